"""The table of what any ODE takes, beside AUTO-07p: points with multipliers, whole branches, large systems, a map.

Times are of a processor, in dense 193 x 193 solves. Ours have tolerance 1e-8. AUTO is run where AUTO_DIR names its
folder: for points on 10 to 320 intervals of four points until the period at the end agrees to 1e-8 with ours at 1e-11,
for whole branches on 80, with multipliers at its tolerance of 1e-9; its points depend on its longest step. Evolution,
kick and breather are in test_chain_speed.py, Bratu's problem beside solve_bvp in test_boundary_speed.py. Run with
`pytest -m benchmark -s tests/benchmarks/test_any_ode_speed.py`, one thread.
"""

from __future__ import annotations

import resource
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from maps import tasks
from ode_cases import (
    SMALL,
    OdeCase,
    autocatalator,
    brusselator,
    canard,
    circle,
    detuned_ring,
    hopf_of,
    lorenz,
    morris_lecar,
    neuron,
    synapses,
    van_der_pol,
)
from stopwatch import LEAST_OF, least

from casadi_skin import find_equilibrium, find_orbit, run_map
from casadi_skin.stability.result import LostMultiplierWarning

sys.path += [str(Path(__file__).parent / "peers"), str(Path(__file__).parents[1] / "unit")]
from auto_orbits import AutoOrbits, folder
from test_breathers import SITES, at_the_limit

pytestmark = pytest.mark.benchmark

ASKED, REFERENCE = 1e-8, 1e-11
MESHES = (10, 20, 40, 80, 160, 320)
FIRST_STEP = 0.01
EXAMPLES = Path(__file__).parents[2] / "examples"


def line(name: str, seconds: float, points: int, unit: float, aim: float | None = None, words: str = "") -> None:
    units, wanted = seconds / unit, "" if aim is None else f"  (aim {aim:g})"
    print(f"  {name:<44} {points:5d} points {units:9.0f} units {units / points:8.1f} a point{wanted}  {words}")


@pytest.mark.parametrize("case", SMALL, ids=lambda case: case.name)
def test_a_point_with_multipliers(case: OdeCase, unit: float, tmp_path: Path) -> None:
    model = case.model()
    start = case.start(model)
    seconds, branch = least(lambda: start.follow(case.parameter, case.to, stability=True))
    assert branch.complete
    assert branch.values[-1] == case.to
    print()
    line(case.name, seconds, len(branch.values), unit, case.aim)
    last = branch.orbits[-1]
    values = {case.parameter: case.to}
    exact = find_orbit(model, last, last.period, parameters=values, tolerance=REFERENCE).period
    assert abs(branch.period[-1] / exact - 1.0) <= ASKED
    if folder() is None:
        return
    first, value = branch.orbits[1], float(branch.values[1])
    auto = AutoOrbits(model, tmp_path, first, value)
    for intervals in MESHES:
        follow = partial(auto.follow, case.to, value, intervals, FIRST_STEP, case.longest)
        found = min((follow() for _ in range(LEAST_OF)), key=lambda branch: branch.seconds)
        if abs(found.period / exact - 1.0) <= ASKED:
            break
    line(f"AUTO-07p, {intervals} x 4, {found.period / exact - 1.0:.0e}", found.seconds, found.points, unit)


def test_equilibria(unit: float) -> None:
    rest = find_equilibrium(lorenz(), [7.1, 7.1, 19.0], parameters={"r": 20.0})
    seconds, branch = least(lambda: rest.follow("r", 28.0))
    print()
    line("equilibria of Lorenz", seconds, len(branch.values), unit, 3.0)


def second_hopf() -> Any:
    return hopf_of(autocatalator(), [0.1] * 3, 1e-3, 0.3, 1)


def through_the_canard() -> Any:
    return hopf_of(autocatalator(), [0.1] * 3, 1e-3, 0.3)


def breather() -> Any:
    return at_the_limit(np.ones(SITES))


# What is followed, in which parameter, to where, and the aim in units for all points.
BRANCHES: dict[str, tuple[Callable[[], Any], str, float, dict[str, Any], float | None]] = {
    "canard": (lambda: hopf_of(canard(), [1.1, -0.6], 1.1, 0.9), "a", 0.5, {}, 3000),
    "autocatalator from its second Hopf point": (second_hopf, "mu", 0.0374, {}, 1000),
    "autocatalator through its canard": (through_the_canard, "mu", 0.17443577, {}, 6000),
    "bursts": (lambda: hopf_of(neuron(), [-1.5, -10.0, 0.0], 0.0, 4.0), "I", 2.1, {}, 13000),
    "synapses": (
        lambda: hopf_of(synapses(), [0.2386, 0.9827, 0.3679], -2.0, -0.9, -1),
        "E0",
        -5.0,
        {"period_max": 30.0},
        6700,
    ),
    "van der Pol to mu = 1000": (lambda: circle(van_der_pol(), 2.0, 6.6, 1.0), "mu", 1000.0, {}, None),
    "breather": (breather, "C", 0.15, {}, None),
    "breather at its period": (breather, "C", 0.15, {"fixed": "period"}, None),
}


@pytest.mark.parametrize("name", BRANCHES)
def test_whole_branches(name: str, unit: float, tmp_path: Path) -> None:
    """Without multipliers, as they are followed by default; from the anticontinuous limit 15 points are the aim."""
    start_of, parameter, to, options, aim = BRANCHES[name]
    start = start_of()
    seconds, branch = least(lambda: start.follow(parameter, to, **options), 1)
    print()
    line(name, seconds, len(branch.values), unit, aim, branch.reason[:60])
    assert branch.complete or "without bound" in branch.reason or "Hopf point" in branch.reason
    if folder() is not None and not options and "breather" not in name:
        first, value = branch.orbits[1], float(branch.values[1])
        auto = AutoOrbits(first.model, tmp_path, first, value).follow(to, value, 80, 1e-4, 10.0)
        line(f"AUTO-07p, 80 x 4, to {auto.value:.6g}", auto.seconds, auto.points, unit)


def test_a_fold_curve(unit: float) -> None:
    hopf = hopf_of(morris_lecar(), [-60.0, 0.0], 0.0, 300.0, phi=0.04)
    (fold,) = [point for point in hopf.follow("I", 50.0).special_points if point.kind == "fold"]
    seconds, curve = least(lambda: fold.curve("phi", 0.2))
    print()
    line("fold curve of Morris and Lecar", seconds, len(curve), unit)
    assert curve.complete


def rest_of_brusselator(cells: int) -> Any:
    return find_equilibrium(brusselator(cells), [2.0] * cells + [2.0] * cells, parameters={"B": 4.0})


def test_multipliers_of_200_states(unit: float) -> None:
    (hopf, *_) = [p for p in rest_of_brusselator(100).follow("B", 6.0).special_points if p.kind == "hopf"]
    orbit = hopf.follow("B", hopf.parameters["B"] + 0.05, max_points=3).orbits[-1]
    with warnings.catch_warnings():  # the smallest of 200 are not resolved
        warnings.simplefilter("ignore", LostMultiplierWarning)
        seconds, multipliers = least(lambda: orbit.floquet(), 1)
    print()
    line("Brusselator of 200 states, multipliers", seconds, 1, unit, 2500.0)
    assert abs(multipliers.multipliers[np.argmin(abs(multipliers.multipliers - 1.0))] - 1.0) < 1e-4


def test_orbits_of_1000_states(unit: float) -> None:
    """The first orbits with multipliers, and the most memory of the process in GB."""
    (hopf, *_) = [p for p in rest_of_brusselator(500).follow("B", 6.0).special_points if p.kind == "hopf"]
    to = hopf.parameters["B"] + 0.3
    seconds, branch = least(lambda: hopf.follow("B", to, max_points=6, stability=True), 1)
    print(f"\n  {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.1f} GB")
    line("Brusselator of 1,000 states, orbits", seconds, len(branch), unit)
    assert all(orbit.floquet().beyond < 1.0 for orbit in branch.orbits[1:])


def test_equilibria_of_400_states(unit: float) -> None:
    start = rest_of_brusselator(200)
    seconds, branch = least(lambda: start.follow("B", 5.0), 1)
    print()
    line("Brusselator of 400 states, equilibria", seconds, len(branch.values), unit, 100.0)


@pytest.mark.parametrize(("units", "aim"), [(10, 2000.0), (25, 4000.0)])
def test_a_detuned_ring(unit: float, units: int, aim: float) -> None:
    phases = 2 * np.pi * np.arange(units) / units
    guess = lambda t: np.concatenate([2 * np.cos(t - phases), -2 * np.sin(t - phases)])  # noqa: E731
    seconds, orbit = least(lambda: find_orbit(detuned_ring(units), guess, 6.4), 1)
    print()
    line(f"detuned ring of {units}", seconds, 1, unit, aim)
    assert 6.0 < orbit.period < 7.0


def test_a_map(unit: float, tmp_path: Path) -> None:
    """Cells of van der Pol's orbit, and of a chain's family."""
    scene = (
        (EXAMPLES / "van_der_pol.toml").read_text().split("[continuation]")[0].replace("models/", f"{EXAMPLES}/models/")
    )
    scenes = {
        "van der Pol": scene + '[map]\nmu = { from = 0.5, to = 3.0, points = 64 }\nquantities = ["period"]\n',
        "chain": "[chain]\nsites = 6\nalpha = 1.0\ngamma = 0.1\ng = -1.0\n[family]\nmode = 1\namplitude_max = 0.5\n"
        '[map]\ngamma = { from = 0.0, to = 0.5, points = 16 }\nquantities = ["Omega"]\n',
    }
    print()
    for name, text in scenes.items():
        (path := tmp_path / f"{name}.toml").write_text(text)
        found = run_map(path, tmp_path / name, pictures=False, quiet=True)
        cells, seconds = len(found.known), sum(task.seconds for task in tasks(tmp_path / name / "journal.msgpack"))
        line(f"map of {name}, {cells / seconds:.0f} cells a second", seconds, cells, unit)
        assert found.complete
