"""Orbits of a family in full states: the unfolded field, their conditions, and collocation of any first-order model.

x' = T f(x, p) + T damping D(x) on a quarter, half or full period of length T = part 2 pi/Omega, from one fixed set of
the reversal to the other, or closed; see `FirstOrderProblem` for the order of the unknowns.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.model.conserved import SymmetryClass, pinned_components, unfolded_phases
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.formulation import Formulation
from casadi_skin.zero.problem import Array, OrbitProblem

PHASE_DIFFERENCE_STEP = 1e-5  # of a phase, for velocities


def damping_direction(model: OdeModel) -> ca.SX:
    """Where the unfolding damping acts: along the velocities, or along the gradient of the conserved quantity."""
    if model.velocity is not None:
        return ca.vertcat(ca.SX.zeros(model.size), model.velocity)
    if model.hamiltonian is not None:
        return ca.gradient(model.hamiltonian, model.full_state)
    return ca.SX(model.full_size, 1)  # of no use: only the full period unfolds


def orbit_formulation(
    model: OdeModel, symmetry: SymmetryClass, pinned: tuple[list[int], list[int]], unfolded: bool
) -> Formulation:
    """The part of a period that the symmetry leaves unknown, with scalars (Omega, parameter, damping if unfolded).

    The components `pinned` vanish at the start and at the end; an unfolded orbit closes, and its phase is where the
    normalisation is stationary along the flow.
    """
    Omega, damping = ca.SX.sym("Omega"), ca.SX.sym("damping", int(unfolded))
    field = model.full_rhs
    if unfolded:
        field = field + damping * damping_direction(model)
    duration = symmetry.value * 2.0 * np.pi / Omega
    x, p, end = model.full_state, model.parameters, ca.SX.sym("end", model.full_size)
    first, last = pinned
    closed = end - x if unfolded else ca.SX(0, 1)
    rows = ca.vertcat(x[first], end[last], closed, model.normalisation)
    if unfolded:
        rows = ca.vertcat(rows, ca.jacobian(model.normalisation, x) @ model.full_rhs)
    return Formulation(
        ca.SX.sym("s"), x, (x, end), ca.vertcat(Omega, p, damping), duration * field, rows, ca.SX(0, 1),
        constants=ca.SX.sym("constants", 0),
    )  # fmt: skip


class FirstOrderProblem(OrbitProblem):
    """Unknowns are full states in the order of time, Omega, the free parameter and the unfolding parameter.

    The last is there for the full period only: the coefficient of a damping that a conservative model does not have,
    which makes the equations regular (Sepulchre and MacKay 1997; Munoz-Almaraz et al. 2003); it comes back as zero. The
    phase is where the model's normalisation is stationary along the flow. Raises ValueError for missing symmetries.
    """

    def __init__(self, model: OdeModel, resolution: int, symmetry: SymmetryClass) -> None:
        if model.parameters.numel() != 1 or model.normalisation is None:
            raise ValueError(f"{model.name}: a family needs one free parameter and a normalisation")
        if symmetry is SymmetryClass.FULL and model.order == 1 and model.hamiltonian is None:
            raise ValueError(f"{model.name}: the full period unfolds a conserved quantity; declare its hamiltonian")
        self.model, self.resolution, self.symmetry = model, resolution, symmetry
        self.pinned = pinned_components(model, symmetry)
        self.unfolded = symmetry is SymmetryClass.FULL

    @property
    def size(self) -> int:
        return self.states + 2 + int(self.unfolded)

    @property
    def damping_index(self) -> int:
        """Place of the unfolding parameter among the unknowns (full period only)."""
        return self.states + 2

    def of_shorter_period(self, z: Array, turns: int) -> Array:
        phases = self.phases() / turns
        states = self.sample(z, phases)
        if self.model.order == 2:
            ends = [self.sample(z, phases + side * PHASE_DIFFERENCE_STEP) for side in (-1.0, 1.0)]
            states = np.hstack([states, self.frequency(z) * (ends[1] - ends[0]) / (2.0 * PHASE_DIFFERENCE_STEP)])
        return states.ravel()

    def _spread(self, factors: Array) -> Array:
        return np.tile(factors, self.states // factors.size)  # velocities are shown as positions are

    def pack(self, positions: Array, Omega: float, parameter: float) -> Array:
        theta = self.phases()
        state = np.outer(np.cos(theta), positions)
        if self.model.order == 2:
            state = np.hstack([state, np.outer(-Omega * np.sin(theta), positions)])
        return np.concatenate([state.ravel(), [Omega, parameter], np.zeros(int(self.unfolded))])


class CollocationProblem(CollocationEquations, FirstOrderProblem):
    """Equations of K intervals with d stages of the part of the period that the symmetry leaves unknown.

    Raises ValueError for missing symmetries.
    """

    def __init__(self, model: OdeModel, intervals: int, symmetry: SymmetryClass, table: CollocationTable) -> None:
        FirstOrderProblem.__init__(self, model, intervals, symmetry)
        self._discretise(orbit_formulation(model, symmetry, self.pinned, self.unfolded), intervals, table)

    def phases(self) -> Array:
        return self.symmetry.value * 2.0 * np.pi * self._fractions()

    def sample(self, z: Array, theta: Array) -> Array:
        fractions, signs = unfolded_phases(self.model, self.symmetry, theta)
        full = signs * self._interpolate(z, fractions)
        return np.asarray(full[:, : self.model.size])
