"""Step by step flow maps against each other, the matrix exponential and DOP853; errors of mu against finer orbits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from kernels import needs_kernels, numpy_alone
from numpy.typing import NDArray
from scipy.integrate import OdeSolution, solve_ivp
from scipy.linalg import expm
from scipy.optimize import linear_sum_assignment

from casadi_skin import Branch, Chain, OdeModel, Orbit, follow_family
from casadi_skin.follow.family import Family
from casadi_skin.follow.following import Following
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.stability import family_stability, splitting
from casadi_skin.stability.flows import CvodesFlow, FlowError, OrbitState, SteppedFlow, Transition, extrapolation
from casadi_skin.stability.jacobian import JacobianAlong, rows_of
from casadi_skin.stability.multipliers import LARGE_EIGENVALUE_COUNT, couplings, eigenvalue_errors, floquet
from casadi_skin.stability.reduction import Eigensystems, Reflections, eigensystems, half_cosine_errors, half_cosines
from casadi_skin.stability.result import Floquet, ReversibleFloquet
from casadi_skin.stability.splitting import SplittingFlow, SplittingMap
from casadi_skin.zero.request import family_request
from casadi_skin.zero.settings import End, Point
from tests.studies.gauss_flow import GaussFlow, GaussMap
from tests.studies.runge_kutta_flow import RungeKuttaFlow, RungeKuttaMap

Array = NDArray[np.float64]

ORBITS = [(Chain(3, 1.0, 0.3, -1.0), 1, 1.5), (Chain(6, 1.0, -0.3, 1.0), 6, 2.0), (Chain(5, 1.0, 0.0, 1.0), 3, 4.0)]
FLOWS = [SplittingFlow, GaussFlow, RungeKuttaFlow]


@cache
def followed(chain: Chain, mode: int, S: float, tolerance: float = 1e-12) -> Branch:
    return follow_family(chain, mode, S, at=(S,), tolerance=tolerance, corrector="newton")


def state(orbit: Orbit) -> OrbitState:
    return OrbitState(orbit.point.problem, orbit.point.z)


def variational(orbit: Orbit) -> Array:
    """Quarter-period transition matrix of the scaled gauge equations, typed out, by DOP853."""
    chain, n, kappa = orbit.model, orbit.model.sites, orbit.model.g * orbit.S
    w = ((1 + chain.gamma) / (1 - chain.gamma)) ** (np.arange(1, n + 1) - (n if chain.gamma >= 0 else 1))
    s = np.sqrt(1 - chain.gamma**2)
    L = (2 + chain.alpha) * np.eye(n) - s * (np.eye(n, k=1) + np.eye(n, k=-1))

    def field(_: float, x: Array) -> Array:
        q, X = x[:n], x[2 * n :].reshape(2 * n, 2 * n)
        J = -L - 3 * kappa * np.diag(w * q**2)
        return np.concatenate([x[n : 2 * n], -L @ q - kappa * w * q**3, X[n:].ravel(), (J @ X[:n]).ravel()])

    x0 = np.concatenate([orbit.profile / np.sqrt(orbit.S * w), np.zeros(n), np.eye(2 * n).ravel()])
    path = solve_ivp(field, (0, orbit.period / 4), x0, "DOP853", rtol=1e-13, atol=1e-14)
    return np.asarray(path.y[2 * n :, -1].reshape(2 * n, 2 * n))


@dataclass
class Given:
    """A path in time as a problem: flow maps see no more of one than states at phases; z = (Omega, parameter)."""

    path: OdeSolution
    Omega_index: int = 0
    parameter_index: int = 1

    def frequency(self, z: Array) -> float:
        return float(z[0])

    def sample(self, z: Array, theta: Array) -> Array:
        return np.asarray(self.path(theta / z[0]).T)

    def samples(self, z: Array, theta: Array) -> Array:
        return np.stack([self.sample(one, theta) for one in z])

    def sampling(self, theta: Array) -> None:
        return None


# Pieces -------------------------------------------------------------------------------------------------------------


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
    nonzeros = along(states, parameters)
    dense = along.dense(nonzeros)
    for k in (0, 63, 64, 149):
        expected = np.array(ca.DM(exact(states[k], parameters[k])[1]))
        np.testing.assert_allclose(dense[k], expected, rtol=1e-13, atol=1e-14)
    blocks = along.block_matrix(150)
    blocks.data = nonzeros.ravel()
    vectors = generator.normal(size=(150, 5, 2))
    np.testing.assert_allclose(
        (blocks @ vectors.reshape(750, 2)).reshape(150, 5, 2), dense @ vectors, rtol=1e-13, atol=1e-15
    )


@pytest.mark.parametrize("cached", [10**6, 200, 7])
def test_orbits_together_and_columns_by_themselves_change_nothing(cached: int, monkeypatch: pytest.MonkeyPatch) -> None:
    branch = followed(*ORBITS[1])
    first, *others = [state(orbit) for orbit in branch.orbits[1:5]]
    flow = SplittingFlow(branch.space.coordinates.scaled, 1e-8)
    wanted = [(4, [first]), (9, others)]
    with numpy_alone():
        alone = [[flow.matrices(steps, [orbit])[0] for orbit in orbits] for steps, orbits in wanted]
        monkeypatch.setattr(
            splitting, "CACHED_NUMBERS", cached
        )  # 432 numbers of four orbits: all, or each by itself, in columns
        together = flow.several(wanted)
    for found, expected in zip(together, alone, strict=True):
        np.testing.assert_allclose(found, np.stack(expected), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("moving", [150, 30])
@pytest.mark.parametrize("cached", [10**6, 20_000, 3000])
def test_what_kicks_do_not_reach_is_left_out_of_long_chains(
    cached: int, moving: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In 3 steps 34 kicks; columns of all sites from one end to the other, whatever blocks they are taken in.

    Of sites at rest, all but `moving`, columns with the same sites around them are computed once.
    """
    chain, steps = Chain(150, 1.0, 0.2, -1.0), 3
    jacobian = JacobianAlong(chain.gauge_model())
    generator = np.random.default_rng(7)
    flow = SplittingMap(jacobian, steps)
    durations = np.array([1.3])
    states, parameters = generator.normal(size=(flow.fractions.size, 150)), np.full(flow.fractions.size, -0.8)
    states[:, moving:] = 0.0
    nonzeros = jacobian(states, parameters)[None]
    x, v, h = np.eye(150, 300), np.eye(150, 300, 150) * durations[0] / steps, durations[0] / steps

    def kick(i: int, x: Array, v: Array) -> Array:
        return v + h * h * flow.sequence.kicks[i] * (jacobian.dense(nonzeros[0, i]) @ x)

    x, v = flow.sequence.apply(x, v, kick, lambda a, x, v: x + a * v)
    monkeypatch.setattr(splitting, "CACHED_NUMBERS", cached)
    np.testing.assert_allclose(flow(nonzeros, durations)[0], np.vstack([x, v / h]), rtol=1e-11, atol=1e-13)
    widths: list[int] = []
    columns = splitting._columns

    def counted(*arguments: Any) -> Array:
        widths.append(arguments[-1])
        return columns(*arguments)

    monkeypatch.setattr(splitting, "_columns", counted)
    with numpy_alone():
        found = flow(nonzeros, durations)[0]
    np.testing.assert_allclose(found, np.vstack([x, v / h]), rtol=1e-11, atol=1e-13)
    assert sum(widths) == 150 if moving == 150 else sum(widths) < 150 or cached > 3000


@pytest.mark.parametrize("size", [5, 300])
def test_products_of_matrices_with_a_band_are_those_of_full_ones(size: int) -> None:
    generator = np.random.default_rng(8)
    blocks = [np.triu(np.tril(generator.normal(size=(2, size, size)), 40), -17) for _ in range(4)]
    blocks[0][:, :, 140:] = 0.0  # columns of nothing
    transitions = np.block([[blocks[2], blocks[0]], [blocks[1], blocks[3]]])
    np.testing.assert_allclose(half_cosines(transitions), blocks[0].swapaxes(1, 2) @ blocks[1], rtol=0, atol=1e-12)


@needs_kernels
def test_matrices_stored_by_their_bands_are_those_of_a_flow_without_kernel() -> None:
    """Entries and estimated errors along an orbit of 200 sites, and the products that decide its stability."""
    orbit = followed(Chain(200, 1.0, 0.25, 1.0), 200, 0.1, 1e-7).solutions[-1]
    at = replace(state(orbit), better=OrbitState(orbit.point.problem, 1.001 * orbit.point.z))
    model = orbit.space.coordinates.scaled
    (banded,) = SplittingFlow(model, 1e-7).transitions([at], banded=True)
    with numpy_alone():
        (full,) = SplittingFlow(model, 1e-7).transitions([at], banded=True)
    assert full.matrix.shape == (400, 400)
    assert full.pair is not None
    assert full.truncation is not None
    assert banded.matrix.shape[1] < 200
    assert banded.pair is not None
    assert banded.truncation is not None
    assert banded.error == pytest.approx(full.error, rel=1e-6)
    pairs = zip(
        (banded.matrix, banded.truncation, *banded.pair), (full.matrix, full.truncation, *full.pair), strict=True
    )
    for bands, matrix in pairs:
        rows, width = bands.reshape(2, 200, 2, -1), bands.shape[1] // 4
        blocks = [[rows_of(rows[i, :, j][None], 0, 200)[0][:, width:-width] for j in range(2)] for i in range(2)]
        np.testing.assert_allclose(np.block(blocks), matrix, rtol=0, atol=1e-13)
    one, other = (half_cosine_errors(t.matrix[None], t.truncation[None]) for t in (banded, full))  # type: ignore[index]
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-14)
    np.testing.assert_allclose(half_cosines(banded.matrix[None]), half_cosines(full.matrix[None]), rtol=0, atol=1e-13)


def test_extrapolation_cancels_the_errors_it_is_told() -> None:
    steps = np.array([3, 4, 6])
    weights = extrapolation((3, 4, 6), (6, 8))
    np.testing.assert_allclose(weights @ (2.0 + 5.0 * steps**-6.0 - 7.0 * steps**-8.0), 2.0, rtol=1e-14)
    np.testing.assert_allclose(extrapolation((8,), ()), [1.0])


@pytest.mark.parametrize("make", [GaussMap, RungeKuttaMap])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("sites", [1, 4])
def test_constant_coefficients_give_the_matrix_exponential(
    make: type[GaussMap] | type[RungeKuttaMap], order: int, sites: int
) -> None:
    model = Chain(sites, 1.0, 0.3 if sites > 1 else 0.0, 1.0).gauge_model()
    n = model.size
    K = np.array(ca.DM(model.rhs_and_jacobian()(np.zeros(n), 0.0)[1]))
    exact = expm(0.9 * np.block([[np.zeros((n, n)), np.eye(n)], [K, np.zeros((n, n))]]))
    jacobian = JacobianAlong(model if order == 2 else model.first_order())
    flow = make(jacobian, 6 if make is GaussMap else 400, order)
    phases = flow.fractions.size
    nonzeros = jacobian(np.zeros((phases, jacobian.size)), np.zeros(phases))
    (found,) = flow(nonzeros[None], np.array([0.9]))
    np.testing.assert_allclose(found, exact, rtol=0, atol=2e-11)


def test_nodes_lie_where_the_methods_want_them() -> None:
    jacobian = JacobianAlong(Chain(2, 1.0, 0.3, 1.0).gauge_model())
    np.testing.assert_allclose(RungeKuttaMap(jacobian, 2, 2).fractions, [0, 0.25, 0.5, 0.75, 1])
    root = np.sqrt(3) / 6
    np.testing.assert_allclose(
        GaussMap(jacobian, 2, 2, degree=2).fractions,
        [0.25 - root / 2, 0.25 + root / 2, 0.75 - root / 2, 0.75 + root / 2],
    )


def test_banded_and_full_stage_systems_have_the_same_solution() -> None:
    jacobian = JacobianAlong(Chain(60, 1.0, 0.2, -1.0).gauge_model())
    banded, full = GaussMap(jacobian, 3, 2), GaussMap(jacobian, 3, 2)
    assert banded._banded
    full._banded = False
    states = 0.4 * np.random.default_rng(2).normal(size=(2 * banded.fractions.size, 60))
    nonzeros = jacobian(states, np.full(len(states), -0.7)).reshape(2, banded.fractions.size, -1)
    durations = np.array([1.0, 1.4])
    np.testing.assert_allclose(banded(nonzeros, durations), full(nonzeros, durations), rtol=0, atol=1e-12)


# Orders, symplecticity, agreement ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "steps", "order"), [(GaussFlow, 3, 8), (RungeKuttaFlow, 24, 4)])
@pytest.mark.parametrize(("chain", "mode", "S"), ORBITS)
def test_orders_of_convergence(
    kind: type[SteppedFlow], steps: int, order: int, chain: Chain, mode: int, S: float
) -> None:
    orbit = followed(chain, mode, S).at(S)
    exact = SplittingFlow(orbit.space.coordinates.scaled, 1e-13).transition(orbit.point.problem, orbit.point.z).matrix
    flow = kind(orbit.space.coordinates.scaled, 1e-8)
    errors = [np.linalg.norm(flow.matrices(n, [state(orbit)])[0] - exact) for n in (steps, 2 * steps)]
    assert errors[1] > 1e-12
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("steps", [1, 2, 7])
@pytest.mark.parametrize(("chain", "mode", "S"), ORBITS)
def test_gauss_is_symplectic_at_every_number_of_steps(chain: Chain, mode: int, S: float, steps: int) -> None:
    orbit, n = followed(chain, mode, S).at(S), chain.sites
    (Phi,) = GaussFlow(orbit.space.coordinates.scaled, 1e-8).matrices(steps, [state(orbit)])
    J = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    np.testing.assert_allclose(Phi.T @ J @ Phi, J, rtol=0, atol=2e-13)
    (other,) = RungeKuttaFlow(orbit.space.coordinates.scaled, 1e-8).matrices(8, [state(orbit)])
    assert np.abs(other.T @ J @ other - J).max() > 1e-7  # this one is not


@pytest.mark.parametrize("kind", FLOWS)
@pytest.mark.parametrize("tolerance", [1e-4, 1e-7, 1e-10])
@pytest.mark.parametrize(("chain", "mode", "S"), ORBITS)
def test_flows_are_within_their_estimates_of_an_independent_integration(
    chain: Chain, mode: int, S: float, tolerance: float, kind: type[SteppedFlow]
) -> None:
    orbit = followed(chain, mode, S).at(S)
    transition = kind(orbit.space.coordinates.scaled, tolerance).transition(orbit.point.problem, orbit.point.z)
    assert transition.error <= tolerance + 1e-11
    assert np.linalg.norm(transition.matrix - variational(orbit)) <= transition.error + 2e-11
    assert transition.truncation is not None
    assert np.linalg.norm(transition.truncation) <= transition.error


@pytest.mark.slow
def test_every_flow_gives_a_family_the_same_multipliers() -> None:
    chain, tolerance = Chain(4, 1.0, 0.3, -1.0), 1e-8
    a, b = (
        follow_family(chain, 1, 1.5, tolerance=tolerance, corrector="newton", stability=True, events=False, flow=name)
        for name in ("splitting", "cvodes")
    )
    assert b.complete
    np.testing.assert_array_equal(a.stable, b.stable)
    difference = np.abs(a.max_abs_multiplier - b.max_abs_multiplier)
    assert np.all(difference <= a.multiplier_error + b.multiplier_error + 1e-12)


@pytest.mark.parametrize("kind", [GaussFlow, RungeKuttaFlow])
def test_models_of_first_order_that_conserve_nothing(kind: type[SteppedFlow]) -> None:
    """The van der Pol equation and its variational system, typed out, by DOP853 over the time 2 pi/0.9."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    model = OdeModel("van der Pol", x, ca.vertcat(x[1], p * (1 - x[0] ** 2) * x[1] - x[0]), p)

    def field(_: float, y: Array) -> Array:
        a, b = y[:2]
        return np.array([b, 0.7 * (1 - a**2) * b - a])

    def with_variation(_: float, y: Array) -> Array:
        a, b, X = y[0], y[1], y[2:].reshape(2, 2)
        J = np.array([[0, 1], [-1 - 2 * 0.7 * a * b, 0.7 * (1 - a**2)]])
        return np.concatenate([field(0.0, y), (J @ X).ravel()])

    time, start = 2 * np.pi / 0.9, np.array([1.0, 0.5])
    how = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
    exact = solve_ivp(with_variation, (0, time), np.concatenate([start, np.eye(2).ravel()]), **how).y[2:, -1]
    # Dense output is of order 7 only: short steps make it exact.
    path = solve_ivp(field, (0, time), start, max_step=0.02, dense_output=True, **how).sol
    flow = kind(model, 1e-8)
    transition = flow.transition(Given(path), np.array([0.9, 0.7]))  # type: ignore[arg-type]
    assert transition.fraction == 1.0
    assert transition.error <= 1e-8 + 1e-11
    np.testing.assert_allclose(transition.matrix, exact.reshape(2, 2), rtol=0, atol=transition.error + 1e-11)


# Batches and steps ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [*FLOWS, CvodesFlow])
def test_a_batch_is_its_members(kind: type[SteppedFlow] | type[CvodesFlow]) -> None:
    branch = followed(Chain(5, 1.0, 0.3, -1.0), 1, 2.5)
    states = [state(branch.orbits[k]) for k in (0, len(branch) // 2, -1)]
    states[1] = replace(states[1], better=states[0])
    together = kind(branch.space.coordinates.scaled, 1e-7).transitions(states)
    for one, transition in zip(states, together, strict=True):
        alone = kind(branch.space.coordinates.scaled, 1e-7).transition(one.problem, one.z)
        np.testing.assert_allclose(transition.matrix, alone.matrix, rtol=0, atol=alone.error + transition.error)
    assert together[0].pair is None
    assert together[1].pair is not None
    along, better = together[1].pair
    np.testing.assert_allclose(better, together[0].matrix, rtol=0, atol=1e-2)
    np.testing.assert_allclose(along, together[1].matrix, rtol=0, atol=1e-2)
    assert np.abs(along - better).max() > 0.05


@pytest.mark.parametrize("kind", FLOWS)
def test_steps_go_up_and_down_with_the_orbits(kind: type[SteppedFlow], monkeypatch: pytest.MonkeyPatch) -> None:
    branch = followed(Chain(5, 1.0, 0.3, -1.0), 1, 2.5)
    easy = state(branch.orbits[0])
    slow = easy.z.copy()
    slow[easy.problem.Omega_index] *= 0.3  # no orbit, which is not the flow's business
    hard = replace(easy, z=slow)
    used: list[int] = []
    original = kind.several

    def counted(
        self: SteppedFlow, wanted: Sequence[tuple[int, Sequence[OrbitState]]], half_width: int | None = None
    ) -> list[Array]:
        used.extend(steps for steps, _ in wanted)
        return original(self, wanted, half_width)

    monkeypatch.setattr(kind, "several", counted)
    flow, most = kind(branch.space.coordinates.scaled, 1e-8), []
    for orbit in (easy, hard, easy, easy, easy, easy):
        used.clear()
        flow.transitions([orbit])
        most.append(max(used))
    assert most[1] > most[0]
    assert most[0] <= most[-1] < most[1]


def test_rk4_gives_up_by_name_where_its_steps_do_not_suffice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RungeKuttaFlow, "step_numbers", (6, 8, 12, 16))
    orbit = followed(*ORBITS[0]).at(1.5)
    with pytest.raises(FlowError, match=r"the Runge-Kutta method leaves .*e-0\d with 16 steps; requested: 1\.0e-10"):
        RungeKuttaFlow(orbit.space.coordinates.scaled, 1e-10).transition(orbit.point.problem, orbit.point.z)


@pytest.mark.slow
def test_a_walk_in_batches_is_the_walk_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    request = family_request(Chain(6, 1.0, 0.4, -1.0), 1, 2.5, at=(0.5, 2.0), tolerance=1e-8, corrector="newton")
    results = []
    for together in (8, 1):
        monkeypatch.setattr(family_stability, "STABILITY_BATCH", together)
        walk = Following(Family(request), stability=True)
        assert all(isinstance(result, Orbit) for result in walk)
        results.append(walk.branch())
    a, b = results
    assert a.complete
    assert a.changes == b.changes != ()
    np.testing.assert_array_equal(a.S, b.S)
    difference = np.abs(a.max_abs_multiplier - b.max_abs_multiplier)
    assert np.all(difference <= a.multiplier_error + b.multiplier_error)


def test_a_flow_that_fails_within_a_batch_leaves_the_orbits_before(monkeypatch: pytest.MonkeyPatch) -> None:
    request = family_request(Chain(3, 1.0, 0.3, 1.0), 1, 3.0, tolerance=1e-8, corrector="newton")
    original = SplittingFlow.transitions

    def limited(
        self: SplittingFlow, orbits: Sequence[OrbitState], tolerance: float | None = None, banded: bool = False
    ) -> list[Transition]:
        for orbit in orbits:
            if orbit.parameter > 1.234:
                raise FlowError(f"no flow at {orbit.parameter:.3f}")
        return original(self, orbits, tolerance, banded)

    monkeypatch.setattr(SplittingFlow, "transitions", limited)
    walk = Following(Family(request), stability=True)
    orbits = [result for result in walk if isinstance(result, Orbit)]
    whole = [S for S in follow_family(request.model, 1, 3.0, corrector="newton").S if S <= 1.234]
    assert [orbit.S for orbit in orbits] == pytest.approx(whole)
    branch = walk.branch()
    assert branch.end is End.FLOW
    assert branch.detail.startswith("no flow at 1.")
    assert float(branch.detail.split()[-1]) == pytest.approx(
        min(S for S in follow_family(request.model, 1, 3.0, corrector="newton").S if S > 1.234), abs=1e-3
    )


def test_an_interruption_of_the_last_batch_is_not_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    request = family_request(Chain(3, 1.0, 0.3, 1.0), 1, 3.0, tolerance=1e-8, corrector="newton")
    count = len(follow_family(request.model, 1, 3.0, corrector="newton"))
    calls: list[int] = []

    original = Family.floquets

    def interrupted(self: Family, points: Sequence[Point], by: str | None = None) -> list[Floquet]:
        calls.append(len(points))
        if sum(calls) == count:
            raise KeyboardInterrupt
        return original(self, points, by)

    monkeypatch.setattr(Family, "floquets", interrupted)
    walk = Following(Family(request), stability=True)
    with pytest.raises(KeyboardInterrupt):
        for _ in walk:
            pass
    branch = walk.branch()
    assert branch.end is None
    assert len(branch) == count - calls[-1]


# Errors of mu --------------------------------------------------------------------------------------------------------


def test_reflections_are_their_matrices() -> None:
    generator = np.random.default_rng(3)
    directions, matrices = generator.normal(size=(4, 5)), generator.normal(size=(4, 5, 5))
    reflections = Reflections.of(directions)
    for direction, matrix, similar in zip(directions, matrices, reflections.similar(matrices), strict=True):
        u = direction / np.linalg.norm(direction)
        u[0] += np.sign(u[0])
        H = np.eye(5) - 2 * np.outer(u, u) / (u @ u)
        np.testing.assert_allclose(similar, H @ matrix @ H, atol=1e-13)
        np.testing.assert_allclose((H @ direction)[1:], 0.0, atol=1e-13)
    H = np.eye(5) - 2 * np.outer(reflections.u[0], reflections.u[0])
    x = generator.normal(size=4).astype(complex)
    np.testing.assert_allclose(reflections.vector(x), H @ np.append(0.0, x), atol=1e-13)


def test_left_and_right_vectors_belong_together_and_are_infinite_at_a_jordan_block() -> None:
    matrices = np.stack([np.random.default_rng(4).normal(size=(3, 3)), np.diag([1.0, 2.0, 2.0])])
    matrices[1, 1, 2] = 1.0
    systems = eigensystems(matrices)
    np.testing.assert_allclose(systems.left[0] @ systems.right[0], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(matrices[0] @ systems.right[0], systems.right[0] * systems.values[0], atol=1e-12)
    assert np.count_nonzero(systems.values[0].imag) == 2  # a pair of conjugate ones
    coupled = np.abs(systems.left[0] @ matrices[1] @ systems.right[0])
    np.testing.assert_allclose(couplings(systems, matrices[[1, 1]])[0], coupled, atol=1e-12)
    assert np.linalg.norm(systems.left[1, 0]) < 10
    assert np.linalg.norm(systems.left[1, 1]) > 1e12
    errors = np.full((2, 3, 3), 1e-10)
    bounds, _ = eigenvalue_errors(systems, [errors], np.linalg.norm(errors, axis=(1, 2)), np.zeros(2))
    np.testing.assert_allclose(bounds[1, 1:], np.sqrt(3e-10), rtol=1e-12)  # as a defective pair moves


@pytest.mark.parametrize("gap", [1.0, 1e-3, 1e-5])
def test_eigenvalues_that_nearly_meet_move_no_farther_than_their_errors(gap: float) -> None:
    generator = np.random.default_rng(5)
    for _ in range(20):
        X = generator.normal(size=(5, 5))
        matrix = X @ np.diag([-0.2, -0.4, -0.6, -0.8, -0.8 + gap]) @ np.linalg.inv(X)
        change = 1e-7 * generator.normal(size=(5, 5))
        systems: Eigensystems = eigensystems(matrix[None])
        norm = np.array([np.linalg.norm(change)])
        bounds = eigenvalue_errors(systems, [change[None]], norm, np.full(1, 1e-15))[0][0]
        moved = np.linalg.eigvals(matrix + change)
        cost = np.abs(systems.values[0][:, None] - moved)
        rows, columns = linear_sum_assignment(cost)
        assert np.all(cost[rows, columns] <= 1.5 * bounds)
        assert bounds.min() <= 100 * cost[rows, columns].max()


def test_couplings_that_are_left_out_of_large_matrices_do_not_matter() -> None:
    """Beside all couplings of dense matrices with pairs that nearly meet, and with conjugate ones."""
    generator = np.random.default_rng(6)
    size = LARGE_EIGENVALUE_COUNT + 40
    values = np.sort(generator.uniform(-1.0, 0.0, size))
    values[1:20:2] = values[:19:2] + 10.0 ** -np.arange(3.0, 13.0)
    D = np.diag(values)
    for k in range(40, 60, 4):
        D[k, k + 1], D[k + 1, k], D[k + 1, k + 1] = 1e-3, -1e-3, D[k, k]
    X = np.eye(size) + 0.02 * generator.normal(size=(size, size))
    systems = eigensystems(np.stack([X @ D @ np.linalg.inv(X), X.T @ D @ np.linalg.inv(X.T)]))
    assert np.count_nonzero(systems.first) == 10
    parts = [10.0**-k * generator.normal(size=(2, size, size)) for k in (8, 9)]
    norms, round_off = np.full(2, 1e-6), np.full(2, 1e-14)
    found, alone = eigenvalue_errors(systems, parts, norms, round_off)
    W = sum(np.abs(systems.left @ part @ systems.right) for part in parts)
    W = W + (round_off[:, None] * np.linalg.norm(systems.left, axis=2))[:, :, None]
    first = np.diagonal(W, axis1=1, axis2=2)
    distance = np.abs(systems.values[:, :, None] - systems.values[:, None, :]) + np.eye(size)
    product = W * W.swapaxes(1, 2)
    pairs = np.minimum(product / distance, np.sqrt(product)) * (1.0 - np.eye(size))
    total = np.fmin(first + 0.1 * np.max(first, axis=1, keepdims=True) + np.max(pairs, axis=2), 1e-3)
    np.testing.assert_allclose(found, total, rtol=0.011)
    assert np.max(np.max(pairs, axis=2) / first) > 0.5  # some couplings do matter
    own = np.diagonal(np.abs(systems.left @ parts[0] @ systems.right), axis1=1, axis2=2)
    np.testing.assert_allclose(alone, own, rtol=1e-9, atol=1e-20)


@pytest.mark.parametrize("power", [1, 2])
def test_the_error_of_the_multipliers_follows_from_that_of_mu(power: int) -> None:
    def largest(mu: float) -> float:
        """lambda + 1/lambda = 2 + 4 mu, solved for the larger root."""
        half = 1 + 2 * mu
        return float((half + np.sqrt(half**2 - 1)) ** power)

    for mu, error in ((0.2, 1e-6), (1e-8, 4e-9)):
        result = ReversibleFloquet(np.array([-0.3, mu], complex), np.array([1e-7, error]), 0.0, power)
        expected = max(largest(mu + error) - largest(mu), largest(mu) - largest(mu - error))
        assert result.error == pytest.approx(expected, rel=1e-6)
    stable = ReversibleFloquet(np.array([-0.3, -0.9], complex), np.array([1e-7, 1e-9]), 0.0, power)
    assert stable.error == 1e-7
    pair = ReversibleFloquet(np.array([-0.5 + 0.1j, -0.5 - 0.1j]), np.full(2, 1e-6), 0.0, power)
    assert 1e-6 < pair.error < 1e-4
    assert ReversibleFloquet(np.zeros(0, complex), np.zeros(0), 0.0, power).error == 0.0


def exact_floquet(orbit: Orbit) -> ReversibleFloquet:
    """The same orbit at twice its resolution, corrected to round-off, with a flow of many steps."""
    space, problem = orbit.space, orbit.point.problem
    assert isinstance(space, Family)
    fine = space.levels.problem(next(r for r in space.levels.resolutions if r >= max(2 * problem.resolution, 16)))
    z, row = problem.prolong(orbit.point.z, fine), fine.parameter_row()
    for _ in range(2):
        z = NewtonCorrector(fine, 1e-13).correct(z, row, float(row @ z)).z
    better = OrbitState(fine, z)
    transition = SplittingFlow(space.coordinates.scaled, 1e-13).transition(fine, z)
    return floquet(transition, space.accelerations([better])[0])


def random_orbit(generator: np.random.Generator) -> Orbit:
    """A random orbit of a random chain at a random tolerance, at the last point of the family."""
    sites, g = int(generator.integers(2, 31)), float(generator.choice([-1.0, 1.0]))
    chain = Chain(sites, generator.uniform(0, 5), generator.uniform(-0.9, 0.95), g)
    S, tolerance = generator.uniform(0.1, 1.0) ** 2 * (8 if g > 0 else 2.5), 10 ** generator.uniform(-12, -3)
    branch = follow_family(chain, int(generator.integers(1, sites + 1)), S, tolerance=tolerance, corrector="newton")
    return branch.orbits[-1]


def errors_of_random_orbits(number: int, seed: int) -> tuple[Array, Array]:
    """True and estimated errors of the multipliers; checks that no instability is claimed that is not there."""
    generator = np.random.default_rng(seed)
    true, estimated = [], []
    while len(true) < number:
        orbit = random_orbit(generator)
        found, exact = orbit.floquet(), exact_floquet(orbit)
        cost = np.abs(found.mu[:, None] - exact.mu)
        rows, columns = linear_sum_assignment(cost)
        assert found.stable or not exact.stable
        of_largest = 0.0 if found.stable else abs(found.max_abs_multiplier - exact.max_abs_multiplier)
        if max(of_largest, cost[rows, columns].max()) > 1e-14:
            true.append(max(of_largest, cost[rows, columns].max()))
            estimated.append(orbit.multiplier_error)
    return np.array(true), np.array(estimated)


def check_honesty(true: Array, estimated: Array) -> None:
    assert np.count_nonzero(true <= estimated) >= 0.95 * true.size - 0.5
    assert np.all(true <= 10 * estimated)
    assert np.median(estimated / true) < 30


@pytest.mark.parametrize("number", [5, pytest.param(15, marks=pytest.mark.slow)])
def test_the_errors_of_the_multipliers_are_honest(number: int) -> None:
    check_honesty(*errors_of_random_orbits(number, 11))


@pytest.mark.slow
def test_the_errors_of_the_multipliers_are_honest_in_many_cases() -> None:
    check_honesty(*errors_of_random_orbits(120, 12))


def test_without_a_better_orbit_the_points_own_errors_count() -> None:
    """At a tolerance of 1e-3 the orbit's error is by far the larger part."""
    chain = Chain(6, 1.0, -0.3, 1.0)
    orbit = followed(chain, 6, 4.0, 1e-3).orbits[-1]
    bare = Orbit(orbit.space, replace(orbit.point, better=None))
    exact = exact_floquet(orbit)
    true = np.max(np.abs(bare.floquet().mu - exact.mu))
    assert true > 1e-9
    assert true <= bare.multiplier_error <= 1e3 * true
    np.testing.assert_array_equal(bare.floquet().mu, orbit.floquet().mu)
    assert orbit.multiplier_error <= 10 * true


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


def test_resting_sites_have_the_error_of_the_period() -> None:
    branch = follow_family(Chain(3, 1.0, 1.0, 1.0), 3, 2.0, tolerance=1e-4, corrector="newton", stability=True)
    exact = follow_family(Chain(3, 1.0, 1.0, 1.0), 3, 2.0, at=tuple(branch.S[-1:]), tolerance=1e-12, corrector="newton")
    found, true = branch.orbits[-1].floquet(), exact.orbits[-1].floquet()
    assert np.max(np.abs(found.mu - true.mu)) <= branch.orbits[-1].multiplier_error <= 1e-3
