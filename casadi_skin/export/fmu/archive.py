"""An FMU as a file: modelDescription.xml, sources, binary, documentation and icon in one archive."""

from __future__ import annotations

import uuid
import zipfile
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from numpy.typing import ArrayLike

from casadi_skin.arguments import short_repr
from casadi_skin.export.fmu.build import compile_library
from casadi_skin.export.fmu.config import config_header
from casadi_skin.export.fmu.description import SOURCES, Description, build_description, terminals_and_icons
from casadi_skin.export.fmu.documentation import icon, page
from casadi_skin.export.fmu.equations import Equations
from casadi_skin.export.fmu.subject import Subject, subject_of
from casadi_skin.files import replacing
from casadi_skin.lattice.chain import Chain
from casadi_skin.models.fmu_archive import library_ending, platform_folder
from casadi_skin.models.ode import OdeModel
from casadi_skin.orbits.orbit import Orbit

Fmi = Literal["3.0", "2.0"]
HEADERS = ("instance.h", "dop853.h")
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of all files inside: the same model gives the same archive


def export_fmu(
    what: Chain | Orbit | OdeModel,
    path: str | Path,
    fmi: Fmi = "3.0",
    *,
    start: ArrayLike | None = None,
    mode: int | str | None = None,
    S: float | None = None,
    stop_time: float | None = None,
    tolerance: float = 1e-8,
    binary: bool = True,
) -> Path:
    """Write a chain, an orbit or a model as an FMU for Model Exchange and Co-Simulation, of FMI 3.0 or 2.0.

    A chain starts from its linear `mode` (1 unless given) with amplitude `S` (sum of y_n^2, 0.01 unless given), an
    orbit from its phase zero, a model from zero, unless `start` gives displacements, or these and velocities (of a
    model of first order its states). Parameters, alpha, gamma and g of a chain, are tunable; outputs are the
    displacements (or states), the model's outputs, and of a chain S and its energy, the Hamiltonian of the gauge with
    rho = 1 at the edge that the modes lean to. `stop_time` (10 periods unless given) and `tolerance` are those of the
    default experiment. The sources are inside; `binary` says whether they are compiled for this platform as well. A
    file that is there is replaced. The model is dimensionless.

    Raises TypeError or ValueError, in one line, for arguments that are out of range, a model of which no C can be
    generated, and where fmpy, which has the headers of the standard, or a C compiler is missing.
    """
    target = Path(path)
    if fmi not in SOURCES:
        raise ValueError(f"fmi: given {short_repr(fmi)}; accepted: {', '.join(SOURCES)}")
    if target.suffix != ".fmu":
        raise ValueError(f"path: given {str(target)!r}; accepted: a file name that ends in .fmu")
    if not target.parent.is_dir():
        raise ValueError(f"path: no folder {str(target.parent)!r}; accepted: a file in a folder that is there")
    subject = subject_of(what, start, mode, S, stop_time, tolerance)
    files = contents(subject, fmi)
    if binary:
        files |= _compiled(subject, fmi, files)
    with replacing(target) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files, key=lambda name: (name != "modelDescription.xml", name)):
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, files[name])
    return target


def contents(subject: Subject, fmi: Fmi) -> dict[str, bytes]:
    """All files of an FMU but its binary, by their names in the archive."""
    equations = Equations(subject.model, subject.identifier)
    source = equations.source()
    unnamed = config_header(subject, equations, "")
    token = "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, unnamed + source)) + "}"
    description = Description(subject, equations, token)
    files = {
        "modelDescription.xml": description.fmi3() if fmi == "3.0" else description.fmi2(),
        "documentation/index.html": page(description, fmi).encode(),
        "documentation/licenses/license.txt": _packaged("license.txt"),
        "sources/config.h": config_header(subject, equations, token).encode(),
        f"sources/{subject.identifier}_equations.c": source.encode(),
    }
    files |= {f"sources/{name}": _packaged(name) for name in (*SOURCES[fmi], *HEADERS)}
    if fmi == "3.0":
        files["sources/buildDescription.xml"] = build_description(subject.identifier, description.source_files(fmi))
        files["terminalsAndIcons/terminalsAndIcons.xml"] = terminals_and_icons()
        files["terminalsAndIcons/icon.png"] = icon()
    else:
        files["model.png"] = icon()
    return files


def _packaged(name: str) -> bytes:
    return resources.files("casadi_skin.export.fmu").joinpath("sources", name).read_bytes()


def _compiled(subject: Subject, fmi: Fmi, files: dict[str, bytes]) -> dict[str, bytes]:
    """The shared library for this platform, by its name in the archive."""
    name = f"binaries/{platform_folder(fmi)}/{subject.identifier}.{library_ending()}"
    sources = (*SOURCES[fmi], f"{subject.identifier}_equations.c")
    with TemporaryDirectory(prefix="casadi_skin_fmu_") as folder:
        for file, text in files.items():
            if file.startswith("sources/"):
                Path(folder, Path(file).name).write_bytes(text)
        return {name: compile_library(Path(folder), sources, Path(folder, "library")).read_bytes()}
