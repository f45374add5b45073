"""Parts made of the equations of motion: right-hand side, derivatives, variational system, outputs, flow."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.export.codegen import (
    BY_ROWS,
    MOST_ENTRIES,
    Call,
    Part,
    Size,
    arrays,
    comment,
    declared,
    doubles,
    pattern,
    plain,
    strings,
)
from casadi_skin.export.exported_model import ExportedModel
from casadi_skin.export.site_loops import called, definition
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.ode import OdeModel
from casadi_skin.stability.splitting import srkn_coefficients

CHAIN_CONSTANTS = ("alpha", "gamma", "g")
GIVEN_C_ARGUMENTS = "double t, const double *x, const double *p"


def model_part(exported: ExportedModel) -> Part:
    """Sizes, names and usual parameters."""
    states, parameters = exported.model.state_names, exported.model.parameter_names
    lines = [
        comment("Names of the states, and of the parameters, in their order."),
        f"extern const char *const @p_state_names[{max(1, len(states))}];",
        f"extern const char *const @p_parameter_names[{max(1, len(parameters))}];",
    ]
    sizes = (Size("STATES", len(states), "x: " + _listed(states)),
             Size("PARAMETERS", len(parameters), "p: " + _listed(parameters)))  # fmt: skip
    names = (strings("@p_state_names", states), strings("@p_parameter_names", parameters))
    part = Part("The model", sizes, ("\n".join(lines),), names)
    if exported.parameters is not None:
        part = part.plus(*arrays("@p", {"nominal": exported.parameters}, "Usual values of the parameters."))
    return part if exported.chain is None else _with_chain(part, exported.chain)


def _with_chain(part: Part, chain: Chain) -> Part:
    """The part with the chain's numbers and the factors of its gauge."""
    words = (
        "The chain, and the factors rho of its gauge y_n = sqrt(S) rho_n q_n, S the sum of y_n^2 at t = 0 of an orbit: "
        "there the flow is symplectic, and its only parameter is kappa = g S."
    )
    constants = ", ".join(f"@p_{name}" for name in CHAIN_CONSTANTS)
    declaration = f"{comment(words)}\nextern const double {constants};\nextern const double @p_rho[{chain.sites}];"
    numbers = "\n".join(f"const double @p_{name} = {getattr(chain, name):.17g};" for name in CHAIN_CONSTANTS)
    size = Size("SITES", int(chain.sites), "sites of the chain")
    return part.plus(f"{numbers}\n\n{doubles('@p_rho', np.asarray(chain.rho))}", declaration, sizes=(size,))


def _listed(names: tuple[str, ...]) -> str:
    shown = [plain(name) for name in names]
    return ", ".join(shown if len(shown) <= 6 else [*shown[:2], "...", shown[-1]]) or "none"


def rhs_part(exported: ExportedModel) -> Part:
    """The right-hand side."""
    function = exported.model.function(f"{exported.name}_generated_rhs", ca.densify(exported.model.full_rhs))
    prototype = f"int @p_rhs({GIVEN_C_ARGUMENTS}, double *dxdt, double *work)"
    call = Call(prototype, function, ("&t", "x", "p"), ("dxdt",))
    return called("Right-hand side", call, "RHS_WORK", "dx/dt at time t (STATES entries). Returns 0.")


def jacobian_part(exported: ExportedModel) -> Part:
    """The right-hand side with its sparse Jacobian and the derivatives by the parameters."""
    model = exported.model
    dfdx = ca.jacobian(model.full_rhs, model.full_state)
    results = (ca.densify(model.full_rhs), dfdx, ca.densify(ca.jacobian(model.full_rhs, model.parameters)))
    function = model.function(f"{exported.name}_generated_jacobian", *results)
    prototype = f"int @p_jacobian({GIVEN_C_ARGUMENTS}, double *dxdt, double *dfdx, double *dfdp, double *work)"
    call = Call(prototype, function, ("&t", "x", "p"), ("dxdt", "dfdx", "dfdp"))
    sparsity = function.sparsity_out(1)
    words = (
        "dx/dt, the non-zeros of df/dx by columns (JACOBIAN_NONZEROS of them; column j has entries colptr[j] to "
        "colptr[j+1]-1 in the rows named), and df/dp, dense by columns (STATES times PARAMETERS). A result may be a "
        "null pointer where it is not wanted. Returns 0."
    )
    size = Size("JACOBIAN_NONZEROS", sparsity.nnz(), "non-zeros of df/dx")
    return called("Jacobian", call, "JACOBIAN_WORK", words, size).plus(*pattern("@p_jacobian", sparsity))


def variational_part(exported: ExportedModel) -> Part:
    """The variational equations, through the Jacobian."""
    work = sum(size.value for size in jacobian_part(exported).sizes)
    prototype = (
        f"int @p_variational({GIVEN_C_ARGUMENTS}, int columns, const double *V,\n"
        "                   double *dxdt, double *dVdt, double *work)"
    )
    words = (
        "dx/dt and dV/dt = (df/dx) V for V of any number of columns, one after the other (STATES entries each). "
        "Returns 0."
    )
    size = Size("VARIATIONAL_WORK", work, "doubles of work")
    return Part("Variational equations", (size,), (declared(prototype, words),), files=("variational",))


def outputs_part(exported: ExportedModel) -> Part:
    """The outputs that the model names."""
    outputs = exported.model.outputs
    results = ca.densify(ca.vertcat(*outputs.values()))
    function = exported.model.function(f"{exported.name}_generated_outputs", results)
    call = Call(f"int @p_outputs({GIVEN_C_ARGUMENTS}, double *y, double *work)", function, ("&t", "x", "p"), ("y",))
    size = Size("OUTPUTS", len(outputs), "y: " + _listed(tuple(outputs)))
    part = called("Outputs", call, "OUTPUTS_WORK", "The outputs (OUTPUTS entries). Returns 0.", size)
    names = f"extern const char *const @p_output_names[{len(outputs)}];"
    return part.plus(strings("@p_output_names", tuple(outputs)), names)


def flow_part(exported: ExportedModel) -> Part:
    """The flow with its transition matrix; for a chain in the gauge, with the multipliers."""
    model, chain = exported.flow_model, exported.chain
    prototype = (
        "int @p_flow(double t, double duration, int steps, double *x, double *Phi, const double *p, double *work)"
    )
    where = " The flow of a chain is that of the gauge: x = (q, q'), p = (kappa)." if chain is not None else ""
    kind = "symplectic splitting of order 6" if model.order == 2 else "extrapolated midpoint rule of order 8"
    words = (
        f"Moves the state x (FLOW_STATES entries, p as many as FLOW_PARAMETERS) from time t on by `duration` in equal "
        f"steps ({kind}) and gives the transition matrix Phi, by columns, unless it is a null pointer. Returns 0, or 1 "
        f"for steps < 1.{where}"
    )
    n = model.full_size
    sizes = (Size("FLOW_STATES", n, "positions, then velocities" if model.order == 2 else "states"),
             Size("FLOW_PARAMETERS", model.parameters.numel(), "parameters of the flow"))  # fmt: skip
    part = Part("Flow", sizes, (declared(prototype, words),))
    if model.order == 1:
        work = (1 + n) * n * 8 + sum(size.value for size in jacobian_part(exported).sizes)
        return part.plus(sizes=(Size("FLOW_WORK", work, "doubles of work"),), files=("flow_extrapolation",))
    force = _force_call(exported.name, model)
    sparsity = force.function.sparsity_out(1)
    text, functions, work = definition(force)
    size = Size("FLOW_WORK", 3 * model.size + sparsity.nnz() + work, "doubles of work")
    rows, columns = (np.array(t) for t in sparsity.get_triplet())
    width = int(np.abs(rows - columns).max(initial=0))
    if n * n > MOST_ENTRIES:
        raise ValueError(f"{exported.name}: a transition matrix of {n * n} entries; accepted: up to {MOST_ENTRIES}")
    indices, extern = pattern("@p_force", sparsity, BY_ROWS)
    coefficients = dict(zip(("drifts", "kicks"), srkn_coefficients(), strict=True))
    part = part.plus(*arrays("@p_flow", coefficients, "Coefficients of the splitting.")).plus(
        f"{indices}\n\n{text}",
        f"{declared(force.prototype, 'Used by the flow.')}\n{extern}",
        sizes=(
            Size("FORCE_NONZEROS", sparsity.nnz(), "non-zeros of its Jacobian"),
            Size("FORCE_WIDTH", width, "how far a site acts on others"),
            size,
        ),
        functions=functions,
        files=("flow_splitting",),
    )
    return part if chain is None else _with_multipliers(part, int(chain.sites))


def _force_call(name: str, model: OdeModel) -> Call:
    time = ca.SX.sym("t") if model.time is None else model.time
    results = [ca.densify(model.rhs), ca.jacobian(model.rhs, model.state).T]  # the non-zeros by rows
    function = ca.Function(f"{name}_generated_force", [time, model.state, model.parameters], results)
    prototype = "int @p_force(double t, const double *q, const double *p, double *force, double *dfdq, double *work)"
    return Call(prototype, function, ("&t", "q", "p"), ("force", "dfdq"))


def _with_multipliers(part: Part, sites: int) -> Part:
    prototype = (
        "int @p_multipliers(const double *Phi, double tolerance, double *mu_real, double *mu_imaginary,\n"
        "                   double *largest, double *trivial, double *work)"
    )
    words = (
        "Floquet multipliers of an orbit that starts at rest, from Phi over a quarter of its period: the SITES numbers "
        "mu, with 2 + 4 mu = lambda + 1/lambda for the map over half the period, and the largest modulus of a "
        "multiplier lambda^2 over the period but for the trivial pair (mu = -1), whose distance from -1 is `trivial`. "
        "A mu that is real and in [-1, 0] within `tolerance` has modulus 1: the orbit is stable where all are. Returns "
        "0, or 1 where the QR iteration does not converge."
    )
    size = Size("MULTIPLIERS_WORK", sites * (sites + 1), "doubles of work")
    return part.plus(declaration=declared(prototype, words), sizes=(size,), files=("multipliers",))
