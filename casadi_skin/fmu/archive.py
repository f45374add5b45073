"""An FMU as a file: modelDescription.xml, sources, binary, documentation and icon in one archive.

The XML files of an FMU: modelDescription.xml for FMI 2.0 and 3.0, buildDescription.xml, terminalsAndIcons.xml.

Value references are 0 for the time, then states, their derivatives, parameters, inputs and outputs in their order, as
in sources/instance.h. In FMI 2.0 dependencies are the positions of the variables in the list, counted from 1.
"""

from __future__ import annotations

import re
import uuid
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin._version import __version__
from casadi_skin.export.codegen import build_library, pieces, with_words
from casadi_skin.export.exported_model import Source
from casadi_skin.fmu.description import library_name
from casadi_skin.fmu.initial_value_problem import (
    SOURCES,
    Equations,
    InitialValueProblem,
    check_smooth,
    config_header,
    initial_value_problem,
)
from casadi_skin.fmu.instance import with_inputs
from casadi_skin.model.arguments import check_name, new_file, truth
from casadi_skin.model.files import replacing
from casadi_skin.model.result import in_turn, renamed

# The XML files of an FMU: modelDescription.xml for FMI 2.0 and 3.0, buildDescription.xml, terminalsAndIcons.xml -------

STRUCTURED_NAME = re.compile(r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?", re.ASCII)
DIMENSIONLESS = {"unit": "1"}
COMMUNICATION_STEPS = 500  # of communication, in the default experiment
Fmi = Literal["3.0", "2.0"]


@dataclass(frozen=True)
class Variable:
    """One entry of ModelVariables; `derivative` is the value reference of the state that it is the derivative of."""

    name: str
    reference: int
    causality: str
    variability: str
    initial: str | None = None
    description: str = ""
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    start: float | None = None
    derivative: int | None = None

    @property
    def words(self) -> dict[str, str]:
        """Attributes of any variable."""
        words = {key: getattr(self, key) for key in ("causality", "variability", "initial", "description")}
        known = {key: word for key, word in words.items() if word}
        return {"name": self.name, "valueReference": str(self.reference)} | known

    @property
    def numbers(self) -> dict[str, str]:
        """Attributes of a real variable."""
        known = {key: getattr(self, key) for key in ("min", "max", "nominal", "start")}
        return DIMENSIONLESS | {key: repr(float(value)) for key, value in known.items() if value is not None}


@dataclass(frozen=True, eq=False)
class Description:
    """The contents of modelDescription.xml of one model."""

    problem: InitialValueProblem
    equations: Equations
    token: str

    @cached_property
    def variables(self) -> list[Variable]:
        """All variables in the order of their value references."""
        problem, model = self.problem, self.problem.model
        found = [Variable("time", 0, "independent", "continuous", description="time")]

        def add(name: str, causality: str, initial: str | None, meaning: str, **values: Any) -> None:
            variability = "tunable" if causality == "parameter" else "continuous"
            description = problem.meanings.get(name, meaning)
            found.append(Variable(name, len(found), causality, variability, initial, description=description, **values))

        for name, start, nominal in zip(model.state_names, problem.start, problem.nominals, strict=True):
            add(name, "output", "exact", "state", start=start, nominal=nominal)
        for k, name in enumerate(model.state_names, start=1):
            add(f"der({name})", "local", "calculated", f"time derivative of {name}", derivative=k)
        for name, value in zip(model.parameter_names, problem.parameters, strict=True):
            kind, initial = ("input", None) if name in problem.inputs else ("parameter", "exact")
            limits = dict(zip(("min", "max"), problem.bounds.get(name, ()), strict=False))
            add(name, kind, initial, kind, start=value, **limits)
        for name in model.outputs:
            add(name, "output", "calculated", "output")
        return found

    @cached_property
    def naming(self) -> str:
        """ "structured" where all names are legal there, else "flat"."""
        names = (v.name for v in self.variables if v.derivative is None)
        return "structured" if all(STRUCTURED_NAME.fullmatch(name) for name in names) else "flat"

    def dependencies(self, variable: Variable, *, initially: bool, fmi: str) -> list[int]:
        """Value references of the knowns that a variable depends on, ascending; an output that is a state is its own.

        Inputs are knowns at all times; tunable parameters in FMI 3.0 too, and in FMI 2.0 in initialisation only.
        """
        if variable.initial == "exact":
            return [variable.reference]
        states, parameters = self.problem.model.full_size, len(self.problem.parameters)
        row = variable.reference - 1 - states - (0 if variable.reference <= 2 * states else parameters)
        references = [int(c) if c <= states else int(c) + states for c in np.flatnonzero(self.equations.depends[row])]
        held = range(1 + 2 * states, 1 + 2 * states + parameters - len(self.problem.inputs))
        return [r for r in references if r not in held or initially or fmi == "3.0"]

    def filled(self, piece: str) -> ET.Element:
        """A piece of descriptions.xml with the words of this model."""
        problem, stop = self.problem, float(self.problem.stop_time)
        words = {
            "name": problem.model.name, "description": problem.description, "version": __version__,
            "naming": self.naming, "token": self.token, "identifier": problem.identifier,
            "equations": equations_file(problem), "stop": stop, "tolerance": float(problem.tolerance),
            "step": stop / COMMUNICATION_STEPS,
        }  # fmt: skip
        root = ET.fromstring(pieces(SOURCES, "descriptions.xml")[piece])
        for element in root.iter():
            element.attrib.update({key: with_words(text, **words) for key, text in element.items()})
        return root

    def xml(self, fmi: Fmi) -> bytes:
        """modelDescription.xml of a version of the standard."""
        three, root = fmi == "3.0", self.filled(fmi)
        variables, structure = (next(root.iter(name)) for name in ("ModelVariables", "ModelStructure"))
        for v in self.variables:
            numbers = v.numbers
            if v.derivative is not None:
                numbers["derivative"] = str(v.derivative if three else v.derivative + 1)
            if three:
                ET.SubElement(variables, "Float64", v.words | numbers)
            else:
                ET.SubElement(ET.SubElement(variables, "ScalarVariable", v.words), "Real", numbers)
        self._structure(structure, fmi)
        return _text(root)

    def _structure(self, structure: ET.Element, fmi: str) -> None:
        """Outputs, derivatives and unknowns of the initialisation, with their dependencies."""
        outputs = [v for v in self.variables if v.causality == "output"]
        derivatives = [v for v in self.variables if v.derivative is not None]
        calculated = [v for v in outputs if v.initial == "calculated"] + derivatives
        for element, title, group in (
            ("Output", "Outputs", outputs),
            ("ContinuousStateDerivative", "Derivatives", derivatives),
            ("InitialUnknown", "InitialUnknowns", sorted(calculated, key=lambda v: v.reference)),
        ):
            three = fmi == "3.0"
            parent = structure if three or not group else ET.SubElement(structure, title)
            tag, key, first = (element, "valueReference", 0) if three else ("Unknown", "index", 1)
            for v in group:
                depends = self.dependencies(v, initially=element == "InitialUnknown", fmi=fmi)
                words = " ".join(str(reference + first) for reference in depends)
                ET.SubElement(parent, tag, {key: str(v.reference + first), "dependencies": words})


def _text(root: ET.Element) -> bytes:
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"


# The documentation page inside an FMU ---------------------------------------------------------------------------------


def page(description: Description, fmi: Fmi) -> str:
    """documentation/index.html: the model, its variables, its origin and how it is compiled elsewhere."""
    problem, piece = description.problem, pieces(SOURCES, "index.html")
    energy = piece["energy"] if "energy" in problem.model.outputs else ""
    chain = with_words(piece["chain"], energy=energy).rstrip() if "energy" in problem.meanings else ""
    return with_words(
        piece["page"], tolerance=repr(problem.tolerance), version=__version__, chain=chain,
        files=" ".join(source_files(problem, fmi)), identifier=problem.identifier,
        rows="".join(map(_row, description.variables)), description=escape(problem.description),
        name=escape(problem.model.name),
    )  # fmt: skip


def _row(variable: Variable) -> str:
    start = "" if variable.start is None else f"{variable.start:.6g}"
    cells = (variable.name, variable.causality, start, variable.description)
    return "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>\n"


# An FMU as a file: modelDescription.xml, sources, binary, documentation and icon in one archive -----------------------

INTERFACE_SOURCES = {"2.0": "fmi2.c", "3.0": "fmi3.c"}
HEADER_FILES = ("instance.h", "dop853.h")
_FILE_DATE = (1980, 1, 1, 0, 0, 0)  # of all files inside: the same model gives the same archive


@renamed(what="source")
@in_turn
def export_fmu(
    source: Source,
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
        source: A Chain, an OdeModel, or an orbit of `follow_family` or `find_orbit`.
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
    target = new_file("path", path, ".fmu")
    check_name("fmi", fmi, INTERFACE_SOURCES)
    truth("binary", binary)
    problem = with_inputs(initial_value_problem(source, start, mode, S, stop_time, tolerance), inputs)
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
        f"sources/{equations_file(problem)}": source.encode(),
    }
    files |= {f"sources/{name}": _packaged(name) for name in (INTERFACE_SOURCES[fmi], *HEADER_FILES)}
    if fmi == "3.0":
        files["sources/buildDescription.xml"] = _text(description.filled("build"))
        files["terminalsAndIcons/terminalsAndIcons.xml"] = _packaged("terminalsAndIcons.xml")
        files["terminalsAndIcons/icon.png"] = _packaged("icon.png")
    else:
        files["model.png"] = _packaged("icon.png")
    return files


def equations_file(problem: InitialValueProblem) -> str:
    """Name of the C file of a model's equations."""
    return f"{problem.identifier}_equations.c"


def source_files(problem: InitialValueProblem, fmi: Fmi) -> tuple[str, str]:
    """Names of the C files that are compiled."""
    return INTERFACE_SOURCES[fmi], equations_file(problem)


def _packaged(name: str) -> bytes:
    return (SOURCES / name).read_bytes()


def _compiled(problem: InitialValueProblem, fmi: Fmi, files: dict[str, bytes]) -> dict[str, bytes]:
    """The shared library for this platform, by its name in the archive."""
    name = library_name(fmi, problem.identifier)
    with TemporaryDirectory(prefix="casadi_skin_fmu_") as folder:
        for file, text in files.items():
            if file.startswith("sources/"):
                Path(folder, Path(file).name).write_bytes(text)
        target = Path(folder, Path(name).name)
        return {name: build_library(Path(folder), source_files(problem, fmi), target).read_bytes()}
