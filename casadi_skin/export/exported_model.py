"""The source of exported C code: a chain, a model or an orbit, and the parts that can be made of it.

Parts made of the equations of motion: right-hand side, derivatives, variational system, outputs, flow.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TypeAlias, cast

import casadi as ca
import numpy as np

from casadi_skin.export.codegen import (
    BY_ROWS,
    DECLARATIONS,
    MOST_ENTRIES,
    Call,
    Part,
    Size,
    arrays,
    c_name,
    comment,
    doubles,
    pattern,
    plain,
    strings,
)
from casadi_skin.export.site_loops import called, definition
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.model.arguments import check_name, short_repr, whole
from casadi_skin.model.ode import OdeModel
from casadi_skin.stability.flows import srkn_coefficients
from casadi_skin.zero.cosines import TrigonometricProblem

Source: TypeAlias = Chain | OdeModel | Orbit
EXPORTED_PARTS: Mapping[str, str] = MappingProxyType({
    "rhs": "the right-hand side of the first-order system",
    "jacobian": "the right-hand side with its sparse derivatives",
    "variational": "the right-hand side with the variational equations of any number of columns",
    "outputs": "the outputs that the model names",
    "flow": "the state after a time with its transition matrix; of a chain also the Floquet multipliers",
    "residual": "the collocation equations of periodic orbits with their sparse Jacobian",
    "newton": "Newton's method for periodic orbits, with its own LU factorisation",
    "orbit": "a converged orbit as data, with its evaluation",
    "ipopt": "the orbit equations as a problem for Ipopt (needs libipopt)",
})  # fmt: skip
LONGEST_NAME = 60  # characters: names of files are made of it
NEEDED_PARTS: Mapping[str, tuple[str, ...]] = MappingProxyType({"variational": ("jacobian",), "newton": ("residual",)})
EQUATIONS_OF_ORBITS = ("residual", "newton", "ipopt")
OPTIONAL_PARTS = ("ipopt",)  # exported only on request: it needs more than libm


@dataclass(frozen=True, eq=False)
class ExportedModel:
    """A chain, a model or an orbit under a C name; `harmonics` are those of the equations of a chain's orbits."""

    source: Source
    name: str
    harmonics: int

    @property
    def chain(self) -> Chain | None:
        """The chain, where the source is one or an orbit of one."""
        return self._given if isinstance(self._given, Chain) else None

    @property
    def orbit(self) -> Orbit | None:
        """The orbit, where the source is one."""
        return self.source if isinstance(self.source, Orbit) else None

    @cached_property
    def model(self) -> OdeModel:
        """The equations of motion; a chain's in physical coordinates with parameters alpha, gamma, g."""
        return self._given.tunable_model()

    @property
    def parameters(self) -> tuple[float, ...] | None:
        """Usual values of the parameters, or those of the orbit."""
        if self.orbit is None or self.chain is not None:
            return self.model.nominal
        return tuple(self.orbit.parameters[name] for name in self.model.parameter_names)

    @cached_property
    def flow_model(self) -> OdeModel:
        """The equations that the flow follows; a chain's in the gauge, where its flow is symplectic."""
        return self.model if self.chain is None else self.chain.gauge_model()

    @cached_property
    def problem(self) -> TrigonometricProblem:
        """The collocation equations: those that the orbit was solved with, or a chain's."""
        if self.orbit is None:
            return TrigonometricProblem(self.flow_model, self.harmonics)
        return cast(TrigonometricProblem, self.orbit.point.problem)

    @cached_property
    def jacobian(self) -> Part:
        """The right-hand side with its sparse Jacobian: other parts need its sizes."""
        return jacobian_part(self)

    @property
    def _given(self) -> Chain | OdeModel:
        """The chain or the model, of an orbit its own."""
        given: Chain | OdeModel = self.source.model if isinstance(self.source, Orbit) else self.source
        return given

    def refusal(self, part: str) -> str | None:
        """The reason why a part cannot be exported, in words; None where it can."""
        orbit = self.orbit
        if part == "outputs" and not self.model.outputs:
            return "the model names no outputs"
        if part == "orbit" and orbit is None:
            kind, such = ("model", "find_orbit(...)") if self.chain is None else ("chain", "branch.at(S=0.2)")
            return f"a {kind} alone is no orbit; of an orbit, such as {such}, it can"
        if part in EQUATIONS_OF_ORBITS and self.chain is None:
            return "collocation equations are written for chains and their orbits"
        if part in ("flow", *EQUATIONS_OF_ORBITS) and self.chain is not None and abs(self.chain.gamma) == 1:
            return "at |gamma| = 1 the gauge holds the edge site alone"
        if part in EQUATIONS_OF_ORBITS and orbit is not None:
            if orbit.space.is_family and isinstance(orbit.space.coordinates, CoreWithTail):
                return 'the linear tail of its chain was eliminated; with tail="full" in follow_family it can'
            if not orbit.point.problem.cosines:
                return "its equations are not in odd cosines; with transcription trigonometric it can"
        return None


def exported_model(source: object, name: str | None, harmonics: int) -> ExportedModel:
    """The source of an export under its C name.

    Raises TypeError for anything but a chain, a model or an orbit, ValueError for arguments out of range.
    """
    if not isinstance(source, Source):
        raise TypeError(f"source: given {short_repr(source)}; accepted: a Chain, an OdeModel or an orbit")
    model = source.model if isinstance(source, Orbit) else source
    if model.infinite:
        raise ValueError("sites: given inf; accepted: a whole number (generated C has arrays over all sites)")
    whole("harmonics", harmonics, 2, 512)
    if name is not None and not isinstance(name, str):
        raise TypeError(f"name: given {short_repr(name)}; accepted: a string")
    accepted = c_name(model.name if name is None else name)[:LONGEST_NAME].strip("_")
    if name not in (None, accepted):
        words = f"up to {LONGEST_NAME} lower-case letters, digits and single underscores, such as {accepted}"
        raise ValueError(f"name: given {short_repr(name)}; accepted: {words}")
    return ExportedModel(source, accepted, harmonics)


def chosen_parts(exported: ExportedModel, what: Collection[str] | None) -> list[str]:
    """Names of the parts of an export, with those that they need, in the order of PARTS.

    Arguments:
        exported: The source.
        what: The requested parts; None for all that the source has and that need libm only.

    Raises:
        TypeError: `what` is no list of names.
        ValueError: A name is unknown, or its part cannot be exported.
    """
    if what is None:
        return [name for name in EXPORTED_PARTS if name not in OPTIONAL_PARTS and exported.refusal(name) is None]
    if not isinstance(what, list | tuple | set | frozenset):
        raise TypeError(f"what: given {short_repr(what)}; accepted: a list of {', '.join(EXPORTED_PARTS)}")
    if not what:
        raise ValueError(f"what: given an empty list; accepted: some of {', '.join(EXPORTED_PARTS)}")
    chosen: set[str] = set()
    for name in what:
        check_name("what", name, EXPORTED_PARTS)
        reason = exported.refusal(name)
        if reason is not None:
            can = ", ".join(other for other in EXPORTED_PARTS if exported.refusal(other) is None)
            raise ValueError(f"what: given {name!r}, which cannot be exported: {reason}; accepted: {can}")
        chosen |= {name, *NEEDED_PARTS.get(name, ())}
    if "flow" in chosen and exported.flow_model.order == 1:
        chosen |= {"jacobian", "variational"}
    return [name for name in EXPORTED_PARTS if name in chosen]


# Parts made of the equations of motion: right-hand side, derivatives, variational system, outputs, flow ---------------

CHAIN_CONSTANTS = ("alpha", "gamma", "g")


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
    return called("Right-hand side", Call("rhs", function, ("&t", "x", "p"), ("dxdt",)), "RHS_WORK")


def jacobian_part(exported: ExportedModel) -> Part:
    """The right-hand side with its sparse Jacobian and the derivatives by the parameters."""
    model = exported.model
    dfdx = ca.jacobian(model.full_rhs, model.full_state)
    results = (ca.densify(model.full_rhs), dfdx, ca.densify(ca.jacobian(model.full_rhs, model.parameters)))
    function = model.function(f"{exported.name}_generated_jacobian", *results)
    call = Call("jacobian", function, ("&t", "x", "p"), ("dxdt", "dfdx", "dfdp"))
    sparsity = function.sparsity_out(1)
    size = Size("JACOBIAN_NONZEROS", sparsity.nnz(), "non-zeros of df/dx")
    return called("Jacobian", call, "JACOBIAN_WORK", size).plus(*pattern("@p_jacobian", sparsity))


def variational_part(exported: ExportedModel) -> Part:
    """The variational equations, through the Jacobian."""
    work = sum(size.value for size in exported.jacobian.sizes)
    return Part("Variational equations", (Size("VARIATIONAL_WORK", work, "doubles of work"),), files=("variational",))


def outputs_part(exported: ExportedModel) -> Part:
    """The outputs that the model names."""
    outputs = exported.model.outputs
    results = ca.densify(ca.vertcat(*outputs.values()))
    function = exported.model.function(f"{exported.name}_generated_outputs", results)
    call = Call("outputs", function, ("&t", "x", "p"), ("y",))
    size = Size("OUTPUTS", len(outputs), "y: " + _listed(tuple(outputs)))
    part = called("Outputs", call, "OUTPUTS_WORK", size)
    names = f"extern const char *const @p_output_names[{len(outputs)}];"
    return part.plus(strings("@p_output_names", tuple(outputs)), names)


def flow_part(exported: ExportedModel) -> Part:
    """The flow with its transition matrix; for a chain in the gauge, with the multipliers."""
    model, chain = exported.flow_model, exported.chain
    n = model.full_size
    sizes = (Size("FLOW_STATES", n, "positions, then velocities" if model.order == 2 else "states"),
             Size("FLOW_PARAMETERS", model.parameters.numel(), "parameters of the flow"))  # fmt: skip
    part = Part("Flow", sizes)
    if model.order == 1:
        work = (1 + n) * n * 8 + sum(size.value for size in exported.jacobian.sizes)
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
        f"{DECLARATIONS['force']}{extern}",
        sizes=(
            Size("FORCE_NONZEROS", sparsity.nnz(), "non-zeros of its Jacobian"),
            Size("FORCE_WIDTH", width, "how far a site acts on others"),
            size,
        ),
        functions=functions,
        files=("flow_splitting",),
    )
    if chain is None:
        return part
    size = Size("MULTIPLIERS_WORK", int(chain.sites * (chain.sites + 1)), "doubles of work")
    return part.plus(sizes=(size,), files=("multipliers",))


def _force_call(name: str, model: OdeModel) -> Call:
    time = ca.SX.sym("t") if model.time is None else model.time
    results = [ca.densify(model.rhs), ca.jacobian(model.rhs, model.state).T]  # the non-zeros by rows
    function = ca.Function(f"{name}_generated_force", [time, model.state, model.parameters], results)
    return Call("force", function, ("&t", "q", "p"), ("force", "dfdq"))
