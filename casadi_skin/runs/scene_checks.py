"""Checks that tie one key of a scene to another, of any scene; bounds of single keys are in the tables."""

from __future__ import annotations

import math

from casadi_skin.lattice.stiffness import stiffness
from casadi_skin.model.methods import COLLOCATION_TABLES, FLOWS, FULL_PERIOD_FLOWS, SHOOTING, TRIGONOMETRIC
from casadi_skin.runs.faults import SceneError, refusal, toml_repr
from casadi_skin.runs.model_tables import AMPLITUDE, SELECTED, ContinuationTable, ModelTable
from casadi_skin.runs.scene import Scene
from casadi_skin.runs.scene_tables import AccuracyTable, ChainTable, FamilyTable, MethodTable, one_of
from casadi_skin.runs.task_checks import check_dynamics, check_export, check_figures, check_search

# Checks of the scene of a chain, as far as they need no numerics ------------------------------------------------------

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
