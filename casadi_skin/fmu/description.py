"""An imported FMU as a file: its description is checked, and its necessary parts are unpacked.

Variables in its description of which a model is made: states, parameters, inputs and outputs. Arrays of FMI 3.0 are
taken number by number: the entry in row 1 and column 2 of A is A[1,2].
"""

from __future__ import annotations

import ctypes
import hashlib
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any
from xml.etree import ElementTree as ET
from xml.parsers.expat import ParserCreate

import numpy as np
from numpy.typing import NDArray

from casadi_skin.fmu.unzip import Archive
from casadi_skin.model.arguments import in_words, nearest, short_repr
from casadi_skin.model.files import TemporaryFolder
from casadi_skin.model.result import warn_caller

DESCRIPTION_FILE = "modelDescription.xml"
LARGEST_DESCRIPTION = 1 << 26  # bytes
MOST_ELEMENTS = 1_000_000  # of XML in a description
MOST_VARIABLES = 100_000
MOST_STATES = 2_000
LARGEST_REFERENCE = (1 << 32) - 1  # of FMI's functions
DEEPEST_XML = 100  # elements of XML within each other
CHUNK_BYTES = 1 << 16  # bytes
MODEL_EXCHANGE, CO_SIMULATION = "ModelExchange", "CoSimulation"  # kinds of FMUs in the standard
INTERFACES = {MODEL_EXCHANGE: "modelExchange", CO_SIMULATION: "coSimulation"}  # in fmpy's descriptions
Array = NDArray[np.float64]
Pattern = NDArray[np.bool_]
REAL_TYPES = ("Real", "Float64")
MOST_LISTED = 8  # names in a message


def fmpy_package() -> Any:
    """The package fmpy; raises ValueError where it is not installed."""
    try:
        import fmpy
    except ImportError as error:
        raise ValueError("fmpy is not installed; accepted: pip install 'casadi-skin[fmu]'") from error
    return fmpy


def library_name(fmi: str, identifier: str) -> str:
    """Name of this platform's library in an FMU of FMI 2.0 or 3.0."""
    fmpy = fmpy_package()
    folder = fmpy.platform if fmi.startswith("2") else fmpy.platform_tuple
    return f"binaries/{folder}/{identifier}{fmpy.sharedLibraryExtension}"


class FmuWarning(UserWarning):
    """Oddities of an FMU that do not matter for the model."""


@dataclass(frozen=True, eq=False)
class Unpacked:
    """An FMU's folder, the library in it for this platform, and its modelDescription.xml as fmpy reads it.

    `digest` is the SHA-256 of the file, `remove` removes the folder, `kind` is that of the interface which is used.
    """

    path: Path
    folder: Path
    library: Path
    description: Any
    remove: Callable[[], object]
    digest: str = ""
    kind: str = MODEL_EXCHANGE

    @property
    def offers_derivatives(self) -> bool:
        """Whether the FMU says that it has directional derivatives; fmpy does not keep that flag of FMI 3.0."""
        exchange = ET.parse(self.folder / DESCRIPTION_FILE).getroot().find("ModelExchange")
        flags = ("providesDirectionalDerivatives", "providesDirectionalDerivative")
        return exchange is not None and any(exchange.get(flag) in ("true", "1") for flag in flags)


def unpack(path: str | Path, kind: str = MODEL_EXCHANGE) -> Unpacked:
    """Unpack an FMU of a kind, without its sources, into a new temporary folder, which the caller removes.

    Raises ValueError, in one line, for other files, for FMUs that are damaged or hostile, of another kind or without a
    binary for this platform, and where fmpy is missing; nothing is left behind then.
    """
    path = Path(path)
    archive = Archive(path)  # refuses pipes and devices
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        if DESCRIPTION_FILE not in archive.names:
            raise ValueError(f"{path}: no {DESCRIPTION_FILE} inside; accepted: an FMU")
        temporary = TemporaryFolder("casadi_skin_fmu_")
        try:
            archive.write(temporary.path, lambda name: name == DESCRIPTION_FILE)
            description = read_description(path, temporary.path, kind)
            library = _library(path, description, archive.names, kind)
            wanted = ("/".join([*PurePosixPath(library).parts[:2], ""]), "resources/")
            archive.write(temporary.path, lambda name: name.startswith(wanted))
            if archive.repeated:
                names = ", ".join(sorted(archive.repeated)[:3])
                warn_caller(f"{path}: in it more than once, and not unpacked: {names}", FmuWarning)
        except BaseException:
            temporary.remove()
            raise
    finally:
        archive.close()
    return Unpacked(path, temporary.path, temporary.path / library, description, temporary.remove, digest, kind)


def read_description(path: Path, folder: Path, kind: str = MODEL_EXCHANGE) -> Any:
    """The model description of an FMU of FMI 2.0 or 3.0 of a kind, as fmpy reads it."""
    fmpy = fmpy_package()
    try:
        _check_xml((folder / DESCRIPTION_FILE).read_bytes())
        description = fmpy.read_model_description(folder, validate=False)
    except Exception as error:  # fmpy raises whatever its parser meets
        reason = in_words(error)[:200]
        raise ValueError(f"{path}: {DESCRIPTION_FILE} cannot be read: {reason or type(error).__name__}") from error
    if not str(description.fmiVersion).startswith(("2.", "3.")):
        raise ValueError(f"{path}: FMI {description.fmiVersion}; accepted: 2.0, 3.0")
    if getattr(description, INTERFACES[kind]) is None:
        if kind != MODEL_EXCHANGE:
            raise ValueError(f"{path}: no Co-Simulation; accepted: one with it; import_fmu reads Model Exchange")
        tool = " ".join(str(description.generationTool or "its tool").split())[:80]
        why = "its solver is inside, and there is no right-hand side to ask for"
        way = f"one with Model Exchange, as {tool} may export it; import_co_simulation finds orbits of this one"
        raise ValueError(f"{path}: no Model Exchange, Co-Simulation alone: {why}; accepted: {way}")
    return description


class _Counter:
    """Elements of a description as a parser meets them, in any encoding; raises ValueError at the first too many."""

    def __init__(self) -> None:
        self.elements = self.variables = self.states = 0
        self.open: list[str] = []

    def doctype(self, *declaration: object) -> None:
        raise ValueError("refused, it declares entities")

    def start(self, name: str, attributes: Mapping[str, str]) -> None:
        reference = attributes.get("valueReference", "0")
        if not (reference.isdecimal() and len(reference) <= 10 and int(reference) <= LARGEST_REFERENCE):
            raise ValueError(f"refused, value reference {reference[:20]!r}; accepted: 0 to {LARGEST_REFERENCE}")
        self.elements += 1
        self.variables += self.open[1:] == ["ModelVariables"]
        self.states += self.open[1:] == ["ModelStructure", "Derivatives"] or name == "ContinuousStateDerivative"
        self.open.append(name)
        for count, most, what in (
            (self.elements, MOST_ELEMENTS, "elements"), (self.variables, MOST_VARIABLES, "variables"),
            (self.states, MOST_STATES, "states"), (len(self.open), DEEPEST_XML, "elements within each other"),
        ):  # fmt: skip
            if count > most:
                raise ValueError(f"refused, more than {most} {what}")

    def end(self, name: str) -> None:
        self.open.pop()


def _check_xml(text: bytes) -> None:
    """Raises ValueError for XML that is too much for those who read all of it at once."""
    if len(text) > LARGEST_DESCRIPTION:
        raise ValueError(f"refused, {len(text)} bytes; accepted: up to {LARGEST_DESCRIPTION}")
    parser, counter = ParserCreate(), _Counter()
    parser.StartDoctypeDeclHandler = counter.doctype
    parser.StartElementHandler = counter.start
    parser.EndElementHandler = counter.end
    for start in range(0, len(text), CHUNK_BYTES):
        parser.Parse(text[start : start + CHUNK_BYTES])


def _library(path: Path, description: Any, names: tuple[str, ...], kind: str) -> str:
    """Name of the library for this platform in the archive."""
    name = library_name(description.fmiVersion, getattr(description, INTERFACES[kind]).modelIdentifier)
    if name not in names:
        there = {PurePosixPath(n).parts[1] for n in names if n.startswith("binaries/")}
        sources = "sources alone" if any(n.startswith("sources/") for n in names) else "neither binaries nor sources"
        found = f"binaries for {', '.join(sorted(there))}" if there else sources
        raise ValueError(f"{path}: no binary for {PurePosixPath(name).parts[1]}; it has {found}")
    return name


# Variables of which a model is made: states, parameters, inputs and outputs -------------------------------------------


@dataclass(frozen=True)
class FmuChoices:
    """Choices of a script for an FMU, by name: the order of its states, and the variables that get values.

    `starts` are states with the variables that put them in, where these are others.
    """

    states: tuple[str, ...] | None = None
    parameters: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    forcing_period: float | None = None
    starts: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, eq=False)
class Element:
    """One number of fmpy's `variable`: all of a scalar, or the entry of an array at a `place`, row after row."""

    name: str
    variable: Any
    place: int
    start: float

    @property
    def is_input(self) -> bool:
        """Whether it may change at any time; a parameter is the same for an instance until it is initialised."""
        return bool(self.variable.causality == "input")

    @property
    def tunable(self) -> bool:
        """Whether it may be given a value after the initialisation."""
        return self.is_input or bool(self.variable.variability == "tunable")

    @property
    def size(self) -> float:
        """Usual size: the nominal value where there is one that can be."""
        nominal = abs(float(self.variable.nominal or 0.0))
        return nominal if 0.0 < nominal < np.inf else max(1.0, abs(self.start))


@dataclass(frozen=True, eq=False)
class Group:
    """Numbers as FMI's functions take them: whole variables by their references, and the `places` of the numbers.

    `starts` are the start values of all entries of these variables.
    """

    references: NDArray[np.uint32]
    places: NDArray[np.int64]
    starts: Array

    @classmethod
    def of(cls, elements: Iterable[Element]) -> Group:
        """The variables of some numbers, each once."""
        given = list(elements)
        variables = {int(element.variable.valueReference): element.variable for element in given}
        whole = {reference: elements_of(variable) for reference, variable in variables.items()}
        first = dict(zip(whole, itertools.accumulate([0, *map(len, whole.values())]), strict=False))
        places = [first[int(e.variable.valueReference)] + e.place for e in given]
        starts = [element.start for entries in whole.values() for element in entries]
        return cls(np.array(list(whole), np.uint32), np.array(places, np.int64), np.array(starts, float))

    @property
    def named(self) -> tuple[Any, int]:
        """The references as C takes them, and their number."""
        return self.references.ctypes.data_as(ctypes.POINTER(ctypes.c_uint32)), self.references.size

    def spread(self, numbers: Array, others: Array | float = 0.0) -> Array:
        """Rows of numbers as rows of all entries of the variables, with others where there is none."""
        entries = np.zeros((len(numbers), self.starts.size)) + others
        entries[:, self.places] = numbers
        return entries


@dataclass(frozen=True, eq=False)
class Variables:
    """The numbers of an FMU that a model is made of; `description` is fmpy's.

    Raises ValueError for a description that no model can be made of, and for names that it does not have.
    """

    path: Path
    description: Any
    choices: FmuChoices

    def __post_init__(self) -> None:
        _check_description(self.path, self.description)
        _ = self.given
        names = [state.name for state in self.states]
        if self.choices.states is not None:
            _check_order(self.choices.states, names)

    @cached_property
    def states(self) -> tuple[Element, ...]:
        """Continuous states in the FMU's order."""
        return tuple(e for u in self.description.derivatives for e in elements_of(u.variable.derivative))

    @cached_property
    def derivatives(self) -> tuple[Element, ...]:
        """Their derivatives."""
        return tuple(e for u in self.description.derivatives for e in elements_of(u.variable))

    @cached_property
    def indicators(self) -> tuple[str, ...]:
        """Names of the event indicators; FMI 2.0 counts them from 1 alone."""
        named = [e.name for u in self.description.eventIndicators or () for e in elements_of(u.variable)]
        count = int(self.description.numberOfEventIndicators or 0)
        return tuple(named or (str(k) for k in range(1, count + 1)))

    @cached_property
    def outputs(self) -> tuple[Element, ...]:
        """Real outputs that are neither states nor given."""
        taken = {element.name for element in (*self.states, *self.given)}
        variables = [u.variable for u in self.description.outputs if u.variable.type in REAL_TYPES]
        return tuple(e for variable in variables for e in elements_of(variable) if e.name not in taken)

    @cached_property
    def given(self) -> tuple[Element, ...]:
        """Variables that get values: parameters of the model, then inputs that have a value or a signal."""
        variables = [v for v in self.description.modelVariables if v.type in REAL_TYPES]
        found: list[Element] = []
        for label, names, kinds in (
            ("parameters", self.choices.parameters, ("parameter", "input")),
            ("inputs", self.choices.inputs, ("input",)),
        ):
            found += chosen(label, names, [v for v in variables if v.causality in kinds])
        for name in self.choices.inputs:
            if name in self.choices.parameters:
                raise ValueError(f"inputs: given {name!r}, which is among parameters; accepted: one of them")
        return tuple(found)

    @cached_property
    def held(self) -> tuple[Element, ...]:
        """Those of them that stay the same along a solution."""
        return tuple(element for element in self.given if not element.is_input)

    @cached_property
    def order(self) -> list[int]:
        """Places of the states in the requested order."""
        names = [state.name for state in self.states]
        return list(range(len(names))) if self.choices.states is None else [names.index(n) for n in self.choices.states]

    def declared(self, unknowns: Sequence[Element]) -> Pattern:
        """Which unknowns depend on which states as ModelStructure says; on all where it says nothing."""
        listed = {u.variable.name: u for u in (*self.description.derivatives, *self.description.outputs)}
        pattern = np.zeros((len(unknowns), len(self.states)), dtype=bool)
        places: dict[str, list[int]] = {}
        for k, state in enumerate(self.states):
            places.setdefault(state.variable.name, []).append(k)
        for row, element in enumerate(unknowns):
            dependencies = listed[element.variable.name].dependencies
            if dependencies is None:
                pattern[row] = True
            else:
                pattern[row, [k for v in dependencies for k in places.get(v.name, ())]] = True
        return pattern


def elements_of(variable: Any) -> list[Element]:
    """The numbers of one variable; a start value that is missing is 0."""
    shape = tuple(variable.shape or ())
    starts = [float(word) for word in str(variable.start or "").split()]
    count = math.prod(shape)
    starts = starts * count if len(starts) == 1 else starts
    if len(starts) != count:
        starts = [0.0] * count
    if not shape:
        return [Element(variable.name, variable, 0, starts[0])]
    indices = itertools.product(*(range(1, length + 1) for length in shape))
    names = (f"{variable.name}[{','.join(map(str, index))}]" for index in indices)
    return [Element(name, variable, k, starts[k]) for k, name in enumerate(names)]


# Refusals -------------------------------------------------------------------------------------------------------------


def chosen(label: str, names: Sequence[str], variables: Sequence[Any]) -> list[Element]:
    """The numbers of these names; raises ValueError for one that is not there, with the nearest."""
    known: Mapping[str, Element] = {e.name: e for v in variables for e in elements_of(v)}
    arrays = {v.name for v in variables if v.shape}
    for name in names:
        if name in arrays:
            entries = [other for other in known if other.startswith(f"{name}[")]
            raise ValueError(f"{label}: {name!r} is an array; accepted: its entries, such as {entries[0]}")
        if name not in known:
            raise ValueError(f"{label}: given {name!r}; accepted: {nearest_first(name, list(known))}")
    if len(set(names)) < len(names):
        raise ValueError(f"{label}: given {', '.join(names)}; accepted: each one once")
    return [known[name] for name in names]


def _check_description(path: Path, description: Any) -> None:
    """Raises ValueError for a model without states or with too many."""
    strange = [entry.variable.name for entry in description.derivatives if entry.variable.derivative is None]
    if strange:
        raise ValueError(f"{path}: {strange[0]} is listed as a derivative, but of no state; accepted: derivatives")
    if not description.derivatives:
        raise ValueError(f"{path}: no continuous states; accepted: a model with some")
    for variable in description.modelVariables:
        check_numbers(path, variable)
    entries = sum(math.prod(v.shape or ()) for v in description.modelVariables if v.type in REAL_TYPES)
    if entries > MOST_VARIABLES:
        raise ValueError(f"{path}: {entries} real numbers; accepted: up to {MOST_VARIABLES}")
    states = sum(math.prod(entry.variable.derivative.shape or ()) for entry in description.derivatives)
    if not 0 < states <= MOST_STATES:
        raise ValueError(f"{path}: {states} states; accepted: 1 to {MOST_STATES}")
    for entry in description.derivatives:
        if entry.variable.shape != entry.variable.derivative.shape:
            raise ValueError(f"{path}: {entry.variable.name} and its state have other sizes; accepted: the same")


def check_numbers(path: Path, variable: Any) -> None:
    """Raises ValueError where the start or the nominal value of a real variable is no number, or it has too many."""
    if variable.type not in REAL_TYPES:
        return
    count = math.prod(variable.shape or ())
    if not 0 <= count <= MOST_VARIABLES:
        raise ValueError(f"{path}: {variable.name} has {count} entries; accepted: 0 to {MOST_VARIABLES}")
    for label, text in (("start", variable.start), ("nominal", variable.nominal)):
        try:
            words = [float(word) for word in str(text or "0").split()]
        except ValueError:
            words = []
        if not words or (label == "start" and len(words) not in (1, count)):
            given = f"{label} value {short_repr(text)} of {variable.name}"
            accepted = "a number" if count == 1 else f"{count} numbers"
            raise ValueError(f"{path}: {given}; accepted: {accepted}")


def _check_order(given: Sequence[str], names: Sequence[str]) -> None:
    for name in given:
        if name not in names:
            raise ValueError(f"states: given {name!r}; accepted: {nearest_first(name, names)}")
    missing = [name for name in names if name not in given]
    if missing or len(set(given)) < len(given):
        words = ", ".join(missing or sorted({name for name in given if list(given).count(name) > 1}))
        raise ValueError(f"states: {'left out' if missing else 'twice'}: {words}; accepted: each of the FMU's once")


def nearest_first(name: str, names: Sequence[str], none: str = "none, the FMU has no such variables") -> str:
    """The names that there are, the nearest first, few of many; words where there are none."""
    near = nearest(name, names)
    listed = sorted(names, key=lambda other: other != near)
    more = f" and {len(listed) - MOST_LISTED} more" if listed[MOST_LISTED:] else ""
    return ", ".join(listed[:MOST_LISTED]) + more or none
