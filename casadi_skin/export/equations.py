"""Parts made of the equations of motion: right-hand side, derivatives, variational system, outputs, flow."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from casadi_skin.export.c_text import BY_COLUMNS, BY_ROWS, Call, comment, doubles, pattern, plain, strings
from casadi_skin.export.exported_model import Subject
from casadi_skin.export.part import Part, Size, called, declared
from casadi_skin.integrators.srkn import srkn_coefficients
from casadi_skin.lattice.chain import Chain
from casadi_skin.models.ode import OdeModel

CONSTANTS = ("alpha", "gamma", "g")
GIVEN = "double t, const double *x, const double *p"


def model_part(subject: Subject) -> Part:
    """Sizes, names and usual parameters."""
    model = subject.model
    parameters, states = model.parameter_names, model.state_names
    definitions = [strings("@p_state_names", states), strings("@p_parameter_names", parameters)]
    lines = [
        comment("Names of the states, and of the parameters, in their order."),
        f"extern const char *const @p_state_names[{max(1, len(states))}];",
        f"extern const char *const @p_parameter_names[{max(1, len(parameters))}];",
    ]
    if model.nominal is not None:
        definitions.append(doubles("@p_nominal", model.nominal))
        lines += [
            comment("Usual values of the parameters."),
            f"extern const double @p_nominal[{max(1, len(parameters))}];",
        ]
    sizes = [Size("STATES", len(states), "x: " + _listed(states)),
             Size("PARAMETERS", len(parameters), "p: " + _listed(parameters))]  # fmt: skip
    part = Part("The model", tuple(sizes), ("\n".join(lines),), tuple(definitions))
    return part if subject.chain is None else _with_chain(part, subject.chain)


def _with_chain(part: Part, chain: Chain) -> Part:
    """The part with the chain's numbers and the factors of its gauge."""
    words = (
        "The chain, and the factors rho of its gauge y_n = sqrt(S) rho_n q_n, S the sum of y_n^2 at t = 0 of an orbit: "
        "there the flow is symplectic, and its only parameter is kappa = g S."
    )
    constants = ", ".join(f"@p_{name}" for name in CONSTANTS)
    declaration = f"{comment(words)}\nextern const double {constants};\nextern const double @p_rho[{chain.sites}];"
    numbers = [f"const double @p_{name} = {getattr(chain, name):.17g};" for name in CONSTANTS]
    return replace(
        part,
        sizes=(*part.sizes, Size("SITES", int(chain.sites), "sites of the chain")),
        declarations=(*part.declarations, declaration),
        definitions=(*part.definitions, "\n".join(numbers), doubles("@p_rho", np.asarray(chain.rho))),
    )


def _listed(names: tuple[str, ...]) -> str:
    shown = [plain(name) for name in names]
    return ", ".join(shown if len(shown) <= 6 else [*shown[:2], "...", shown[-1]]) or "none"


def rhs_part(subject: Subject) -> Part:
    """The right-hand side."""
    function = subject.model.function(f"{subject.name}_generated_rhs", ca.densify(subject.model.full_rhs))
    prototype = f"int @p_rhs({GIVEN}, double *dxdt, double *work)"
    call = Call(prototype, function, ("&t", "x", "p"), ("dxdt",))
    return called("Right-hand side", call, "RHS_WORK", "dx/dt at time t (STATES entries). Returns 0.")


def jacobian_part(subject: Subject) -> Part:
    """The right-hand side with its sparse Jacobian and the derivatives by the parameters."""
    model = subject.model
    dfdx = ca.jacobian(model.full_rhs, model.full_state)
    results = (ca.densify(model.full_rhs), dfdx, ca.densify(ca.jacobian(model.full_rhs, model.parameters)))
    function = model.function(f"{subject.name}_generated_jacobian", *results)
    prototype = f"int @p_jacobian({GIVEN}, double *dxdt, double *dfdx, double *dfdp, double *work)"
    call = Call(prototype, function, ("&t", "x", "p"), ("dxdt", "dfdx", "dfdp"))
    sparsity = function.sparsity_out(1)
    words = (
        "dx/dt, the non-zeros of df/dx by columns (JACOBIAN_NONZEROS of them; column j has entries colptr[j] to "
        "colptr[j+1]-1 in the rows named), and df/dp, dense by columns (STATES times PARAMETERS). A result may be a "
        "null pointer where it is not wanted. Returns 0."
    )
    size = Size("JACOBIAN_NONZEROS", sparsity.nnz(), "non-zeros of df/dx")
    part = called("Jacobian", call, "JACOBIAN_WORK", words, size)
    return replace(
        part,
        declarations=(*part.declarations, pattern_declaration("@p_jacobian", sparsity)),
        definitions=(pattern("@p_jacobian", sparsity), *part.definitions),
    )


def pattern_declaration(name: str, sparsity: ca.Sparsity, names: tuple[str, str] = BY_COLUMNS) -> str:
    """Declarations of what `pattern` defines."""
    starts, places = names
    sizes = sparsity.size2() + 1, max(1, sparsity.nnz())
    return f"extern const int {name}_{starts}[{sizes[0]}];\nextern const int {name}_{places}[{sizes[1]}];"


def variational_part(subject: Subject) -> Part:
    """The variational equations, through the Jacobian."""
    jacobian = jacobian_part(subject)
    nonzeros, work = (size.value for size in jacobian.sizes)
    prototype = (
        f"int @p_variational({GIVEN}, int columns, const double *V,\n"
        "                   double *dxdt, double *dVdt, double *work)"
    )
    words = (
        "dx/dt and dV/dt = (df/dx) V for V of any number of columns, one after the other (STATES entries each). "
        "Returns 0."
    )
    return Part(
        "Variational equations",
        (Size("VARIATIONAL_WORK", nonzeros + work, "doubles of work"),),
        (declared(prototype, words),),
        files=("variational",),
    )


def outputs_part(subject: Subject) -> Part:
    """The outputs that the model names."""
    outputs = subject.model.outputs
    results = ca.densify(ca.vertcat(*outputs.values()))
    function = subject.model.function(f"{subject.name}_generated_outputs", results)
    call = Call(f"int @p_outputs({GIVEN}, double *y, double *work)", function, ("&t", "x", "p"), ("y",))
    size = Size("OUTPUTS", len(outputs), "y: " + _listed(tuple(outputs)))
    part = called("Outputs", call, "OUTPUTS_WORK", "The outputs (OUTPUTS entries). Returns 0.", size)
    names = f"extern const char *const @p_output_names[{len(outputs)}];"
    return replace(
        part,
        declarations=(*part.declarations, names),
        definitions=(*part.definitions, strings("@p_output_names", tuple(outputs))),
    )


def flow_part(subject: Subject) -> Part:
    """The flow with its transition matrix; for a chain in the gauge, with the multipliers."""
    model = subject.flow_model
    prototype = (
        "int @p_flow(double t, double duration, int steps, double *x, double *Phi, const double *p, double *work)"
    )
    where = " The flow of a chain is that of the gauge: x = (q, q'), p = (kappa)." if subject.chain is not None else ""
    kind = "symplectic splitting of order 6" if model.order == 2 else "extrapolated midpoint rule of order 8"
    words = (
        f"Moves the state x (FLOW_STATES entries, p as many as FLOW_PARAMETERS) from time t on by `duration` in equal "
        f"steps ({kind}) and gives the transition matrix Phi, by columns, unless it is a null pointer. Returns 0, or 1 "
        f"for steps < 1.{where}"
    )
    n = model.full_size
    sizes = [Size("FLOW_STATES", n, "positions, then velocities" if model.order == 2 else "states"),
             Size("FLOW_PARAMETERS", model.parameters.numel(), "parameters of the flow")]  # fmt: skip
    if model.order == 1:
        work = (1 + n) * n * 8 + sum(size.value for size in jacobian_part(subject).sizes)
        work_size = Size("FLOW_WORK", work, "doubles of work")
        return Part("Flow", (*sizes, work_size), (declared(prototype, words),), files=("flow_extrapolation",))
    force = _force_call(subject, model)
    sparsity = force.function.sparsity_out(1)
    work = model.size + sparsity.nnz() + force.work
    sizes += [Size("FORCE_NONZEROS", sparsity.nnz(), "non-zeros of its Jacobian"),
              Size("FLOW_WORK", work, "doubles of work")]  # fmt: skip
    drifts, kicks = srkn_coefficients()
    inner = (
        f"{declared(force.prototype, 'Used by the flow.')}\n{pattern_declaration('@p_force', sparsity, BY_ROWS)}\n"
        f"extern const double @p_flow_drifts[{drifts.size}];\nextern const double @p_flow_kicks[{kicks.size}];"
    )
    part = Part(
        "Flow",
        tuple(sizes),
        (declared(prototype, words), inner),
        (
            pattern("@p_force", sparsity, BY_ROWS),
            doubles("@p_flow_drifts", drifts),
            doubles("@p_flow_kicks", kicks),
            force.text(),
        ),
        (force.function,),
        ("flow_splitting",),
    )
    return part if subject.chain is None else _with_multipliers(part, subject)


def _force_call(subject: Subject, model: OdeModel) -> Call:
    time = ca.SX.sym("t") if model.time is None else model.time
    results = [ca.densify(model.rhs), ca.jacobian(model.rhs, model.state).T]  # the non-zeros by rows
    function = ca.Function(f"{subject.name}_generated_force", [time, model.state, model.parameters], results)
    prototype = "int @p_force(double t, const double *q, const double *p, double *force, double *dfdq, double *work)"
    return Call(prototype, function, ("&t", "q", "p"), ("force", "dfdq"))


def _with_multipliers(part: Part, subject: Subject) -> Part:
    assert subject.chain is not None
    N = int(subject.chain.sites)
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
    return replace(
        part,
        sizes=(*part.sizes, Size("MULTIPLIERS_WORK", 2 * N * N + 4 * N, "doubles of work")),
        declarations=(*part.declarations, declared(prototype, words)),
        files=(*part.files, "multipliers"),
    )
