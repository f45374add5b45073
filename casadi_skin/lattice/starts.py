"""Starts of a time evolution near rest: a linear mode, a kick of one site, a direction, noise; of any model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.dynamics.equations import equations_of_motion
from casadi_skin.dynamics.evolve import checked_vector
from casadi_skin.lattice.declaration import Array
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import lattice_modes
from casadi_skin.lattice.spectrum import linear_spectrum
from casadi_skin.model.arguments import number, short_repr

KINDS = ("mode", "site", "vector", "seed")


def initial_state(
    model: Any,
    size: float,
    *,
    mode: int | None = None,
    site: int | None = None,
    vector: ArrayLike | None = None,
    seed: int | None = None,
    moving: bool = False,
    parameters: Mapping[str, float] | None = None,
) -> tuple[Array, Array | None]:
    """A state near rest for `evolve`: a linear mode, a kick of one site, a direction, or noise.

    Starts near an orbit are those of `dynamics.perturbed`.

    Arguments:
        model: a `Lattice`, a `Chain` of finite length, or any `OdeModel`; the sites of one of first order are its
            states.
        size: norm of the displacements, or of the velocities.
        mode: number of a linear mode by ascending frequency, from 1; those of a lattice leave damping and drive out.
        site: number of the one site that moves, from 1.
        vector: a direction, shape (sites,), or (2 sites,) with velocities.
        seed: of normally distributed noise at all sites.
        moving: whether the sites have velocities in place of displacements.
        parameters: values of parameters that are not the declared ones.

    Returns:
        Displacements and velocities, shape (sites,) each; of a model of first order the state, and None.

    Raises:
        ValueError, TypeError: not one of mode, site, vector and seed is given, it does not fit, or the frequency of the
            mode is not real.
    """
    equations = equations_of_motion(model, parameters)
    first_order = not equations.positions
    n = model.declaration.size if isinstance(model, Lattice) else equations.positions or equations.size
    chosen = dict(zip(KINDS, (mode, site, vector, seed), strict=True))
    given = [name for name, value in chosen.items() if value is not None]
    if len(given) != 1:
        words = " and ".join(given) or "none"
        raise ValueError(f"start: given {words}; accepted: one of {', '.join(KINDS)}")
    for name, value in (("mode", mode), ("site", site)):
        if value is not None and not (isinstance(value, int | np.integer) and 1 <= value <= n):
            raise ValueError(f"{name}: given {short_repr(value)}; accepted: 1..{n}")
    if moving and n == equations.size:
        raise ValueError(
            f"moving: given with {equations.physical.name}, of first order; accepted: a model with positions"
        )
    direction = np.zeros(n)
    if mode is not None:
        direction = _mode(model, mode, parameters)
    elif site is not None:
        direction[site - 1] = 1.0
    elif vector is not None:
        direction = checked_vector("vector", vector, equations.names, *sorted({n, equations.size}))
    else:
        direction = np.random.default_rng(seed).normal(size=n)
    if moving and direction.size != n:
        raise ValueError(f"moving: given with velocities in vector; accepted: with {n} numbers")
    norm = float(np.linalg.norm(direction))
    if norm == 0.0:
        raise ValueError("vector: given zeros; accepted: a vector with a direction")
    state, first = np.zeros(equations.size), n if moving else 0
    state[first : first + direction.size] = number("size", size) / norm * direction
    return (state, None) if first_order else (state[:n], state[n:])


def _mode(model: Any, mode: int, parameters: Mapping[str, float] | None) -> Array:
    """Displacements of a linear mode; raises ValueError where its frequency is not real."""
    if isinstance(model, Lattice):
        modes = lattice_modes(model, parameters)
        square, direction = modes.squares[mode - 1], modes.right[:, mode - 1].real
    else:
        spectrum = linear_spectrum(model, parameters)
        square, direction = complex(spectrum.squares[mode - 1]), spectrum.mode(mode)
    if square.imag != 0.0 or square.real < 0.0:
        raise ValueError(f"mode: given {mode}, of omega^2 = {square:.6g}; accepted: one with a real frequency")
    return np.asarray(direction * np.sign(direction[np.argmax(np.abs(direction))]))
