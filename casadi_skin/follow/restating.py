"""An orbit of a family as a boundary-value problem of its model, so that it can be followed in any parameter."""

from __future__ import annotations

from dataclasses import fields

import casadi as ca

from casadi_skin.follow.family import Family
from casadi_skin.follow.find import find_orbit
from casadi_skin.follow.orbit import Orbit
from casadi_skin.model.amplitude import amplitude_square
from casadi_skin.model.ode import OdeModel

AMPLITUDE_NAME = "S"


def restated(orbit: Orbit, parameter: str) -> Orbit:
    """The orbit of the model in its own coordinates at the same S, which becomes a parameter.

    Arguments:
        orbit: an orbit of a family.
        parameter: the parameter to follow, for the message: one of the model, or "S".

    Returns:
        The same orbit, solved by Gauss collocation on the part of the period that the symmetries leave.

    Raises:
        ValueError: the model has no such parameter.
        BoundaryError: the orbit is not found in these coordinates.
    """
    family = orbit.space
    assert isinstance(family, Family)
    family.coordinates.check_whole("an orbit followed in a parameter")
    extended, amplitude, select = with_amplitude(family.coordinates.model)

    def guess(t: float) -> list[float]:
        h = 1e-6 * orbit.period
        before, here, after = orbit.evaluate([t - h, t, t + h])
        return [*here, *((after - before) / (2.0 * h))]

    values = {**orbit.parameters, amplitude: orbit.S}
    return find_orbit(
        extended, guess, orbit.period, parameters=values, select=select, symmetric=True, tolerance=orbit.space.tolerance
    )


def with_amplitude(model: OdeModel) -> tuple[OdeModel, str, ca.SX]:
    """The model with S among its parameters, its name there, and the function that vanishes where S has its value."""
    form = amplitude_square(model)
    if form.parameter is not None:
        return model, form.parameter, form.form - model.parameters[model.parameter_names.index(form.parameter)]
    name = AMPLITUDE_NAME
    while name in (*model.parameter_names, *model.state_names):
        name += "_"
    S = ca.SX.sym(name)
    own = {entry.name: getattr(model, entry.name) for entry in fields(OdeModel)}  # a lattice becomes a plain model
    own |= {"parameters": ca.vertcat(model.parameters, S), "nominal": None, "checked": False}
    extended = OdeModel(**own | {"parameter_labels": (*model.parameter_names, name)})
    return extended, name, form.form - S
