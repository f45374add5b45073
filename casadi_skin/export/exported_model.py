"""The source of exported C code: a chain, a model or an orbit, and the parts that can be made of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TypeAlias, cast

from casadi_skin.export.codegen import c_name
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.model.arguments import check_name, short_repr, whole
from casadi_skin.model.ode import OdeModel
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
