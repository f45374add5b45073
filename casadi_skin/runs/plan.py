"""The plan of a scene in words: the equations that would be built and solved, and their expected cost.

That of the usual families of a chain is known from the scene alone; numerics are loaded where another one needs them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from casadi_skin.lattice.stiffness import stiffness
from casadi_skin.model import methods
from casadi_skin.runs.output import Lines, listed, named
from casadi_skin.runs.scene import (
    LEAVING,
    ChainTable,
    ContinuationTable,
    EquilibriumTable,
    FamilyTable,
    MethodTable,
    Scene,
)

if TYPE_CHECKING:
    from casadi_skin.follow.family import Family
    from casadi_skin.lattice.lattice import Lattice, LongLattice
    from casadi_skin.model.conserved import SymmetryClass
    from casadi_skin.runs.request import Request
    from casadi_skin.zero.settings import Point

Result = TypeVar("Result")
KNOWN_TABLES = {"chain", "family", "spectrum", "stability"}  # tables whose plan is known from the scene
COMMON_TABLES = {"title", "figures", "accuracy", "method"}  # which any scene has
SMALLEST_SCALED_S, LARGEST_SCALED_S = 1e-100, 1e100  # sizes of g S that are checked no further
TO_MEASURE = "casadi-skin check --measure builds the equations, solves at the start and measures it"
SPECTRUM_LINE = ("spectrum", "linear frequencies and modes")
UNKNOWNS = {
    methods.TRIGONOMETRIC: "positions only, as odd cosines",
    methods.SHOOTING: "positions and velocities, integrated by CVODES",
}
ZERO_SQUARE_RATIO = 1e-13  # of the largest omega^2: smaller ones are 0
MOST_MODES = 600  # whose frequencies a plan computes at once
TYPICAL_SAMPLES = (60, 450)  # orbits of a family that its changes of stability are sought with
MEASURED_POINTS = 8  # at the begin of a family
TYPICAL_POINTS = (15, 150)  # a family, from interior modes of short chains to end modes of long or steep ones


def chain_lines(scene: Scene) -> Lines | None:
    """The plan of a scene of a chain without numerics; None where it is not known without them, or not allowed."""
    chain, family, asked = scene.chain, scene.family, set(scene.given(*Scene.__struct_fields__))
    if chain is None or family is None or not asked <= KNOWN_TABLES | COMMON_TABLES or scene.accuracy.certify:
        return None
    known = MethodTable(corrector=scene.method.corrector, flow=scene.method.flow)
    usual = scene.method == known and known.flow in (None, *methods.FLOWS)
    on_some = scene.stability is not None and scene.stability.sites is not None
    if not usual or on_some or not _has_full_chain(chain, family):
        return None
    if scene.spectrum is not None and chain.alpha + stiffness(chain.sites, chain.gamma, 1) <= 0.0:
        return None
    words = {"symmetry": methods.QUARTER_PERIOD, "coordinates": methods.EVERY_SITE, "sites": int(chain.sites)}
    lines = _family_lines(scene, scene.modes(), scene.methods, **words)  # type: ignore[arg-type]
    spectrum = [SPECTRUM_LINE] if scene.spectrum is not None else []
    return [_chain_line(int(chain.sites), chain.alpha, chain.gamma, chain.g), *spectrum, *lines]


def _has_full_chain(chain: ChainTable, family: FamilyTable) -> bool:
    """Whether all sites are unknowns, as `lattice.chain_coordinates` decides, and no limit of doubles is near."""
    ends = [abs(chain.g) * S for S in (family.amplitude_max, *family.at)]
    sizes = min(ends) >= SMALLEST_SCALED_S and max(*ends, family.amplitude_max) <= LARGEST_SCALED_S
    return chain.sites < methods.PAYS_FROM and abs(chain.gamma) < 1.0 and sizes


def _chain_line(sites: float, alpha: float, gamma: float, g: float) -> tuple[str, str]:
    return "chain", f"N = {sites}, alpha = {alpha:g}, gamma = {gamma:g}, g = {g:g}"


def _family_lines(
    scene: Scene, modes: Sequence[Any], method: Any, *, symmetry: str, coordinates: str, localised: int | None = None,
    sites: int | None = None, measured: Lines | None = None,
) -> Lines:  # fmt: skip
    """Families, their accuracy, methods and stability.

    Arguments:
        scene: the scene.
        modes, method: as they are chosen for its model.
        symmetry, coordinates: words for those of the model.
        localised: sites that localised multipliers begin with, where stability is of that kind.
        sites: those of a chain whose sites are all unknowns.
        measured: lines on the problem, and last one on the cost, where these are measured.
    """
    family, stability, table, cosines = scene.family, scene.stability, scene.continuation, methods.FEWEST_COSINES
    assert family is not None
    wanted = (("S", family.at), ("Omega", family.at_Omega), ("period", family.at_period))
    exactly = "; ".join(f"{name} = {', '.join(f'{v:g}' for v in values)}" for name, values in wanted if values)
    end = f"S = {family.amplitude_max:g}"
    if family.period_max is not None:
        end += f" or a period of {family.period_max:g}, whichever comes first"
    at = f", points exactly at {exactly}" if exactly else ""
    unknowns = UNKNOWNS.get(method.transcription, "positions and velocities")
    lines = [
        ("families", f"j = {', '.join(map(str, modes))}, to {end}{at}; {family.max_points} points at most"),
        ("tolerance", f"{scene.accuracy.relative_tolerance:g}, relative, of Omega and the profile"),
        ("symmetry", symmetry), ("coordinates", coordinates),
        ("transcription", f"{method.transcription}: {unknowns}"), *(measured or [])[:-1],
    ]  # fmt: skip
    if not measured and sites is not None and method.transcription == methods.TRIGONOMETRIC:
        start = f"{cosines * sites + 2} at the start ({cosines} odd cosines a site, Omega and S)"
        lines.append(("unknowns", f"{start}; more where the tolerance asks for it"))
    built = f"scaled model, collocation equations, {scene.method.corrector} corrector"
    if stability is None:
        lines += [("built", built), ("not built", "the variational system: the scene has no [stability]")]
    else:
        what = f"multipliers{' and every change of stability' if stability.events else ''}"
        if localised is not None:
            what = f"localised multipliers, on {localised} sites at the edge or more; waves have theirs in closed form"
            if stability.events:
                lines.append(("changes", "of localised multipliers; weak instabilities of waves depend on the length"))
        lines.append(("built", f"{built}, variational system with the {method.flow} flow for {what}"))
    if family.series is not None:
        lines.append(("series", f"of Omega and the profile to order {family.series}, with the radius of convergence"))
    if scene.accuracy.certify:
        which = "every orbit" if scene.accuracy.certify == "all" else "the orbits asked for"
        lines.append(("proofs", f"of {which}, in balls"))
    if table is not None and table.switch:
        lines.append(("leaving", f"branches at every {' and '.join(table.switch)}, to S = {table.to:g}"))
    if table is not None and table.curve is not None:
        lines.append(("curves", f"edges of tongues in {table.curve.parameter} to {table.curve.to:g}, with S free"))
    return [*lines, measured[-1] if measured else ("cost", TO_MEASURE)]


# Any scene with its model ---------------------------------------------------------------------------------------------


def plan_lines(request: Request, measure: bool) -> Lines:
    """Pairs (subject, text) that describe the work of a run of the request; with `measure` of families the cost too."""
    from casadi_skin.runs.tasks import tasks_of

    scene, lines = request.scene, _model_lines(request)
    nothing = "[family], [equilibrium], [orbit] or [solution]" if scene.chain is None else "family"
    not_built = ("not built", f"any boundary-value problem: the scene asks for no {nothing}")
    if scene.spectrum is not None:
        lines.append(SPECTRUM_LINE)
    if request.families:
        lines += _families(request, measure)
    elif scene.equilibrium is not None:
        lines += _equilibrium_lines(request, scene.equilibrium)
    elif scene.orbit is not None or request.problem is not None:
        lines += _orbit_lines(request) if scene.orbit is not None else _problem_lines(request)
        lines += _solved_lines(request) if scene.given("orbit", "solution") else [not_built]
    elif scene.design is None:
        lines.append(not_built)
    for task in tasks_of(request):
        lines += task.plan()
    if scene.given("family", "design"):
        from casadi_skin.runs.cost import UNCERTAINTY, bytes_of, memory_in_words

        if bytes_of(request):
            lines.append(("memory", f"{memory_in_words(request)} a process, within a factor of {UNCERTAINTY}"))
    return lines if scene.time_limit is None else [*lines, ("time limit", f"{scene.time_limit:g} s")]


def _model_lines(request: Request) -> Lines:
    model = request.model
    if request.scene.chain is not None:
        return [_chain_line(model.sites, model.alpha, model.gamma, model.g)]
    if request.scene.lattice is not None:
        lattice = request.scene.lattice
        return long_lattice_lines(model) if lattice.long else lattice_lines(model, request.parameters)
    words = {
        "time reversal": model.reversal is not None,
        "half-period symmetry": model.half_period is not None,
        "conserved quantity": model.hamiltonian is not None or bool(model.conserved),
        "forced": model.forced,
    }
    declared = ", ".join(word for word, holds in words.items() if holds)
    return [
        ("model", f"{model.name}, from {request.path}"),
        ("states", listed(model.state_names)),
        ("parameters", named(request.parameters) or "none"),
        ("declared", declared or "no symmetry, no conserved quantity"),
    ]


def _families(request: Request, measure: bool) -> Lines:
    from casadi_skin.follow.family import Family

    first, family = request.families[0], Family(request.families[0])
    localised, description = first.coordinates.localised, first.coordinates.description
    full = description == methods.EVERY_SITE and request.scene.chain is not None
    return _family_lines(
        request.scene, [each.mode for each in request.families], first.method, symmetry=family.symmetry.reason,
        coordinates=description, localised=None if localised is None else localised.sites[0],
        sites=int(request.model.sites) if full else None, measured=_measured(request, family) if measure else None,
    )  # fmt: skip


def _measured(request: Request, family: Family) -> Lines:
    """The problem of the first points of the first family, and the cost of all: that of one, times the usual number."""
    from casadi_skin.follow.follow import BranchRun

    def follow() -> list[Point]:
        return [orbit.point for orbit in islice(BranchRun(family), MEASURED_POINTS)]

    stability, families = request.scene.stability, len(request.families)
    points, first = _timed(follow)  # builds
    if not points:
        return [("expected cost", "not known: no step, however short, leads from the linear mode")]
    each = _timed(follow)[1] / len(points)
    building, multipliers, words = max(first - each * len(points), 0.0), 0.0, ""
    if stability is not None:
        _timed(lambda: family.floquets(points[:1]))  # builds the variational system
        multipliers = _timed(lambda: family.floquets(points[-1:]))[1]
        words = f" and {1e3 * multipliers:.2g} ms for its multipliers"
    events = stability is not None and stability.events and family.coordinates.localised is None
    counts = zip(TYPICAL_POINTS, TYPICAL_SAMPLES if events else (0, 0), strict=True)
    low, high = (families * (building + (usual + samples) * (each + multipliers)) for usual, samples in counts)
    of_all = f"{low:.1g} to {high:.1g} s for {families} famil{'y' if families == 1 else 'ies'}"
    of_one = f"{1e3 * building:.0f} ms to build, {1e3 * each:.2g} ms a point{words} (measured now)"
    problem, error = points[0].problem, points[0].error.relative(family.coordinates.frequency)
    sizes = f"{problem.size} at the start ({problem.resolution_in_words()}); {problem.size - 1} equations"
    return [
        ("unknowns", f"{sizes}; more where the tolerance asks for it"),
        ("non-zeros", f"{problem.pattern[0].size} in the Jacobian"),
        ("first error", f"{error:.1e} estimated at the start"),
        ("expected cost", f"{of_one}; {of_all}"),
    ]


def _timed(act: Callable[[], Result]) -> tuple[Result, float]:
    started = time.perf_counter()
    return act(), time.perf_counter() - started


# Lattices -----------------------------------------------------------------------------------------------------------


def lattice_lines(lattice: Lattice, parameters: Mapping[str, float]) -> Lines:
    """The declaration of a lattice, and the properties found in it."""
    declared = lattice.declaration
    size = f"{' x '.join(map(str, declared.cells))} cells of {len(declared.sites)}, {declared.size} sites"
    by_cell = f"; by cell {', '.join(declared.by_cell)}" if declared.by_cell else ""
    return [
        ("lattice", f"{size}, {len(declared.bonds)} bonds a cell; ends {', '.join(declared.boundary)}"),
        ("parameters", (named(parameters) or "none") + by_cell),
        *lattice.structure.lines(),
        ("linear", _linear(lattice, parameters)),
    ]


def _linear(lattice: Lattice, parameters: Mapping[str, float]) -> str:
    """Frequencies about rest without damping and drives, the digits that they lose, and bands and gaps of the cell."""
    import numpy as np

    from casadi_skin.lattice.linear import REAL_SQUARE_RTOL, bands, lattice_modes

    words = []
    if lattice.declaration.size <= MOST_MODES:
        modes = lattice_modes(lattice, parameters)
        squares = modes.squares
        words.append(f"omega {_from_to(squares.real.min(), squares.real.max())}")
        if not modes.real:
            count = int(np.sum(np.abs(squares.imag) > REAL_SQUARE_RTOL * np.max(np.abs(squares))))
            words[0] += f"; {count} of {squares.size} omega^2 are complex: it has no families"
        lost = np.log10(np.max(1.0 / np.abs(np.sum(modes.left * modes.right, axis=0))))
        if lattice.structure.log_weights is None and lost >= 1.0:
            words.append(f"left and right modes differ so that about {lost:.0f} digits of them are lost")
    if not lattice.declaration.differing:
        found = bands(lattice, parameters)
        low, high = found.squares.real.min(axis=0), found.squares.real.max(axis=0)
        ring = "" if lattice.structure.log_weights is not None else "real part of a ring's "
        words.append(f"{ring}bands {', '.join(_from_to(a, b) for a, b in zip(low, high, strict=True))}")
        gaps = [_from_to(a, b) for a, b in found.gaps]
        words.append(f"gaps {', '.join(gaps)}" if gaps else "no gap")
    return "; ".join(words) or f"not computed for more than {MOST_MODES} sites that differ"


def _from_to(low: float, high: float) -> str:
    """Ends of a range of omega^2 as those of omega, imaginary where omega^2 < 0."""
    zero = ZERO_SQUARE_RATIO * max(abs(low), abs(high))
    ends = (f"{math.sqrt(abs(end)):.6g}{'i' if end < -zero else ''}" if abs(end) > zero else "0" for end in (low, high))
    return "from " + " to ".join(ends)


def long_lattice_lines(lattice: LongLattice) -> Lines:
    """A lattice with a linear tail, and the linear modes at its edge."""
    modes = [f"{math.sqrt(mode.square):.6g}{' (pinned to a band)' if mode.pinned else ''}" for mode in lattice.modes]
    edge = "last" if lattice.at_last else "first"
    sites = f"{lattice.cells} cells of {len(lattice.sites)}, {len(lattice.bonds)} bonds a cell"
    return [
        ("lattice", f"{sites}; ends {lattice.boundary}; a linear tail behind the {edge} cells"),
        ("parameters", named(dict(lattice.parameters)) or "none"),
        ("edge modes", ", ".join(modes) or "none"),
    ]


# Equilibria -----------------------------------------------------------------------------------------------------------


def _equilibrium_lines(request: Request, equilibrium: EquilibriumTable) -> Lines:
    from casadi_skin.runs.request import state_of

    model, table = request.equations, request.scene.continuation
    names = model.state_names[: model.size]
    state = named(dict(zip(names, state_of(equilibrium.start, model.state_names), strict=False)))
    where = "near" if equilibrium.transient is None else f"where a simulation for {equilibrium.transient:g} rests, from"
    lines = [("equilibrium", f"{where} {state}"), ("unknowns", f"{model.size}: {listed(names)}")]
    located = [("located", "folds, branch points and Hopf points, with their normal forms")]
    lines += _branch_lines(table, located)
    lines.append(("tolerance", f"{request.tolerance:g}, relative, of each component of the state"))
    return lines


def _branch_lines(table: ContinuationTable | None, located: Lines) -> Lines:
    """A branch, what is located on it, the branches that leave it, and curves in two parameters."""
    if table is None:
        return []
    at = f", points exactly at {', '.join(f'{value:g}' for value in table.at)}" if table.at else ""
    lines = [("branch", f"in {table.parameter} to {table.to:g}{at}; {table.max_points} points at most"), *located]
    if table.switch or table.depth:
        kinds = " and ".join(table.switch or LEAVING)
        deep = "" if table.depth is None else f", {table.depth} deep and {table.limit} branches at most"
        lines.append(("leaving", f"branches at every {kinds}, as far{deep}"))
    if table.curve is not None:
        lines.append(("curves", f"special points in {table.curve.parameter} to {table.curve.to:g}"))
    return lines


# Orbits and solutions -------------------------------------------------------------------------------------------------


def _solved_lines(request: Request) -> Lines:
    """What an orbit and a solution have in common: the branch, the tolerance, unknowns and multipliers."""
    scene = request.scene
    without = ("not built", "multipliers: the scene has no [stability]")
    with_them = ("stability", f"multipliers over the full period at every point, by {scene.methods.flow}")
    return [
        *_branch_lines(scene.continuation, []),
        ("tolerance", f"{request.tolerance:g}, relative, of each state and free parameter"),
        *_unknowns(request),
        without if scene.stability is None else with_them,
    ]


def _symmetry(request: Request) -> SymmetryClass:
    from casadi_skin.model.conserved import SymmetryClass, symmetry_class

    symmetric = request.scene.orbit is not None and request.scene.orbit.symmetric
    return symmetry_class(request.ode) if symmetric else SymmetryClass.FULL


def _orbit_lines(request: Request) -> Lines:
    from casadi_skin.runs.request import state_of

    orbit, model = request.scene.orbit, request.ode
    assert orbit is not None
    start = named(dict(zip(model.state_names, state_of(orbit.start, model.state_names), strict=True)))
    turning = f", but for {named(orbit.rotations)} turns" if orbit.rotations else ""
    if model.forced:
        times = "a period" if orbit.cycles == 1 else f"{orbit.cycles} periods"
        what = f"closes after {times} of the forcing{turning}"
        after = f", after a transient of {orbit.transient:g} or little more" if orbit.transient else ""
        return [("orbit", what), ("guess", f"{times} simulated from {start}{after}")]
    symmetry, selected = _symmetry(request), "" if orbit.select is None else f", selected by {named(orbit.select)}"
    if symmetry.name == "FULL":
        phase = "an integral phase condition" if orbit.section is None else f"phase zero at {named(orbit.section)}"
        what = f"the full period, {phase}{selected}"
        what += ", unfolded by a damping that comes back as zero" if model.hamiltonian is not None else ""
    else:
        what = f"{symmetry.reason}{selected}"
    cut = f"the last cycle of a simulation for {orbit.transient or 0.0:g}"
    guess = cut if orbit.period is None else f"one period of {orbit.period:g}"
    return [("orbit", what + turning), ("guess", f"{guess} from {start}")]


def _problem_lines(request: Request) -> Lines:
    problem = request.problem
    assert problem is not None
    start, end = problem.span(request.parameters.values())
    ends = sum(int(expression.numel()) for expression in problem.conditions)
    integrals = sum(int(expression.numel()) for expression in problem.integrals)
    words = f"t from {start:g} to {end:g}; {ends} conditions at the ends, {integrals} integrals"
    free = f"; free: {', '.join(problem.free)}" if problem.free else ""
    best = "; an objective is minimised" if problem.optimises else ""
    return [("problem", f"{words}{free}{best}")]


def _unknowns(request: Request) -> Lines:
    """States at the ends and stages of the intervals, and free parameters, on the first mesh; their expected cost."""
    from casadi_skin.runs.cost import UNCERTAINTY, cost_of, memory_in_words
    from casadi_skin.zero.orbit import UNFOLDING
    from casadi_skin.zero.stated_problem import PERIOD

    model, problem, cost = request.ode, request.problem, cost_of(request)
    unfolded = model.hamiltonian is not None and _symmetry(request).name == "FULL"
    orbit = () if model.forced else (PERIOD, UNFOLDING) if unfolded else (PERIOD,)
    free = orbit if problem is None else tuple(problem.free)
    also = f"and {', '.join(free)} " if free else ""
    words = f"{cost.seconds:.2g} s and {memory_in_words(request)} for the first solution, within a factor of"
    return [
        ("unknowns", f"{cost.unknowns} state values {also}on {cost.mesh}; more where the tolerance asks for it"),
        ("expected cost", f"{words} {UNCERTAINTY}; more on finer meshes, and each further point about half as long"),
    ]
