"""From a scene to a request: the file of its model is run or read, and names and shapes are checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from casadi_skin.model.jumps import JumpError
from casadi_skin.model.loading import ModelFileError, named, read_source, run_file
from casadi_skin.model.ode import OdeModel
from casadi_skin.runs.faults import SceneError, check_known, refusal
from casadi_skin.runs.lattice_tables import LatticeTable
from casadi_skin.runs.model_tables import SELECTED, ContinuationTable, EquilibriumTable, ModelTable
from casadi_skin.runs.request import Request, chain_of, lattice_of
from casadi_skin.runs.scene import Scene
from casadi_skin.runs.states import check_state, values_of

if TYPE_CHECKING:
    pass

Numbers = Sequence[float] | Mapping[str, float]
Files = dict[tuple[Path, str | None], tuple[str, dict[str, Any], Any]]  # text, names and model by file and name
# Where the arguments of a family are in a scene; those of the chain itself are named after its keys.
PLACES = {
    "amplitude_max": "family", "at": "family", "at_Omega": "family", "at_period": "family", "period_max": "family",
    "max_points": "family", "mode": "family", "transcription": "method", "degree": "method", "corrector": "method",
    "walker": "method", "flow": "method", "tail": "method", "intervals": "method", "parameters": "model",
    "sites": "chain", "alpha": "chain", "gamma": "chain", "g": "chain", "tolerance": "accuracy", "certify": "accuracy",
}  # fmt: skip


def bind(scene: Scene, scene_path: Path, files: Files | None = None) -> Request:
    """Make the model of a scene and check the scene against it.

    `files` holds what files of models gave before, and is added to: scenes of one model share it with all that is built
    of it. Raises SceneError, in one line with table and key, or with file and line where the user's code fails.
    """
    if scene.model is not None:
        request = _bound_file(scene, scene.model, scene_path, {} if files is None else files)
    else:
        request = _bound_chain(scene) if scene.lattice is None else _bound_lattice(scene, scene.lattice)
    if scene.orbit is not None:
        from casadi_skin.runs.binding_boundary import check_orbit

        check_orbit(request, scene.orbit)
    if scene.equilibrium is not None:
        _check_equilibrium(request, scene.equilibrium)
    _check_continuation(request)
    _check_jumps(request)
    _check_families(request)
    _check_perturbation(request)
    if scene.spectrum is not None:
        check_spectrum(request)
    return request


def _bound_chain(scene: Scene) -> Request:
    chain = chain_of(scene)
    return Request(scene, chain, {"alpha": chain.alpha, "gamma": chain.gamma, "g": chain.g})


def _bound_lattice(scene: Scene, table: LatticeTable) -> Request:
    try:
        lattice = lattice_of(table)
    except (TypeError, ValueError) as error:
        raise SceneError(f"[lattice] {error}") from None
    if isinstance(lattice, OdeModel):
        return Request(scene, lattice, dict(zip(lattice.parameter_names, lattice.nominal or (), strict=True)))
    return Request(scene, lattice, dict(lattice.parameters))


def _bound_file(scene: Scene, table: ModelTable, scene_path: Path, files: Files) -> Request:
    from casadi_skin.model.saved import loads
    from casadi_skin.zero.boundary_value_problem import BoundaryValueProblem

    path, kinds = scene_path.parent / table.file, (OdeModel, BoundaryValueProblem)
    try:
        if (path, table.name) not in files:
            source = read_source(path)
            names: dict[str, Any] = {} if path.suffix == ".json" else run_file(path, source)
            found = loads(source, str(path)) if table.name is None else named(path, names, table.name, kinds)
            files[path, table.name] = source, names, found
        source, names, found = files[path, table.name]
    except (ModelFileError, ValueError) as error:  # ValueError: a damaged .json file
        raise SceneError(f"[model] {error}") from None
    if isinstance(found, BoundaryValueProblem):
        from casadi_skin.runs.binding_boundary import bound_problem

        return bound_problem(scene, table, path, source, found, names)
    if scene.solution is not None:
        given = f"with {table.name}, an OdeModel"
        raise refusal("[solution]", given, "[orbit], or a BoundaryValueProblem")
    return Request(scene, found, values_of(found, table.parameters), path, source)


def _placed(message: str, table: str = "family") -> str:
    """A message about an argument of a family, with the table that it is in; one about the model with `table`."""
    argument, _, words = message.partition(": ")
    if argument in ("model", "lattice"):
        return f"[{table}]: {words}"
    if argument == "stability_sites":
        return f"[stability] sites: {words}"
    return f"[{PLACES[argument]}] {message}" if argument in PLACES else f"[{table}]: {message}"


def _check_families(request: Request) -> None:
    """Refuse families that cannot be followed, one requested twice, and orbits of families that are not followed."""
    scene = request.scene
    try:
        modes = [family.mode for family in request.families]
    except (TypeError, ValueError) as error:
        raise SceneError(_placed(str(error))) from None
    if scene.accuracy.certify:
        _check_provable(request)
    if not modes:
        return
    for i, mode in enumerate(modes):
        if mode in modes[:i]:
            raise refusal("[family] mode", f"mode {mode} more than once", "each mode once")
    for name, table in (("dynamics", scene.dynamics), ("export", scene.export)):
        if table is not None and table.mode is not None and table.mode not in modes:
            raise refusal(f"[{name}] mode", str(table.mode), f"one of the modes of [family], {modes}")


def _check_provable(request: Request) -> None:
    """Refuse proofs of orbits that the theorem is not about, and all without python-flint."""
    from casadi_skin.certify.certify import provable
    from casadi_skin.follow.family import Family

    try:
        for family in request.families:
            provable(Family(family))
    except (ValueError, ImportError) as error:
        raise SceneError(_placed(str(error))) from None


def _check_jumps(request: Request) -> None:
    """Refuse equilibria and orbits of equations that jump along them; only of such equations they are sought here."""
    scene = request.scene
    if scene.family is not None or not isinstance(request.model, OdeModel) or not request.ode.jumps.by_name:
        return
    if scene.equilibrium is None and scene.orbit is None and scene.solution is None:
        return
    from casadi_skin.runs.first_solution import first_solution

    try:
        first_solution(request)
    except JumpError as error:
        raise SceneError(f"[model] {error}") from None
    except (ArithmeticError, ValueError):  # none is found: the run says why
        return


def _check_perturbation(request: Request) -> None:
    """Refuse a perturbation that the states of the model do not have."""
    table, model, scene = request.scene.dynamics, request.model, request.scene
    if table is not None and scene.family is None and scene.orbit is None:
        from casadi_skin.runs.dynamics import start_near_rest

        try:
            start_near_rest(request)
        except (TypeError, ValueError) as error:
            raise SceneError(f"[dynamics] {error}") from None
        return
    if table is None or not isinstance(model, OdeModel):
        return
    accepted = f"{model.size} numbers" if model.order == 1 else (
        f"{model.size} displacements, or these and {model.size} velocities")  # fmt: skip
    if table.vector is not None and len(table.vector) not in (model.size, model.full_size):
        raise refusal("[dynamics] vector", f"a list of {len(table.vector)}", accepted)
    if table.site is not None and not 1 <= table.site <= model.size:
        names = ", ".join(model.state_names[: model.size])
        raise refusal("[dynamics] site", str(table.site), f"whole numbers from 1 to {model.size} ({names})")


def check_spectrum(request: Request) -> None:
    """Raises SceneError where linear frequencies cannot be shown."""
    from casadi_skin.lattice.spectrum import linear_frequencies

    if request.scene.lattice is not None:  # frequencies that are not real are written as they are
        return
    try:
        linear_frequencies(request.model, request.parameters)
    except ValueError as error:
        if request.scene.chain is not None:
            raise SceneError(f"[chain] alpha: given {request.scene.chain.alpha:g}; {error}") from None
        raise SceneError(_placed(str(error), "spectrum")) from None


def _check_equilibrium(request: Request, table: EquilibriumTable) -> None:
    model = request.equations
    if model.forced:
        raise refusal("[equilibrium]", f"with {model.name}, which is forced", "[orbit], or a model without time")
    check_state("[equilibrium] start", table.start, model.state_names)


def _check_edges(request: Request, table: ContinuationTable) -> None:
    """The parameter in which edges of tongues of families are followed."""
    if table.curve is None:
        return
    name, to = table.curve.parameter, table.curve.to
    check_known("[continuation] curve", name, list(request.parameters))
    if to == request.parameters[name]:
        raise refusal("[continuation] curve", f"to = {to!r}, where it starts", "another number")
    if request.scene.chain is not None and name == "gamma" and abs(to) >= 1:
        raise refusal("[continuation] curve", f"to = {to!r} for gamma", "numbers between -1 and 1")


def _check_continuation(request: Request) -> None:
    table, values = request.scene.continuation, dict(request.parameters)
    if table is None:
        return
    problem = request.problem
    if problem is not None and (problem.optimises or problem.bounds):
        what = "an objective" if problem.optimises else "bounds"
        raise refusal("[continuation]", f"with a problem that has {what}", "a problem without")
    if request.scene.family is not None:
        _check_edges(request, table)
        return
    if SELECTED not in values and request.scene.orbit is not None and request.scene.orbit.select is not None:
        values[SELECTED] = next(iter(request.scene.orbit.select.values()))
    free = () if problem is None else problem.free
    check_known("[continuation] parameter", table.parameter, [name for name in values if name not in free])
    if table.curve is not None:
        check_known("[continuation] curve", table.curve.parameter, [n for n in values if n != table.parameter])
        if table.curve.to == values[table.curve.parameter]:
            raise refusal("[continuation] curve", f"to = {table.curve.to!r}, where it starts", "another number")
    if table.to == values[table.parameter]:
        raise refusal("[continuation] to", f"{table.to!r}, where the branch starts", "another number")
    if request.scene.chain is not None and table.parameter == "gamma" and abs(table.to) > 1:
        raise refusal("[continuation] to", f"{table.to!r} for gamma", "numbers from -1 to 1")
    start = values[table.parameter]
    if table.back_to is not None and not (table.back_to - start) * (table.to - start) < 0.0:
        side = "below" if table.to > start else "above"
        raise refusal("[continuation] back_to", repr(table.back_to), f"a number {side} {start!r}, where it starts")
    low, high = sorted((start if table.back_to is None else table.back_to, table.to))
    for item, value in enumerate(table.at, start=1):
        if not low <= value <= high:
            raise refusal("[continuation] at", f"{value!r} as item {item}", f"numbers from {low!r} to {high!r}")
