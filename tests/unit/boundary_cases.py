"""Boundary-value problems with layers whose solutions are known in closed form.

Of the test set of J. R. Cash and others (https://archimede.uniba.it/~bvpsolvers/testsetbvpsolvers), many also in
U. M. Ascher, R. M. M. Mattheij and R. D. Russell, Numerical Solution of Boundary Value Problems for Ordinary
Differential Equations (SIAM 1995). Numbers are those of the test set.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from casadi_skin import BoundaryValueProblem
from casadi_skin.follow.solution import Solution
from casadi_skin.model.ode import OdeModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Layer:
    """eps u'' = rhs(x, u, u', eps) on an interval, its solution, and where it varies fastest."""

    rhs: Callable[[Any, Any, Any, Any, Any], Any]  # of the functions' module, x, u, v, eps
    exact: Callable[[Array, float], Array]
    start: float
    places: tuple[float, ...]
    width: Callable[[float], float]

    def problem(self, eps: float) -> BoundaryValueProblem:
        """The problem with the values of the solution at the ends."""
        x, u, v, e = (ca.SX.sym(name) for name in ("x", "u", "v", "eps"))
        rhs = ca.vertcat(v, self.rhs(ca, x, u, v, e) / e)
        model = OdeModel("layer", ca.vertcat(u, v), rhs, e, time=x, forcing_period=1.0)
        left, right = self.exact(np.array([self.start, 1.0]), eps)
        conditions = [model.start(u) - left, model.end(u) - right]
        return BoundaryValueProblem(model, conditions, interval=(self.start, 1.0), parameters={"eps": eps})

    def grid(self, eps: float) -> Array:
        """Places all over the interval and densely in the layers."""
        inside = np.concatenate([[0.0], np.geomspace(1e-3, 40.0, 400)]) * self.width(eps)
        near = [place + sign * inside for place in self.places for sign in (-1.0, 1.0)]
        x = np.unique(np.concatenate([np.linspace(self.start, 1.0, 1001), *near]))
        return np.asarray(x[(x >= self.start) & (x <= 1.0)])

    def error(self, solution: Solution, eps: float) -> float:
        """Largest error of u, relative to its largest value."""
        x = self.grid(eps)
        exact = self.exact(x, eps)
        return float(np.max(np.abs(solution.evaluate(x)[:, 0] - exact)) / np.max(np.abs(exact)))


def _decay(x: Array, eps: float) -> Array:
    r = np.sqrt(eps)
    return np.asarray((np.exp(-x / r) - np.exp((x - 2.0) / r)) / (1.0 - np.exp(-2.0 / r)))


def _corner(x: Array, eps: float) -> Array:
    r = np.sqrt(2.0 * eps)
    tail = r / np.sqrt(np.pi) * np.exp(-((x / r) ** 2))
    end = erf(1.0 / r) + r / np.sqrt(np.pi) * np.exp(-1.0 / r**2)
    return np.asarray(np.cos(np.pi * x) + x + (x * erf(x / r) + tail) / end)


def _shock(x: Array, eps: float) -> Array:
    r = np.sqrt(2.0 * eps)
    return np.asarray(np.cos(np.pi * x) + erf(x / r) / erf(1.0 / r))


def _log_cosh(x: Array, eps: float) -> Array:
    s = np.abs(x - 0.745) / eps
    return np.asarray(1.0 + eps * (s + np.log1p(np.exp(-2.0 * s)) - np.log(2.0)))


LAYERS = {
    "1, two layers": Layer(lambda m, x, u, v, e: u, _decay, 0.0, (0.0, 1.0), np.sqrt),
    "2, layer at the end": Layer(
        lambda m, x, u, v, e: v,
        lambda x, e: np.expm1((x - 1.0) / e) / np.expm1(-1.0 / e),
        0.0,
        (1.0,),
        lambda e: e,
    ),
    "4, layer at the start": Layer(
        lambda m, x, u, v, e: (1 + e) * u - v,
        lambda x, e: np.exp(x - 1.0) + np.exp(-(1.0 + e) * (1.0 + x) / e),
        -1.0,
        (-1.0,),
        lambda e: e,
    ),
    "6, shock at a turning point": Layer(
        lambda m, x, u, v, e: -x * v - e * np.pi**2 * m.cos(np.pi * x) - np.pi * x * m.sin(np.pi * x),
        _shock,
        -1.0,
        (0.0,),
        np.sqrt,
    ),
    "7, corner at a turning point": Layer(
        lambda m, x, u, v, e: -x * v + u - (1 + e * np.pi**2) * m.cos(np.pi * x) - np.pi * x * m.sin(np.pi * x),
        _corner,
        -1.0,
        (0.0,),
        np.sqrt,
    ),
    "20, nonlinear corner": Layer(lambda m, x, u, v, e: 1 - v**2, _log_cosh, 0.0, (0.745,), lambda e: e),
    "21, nonlinear layer": Layer(
        lambda m, x, u, v, e: u + u**2 - m.exp(-2 * x / m.sqrt(e)),
        lambda x, e: np.exp(-x / np.sqrt(e)),
        0.0,
        (0.0,),
        np.sqrt,
    ),
}
