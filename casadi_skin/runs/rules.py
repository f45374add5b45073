"""Faults of a scene, each one line with the place, the given and the accepted; and the rules that tie its keys.

Bounds of single keys are in the tables (see scene.py). A rule is a condition, and the message where it holds; the first
one that holds is reported.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
NARROWEST_BAND = 1e-10  # the same as in lattice.full_chain, which loads numerics
LONGEST_ENVELOPE = 700.0  # the same as in dynamics, which loads numerics
LOWEST_DEGREE = 2  # of families; the same as in zero.request, which loads numerics
KICKS = ("site", "vector", "seed")  # keys of [dynamics], one of which a perturbation has
STARTS = ("mode", *KICKS)  # of which a motion from rest has one


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
        self.transcription, self.lacking = scene.methods.transcription, MethodTable()
        self.sought = scene.given("family", "equilibrium", "orbit", "solution")
        self.at_rest = scene.family is None and scene.orbit is None  # where [dynamics] starts
        self.tables: dict[str, Any] = {name: getattr(scene, name) or Absent() for name in Scene.__struct_fields__}
        self.tables["curve"] = self.tables["continuation"].curve or Absent()

    def __getattr__(self, name: str) -> Any:
        return self.tables[name]

    def given(self, table: str, *keys: str) -> list[str]:
        """Which of these keys a table has."""
        return [key for key in keys if getattr(self.tables[table], key) is not None]

    def asks_of_family(self, table: str) -> bool:
        """Whether a table asks for an orbit of a family."""
        return bool(self.family) and self.tables[table].S is not None


Rule = tuple[Callable[[Any], object], str]  # the condition: true, or values for the message by name, or all of it


def check_scene(scene: Scene) -> None:
    """Raises SceneError for the first key that does not go with another one."""
    seen = Seen(scene)
    known = {**seen.tables, "sites": seen.sites, "modes": seen.modes}
    for table, rules in RULES:
        for condition, message in rules if seen.tables[table] else ():
            found = condition(seen)
            if found:
                more = found if isinstance(found, dict) else {}
                raise SceneError(Words().vformat(message, (found,), {**known, **more}))


def again(values: Sequence[object]) -> dict[str, Any] | None:
    """The first item of a list that was there before; None where each is there once."""
    return first(values, lambda item, value: value in values[: item - 1])


def first(values: Sequence[Any], wrong: Callable[[int, Any], bool]) -> dict[str, Any] | None:
    """The first item, its number from 1 and its value, that is wrong; None where there is none."""
    found = ((item, value) for item, value in enumerate(values, start=1) if wrong(item, value))
    return next(({"item": item, "value": value} for item, value in found), None)


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
    """Faults of the names and bounds of a [search]."""
    search = s.search
    yield unknown("[search] objective", search.objective, NAMED)
    for name in search.free:
        yield unknown("[search] free", name, FREE)
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


def _one(faults: Callable[[Seen], Iterator[str]]) -> Rule:
    """The first of some faults, whose messages are made where they are found, as a rule."""
    return (lambda s: next(filter(None, faults(s)), None)), "{}"


def _orbit_of_family(name: str) -> tuple[Rule, ...]:
    """Rules on the orbit at S of the family of a mode, which has to be named where there are several.

    Whether a model has a mode by the number of one that is named, as "last", shows with the model alone.
    """
    modes = "accepted: one of the modes of [family], {modes!t}"
    return (
        (lambda s: s.asks_of_family(name) and s.tables[name].mode is None and len(s.modes) > 1,
         f"[{name}] mode: missing; {modes}"),
        (lambda s: s.asks_of_family(name) and s.tables[name].mode not in (None, *s.modes)
         and not any(isinstance(mode, str) for mode in s.modes),
         f"[{name}] mode: given {{{name}.mode}}; {modes}"),
        (lambda s: s.asks_of_family(name) and s.family.amplitude_max < s.tables[name].S,
         f"[{name}] S: given {{{name}.S!r}}; accepted: a number <= amplitude_max = {{family.amplitude_max!r}}"),
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
    cycles = "hopf" in s.continuation.switch
    return first(
        s.continuation.switch, lambda _, k: k in needed and (not s.stability or (s.equilibrium and not cycles))
    )


# fmt: off
BESIDE_SOLUTION = "beside [equilibrium], [orbit] or [solution]"
RULES: tuple[tuple[str, tuple[Rule, ...]], ...] = (  # by the table without which they are not asked
    ("accuracy", (
        (lambda s: s.accuracy.preset is not None and s.accuracy.tolerance is not None,
         '[accuracy]: given preset = "{accuracy.preset}" and tolerance = {accuracy.tolerance!r}; '
         "accepted: preset or tolerance, one of them or neither"),
        (lambda s: s.accuracy.certify and not s.family,
         "[accuracy] certify: given {accuracy.certify!t}; accepted: with a [family], else false"),
    )),
    ("model", (
        (lambda s: "\0" in s.model.file, "[model] file: given {model.file!t}; accepted: the name of a file"),
        (lambda s: s.model.file.endswith(".json") and s.model.name is not None,
         '[model] name: given {model.name!t} with file = "{model.file}"; accepted: none: the file holds one model'),
        (lambda s: not s.model.file.endswith((".json", ".py")),
         "[model] file: given {model.file!t}; accepted: a name that ends in .py or .json"),
        (lambda s: s.model.file.endswith(".py") and s.model.name is None,
         "[model] name: missing; accepted: with a Python file the name of the model in it"),
    )),
    ("family", (
        (lambda s: s.method.degree is not None and s.method.degree < LOWEST_DEGREE,
         "[method] degree: given {method.degree}; "
         f"accepted: with a [family] a whole number >= {LOWEST_DEGREE} and <= 12"),
        (lambda s: s.method.intervals is not None,
         "[method] intervals: given {method.intervals}; accepted: beside [orbit] or [solution]"),
        (lambda s: s.method.flow not in (None, *FLOWS),
         f"[method] flow: given {{method.flow!t}} with [family]; accepted: {one_of(FLOWS)}"),
    )),
    ("method", (
        (lambda s: (s.orbit or s.solution) and s.method.tail is not None,
         "[method] tail: given {method.tail!t}; accepted: beside [family]"),
        (lambda s: (s.orbit or s.solution) and s.method.walker is not None,
         "[method] walker: given {method.walker!t}; accepted: beside [family]"),
        (lambda s: (s.orbit or s.solution) and s.method.transcription not in (None, *COLLOCATION_TABLES),
         "[method] transcription: given {method.transcription!t} without [family]; "
         f"accepted: {one_of(COLLOCATION_TABLES)}"),
        (lambda s: (s.orbit or s.solution) and s.method.flow not in (None, *FULL_PERIOD_FLOWS),
         f"[method] flow: given {{method.flow!t}} without [family]; accepted: {one_of(FULL_PERIOD_FLOWS)}"),
        (lambda s: s.method.degree is not None and s.transcription in (TRIGONOMETRIC, SHOOTING)
         and {"transcription": s.transcription},
         '[method] degree: given {method.degree} with transcription = "{transcription}"; '
         "accepted: with transcription = " + " or ".join(f'"{name}"' for name in COLLOCATION_TABLES) + " only"),
        (lambda s: s.method.walker == "series" and s.transcription not in (None, TRIGONOMETRIC)
         and {"transcription": s.transcription},
         '[method] walker: given "series" with transcription = "{transcription}"; '
         'accepted: "arclength", or transcription = "trigonometric"'),
        (lambda s: len(s.sought) > 1 and {"one": s.sought[0], "two": s.sought[1]},
         "[{two}]: given beside [{one}]; accepted: [{one}] or [{two}] in one scene"),
    )),
    ("solution", (
        (lambda s: not s.model and {"other": "lattice" if s.lattice else "chain"},
         "[solution]: given beside [{other}]; accepted: beside [model], whose file states a boundary-value problem"),
        (lambda s: s.model.file.endswith(".json"),
         '[solution]: given with file = "{model.file}"; '
         "accepted: with a Python file: a saved model is no boundary-value problem"),
    )),
    ("stability", (
        (lambda s: not (s.family or s.orbit or s.solution or _cycles(s)),
         "[stability]: given without [family], [orbit] or [solution]; accepted: beside a [family], an [orbit] or a "
         '[solution], or with "hopf" in [continuation] switch, whose stability it asks for'),
        (lambda s: s.stability.sites is not None and not s.family,
         "[stability] sites: given {stability.sites} without [family]; accepted: beside a [family] of a chain"),
    )),
    ("continuation", (
        (lambda s: not s.sought,
         "[continuation]: given without [family], [equilibrium], [orbit] or [solution]; accepted: beside a [family], "
         "an [equilibrium], an [orbit] or a [solution], from which it follows"),
    )),
    ("equilibrium", (
        (lambda s: s.method != s.lacking,
         "[method]: given beside [equilibrium]; accepted: beside [family], [orbit] or [solution]"),
    )),
    ("orbit", (
        (lambda s: s.chain and not s.orbit.symmetric,
         "[orbit] symmetric: given false with [chain]; accepted: true: the orbits of a chain come in families"),
        (lambda s: s.orbit.period is not None and s.orbit.transient is not None,
         "[orbit]: given period and transient; accepted: period or transient, one of them"),
        (lambda s: s.orbit.section is not None and s.orbit.symmetric,
         "[orbit] section: given with symmetric = true; accepted: without: the symmetry fixes the phase"),
        (lambda s: s.orbit.symmetric and s.orbit.transient is not None,
         "[orbit] transient: given with symmetric = true; "
         "accepted: period (the orbit starts where the symmetry has its phase zero)"),
    )),
    ("continuation", (
        (lambda s: again(s.continuation.at),
         "[continuation] at: given {value!r} as item {item} again; accepted: each number once"),
        (lambda s: s.family and s.continuation.parameter != AMPLITUDE,
         '[continuation] parameter: given {continuation.parameter!t}; accepted: "S" beside [family]'),
        (lambda s: s.family and not s.continuation.switch and not s.curve,
         "[continuation]: given beside [family] without switch or curve; accepted: with one of them, or both"),
        (lambda s: s.family and s.continuation.at,
         f"[continuation] at: given beside [family]; accepted: {BESIDE_SOLUTION}"),
        (lambda s: s.family and s.continuation.back_to is not None,
         f"[continuation] back_to: given beside [family]; accepted: {BESIDE_SOLUTION}"),
        (lambda s: s.family and not s.stability.events,
         "[continuation]: given beside [family] without [stability] events; "
         "accepted: with [stability], events = true"),
        (lambda s: s.family and not s.continuation.to > 0.0,
         "[continuation] to: given {continuation.to!r}; accepted: a number > 0, which is S, beside [family]"),
        (lambda s: s.family and s.continuation.depth is not None,
         f"[continuation] depth: given beside [family]; accepted: {BESIDE_SOLUTION}"),
        (lambda s: "hopf" in s.continuation.switch and not s.equilibrium and not s.orbit
         and {"beside": "family" if s.family else "solution"},
         '[continuation] switch: given "hopf" beside [{beside}]; accepted: "branch point" and "period doubling"'),
        (lambda s: s.continuation.depth and not s.continuation.switch and s.orbit and not s.stability,
         "[continuation] depth: given {continuation.depth} beside [orbit] without [stability]; "
         "accepted: with [stability]"),
        (lambda s: not s.stability and _without_multipliers(s),
         '[continuation] switch: given "{value}" without [stability]; accepted: with [stability]'),
        (_without_multipliers,
         '[continuation] switch: given "{value}" beside [equilibrium]; '
         'accepted: beside "hopf", whose cycles have period doublings'),
        (lambda s: s.curve.further and not s.family,
         "[continuation] curve: given further = true without [family]; accepted: beside [family]"),
        (lambda s: again(s.continuation.switch),
         "[continuation] switch: given {value!t} as item {item} again; accepted: each kind once"),
        (lambda s: s.curve and s.curve.parameter == s.continuation.parameter,
         "[continuation] curve: given parameter = {continuation.parameter!t} again; accepted: another parameter"),
        (lambda s: s.continuation.parameter == SELECTED and s.solution,
         f'[continuation] parameter: given "{SELECTED}"; accepted: with [orbit] select, whose value it moves'),
    )),
    ("family", (
        _one(_modes),
        (lambda s: s.chain and s.chain.g == 0,
         "[chain] g: given {chain.g!r}; accepted: with a [family] a finite number other than 0 "
         "(the family would be the linear mode at every amplitude)"),
        (lambda s: s.chain and abs(s.chain.gamma) == 1 and s.stability.vectors,
         "[stability] vectors: given true with gamma = {chain.gamma!r}; "
         "accepted: false (the vectors form Jordan chains that the gauge does not have)"),
        _one(_oscillates),
        (lambda s: first(s.family.at, lambda _, value: value > s.family.amplitude_max),
         "[family] at: given {value!r} as item {item}; accepted: numbers <= amplitude_max = {family.amplitude_max!r}"),
        (lambda s: (found := first(s.family.at, lambda i, value: i > 1 and value <= s.family.at[i - 2]))
         and {**found, "before": s.family.at[found["item"] - 2]},
         "[family] at: given {value!r} as item {item} after {before!r}; accepted: numbers in strictly ascending order"),
        (lambda s: again(s.family.at_Omega),
         "[family] at_Omega: given {value!r} as item {item} again; accepted: each number once"),
        (lambda s: (found := first(s.family.at_Omega, lambda _, v: 2 * math.pi / v > (s.family.period_max or math.inf)))
         and {**found, "least": 2 * math.pi / s.family.period_max},
         "[family] at_Omega: given {value!r} as item {item}; accepted: numbers >= 2 pi/period_max = {least:.12g}"),
        (lambda s: again(s.family.at_period),
         "[family] at_period: given {value!r} as item {item} again; accepted: each number once"),
        (lambda s: first(s.family.at_period, lambda _, value: value > (s.family.period_max or math.inf)),
         "[family] at_period: given {value!r} as item {item}; accepted: numbers <= period_max = {family.period_max!r}"),
    )),
    ("chain", (
        (lambda s: s.sites == math.inf and (given := s.scene.given("spectrum", "dynamics", "orbit"))
         and {"name": given[0]},
         "[{name}]: given with sites = inf; accepted: with a whole number of sites: all of them take part in it"),
        (lambda s: s.sites == math.inf and s.stability.vectors,
         "[stability] vectors: given true with sites = inf; accepted: false: all sites take part in them"),
    )),
    ("lattice", (
        (lambda s: s.lattice.long and (given := s.scene.given(
            "spectrum", "dynamics", "orbit", "equilibrium", "continuation", "search", "export")) and {"name": given[0]},
         "[{name}]: given with a linear tail (edge, or more than 100000 cells); accepted: with all sites unknown"),
        (lambda s: s.lattice.long and s.stability.vectors,
         "[stability] vectors: given true with a linear tail; accepted: false: all sites take part in them"),
    )),
    ("dynamics", (
        (lambda s: s.at_rest and (given := s.scene.given("equilibrium", "solution", "search")) and {"name": given[0]},
         "[dynamics]: given beside [{name}]; accepted: beside [family] or [orbit], or with a start of its own"),
        (lambda s: s.at_rest and len(given := s.given("dynamics", *STARTS)) != 1
         and {"kinds": " and ".join(given) or f"none of {', '.join(STARTS)}"},
         "[dynamics]: given without [family] and [orbit], with {kinds}; "
         f"accepted: one of {', '.join(STARTS)}, with size and duration, from which motion starts"),
        (lambda s: s.at_rest and s.dynamics.S is not None,
         "[dynamics] S: given {dynamics.S!r}; accepted: beside a [family] or an [orbit]"),
        (lambda s: s.at_rest and s.dynamics.periods is not None,
         "[dynamics] periods: given {dynamics.periods!r}; accepted: beside a [family] or an [orbit]"),
        (lambda s: s.at_rest and (lacking := [n for n in ("size", "duration") if not s.given("dynamics", n)])
         and {"name": lacking[0], "kind": s.given("dynamics", *STARTS)[0]},
         "[dynamics] {name}: missing; accepted: beside {kind} a finite number > 0"),
        (lambda s: s.at_rest and s.chain and abs(s.chain.gamma) == 1,
         "[dynamics]: given with gamma = {chain.gamma!r} and without [family]; "
         "accepted: |gamma| < 1: sites off the edge have no image in the gauge"),
        (lambda s: not s.at_rest and s.dynamics.moving,
         "[dynamics] moving: given true; accepted: without [family] and [orbit], which start at phase zero"),
        (lambda s: not s.at_rest and not s.family and s.dynamics.S is not None,
         "[dynamics] S: given {dynamics.S!r}; accepted: beside a [family]"),
        (lambda s: not s.at_rest and not s.family and s.dynamics.mode is not None,
         "[dynamics] mode: given {dynamics.mode!r}; accepted: beside a [family]"),
        (lambda s: s.family and s.dynamics.S is None,
         "[dynamics] S: missing; accepted: a finite number > 0, up to amplitude_max"),
        *_orbit_of_family("dynamics"),
        (lambda s: s.dynamics.duration is None and s.dynamics.periods is None,
         "[dynamics]: given neither duration nor periods; accepted: duration or periods, one of them"),
        (lambda s: s.dynamics.duration is not None and s.dynamics.periods is not None,
         "[dynamics]: given duration and periods; accepted: duration or periods, one of them"),
        (lambda s: len(given := s.given("dynamics", *KICKS)) > 1 and {"kinds": " and ".join(given)},
         "[dynamics]: given {kinds}; accepted: site, vector or seed, one of them or none"),
        (lambda s: s.dynamics.size is None and (given := s.given("dynamics", *KICKS)) and {"kind": given[0]},
         "[dynamics] size: missing; accepted: beside {kind} a finite number > 0"),
        (lambda s: s.dynamics.size is not None and not s.at_rest and not s.given("dynamics", *KICKS),
         "[dynamics] size: given {dynamics.size!r}; accepted: beside one of site, vector, seed"),
        (lambda s: s.dynamics.vector is not None and not any(s.dynamics.vector),
         "[dynamics] vector: given zeros; accepted: a vector with a direction"),
        (lambda s: s.chain and abs(s.chain.gamma) < 1
         and (s.chain.sites - 1) * math.atanh(abs(s.chain.gamma)) > LONGEST_ENVELOPE,
         "[dynamics]: given with sites = {sites} and gamma = {chain.gamma!r}, whose far end is below the smallest "
         f"double; accepted: (sites - 1) artanh|gamma| <= {LONGEST_ENVELOPE:g}"),
        (lambda s: s.chain and s.dynamics.site is not None and not 1 <= s.dynamics.site <= s.chain.sites,
         "[dynamics] site: given {dynamics.site!t}; accepted: whole numbers from 1 to {sites} (sites)"),
        (lambda s: s.chain and s.dynamics.vector is not None
         and (count := len(s.dynamics.vector)) not in (s.chain.sites, 2 * s.chain.sites) and {"count": count},
         "[dynamics] vector: given a list of {count}; "
         "accepted: {sites} displacements, or these and {sites} velocities"),
        (lambda s: s.chain and abs(s.chain.gamma) == 1 and (given := s.given("dynamics", *KICKS))
         and not _moves_alone(s) and {"kind": given[0], "edge": s.chain.sites if s.chain.gamma > 0 else 1},
         "[dynamics] {kind}: given with gamma = {chain.gamma!r}; accepted: site {edge} alone "
         "(at |gamma| = 1 displacements off the edge have no image in the gauge)"),
    )),
    ("search", (
        (lambda s: s.family, "[search]: given beside [family]; accepted: [search] or [family] in one scene"),
        (lambda s: s.sites == math.inf, "[search]: given with sites = inf; accepted: with a whole number of sites"),
        (lambda s: s.chain and s.chain.g == 0,
         "[chain] g: given {chain.g!r}; accepted: with a [search] a finite number other than 0"),
        (lambda s: s.chain and isinstance(s.search.mode, int) and s.search.mode > s.chain.sites,
         "[search] mode: given {search.mode!t}; accepted: whole numbers from 1 to {sites} (sites), first, last"),
        (lambda s: s.chain and next(filter(None, _search(s)), None), "{}"),
    )),
    ("export", (
        (lambda s: s.sites == math.inf, "[export]: given with sites = inf; accepted: with a whole number of sites"),
        (lambda s: s.export.c is None and s.export.fmu is None,
         "[export]: given neither c nor fmu; accepted: one of them, or both"),
        (lambda s: s.export.inputs and s.export.fmu is None,
         "[export] inputs: given {export.inputs!t}; accepted: beside fmu"),
        (lambda s: s.chain and s.export.c not in (None, "all") and abs(s.chain.gamma) == 1
         and first(s.export.c, lambda _, part: part in ("flow", "residual", "newton", "ipopt")),
         "[export] c: given {value!t} with gamma = {chain.gamma!r}; "
         "accepted: rhs, jacobian, variational, orbit (the gauge holds the edge site alone)"),
        (lambda s: s.export.S is None and s.export.mode is not None,
         "[export] mode: given {export.mode!t}; accepted: beside S, the orbit of that mode's family"),
        (lambda s: s.export.S is None and not s.orbit and "orbit" in (s.export.c or ()),
         '[export] c: given "orbit" without S; accepted: with S, that of the orbit'),
        (lambda s: s.export.S is not None and not s.family,
         "[export] S: given {export.S!r}; accepted: beside a [family], one of whose orbits it names"),
        *_orbit_of_family("export"),
    )),
    ("figures", (
        (lambda s: again(s.figures.formats),
         "[figures] formats: given {value!t} as item {item} again; accepted: each format once"),
    )),
)
# fmt: on
