"""The smallest kick against closed forms, brute force over all directions, and runs of other integrators."""

from __future__ import annotations

import math
import multiprocessing
import os
import re
import signal
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import nullcontext
from functools import cache
from typing import Any

import numpy as np
import pytest
from apart import killing
from scipy.optimize import brentq

import casadi_skin.search.kick
from casadi_skin import Chain, Orbit, distance_from_orbit, evolve, follow_family, smallest_kick
from casadi_skin.follow.closed_curve import cosine_curve
from casadi_skin.lattice.closed_forms import Array
from casadi_skin.search.cosine_orbit import CosineOrbit
from casadi_skin.search.kick import KickError, SmallestKick, kick_norm
from casadi_skin.search.kick_nlp import reach
from casadi_skin.solve.processes import SearchProgress


@cache
def breather(sites: int = 6, gamma: float = 0.25, g: float = -1.0, S: float = 0.2, mode: int = 1) -> Orbit:
    chain = Chain(sites, 1.0, gamma, g)
    return follow_family(chain, mode, S, at=[S], tolerance=1e-10, corrector="newton").at(S=S)


@cache
def found(periods: float = 3.0, distance: float = 0.5, norm: str = "physical", starts: int = 4) -> SmallestKick:
    return smallest_kick(breather(), periods * breather().period, distance=distance, norm=norm, starts=starts)


def farthest(orbit: Orbit, kick: Array, time: float) -> float:
    """Largest distance up to `time` by Dormand-Prince in physical coordinates."""
    n = orbit.model.sites
    t = np.linspace(0.0, time, 1 + int(200 * time / orbit.period))
    run = evolve(orbit.model, orbit.profile + kick[:n], kick[n:], t, "dop853", 1e-12, "physical")
    return float(distance_from_orbit(orbit, run).max())


def test_one_site_is_a_distance_between_curves_of_constant_energy() -> None:
    orbit = breather(1, 0.25, 1.0, 0.5)
    kick = smallest_kick(orbit, 1.2 * orbit.period, distance=0.3, starts=2)

    def energy(y: Array, v: Array) -> Array:
        return 0.5 * v**2 + 1.5 * y**2 + 0.25 * y**4

    def level(E: float, points: int) -> Array:
        """Points (y, v) of the curve of energy E, dense everywhere: amplitudes by bisection along rays."""
        angle = np.linspace(0.0, 2 * np.pi, points)
        low, high = np.zeros(points), np.full(points, 3.0)
        for _ in range(40):
            middle = 0.5 * (low + high)
            inside = energy(middle * np.cos(angle), middle * np.sin(angle)) < E
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        return np.stack([low * np.cos(angle), low * np.sin(angle)], axis=1)

    scale = np.array([1.0, orbit.Omega])
    start = np.array([np.sqrt(0.5), 0.0])
    own = float(energy(start[0], start[1]))
    curve = level(own, 1501) / scale

    def excess(E: float) -> float:
        far = level(E, 201) / scale
        return float(np.max(np.min(np.linalg.norm(far[:, None] - curve, axis=2), axis=1))) - 0.3 * np.sqrt(0.5)

    levels = brentq(excess, 0.1 * own, own, xtol=1e-7), brentq(excess, own, 4 * own, xtol=1e-7)
    nearest = min(float(np.min(np.linalg.norm(level(E, 5001) - start, axis=1))) for E in levels)
    assert kick.norm == pytest.approx(nearest, rel=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("periods", "others"), [(2.0, 1), pytest.param(3.0, 5, marks=pytest.mark.slow)])
def test_the_kick_escapes_by_another_integrator_and_its_parts_do_not(periods: float, others: int) -> None:
    kick, orbit = found(periods), breather()
    assert kick.converged
    assert kick.best.strict
    assert kick.kkt < 1e-8
    assert farthest(orbit, kick.best.kick, kick.time) == pytest.approx(0.5, abs=1e-4)
    assert farthest(orbit, 0.98 * kick.best.kick, kick.time) < 0.4999
    assert abs(kick.reached - 0.5) < 1e-6
    assert kick.norm == pytest.approx(np.linalg.norm(np.concatenate([kick.displacements, kick.velocities])), rel=1e-14)
    assert "not proved" in kick.status
    generator = np.random.default_rng(1)
    for spread in (0.1, 0.3, 1.0, 10.0):
        for _ in range(others):
            other = kick.best.kick / kick.norm + spread * generator.normal(size=12) / np.sqrt(12)
            assert farthest(orbit, 0.98 * kick.norm * other / np.linalg.norm(other), kick.time) < 0.5


@pytest.mark.slow
def test_small_distances_are_reached_as_linear_growth_predicts() -> None:
    # What nonlinear terms make of it is one order higher: the relative difference goes with the distance.
    kick = found(2.0, 0.01)
    less, tenth = (1 - k.norm / k.linear_norm for k in (found(2.0, 0.1), kick))
    assert 0 < less < 0.002
    assert less / tenth == pytest.approx(10.0, rel=0.05)
    # The prediction itself, by finite differences of another integrator.
    n, size = 6, 1e-5 / np.linalg.norm(kick.linear_kick)
    z = size * kick.linear_kick
    orbit = breather()
    run = evolve(orbit.model, orbit.profile + z[:n], z[n:], [kick.linear_time], "dop853", 1e-13)
    grown = float(distance_from_orbit(orbit, run)[0])
    assert grown / size == pytest.approx(0.01, rel=1e-3)
    cosine = kick.best.kick @ kick.linear_kick / (kick.norm * kick.linear_norm)
    assert abs(cosine) > 0.99


@pytest.mark.slow
def test_the_far_end_alone_needs_more() -> None:
    time, all_sites = 2.0 * breather().period, found(2.0)
    one = smallest_kick(breather(), time, sites=1, starts=2)
    assert np.all(one.displacements[1:] == 0)
    assert np.all(one.velocities[1:] == 0)
    assert all_sites.norm < one.norm < one.far_end_norm == pytest.approx(all_sites.far_end_norm, rel=1e-9)
    assert farthest(breather(), one.far_end_kick, time) == pytest.approx(0.5, abs=1e-4)


def energy_norm(kick: Array) -> float:
    chain = breather().model
    eta = kick / np.tile(chain.rho, 2)
    padded = np.pad(eta[:6], 1)
    springs = chain.coupling * np.sum(np.diff(padded) ** 2)  # potential energy of neighbours, ends fixed, and on site
    on_site = (2 + chain.alpha - 2 * chain.coupling) * np.sum(eta[:6] ** 2)
    return float(np.sqrt(springs + on_site + np.sum(eta[6:] ** 2)))


@pytest.mark.slow
def test_the_smallest_kick_in_energy_is_another_one() -> None:
    kick, any_kick = found(3.0, 0.5, "energy"), np.random.default_rng(0).normal(size=12)
    for one in (kick.best.kick, any_kick):
        assert kick_norm(breather(), one, "energy") == pytest.approx(energy_norm(one), rel=1e-12)
    assert kick.norm == pytest.approx(energy_norm(kick.best.kick), rel=1e-12)
    assert kick.norm <= kick_norm(breather(), found().best.kick, "energy")
    assert found().norm <= kick_norm(breather(), kick.best.kick, "physical")


def test_reach_is_the_least_radius_of_curvature_of_a_bent_loop() -> None:
    def of(*cosines: list[float]) -> float:
        return reach(cosine_curve(CosineOrbit(None, 1.0, 1.0, np.array(cosines))))

    assert of([0.0, 2.0]) == pytest.approx(2.0, rel=1e-9)
    # y = cos + 0.1 cos 3: at the phase pi/2, y' = -0.7 and y''' = -1.7
    assert of([1.0], [0.1]) == pytest.approx(0.49 / 1.7, rel=1e-3)


@pytest.mark.slow
def test_steps_that_are_too_long_are_halved_until_cvodes_agrees(monkeypatch: pytest.MonkeyPatch) -> None:
    fine, orbit = found(2.0), breather()
    monkeypatch.setattr("casadi_skin.search.kick_nlp.STEP_RADIANS", 2.2)  # 12 steps
    coarse = smallest_kick(orbit, fine.time, starts=1)
    assert abs(coarse.reached - 0.5) < 1e-6
    assert coarse.norm == pytest.approx(fine.norm, rel=1e-4)
    monkeypatch.setattr("casadi_skin.search.kick.MOST_REFINEMENTS", 0)
    with pytest.raises(KickError, match=r"CVODES gives .* in place of 0.5 .* with 12 steps"):
        smallest_kick(orbit, fine.time, starts=1)


@pytest.mark.slow
@pytest.mark.usefixtures("interruptible")
def test_interruption_keeps_the_best_and_progress_is_told() -> None:
    told: list[SearchProgress] = []

    def interrupt_second_start(progress: SearchProgress) -> None:
        told.append(progress)
        if progress.start == 2 and progress.iteration == 1:
            os.kill(os.getpid(), signal.SIGINT)

    kick = smallest_kick(breather(), 2.0 * breather().period, starts=6, progress=interrupt_second_start)
    assert kick.interrupted
    assert kick.status.startswith("interrupted")
    assert kick.tried == 2
    assert kick.norm == pytest.approx(found(2.0).norm, rel=0.05)
    assert told[0].starts == 6
    assert all(math.isfinite(p.objective) and math.isfinite(p.violation) for p in told)


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("name", ["escape", "size_to_escape"])
def test_an_interrupted_check_keeps_the_best(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The comparison with CVODES, and that with the far end."""
    known = found(2.0, starts=1)

    def interrupted(*arguments: Any) -> Any:
        monkeypatch.undo()
        os.kill(os.getpid(), signal.SIGINT)
        return getattr(casadi_skin.search.kick, name)(*arguments)

    monkeypatch.setattr(f"casadi_skin.search.kick.{name}", interrupted)
    kick = smallest_kick(breather(), 2.0 * breather().period, starts=1)
    assert kick.interrupted
    assert kick.norm == pytest.approx(known.norm, rel=0.05)
    if name == "escape":
        assert math.isnan(kick.reached)
        assert "not yet compared with CVODES" in kick.status
        assert kick.far_end_norm == known.far_end_norm
    else:
        assert abs(kick.reached - 0.5) < 1e-6
        assert math.isnan(kick.far_end_norm)


@pytest.mark.slow
@pytest.mark.parametrize("given", [False, True])
def test_processes_find_the_same_optima(given: bool) -> None:
    alone, told = found(), list[SearchProgress]()
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=context) if given else nullcontext() as pool:
        where: dict[str, Any] = {"executor": pool} if given else {"workers": 2}
        kick = smallest_kick(breather(), alone.time, starts=4, progress=told.append, **where)
    assert (kick.tried, kick.interrupted) == (4, False)
    assert [o.name for o in kick.optima] == [o.name for o in alone.optima]
    for one, other in zip(kick.optima, alone.optima, strict=True):
        np.testing.assert_allclose(one.kick, other.kick, rtol=1e-9, atol=1e-9 * alone.norm)
    assert {p.start for p in told} == {1, 2, 3, 4}
    assert str(told[-1]).startswith("4 of 4 starts done")


@pytest.mark.slow
@pytest.mark.parametrize("times", [1, 2])
def test_a_start_whose_worker_is_killed_is_run_again(times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    killed = killing(monkeypatch, times)
    kick = smallest_kick(breather(), found().time, starts=4, workers=2)
    assert (len(killed), kick.tried, kick.interrupted) == (times, 5 - times, False)
    assert kick.norm == pytest.approx(found().norm)
    assert bool(re.search(r"; start [1-4]: its worker ended by signal 9, twice$", kick.status)) is (times == 2)


def test_what_the_progress_callback_raises_arrives() -> None:
    def refuse(progress: SearchProgress) -> None:
        raise LookupError("no place for it")

    with pytest.raises(LookupError, match="no place for it"):
        smallest_kick(breather(), 2.0 * breather().period, starts=2, progress=refuse)


def test_without_an_optimum_the_best_start_is_kept_and_told(monkeypatch: pytest.MonkeyPatch) -> None:
    least = found(2.0, starts=1).norm
    monkeypatch.setattr("casadi_skin.search.kick_nlp.MOST_ITERATIONS", 2)
    kick = smallest_kick(breather(), 2.0 * breather().period, starts=2)
    assert not kick.converged
    assert "no optimum (Ipopt: the iteration did not converge in the steps allowed)" in kick.status
    assert least < kick.norm < 1.1 * least
    assert farthest(breather(), kick.best.kick, kick.time) >= 0.4999


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"time": -1.0}, "time: given -1.0; accepted: above 0"),
    ({"time": 1e6}, "up to 100 periods"),
    ({"distance": 1.5}, "nearest phase of this orbit is unique"),
    ({"distance": 1e-9}, "distance: given 1e-09"),
    ({"norm": "taxi"}, "norm: given 'taxi'; accepted: physical, energy"),
    ({"sites": 7}, "sites: given 7 to 7; accepted: 1 to 6"),
    ({"sites": []}, "sites: given none; accepted: one or more"),
    ({"sites": "1"}, "sites: given '1'; accepted: whole numbers"),
    ({"starts": 0}, "starts: given 0"),
    ({"workers": True}, "workers: given True; accepted: a whole number >= 1"),
    ({"executor": ThreadPoolExecutor(1)}, "accepted: a concurrent.futures.Executor of processes"),
    ({"orbit": Chain(6, 1.0, 0.25, -1.0)}, "orbit: given"),
    ({"orbit": lambda: breather(6, 0.25, -1.0, 2.0)}, "the breather is linearly unstable"),
    ({"orbit": lambda: breather(4, 1.0, 1.0, 0.2, 4)}, "gamma"),
]


@pytest.mark.parametrize(("arguments", "words"), REFUSED)
def test_bad_input_is_refused_in_one_line(arguments: dict[str, Any], words: str) -> None:
    orbit = arguments.get("orbit", breather)
    given = {"time": 10.0} | arguments | {"orbit": orbit() if callable(orbit) else orbit}
    with pytest.raises((ValueError, TypeError), match="accepted") as error:
        smallest_kick(**given)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_no_direction_of_two_sites_escapes_with_less() -> None:
    """All directions of the four-dimensional sphere at once, by Runge-Kutta in physical coordinates."""
    orbit = breather(2, 0.4, 1.0, 0.5, 2)
    time = 1.5 * orbit.period
    kick = smallest_kick(orbit, time, distance=0.4, starts=12)
    gamma, generator = 0.4, np.random.default_rng(3)
    directions = generator.normal(size=(4, 2000))
    directions /= np.linalg.norm(directions, axis=0)
    theta = 2 * np.pi * np.arange(512) / 512
    y = orbit.evaluate(theta / orbit.Omega)
    rate = (orbit.evaluate((theta + 1e-4) / orbit.Omega) - orbit.evaluate((theta - 1e-4) / orbit.Omega)) / 2e-4
    curve = np.hstack([y, rate])

    def field(x: Array) -> Array:
        left = -3 * x[0] + (1 - gamma) * x[1] - x[0] ** 3
        right = -3 * x[1] + (1 + gamma) * x[0] - x[1] ** 3
        return np.stack([x[2], x[3], left, right])

    def largest(sizes: Array) -> Array:
        x = np.concatenate([orbit.profile, [0, 0]])[:, None] + sizes * directions
        steps, best = 120, np.zeros(sizes.size)
        h = time / steps
        for k in range(steps + 1):
            seen = x / np.array([1, 1, orbit.Omega, orbit.Omega])[:, None]
            square = np.sum(seen**2, axis=0)[:, None] - 2 * seen.T @ curve.T + np.sum(curve**2, axis=1)
            best = np.maximum(best, np.sqrt(np.maximum(square.min(axis=1), 0.0)))
            if k < steps:
                a = field(x)
                b = field(x + 0.5 * h * a)
                c = field(x + 0.5 * h * b)
                x = x + h / 6 * (a + 2 * b + 2 * c + field(x + h * c))
        return best / np.sqrt(orbit.S)

    low, high = np.zeros(2000), np.full(2000, 0.6)
    for _ in range(9):
        middle = 0.5 * (low + high)
        escapes = largest(middle) >= 0.4
        low, high = np.where(escapes, low, middle), np.where(escapes, middle, high)
    assert 0.995 * kick.norm < high.min() < 1.03 * kick.norm


@pytest.mark.slow
def test_strong_nonreciprocity_is_solved_as_well() -> None:
    orbit = breather(24, 0.8, -1.0, 0.1)
    kick = smallest_kick(orbit, 5.0 * orbit.period, starts=2)
    assert kick.best.strict
    assert abs(kick.reached - 0.5) < 1e-6
    assert kick.norm < 1e-4 * np.sqrt(orbit.S)
