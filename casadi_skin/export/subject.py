"""What is exported as C: a chain, a model or an orbit, with what each of them has to offer."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property

from casadi_skin.arguments import short_repr
from casadi_skin.bvp.trigonometric import TrigonometricProblem
from casadi_skin.export.codegen import c_name
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.models.ode import OdeModel
from casadi_skin.orbits.orbit import Orbit

WHAT: Mapping[str, str] = {
    "rhs": "the right-hand side of the first-order system",
    "jacobian": "the right-hand side with its sparse derivatives",
    "variational": "the right-hand side with the variational equations of any number of columns",
    "outputs": "the outputs that the model names",
    "flow": "the state after a time with its transition matrix; of a chain also the Floquet multipliers",
    "residual": "the collocation equations of periodic orbits with their sparse Jacobian",
    "newton": "Newton's method for periodic orbits, with its own LU factorisation",
    "orbit": "a converged orbit as data, with its evaluation",
    "ipopt": "the orbit equations as a problem for Ipopt (needs libipopt)",
}
NEEDS: Mapping[str, tuple[str, ...]] = {
    "variational": ("jacobian",),
    "newton": ("residual",),
}
IN_THE_GAUGE = ("flow", "residual", "newton", "ipopt")  # of a chain or an orbit
OPTIONAL = ("ipopt",)  # not exported unless asked for: it needs more than libm
LONGEST_NAME = 60  # characters: names of files are made of it


@dataclass(frozen=True, eq=False)
class Subject:
    """A chain, a model or an orbit under a C name; `harmonics` are those of the equations of a chain's orbits."""

    source: Chain | OdeModel | Orbit
    name: str
    harmonics: int

    @property
    def chain(self) -> Chain | None:
        """The chain, where it is one or an orbit of one."""
        if isinstance(self.source, Orbit):
            return self.source.chain
        return self.source if isinstance(self.source, Chain) else None

    @property
    def orbit(self) -> Orbit | None:
        """The orbit, where it is one."""
        return self.source if isinstance(self.source, Orbit) else None

    @cached_property
    def model(self) -> OdeModel:
        """The equations of motion; a chain's in physical coordinates with parameters alpha, gamma, g."""
        return self.source if isinstance(self.source, OdeModel) else self._chain.tunable_model()

    @cached_property
    def flow_model(self) -> OdeModel:
        """The equations that the flow follows; a chain's in the gauge, where its flow is symplectic."""
        return self.source if isinstance(self.source, OdeModel) else self._chain.gauge_model()

    @cached_property
    def problem(self) -> TrigonometricProblem:
        """The collocation equations: those that the orbit was solved with, or a chain's."""
        if self.orbit is None:
            return TrigonometricProblem(self.flow_model, self.harmonics)
        problem = self.orbit.point.problem
        assert isinstance(problem, TrigonometricProblem)
        return problem

    @property
    def _chain(self) -> Chain:
        assert self.chain is not None
        return self.chain

    def refusal(self, what: str) -> str | None:
        """Why it cannot be exported, in words; None where it can."""
        if what == "outputs" and not self.model.outputs:
            return "the model names no outputs"
        if what in ("residual", "newton", "orbit", "ipopt") and isinstance(self.source, OdeModel):
            return "a model alone has no orbit; of a chain or an orbit it can"
        if what == "orbit" and self.orbit is None:
            return "a chain alone is no orbit; of an orbit, such as branch.at(S=0.2), it can"
        if what in IN_THE_GAUGE and self.chain is not None and abs(self.chain.gamma) == 1:
            return "at |gamma| = 1 the gauge holds the edge site alone"
        if what in IN_THE_GAUGE and what != "flow" and self.orbit is not None:
            return self._not_in_cosines(self.orbit)
        return None

    @staticmethod
    def _not_in_cosines(orbit: Orbit) -> str | None:
        if isinstance(orbit.tools.layout, CoreWithTail):
            return 'the linear tail of its chain was eliminated; with tail="full" in follow_family it can'
        if not isinstance(orbit.point.problem, TrigonometricProblem):
            return "its equations are not in odd cosines; with transcription trigonometric it can"
        return None


def subject_of(source: object, name: str | None, harmonics: int) -> Subject:
    """What is to be exported.

    Raises TypeError for anything but a chain, a model or an orbit, ValueError for arguments out of range.
    """
    if not isinstance(source, Chain | OdeModel | Orbit):
        raise TypeError(f"source: given {short_repr(source)}; accepted: a Chain, an OdeModel or an Orbit")
    if isinstance(source, OdeModel):
        return Subject(source, _name(source.name if name is None else name, name), harmonics)
    chain = source if isinstance(source, Chain) else source.chain
    if chain.infinite:
        raise ValueError("sites: given inf; accepted: a whole number (generated C has arrays over all sites)")
    if isinstance(harmonics, bool) or not isinstance(harmonics, int) or not 2 <= harmonics <= 512:
        raise ValueError(f"harmonics: given {short_repr(harmonics)}; accepted: a whole number from 2 to 512")
    return Subject(source, _name("chain" if name is None else name, name), harmonics)


def _name(words: str, given: str | None) -> str:
    if not isinstance(words, str):
        raise TypeError(f"name: given {short_repr(given)}; accepted: a string")
    name = c_name(words[:LONGEST_NAME])
    if given is not None and given != name:
        accepted = f"up to {LONGEST_NAME} lower-case letters, digits and single underscores, such as {name}"
        raise ValueError(f"name: given {short_repr(given)}; accepted: {accepted}")
    return name


def wanted(subject: Subject, what: Collection[str] | None) -> list[str]:
    """The names of what is exported, with what these need, in the order of WHAT; None stands for all that libm serves.

    Raises TypeError and ValueError for what is no list of known names, or cannot be exported, in one line.
    """
    if what is None:
        return [name for name in WHAT if name not in OPTIONAL and subject.refusal(name) is None]
    if isinstance(what, str | bytes) or not isinstance(what, Collection):
        raise TypeError(f"what: given {short_repr(what)}; accepted: a list of {', '.join(WHAT)}")
    if not what:
        raise ValueError(f"what: given an empty list; accepted: some of {', '.join(WHAT)}")
    chosen: set[str] = set()
    for name in what:
        if not isinstance(name, str) or name not in WHAT:
            near = get_close_matches(str(name).lower(), list(WHAT), n=1)
            hint = f"did you mean {near[0]}? (accepted: {', '.join(WHAT)})" if near else f"accepted: {', '.join(WHAT)}"
            raise ValueError(f"what: given {short_repr(name)}; {hint}")
        reason = subject.refusal(name)
        if reason is not None:
            can = ", ".join(other for other in WHAT if subject.refusal(other) is None)
            raise ValueError(f"what: given {name!r}, which cannot be exported: {reason}; accepted: {can}")
        chosen |= {name, *NEEDS.get(name, ())}
    if "flow" in chosen and subject.flow_model.order == 1:
        chosen |= {"jacobian", "variational"}
    return [name for name in WHAT if name in chosen]
