"""One case each beside NLvib-py, JaxCont and CAPD, in one run: errors are asserted, times are printed as solves.

    q'' + 0.05 q' + q + 0.1 q^3 = 0.18 cos omega t through its resonance, beside harmonic balance
    van der Pol's cycle from mu = 1 to 3
    a proof that the orbit of 24 sites with S = 1 exists

Run with `pytest -m benchmark -s tests/benchmarks/peers/test_other_cases.py`, one thread. What is not there is skipped:
NLvib-py is installed from its repository (commit 64ad450), jaxcont from PyPI, and CAPD is built from its repository
(commit 7310792) into the folder that CAPD_DIR names. Errors are asked to be below 1e-8, with the settings that were
found cheapest by hand; our tolerance is 1e-8.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from stopwatch import LEAST_OF, least

from casadi_skin import Chain, OdeModel, find_orbit, follow_family

sys.path.append(str(Path(__file__).parents[1]))
from ode_cases import circle, van_der_pol

pytestmark = pytest.mark.benchmark

ASKED, REFERENCE = 1e-8, 1e-11
DAMPING, CUBIC, FORCE, FIRST, LAST = 0.05, 0.1, 0.18, 0.5, 1.6
MU = (1.0, 3.0)
S, RADIUS = 1.0, 1e-12  # of the orbit to prove, of CAPD's box
ORDER = 48  # of its Taylor series: below 47 the ends of the chain do not see each other, and no step has an enclosure


def line(name: str, seconds: float, points: int, unit: float, error: float | None = None) -> None:
    worst = "" if error is None else f", worst error {error:.0e}"
    print(f"  {name:<52} {points:4d} points {seconds / unit:8.0f} units {seconds / unit / points:8.1f} a point{worst}")


def installed(name: str, package: str) -> None:
    if find_spec(package) is None:
        pytest.skip(f"{name}: needs the package {package}")


def duffing() -> OdeModel:
    q, v, omega, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "t"))
    rate = FORCE * ca.cos(omega * t) - DAMPING * v - q - CUBIC * q**3
    return OdeModel("Duffing", [q, v], [v, rate], omega, time=t, forcing_period=2 * ca.pi / omega, nominal=[FIRST])


def by_nlvib(harmonics: int, longest: float, tolerance: float) -> Any:
    """The branch of harmonic balance: coefficients [1, cos, sin, cos 2, sin 2, ...] and omega, a row a point."""
    from nlvib.continuation.solver import ContinuationOptions, ContinuationSolver
    from nlvib.nonlinearities.elements import cubic_spring
    from nlvib.solvers.harmonic_balance import hb_residual
    from nlvib.systems.oscillators import SingleMassOscillator

    system = SingleMassOscillator(m=1.0, d=DAMPING, k=1.0)
    system.add_nonlinear_element(cubic_spring(k3=CUBIC, dof_index=0))
    force = {"dof": 0, "amplitude": FORCE, "harmonic": 1}
    start = np.zeros(2 * harmonics + 1)
    start[1] = FORCE / abs(1 - FIRST**2 + 1j * DAMPING * FIRST)
    options = ContinuationOptions(
        ds_initial=0.02, ds_max=longest, newton_tol=tolerance, lambda_min=0.9 * FIRST, lambda_max=LAST
    )
    return (
        ContinuationSolver()
        .run(lambda x, omega: hb_residual(x, omega, system, harmonics, force), start, FIRST, options)
        .solutions
    )


def missed(start: Sequence[float], omega: float) -> float:
    """Distance from the start after a period, by DOP853: as good beside a fold as elsewhere."""

    def rates(t: float, x: Any) -> list[float]:
        return [x[1], FORCE * np.cos(omega * t) - DAMPING * x[1] - x[0] - CUBIC * x[0] ** 3]

    end = solve_ivp(rates, (0.0, 2 * np.pi / omega), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return float(np.linalg.norm(end - start))


def start_of(solution: Any) -> tuple[list[float], float]:
    """State at t = 0 of a series with coefficients [1, cos, sin, cos 2, sin 2, ...], and its frequency."""
    omega, (mean, *rest) = float(solution[-1]), solution[:-1]
    sines = np.array(rest[1::2])
    return [mean + sum(rest[::2]), omega * np.arange(1, len(sines) + 1) @ sines], omega


def test_a_forced_oscillator_beside_nlvib(unit: float) -> None:
    installed("NLvib-py", "nlvib")
    model = duffing()
    start = find_orbit(model, [0.0, 0.0], tolerance=ASKED)
    print()
    for stability in (False, True):
        seconds, branch = least(partial(start.follow, "omega", LAST, stability=stability))
        assert branch.complete
        assert len(branch.folds) == 2
        worst = max(missed([orbit["q"][0], orbit["v"][0]], orbit["omega"]) for orbit in branch.orbits)
        line(f"this{', multipliers' if stability else ''}", seconds, len(branch), unit, worst)
        assert worst < ASKED
    for longest in (0.5, 0.2):
        seconds, solutions = least(lambda longest=longest: by_nlvib(11, longest, 1e-9))
        steps = [solution for solution in solutions[1:] if solution[-1] <= LAST]  # its start is not corrected
        worst = max(missed(*start_of(solution)) for solution in steps)
        line(f"NLvib-py, 11 harmonics, steps to {longest:g}", seconds, len(solutions), unit, worst)
        assert worst < ASKED


def error_of_period(model: OdeModel, guess: Any, period: float, mu: float) -> float:
    return abs(period / find_orbit(model, guess, period, parameters={"mu": mu}, tolerance=REFERENCE).period - 1.0)


def by_jaxcont(intervals: int, points: int, model: OdeModel, orbit: Any) -> Callable[[], Any]:
    """Its continuation of periodic orbits, compiled as a whole; gives mu and the period at each point."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    import jaxcont
    from jaxcont.core.collocation import Collocation
    from jaxcont.problems.periodic import periodic_orbit_problem

    def rates(u: Any, mu: Any, _: Any) -> Any:
        return jnp.array([u[1], mu * (1 - u[0] ** 2) * u[1] - u[0]])

    times = np.linspace(0.0, orbit.period, 2001)
    states = np.array([orbit.evaluate(t) for t in times])
    mesh = Collocation(ntst=intervals, ncol=points)
    problem = periodic_orbit_problem(rates, jnp.array(states), jnp.array(times), orbit.period, MU[0], mesh)
    settings = jaxcont.ContinuationPar(ds=0.1, ds_max=1.0, max_steps=40, newton_tol=1e-9, compute_stability=False)
    follow = jax.jit(lambda u: jaxcont.continuation(problem.at(u0=u), p_span=MU, settings=settings).branch)

    def branch() -> tuple[Any, Any]:
        found = follow(problem.u0)
        valid = np.asarray(found.valid)
        return np.asarray(found.params)[valid], np.asarray(found.states)[valid, -1]

    return branch


def test_a_cycle_beside_jaxcont(unit: float) -> None:
    installed("JaxCont", "jaxcont")
    model = van_der_pol()
    start = circle(model, 2.0, 6.6, MU[0])
    seconds, branch = least(lambda: start.follow("mu", MU[1]))
    assert branch.complete
    print()
    worst = max(error_of_period(model, orbit, orbit.period, orbit["mu"]) for orbit in branch.orbits)
    line("this", seconds, len(branch), unit, worst)
    assert worst < ASKED
    follow = by_jaxcont(40, 6, model, start)
    first, _ = least(follow, 1)
    seconds, (values, periods) = least(follow)
    worst = max(
        error_of_period(model, branch.at(mu), period, mu)
        for mu, period in zip(values, periods, strict=True)
        if mu <= MU[1]
    )
    line(f"JaxCont, 40 x 6, compiled in {first / unit:.0f} units", seconds, len(values), unit, worst)
    assert worst < ASKED


def processor_of(command: Sequence[str], given: str) -> tuple[float, str]:
    """Least time of the processor of a program in a process of its own, and what it prints."""
    times = []
    for _ in range(LEAST_OF):
        before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        found = subprocess.run(command, input=given, capture_output=True, text=True, check=True).stdout
        times.append(resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before)
    return min(times), found


def test_a_proof_beside_capd(unit: float, tmp_path: Path) -> None:
    """The same orbit by the interval Newton operator of a Poincare map; both enclosures of Omega have it."""
    if not (folder := os.environ.get("CAPD_DIR")):
        pytest.skip("CAPD: CAPD_DIR names no folder that CAPD was installed in")
    orbit = follow_family(Chain(24, 1.0, 0.25, -1.0), mode=1, amplitude_max=S, tolerance=1e-11).at(S=S)
    seconds, certificate = least(orbit.certify)
    assert certificate.proved
    program = tmp_path / "capd_orbit"
    flags = subprocess.run(
        [f"{folder}/bin/capd-config", "--cflags", "--libs"], capture_output=True, text=True, check=True
    ).stdout.split()
    source = Path(__file__).with_name("capd_orbit.cpp")
    subprocess.run(["g++", "-O2", str(source), "-o", str(program), *flags], check=True)
    given = " ".join(f"{value:.17g}" for value in orbit.profile)
    taken, words = processor_of([str(program), f"{S:g}", f"{RADIUS:g}", f"{ORDER}"], given)
    proved, lower, upper, widest = (float(word) for word in words.split())
    ours = certificate.Omega
    print(f"\n  Omega of width {ours[1] - ours[0]:.0e} here, {upper - lower:.0e} by CAPD, y(0) within {widest:.0e}")
    line("this", seconds, 1, unit)
    line(f"CAPD, series of order {ORDER}", taken, 1, unit)
    assert proved == 1
    assert lower <= ours[0]
    assert ours[1] <= upper
