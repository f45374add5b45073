"""What ties one key of a scene to another, of any scene; bounds of single keys are in the tables."""

import math

from casadi_skin.methods import COLLOCATION_TABLES, SHOOTING, TRIGONOMETRIC
from casadi_skin.scene.chain_checks import check_chain_family, check_infinite
from casadi_skin.scene.faults import SceneError, refusal, toml_repr
from casadi_skin.scene.scene import Scene
from casadi_skin.scene.tables import AccuracyTable, FamilyTable
from casadi_skin.scene.task_checks import check_dynamics, check_export, check_search

SELECTED = "select"


def check_scene(scene: Scene) -> None:
    """Raises SceneError for the first key that does not go with another one."""
    _check_accuracy(scene.accuracy)
    _check_subject(scene)
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
    check_dynamics(scene)
    check_search(scene)
    check_export(scene)


def _check_accuracy(accuracy: AccuracyTable) -> None:
    if accuracy.preset is not None and accuracy.tolerance is not None:
        given = f'preset = "{accuracy.preset}" and tolerance = {accuracy.tolerance!r}'
        raise refusal("[accuracy]", given, "preset or tolerance, one of them or neither")


def _check_subject(scene: Scene) -> None:
    """One of [chain] and [model], and what the file of a model needs."""
    if scene.model is None:
        return
    if scene.chain is not None:
        raise refusal("[chain]", "beside [model]", "[chain] or [model] in one scene")
    file, name = scene.model.file, scene.model.name
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
    method = scene.method
    transcription = method.transcription or (TRIGONOMETRIC if scene.chain is not None and scene.family else None)
    if method.degree is not None and transcription in (TRIGONOMETRIC, SHOOTING):
        given = f'{method.degree} with transcription = "{transcription}"'
        accepted = " or ".join(f'"{name}"' for name in COLLOCATION_TABLES)
        raise refusal("[method] degree", given, f"with transcription = {accepted} only")
    if method.walker == "series" and transcription not in (None, TRIGONOMETRIC):
        given = f'"series" with transcription = "{transcription}"'
        raise refusal("[method] walker", given, '"arclength", or transcription = "trigonometric"')
    boundary = scene.orbit is not None or scene.solution is not None
    if boundary and method.transcription not in (None, *COLLOCATION_TABLES):
        accepted = ", ".join(f'"{name}"' for name in COLLOCATION_TABLES)
        raise refusal("[method] transcription", f'"{method.transcription}" without [family]', accepted)
    for name in ("tail", "walker") if boundary else ("intervals",):
        if getattr(method, name) is not None and (boundary or scene.family is not None):
            where = "beside [family]" if boundary else "beside [orbit] or [solution]"
            raise refusal(f"[method] {name}", toml_repr(getattr(method, name)), where)


def _check_sought(scene: Scene) -> None:
    """One of [family], [orbit], [solution] and [search], and what may stand beside it."""
    sought = [name for name in ("family", "orbit", "solution") if getattr(scene, name) is not None]
    if len(sought) > 1:
        words = " or ".join(f"[{name}]" for name in sought[:2])
        raise refusal(f"[{sought[1]}]", f"beside [{sought[0]}]", f"{words} in one scene")
    if scene.solution is not None and scene.chain is not None:
        raise refusal("[solution]", "beside [chain]", "beside [model], whose file states a boundary-value problem")
    if scene.solution is not None and scene.model is not None and scene.model.file.endswith(".json"):
        given = f'with file = "{scene.model.file}"'
        raise refusal("[solution]", given, "with a Python file: a saved model is no boundary-value problem")
    if scene.stability is not None and scene.family is None and scene.orbit is None:
        kind = "a [family]" if scene.chain is not None else "a [family] or an [orbit]"
        raise refusal(
            "[stability]", f"without {kind.split(maxsplit=1)[1]}", f"beside {kind}, whose stability it asks for"
        )
    if scene.continuation is not None and scene.orbit is None and scene.solution is None:
        raise refusal("[continuation]", "without what it follows", "beside an [orbit] or a [solution]")


def _check_orbit(scene: Scene) -> None:
    orbit = scene.orbit
    if orbit is None:
        return
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
    if table.parameter == SELECTED and scene.solution is not None:
        raise refusal("[continuation] parameter", toml_repr(SELECTED), "with [orbit] select, whose value it moves")


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
