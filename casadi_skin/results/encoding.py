"""Results as data: numbers, names, arrays and the fields of known classes; nothing in them is run when they are read.

A value is written as a type of MessagePack, or as a list that begins with a word: ["array", type, shape, bytes],
["complex", real, imaginary], ["tuple", ...], ["map", {...}], ["enum", class, member], ["object", class, fields],
["point", resolution, constants, fields], and ["shared", number] for what stands in the list of models and spaces, each
of which is written once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import import_module
from typing import Any

import numpy as np

from casadi_skin.follow.settings import Point
from casadi_skin.model.arguments import short_repr
from casadi_skin.solve.estimates import Refinement

KINDS = {"<f8", "<c16", "<i8", "|b1"}  # of arrays
PLACES = {  # of every class that a file may name, with its own name where that is another one
    "Bands": "lattice.linear",
    "Bond": "lattice.declaration",
    "BoundarySpace": "follow.boundary_space",
    "Branch": "follow.branch",
    "Certificate": "certify.certificate",
    "Chain": "lattice.chain",
    "ChainFamily": "optimise.families",
    "Condition": "optimise.search_arguments",
    "Constants": "certify.certificate",
    "ContinuationSettings": "follow.settings",
    "ContinuousSpectrum": "stability.continuous",
    "CosineOrbit": "optimise.optimum",
    "Course": "zero.rest_problem",
    "Critical": "zero.systems",
    "CurveSpace": "follow.rest_curve",
    "Cycle": "dynamics.evolution",
    "Declaration": "lattice.declaration",
    "Diagram": "points.diagram",
    "EdgeCurve": "points.edges",
    "EdgePoint": "points.edges",
    "End": "follow.settings",
    "Ending": "optimise.search_problem",
    "Equilibrium": "follow.solution",
    "EquilibriumSpace": "follow.rest_space",
    "ErrorEstimate": "solve.estimates",
    "Evolution": "dynamics.evolution",
    "FamilyRequest": "zero.request",
    "FamilySearch": "optimise.family_search",
    "FullPeriodFloquet": "stability.result",
    "KickOptimum": "optimise.kick_nlp",
    "Kkt": "optimise.nlp",
    "LatticeModes": "lattice.linear",
    "LocalisedChange": "stability.tongues.localised_diagram",
    "LocalisedDiagram": "stability.tongues.localised_diagram",
    "LocalisedFloquet": "stability.localised",
    "LongLattice": "lattice.long_lattice",
    "MatrixSeries": "stability.tongues.interpolation",
    "Method": "zero.method",
    "ModelFamily": "optimise.families",
    "NlpSolution": "optimise.nlp:Solution",
    "Optimality": "follow.solution",
    "Optimum": "follow.solution",
    "Orbit": "follow.orbit",
    "OrbitCurveSpace": "follow.curve",
    "OrbitSearch": "optimise.orbit_search",
    "Outcome": "optimise.search_problem",
    "ParetoFront": "optimise.search_orbit",
    "Passage": "stability.tongues.diagram",
    "Periodic": "zero.boundary_choices",
    "Piece": "stability.tongues.interpolation",
    "Place": "stability.tongues.diagram",
    "PlainCheck": "optimise.optimum",
    "ProvedStability": "certify.certificate",
    "ProvedStretch": "certify.certificate",
    "ReversibleFloquet": "stability.result",
    "Scalar": "zero.problem",
    "SearchOptimum": "optimise.optimum:Optimum",
    "SearchResult": "optimise.search",
    "SearchStatus": "optimise.search",
    "Site": "lattice.declaration",
    "Sizes": "zero.boundary_choices",
    "SmallestKick": "optimise.kick",
    "Solution": "follow.solution",
    "SpecialPoint": "follow.special_points",
    "Spectrum": "zero.statics",
    "Spreading": "lattice.spreading",
    "StabilityChange": "follow.ledger",
    "StabilityDiagram": "stability.tongues.diagram",
    "StabilityEdge": "stability.tongues.diagram",
    "StableWindow": "stability.tongues.diagram",
    "Start": "optimise.search_problem",
    "Statics": "zero.statics",
    "SymmetryClass": "model.symmetry",
    "Target": "follow.settings",
    "Targets": "zero.method",
    "Tongue": "stability.tongues.diagram",
    "TransientGrowth": "stability.growth",
    "Uniform": "lattice.declaration",
    "Unresolved": "follow.unresolved",
}


def class_named(name: object) -> Any:
    """The class of a name in a file; raises ValueError for any other."""
    if not isinstance(name, str) or name not in PLACES:
        raise ValueError(f"a thing of kind {short_repr(name)}, which no result holds")
    place, _, other = PLACES[name].partition(":")
    return getattr(import_module(f"casadi_skin.{place}"), other or name)


def name_of(kind: type) -> str:
    """The name of a class in a file; empty for one that may not stand there."""
    return next((name for name, place in PLACES.items() if _is_at(kind, name, place)), "")


def _is_at(kind: type, name: str, place: str) -> bool:
    module, _, other = place.partition(":")
    return (kind.__module__, kind.__name__) == (f"casadi_skin.{module}", other or name)


class Writer:
    """Makes data of values; `shared` holds models and spaces, each of which `write_shared` makes data of once."""

    def __init__(self, write_shared: Callable[[Writer, Any], Any | None]) -> None:
        self.shared: list[Any] = []
        self._write_shared = write_shared
        self._places: dict[int, int] = {}
        self._kept: list[Any] = []  # so that no other object gets the id of one of these

    def value(self, value: Any) -> Any:
        """A value as data; raises ValueError for objects that a file cannot hold."""
        if value is None or isinstance(value, bool | str):
            return value
        if isinstance(value, Enum):
            if not name_of(type(value)):
                raise _stranger(value)
            return ["enum", name_of(type(value)), value.name]
        if isinstance(value, np.generic):
            return self.value(value.item())
        if isinstance(value, int | float):
            return value
        if isinstance(value, complex):
            return ["complex", value.real, value.imag]
        if isinstance(value, np.ndarray):
            array = np.ascontiguousarray(value)
            if array.dtype.str not in KINDS:
                raise _stranger(value)
            return ["array", array.dtype.str, list(value.shape), array.tobytes()]
        if isinstance(value, tuple | list):
            return ["tuple" if isinstance(value, tuple) else "list", *(self.value(item) for item in value)]
        if isinstance(value, Mapping):
            return ["map", {str(name): self.value(item) for name, item in value.items()}]
        return self._object(value)

    def _object(self, value: Any) -> Any:
        if id(value) in self._places:
            return ["shared", self._places[id(value)]]
        data = self._write_shared(self, value)
        if data is not None:
            self.shared.append(data)
            self._kept.append(value)
            self._places[id(value)] = len(self.shared) - 1
            return ["shared", len(self.shared) - 1]
        if isinstance(value, Point):
            constants = self.value(value.problem.constants)
            return ["point", value.problem.resolution, constants, self.named_fields(value, ("problem",))]
        if isinstance(value, Refinement):
            return ["refinement", value.problem.resolution, self.value(value.problem.constants), self.value(value.z)]
        if is_dataclass(value) and name_of(type(value)):
            return ["object", name_of(type(value)), self.named_fields(value)]
        raise _stranger(value)

    def named_fields(self, value: Any, without: Sequence[str] = ()) -> dict[str, Any]:
        """Fields by name, those that every object of the class makes itself left out."""
        names = [field.name for field in fields(value) if field.init and field.name not in without]
        return {name: self.value(known_now(value, name)) for name in names}


def _stranger(value: object) -> ValueError:
    what = f"what holds {short_repr(value)} ({type(value).__name__})"
    return ValueError(f"result: given {what}; accepted: results of this package, of models in expressions")


def known_now(value: Any, name: str) -> Any:
    """A field; of an orbit the stability too that was computed since."""
    found = getattr(value, name)
    return vars(value).get("_floquet") if name == "known_floquet" and found is None else found


class Reader:
    """Makes values of data; `read_shared` makes those of models and spaces."""

    def __init__(self, shared: Sequence[Any], read_shared: Callable[[Reader, Any], Any]) -> None:
        self._shared: list[Any] = []
        for data in shared:
            self._shared.append(read_shared(self, data))

    def value(self, data: Any, space: Any = None) -> Any:
        """A value of data, points among it those of a space; raises ValueError and others for other data."""
        if not isinstance(data, list):
            if not (data is None or isinstance(data, bool | str | int | float)):
                raise ValueError(f"a value {short_repr(data)}")
            return data
        word, *rest = data
        if word in ("tuple", "list"):
            items = [self.value(item, space) for item in rest]
            return tuple(items) if word == "tuple" else items
        if word == "complex":
            return complex(*rest)
        if word == "map":
            return {name: self.value(item, space) for name, item in rest[0].items()}
        if word == "array":
            return _array(*rest)
        if word == "enum":
            return class_named(rest[0])[rest[1]]
        if word == "shared":
            return self._shared[_place(rest[0], len(self._shared))]
        if word == "point":
            resolution, constants, named = rest
            problem = self._problem(space, resolution, constants)
            return Point(problem=problem, **self.named(named, space))
        if word == "refinement":
            return Refinement(self._problem(space, rest[0], rest[1]), self.value(rest[2]))
        if word == "object":
            return self._object(class_named(rest[0]), rest[1])
        raise ValueError(f"a value of kind {short_repr(word)}")

    def named(self, data: Mapping[str, Any], space: Any = None) -> dict[str, Any]:
        """Values by name."""
        return {name: self.value(item, space) for name, item in data.items()}

    def _object(self, kind: Any, data: Mapping[str, Any]) -> Any:
        space = self.value(data["space"]) if "space" in data else None
        return kind(**self.named(data, space))

    def _problem(self, space: Any, resolution: int, constants: Any) -> Any:
        if resolution not in space.levels.resolutions:
            raise ValueError(f"a resolution {short_repr(resolution)}; accepted: {space.levels.resolutions}")
        problem = space.levels.problem(resolution)
        found = self.value(constants)
        if found.shape != problem.constants.shape:
            raise ValueError("a point of another discretisation")
        return problem.with_constants(found)


def _array(kind: str, shape: Sequence[int], data: bytes) -> np.ndarray[Any, Any]:
    if kind not in KINDS:
        raise ValueError(f"an array of {short_repr(kind)}")
    return np.frombuffer(data, kind).reshape(shape).copy()


def _place(place: int, count: int) -> int:
    if not 0 <= place < count:
        raise ValueError(f"a reference to {short_repr(place)}, of {count}")
    return place
