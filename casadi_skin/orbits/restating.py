"""An orbit of a family as a boundary-value problem of its model, so that it can be followed in any parameter."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from casadi_skin.orbits.family import Family
from casadi_skin.orbits.find_orbit import find_orbit
from casadi_skin.orbits.orbit import Orbit

AMPLITUDE = "S"


def restated(orbit: Orbit, parameter: str) -> Orbit:
    """The orbit of the model in its own coordinates at the same S, which becomes a parameter.

    Arguments:
        orbit: an orbit of a family.
        parameter: what it is to be followed in, for the message: a parameter of the model, or "S".

    Returns:
        The same orbit, solved by Gauss collocation on the part of the period that the symmetries leave.

    Raises:
        ValueError: the model has no such parameter.
        BoundaryError: the orbit is not found in these coordinates.
    """
    family = orbit.space
    assert isinstance(family, Family)
    model = family.coordinates.model
    S = ca.SX.sym(AMPLITUDE)
    extended = replace(
        model, parameters=ca.vertcat(model.parameters, S), nominal=None, normalisation=None,
        parameter_labels=(*model.parameter_names, AMPLITUDE), checked=False,
    )  # fmt: skip
    select = ca.dot(model.state, model.state) - S

    def guess(t: float) -> list[float]:
        h = 1e-6 * orbit.period
        before, here, after = orbit.evaluate([t - h, t, t + h])
        return [*here, *((after - before) / (2.0 * h))]

    values = {**orbit.parameters, AMPLITUDE: orbit.S}
    return find_orbit(
        extended, guess, orbit.period, parameters=values, select=select, symmetric=True, tolerance=orbit.space.tolerance
    )
