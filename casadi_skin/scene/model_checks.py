"""What ties one key of a scene of a model to another, as far as that shows without the model."""

from collections.abc import Iterable

from casadi_skin.scene.checks import check_accuracy
from casadi_skin.scene.faults import SceneError, refusal, toml_repr
from casadi_skin.scene.model_tables import MODEL_TABLES, SELECTED, ModelScene, OrbitTable
from casadi_skin.scene.tables import TABLES


def check_model_scene(scene: ModelScene) -> None:
    """Raises SceneError for the first key that does not go with another one."""
    check_accuracy(scene.accuracy)
    _check_file(scene)
    _check_tables(scene)
    if scene.orbit is not None:
        _check_orbit(scene.orbit)
    _check_continuation(scene)


def check_model_tables(names: Iterable[str]) -> None:
    """Refuse tables of a model in a scene of a chain, by name."""
    for name in names:
        if name in MODEL_TABLES and name not in TABLES:
            if name == "model":
                raise refusal("[model]", "where a scene of a chain is read", "[chain]")
            raise refusal(f"[{name}]", "without [model]", "beside [model]")


def check_chain_tables(names: Iterable[str]) -> None:
    """Refuse tables of a chain beside [model], by name."""
    for name in names:
        if name in TABLES and name not in MODEL_TABLES:
            accepted = "[chain] or [model] in one scene" if name == "chain" else "beside [chain]"
            raise refusal(f"[{name}]", "beside [model]", accepted)


def _check_file(scene: ModelScene) -> None:
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


def _check_tables(scene: ModelScene) -> None:
    if scene.orbit is not None and scene.solution is not None:
        raise refusal("[solution]", "beside [orbit]", "[orbit] or [solution] in one scene")
    if scene.stability is not None and scene.orbit is None:
        raise refusal("[stability]", "without [orbit]", "beside an [orbit], whose multipliers it asks for")
    if scene.continuation is not None and scene.orbit is None and scene.solution is None:
        raise refusal("[continuation]", "without what it follows", "beside an [orbit] or a [solution]")
    if scene.solution is not None and scene.model.file.endswith(".json"):
        raise refusal("[solution]", f'with file = "{scene.model.file}"', "with a Python file: a saved model is no "
                      "boundary-value problem")  # fmt: skip


def _check_orbit(orbit: OrbitTable) -> None:
    if orbit.period is not None and orbit.transient is not None:
        raise refusal("[orbit]", "period and transient", "period or transient, one of them")
    if orbit.section is not None and orbit.symmetric:
        raise refusal("[orbit] section", "with symmetric = true", "without: the symmetry fixes the phase")
    if orbit.symmetric and orbit.transient is not None:
        reason = "the orbit starts where the symmetry has its phase zero"
        raise refusal("[orbit] transient", "with symmetric = true", f"period ({reason})")


def _check_continuation(scene: ModelScene) -> None:
    table = scene.continuation
    if table is None:
        return
    for item, value in enumerate(table.at, start=1):
        if value in table.at[: item - 1]:
            raise refusal("[continuation] at", f"{value!r} as item {item} again", "each number once")
    selected = scene.orbit is not None and scene.orbit.select is not None
    if table.parameter == SELECTED and scene.solution is not None and not selected:
        raise refusal("[continuation] parameter", toml_repr(SELECTED), "with [orbit] select, whose value it moves")
