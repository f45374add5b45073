"""The linear spectrum of a chain or of any model of second order that rests at 0."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.model_coordinates import modes_of
from casadi_skin.zero.problem import Array


@dataclass(frozen=True, eq=False)
class LinearSpectrum:
    """Linear modes about rest.

    Attributes:
        squares: of the frequencies, ascending, shape (modes,); none of a lattice of infinite length.
        ends: squares of the lowest and the highest frequency.
        mode: function of the number of a mode, from 1, to its displacements at all positions: of norm 1, the largest
            positive.
        cutoffs: squares of the limits of the frequencies of an infinitely long lattice; None where these are not known.
        bands: squares of the ends of its bands, where there are several.
    """

    squares: Array
    ends: tuple[float, float]
    mode: Callable[[int], Array]
    cutoffs: tuple[float, float] | None = None
    bands: tuple[tuple[float, float], ...] = ()


def linear_spectrum(model: Any, parameters: Mapping[str, float] | None = None) -> LinearSpectrum:
    """The linear spectrum of a model.

    Arguments:
        model: a `Chain`, or an `OdeModel` of second order with an equilibrium at 0.
        parameters: values of the parameters of an `OdeModel`, where they are not its nominal ones.

    Returns:
        Frequencies and modes.

    Raises:
        ValueError: the model has no such modes.
    """
    found: LinearSpectrum = model.linear_spectrum(parameters)
    return found


def spectrum_of_model(model: OdeModel, parameters: Mapping[str, float] | None = None) -> LinearSpectrum:
    """`linear_spectrum` of an `OdeModel`."""
    modes = modes_of(model, parameters or {})
    scale = np.exp(modes.log_scale)

    def displacements(mode: int) -> Array:
        return of_norm_one(scale * modes.modes[:, mode - 1])

    return LinearSpectrum(modes.squares, (float(modes.squares[0]), float(modes.squares[-1])), displacements)


def of_norm_one(displacements: Array) -> Array:
    """Displacements scaled to norm 1, the largest positive, shape (positions,)."""
    largest = displacements[np.argmax(np.abs(displacements))]
    return np.asarray(displacements / np.linalg.norm(displacements) * np.sign(largest))


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
    return np.asarray(model.linear_frequencies(parameters), dtype=float)


def frequencies_of_model(model: OdeModel, parameters: Mapping[str, float] | None = None) -> Array:
    """`linear_frequencies` of an `OdeModel`."""
    squares = spectrum_of_model(model, parameters).squares
    if squares[0] < 0:
        words = f"mode 1 of {model.name} does not oscillate: omega^2 = {squares[0]:.6g}"
        raise ValueError(f"{words}; accepted: omega^2 >= 0")
    return np.sqrt(squares)
