"""An orbit followed through an FMU's binary against the same model in expressions: at most 5 times the time, also where
its derivatives by the parameter are differences between instances.

Run with `pytest -m benchmark -s tests/benchmarks/test_import_speed.py`. Times are those of the processor, the best of
three, in one process.
"""

from __future__ import annotations

import time
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from foreign_fmus import casadi_van_der_pol, changed

from casadi_skin import OdeModel, find_orbit, import_fmu

pytestmark = pytest.mark.benchmark
MOST = 5.0


def seconds(model: OdeModel) -> tuple[float, float]:
    """Processor time of an orbit at mu = 1 followed to mu = 3, and the period there."""
    best = np.inf
    for _ in range(3):
        started = time.process_time()
        orbit = find_orbit(model, lambda t: [2.0 * np.cos(t), -2.0 * np.sin(t)], 6.6, parameters={"mu": 1.0})
        period = orbit.follow("mu", 3.0, at=[3.0]).at(3.0).period
        best = min(best, time.process_time() - started)
    return best, float(period)


@pytest.mark.parametrize("variability", ["fixed", "tunable"])
def test_orbit_through_the_binary(variability: str, tmp_path: Path) -> None:
    def held(text: bytes) -> bytes:
        return text.replace(b'variability="tunable"', b'variability="%s"' % variability.encode())

    path = changed(casadi_van_der_pol(tmp_path), tmp_path / "held.fmu", {"modelDescription.xml": held})
    x, mu = ca.SX.sym("x", 2), ca.SX.sym("mu")
    written = OdeModel("vdp", x, ca.vertcat(x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]), mu)
    model = import_fmu(path, parameters=["mu"])
    (there, known), (here, period) = seconds(written), seconds(model)
    assert abs(period - known) < 1e-9
    print(f"\n  mu is {variability}, by {model.parameter_derivatives}: {here:.2f} s, in expressions {there:.2f} s,")
    print(f"  {here / there:.1f} times; accepted: up to {MOST:g}")
    assert here / there < MOST
