"""Linear modes of models that have families: checks of the model, of its parameters and of a mode."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.lattice.linear_modes import LinearModes, linear_modes
from casadi_skin.model.amplitude import amplitude_square
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statement import named_values

SIMPLE = 1e-10  # relative distance of squared frequencies that doubles distinguish
HIGHEST_HARMONIC = 7  # whose resonance with another mode is looked for: the coarsest level has no higher ones
MOST_NAMED = 6  # modes in a message
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


@dataclass(frozen=True)
class Resonance:
    """Two modes with `harmonic` times the frequency of `mode` next to that of `other`; `off` is their difference.

    The difference is one of squared frequencies, relative to the largest.
    """

    mode: int
    other: int
    harmonic: int
    omega: float
    off: float

    @property
    def words(self) -> str:
        """What is in resonance."""
        m, j, k = self.harmonic, self.mode, self.other
        if m == 1:
            return f"a 1:1 resonance of modes {j} and {k}"
        return f"an internal resonance at harmonic {m} ({m} omega_{j} = omega_{k} = {self.omega:.10g})"


def nearest_resonance(squares: Array, number: int, odd: bool, lowest: int = 1) -> Resonance | None:
    """The nearest resonance of a mode with another one at a harmonic from the lowest on; None where there is no other.

    Arguments:
        squares: of the frequencies of all modes, ascending.
        number: of the mode, from 1.
        odd: whether forces are odd, so that orbits have odd harmonics alone.
        lowest: harmonic.
    """
    harmonics = np.arange(1, HIGHEST_HARMONIC + 1, 2 if odd else 1)
    harmonics = harmonics[harmonics >= lowest]
    off = np.abs(squares - harmonics[:, None] ** 2 * squares[number - 1]) / np.max(np.abs(squares))
    off[:, number - 1] = np.inf
    if not np.isfinite(off).any():
        return None
    i, other = (int(k) for k in np.unravel_index(np.argmin(off), off.shape))
    omega = float(np.sqrt(np.maximum(squares[other], 0.0)))
    return Resonance(number, other + 1, int(harmonics[i]), omega, float(off[i, other]))


def check_alone(squares: Array, number: int, name: str, odd: bool) -> None:
    """Raises ValueError for a mode that does not oscillate, or has no family alone: it is in resonance with another.

    Arguments are those of `check_harmonics`.
    """
    square, same = squares[number - 1], SIMPLE * np.max(np.abs(squares))
    if square <= same:
        words = f"mode {number} of {name} does not oscillate: omega^2 = {square:.6g}"
        raise ValueError(f"mode: {words}; accepted: a mode with omega^2 > 0")
    near = [k + 1 for k in np.flatnonzero(np.abs(squares - square) <= same).tolist()]
    if len(near) > 1:
        words = f"modes {', '.join(map(str, near))} of {name} have the same frequency"
        apart = np.abs(np.diff(squares)) > same
        alone = np.flatnonzero(np.append(True, apart) & np.append(apart, True) & (squares > same)) + 1
        listed = ", ".join([*map(str, alone[:MOST_NAMED]), *(["..."] if alone.size > MOST_NAMED else [])])
        raise ValueError(
            f"mode: {words}: no family belongs to one of them alone, a 1:1 resonance; accepted: a mode with a frequency"
            f" of its own: {listed or 'there is none'}"
        )
    check_harmonics(squares, number, name, odd)


def check_harmonics(squares: Array, number: int, name: str, odd: bool) -> None:
    """Raises ValueError for a mode a harmonic of which is in resonance with another mode.

    Arguments are those of `nearest_resonance`, and the `name` of the model.
    """
    found = nearest_resonance(squares, number, odd, lowest=2)
    if found is not None and found.off <= SIMPLE:
        words = f"mode {found.other} of {name} has {found.harmonic} times the frequency of mode {number}, {found.words}"
        accepted = "a mode without such a resonance, or other values of parameters"
        raise ValueError(f"mode: {words}: its family does not start alone; accepted: {accepted}")
