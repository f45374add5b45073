"""The XML files of an FMU: modelDescription.xml for FMI 2.0 and 3.0, buildDescription.xml, terminalsAndIcons.xml.

Value references are 0 for the time, then states, their derivatives, parameters, inputs and outputs in their order, as
in sources/instance.h. In FMI 2.0 dependencies are the positions of the variables in the list, counted from 1.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from casadi_skin._version import __version__
from casadi_skin.fmu.equations import Equations
from casadi_skin.fmu.initial_value_problem import InitialValueProblem

SOURCES = {"2.0": ("fmi2.c",), "3.0": ("fmi3.c",)}  # of the interface; that of the equations is named after the model
CATEGORIES = {"logStatusDiscard": "Values that cannot be computed", "logStatusError": "Errors"}
STRUCTURED = re.compile(r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?", re.ASCII)
UNIT = "1"
MOST_REFERENCES = (1 << 31) - 1  # value references have 32 bits, and are numbers of an enum of C
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
            add(name, kind, initial, kind, start=value, bounds=problem.bounds.get(name))
        for name in model.outputs:
            add(name, "output", "calculated", "output")
        if len(found) > MOST_REFERENCES:
            raise ValueError(f"{model.name}: {len(found)} variables; accepted: up to {MOST_REFERENCES}")
        return found

    @cached_property
    def naming(self) -> str:
        """ "structured" where all names are legal there, else "flat"."""
        names = (v.name for v in self.variables if v.derivative is None)
        return "structured" if all(STRUCTURED.fullmatch(name) for name in names) else "flat"

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

    def source_files(self, fmi: str) -> tuple[str, ...]:
        """Names of the C files that are compiled."""
        return (*SOURCES[fmi], f"{self.problem.identifier}_equations.c")

    def xml(self, fmi: str) -> bytes:
        """modelDescription.xml of a version of the standard."""
        three, problem = fmi == "3.0", self.problem
        given = {"fmiVersion": fmi, "modelName": problem.model.name, "description": problem.description}
        given |= {"generationTool": f"casadi_skin {__version__}", "variableNamingConvention": self.naming}
        given |= {"instantiationToken": self.token} if three else {"guid": self.token, "numberOfEventIndicators": "0"}
        root = ET.Element("fmiModelDescription", given)
        self._interfaces(root, fmi)
        unit = ET.SubElement(ET.SubElement(root, "UnitDefinitions"), "Unit", {"name": UNIT})
        ET.SubElement(unit, "BaseUnit")  # all exponents are 0: dimensionless
        categories = ET.SubElement(root, "LogCategories")
        for name, meaning in CATEGORIES.items():
            ET.SubElement(categories, "Category", {"name": name, "description": meaning})
        stop = float(problem.stop_time)
        times = {"startTime": "0.0", "stopTime": repr(stop), "tolerance": repr(float(problem.tolerance))}
        ET.SubElement(root, "DefaultExperiment", times | {"stepSize": repr(stop / STEPS)})
        variables = ET.SubElement(root, "ModelVariables")
        for v in self.variables:
            names, numbers = {"name": v.name, "valueReference": str(v.reference)} | _common(v), _numbers(v)
            if v.derivative is not None:
                numbers["derivative"] = str(v.derivative if three else v.derivative + 1)
            if three:
                ET.SubElement(variables, "Float64", names | numbers)
            else:
                ET.SubElement(ET.SubElement(variables, "ScalarVariable", names), "Real", numbers)
        self._structure(ET.SubElement(root, "ModelStructure"), fmi)
        return _text(root)

    def _interfaces(self, root: ET.Element, fmi: str) -> None:
        if fmi == "3.0":
            flags = ("canGetAndSetFMUState", "canSerializeFMUState", "providesDirectionalDerivatives",
                     "providesAdjointDerivatives")  # fmt: skip
        else:
            flags = ("canNotUseMemoryManagementFunctions", "canGetAndSetFMUstate", "canSerializeFMUstate",
                     "providesDirectionalDerivative")  # fmt: skip
        common = {"modelIdentifier": self.problem.identifier} | dict.fromkeys(flags, "true")
        exchange = ET.SubElement(root, "ModelExchange", common)
        cosimulation = ET.SubElement(root, "CoSimulation", common | {"canHandleVariableCommunicationStepSize": "true"})
        for parent in (exchange, cosimulation) if fmi == "2.0" else ():
            files = ET.SubElement(parent, "SourceFiles")
            for name in self.source_files(fmi):
                ET.SubElement(files, "File", {"name": name})

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
            parent = ET.SubElement(structure, title) if fmi == "2.0" and group else structure
            for v in group:
                depends = self.dependencies(v, initially=element == "InitialUnknown", fmi=fmi)
                if fmi == "3.0":
                    attributes = {"valueReference": str(v.reference), "dependencies": _words(depends)}
                    ET.SubElement(parent, element, attributes)
                else:
                    attributes = {"index": str(v.reference + 1), "dependencies": _words(r + 1 for r in depends)}
                    ET.SubElement(parent, "Unknown", attributes)


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
    """sources/buildDescription.xml of FMI 3.0: the sources and options for compilers on other platforms."""
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
