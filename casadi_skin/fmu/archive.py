"""An FMU as a file: modelDescription.xml, sources, binary, documentation and icon in one archive."""

from __future__ import annotations

import uuid
import zipfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from numpy.typing import ArrayLike

from casadi_skin.export.compiler import build_library
from casadi_skin.export.exported_model import Source
from casadi_skin.fmu.description import (
    INTERFACE_SOURCES,
    Description,
    build_description,
    icon,
    page,
    terminals_and_icons,
)
from casadi_skin.fmu.fmu_archive import library_ending, platform_folder
from casadi_skin.fmu.initial_value_problem import (
    Equations,
    InitialValueProblem,
    check_smooth,
    config_header,
    initial_value_problem,
)
from casadi_skin.fmu.instance import with_inputs
from casadi_skin.model.arguments import check_name, file_path, truth
from casadi_skin.model.files import replacing

Fmi = Literal["3.0", "2.0"]
HEADER_FILES = ("instance.h", "dop853.h")
_FILE_DATE = (1980, 1, 1, 0, 0, 0)  # of all files inside: the same model gives the same archive


def export_fmu(
    what: Source,
    path: str | Path,
    fmi: Fmi = "3.0",
    *,
    start: ArrayLike | None = None,
    mode: int | str | None = None,
    S: float | None = None,
    stop_time: float | None = None,
    tolerance: float = 1e-8,
    inputs: Sequence[str] = (),
    binary: bool = True,
) -> Path:
    """Write a chain, a model, or an orbit of either as an FMU for Model Exchange and Co-Simulation.

    Parameters, alpha, gamma and g of a chain, are tunable. Outputs are displacements and velocities (or states), the
    model's outputs, and of a chain S and its energy, the Hamiltonian of the gauge with rho = 1 at the edge that the
    modes lean to. The sources are inside; a file that is there is replaced. The model is dimensionless.

    Arguments:
        what: A Chain, an OdeModel, or an orbit of `follow_family` or `find_orbit`.
        path: The file, whose name ends in .fmu.
        fmi: The version of the standard, "3.0" or "2.0".
        start: Displacements, or these and velocities, shape (sites,) or (2 sites,); of a model its states. By default a
            chain starts from a linear mode, an orbit from its phase zero, a model from zero.
        mode: The linear mode from which a chain starts, 1 unless given.
        S: Its amplitude, the sum of y_n^2, 0.01 unless given.
        stop_time: End of the default experiment, 10 periods unless given.
        tolerance: Of the default experiment, 1e-14 to 1e-2.
        inputs: Names of forces on sites (f_3 acts on y_3 of a chain or a lattice, f_q on q of a model of second order)
            and of parameters that become inputs; forces start from 0.
        binary: Whether the sources are compiled for this platform as well.

    Returns:
        The path of the file.

    Raises:
        TypeError: An argument is of a wrong type.
        ValueError: An argument is out of range; no C can be generated of the model, or its equations jump; fmpy, which
            has the headers of the standard, or a C compiler is missing.
    """
    target = file_path("path", path)
    check_name("fmi", fmi, INTERFACE_SOURCES)
    truth("binary", binary)
    if target.suffix != ".fmu":
        raise ValueError(f"path: given {str(target)!r}; accepted: a file name that ends in .fmu")
    if not target.parent.is_dir():
        raise ValueError(f"path: no folder {str(target.parent)!r}; accepted: a file in a folder that is there")
    problem = with_inputs(initial_value_problem(what, start, mode, S, stop_time, tolerance), inputs)
    check_smooth(problem)
    files = contents(problem, fmi)
    if binary:
        files |= _compiled(problem, fmi, files)
    with replacing(target) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files, key=lambda name: (name != "modelDescription.xml", name)):
            entry = zipfile.ZipInfo(name, _FILE_DATE)
            entry.compress_type, entry.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(entry, files[name])
    return target


def contents(problem: InitialValueProblem, fmi: Fmi) -> dict[str, bytes]:
    """All files of an FMU but its binary, by their names in the archive."""
    equations = Equations(problem.model, problem.identifier)
    source = equations.source()
    unnamed = config_header(problem, equations, "")
    token = "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, unnamed + source)) + "}"
    description = Description(problem, equations, token)
    files = {
        "modelDescription.xml": description.xml(fmi),
        "documentation/index.html": page(description, fmi).encode(),
        "documentation/licenses/license.txt": _packaged("license.txt"),
        "sources/config.h": config_header(problem, equations, token).encode(),
        f"sources/{problem.identifier}_equations.c": source.encode(),
    }
    files |= {f"sources/{name}": _packaged(name) for name in (*INTERFACE_SOURCES[fmi], *HEADER_FILES)}
    if fmi == "3.0":
        files["sources/buildDescription.xml"] = build_description(problem.identifier, description.source_files(fmi))
        files["terminalsAndIcons/terminalsAndIcons.xml"] = terminals_and_icons()
        files["terminalsAndIcons/icon.png"] = icon()
    else:
        files["model.png"] = icon()
    return files


def _packaged(name: str) -> bytes:
    return resources.files("casadi_skin.fmu").joinpath("sources", name).read_bytes()


def _compiled(problem: InitialValueProblem, fmi: Fmi, files: dict[str, bytes]) -> dict[str, bytes]:
    """The shared library for this platform, by its name in the archive."""
    name = f"binaries/{platform_folder(fmi)}/{problem.identifier}.{library_ending()}"
    sources = (*INTERFACE_SOURCES[fmi], f"{problem.identifier}_equations.c")
    with TemporaryDirectory(prefix="casadi_skin_fmu_") as folder:
        for file, text in files.items():
            if file.startswith("sources/"):
                Path(folder, Path(file).name).write_bytes(text)
        return {name: build_library(Path(folder), sources, Path(folder, "library")).read_bytes()}
