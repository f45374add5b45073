"""Orbits found by optimisation, against families, differences, closed forms and the conditions of optimality."""

from __future__ import annotations

import pickle
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from casadi_skin import Chain, follow_family, search_orbit
from casadi_skin.lattice.closed_forms import duffing_frequency
from casadi_skin.optimise.families import Observables
from casadi_skin.optimise.family_search import FamilyNlp, FamilySearch
from casadi_skin.optimise.names import NAMED
from casadi_skin.optimise.nlp import optimality
from casadi_skin.optimise.search import SearchResult, SearchStatus, pareto_front
from casadi_skin.optimise.search_problem import Ending
from casadi_skin.solve.processes import SearchProgress

SHORT = Chain(sites=6, alpha=1.0, gamma=0.3, g=1.0)


def stated(chain: Chain = SHORT, **changes: Any) -> FamilySearch:
    given: dict[str, Any] = {"S": 1.0, "objective": "Omega", "free": ("gamma",), "tolerance": 1e-9}
    return FamilySearch.of(chain, **(given | changes))


def first_point(problem: FamilySearch, harmonics: int) -> tuple[FamilyNlp, np.ndarray]:
    """The programme on a number of harmonics, and the first start's orbit."""
    nlp, start = FamilyNlp(problem, harmonics), problem.starts(1, 0)[0]
    members = problem.members(start.free)
    assert members is not None
    return nlp, nlp.packed(start.free, members)


def search(chain: Chain = SHORT, **changes: Any) -> SearchResult:
    given: dict[str, Any] = {"objective": "Omega", "free": ("gamma",), "starts": 2}
    return search_orbit(chain, **(given | changes))


# The equations and the named quantities ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("g", "gamma"),
    [
        *((1.0, 0.3), (-1.0, -0.3), (1.0, 0.0)),
        *(pytest.param(g, gamma, marks=pytest.mark.slow) for g, gamma in ((1.0, -0.3), (-1.0, 0.3), (-1.0, 0.0))),
    ],
)
def test_quantities_of_an_orbit_are_those_of_its_family(gamma: float, g: float) -> None:
    chain = Chain(6, 1.0, gamma, g)
    problem = stated(chain, objective="Omega_slope", free=("S",), S=0.5)
    nlp, x = first_point(problem, 12)
    (values,) = nlp.values(x)
    assert set(values) == {*NAMED, "alpha_n"}
    h = 0.01
    branch = follow_family(chain, problem.family.mode, 0.5 + h, at=[0.5 - h, 0.5, 0.5 + h], tolerance=1e-11)
    left, orbit, right = (branch.at(S=S) for S in (0.5 - h, 0.5, 0.5 + h))
    y = orbit.profile
    expected = {
        "S": 0.5, "Omega": orbit.Omega, "period": orbit.period, "energy": orbit.energy, "gamma": gamma, "g": g,
        "participation": np.sum(y**2) ** 2 / np.sum(y**4), "alpha": 1.0, "roughness": 0.0,
        "upper_cutoff": np.sqrt(chain.band()[1]), "lower_cutoff": np.sqrt(chain.band()[0]),
        "amplification": ((1 + abs(gamma)) / (1 - abs(gamma))) ** 2.5,
    }  # fmt: skip
    for name, value in expected.items():
        assert abs(values[name] - value) < 1e-9, name
    assert abs(values["Omega_slope"] - (right.Omega - left.Omega) / (2 * h)) < 1e-4
    assert abs(values["energy_slope"] - (right.energy - left.energy) / (2 * h)) < 1e-3
    # An orbit that is solved has residual zero, and its tangent as well.
    assert np.max(np.abs(nlp.residual(x)[nlp.equations])) < 1e-8


def test_derivatives_are_exact() -> None:
    problem = stated(objective="energy_slope", free=("S", "gamma", "alpha", "g"), constraints=[("above_band", 0, 0)])
    (nlp, x), rng = first_point(problem, 6), np.random.default_rng(0)
    lam, way = rng.normal(size=nlp.residual(x).size), rng.normal(size=nlp.size)
    h = 1e-6
    ahead, behind = x + h * way, x - h * way
    moved = (nlp.residual(ahead) - nlp.residual(behind)) / (2 * h)
    np.testing.assert_allclose(nlp.jacobian(x) @ way, moved, rtol=0, atol=1e-6 * np.max(np.abs(moved)))

    def slope(z: np.ndarray) -> np.ndarray:
        return np.asarray(nlp.gradient(z) + nlp.jacobian(z).T @ lam)

    turned = (slope(ahead) - slope(behind)) / (2 * h)
    np.testing.assert_allclose(nlp.hessian(x, lam) @ way, turned, rtol=0, atol=1e-6 * np.max(np.abs(turned)))


# Searches ------------------------------------------------------------------------------------------------------------


def test_one_site_is_duffing() -> None:
    """S at which the frequency is 2: the closed form of Duffing's oscillator, solved here by bisection."""
    bounds = {"S": (0.1, 5), "Omega": (2, 3)}
    result = search_orbit(Chain(1, 1.0, 0.0, 1.0), objective="S", free=("S",), bounds=bounds, starts=2)
    assert result.status is SearchStatus.ON_BOUND
    assert result.best.active == ("Omega >= 2",)
    assert abs(duffing_frequency(3.0, 1.0, amplitude=float(np.sqrt(result.best.S))) - 2.0) < 1e-9


def slope_of(gamma: float) -> float:
    at = 1.0 + 0.01 * np.array([-2.0, -1.0, 1.0, 2.0])
    branch = follow_family(Chain(6, 1.0, gamma, 1.0), "last", at[-1], at=at, tolerance=1e-11)
    a, b, c, d = (branch.at(S=S).Omega for S in at)
    return float((8 * (c - b) - (d - a)) / 0.12)


@pytest.mark.slow
def test_least_slope_is_that_of_plain_families_and_of_the_mirrored_chain() -> None:
    result = search(objective="Omega_slope", bounds={"gamma": (0.2, 0.8)}, starts=3)
    plain = minimize_scalar(slope_of, bounds=(0.2, 0.8), method="bounded", options={"xatol": 1e-6})
    right = result.best
    assert result.status is SearchStatus.FOUND
    assert abs(right.gamma - plain.x) < 1e-4
    assert abs(right.objective - plain.fun) < 1e-7
    assert right.curvature > 0
    mirrored = Chain(6, 1.0, -0.3, 1.0)
    left = search(mirrored, objective="Omega_slope", bounds={"gamma": (-0.8, -0.2)}, starts=1).best
    assert abs(right.gamma + left.gamma) < 1e-6
    assert abs(right.objective - left.objective) < 1e-10
    np.testing.assert_allclose(np.abs(right.orbit.profile), np.abs(left.orbit.profile[::-1]), atol=1e-6)


def test_every_optimum_is_solved_again_as_a_plain_orbit() -> None:
    result = search(objective="participation", bounds={"gamma": (0.1, 0.6), "alpha": (0.5, 2)}, free=("gamma", "alpha"))
    best = result.best
    assert result.status is SearchStatus.ON_BOUND
    assert "gamma <= 0.6" in best.active
    assert best.kkt.largest < 1e-9
    check = best.check
    assert check.converged
    assert abs(check.Omega_difference) < 1e-8
    assert check.residual < 1e-12
    assert check.family_difference is not None
    assert abs(check.family_difference) < 1e-8
    assert best.on_family
    y = best.orbit.evaluate([0.0, best.period / 2])
    np.testing.assert_allclose(y[0], best.orbit.profile)
    np.testing.assert_allclose(y[1], -best.orbit.profile, atol=1e-12)
    assert abs(np.sum(best.orbit.profile**2) - best.S) < 1e-10


def test_wrong_multipliers_are_no_optimum() -> None:
    nlp, x = first_point(stated(objective="participation", bounds={"gamma": (0.1, 0.6)}), 8)
    solution = nlp.solve(x)
    assert optimality(nlp, solution).kkt.largest < 1e-9
    wrong = replace(solution, lam_g=solution.lam_g + np.eye(solution.lam_g.size)[0])
    assert optimality(nlp, wrong).kkt.stationarity > 1e-3


def test_uneven_chain_meets_its_target() -> None:
    """The curve of a uniform chain with alpha = 0.9 and 1.01 of it at the larger S: met within the bounds."""
    plain = follow_family(Chain(6, 0.9, 0.3, 1.0), "last", 0.8, at=[0.3, 0.8])
    target = [plain.at(S=0.3).Omega, plain.at(S=0.8).Omega * 1.001]

    def off_target(orbits: tuple[Observables, ...]) -> ca.SX:
        return ca.vertcat(*(orbit.Omega - value for orbit, value in zip(orbits, target, strict=True)))

    result = search(
        objective="roughness", free=("alpha_n",), bounds={"alpha_n": (0.5, 1.5)}, S=[0.3, 0.8], constraints=[off_target]
    )
    best = result.best
    np.testing.assert_allclose([orbit.Omega for orbit in best.orbits], target, rtol=0, atol=1e-9)
    assert best.on_family is None
    assert 0 < best.objective < 0.1
    # Equations of motion in physical coordinates, at instants that are no nodes.
    for orbit in best.orbits:
        odd = 2 * np.arange(orbit.harmonics) + 1
        theta = np.array([0.1, 0.7, 1.3])
        y = np.cos(np.outer(theta, odd)) @ orbit.cosines
        acceleration = -(np.cos(np.outer(theta, odd)) * (odd * orbit.Omega) ** 2) @ orbit.cosines
        padded = np.pad(y, ((0, 0), (1, 1)))
        force = 1.3 * padded[:, :-2] + 0.7 * padded[:, 2:] - (2 + best.alpha_n) * y - y**3
        assert np.max(np.abs(acceleration - force)) < 1e-6


@pytest.mark.slow
def test_a_pareto_front_is_that_of_plain_families() -> None:
    def plain(gamma: float) -> tuple[float, float]:
        profile = follow_family(Chain(6, 1.0, gamma, 1.0), "last", 1.0, at=[1.0]).at(S=1.0).profile
        return 1 / float(np.sum(profile**4)), 5 * np.arctanh(gamma)

    names, bounds = ("participation", "log_amplification"), {"gamma": (0.1, 0.6)}
    front = pareto_front(SHORT, *names, points=4, free=("gamma",), bounds=bounds, starts=1)
    assert front.complete
    assert np.all(np.diff(front.values[:, 1]) > 0)
    assert np.all(np.diff(front.values[:, 0]) < 0)
    np.testing.assert_allclose(front.values, [plain(optimum.gamma) for optimum in front.points], rtol=0, atol=1e-6)
    others = np.array([plain(gamma) for gamma in np.linspace(0.1, 0.6, 11)])
    assert not np.any(np.all(others[:, None] < front.values - 1e-6, axis=2))


# What a search says of itself ----------------------------------------------------------------------------------------


def test_an_infeasible_search_names_the_constraint() -> None:
    result = search(free=("S",), bounds={"S": (0.1, 1.0), "Omega": (4.0, 5.0)}, constraints=[("energy", 0.0, 100.0)])
    assert result.status is SearchStatus.INFEASIBLE
    assert not result.found
    nearest = follow_family(SHORT, "last", 1.0, at=[1.0]).at(S=1.0).Omega  # Omega grows with S: the end is nearest
    assert result.nearest is not None
    assert result.nearest.worst == "Omega"
    assert abs(result.nearest.gap - (4.0 - nearest)) < 1e-6
    assert "Omega is off by" in result.reason
    with pytest.raises(ValueError, match="no optimum"):
        _ = result.best


def test_an_unbounded_search_says_so() -> None:
    result = search_orbit(Chain(1, 1.0, 0.0, 1.0), objective="S", maximise=True, free=("S",), starts=2)
    assert result.status is SearchStatus.UNBOUNDED
    assert "S = " in result.reason


@pytest.mark.usefixtures("interruptible")
def test_progress_tells_and_an_interruption_keeps_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    import os
    import signal

    told: list[SearchProgress] = []

    def tell(progress: SearchProgress) -> None:
        told.append(progress)
        if progress.start == 2:
            os.kill(os.getpid(), signal.SIGINT)

    result = search(objective="participation", bounds={"gamma": (0.1, 0.6)}, starts=6, progress=tell)
    assert result.status is SearchStatus.INTERRUPTED
    assert [o.ending for o in result.outcomes] == [Ending.CONVERGED, Ending.INTERRUPTED]
    assert result.best.active == ("gamma <= 0.6",)
    assert {p.start for p in told} == {1, 2}
    assert "objective" in str(told[0])


def test_starts_are_the_same_for_the_same_seed_and_lie_in_the_bounds() -> None:
    problem = stated(free=("gamma", "S"), bounds={"gamma": (0.1, 0.6)}, S=2.0)
    starts = problem.starts(20, 3)
    assert starts == problem.starts(20, 3)
    assert starts != problem.starts(20, 4)
    assert starts[0].free == (0.3, 2.0)
    values = np.array([start.free for start in starts])
    assert np.all((values[:, 0] > 0.1) & (values[:, 0] < 0.6))
    assert np.all(values[:, 1] > 0)
    assert pickle.loads(pickle.dumps(problem)) == problem


@pytest.mark.slow
@pytest.mark.parametrize("given", [False, True])
def test_processes_find_what_one_finds(given: bool) -> None:
    options: dict[str, Any] = {"objective": "Omega_slope", "bounds": {"gamma": (0.2, 0.8)}, "starts": 3}
    alone, told = search(**options), list[SearchProgress]()
    if given:
        import multiprocessing

        with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
            together = search(**options, executor=pool)
    else:
        together = search(**options, workers=2, progress=told.append)
    assert together.best.objective == alone.best.objective
    assert together.best.starts == alone.best.starts


# Refusals ------------------------------------------------------------------------------------------------------------


def vector(o: Observables) -> ca.SX:
    return o.y0


def unknown(o: Observables) -> ca.SX:
    return o.Omaga


REFUSED: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"objective": vector}, ValueError, r"objective: given an expression of shape \(6, 1\); accepted: a scalar"),
    ({"objective": unknown}, ValueError, "objective: given Omaga; did you mean Omega"),
    ({"objective": "Omaga"}, ValueError, "did you mean Omega"),
    ({"objective": 3.0}, TypeError, "objective: given 3.0"),
    ({"objective": lambda o: "S"}, TypeError, "accepted: a CasADi expression"),
    ({"objective": lambda o: o.y0 + ca.SX.zeros(5)}, TypeError, "the function given fails"),
    ({"free": ("gama",)}, ValueError, "did you mean gamma"),
    ({"free": ()}, ValueError, "free: given"),
    ({"free": ("alpha", "alpha_n")}, ValueError, "accepted: one of them"),
    ({"bounds": {"gama": (0, 1)}}, ValueError, "did you mean gamma"),
    ({"bounds": {"gamma": (0.6, 0.1)}}, ValueError, "lower <= upper"),
    ({"bounds": {"gamma": (0.3, 0.3)}}, ValueError, "different bounds"),
    ({"bounds": {"gamma": (-0.3, 0.3)}}, ValueError, "one side of 0"),
    ({"bounds": {"gamma": (0.3, 1.0)}}, ValueError, r"\|gamma\| < 1"),
    ({"bounds": {"gamma": (0.3,)}}, TypeError, "a pair"),
    ({"bounds": {"gamma": "ab"}}, TypeError, "a pair"),
    ({"bounds": {"alpha": (0.5, 1)}}, ValueError, "which is not free"),
    ({"bounds": {"gamma": (0.3, float("nan"))}}, ValueError, "nan"),
    ({"constraints": [("Omega", 2.0)]}, TypeError, "constraints, item 1"),
    ({"constraints": [3]}, TypeError, "constraints, item 1"),
    ({"constraints": [("Omaga", 2, 3)]}, ValueError, "did you mean Omega"),
    ({"constraints": [("Omega", 2, 2), ("energy", 1, 1)]}, ValueError, "2 equalities with 1 free"),
    ({"constraints": [vector]}, ValueError, "6 equalities with 1 free"),
    ({"constraints": [lambda o: o.Omega == 2.0]}, ValueError, "given a comparison"),
    ({"objective": lambda o: 1.0}, ValueError, "objective: given the constant 1"),
    ({"S": [0.3, 0.5]}, ValueError, "with a list of S"),
    ({"S": -1.0}, ValueError, "S: given -1.0"),
    ({"mode": 9}, ValueError, "mode: given 9"),
    ({"tolerance": 2.0}, ValueError, "tolerance"),
    ({"starts": 0}, ValueError, "starts: given 0"),
    ({"workers": 0}, ValueError, "workers"),
    ({"workers": 2, "objective": lambda o: o.S}, TypeError, "cannot be sent to a process"),
    ({"executor": 3}, TypeError, "executor"),
]


@pytest.mark.parametrize(("changes", "kind", "words"), REFUSED)
def test_what_cannot_be_meant_is_refused_before_any_solve(
    changes: dict[str, Any], kind: type[Exception], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("something was solved")

    monkeypatch.setattr("casadi_skin.solve.processes.Runner.run", refuse)
    monkeypatch.setattr("casadi_skin.optimise.family_search.FamilySearch.members", refuse)
    with pytest.raises(kind, match=words) as caught:
        search(**changes)
    assert len(str(caught.value).splitlines()) == 1


def test_other_models_and_threads_are_refused() -> None:
    with pytest.raises(TypeError, match="chain_or_model: given 3; accepted: a Chain or an OdeModel"):
        search_orbit(3, objective="S", free=("S",))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="infinite"):
        search_orbit(Chain(np.inf, 1.0, 0.3, 1.0), objective="S", free=("S",))  # type: ignore[arg-type]
    with ThreadPoolExecutor(1) as threads, pytest.raises(TypeError, match="between threads"):
        search(executor=threads)
