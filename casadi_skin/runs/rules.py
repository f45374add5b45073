"""Faults of a scene, each one line with the place, the given and the accepted; and the rules that tie its keys.

Bounds of single keys are in the tables (see scene.py). A rule is a condition, and the message where it holds; the first
one that holds is reported.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from string import Formatter
from typing import Any, NamedTuple

from casadi_skin.lattice.stiffness import stiffness
from casadi_skin.model.arguments import LONGEST_VALUE_TEXT, cut, nearest
from casadi_skin.model.methods import COLLOCATION_TABLES, FLOWS, FULL_PERIOD_FLOWS, SHOOTING, TRIGONOMETRIC
from casadi_skin.optimise.names import FREE, NAMED
from casadi_skin.runs.output import InputError
from casadi_skin.runs.scene import AMPLITUDE, SELECTED, MethodTable, Scene, one_of

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


def did_you_mean(near: str | None, accepted: str) -> str:
    return f"; did you mean {near}? (accepted: {accepted})" if near else f"; accepted: {accepted}"


class Unknown(NamedTuple):
    """A table or key that no scene has: its place, the nearest known name and all that are accepted there."""

    fault: str
    near: str | None
    accepted: str


def check_unknown(found: Iterable[Unknown]) -> None:
    """Raises SceneError for unknown names: one with all that is accepted, several with the nearest names alone."""
    names = list(found)
    if len(names) == 1:
        raise SceneError(names[0].fault + did_you_mean(names[0].near, names[0].accepted))
    shown, words = 0, ""
    for name in names:
        more = f"{'; ' if words else ''}{name.fault}{f', did you mean {name.near}?' if name.near else ''}"
        if len(words) + len(more) > LONGEST_LIST:
            break
        shown, words = shown + 1, words + more
    if names:
        raise SceneError(words + (f"; and {len(names) - shown} more" if shown < len(names) else ""))


def unknown(place: str, name: str, known: Iterable[str]) -> str:
    """The message on a name that is not known, with the nearest one that is; empty for one that is."""
    names = tuple(known)
    if name in names:
        return ""
    near = nearest(name, names)
    return f"{place}: given {toml_repr(name)}{did_you_mean(near and toml_repr(near), ', '.join(names) or 'none')}"


def check_known(place: str, name: str, known: Iterable[str]) -> None:
    """Raises SceneError, with the nearest known name, for an unknown one."""
    if words := unknown(place, name, known):
        raise SceneError(words)


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
    if isinstance(value, list):
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


# The rules: a condition on a scene, and the message where it holds ----------------------------------------------------

NEAREST_END_RTOL = 1e-12  # relative, of the end of a family to its start
NARROWEST_BAND = 1e-10  # the same as in lattice.chain_coordinates, which loads numerics
LONGEST_ENVELOPE = 700.0  # the same as in dynamics, which loads numerics
LOWEST_DEGREE = 2  # of families; the same as in zero.request, which loads numerics
KICKS = ("site", "vector", "seed")  # keys of [dynamics], one of which a perturbation has
STARTS = ("mode", *KICKS)  # of which a motion from rest has one
ITEM = "{value!t} as item {item}"  # of a list
BESIDE_SOLUTION = "beside [equilibrium], [orbit] or [solution]"


class Words(Formatter):
    """Messages with values of the scene: {continuation.to!r}, and as TOML has it {model.name!t}."""

    def convert_field(self, value: Any, conversion: Any) -> Any:
        """A value in a message."""
        if conversion != "t":
            return super().convert_field(value, conversion)
        return toml_repr(list(value) if isinstance(value, tuple) else value)


class Absent:
    """A table that a scene does not have: false, and none of its keys is given."""

    def __bool__(self) -> bool:
        return False

    def __getattr__(self, name: str) -> None:
        return None


class Seen:
    """A scene as rules see it: its tables by name, those that it lacks as `Absent`."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.sites, self.modes = scene, scene.sites, scene.modes()
        self.transcription = scene.methods.transcription
        self.sought = scene.given("family", "equilibrium", "orbit", "solution")
        self.at_rest = scene.family is None and scene.orbit is None  # where [dynamics] starts
        self.least_Omega = 0.0 if scene.family is None else 2 * math.pi / (scene.family.period_max or math.inf)
        tables = {name: getattr(scene, name) or Absent() for name in Scene.__struct_fields__}
        vars(self).update(tables, curve=tables["continuation"].curve or Absent())

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)

    def given(self, table: str, *keys: str) -> list[str]:
        """Which of these keys a table has."""
        return [key for key in keys if getattr(getattr(self, table), key) is not None]


Found = object  # what a condition finds: true, or values for the message by name
Rule = tuple[str, Callable[[Seen], Found], str, str | None] | Callable[[Seen], Iterable[str]]


def rule(place: str, wrong: Callable[[Seen], Found], accepted: str, given: str | None = "{value!t}") -> Rule:
    """A rule on a table, or on a key of it where that is given, or where `given` is None missing.

    Arguments:
        place: the table, and the key after a space.
        wrong: the condition; a dictionary that it returns has values for the message.
        accepted: the end of the message.
        given: its beginning; words that begin with a space follow the value.
    """
    return place, wrong, accepted, f"{{value!t}}{given}" if given is not None and given.startswith(" ") else given


def check_scene(scene: Scene) -> None:
    """Raises SceneError for the first key that does not go with another one."""
    seen = Seen(scene)
    for table, rules in RULES:
        for each in rules if getattr(seen, table) else ():
            message = next(iter(_faults(each, seen)), "")
            if message:
                raise SceneError(message)


def _faults(each: Rule, seen: Seen) -> Iterator[str]:
    """The messages of a rule on a scene."""
    if not isinstance(each, tuple):
        yield from filter(None, each(seen) or ())
        return
    place, wrong, accepted, given = each
    table, _, key = place.partition(" ")
    value = getattr(getattr(seen, table), key) if key and "{" not in key else seen
    lacking = value is None or value is False or value == ()
    if lacking is not (given is None):
        return
    found = wrong(seen)
    if found:
        message = f"[{table}]{' ' if key else ''}{key}: {'missing' if given is None else f'given {given}'}"
        values = {**vars(seen), "value": value, **(found if isinstance(found, dict) else {})}
        yield Words().vformat(f"{message}; accepted: {accepted}", (), values)


def first(values: Sequence[Any], wrong: Callable[[int, Any], bool]) -> dict[str, Any] | None:
    """The first item that is wrong, its number from 1, and the item before it; None where there is none."""
    pairs = enumerate(zip(values, (None, *values), strict=False), start=1)
    found = ({"item": item, "value": value, "before": before} for item, (value, before) in pairs if wrong(item, value))
    return next(found, None)


def once(place: str, accepted: str = "each number once") -> Rule:
    """The rule that a list has each of its items once."""

    def again(seen: Seen) -> Found:
        table, _, key = place.partition(" ")
        values = getattr(getattr(seen, table), key)
        return first(values, lambda item, value: value in values[: item - 1])

    return rule(place, again, accepted, f"{ITEM} again")


def _oscillates(s: Seen) -> Iterator[str]:
    """Faults of the modes of a chain: those that do not move, and the period where they start.

    A mode has omega_j^2 = 2 + alpha - 2 s cos(j pi/(N+1)), where s^2 = 1 - gamma^2.
    """
    chain, family = s.chain, s.family
    for mode in family.modes(chain.sites) if chain else ():
        only = chain.sites if chain.g > 0 else 1
        if abs(chain.gamma) == 1 and mode != only:
            reason = "at |gamma| = 1 all frequencies meet and only mode N (g > 0) or mode 1 (g < 0), in which the edge"
            given = f"mode {mode} with gamma = {chain.gamma!r}"
            yield f"[family] mode: given {given}; accepted: mode {only} ({reason} site alone moves, can be followed)"
        own = stiffness(chain.sites, chain.gamma, mode)
        square = chain.alpha + own
        if square <= 0:
            given = f"mode {mode}, which has omega^2 = {square:.6g} at alpha = {chain.alpha!r}"
            accepted = f"modes with omega^2 > 0; for mode {mode}: alpha > {-own:.12g}"
            yield f"[family] mode: given {given}; accepted: {accepted}"
            continue
        coupling = math.sqrt((1 - chain.gamma) * (1 + chain.gamma))
        if chain.sites > 1 and 0 < 4 * coupling < NARROWEST_BAND * square:
            largest = f"with a [family] up to {4 * coupling / NARROWEST_BAND:.3g}"
            reason = "beside a larger one the modes of the band are the same in doubles"
            yield f"[chain] alpha: given {chain.alpha!r}; accepted: {largest} ({reason})"
        linear = 2 * math.pi / math.sqrt(square)
        if family.period_max is not None and family.period_max <= linear * (1 + NEAREST_END_RTOL):
            accepted = f"a finite number > {linear:.12g} (the period of linear mode {mode})"
            yield f"[family] period_max: given {family.period_max!r}; accepted: {accepted}"


def _modes(s: Seen) -> Iterator[str]:
    """Faults of the modes of [family]: each once; those of a chain are known to be there."""
    there = "whole numbers from 1" if s.sites is None else f"whole numbers from 1 to {s.sites} (sites)"
    for place, mode in enumerate(s.modes):
        if s.sites == math.inf and mode != (-1 if s.chain.g > 0 else 1):
            named = '"last"' if mode == -1 else '"first"' if mode == 1 else toml_repr(mode)
            only = f'"{"last" if s.chain.g > 0 else "first"}" (of an infinite chain, with g = {s.chain.g:g})'
            yield f"[family] mode: given {named}; accepted: {only}"
        outside = isinstance(mode, int) and (mode < 1 or (s.sites is not None and mode > s.sites))
        if outside and s.sites != math.inf:
            yield f"[family] mode: given {toml_repr(mode)}; accepted: {there}, first, last"
        if mode in s.modes[:place]:
            yield f"[family] mode: given {mode} more than once; accepted: each mode once"


def _search(s: Seen) -> Iterator[str]:
    """Faults of the names and bounds of the [search] of a chain."""
    search = s.search
    yield unknown("[search] objective", search.objective, NAMED)
    yield from (unknown("[search] free", name, FREE) for name in search.free)
    for name, (lower, upper) in search.bounds.items():
        yield unknown("[search] bounds", name, {**FREE, **NAMED})
        if not lower <= upper:
            given = toml_repr([lower, upper])
            yield f"[search] bounds {name}: given {given}; accepted: a list [lower, upper] with lower <= upper"
    for item, held in enumerate(search.constraints, start=1):
        place = f"[search] constraints, item {item}"
        yield unknown(place, held.quantity, NAMED)
        if (held.equal is None) == (held.lower is None and held.upper is None):
            given = "equal beside a bound" if held.equal is not None else "neither equal nor a bound"
            yield f"{place}: given {given}; accepted: equal, or lower and upper or one of these"


def _orbit_of_family(name: str) -> tuple[Rule, ...]:
    """Rules on the orbit at S of the family of a mode, which has to be named where there are several.

    Whether a model has a mode by the number of one that is named, as "last", shows with the model alone.
    """
    modes, place = "one of the modes of [family], {modes!t}", f"{name} mode"

    def asked(s: Seen) -> Any:
        return s.family and getattr(s, name).S

    return (
        rule(place, lambda s: asked(s) and len(s.modes) > 1, modes, None),
        rule(place, lambda s: asked(s) and getattr(s, name).mode not in s.modes and str not in map(type, s.modes),
             modes),
        rule(f"{name} S", lambda s: s.family and s.family.amplitude_max < asked(s),
             "a number <= amplitude_max = {family.amplitude_max!r}"),
    )  # fmt: skip


def _moves_alone(s: Seen) -> bool:
    """Whether the perturbation moves the edge site alone; random displacements of several sites do not."""
    chain, dynamics = s.chain, s.dynamics
    edge = chain.sites if chain.gamma > 0 else 1
    if dynamics.vector is not None:
        return not any(value for i, value in enumerate(dynamics.vector) if i % chain.sites != edge - 1)
    return bool(dynamics.site == edge or chain.sites == 1)


def _cycles(s: Seen) -> bool:
    """Whether cycles are followed from Hopf points."""
    table = s.continuation
    return bool(table) and ("hopf" in table.switch or (not table.switch and bool(table.depth)))


def _without_multipliers(s: Seen) -> dict[str, Any] | None:
    """The first kind of special point in switch that multipliers decide, where there are none."""
    needed = {"period doubling"} | ({"branch point"} if s.orbit else set())
    lacking = not s.stability or (s.equilibrium and "hopf" not in s.continuation.switch)
    return first(s.continuation.switch, lambda _, kind: lacking and kind in needed)


def _first_table(s: Seen, *names: str) -> Found:
    """The first of the tables by these names that the scene has."""
    given = s.scene.given(*names)
    return {"name": given[0]} if given else None


def _collocated(s: Seen) -> bool:
    """Whether an orbit or a solution is sought on a mesh."""
    return bool(s.orbit or s.solution)


def _exceptional(s: Seen) -> bool:
    """Whether the chain is at |gamma| = 1."""
    return bool(s.chain) and abs(s.chain.gamma) == 1


# fmt: off
RULES: tuple[tuple[str, tuple[Rule, ...]], ...] = (  # by the table without which they are not asked
    ("accuracy", (
        rule("accuracy", lambda s: s.accuracy.preset is not None and s.accuracy.tolerance is not None,
             "preset or tolerance, one of them or neither",
             "preset = {accuracy.preset!t} and tolerance = {accuracy.tolerance!r}"),
        rule("accuracy certify", lambda s: not s.family, "with a [family], else false"),
    )),
    ("model", (
        rule("model file", lambda s: "\0" in s.model.file, "the name of a file"),
        rule("model name", lambda s: s.model.file.endswith(".json"), "none: the file holds one model",
             ' with file = "{model.file}"'),
        rule("model file", lambda s: not s.model.file.endswith((".json", ".py")), "a name that ends in .py or .json"),
        rule("model name", lambda s: s.model.file.endswith(".py"), "with a Python file the name of the model in it",
             None),
    )),
    ("family", (
        rule("method degree", lambda s: s.method.degree < LOWEST_DEGREE,
             f"with a [family] a whole number >= {LOWEST_DEGREE} and <= 12"),
        rule("method intervals", lambda s: True, "beside [orbit] or [solution]"),
        rule("method flow", lambda s: s.method.flow not in FLOWS, one_of(FLOWS), " with [family]"),
    )),
    ("method", (
        *(rule(f"method {name}", _collocated, "beside [family]") for name in ("tail", "walker")),
        rule("method transcription", lambda s: _collocated(s) and s.method.transcription not in COLLOCATION_TABLES,
             one_of(COLLOCATION_TABLES), " without [family]"),
        rule("method flow", lambda s: _collocated(s) and s.method.flow not in FULL_PERIOD_FLOWS,
             one_of(FULL_PERIOD_FLOWS), " without [family]"),
        rule("method degree", lambda s: s.transcription in (TRIGONOMETRIC, SHOOTING),
             "with transcription = " + " or ".join(f'"{name}"' for name in COLLOCATION_TABLES) + " only",
             " with transcription = {transcription!t}"),
        rule("method walker", lambda s: s.method.walker == "series" and s.transcription not in (None, TRIGONOMETRIC),
             '"arclength", or transcription = "trigonometric"', " with transcription = {transcription!t}"),
        rule("{sought[1]}", lambda s: len(s.sought) > 1, "[{sought[0]}] or [{sought[1]}] in one scene",
             "beside [{sought[0]}]"),
    )),
    ("solution", (
        rule("solution", lambda s: not s.model and {"other": "lattice" if s.lattice else "chain"},
             "beside [model], whose file states a boundary-value problem", "beside [{other}]"),
        rule("solution", lambda s: s.model.file.endswith(".json"),
             "with a Python file: a saved model is no boundary-value problem", 'with file = "{model.file}"'),
    )),
    ("stability", (
        rule("stability", lambda s: not (s.family or _collocated(s) or _cycles(s)),
             'beside a [family], an [orbit] or a [solution], or with "hopf" in [continuation] switch, whose stability '
             "it asks for", "without [family], [orbit] or [solution]"),
        rule("stability sites", lambda s: not s.family, "beside a [family] of a chain", " without [family]"),
    )),
    ("continuation", (
        rule("continuation", lambda s: not s.sought,
             "beside a [family], an [equilibrium], an [orbit] or a [solution], from which it follows",
             "without [family], [equilibrium], [orbit] or [solution]"),
    )),
    ("equilibrium", (
        rule("method", lambda s: s.method != MethodTable(), "beside [family], [orbit] or [solution]",
             "beside [equilibrium]"),
    )),
    ("orbit", (
        lambda s: ["[orbit] symmetric: given false with [chain]; accepted: true: the orbits of a chain come in families"
                   if s.chain and not s.orbit.symmetric else ""],
        rule("orbit", lambda s: s.orbit.period is not None and s.orbit.transient is not None,
             "period or transient, one of them", "period and transient"),
        rule("orbit section", lambda s: s.orbit.symmetric, "without: the symmetry fixes the phase",
             "with symmetric = true"),
        rule("orbit transient", lambda s: s.orbit.symmetric,
             "period (the orbit starts where the symmetry has its phase zero)", "with symmetric = true"),
    )),
    ("continuation", (
        once("continuation at"),
        rule("continuation parameter", lambda s: s.family and s.continuation.parameter != AMPLITUDE,
             '"S" beside [family]'),
        rule("continuation", lambda s: s.family and not s.continuation.switch and not s.curve,
             "with one of them, or both", "beside [family] without switch or curve"),
        *(rule(f"continuation {name}", lambda s: s.family, BESIDE_SOLUTION, "beside [family]")
          for name in ("at", "back_to", "depth")),
        rule("continuation", lambda s: s.family and not s.stability.events,
             "with [stability], events = true", "beside [family] without [stability] events"),
        rule("continuation to", lambda s: s.family and not s.continuation.to > 0.0,
             "a number > 0, which is S, beside [family]"),
        rule("continuation switch", lambda s: "hopf" in s.continuation.switch and not s.equilibrium and not s.orbit
             and {"beside": "family" if s.family else "solution"},
             '"branch point" and "period doubling"', '"hopf" beside [{beside}]'),
        rule("continuation depth", lambda s: s.continuation.depth and not s.continuation.switch and s.orbit
             and not s.stability, "with [stability]", " beside [orbit] without [stability]"),
        rule("continuation switch", lambda s: not s.stability and _without_multipliers(s), "with [stability]",
             " without [stability]"),
        rule("continuation switch", _without_multipliers, 'beside "hopf", whose cycles have period doublings',
             " beside [equilibrium]"),
        rule("continuation curve", lambda s: s.curve.further and not s.family, "beside [family]",
             "further = true without [family]"),
        once("continuation switch", "each kind once"),
        rule("continuation curve", lambda s: s.curve.parameter == s.continuation.parameter, "another parameter",
             "parameter = {continuation.parameter!t} again"),
        rule("continuation parameter", lambda s: s.continuation.parameter == SELECTED and s.solution,
             "with [orbit] select, whose value it moves"),
    )),
    ("family", (
        _modes,
        rule("chain g", lambda s: s.chain.g == 0, "with a [family] a finite number other than 0 "
             "(the family would be the linear mode at every amplitude)"),
        rule("stability vectors", _exceptional,
             "false (the vectors form Jordan chains that the gauge does not have)", " with gamma = {chain.gamma!r}"),
        _oscillates,
        rule("family at", lambda s: first(s.family.at, lambda _, value: value > s.family.amplitude_max),
             "numbers <= amplitude_max = {family.amplitude_max!r}", ITEM),
        rule("family at", lambda s: first(s.family.at, lambda i, value: i > 1 and value <= s.family.at[i - 2]),
             "numbers in strictly ascending order", f"{ITEM} after {{before!t}}"),
        once("family at_Omega"),
        rule("family at_Omega", lambda s: s.family.period_max
             and first(s.family.at_Omega, lambda _, value: 2 * math.pi / value > s.family.period_max),
             "numbers >= 2 pi/period_max = {least_Omega:.12g}", ITEM),
        once("family at_period"),
        rule("family at_period", lambda s: s.family.period_max
             and first(s.family.at_period, lambda _, value: value > s.family.period_max),
             "numbers <= period_max = {family.period_max!r}", ITEM),
    )),
    ("chain", (
        rule("{name}", lambda s: s.sites == math.inf and _first_table(s, "spectrum", "dynamics", "orbit"),
             "with a whole number of sites: all of them take part in it", "with sites = inf"),
        rule("stability vectors", lambda s: s.sites == math.inf, "false: all sites take part in them",
             " with sites = inf"),
    )),
    ("lattice", (
        rule("{name}", lambda s: s.lattice.long and _first_table(
             s, "spectrum", "dynamics", "orbit", "equilibrium", "continuation", "search", "export"),
             "with all sites unknown", "with a linear tail (edge, or more than 100000 cells)"),
        rule("stability vectors", lambda s: s.lattice.long, "false: all sites take part in them",
             " with a linear tail"),
    )),
    ("dynamics", (
        rule("dynamics", lambda s: s.at_rest and _first_table(s, "equilibrium", "solution", "search"),
             "beside [family] or [orbit], or with a start of its own", "beside [{name}]"),
        rule("dynamics", lambda s: s.at_rest and len(given := s.given("dynamics", *STARTS)) != 1
             and {"kinds": " and ".join(given) or f"none of {', '.join(STARTS)}"},
             f"one of {', '.join(STARTS)}, with size and duration, from which motion starts",
             "without [family] and [orbit], with {kinds}"),
        *(rule(f"dynamics {name}", lambda s: s.at_rest, "beside a [family] or an [orbit]")
          for name in ("S", "periods")),
        *(rule(f"dynamics {name}", lambda s: s.at_rest and {"kind": s.given("dynamics", *STARTS)[0]},
               "beside {kind} a finite number > 0", None) for name in ("size", "duration")),
        rule("dynamics", lambda s: s.at_rest and _exceptional(s),
             "|gamma| < 1: sites off the edge have no image in the gauge",
             "with gamma = {chain.gamma!r} and without [family]"),
        rule("dynamics moving", lambda s: not s.at_rest, "without [family] and [orbit], which start at phase zero"),
        *(rule(f"dynamics {name}", lambda s: not s.at_rest and not s.family, "beside a [family]")
          for name in ("S", "mode")),
        rule("dynamics S", lambda s: s.family, "a finite number > 0, up to amplitude_max", None),
        *_orbit_of_family("dynamics"),
        rule("dynamics", lambda s: s.dynamics.duration is None and s.dynamics.periods is None,
             "duration or periods, one of them", "neither duration nor periods"),
        rule("dynamics", lambda s: s.dynamics.duration is not None and s.dynamics.periods is not None,
             "duration or periods, one of them", "duration and periods"),
        rule("dynamics", lambda s: len(given := s.given("dynamics", *KICKS)) > 1 and {"kinds": " and ".join(given)},
             "site, vector or seed, one of them or none", "{kinds}"),
        rule("dynamics size", lambda s: (given := s.given("dynamics", *KICKS)) and {"kind": given[0]},
             "beside {kind} a finite number > 0", None),
        rule("dynamics size", lambda s: not s.at_rest and not s.given("dynamics", *KICKS),
             "beside one of site, vector, seed"),
        rule("dynamics vector", lambda s: not any(s.dynamics.vector), "a vector with a direction", "zeros"),
        rule("dynamics", lambda s: s.chain and abs(s.chain.gamma) < 1
             and (s.chain.sites - 1) * math.atanh(abs(s.chain.gamma)) > LONGEST_ENVELOPE,
             f"(sites - 1) artanh|gamma| <= {LONGEST_ENVELOPE:g}",
             "with sites = {sites} and gamma = {chain.gamma!r}, whose far end is below the smallest double"),
        rule("dynamics site", lambda s: s.chain and not 1 <= s.dynamics.site <= s.chain.sites,
             "whole numbers from 1 to {sites} (sites)"),
        rule("dynamics vector", lambda s: s.chain and (count := len(s.dynamics.vector)) not in
             (s.chain.sites, 2 * s.chain.sites) and {"count": count},
             "{sites} displacements, or these and {sites} velocities", "a list of {count}"),
        rule("dynamics {kind}", lambda s: _exceptional(s) and (given := s.given("dynamics", *KICKS))
             and not _moves_alone(s) and {"kind": given[0], "edge": s.chain.sites if s.chain.gamma > 0 else 1},
             "site {edge} alone (at |gamma| = 1 displacements off the edge have no image in the gauge)",
             "with gamma = {chain.gamma!r}"),
    )),
    ("search", (
        rule("search", lambda s: s.family, "[search] or [family] in one scene", "beside [family]"),
        rule("search", lambda s: s.sites == math.inf, "with a whole number of sites", "with sites = inf"),
        rule("chain g", lambda s: s.chain.g == 0, "with a [search] a finite number other than 0"),
        rule("search mode", lambda s: s.chain and isinstance(s.search.mode, int) and s.search.mode > s.chain.sites,
             "whole numbers from 1 to {sites} (sites), first, last"),
        lambda s: _search(s) if s.chain else (),
    )),
    ("export", (
        rule("export", lambda s: s.sites == math.inf, "with a whole number of sites", "with sites = inf"),
        rule("export", lambda s: s.export.c is None and s.export.fmu is None, "one of them, or both",
             "neither c nor fmu"),
        rule("export inputs", lambda s: s.export.fmu is None, "beside fmu"),
        rule("export c", lambda s: s.export.c != "all" and _exceptional(s)
             and first(s.export.c, lambda _, part: part in ("flow", "residual", "newton", "ipopt")),
             "rhs, jacobian, variational, orbit (the gauge holds the edge site alone)",
             "{value!t} with gamma = {chain.gamma!r}"),
        rule("export mode", lambda s: s.export.S is None, "beside S, the orbit of that mode's family"),
        rule("export c", lambda s: s.export.S is None and not s.orbit and "orbit" in s.export.c,
             "with S, that of the orbit", '"orbit" without S'),
        rule("export S", lambda s: not s.family, "beside a [family], one of whose orbits it names"),
        *_orbit_of_family("export"),
    )),
    ("figures", (once("figures formats", "each format once"),)),
)
# fmt: on
