"""Linear frequencies of a chain or of any model of second order that rests at 0."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.models.ode import OdeModel
from casadi_skin.orbits.model_coordinates import modes_of


def linear_frequencies(model: Any, parameters: Mapping[str, float] | None = None) -> Array:
    """Frequencies of all linear modes in ascending order.

    Arguments:
        model: a `Chain`, or an `OdeModel` of second order with an equilibrium at 0.
        parameters: values of the parameters of an `OdeModel`, where they are not its nominal ones.

    Returns:
        Shape (modes,).

    Raises:
        ValueError: the model has no such modes, or the lowest does not oscillate.
    """
    if not isinstance(model, OdeModel):
        return np.asarray(model.linear_frequencies(), dtype=float)
    squares = modes_of(model, parameters or {}).squares
    if squares[0] < 0:
        raise ValueError(
            f"mode 1 of {model.name} does not oscillate: omega^2 = {squares[0]:.6g}; accepted: omega^2 >= 0"
        )
    return np.sqrt(squares)
