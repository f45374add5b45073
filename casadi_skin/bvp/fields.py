"""CasADi functions that transcriptions of first order are assembled from: the unfolded field, the border conditions."""

from __future__ import annotations

import casadi as ca

from casadi_skin.models.ode import OdeModel


def unfolded_field(model: OdeModel) -> ca.Function:
    """Function (x, (p, damping)) -> (F, dF/dx, dF/d(p, damping)) of the field with an added damping.

    The damping acts along the velocities, or along the gradient of the conserved quantity.
    """
    damping = ca.SX.sym("damping")
    if model.velocity is not None:
        direction = ca.vertcat(ca.SX.zeros(model.size), model.velocity)
    elif model.hamiltonian is not None:
        direction = ca.gradient(model.hamiltonian, model.full_state)
    else:  # of no use: only the full period unfolds
        direction = ca.SX(model.full_size, 1)
    x, parameters = model.full_state, ca.vertcat(model.parameters, damping)
    field = model.full_rhs + damping * direction
    results = [field, ca.jacobian(field, x), ca.densify(ca.jacobian(field, parameters))]
    return ca.Function("field", [x, parameters], results)


def border_conditions(model: OdeModel, pinned: tuple[list[int], list[int]], periodic: bool) -> ca.Function:
    """Function (x_start, x_end, p) -> boundary conditions, normalisation, phase; then their derivatives.

    The components `pinned` vanish at the start and at the end; a `periodic` orbit closes, and its phase is where the
    normalisation is stationary along the flow.
    """
    x, p, end = model.full_state, model.parameters, ca.SX.sym("end", model.full_size)
    first, last = pinned
    conditions = ca.vertcat(x[first], end[last], end - x) if periodic else ca.vertcat(x[first], end[last])
    rows = ca.vertcat(conditions, model.normalisation)
    if periodic:
        rows = ca.vertcat(rows, ca.jacobian(model.normalisation, x) @ model.full_rhs)
    derivatives = [ca.jacobian(rows, v) for v in (x, end, p)]
    return ca.Function("conditions", [x, end, p], [rows, *derivatives])
