"""Random cycles, autonomous and forced, whose multipliers are known in closed form.

A cycle of Hopf's normal form, x' = g(r) x - w(r) y, or the response b cos(omega t) of a forced system, with directions
across it, z' = A z, whose flow is known: with constant matrices, among them nearly defective ones, with rates that
change along the cycle, and in frames that make half a turn a period. Each block feels those behind it, so that the
monodromy matrix is triangular and far from normal. Shears with squares, x_i + q x_j^2 + l x_j, and units of the states
change coordinates: multipliers stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from casadi_skin import OdeModel, Orbit, find_orbit
from casadi_skin.stability.result import Floquet

Array = NDArray[Any]
KINDS = ("real", "variable", "complex", "negative", "defective")


@dataclass(frozen=True)
class KnownCycle:
    """A model with a guess that is its cycle, the period of an autonomous one, and the multipliers but the trivial."""

    model: OdeModel
    guess: Callable[[float], list[float]]
    period: float | None
    others: Array

    def orbit(self, **options: Any) -> Orbit:
        return find_orbit(self.model, self.guess, self.period, **options)


def drawn(seed: int, index: int, decades: float = 0.0) -> KnownCycle:
    """Cycle `index` of a draw; units of the states over as many decades on either side of 1."""
    random = np.random.default_rng([seed, index])
    forced, omega = bool(random.random() < 0.3), float(random.uniform(0.5, 3.0))
    T, t = 2.0 * np.pi / omega, ca.SX.sym("t")
    blocks = [_block(str(random.choice(KINDS)), random, omega) for _ in range(int(random.integers(1, 4)))]
    n = (0 if forced else 2) + sum(size for size, _, _ in blocks)
    x, others, rows = ca.SX.sym("x", n), [value for *_, values in blocks for value in values], []
    if forced:
        cosine, sine = ca.cos(omega * t), ca.sin(omega * t)
    else:
        cosine, sine, rest = x[0], x[1], 1 - x[0] ** 2 - x[1] ** 2
        growth, shear = random.uniform(0.05, 1.5) / T * random.choice([1, 1, -1]), random.uniform(-1, 1)
        others.insert(0, np.exp(-2.0 * growth * T))
        turn = omega + shear * rest
        rows += [growth * rest * x[0] - turn * x[1], growth * rest * x[1] + turn * x[0]]
    place = len(rows)
    for size, matrix, _ in blocks:
        rows += ca.vertsplit(matrix(cosine, sine) @ x[place : place + size])
        place += size
        for i in range(place - size):  # what comes before feels this block
            strength = random.uniform(-1, 1) / T if random.random() < 0.3 else 0.0
            rows[i] += strength * x[place - 1] * (1 + 0.5 * cosine)
    shears = [(*random.choice(n, 2, replace=False).tolist(), *random.uniform(-0.4, 0.4, 2)) for _ in range(3 * (n > 1))]
    units = 10.0 ** random.uniform(-decades, decades, n)
    response = random.uniform(-1, 1, n) if forced else np.zeros(n)

    def sheared(values: list[Any], sign: int) -> list[Any]:
        values = list(values)
        for i, j, curved, straight in shears[::sign]:
            values[i] = values[i] + sign * (curved * values[j] ** 2 + straight * values[j])
        return values

    state, w = ca.SX.sym("state", n), ca.SX.sym("w", n)
    back = ca.vertcat(*sheared(ca.vertsplit(state / units), -1))
    field = ca.substitute(ca.vertcat(*rows), x, back - (response * cosine if forced else 0))
    field += -omega * response * sine if forced else 0
    slope = ca.substitute(ca.jacobian(ca.vertcat(*sheared(ca.vertsplit(w), 1)), w), w, back)
    clock = {"time": t, "forcing_period": T} if forced else {}
    model = OdeModel(f"cycle {seed}.{index}", state, units * (slope @ field), **clock)

    def guess(time: float) -> list[float]:
        values = response * np.cos(omega * time)
        if not forced:
            values[:2] = np.cos(omega * time), np.sin(omega * time)
        return list(units * sheared(values.tolist(), 1))

    return KnownCycle(model, guess, None if forced else T, np.array(others))


def _block(kind: str, random: np.random.Generator, omega: float) -> tuple[int, Callable[..., Any], list[complex]]:
    """Number of states, A(cos, sin), and the multipliers of z' = A z."""
    T = 2.0 * np.pi / omega
    (a, b), rate = random.uniform(-1.5, 0.7, 2) / T, random.uniform(0.0, 3.0) / T
    if kind == "real":
        return 1, lambda c, s: ca.SX(a), [np.exp(a * T)]
    if kind == "variable":
        return 1, lambda c, s: a + 0.5 * omega * c, [np.exp(a * T)]
    if kind == "negative":  # diag(a, b) in a frame that makes half a turn
        m, d = 0.5 * (a + b), 0.5 * (a - b)
        rows = lambda c, s: [[m + d * c, d * s - omega / 2], [d * s + omega / 2, m - d * c]]  # noqa: E731
        return 2, lambda c, s: ca.vertcat(*(ca.horzcat(*row) for row in rows(c, s))), [-np.exp(a * T), -np.exp(b * T)]
    square = -(rate**2) if kind == "complex" else 10.0 ** random.uniform(-12, -2) / T**2 * random.choice([1, -1])
    matrix = np.array([[a, 1.0 / T], [square * T, a]])
    root = np.sqrt(complex(square))
    return 2, lambda c, s: ca.SX(ca.DM(matrix)), [np.exp((a + root) * T), np.exp((a - root) * T)]


def errors(floquet: Floquet, others: Array) -> tuple[Array, Array]:
    """True and estimated errors of the multipliers but the trivial, paired with the known ones."""
    distances = np.abs(floquet.others[:, None] - others)
    rows, columns = linear_sum_assignment(distances)
    return distances[rows, columns], floquet.other_errors[rows]
