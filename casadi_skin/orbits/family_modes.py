"""Linear modes of models that have families: checks of the model, of its parameters and of a mode."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from casadi_skin.arguments import short_repr
from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.statement import named_values
from casadi_skin.models.ode import OdeModel
from casadi_skin.orbits.amplitude import amplitude_square
from casadi_skin.orbits.linear_modes import LinearModes, linear_modes

SIMPLE = 1e-10  # relative distance of squared frequencies that doubles distinguish
FIRST, LAST = "first", "last"


def modes_of(model: OdeModel, parameters: Mapping[str, float]) -> LinearModes:
    """Linear modes of a model of second order about rest; raises ValueError where there are none."""
    check_kind(model)
    amplitude = amplitude_square(model).parameter
    values = fixed_values(model, parameters, () if amplitude is None else (amplitude,))
    numbers = ca.SX([values.get(name, 0.0) for name in model.parameter_names])
    return linear_modes(ca.substitute(model.rhs, model.parameters, numbers), model.state, model.name)


def check_kind(model: OdeModel) -> None:
    """Raises ValueError, in one line, for a model that has no families of brake orbits from rest."""
    even = (1,) * model.size + (-1,) * model.size
    for accepted, holds in (
        ("of second order, with positions as its state", model.order == 2),
        ("without forcing", not model.forced),
        ("with a declared reversal that keeps positions and turns velocities", model.reversal == even),
        ("with half_period = -1 for every component, or none", model.half_period in (None, (-1,) * model.full_size)),
    ):
        if not holds:
            raise ValueError(f"model: given {model.name}; accepted for families: a model {accepted}")


def fixed_values(model: OdeModel, given: Mapping[str, float], free: tuple[str, ...]) -> dict[str, float]:
    """Values of the parameters but for the free ones, given or nominal."""
    for name in free:
        if name in given:
            raise ValueError(f"parameters: given {name}, which the family is followed in; accepted: the others")
    values = named_values(model, {**dict.fromkeys(free, 0.0), **given})
    return {name: value for name, value in values.items() if name not in free}


def number_of_mode(model: OdeModel, mode: int | str) -> int:
    """Number of a mode that may be named; raises ValueError for one that is not there."""
    if isinstance(mode, str) and mode in (FIRST, LAST):
        return 1 if mode == FIRST else model.size
    if isinstance(mode, bool) or not isinstance(mode, int | np.integer) or not 1 <= int(mode) <= model.size:
        raise ValueError(f"mode: given {short_repr(mode)}; accepted: 1..{model.size}, {FIRST}, {LAST}")
    return int(mode)


def check_alone(squares: Array, number: int, name: str) -> None:
    """Raises ValueError for a mode that does not oscillate or is not alone at its frequency."""
    square = squares[number - 1]
    if square <= SIMPLE * np.max(np.abs(squares)):
        words = f"mode {number} of {name} does not oscillate: omega^2 = {square:.6g}"
        raise ValueError(f"mode: {words}; accepted: a mode with omega^2 > 0")
    near = [k + 1 for k in np.flatnonzero(np.abs(squares - square) <= SIMPLE * np.max(np.abs(squares))).tolist()]
    if len(near) > 1:
        words = f"modes {', '.join(map(str, near))} of {name} have the same frequency"
        raise ValueError(
            f"mode: {words}: no family belongs to one of them alone; accepted: a mode with a frequency of its own"
        )
