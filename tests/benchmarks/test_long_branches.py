"""Branches through canards, to relaxation oscillations, from the anticontinuous limit: points and units of the whole.

Units are dense 193 x 193 solves; without multipliers, at the default tolerance. AUTO-07p, with multipliers at its own
tolerance of 1e-9, takes 147 points and 2,300 units for the canard, 119 to 444 points and 290 to 2,900 units for the
autocatalator from its second Hopf point, 1,083 points and 3,100 to 4,900 units from its first. Run with
`pytest -m benchmark -s tests/benchmarks/test_long_branches.py`, one thread.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from ode_cases import canard, circle, hopf_of, model, symbols, van_der_pol

sys.path.append(str(Path(__file__).parents[1] / "unit"))
from test_breathers import SITES, at_the_limit

from casadi_skin import OdeModel

pytestmark = pytest.mark.benchmark


def autocatalator() -> OdeModel:
    """Petrov, Scott and Showalter (1992), as BifurcationKit has it."""
    a, b, c, mu = symbols("a b c mu")
    return model(
        "autocatalator", [a, b, c], [mu * (65 + c) - a * b**2 - a, (a * b**2 + a - b) / 5e-3, (b - c) / 2e-2], mu
    )


def neuron() -> OdeModel:
    """Hindmarsh and Rose (1984)."""
    x, y, z, current = symbols("x y z I")
    return model(
        "neuron", [x, y, z], [y - x**3 + 3 * x**2 - z + current, 1 - 5 * x**2 - y, 6e-3 * (4 * x + 6.4 - z)], current
    )


def synapses() -> OdeModel:
    """Tsodyks and Markram's, as in Cortes et al. (2013)."""
    E, x, u, E0 = symbols("E x u E0")
    rate = 1.5 * ca.log(1 + ca.exp((3.07 * u * x * E + E0) / 1.5))
    rhs = [(rate - E) / 0.013, (1 - x) / 0.2 - u * x * E, (0.3 - u) / 1.5 + 0.3 * (1 - u) * E]
    return model("synapses", [E, x, u], rhs, E0)


def second_hopf() -> Any:
    return hopf_of(autocatalator(), [0.1] * 3, 1e-3, 0.3, 1)


def through_the_canard() -> Any:
    return hopf_of(autocatalator(), [0.1] * 3, 1e-3, 0.3)


def breather() -> Any:
    return at_the_limit(np.ones(SITES))


BRANCHES: dict[str, tuple[Callable[[], Any], str, float, dict[str, Any], int]] = {
    "canard": (lambda: hopf_of(canard(), [1.1, -0.6], 1.1, 0.9), "a", 0.5, {}, 250),
    "autocatalator from its second Hopf point": (second_hopf, "mu", 0.0374, {}, 444),
    "autocatalator through its canard": (through_the_canard, "mu", 0.17443577, {}, 1083),
    "bursts": (lambda: hopf_of(neuron(), [-1.5, -10.0, 0.0], 0.0, 4.0), "I", 2.1, {}, 1000),
    "synapses": (lambda: hopf_of(synapses(), [0.2386, 0.9827, 0.3679], -2.0, -0.9, -1), "E0", -5.0, {}, 250),
    "van der Pol to mu = 1000": (lambda: circle(van_der_pol(), 2.0, 6.6, 1.0), "mu", 1000.0, {}, 500),
    "breather": (breather, "C", 0.15, {}, 15),
    "breather at its period": (breather, "C", 0.15, {"fixed": "period"}, 15),
}


@pytest.mark.parametrize("name", BRANCHES)
def test_whole_branches(name: str, unit: float) -> None:
    start_of, parameter, to, options, aim = BRANCHES[name]
    start = start_of()
    started = time.process_time()
    branch = start.follow(parameter, to, **options)
    units = (time.process_time() - started) / unit
    points = len(branch.values)
    print(f"\n  {name:<42} {points:5d} points (aim {aim}) {units:9.0f} units  {branch.reason[:60]}")
    assert branch.complete or "without bound" in branch.reason or "Hopf point" in branch.reason
