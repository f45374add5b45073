"""A model of second order in displacements from a state at which it rests."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import NotPolynomialError, homogeneous_parts

NODES = 4  # of Gauss and Legendre's formula: right to rounding for displacements below SMALL
SMALL = 0.05  # above it a difference of forces keeps its digits
STEPS = 3  # of Newton's method from a state that is known well


def centred_model(model: OdeModel, rest: NDArray[np.float64], parameters: Mapping[str, float]) -> OdeModel:
    """The model about rest at other positions than 0.

    Arguments:
        model: of second order, not forced.
        rest: positions at which it rests, shape (positions,); rounding is all that is left of an error of 1e-5.
        parameters: values of all its parameters.

    Returns:
        A model without parameters whose positions are the displacements from `rest`.

    Raises:
        ValueError: the model is of first order, or forced.
    """
    if model.order != 2 or model.forced:
        kind = "is forced" if model.forced else "is of first order"
        raise ValueError(f"model: given {model.name}, which {kind}; accepted: one of second order, without time")
    values = ca.DM([parameters[name] for name in model.parameter_names])
    force = ca.Function("f", [model.state], [ca.substitute(model.rhs, model.parameters, values)])
    slope = force.jacobian()
    y = np.asarray(rest, dtype=float)
    for _ in range(STEPS):
        y = y - np.linalg.lstsq(np.array(slope(y, 0)), np.array(force(y)).ravel(), rcond=1e-12)[0]
    moved = ca.DM(y) + model.state
    keeps = model.reversal == (1,) * model.size + (-1,) * model.size
    energy = None
    if model.hamiltonian is not None:
        energy = ca.substitute(model.hamiltonian, ca.vertcat(model.state, model.parameters), ca.vertcat(moved, values))
    return OdeModel(
        f"{model.name} about rest", model.state, _displaced(force, y, model.state), order=2, velocity=model.velocity,
        reversal=model.reversal if keeps else None, hamiltonian=energy, state_labels=model.state_labels, checked=False,
    )  # fmt: skip


def _displaced(force: ca.Function, rest: NDArray[np.float64], u: ca.SX) -> ca.SX:
    """f(rest + u) - f(rest) without cancellation at small u: by homogeneous parts, or the mean of its slope times u."""
    there = force(ca.DM(rest) + u)
    try:
        parts = homogeneous_parts(there, u)
        return ca.SX(sum((part for degree, part in parts.items() if degree), ca.SX.zeros(u.numel())))
    except NotPolynomialError:
        pass
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    y = ca.SX.sym("y", u.numel())
    along = ca.Function("along", [y, u], [ca.jtimes(force(y), y, u)])
    terms = (w / 2 * along(ca.DM(rest) + (s + 1) / 2 * u, u) for s, w in zip(nodes, weights, strict=True))
    mean = sum(terms, ca.SX.zeros(u.numel()))
    return ca.SX(ca.if_else(ca.mmax(ca.fabs(u)) < SMALL, mean, there - force(ca.DM(rest))))
