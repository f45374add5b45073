"""The XML files of an FMU: modelDescription.xml for FMI 2.0 and 3.0, buildDescription.xml, terminalsAndIcons.xml.

Value references are 0 for the time, then states, their derivatives, parameters and outputs in their order, as in
sources/instance.h. In FMI 2.0 dependencies are the positions of the variables in the list, counted from 1.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from xml.etree import ElementTree as ET

import numpy as np

from casadi_skin._version import __version__
from casadi_skin.export.fmu.equations import Equations
from casadi_skin.export.fmu.initial_value_problem import InitialValueProblem

SOURCES = {"2.0": ("fmi2.c",), "3.0": ("fmi3.c",)}  # of the interface; that of the equations is named after the model
CATEGORIES = {"logStatusDiscard": "Values that cannot be computed", "logStatusError": "Errors"}
STRUCTURED = re.compile(r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?", re.ASCII)
UNIT = "1"
STEPS = 500  # of communication, in the default experiment


@dataclass(frozen=True)
class Variable:
    """One entry of ModelVariables; `derivative` is the value reference of the state that it is the derivative of."""

    name: str
    reference: int
    causality: str
    variability: str
    initial: str | None = None
    start: float | None = None
    derivative: int | None = None
    bounds: tuple[float, float] | None = None
    nominal: float | None = None
    description: str = ""


@dataclass(frozen=True, eq=False)
class Description:
    """What the XML files say of one model."""

    problem: InitialValueProblem
    equations: Equations
    token: str

    @cached_property
    def variables(self) -> list[Variable]:
        """All variables in the order of their value references."""
        problem, model = self.problem, self.problem.model
        found = [Variable("time", 0, "independent", "continuous", description="time")]
        nominal = problem.nominal
        for name, start, is_output in zip(model.state_names, problem.start, problem.is_output, strict=True):
            causality, meaning = "output" if is_output else "local", problem.meanings.get(name, "state")
            found.append(
                Variable(name, len(found), causality, "continuous", "exact", start, None, None, nominal, meaning)
            )
        for k, name in enumerate(model.state_names, start=1):
            meaning = f"time derivative of {name}"
            found.append(
                Variable(f"der({name})", len(found), "local", "continuous", "calculated", None, k, description=meaning)
            )
        for name, value in zip(model.parameter_names, problem.parameters, strict=True):
            bounds, meaning = problem.bounds.get(name), problem.meanings.get(name, "parameter")
            found.append(
                Variable(name, len(found), "parameter", "tunable", "exact", value, None, bounds, description=meaning)
            )
        for name in model.outputs:
            meaning = problem.meanings.get(name, "output")
            found.append(Variable(name, len(found), "output", "continuous", "calculated", description=meaning))
        return found

    @cached_property
    def naming(self) -> str:
        """ "structured" where all names are legal there, else "flat"."""
        names = (v.name for v in self.variables if v.derivative is None)
        return "structured" if all(STRUCTURED.fullmatch(name) for name in names) else "flat"

    def dependencies(self, reference: int, *, initially: bool, fmi: str) -> list[int]:
        """Value references of what a derivative or an output that is no state depends on, ascending.

        Tunable parameters are knowns at all times in FMI 3.0, and in FMI 2.0 in initialisation only.
        """
        states, parameters = self.problem.model.full_size, len(self.problem.parameters)
        row = reference - 1 - states if reference <= 2 * states else reference - 1 - states - parameters
        columns = np.flatnonzero(self.equations.depends[row])
        references = [int(c) if c <= states else int(c) + states for c in columns]
        with_parameters = initially or fmi == "3.0"
        return [r for r in references if r <= states or with_parameters]

    # FMI 3.0 ----------------------------------------------------------------------------------------------------------

    def fmi3(self) -> bytes:
        """modelDescription.xml of FMI 3.0."""
        root = self._root("3.0", instantiationToken=self.token)
        flags = {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true"}
        flags |= {"providesDirectionalDerivatives": "true", "providesAdjointDerivatives": "true"}
        common = {"modelIdentifier": self.problem.identifier} | flags
        ET.SubElement(root, "ModelExchange", common)
        ET.SubElement(root, "CoSimulation", common | {"canHandleVariableCommunicationStepSize": "true"})
        self._units(root)
        self._categories_and_experiment(root)
        variables = ET.SubElement(root, "ModelVariables")
        for v in self.variables:
            attributes = {"name": v.name, "valueReference": str(v.reference)} | _common(v) | _numbers(v)
            if v.derivative is not None:
                attributes["derivative"] = str(v.derivative)
            ET.SubElement(variables, "Float64", attributes)
        structure = ET.SubElement(root, "ModelStructure")
        for element, initially, group in self._unknowns():
            for v in group:
                depends = self._known_of(v, initially, "3.0")
                attributes = {"valueReference": str(v.reference), "dependencies": _words(depends)}
                ET.SubElement(structure, element, attributes)
        return _text(root)

    # FMI 2.0 ----------------------------------------------------------------------------------------------------------

    def fmi2(self) -> bytes:
        """modelDescription.xml of FMI 2.0."""
        root = self._root("2.0", guid=self.token, numberOfEventIndicators="0")
        flags = {"canNotUseMemoryManagementFunctions": "true", "canGetAndSetFMUstate": "true"}
        flags |= {"canSerializeFMUstate": "true", "providesDirectionalDerivative": "true"}
        common = {"modelIdentifier": self.problem.identifier} | flags
        exchange = ET.SubElement(root, "ModelExchange", common)
        cosimulation = ET.SubElement(root, "CoSimulation", common | {"canHandleVariableCommunicationStepSize": "true"})
        for parent in (exchange, cosimulation):
            files = ET.SubElement(parent, "SourceFiles")
            for name in self.source_files("2.0"):
                ET.SubElement(files, "File", {"name": name})
        self._units(root)
        self._categories_and_experiment(root)
        variables = ET.SubElement(root, "ModelVariables")
        for v in self.variables:
            names = {"name": v.name, "valueReference": str(v.reference)}
            scalar = ET.SubElement(variables, "ScalarVariable", names | _common(v))
            attributes = _numbers(v)
            if v.derivative is not None:
                attributes["derivative"] = str(v.derivative + 1)
            ET.SubElement(scalar, "Real", attributes)
        structure = ET.SubElement(root, "ModelStructure")
        titles = {"Output": "Outputs", "ContinuousStateDerivative": "Derivatives", "InitialUnknown": "InitialUnknowns"}
        for element, initially, group in self._unknowns():
            if not group:
                continue
            parent = ET.SubElement(structure, titles[element])
            for v in group:
                depends = [r + 1 for r in self._known_of(v, initially, "2.0")]
                attributes = {"index": str(v.reference + 1), "dependencies": _words(depends)}
                ET.SubElement(parent, "Unknown", attributes)
        return _text(root)

    # Both -------------------------------------------------------------------------------------------------------------

    def source_files(self, fmi: str) -> tuple[str, ...]:
        """Names of the C files that are compiled."""
        return (*SOURCES[fmi], f"{self.problem.identifier}_equations.c")

    def _unknowns(self) -> list[tuple[str, bool, list[Variable]]]:
        outputs = [v for v in self.variables if v.causality == "output"]
        derivatives = [v for v in self.variables if v.derivative is not None]
        calculated = [v for v in outputs if v.initial == "calculated"] + derivatives
        initial = sorted(calculated, key=lambda v: v.reference)
        return [
            ("Output", False, outputs),
            ("ContinuousStateDerivative", False, derivatives),
            ("InitialUnknown", True, initial),
        ]

    def _known_of(self, variable: Variable, initially: bool, fmi: str) -> list[int]:
        if variable.initial == "exact":
            return [variable.reference]  # an output that is a state depends on itself
        return self.dependencies(variable.reference, initially=initially, fmi=fmi)

    def _root(self, fmi: str, **attributes: str) -> ET.Element:
        given = {"fmiVersion": fmi, "modelName": self.problem.model.name, "description": self.problem.description}
        given |= {"generationTool": f"casadi_skin {__version__}", "variableNamingConvention": self.naming}
        return ET.Element("fmiModelDescription", given | attributes)

    def _units(self, root: ET.Element) -> None:
        unit = ET.SubElement(ET.SubElement(root, "UnitDefinitions"), "Unit", {"name": UNIT})
        ET.SubElement(unit, "BaseUnit")  # all exponents are 0: dimensionless

    def _categories_and_experiment(self, root: ET.Element) -> None:
        categories = ET.SubElement(root, "LogCategories")
        for name, meaning in CATEGORIES.items():
            ET.SubElement(categories, "Category", {"name": name, "description": meaning})
        stop = self.problem.stop_time
        times = {"startTime": "0.0", "stopTime": repr(float(stop)), "tolerance": repr(float(self.problem.tolerance))}
        ET.SubElement(root, "DefaultExperiment", times | {"stepSize": repr(float(stop) / STEPS)})


def _common(variable: Variable) -> dict[str, str]:
    found = {"causality": variable.causality, "variability": variable.variability}
    found |= {"initial": variable.initial} if variable.initial is not None else {}
    return found | ({"description": variable.description} if variable.description else {})


def _numbers(variable: Variable) -> dict[str, str]:
    found = {"unit": UNIT}
    if variable.bounds is not None:
        found |= {"min": repr(variable.bounds[0]), "max": repr(variable.bounds[1])}
    for name, value in (("nominal", variable.nominal), ("start", variable.start)):
        if value is not None:
            found[name] = repr(float(value))
    return found


def _words(references: Iterable[int]) -> str:
    return " ".join(map(str, references))


def _text(root: ET.Element) -> bytes:
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"


def build_description(identifier: str, files: Iterable[str]) -> bytes:
    """sources/buildDescription.xml of FMI 3.0: what another platform compiles, and how."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = ET.SubElement(root, "BuildConfiguration", {"modelIdentifier": identifier})
    group = ET.SubElement(configuration, "SourceFileSet", {"language": "C99"})
    for name in files:
        ET.SubElement(group, "SourceFile", {"name": name})
    meaning = "mathematical functions of C, where they are a library of their own"
    ET.SubElement(configuration, "Library", {"name": "m", "external": "true", "description": meaning})
    return _text(root)


def terminals_and_icons() -> bytes:
    """terminalsAndIcons/terminalsAndIcons.xml of FMI 3.0: where the icon is drawn."""
    root = ET.Element("fmiTerminalsAndIcons", {"fmiVersion": "3.0"})
    picture = ET.SubElement(root, "GraphicalRepresentation")
    extent = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}
    ET.SubElement(picture, "CoordinateSystem", extent | {"suggestedScalingFactorTo_mm": "0.1"})
    ET.SubElement(picture, "Icon", extent)
    return _text(root)
