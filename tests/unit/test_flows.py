"""Flow maps against each other, the matrix exponential and DOP853; errors of mu against finer orbits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import casadi as ca
import numpy as np
import pytest
from kernels import numpy_alone
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from variational import integrated

from casadi_skin import Branch, Chain, OdeModel, Orbit, follow_family
from casadi_skin.follow.family import Family
from casadi_skin.follow.follow import BranchRun
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.stability.flows import (
    CvodesFlow,
    FlowError,
    FlowMap,
    JacobianAlong,
    OrbitState,
    SplittingFlow,
    SplittingMap,
    Transition,
    srkn_coefficients,
)
from casadi_skin.stability.multipliers import eigenvalue_errors, floquet
from casadi_skin.stability.reduction import Eigensystems, half_cosines
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.family import family_request
from casadi_skin.zero.settings import End, Point

Array = NDArray[np.float64]

ORBITS = [
    (Chain(3, 1.0, 0.3, -1.0), 1, 1.5), (Chain(6, 1.0, -0.3, 1.0), 6, 2.0),
    (Chain(2, 3.0, 0.8, -1.0), 2, 2.0), (Chain(5, 1.0, 0.0, 1.0), 3, 4.0),
]  # fmt: skip


def dense(jacobian: JacobianAlong, nonzeros: Array) -> Array:
    """J as full matrices, shape (..., non-zeros) -> (..., size, size)."""
    matrices = np.zeros((*nonzeros.shape[:-1], jacobian.size, jacobian.size))
    matrices[..., jacobian.rows(), jacobian.indices] = nonzeros
    return matrices


@cache
def followed(chain: Chain, mode: int, S: float, tolerance: float = 1e-12) -> Branch:
    return follow_family(chain, mode, S, at=(S,), tolerance=tolerance, corrector="newton")


def state(orbit: Orbit) -> OrbitState:
    return OrbitState(orbit.point.problem, orbit.point.z)


def matrix_in(orbit: Orbit, steps: int) -> Array:
    """The transition matrix by the splitting in a number of steps, not extrapolated."""
    return np.asarray(SplittingFlow(orbit.space.coordinates.scaled, 1e-8).matrices([steps], [state(orbit)])[0][0])


def transition_of(kind: type[FlowMap], orbit: Orbit, tolerance: float) -> Transition:
    return kind(orbit.space.coordinates.scaled, tolerance).transition(orbit.point.problem, orbit.point.z)


@cache
def variational(orbit: Orbit) -> Array:
    """Quarter-period transition matrix of the scaled gauge equations, typed out, by DOP853."""
    chain, n, kappa = orbit.model, orbit.model.sites, orbit.model.g * orbit.S
    w = ((1 + chain.gamma) / (1 - chain.gamma)) ** (np.arange(1, n + 1) - (n if chain.gamma >= 0 else 1))
    s = np.sqrt(1 - chain.gamma**2)
    L = (2 + chain.alpha) * np.eye(n) - s * (np.eye(n, k=1) + np.eye(n, k=-1))

    _, (matrix,) = integrated(
        lambda q: -L @ q - kappa * w * q**3, orbit.profile / np.sqrt(orbit.S * w), [orbit.period / 4], 1e-13
    )
    return matrix


# Maps in equal steps ------------------------------------------------------------------------------------------------


def restored(force: Callable[[ca.SX], ca.SX]) -> OdeModel:
    """Five sites, each held by a force of its position and by p times that of its distance to the next."""
    q, v, p = ca.SX.sym("q", 5), ca.SX.sym("v", 5), ca.SX.sym("p")
    bonds = force(ca.vertcat(q[1:], 0) - q)
    return OdeModel("five", q, -force(q) + p * (bonds - ca.vertcat(0, bonds[:-1])), p, order=2, velocity=v)


@pytest.mark.parametrize(
    "model",
    [
        Chain(5, 1.0, 0.3, -1.0).gauge_model(),
        restored(lambda y: y - y**2 + 0.3 * y**3),  # several terms an entry
        restored(lambda y: ca.sin(y)),  # no polynomial
        restored(lambda y: (1.0 + y) ** 9),  # one of more terms than pay
        restored(lambda y: 2.0 * y),  # nothing moves with the state
    ],
    ids=lambda model: str(model.rhs[0])[:20],
)
def test_the_jacobian_along_states_is_the_models(model: OdeModel) -> None:
    along, exact = JacobianAlong(model), model.rhs_and_jacobian()
    generator = np.random.default_rng(1)
    states, parameters = generator.normal(size=(150, 5)), generator.normal(size=150)
    found = dense(along, along(states, parameters))
    for k in (0, 63, 64, 149):
        expected = np.array(ca.DM(exact(states[k], parameters[k])[1]))
        np.testing.assert_allclose(found[k], expected, rtol=1e-13, atol=1e-14)


def test_the_splitting_is_symmetric_and_consistent() -> None:
    a, b = srkn_coefficients()
    assert (a.size, b.size) == (11, 12)
    np.testing.assert_array_equal(a, a[::-1])
    np.testing.assert_array_equal(b, b[::-1])
    assert [a.sum(), b.sum()] == pytest.approx([1.0, 1.0], abs=1e-15)
    with pytest.raises(ValueError, match="use cvodes"):
        SplittingFlow(Chain(2, 1.0, 0.3, 1.0).gauge_model().first_order(), 1e-8)


@pytest.mark.parametrize("moving", [150, 30])
def test_what_kicks_do_not_reach_is_left_out_of_long_chains(moving: int) -> None:
    """In 3 steps 34 kicks; of sites at rest, all but `moving`, columns with the same sites around them are one."""
    jacobian, generator = JacobianAlong(Chain(150, 1.0, 0.2, -1.0).gauge_model()), np.random.default_rng(7)
    flow, durations = SplittingMap(jacobian, 3), np.array([1.3])
    states, parameters = generator.normal(size=(flow.fractions.size, 150)), np.full(flow.fractions.size, -0.8)
    states[:, moving:] = 0.0
    nonzeros = jacobian(states, parameters)[None]
    h = durations[0] / 3

    def kick(i: int, x: Array, v: Array) -> Array:
        return v + h * h * flow.sequence.kicks[i] * (dense(jacobian, nonzeros[0, i]) @ x)

    x, v = flow.sequence.apply(np.eye(150, 300), h * np.eye(150, 300, 150), kick, lambda a, x, v: x + a * v)
    found = [flow(nonzeros, durations)[0]]
    with numpy_alone():
        found.append(flow(nonzeros, durations)[0])
    for one in found:
        np.testing.assert_allclose(one, np.vstack([x, v / h]), rtol=1e-11, atol=1e-13)
    B, C = found[0][:150, 150:], found[0][150:, :150]
    np.testing.assert_allclose(half_cosines(found[0][None])[0], B.T @ C, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("chain", "mode", "S"), [ORBITS[0], (Chain(3, 1.0, 0.3, 1.0), 3, 8.0)])
def test_the_splitting_is_of_order_six(chain: Chain, mode: int, S: float) -> None:
    orbit = followed(chain, mode, S).at(S)
    errors = [np.linalg.norm(matrix_in(orbit, n) - matrix_in(orbit, 192)) for n in (8, 16)]
    assert errors[1] > 1e-12
    assert np.log2(errors[0] / errors[1]) == pytest.approx(6, abs=0.4)


# Errors of flows ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [SplittingFlow, CvodesFlow])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-7, 1e-10])
@pytest.mark.parametrize(("chain", "mode", "S"), [*ORBITS, (Chain(1, 1.0, 0.0, -1.0), 1, 1.0)])  # whose last is soft
def test_flows_are_within_their_estimates_of_an_independent_integration(
    chain: Chain, mode: int, S: float, tolerance: float, kind: type[FlowMap]
) -> None:
    orbit = followed(chain, mode, S).at(S)
    transition = transition_of(kind, orbit, tolerance)
    assert transition.fraction == 0.25
    assert transition.error <= (max(10 * tolerance, 3e-8) if kind is CvodesFlow else tolerance + 1e-11)
    assert np.linalg.norm(transition.matrix - variational(orbit)) <= transition.error + 2e-11
    assert np.linalg.norm(transition.truncation) <= transition.error


# Batches and steps ---------------------------------------------------------------------------------------------------


def test_a_flow_gives_up_by_name_where_its_steps_do_not_suffice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SplittingFlow, "step_numbers", (3, 4, 6))
    orbit = followed(*ORBITS[0]).at(1.5)
    with pytest.raises(FlowError, match=r"the splitting leaves .* with 6 steps; requested: 1\.0e-11"):
        transition_of(SplittingFlow, orbit, 1e-11)
    branch = follow_family(Chain(3, 1.0, 0.3, 1.0), 1, 5.0, tolerance=1e-11, corrector="newton", stability=True)
    assert branch.end is End.FLOW
    assert not branch.complete
    assert End.FLOW.value in branch.reason
    assert "6 steps" in branch.detail


def test_a_flow_that_fails_within_a_batch_leaves_the_orbits_before(monkeypatch: pytest.MonkeyPatch) -> None:
    request = family_request(Chain(3, 1.0, 0.3, 1.0), 1, 3.0, tolerance=1e-8, corrector="newton")
    original = SplittingFlow.transitions

    def limited(
        self: SplittingFlow, orbits: Sequence[OrbitState], tolerance: float | None = None, alike: bool = False
    ) -> list[Transition]:
        for orbit in orbits:
            if orbit.parameter > 1.234:
                raise FlowError(f"no flow at {orbit.parameter:.3f}")
        return original(self, orbits, tolerance, alike)

    monkeypatch.setattr(SplittingFlow, "transitions", limited)
    walk = BranchRun(Family(request), stability=True)
    orbits = [result for result in walk if isinstance(result, Orbit)]
    every = follow_family(request.model, 1, 3.0, corrector="newton").S
    assert [orbit.S for orbit in orbits] == pytest.approx([S for S in every if S <= 1.234])
    branch = walk.branch()
    assert branch.end is End.FLOW
    assert branch.detail.startswith("no flow at 1.")
    assert float(branch.detail.split()[-1]) == pytest.approx(min(S for S in every if S > 1.234), abs=1e-3)


def test_an_interruption_of_the_last_batch_is_not_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    request = family_request(Chain(3, 1.0, 0.3, 1.0), 1, 3.0, tolerance=1e-8, corrector="newton")
    count, original = len(follow_family(request.model, 1, 3.0, corrector="newton")), Family.floquets
    calls: list[int] = []

    def interrupted(self: Family, points: Sequence[Point], by: str | None = None) -> list[Floquet]:
        calls.append(len(points))
        if sum(calls) == count:
            raise KeyboardInterrupt
        return original(self, points, by)

    monkeypatch.setattr(Family, "floquets", interrupted)
    walk = BranchRun(Family(request), stability=True)
    with pytest.raises(KeyboardInterrupt):
        list(walk)
    branch = walk.branch()
    assert (branch.end, branch.reason) == (None, "interrupted")
    assert len(branch) == count - calls[-1]


# Errors of mu --------------------------------------------------------------------------------------------------------


def apart(one: Array, other: Array) -> Array:
    """Distances of numbers from those that they are matched with."""
    cost = np.abs(one[:, None] - other)
    return cost[linear_sum_assignment(cost)]


def test_a_defective_pair_moves_by_the_root_of_the_error() -> None:
    matrix = np.diag([1.0, 2.0, 2.0])
    matrix[1, 2] = 1.0
    ((_, systems),) = Eigensystems.groups(matrix[None])
    errors = np.full((1, 3, 3), 1e-10)
    bounds, _ = eigenvalue_errors(systems, [errors], np.linalg.norm(errors, axis=(1, 2)), np.zeros(1))
    np.testing.assert_allclose(bounds[0, 1:], np.sqrt(3e-10), rtol=1e-12)


@pytest.mark.parametrize("gap", [1.0, 1e-3, 1e-5])
def test_eigenvalues_that_nearly_meet_move_no_farther_than_their_errors(gap: float) -> None:
    generator = np.random.default_rng(5)
    for _ in range(20):
        X = generator.normal(size=(5, 5))
        matrix = X @ np.diag([-0.2, -0.4, -0.6, -0.8, -0.8 + gap]) @ np.linalg.inv(X)
        change = 1e-7 * generator.normal(size=(5, 5))
        ((_, systems),) = Eigensystems.groups(matrix[None])
        norm = np.array([np.linalg.norm(change)])
        bounds = eigenvalue_errors(systems, [change[None]], norm, np.full(1, 1e-15))[0][0]
        moved = apart(systems.values[0], np.linalg.eigvals(matrix + change))
        assert np.all(moved <= 1.5 * bounds)
        assert bounds.min() <= 100 * moved.max()


def exact_floquet(orbit: Orbit) -> Floquet:
    """The same orbit at twice its resolution, corrected to round-off, with a flow of many steps."""
    space, problem = orbit.space, orbit.point.problem
    fine = space.levels.problem(next(r for r in space.levels.resolutions if r >= max(2 * problem.resolution, 16)))
    z, row = problem.prolong(orbit.point.z, fine), fine.parameter_row()
    for _ in range(2):
        z = NewtonCorrector(fine, 1e-13).correct(z, row, float(row @ z)).z
    transition = SplittingFlow(space.coordinates.scaled, 1e-13).transition(fine, z)
    return floquet(transition, space.accelerations([OrbitState(fine, z)])[0])


def random_orbit(generator: np.random.Generator) -> Orbit:
    """A random orbit of a random chain at a random tolerance, at the last point of the family."""
    sites, g = int(generator.integers(2, 31)), float(generator.choice([-1.0, 1.0]))
    chain = Chain(sites, generator.uniform(0, 5), generator.uniform(-0.9, 0.95), g)
    S, tolerance = generator.uniform(0.1, 1.0) ** 2 * (8 if g > 0 else 2.5), 10 ** generator.uniform(-12, -3)
    branch = follow_family(chain, int(generator.integers(1, sites + 1)), S, tolerance=tolerance, corrector="newton")
    return branch.orbits[-1]


@pytest.mark.parametrize(
    ("number", "seed"), [(5, 11), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((15, 11), (120, 12)))]
)
def test_the_errors_of_the_multipliers_are_honest(number: int, seed: int) -> None:
    """And no instability is claimed that is not there."""
    generator = np.random.default_rng(seed)
    found_errors = []
    while len(found_errors) < number:
        orbit = random_orbit(generator)
        found, exact = orbit.floquet(), exact_floquet(orbit)
        assert found.stable or not exact.stable
        of_largest = 0.0 if found.stable else abs(found.max_abs_multiplier - exact.max_abs_multiplier)
        error = max(of_largest, apart(found.mu, exact.mu).max())
        if error > 1e-14:
            found_errors.append((error, orbit.multiplier_error))
    true, estimated = np.array(found_errors).T
    assert np.count_nonzero(true <= estimated) >= 0.95 * true.size - 0.5
    assert np.all(true <= 10 * estimated)
    assert np.median(estimated / true) < 30


def test_a_looser_tolerance_claims_no_instability_that_a_tight_one_denies() -> None:
    """The end breather gains a real instability at S = 0.43174."""
    chain = Chain(24, 1.0, 0.25, -1.0)
    for tolerance in (1e-3, 1e-5, 1e-9):
        branch = follow_family(
            chain, 1, 0.45, at=(0.4, 0.431), tolerance=tolerance, corrector="newton", stability=True, events=False
        )
        assert branch.at(0.4).floquet().stable
        assert branch.at(0.431).floquet().stable
        assert np.all(branch.multiplier_error < 100 * tolerance)
    assert not branch.orbits[-1].floquet().stable
