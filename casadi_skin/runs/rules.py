"""Faults of a scene, each one line with the place, the given and the accepted; and the rules that tie its keys.

Bounds of single keys are in the tables (see scene.py). A rule is a condition, and the message where it holds; the first
one that holds is reported.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from casadi_skin.lattice.stiffness import square_of_family
from casadi_skin.model.arguments import LONGEST_VALUE_TEXT, check_name, check_places, cut, did_you_mean
from casadi_skin.model.methods import COLLOCATION_TABLES, FULL_PERIOD_FLOWS
from casadi_skin.runs.output import InputError
from casadi_skin.runs.scene import ACCEPTED_AXES, AMPLITUDE, SELECTED, TABLES, MethodTable, Scene, one_of

LONGEST_LIST = 400  # characters of a message on several names


class SceneError(InputError):
    """A scene that cannot be used: one line with file, table and key, the given and the accepted values."""

    def __init__(self, message: str) -> None:
        # Names and values come from a file and may hold any character: escaped, the message stays one line.
        super().__init__("".join(char if char.isprintable() else ascii(char)[1:-1] for char in message))


def refusal(place: str, given: str, accepted: str) -> SceneError:
    return SceneError(f"{place}: given {given}; accepted: {accepted}")


@contextmanager
def faults_at(place: str | Callable[[str], str]) -> Iterator[None]:
    """A SceneError with a place in front in place of an error of the block about an argument or a missing extra."""
    try:
        yield
    except SceneError:
        raise
    except (ValueError, TypeError, ImportError) as error:
        raise SceneError(f"{place}{error}" if isinstance(place, str) else place(str(error))) from None


@contextmanager
def in_file(path: str | Path) -> Iterator[None]:
    """A SceneError of the block with the file of the scene in front."""
    try:
        yield
    except SceneError as fault:
        raise SceneError(f"{path}: {fault}") from None


def placed(message: str, table: str = "family") -> str:
    """A message about an argument of a family, with the table that it is in; one about the model with `table`."""
    argument, _, words = message.partition(": ")
    if argument in ("model", "lattice"):
        return f"[{table}]: {words}"
    if argument == "stability_sites":
        return f"[stability] sites: {words}"
    homes = ("family", "method", "accuracy", "chain", "model")
    home = next((name for name in homes if argument in TABLES[name].__struct_encode_fields__), "")
    return f"[{home}] {message}" if home else f"[{table}]: {message}"


class Unknown(NamedTuple):
    """A table or key that no scene has: its place, the nearest known name and all that are accepted there."""

    fault: str
    near: str | None
    accepted: str


def check_unknown(found: Iterable[Unknown]) -> None:
    """Raises SceneError for unknown names: one with all that is accepted, several with the nearest names alone."""
    names = list(found)
    if len(names) == 1:
        raise SceneError(f"{names[0].fault}; {did_you_mean(names[0].near, names[0].accepted)}")
    shown, words = 0, ""
    for name in names:
        more = f"{'; ' if words else ''}{name.fault}{f', did you mean {name.near}?' if name.near else ''}"
        if len(words) + len(more) > LONGEST_LIST:
            break
        shown, words = shown + 1, words + more
    if names:
        raise SceneError(words + (f"; and {len(names) - shown} more" if shown < len(names) else ""))


def check_known(place: str, name: str, known: Iterable[str]) -> None:
    """Raises SceneError, with the nearest known name, for an unknown one."""
    with faults_at(""):
        check_name(place, name, known)


def is_table(value: object) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and value != [] and isinstance(value[0], dict))


def toml_repr(value: object, depth: int = 3) -> str:
    """A value as TOML would write it, cut where it is long, nested or huge."""
    if isinstance(value, str):
        return cut(json.dumps(value[:LONGEST_VALUE_TEXT], ensure_ascii=False))
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):  # beyond some hundred digits Python may refuse to write decimals, never hex
        return cut(str(value) if value.bit_length() < 2000 else hex(value))
    if isinstance(value, list | tuple):
        items = [toml_repr(item, depth - 1) for item in value[:LONGEST_VALUE_TEXT]] if depth else ["..."]
        return cut(f"[{', '.join(items)}]")
    return "a table" if isinstance(value, dict) else str(value)


def inline(table: Mapping[str, object]) -> str:
    """A table as TOML would write it in one line, cut where it is long."""
    return cut(f"{{{', '.join(f'{cut(key)} = {toml_repr(value)}' for key, value in table.items())}}}")


def with_kind(value: object) -> str:
    """A value with the name of its TOML type, for where the type is the fault."""
    if is_table(value):
        return "a table" if isinstance(value, dict) else "an array of tables"
    kinds = {bool: "a boolean", int: "a whole number", float: "a float", str: "a string", list: "an array"}
    return f"{toml_repr(value)} ({kinds.get(type(value), 'a date or time')})"


# The rules: the place of a fault, what is given there, and what is accepted -------------------------------------------

LONGEST_ENVELOPE = 700.0  # the same as in dynamics, which loads numerics
KICKS = ("site", "vector", "seed")  # keys of [dynamics], one of which a perturbation has
STARTS = ("mode", *KICKS)  # of which a motion from rest has one
MAPPED_TASKS = ("family", "equilibrium", "orbit", "solution", "design")  # the tasks of cells of maps
MISSING = "missing"
WITH_SELECT = "beside [orbit] with select, which picks orbits of a family"
BESIDE_SOLUTION = "beside [equilibrium], [orbit] or [solution]"

# (place, fault, accepted), or a whole message. A fault is false, true for the value of the key, the words on what is
# given (after a space: the value, then these), or MISSING. Other faults of a key are asked only where it has a value.
Rules = Iterator[tuple[str, object, str] | str]


class Absent:
    """A table that a scene does not have: false, and none of its keys is given."""

    def __bool__(self) -> bool:
        return False

    def __getattr__(self, name: str) -> None:
        return None


class Seen:
    """A scene as rules see it: its tables by name, those that it lacks as `Absent`."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.sites = scene, scene.sites
        self.modes: tuple[Any, ...] = scene.modes()
        self.transcription = scene.methods.transcription
        self.sought = scene.given("family", "equilibrium", "orbit", "solution")
        self.collocated = bool(scene.orbit or scene.solution)
        self.at_rest = scene.family is None and scene.orbit is None  # where [dynamics] starts
        tables = {name: getattr(scene, name) or Absent() for name in Scene.__struct_fields__}
        vars(self).update(tables, curve=tables["continuation"].curve or Absent())

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)

    def given(self, table: str, *keys: str) -> list[str]:
        """Which of these keys a table has."""
        return [key for key in keys if getattr(getattr(self, table), key) is not None]

    @property
    def is_exceptional(self) -> bool:
        """Whether the chain is at |gamma| = 1."""
        return bool(self.chain) and abs(self.chain.gamma) == 1


def check_scene(scene: Scene) -> None:
    """Raises SceneError for the first key that does not go with another one."""
    for rules in (
        _of_how,
        _of_what,
        _of_branches,
        _of_families,
        _of_lengths,
        _of_dynamics,
        _of_design,
        _of_export,
        _of_map,
    ):
        check_rules(scene, rules(Seen(scene)))


def check_rules(scene: Scene, rules: Rules) -> None:
    """Raises SceneError for the first rule that does not hold."""
    for rule in rules:
        message = rule if isinstance(rule, str) else _message(scene, *rule)
        if message:
            raise SceneError(message)


def _message(scene: Scene, place: str, fault: object, accepted: str) -> str:
    """The message of a rule; empty where it holds, or its key is not given."""
    table, _, key = place.partition(" ")
    value = getattr(getattr(scene, table), key, None) if key else True
    lacking = value is None or value is False or value == ()
    if not fault or lacking is not (fault is MISSING):
        return ""
    words = toml_repr(value) if fault is True or str(fault).startswith(" ") else ""
    given = MISSING if fault is MISSING else f"given {words}{'' if fault is True else fault}"
    return f"[{table}]{' ' if key else ''}{key}: {given}; accepted: {accepted}"


def _again(values: Sequence[Any]) -> str:
    """The first item that was there before, with its number from 1, in words; empty where there is none."""
    found = (f"{toml_repr(v)} as item {i} again" for i, v in enumerate(values, start=1) if v in values[: i - 1])
    return next(found, "")


def _of_how(s: Seen) -> Rules:
    """Rules of [accuracy], [model] and [method]."""
    a, m, file = s.accuracy, s.method, s.model.file or ""
    both = a.preset and a.tolerance and f"preset = {toml_repr(a.preset)} and tolerance = {a.tolerance!r}"
    yield "accuracy", both, "preset or tolerance, one of them or neither"
    yield "accuracy certify", not s.family, "with a [family], else false"
    if s.model:
        yield "model file", "\0" in file, "the name of a file"
        yield "model name", file.endswith(".json") and f' with file = "{file}"', "none: the file holds one model"
        yield "model file", not file.endswith((".json", ".py")), "a name that ends in .py or .json"
        yield "model name", file.endswith(".py") and MISSING, "with a Python file the name of the model in it"
    if s.collocated:
        yield "method tail", True, "beside [family]"
        yield "method walker", True, "beside [family]"
        for key, known in (("transcription", COLLOCATION_TABLES), ("flow", FULL_PERIOD_FLOWS)):
            yield f"method {key}", getattr(m, key) not in known and " without [family]", one_of(known)


def _of_what(s: Seen) -> Rules:
    """Rules on what is sought, and on [stability]."""
    if len(s.sought) > 1:
        one, other, *_ = s.sought
        yield other, f"beside [{one}]", f"[{one}] or [{other}] in one scene"
    if s.solution:
        beside, file = f"beside [{'lattice' if s.lattice else 'chain'}]", str(s.model.file)
        yield "solution", not s.model and beside, "beside [model], whose file states a boundary-value problem"
        accepted = "with a Python file: a saved model is no boundary-value problem"
        yield "solution", file.endswith(".json") and f'with file = "{file}"', accepted
    if s.stability:
        table = s.continuation
        cycles = table and ("hopf" in table.switch or (not table.switch and table.depth))
        others = 'beside a [family], an [orbit] or a [solution], or with "hopf" in [continuation] switch'
        without = not (s.family or s.collocated or cycles) and "without [family], [orbit] or [solution]"
        yield "stability", without, f"{others}, whose stability it asks for"
        yield "stability gradient", not s.family and " without [family]", "beside a [family]"
        located = s.stability.events or s.sites == math.inf  # whose threshold maps have
        yield "stability gradient", not located and " without events", "with events = true"
        yield "stability sites", not s.family and " without [family]", "beside a [family] of a chain"
    if s.continuation:
        accepted = "beside a [family], an [equilibrium], an [orbit] or a [solution], from which it follows"
        yield "continuation", not s.sought and "without [family], [equilibrium], [orbit] or [solution]", accepted
    if s.equilibrium:
        yield "method", s.method != MethodTable() and "beside [equilibrium]", "beside [family], [orbit] or [solution]"
    if s.orbit:
        orbit, symmetric = s.orbit, s.orbit.symmetric and "with symmetric = true"
        if s.chain and not orbit.symmetric:
            yield "[orbit] symmetric: given false with [chain]; accepted: true: the orbits of a chain come in families"
        yield "orbit", orbit.period and orbit.transient and "period and transient", "period or transient, one of them"
        yield "orbit section", symmetric, "without: the symmetry fixes the phase"
        yield "orbit transient", symmetric, "period (the orbit starts where the symmetry has its phase zero)"


def _of_branches(s: Seen) -> Rules:
    """Rules of [continuation]."""
    table, curve = s.continuation, s.curve
    if not table:
        return
    yield "continuation at", _again(table.at), "each number once"
    if s.family:
        yield "continuation parameter", table.parameter != AMPLITUDE, '"S" beside [family]'
        alone = not table.switch and not curve and "beside [family] without switch or curve"
        yield "continuation", alone, "with one of them, or both"
        for name in ("at", "back_to", "fixed", "period_max", "depth", "monitors"):
            yield f"continuation {name}", "beside [family]", BESIDE_SOLUTION
        unknown_changes = not s.stability.events and "beside [family] without [stability] events"
        yield "continuation", unknown_changes, "with [stability], events = true"
        yield "continuation to", not table.to > 0.0, "a number > 0, which is S, beside [family]"
    picks = s.orbit and s.orbit.select
    yield "continuation fixed", table.fixed and not s.family and not picks and toml_repr(table.fixed), WITH_SELECT
    other = "beside [equilibrium]" if s.equilibrium else "beside [solution]" if s.solution else ""
    yield "continuation period_max", table.period_max and other, "beside [orbit]"
    if not s.equilibrium and not s.orbit:
        beside = f'"hopf" beside [{"family" if s.family else "solution"}]'
        yield "continuation switch", "hopf" in table.switch and beside, '"branch point" and "period doubling"'
    if not s.stability:
        deep = table.depth and not table.switch and s.orbit
        yield "continuation depth", deep and " beside [orbit] without [stability]", "with [stability]"
    needed = {"period doubling"} | ({"branch point"} if s.orbit else set())  # kinds that multipliers decide
    kind = next((toml_repr(kind) for kind in table.switch if kind in needed), "")
    yield "continuation switch", kind and not s.stability and f"{kind} without [stability]", "with [stability]"
    if s.equilibrium and "hopf" not in table.switch:
        accepted = 'beside "hopf", whose cycles have period doublings'
        yield "continuation switch", kind and f"{kind} beside [equilibrium]", accepted
    yield "continuation curve", curve.further and not s.family and "further = true without [family]", "beside [family]"
    yield "continuation switch", _again(table.switch), "each kind once"
    again = curve.parameter == table.parameter and f"parameter = {toml_repr(table.parameter)} again"
    yield "continuation curve", again, "another parameter"
    selected = table.parameter == SELECTED and bool(s.solution)
    yield "continuation parameter", selected, "with [orbit] select, whose value it moves"


def _of_families(s: Seen) -> Rules:
    """Rules of [family]: modes each once; of a chain also those of its modes and places.

    What is asked of a model, and its modes by name, as "last", is known with the model alone.
    """
    family, chain = s.family, s.chain
    if not family:
        return
    there = "whole numbers from 1" if s.sites is None else f"whole numbers from 1 to {s.sites} (sites)"
    for place, mode in enumerate(s.modes):
        if s.sites == math.inf:
            shown = {-1: '"last"', 1: '"first"'}.get(mode, toml_repr(mode))
            end = "last" if chain.g > 0 else "first"
            accepted = f'"{end}" (of an infinite chain, with g = {chain.g:g})'
            yield "family mode", mode != (-1 if chain.g > 0 else 1) and shown, accepted
        elif isinstance(mode, int) and (mode < 1 or (s.sites is not None and mode > s.sites)):
            yield "family mode", toml_repr(mode), f"{there}, first, last"
        yield "family mode", mode in s.modes[:place] and f"{mode} more than once", "each mode once"
    yield "family series", s.sites == math.inf and " with sites = inf", "with finitely many sites"
    accepted = "false (the vectors form Jordan chains that the gauge does not have)"
    yield "stability vectors", s.is_exceptional and f" with gamma = {chain.gamma!r}", accepted
    with faults_at(placed):
        for mode in s.modes if chain else ():
            square = square_of_family(chain.sites, chain.alpha, chain.gamma, chain.g, mode)
            check_places(family, family.amplitude_max, 2.0 * math.pi / math.sqrt(square), mode)


def _of_lengths(s: Seen) -> Rules:
    """Rules of infinite chains, and of lattices with a linear tail."""
    names, longer = ["spectrum", "dynamics", "orbit"], ["equilibrium", "continuation", "design", "export"]
    if s.sites == math.inf:
        for name in s.scene.given(*names):
            yield name, "with sites = inf", "with a whole number of sites: all of them take part in it"
        yield "stability vectors", " with sites = inf", "false: all sites take part in them"
    if s.lattice and s.lattice.long:
        for name in s.scene.given(*names, *longer):
            yield name, "with a linear tail (edge, or more than 100000 cells)", "with all sites unknown"
        yield "stability vectors", " with a linear tail", "false: all sites take part in them"


def _of_dynamics(s: Seen) -> Rules:
    """Rules of [dynamics]."""
    table, chain, kicks, starts = s.dynamics, s.chain, s.given("dynamics", *KICKS), s.given("dynamics", *STARTS)
    if not table:
        return
    if s.at_rest:
        for name in s.scene.given("equilibrium", "solution", "design")[:1]:
            yield "dynamics", f"beside [{name}]", "beside [family] or [orbit], or with a start of its own"
        words = " and ".join(starts) or f"none of {', '.join(STARTS)}"
        accepted = f"one of {', '.join(STARTS)}, with size and duration, from which motion starts"
        yield "dynamics", len(starts) != 1 and f"without [family] and [orbit], with {words}", accepted
        for name in ("S", "periods"):
            yield f"dynamics {name}", True, "beside a [family] or an [orbit]"
        for name in ("size", "duration"):
            yield f"dynamics {name}", MISSING, f"beside {starts[0]} a finite number > 0"
        still = s.is_exceptional and f"with gamma = {chain.gamma!r} and without [family]"
        yield "dynamics", still, "|gamma| < 1: sites off the edge have no image in the gauge"
    else:
        yield "dynamics moving", True, "without [family] and [orbit], which start at phase zero"
        for name in ("S", "mode"):
            yield f"dynamics {name}", not s.family, "beside a [family]"
    yield "dynamics S", s.family and MISSING, "a finite number > 0, up to amplitude_max"
    yield from _orbit_of_family(s, "dynamics")
    ends = [name for name in ("duration", "periods") if getattr(table, name) is not None]
    counted = {0: "neither duration nor periods", 2: "duration and periods"}.get(len(ends))
    yield "dynamics", counted, "duration or periods, one of them"
    yield "dynamics size", kicks and MISSING, f"beside {kicks[0] if kicks else ''} a finite number > 0"
    yield "dynamics size", not s.at_rest and not kicks, "beside one of site, vector, seed"
    if not chain:
        return
    sites = chain.sites
    far = abs(chain.gamma) < 1 and (sites - 1) * math.atanh(abs(chain.gamma)) > LONGEST_ENVELOPE
    words = f"with sites = {sites} and gamma = {chain.gamma!r}, whose far end is below the smallest double"
    yield "dynamics", far and words, f"(sites - 1) artanh|gamma| <= {LONGEST_ENVELOPE:g}"
    if s.is_exceptional and kicks:
        edge = sites if chain.gamma > 0 else 1
        moved = {i % sites + 1 for i, value in enumerate(table.vector or ()) if value} or {
            table.site if sites > 1 else edge
        }
        accepted = f"site {edge} alone (at |gamma| = 1 displacements off the edge have no image in the gauge)"
        yield f"dynamics {kicks[0]}", moved != {edge} and f"with gamma = {chain.gamma!r}", accepted


def _orbit_of_family(s: Seen, name: str) -> Rules:
    """Rules on the orbit at S of the family of a mode, which has to be named where there are several."""
    table = getattr(s, name)
    if not (s.family and table.S):
        return
    modes = f"one of the modes of [family], {toml_repr(s.modes)}"
    yield f"{name} mode", len(s.modes) > 1 and MISSING, modes
    yield f"{name} mode", table.mode not in s.modes and str not in map(type, s.modes), modes
    most = s.family.amplitude_max
    yield f"{name} S", most < table.S, f"a number <= amplitude_max = {most!r}"


def _of_design(s: Seen) -> Rules:
    """Rules of [design]; its names and bounds are known with the model."""
    design = s.design
    if not design:
        return
    for name in s.scene.given("family", "solution"):
        yield "design", f"beside [{name}]", f"[design] or [{name}] in one scene"
    yield "design", s.sites == math.inf and "with sites = inf", "with a whole number of sites"
    beside = s.equilibrium or s.orbit
    yield "design of", not s.continuation, "beside [continuation], on whose branch the points are"
    yield "design of", s.continuation and MISSING, "the kinds of special points of [continuation]"
    yield "design", beside and not s.continuation and "without [continuation]", "beside it special points of its branch"
    for name in ("mode", "S"):
        where = " beside [equilibrium] or [orbit]"
        yield f"design {name}", beside and where, "without them, of a family"
    for item, held in enumerate(design.subject_to, start=1):
        place = f"[design] subject_to, item {item}"
        if (held.equal is None) == (held.lower is None and held.upper is None):
            given = "equal beside a bound" if held.equal is not None else "neither equal nor a bound"
            yield f"{place}: given {given}; accepted: equal, or lower and upper or one of these"


def _of_export(s: Seen) -> Rules:
    """Rules of [export] and [figures]."""
    yield "figures formats", _again(s.figures.formats), "each format once"
    table = s.export
    if not table:
        return
    yield "export", s.sites == math.inf and "with sites = inf", "with a whole number of sites"
    yield "export", not (table.c or table.fmu) and "neither c nor fmu", "one of them, or both"
    yield "export inputs", table.fmu is None, "beside fmu"
    parts = table.c or () if table.c != "all" else ()
    gauge = ("flow", "residual", "newton", "ipopt")
    part = s.is_exceptional and next((toml_repr(part) for part in parts if part in gauge), "")
    accepted = "rhs, jacobian, variational, orbit (the gauge holds the edge site alone)"
    yield "export c", part and f"{part} with gamma = {s.chain.gamma!r}", accepted
    yield "export mode", table.S is None, "beside S, the orbit of that mode's family"
    without = table.S is None and not s.orbit and "orbit" in parts
    yield "export c", without and '"orbit" without S', "with S, that of the orbit"
    yield "export S", not s.family, "beside a [family], one of whose orbits it names"
    yield from _orbit_of_family(s, "export")


def _of_map(s: Seen) -> Rules:
    """Rules of [map]; where its axes lead is known with the model."""
    table = s.map
    if not table:
        return
    tasks = "beside [family], [equilibrium], [orbit], [solution] or [design]"
    yield "map", not s.scene.given(*MAPPED_TASKS) and "with a scene that asks for no solution", tasks
    yield "map", s.design and s.design.of and "beside a [design] of special points", "beside one of a family"
    if not table.axes:
        yield f"[map]: no axis; accepted: a parameter of the scene with {ACCEPTED_AXES}"
    yield "map growth", table.growth and not s.stability and " without [stability]", "beside [stability]"
    accepted = "with a whole number of sites: an infinite chain has no tongues to be followed"
    for name in ("growth", "boundary"):
        yield f"map {name}", getattr(table, name) and s.sites == math.inf and "with sites = inf", accepted
    ranges = {name for name, axis in table.axes.items() if not isinstance(axis, tuple)}
    yield "map boundary", len(ranges) != 2 and "without two ranges", "beside two ranges"
    if s.family:
        accepted = "beside [family] a range of S, and [stability] with its events"
        known = s.stability.events and ranges & {"S", "family.S"}
        yield "map boundary", not known and "without S or [stability]", accepted
        moved = {part.strip() for name in table.axes for part in name.split(",")}
        several = len(s.modes) > 1 and not moved & {"mode", "family.mode"}
        yield "map boundary", several and "with several families in a cell", "one, or an axis mode"
    else:
        others = s.continuation or s.solution or s.design
        accepted = "with [family], or with [equilibrium] or [orbit] alone"
        yield "map boundary", others and "with a scene of other branches", accepted
        yield "map boundary", s.orbit and not s.stability and "without [stability]", "beside [orbit] with a [stability]"
