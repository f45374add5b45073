"""Random points at which the properties of a lattice are checked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import Array
from casadi_skin.lattice.equations import Equations

SAME = 1e-12  # relative difference of values that are the same but for rounding, per site
TRIALS = 3  # random points
AMPLITUDES = (1.0, 0.1, 0.01)  # of random positions: the first at which all forces are finite
SPREAD = 0.1  # relative change of parameters at random points: a property of the declared values alone is not declared


@dataclass(frozen=True)
class Trial:
    """Random parameters, their gains and masses, and a random state with unit sizes."""

    parameters: Array
    gains: Array
    masses: Array
    y: Array
    v: Array
    t: float


def trials_of(equations: Equations) -> Iterator[Trial]:
    """The declared parameters, then others near them."""
    generator, nominal = np.random.default_rng(0), np.array(equations.nominal)
    spread = np.array([SPREAD if name.isidentifier() else 0.0 for name in equations.symbols])  # numbers stay
    gains = [gain for pair in equations.gains for gain in pair]
    evaluate = ca.Function("f", [equations.parameters], [ca.vertcat(ca.SX(0, 1), *gains), equations.masses])
    accelerations = field_of(equations)
    for k in range(TRIALS):
        parameters = nominal * (1.0 + (spread * generator.uniform(-1, 1, nominal.size) if k else 0.0))
        found = [np.array(value).ravel() for value in evaluate(parameters)]
        y, v, t = (
            generator.normal(size=equations.y.numel()),
            generator.normal(size=equations.y.numel()),
            generator.normal(),
        )
        for amplitude in AMPLITUDES:
            if np.all(np.isfinite(np.array(accelerations(amplitude * y, v, t, parameters)))):
                break
        yield Trial(parameters, found[0].reshape(-1, 2), found[1], amplitude * y, v, t)


def field_of(equations: Equations) -> ca.Function:
    arguments = [equations.y, equations.v, equations.t, equations.parameters]
    return ca.Function("a", arguments, [ca.densify(equations.accelerations)])
