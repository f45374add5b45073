"""Starts of a time evolution near rest: a linear mode, a kick of one site, a direction, noise; of any model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.dynamics.evolution import Evolution, equations_of_motion
from casadi_skin.dynamics.evolve import unit_direction
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.declaration import FIXED, PERIODIC, Array
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import lattice_modes
from casadi_skin.model.arguments import check_instance, number, short_repr, truth
from casadi_skin.model.result import Result, in_turn
from casadi_skin.zero.model_coordinates import linear_spectrum
from casadi_skin.zero.statement import named_values


@in_turn
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
    n = model.declaration.size if model.declaration else equations.positions or equations.size
    choices = {"mode": mode, "site": site, "vector": vector, "seed": seed}
    direction = unit_direction("start", equations.names, n, choices, partial(_mode, model, parameters))
    if truth("moving", moving) and n == equations.size:
        words = f"given with {equations.physical.name}, of first order; accepted: a model with positions"
        raise ValueError(f"moving: {words}")
    if moving and direction.size != n:
        raise ValueError(f"moving: given with velocities in vector; accepted: with {n} numbers")
    state, first = np.zeros(equations.size), n if moving else 0
    state[first : first + direction.size] = number("size", size) * direction
    return (state, None) if first_order else (state[:n], state[n:])


def _mode(model: Any, parameters: Mapping[str, float] | None, mode: int) -> Array:
    """Displacements of a linear mode; raises ValueError where its frequency is not real."""
    if model.declaration is not None:
        modes = lattice_modes(model, parameters)
        square, direction = modes.squares[mode - 1], modes.right[:, mode - 1].real
    else:
        spectrum = linear_spectrum(model, parameters)
        square, direction = complex(spectrum.squares[mode - 1]), spectrum.mode(mode)
    if square.imag != 0.0 or square.real < 0.0:
        raise ValueError(f"mode: given {mode}, of omega^2 = {square:.6g}; accepted: one with a real frequency")
    return np.asarray(direction * np.sign(direction[np.argmax(np.abs(direction))]))


# The spreading of energy over a lattice in time: by site, its centre, participation number and second moment ----------


@dataclass(frozen=True, eq=False)
class Spreading(Result):
    """The distribution of the energy of a lattice in time; dimensionless.

    Attributes:
        t: times, shape (time,).
        energies: of the sites, half of a bond's at each of its ends, shape (time, sites). In a lattice with a gauge
            they have its weights and add up to the energy that is conserved; without one weights are 1.
        centre: mean cell along each direction, from 1, shape (time, directions); around a periodic direction the
            angle of the mean of e^(i 2 pi n/N).
        participation: (sum of e)^2 / sum of e^2: about the number of sites that hold the energy, shape (time,).
        second_moment: mean square distance in cells from the centre, the shorter way round, shape (time,).
    """

    t: Array
    energies: Array
    centre: Array
    participation: Array
    second_moment: Array

    def __repr__(self) -> str:
        return f"<Spreading: {self.t.size} times to {self.t[-1]:g}, {self.energies.shape[1]} sites>"

    @property
    def total(self) -> Array:
        """The sum over all sites, shape (time,)."""
        return np.asarray(self.energies.sum(axis=1))


@in_turn
def spreading(evolution: Evolution) -> Spreading:
    """The distribution of the energy of a lattice in the course of a time evolution.

    Arguments:
        evolution: of a `Lattice`, or a `Chain` of finite length.

    Returns:
        Energies by site, their centre, participation number and second moment at all its times.

    Raises:
        TypeError: the model is no lattice.
        ValueError: a force has no antiderivative that is known.
    """
    check_instance("evolution", evolution, Evolution)
    lattice = as_lattice(evolution.model)
    energies = energies_by_site(lattice, evolution.states, evolution.parameters)
    declaration = lattice.declaration
    share = energies / energies.sum(axis=1, keepdims=True)
    cells = declaration.all_cells().astype(float).repeat(len(declaration.sites), axis=0)
    centre = np.empty((len(share), len(declaration.cells)))
    square = np.zeros_like(share)
    for k, (count, boundary) in enumerate(zip(declaration.cells, declaration.boundary, strict=True)):
        if boundary == PERIODIC:
            angle = np.angle(share @ np.exp(2j * np.pi * cells[:, k] / count))
            centre[:, k] = np.mod(angle * count / (2.0 * np.pi), count)
            off = np.abs(cells[:, k] - centre[:, [k]])
            off = np.minimum(off, count - off)
        else:
            centre[:, k] = share @ cells[:, k]
            off = cells[:, k] - centre[:, [k]]
        square += off**2
    second = np.sum(share * square, axis=1)
    return Spreading(evolution.t, energies, centre + 1.0, 1.0 / np.sum(share**2, axis=1), second)


@in_turn
def energies_by_site(lattice: Lattice, states: ArrayLike, parameters: Mapping[str, float] | None = None) -> Array:
    """Energies of all sites.

    Arguments:
        lattice: the lattice.
        states: positions, then velocities, shape (many, 2 sites).
        parameters: values of parameters that are not the declared ones.

    Returns:
        Shape (many, sites); see `Spreading`.

    Raises:
        ValueError: a force has no antiderivative that is known, or the states do not fit.
    """
    equations, energies = lattice.equations, lattice.structure.energies
    if energies is None:
        raise ValueError("energies: given a force without an antiderivative that is known; accepted: one that has one")
    z = np.atleast_2d(np.asarray(states, dtype=float))
    n = lattice.declaration.size
    if z.shape[1] != 2 * n:
        raise ValueError(f"states: given shape {z.shape}; accepted: (many, {2 * n})")
    function = ca.Function("e", [equations.y, equations.v, equations.parameters], [energies])
    values = np.array(list(named_values(lattice, parameters).values()))
    return np.array(function.map(len(z))(z[:, :n].T, z[:, n:].T, np.tile(values[:, None], len(z)))).T


def as_lattice(model: Any) -> Lattice:
    """A lattice, or a chain of finite length as one; raises TypeError for another model."""
    if isinstance(model, Lattice):
        return model
    if not isinstance(model, Chain) or model.infinite:
        raise TypeError(f"model: given {short_repr(model)}; accepted: a Lattice, or a Chain of finite length")
    if abs(model.gamma) == 1.0:
        raise ValueError(f"gamma: given {model.gamma!r}, whose bonds act one way; accepted: |gamma| < 1")
    return Lattice(model.sites, *model.cell, FIXED, model.parameters, "chain")
