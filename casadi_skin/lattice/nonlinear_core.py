"""The number of cells at an edge of a long lattice that are nonlinear, and these by themselves as a model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.long_lattice import EdgeMode, LongLattice
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.statement import named_values

NEGLIGIBLE = 1e-16  # of the nonlinear forces: the part that the tail may leave out
LONGEST_CORE = 2000  # sites
KEPT = 0.5  # of the decay of a bound mode's displacements: down to it the core holds all that is nonlinear
HARMONICS = 4  # that are looked at before anything is solved


@dataclass(frozen=True)
class Core:
    """The number of unknown cells, and the decay a cell in the gauge for which these are enough."""

    cells: int
    slowest: float


def core_of(lattice: LongLattice, mode: EdgeMode, amplitude_max: float) -> Core:
    """The cells outside of which nonlinear forces are below round-off; raises ValueError where there are none."""
    tail = lattice.tail(1)
    decay = tail.decay(mode.place) if not mode.pinned else 0.0
    for k in range(3, 2 * HARMONICS, 2):
        try:
            falls = tail.decay(tail.place(k**2 * mode.square)) + lattice.lean
        except ArithmeticError:
            falls = 0.0
        if falls <= 0.0:
            words = f"{k} times the frequency of the mode, which the tail carries away"
            raise ValueError(f"mode: given one with {words}; accepted: harmonics that decay, or a Lattice of all sites")
    reach = max(1.0, amplitude_max * _nonlinearity(lattice, amplitude_max))
    for slowest in (0.0, KEPT * (decay + lattice.lean) - lattice.lean) if decay > 0.0 else (0.0,):
        rate, cells = 2.0 * (slowest + lattice.lean), 2
        while cells * len(lattice.sites) <= LONGEST_CORE and rate > 0.0:
            if cells * rate >= 2.0 * math.log(cells + 1) + math.log(reach / NEGLIGIBLE):
                if cells + 2 > lattice.cells:
                    accepted = f"more than {cells + 2} cells, of which so many are nonlinear, or a Lattice"
                    raise ValueError(f"cells: given {lattice.cells}; accepted: {accepted}")
                return Core(cells, slowest)
            cells += max(1, cells // 64)
    words = f"one that falls by {max(decay + lattice.lean, 0.0):.3g} a cell"
    raise ValueError(f"mode: given {words}; accepted: {LONGEST_CORE} nonlinear sites at the edge at most")


def _nonlinearity(lattice: LongLattice, amplitude_max: float) -> float:
    """The nonlinear part of the forces on one site over its displacement and its amplitude squared."""
    model, a = lattice.sample, math.sqrt(amplitude_max)
    values = list(named_values(model, {}).values())
    force = ca.Function("f", [model.state, model.parameters], [model.rhs, ca.jacobian(model.rhs, model.state)])
    _, J = force(0, values)
    unit = np.eye(model.size)
    beside = [np.array(force(a * e, values)[0]).ravel() - a * np.array(J @ e).ravel() for e in unit]
    largest = np.max(np.abs(beside), initial=0.0, where=np.isfinite(beside))
    return float(largest / a**3 / np.max(np.abs(np.array(J))))


def core_model(lattice: LongLattice, whole: Lattice) -> OdeModel:
    """The cells at the edge of a lattice by themselves, with the cell beyond them held at rest."""
    p = len(lattice.sites)
    n = whole.size - p
    kept, beyond = (slice(p, None), slice(None, p)) if lattice.at_last else (slice(None, n), slice(n, None))

    held, at_rest = ca.vertcat(whole.state[beyond], ca.SX(whole.velocity)[beyond]), ca.SX.zeros(2 * p)
    energy = None if whole.hamiltonian is None else ca.substitute(whole.hamiltonian, held, at_rest)
    return OdeModel(
        lattice.name, whole.state[kept], ca.substitute(whole.rhs, held, at_rest)[kept], whole.parameters, 2,
        ca.SX(whole.velocity)[kept], nominal=whole.nominal, hamiltonian=energy, reversal=(1,) * n + (-1,) * n,
        half_period=(-1,) * (2 * n), checked=False,
    )  # fmt: skip
