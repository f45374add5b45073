"""Orbits of a family as boundary-value problems: the unfolded field, conditions of symmetry or of periodicity."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.model.ode import OdeModel
from casadi_skin.model.symmetry import SymmetryClass
from casadi_skin.zero.formulation import Formulation


def damping_direction(model: OdeModel) -> ca.SX:
    """Where the unfolding damping acts: along the velocities, or along the gradient of the conserved quantity."""
    if model.velocity is not None:
        return ca.vertcat(ca.SX.zeros(model.size), model.velocity)
    if model.hamiltonian is not None:
        return ca.gradient(model.hamiltonian, model.full_state)
    return ca.SX(model.full_size, 1)  # of no use: only the full period unfolds


def unfolded_field(model: OdeModel) -> ca.Function:
    """Function (x, (p, damping)) -> (F, dF/dx, dF/d(p, damping)) of the field with an added damping."""
    damping = ca.SX.sym("damping")
    x, parameters = model.full_state, ca.vertcat(model.parameters, damping)
    field = model.full_rhs + damping * damping_direction(model)
    results = [field, ca.jacobian(field, x), ca.densify(ca.jacobian(field, parameters))]
    return ca.Function("field", [x, parameters], results)


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
    border = border_rows(model, pinned, unfolded, end)
    return Formulation(
        ca.SX.sym("s"), x, (x, end), ca.vertcat(Omega, p, damping), duration * field, border, ca.SX(0, 1),
        constants=ca.SX.sym("constants", 0),
    )  # fmt: skip


def border_rows(model: OdeModel, pinned: tuple[list[int], list[int]], periodic: bool, end: ca.SX) -> ca.SX:
    """Boundary conditions, then the normalisation, then the phase of a periodic orbit."""
    x, (first, last) = model.full_state, pinned
    conditions = ca.vertcat(x[first], end[last], end - x) if periodic else ca.vertcat(x[first], end[last])
    rows = ca.vertcat(conditions, model.normalisation)
    if periodic:
        rows = ca.vertcat(rows, ca.jacobian(model.normalisation, x) @ model.full_rhs)
    return rows


def border_conditions(model: OdeModel, pinned: tuple[list[int], list[int]], periodic: bool) -> ca.Function:
    """Function (x_start, x_end, p) -> the rows of `border_rows`; then their derivatives."""
    x, p, end = model.full_state, model.parameters, ca.SX.sym("end", model.full_size)
    rows = border_rows(model, pinned, periodic, end)
    derivatives = [ca.jacobian(rows, v) for v in (x, end, p)]
    return ca.Function("conditions", [x, end, p], [rows, *derivatives])
