"""Reports of faults of a scene: one line with the place, the value and the accepted values."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from casadi_skin.lattice.stiffness import stiffness
from casadi_skin.model.arguments import LONGEST, cut, nearest
from casadi_skin.model.methods import COLLOCATION_TABLES, FLOWS, FULL_PERIOD_FLOWS, SHOOTING, TRIGONOMETRIC
from casadi_skin.optimise.names import FREE, NAMED
from casadi_skin.runs.output import InputError
from casadi_skin.runs.scene import (
    AMPLITUDE,
    SELECTED,
    AccuracyTable,
    ChainTable,
    ContinuationTable,
    DynamicsTable,
    FamilyTable,
    MethodTable,
    ModelTable,
    Scene,
    one_of,
)

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


def check_known(place: str, name: str, known: Sequence[str]) -> None:
    """Raises SceneError, with the nearest known name, for an unknown one."""
    if name not in known:
        near = nearest(name, known)
        hint = did_you_mean(near and toml_repr(near), ", ".join(known) or "none")
        raise SceneError(f"{place}: given {toml_repr(name)}{hint}")


def is_table(value: object) -> bool:
    return isinstance(value, dict) or (isinstance(value, list) and value != [] and isinstance(value[0], dict))


def toml_repr(value: object, depth: int = 3) -> str:
    """A value as TOML would write it, cut where it is long, nested or huge."""
    if isinstance(value, str):
        return cut(json.dumps(value[:LONGEST], ensure_ascii=False))
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):  # beyond some hundred digits Python may refuse to write decimals, never hex
        return cut(str(value) if value.bit_length() < 2000 else hex(value))
    if isinstance(value, list):
        items = [toml_repr(item, depth - 1) for item in value[:LONGEST]] if depth else ["..."]
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


# Checks that tie the keys of [dynamics], [export], [figures] and [search] to other tables -----------------------------

LONGEST_ENVELOPE = 700.0  # the same as in dynamics, which loads numerics


def check_dynamics(scene: Scene) -> None:
    dynamics = scene.dynamics
    if dynamics is None:
        return
    alone = scene.family is None and scene.orbit is None
    if alone:
        _check_start(scene, dynamics)
    elif dynamics.moving:
        raise refusal("[dynamics] moving", "true", "without [family] and [orbit], which start at phase zero")
    elif scene.family is None:
        for name in ("S", "mode"):
            if getattr(dynamics, name) is not None:
                raise refusal(f"[dynamics] {name}", repr(getattr(dynamics, name)), "beside a [family]")
    elif dynamics.S is None:
        raise SceneError("[dynamics] S: missing; accepted: a finite number > 0, up to amplitude_max")
    else:
        _check_orbit_of_family("dynamics", scene, scene.family, dynamics.S, dynamics.mode)
    if (dynamics.duration is None) == (dynamics.periods is None):
        given = "neither duration nor periods" if dynamics.duration is None else "duration and periods"
        raise refusal("[dynamics]", given, "duration or periods, one of them")
    _check_kinds(dynamics, alone)
    if scene.chain is not None:
        _check_envelope(scene.chain)
        _check_perturbation(scene.chain, dynamics)


def check_figures(scene: Scene) -> None:
    formats = scene.figures.formats
    for item, name in enumerate(formats, start=1):
        if name in formats[: item - 1]:
            raise refusal("[figures] formats", f"{toml_repr(name)} as item {item} again", "each format once")


def _check_orbit_of_family(table: str, scene: Scene, family: FamilyTable, S: float, mode: int | None) -> None:
    """An orbit at S of the family of a mode, which has to be named where there are several.

    Whether a model has a mode by the number of one that is named, as "last", shows with the model alone.
    """
    followed = scene.modes()
    modes = f"one of the modes of [family], {toml_repr(list(followed))}"
    if mode is None and len(followed) > 1:
        raise SceneError(f"[{table}] mode: missing; accepted: {modes}")
    named = any(isinstance(known, str) for known in followed)
    if mode is not None and mode not in followed and not named:
        raise refusal(f"[{table}] mode", toml_repr(mode), modes)
    if family.amplitude_max < S:
        raise refusal(f"[{table}] S", repr(S), f"a number <= amplitude_max = {family.amplitude_max!r}")


def _check_envelope(chain: ChainTable) -> None:
    """Refuse chains whose displacements at the far end are below the smallest double."""
    if abs(chain.gamma) < 1 and (chain.sites - 1) * math.atanh(abs(chain.gamma)) > LONGEST_ENVELOPE:
        given = f"with sites = {chain.sites} and gamma = {chain.gamma!r}, whose far end is below the smallest double"
        raise refusal("[dynamics]", given, f"(sites - 1) artanh|gamma| <= {LONGEST_ENVELOPE:g}")


def _check_start(scene: Scene, dynamics: DynamicsTable) -> None:
    """Requirements of a motion from near rest."""
    for name in ("equilibrium", "solution", "search"):
        if getattr(scene, name) is not None:
            raise refusal("[dynamics]", f"beside [{name}]", "beside [family] or [orbit], or with a start of its own")
    kinds = ("mode", "site", "vector", "seed")
    given = [name for name in kinds if getattr(dynamics, name) is not None]
    if len(given) != 1:
        words = f"without [family] and [orbit], with {' and '.join(given) or 'none of ' + ', '.join(kinds)}"
        raise refusal(
            "[dynamics]", words, f"one of {', '.join(kinds)}, with size and duration, from which motion starts"
        )
    for name in ("S", "periods"):
        if getattr(dynamics, name) is not None:
            raise refusal(f"[dynamics] {name}", repr(getattr(dynamics, name)), "beside a [family] or an [orbit]")
    for name in ("size", "duration"):
        if getattr(dynamics, name) is None:
            raise SceneError(f"[dynamics] {name}: missing; accepted: beside {given[0]} a finite number > 0")
    if scene.chain is not None and abs(scene.chain.gamma) == 1:
        given_gamma = f"with gamma = {scene.chain.gamma!r} and without [family]"
        raise refusal("[dynamics]", given_gamma, "|gamma| < 1: sites off the edge have no image in the gauge")


def _check_kinds(dynamics: DynamicsTable, alone: bool) -> None:
    """One kind of perturbation, and its size."""
    kinds = [name for name in ("site", "vector", "seed") if getattr(dynamics, name) is not None]
    if len(kinds) > 1:
        raise refusal("[dynamics]", " and ".join(kinds), "site, vector or seed, one of them or none")
    if kinds and dynamics.size is None:
        raise SceneError(f"[dynamics] size: missing; accepted: beside {kinds[0]} a finite number > 0")
    if dynamics.size is not None and not kinds and not alone:
        raise refusal("[dynamics] size", repr(dynamics.size), "beside one of site, vector, seed")
    if dynamics.vector is not None and not any(dynamics.vector):
        raise refusal("[dynamics] vector", "zeros", "a vector with a direction")


def _check_perturbation(chain: ChainTable, dynamics: DynamicsTable) -> None:
    kinds = [name for name in ("site", "vector", "seed") if getattr(dynamics, name) is not None]
    if dynamics.site is not None and not 1 <= dynamics.site <= chain.sites:
        raise refusal("[dynamics] site", toml_repr(dynamics.site), f"whole numbers from 1 to {chain.sites} (sites)")
    if dynamics.vector is not None and len(dynamics.vector) not in (chain.sites, 2 * chain.sites):
        accepted = f"{chain.sites} displacements, or these and {chain.sites} velocities"
        raise refusal("[dynamics] vector", f"a list of {len(dynamics.vector)}", accepted)
    edge = chain.sites if chain.gamma > 0 else 1
    if abs(chain.gamma) == 1 and kinds and not _moves_alone(dynamics, int(edge), int(chain.sites)):
        reason = "at |gamma| = 1 displacements off the edge have no image in the gauge"
        raise refusal(f"[dynamics] {kinds[0]}", f"with gamma = {chain.gamma!r}", f"site {edge} alone ({reason})")


def _moves_alone(dynamics: DynamicsTable, edge: int, sites: int) -> bool:
    """Whether the perturbation moves the edge site alone; random displacements of several sites do not."""
    if dynamics.vector is not None:
        return not any(value for i, value in enumerate(dynamics.vector) if i % sites != edge - 1)
    return dynamics.site == edge or sites == 1


def check_export(scene: Scene) -> None:
    export = scene.export
    if export is None:
        return
    if scene.sites == math.inf:
        raise refusal("[export]", "with sites = inf", "with a whole number of sites")
    if export.c is None and export.fmu is None:
        raise refusal("[export]", "neither c nor fmu", "one of them, or both")
    if export.inputs and export.fmu is None:
        raise refusal("[export] inputs", toml_repr(list(export.inputs)), "beside fmu")
    if scene.chain is not None and export.c not in (None, "all") and abs(scene.chain.gamma) == 1:
        for part in export.c:
            if part in ("flow", "residual", "newton", "ipopt"):
                given = f"{toml_repr(part)} with gamma = {scene.chain.gamma!r}"
                accepted = "rhs, jacobian, variational, orbit (the gauge holds the edge site alone)"
                raise refusal("[export] c", given, accepted)
    if export.S is None:
        if export.mode is not None:
            raise refusal("[export] mode", toml_repr(export.mode), "beside S, the orbit of that mode's family")
        if scene.orbit is None and export.c is not None and "orbit" in export.c:
            raise refusal("[export] c", '"orbit" without S', "with S, that of the orbit")
        return
    if scene.family is None:
        raise refusal("[export] S", repr(export.S), "beside a [family], one of whose orbits it names")
    _check_orbit_of_family("export", scene, scene.family, export.S, export.mode)


def check_search(scene: Scene) -> None:
    search, chain = scene.search, scene.chain
    if search is None:
        return
    if scene.family is not None:
        raise refusal("[search]", "beside [family]", "[search] or [family] in one scene")
    if chain is None:
        return
    if chain.sites == math.inf:
        raise refusal("[search]", "with sites = inf", "with a whole number of sites")
    if chain.g == 0:
        raise refusal("[chain] g", repr(chain.g), "with a [search] a finite number other than 0")
    if isinstance(search.mode, int) and search.mode > chain.sites:
        raise refusal(
            "[search] mode", toml_repr(search.mode), f"whole numbers from 1 to {chain.sites} (sites), first, last"
        )
    check_known("[search] objective", search.objective, tuple(NAMED))
    for name in search.free:
        check_known("[search] free", name, tuple(FREE))
    for name, (lower, upper) in search.bounds.items():
        check_known("[search] bounds", name, tuple({**FREE, **NAMED}))
        if not lower <= upper:
            raise refusal(
                f"[search] bounds {name}", toml_repr([lower, upper]), "a list [lower, upper] with lower <= upper"
            )
    for item, held in enumerate(search.constraints, start=1):
        place = f"[search] constraints, item {item}"
        check_known(place, held.quantity, tuple(NAMED))
        if (held.equal is None) == (held.lower is None and held.upper is None):
            given = "equal beside a bound" if held.equal is not None else "neither equal nor a bound"
            raise refusal(place, given, "equal, or lower and upper or one of these")


# Checks that tie one key of a scene to another, of any scene; bounds of single keys are in the tables -----------------

NEAREST = 1e-12  # relative, of the end of a family to its start
NARROWEST_BAND = 1e-10  # the same as in lattice.chain_coordinates, which loads numerics


def check_chain_family(scene: Scene, chain: ChainTable, family: FamilyTable) -> None:
    """Raises SceneError for families that the chain does not have."""
    if chain.g == 0:
        reason = "the family would be the linear mode at every amplitude"
        raise refusal("[chain] g", repr(chain.g), f"with a [family] a finite number other than 0 ({reason})")
    if abs(chain.gamma) == 1 and scene.stability is not None and scene.stability.vectors:
        reason = "the vectors form Jordan chains that the gauge does not have"
        raise refusal("[stability] vectors", f"true with gamma = {chain.gamma!r}", f"false ({reason})")
    for mode in family.modes(chain.sites):
        _check_gauge(chain, mode)
        _check_frequency(chain, mode)
        _check_period(chain, family, mode)


def check_infinite(scene: Scene) -> None:
    """Refuse requests that need every site of an infinite chain."""
    for name in ("spectrum", "dynamics", "orbit"):
        if getattr(scene, name) is not None:
            raise refusal(f"[{name}]", "with sites = inf", "with a whole number of sites: all of them take part in it")
    if scene.stability is not None and scene.stability.vectors:
        raise refusal("[stability] vectors", "true with sites = inf", "false: all sites take part in them")


def check_long_lattice(scene: Scene) -> None:
    """Refuse requests that need every site of a lattice with a linear tail."""
    names = ("spectrum", "dynamics", "orbit", "equilibrium", "continuation", "search", "export")
    for name in names:
        if getattr(scene, name) is not None:
            raise refusal(f"[{name}]", "with a linear tail (edge, or more than 100000 cells)", "with all sites unknown")
    if scene.stability is not None and scene.stability.vectors:
        raise refusal("[stability] vectors", "true with a linear tail", "false: all sites take part in them")


def _check_gauge(chain: ChainTable, mode: int) -> None:
    """Refuse the modes that have no family at |gamma| = 1, where every coupling acts one way only."""
    only = chain.sites if chain.g > 0 else 1
    if abs(chain.gamma) == 1 and mode != only:
        reason = (
            "at |gamma| = 1 all frequencies meet and only mode N (g > 0) or mode 1 (g < 0), "
            "in which the edge site alone moves, can be followed"
        )
        raise refusal("[family] mode", f"mode {mode} with gamma = {chain.gamma!r}", f"mode {only} ({reason})")


def _check_frequency(chain: ChainTable, mode: int) -> None:
    """Refuse a mode that does not oscillate: omega_j^2 = 2 + alpha - 2 s cos(j pi/(N+1)) <= 0."""
    own = stiffness(chain.sites, chain.gamma, mode)
    if chain.alpha + own <= 0:
        given = f"mode {mode}, which has omega^2 = {chain.alpha + own:.6g} at alpha = {chain.alpha!r}"
        accepted = f"modes with omega^2 > 0; for mode {mode}: alpha > {-own:.12g}"
        raise refusal("[family] mode", given, accepted)
    s = math.sqrt((1 - chain.gamma) * (1 + chain.gamma))
    if chain.sites > 1 and 0 < 4 * s < NARROWEST_BAND * (chain.alpha + own):
        reason = "beside a larger one the modes of the band are the same in doubles"
        accepted = f"with a [family] up to {4 * s / NARROWEST_BAND:.3g} ({reason})"
        raise refusal("[chain] alpha", repr(chain.alpha), accepted)


def _check_period(chain: ChainTable, family: FamilyTable, mode: int) -> None:
    """Refuse an end at a period that the linear mode, where the family starts, has or exceeds."""
    if family.period_max is None:
        return
    linear = 2 * math.pi / math.sqrt(chain.alpha + stiffness(chain.sites, chain.gamma, mode))
    if family.period_max <= linear * (1 + NEAREST):
        accepted = f"a finite number > {linear:.12g} (the period of linear mode {mode})"
        raise refusal("[family] period_max", repr(family.period_max), accepted)


LOWEST_DEGREE = 2  # of families; the same as in orbits.request, which loads numerics


def check_scene(scene: Scene) -> None:
    """Raises SceneError for the first key that does not go with another one."""
    _check_accuracy(scene.accuracy)
    if scene.accuracy.certify and scene.family is None:
        raise refusal("[accuracy] certify", toml_repr(scene.accuracy.certify), "with a [family], else false")
    if scene.model is not None:
        _check_file(scene.model)
    _check_method(scene)
    _check_sought(scene)
    _check_orbit(scene)
    _check_continuation(scene)
    if scene.family is not None:
        _check_modes(scene)
        if scene.chain is not None:
            check_chain_family(scene, scene.chain, scene.family)
        _check_at(scene.family)
        _check_at_periods(scene.family)
    if scene.sites == math.inf:
        check_infinite(scene)
    if scene.lattice is not None and scene.lattice.long:
        check_long_lattice(scene)
    check_dynamics(scene)
    check_search(scene)
    check_export(scene)
    check_figures(scene)


def _check_accuracy(accuracy: AccuracyTable) -> None:
    if accuracy.preset is not None and accuracy.tolerance is not None:
        given = f'preset = "{accuracy.preset}" and tolerance = {accuracy.tolerance!r}'
        raise refusal("[accuracy]", given, "preset or tolerance, one of them or neither")


def _check_file(model: ModelTable) -> None:
    """Refuse names that the file of a model does not have, or lacks."""
    file, name = model.file, model.name
    if "\0" in file:
        raise refusal("[model] file", toml_repr(file), "the name of a file")
    if file.endswith(".json"):
        if name is not None:
            raise refusal("[model] name", f'{toml_repr(name)} with file = "{file}"', "none: the file holds one model")
    elif not file.endswith(".py"):
        raise refusal("[model] file", toml_repr(file), "a name that ends in .py or .json")
    elif name is None:
        raise SceneError("[model] name: missing; accepted: with a Python file the name of the model in it")


def _check_method(scene: Scene) -> None:
    method, transcription = scene.method, scene.methods.transcription
    if scene.family is not None:
        _check_family_method(method)
    if scene.orbit is not None or scene.solution is not None:
        _check_boundary_method(method)
    if method.degree is not None and transcription in (TRIGONOMETRIC, SHOOTING):
        given = f'{method.degree} with transcription = "{transcription}"'
        accepted = " or ".join(f'"{name}"' for name in COLLOCATION_TABLES)
        raise refusal("[method] degree", given, f"with transcription = {accepted} only")
    if method.walker == "series" and transcription not in (None, TRIGONOMETRIC):
        given = f'"series" with transcription = "{transcription}"'
        raise refusal("[method] walker", given, '"arclength", or transcription = "trigonometric"')


def _check_family_method(method: MethodTable) -> None:
    """Refuse methods that families do not have."""
    if method.degree is not None and method.degree < LOWEST_DEGREE:
        accepted = f"with a [family] a whole number >= {LOWEST_DEGREE} and <= 12"
        raise refusal("[method] degree", toml_repr(method.degree), accepted)
    if method.intervals is not None:
        raise refusal("[method] intervals", toml_repr(method.intervals), "beside [orbit] or [solution]")
    if method.flow not in (None, *FLOWS):
        raise refusal("[method] flow", f"{toml_repr(method.flow)} with [family]", one_of(FLOWS))


def _check_boundary_method(method: MethodTable) -> None:
    """Refuse methods that orbits and solutions of boundary-value problems do not have."""
    for name in ("tail", "walker"):
        if getattr(method, name) is not None:
            raise refusal(f"[method] {name}", toml_repr(getattr(method, name)), "beside [family]")
    for name, known in (("transcription", COLLOCATION_TABLES), ("flow", FULL_PERIOD_FLOWS)):
        if getattr(method, name) not in (None, *known):
            raise refusal(f"[method] {name}", f"{toml_repr(getattr(method, name))} without [family]", one_of(known))


def _check_sought(scene: Scene) -> None:
    """One of [family], [orbit], [solution] and [search], and the tables that may stand beside it."""
    sought = [name for name in ("family", "equilibrium", "orbit", "solution") if getattr(scene, name) is not None]
    if len(sought) > 1:
        words = " or ".join(f"[{name}]" for name in sought[:2])
        raise refusal(f"[{sought[1]}]", f"beside [{sought[0]}]", f"{words} in one scene")
    if scene.solution is not None and scene.model is None:
        beside = "[chain]" if scene.lattice is None else "[lattice]"
        raise refusal("[solution]", f"beside {beside}", "beside [model], whose file states a boundary-value problem")
    if scene.solution is not None and scene.model is not None and scene.model.file.endswith(".json"):
        given = f'with file = "{scene.model.file}"'
        raise refusal("[solution]", given, "with a Python file: a saved model is no boundary-value problem")
    table = scene.continuation
    cycles = table is not None and ("hopf" in table.switch or (not table.switch and bool(table.depth)))
    periodic = scene.family is not None or scene.orbit is not None or scene.solution is not None
    if scene.stability is not None and not periodic and not cycles:
        accepted = (
            "beside a [family], an [orbit] or a [solution], or with "
            '"hopf" in [continuation] switch, whose stability it asks for'
        )
        raise refusal("[stability]", "without [family], [orbit] or [solution]", accepted)
    if scene.stability is not None and scene.stability.sites is not None and scene.family is None:
        raise refusal("[stability] sites", f"{scene.stability.sites} without [family]", "beside a [family] of a chain")
    if scene.continuation is not None and not sought:
        accepted = "beside a [family], an [equilibrium], an [orbit] or a [solution], from which it follows"
        raise refusal("[continuation]", "without [family], [equilibrium], [orbit] or [solution]", accepted)
    if scene.equilibrium is not None and scene.method != MethodTable():
        raise refusal("[method]", "beside [equilibrium]", "beside [family], [orbit] or [solution]")


def _check_orbit(scene: Scene) -> None:
    orbit = scene.orbit
    if orbit is None:
        return
    if scene.chain is not None and not orbit.symmetric:
        raise refusal("[orbit] symmetric", "false with [chain]", "true: the orbits of a chain come in families")
    if orbit.period is not None and orbit.transient is not None:
        raise refusal("[orbit]", "period and transient", "period or transient, one of them")
    if orbit.section is not None and orbit.symmetric:
        raise refusal("[orbit] section", "with symmetric = true", "without: the symmetry fixes the phase")
    if orbit.symmetric and orbit.transient is not None:
        reason = "the orbit starts where the symmetry has its phase zero"
        raise refusal("[orbit] transient", "with symmetric = true", f"period ({reason})")


def _check_continuation(scene: Scene) -> None:
    table = scene.continuation
    if table is None:
        return
    for item, value in enumerate(table.at, start=1):
        if value in table.at[: item - 1]:
            raise refusal("[continuation] at", f"{value!r} as item {item} again", "each number once")
    if scene.family is not None:
        _check_of_family(scene, table)
    if table.depth is not None and scene.family is not None:
        raise refusal("[continuation] depth", "beside [family]", "beside [equilibrium], [orbit] or [solution]")
    if "hopf" in table.switch and scene.equilibrium is None and scene.orbit is None:
        beside = "family" if scene.family is not None else "solution"
        raise refusal("[continuation] switch", f'"hopf" beside [{beside}]', '"branch point" and "period doubling"')
    _check_multipliers(scene, table)
    if table.curve is not None and table.curve.further and scene.family is None:
        raise refusal("[continuation] curve", "further = true without [family]", "beside [family]")
    for item, kind in enumerate(table.switch, start=1):
        if kind in table.switch[: item - 1]:
            raise refusal("[continuation] switch", f"{toml_repr(kind)} as item {item} again", "each kind once")
    if table.curve is not None and table.curve.parameter == table.parameter:
        raise refusal("[continuation] curve", f"parameter = {toml_repr(table.parameter)} again", "another parameter")
    if table.parameter == SELECTED and scene.solution is not None:
        raise refusal("[continuation] parameter", toml_repr(SELECTED), "with [orbit] select, whose value it moves")


def _check_multipliers(scene: Scene, table: ContinuationTable) -> None:
    """Refuse to switch where multipliers decide, which nothing computes."""
    if table.depth and not table.switch and scene.orbit is not None and scene.stability is None:
        given = f"{table.depth} beside [orbit] without [stability]"
        raise refusal("[continuation] depth", given, "with [stability]")
    needed = {"period doubling"} | ({"branch point"} if scene.orbit is not None else set())
    for kind in table.switch:
        if kind in needed and scene.stability is None:
            raise refusal("[continuation] switch", f'"{kind}" without [stability]', "with [stability]")
        if kind in needed and scene.equilibrium is not None and "hopf" not in table.switch:
            accepted = 'beside "hopf", whose cycles have period doublings'
            raise refusal("[continuation] switch", f'"{kind}" beside [equilibrium]', accepted)


def _check_of_family(scene: Scene, table: ContinuationTable) -> None:
    """Beside a family branches that leave it are followed in S, and edges of its tongues in a parameter."""
    if table.parameter != AMPLITUDE:
        raise refusal("[continuation] parameter", toml_repr(table.parameter), '"S" beside [family]')
    if not table.switch and table.curve is None:
        raise refusal("[continuation]", "beside [family] without switch or curve", "with one of them, or both")
    for key in ("at", "back_to"):
        if getattr(table, key) not in ((), None):
            raise refusal(f"[continuation] {key}", "beside [family]", "beside [equilibrium], [orbit] or [solution]")
    if scene.stability is None or not scene.stability.events:
        raise refusal("[continuation]", "beside [family] without [stability] events", "with [stability], events = true")
    if not table.to > 0.0:
        raise refusal("[continuation] to", repr(table.to), "a number > 0, which is S, beside [family]")


# Families ------------------------------------------------------------------------------------------------------------


def _check_modes(scene: Scene) -> None:
    """Each mode once; those of a chain are known to be there."""
    seen: set[int | str] = set()
    for mode in scene.modes():
        if scene.sites == math.inf and scene.chain is not None and mode != (-1 if scene.chain.g > 0 else 1):
            g = scene.chain.g
            only = f'"{"last" if g > 0 else "first"}" (of an infinite chain, with g = {g:g})'
            raise refusal(
                "[family] mode", '"last"' if mode == -1 else '"first"' if mode == 1 else toml_repr(mode), only
            )
        if isinstance(mode, int) and mode < 1 and scene.sites != math.inf:
            raise refusal("[family] mode", toml_repr(mode), f"{_modes_there(scene)}, first, last")
        if scene.sites is not None and isinstance(mode, int) and scene.sites != math.inf and mode > scene.sites:
            raise refusal("[family] mode", toml_repr(mode), f"{_modes_there(scene)}, first, last")
        if mode in seen:
            raise refusal("[family] mode", f"{mode} more than once", "each mode once")
        seen.add(mode)


def _modes_there(scene: Scene) -> str:
    return "whole numbers from 1" if scene.sites is None else f"whole numbers from 1 to {scene.sites} (sites)"


def _check_at_periods(family: FamilyTable) -> None:
    longest = math.inf if family.period_max is None else family.period_max
    for key, values in (("at_Omega", family.at_Omega), ("at_period", family.at_period)):
        for item, value in enumerate(values, start=1):
            if value in values[: item - 1]:
                raise refusal(f"[family] {key}", f"{value!r} as item {item} again", "each number once")
            if key == "at_period" and value > longest:
                accepted = f"numbers <= period_max = {longest!r}"
                raise refusal(f"[family] {key}", f"{value!r} as item {item}", accepted)
            if key == "at_Omega" and 2 * math.pi / value > longest:
                accepted = f"numbers >= 2 pi/period_max = {2 * math.pi / longest:.12g}"
                raise refusal(f"[family] {key}", f"{value!r} as item {item}", accepted)


def _check_at(family: FamilyTable) -> None:
    for item, value in enumerate(family.at, start=1):
        if value > family.amplitude_max:
            accepted = f"numbers <= amplitude_max = {family.amplitude_max!r}"
            raise refusal("[family] at", f"{value!r} as item {item}", accepted)
        if item > 1 and value <= family.at[item - 2]:
            given = f"{value!r} as item {item} after {family.at[item - 2]!r}"
            raise refusal("[family] at", given, "numbers in strictly ascending order")
