"""An optimum of a search: free numbers, orbits, and its checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.solution import Orbit
from casadi_skin.model.arguments import accepted_names
from casadi_skin.optimise.nlp import Kkt, Nlp, Optimality, Solution
from casadi_skin.zero.cosines import cosine_matrix
from casadi_skin.zero.problem import Array

# An orbit in arrays and numbers: a sum of odd cosines, without the equations that it came from ------------------------


@dataclass(frozen=True, eq=False)
class CosineOrbit:
    """An orbit y_n(t) = sum_k c_kn cos((2k+1) Omega t), all velocities zero at t = 0; it can be sent to a process.

    Attributes:
        model: the chain or the model, with the parameters of the orbit; None of a nonuniform chain.
        S: total amplitude, the sum of y_n(0)^2.
        Omega: frequency.
        cosines: c_kn, shape (harmonics, components).
    """

    model: Any
    S: float
    Omega: float
    cosines: Array

    @classmethod
    def of(cls, orbit: Orbit) -> CosineOrbit:
        """The arrays and numbers of an orbit."""
        return cls(orbit.model, orbit.S, orbit.Omega, orbit.coefficients(orbit.harmonics))

    @classmethod
    def at_nodes(cls, model: Any, S: float, Omega: float, values: Array) -> CosineOrbit:
        """From displacements at the nodes, (components, harmonics); the largest at t = 0 becomes positive."""
        harmonics = values.shape[1]
        found = (2.0 / harmonics) * cosine_matrix(harmonics) @ values.T
        start = found.sum(axis=0)
        return cls(model, S, Omega, np.asarray(found * np.sign(start[np.argmax(np.abs(start))])))

    @property
    def period(self) -> float:
        """2 pi/Omega."""
        return 2.0 * np.pi / self.Omega

    @property
    def harmonics(self) -> int:
        """Number of odd harmonics."""
        return len(self.cosines)

    def coefficients(self, harmonics: int) -> Array:
        """The first coefficients c_kn, shape (harmonics, components); 0 beyond those that the orbit has."""
        kept = self.cosines[:harmonics]
        return np.pad(kept, ((0, harmonics - len(kept)), (0, 0)))

    def evaluate(self, t: ArrayLike) -> Array:
        """Displacements y_n(t), shape (time, component)."""
        odd = 2 * np.arange(self.harmonics) + 1
        times = np.atleast_1d(np.asarray(t, dtype=float))
        return np.asarray(np.cos(np.outer(self.Omega * times, odd)) @ self.cosines)

    @cached_property
    def profile(self) -> Array:
        """Displacements at t = 0, shape (components,)."""
        return np.asarray(self.cosines.sum(axis=0))


ON_FAMILY = 1e-6  # relative difference of Omega to the member of the family


@dataclass(frozen=True)
class PlainCheck:
    """An orbit of a search beside the plain orbit problem at its parameters, solved without objective.

    Attributes:
        converged: whether the plain problem was solved.
        Omega_difference: its Omega less that of the optimum, absolute.
        difference: the larger of those of the period and of the states, both relative.
        residual: of the plain problem's equations, relative to their largest term.
        resolution: harmonics or intervals of the plain problem.
        family_difference: Omega less that of the orbit of the mode's family at this S, followed from the linear mode;
            None where there is none to compare with, the reason in `family_words`.
    """

    converged: bool
    Omega_difference: float
    difference: float
    residual: float
    resolution: int
    family_difference: float | None = None
    family_words: str = ""

    def on_family(self, Omega: float) -> bool | None:
        """Whether the orbit belongs to the family that grows from the linear mode; None where the family is missing."""
        if self.family_difference is None:
            return False if self.family_words else None
        return abs(self.family_difference) <= ON_FAMILY * Omega


@dataclass(frozen=True, eq=False)
class Optimum:
    """A local optimum: free numbers, orbits, and its checks. Every quantity of the first orbit is an attribute too.

    Attributes:
        objective: value of the objective.
        parameters: the free numbers by name.
        orbits: the orbits; one unless S was given as a list.
        quantities: quantities of each orbit by name: parameters, period, Omega, and further ones of its problem
            (of the slopes those that the search used).
        checks: each orbit beside a plain solution.
        conditions: values of the conditions by name.
        active: bounds that are active, such as "gamma >= 0".
        kkt: residuals of the conditions of first order, from multipliers and derivatives.
        curvature: the smallest eigenvalue of the Hessian of the Lagrangian (of the negative objective where that is
            maximised) in the free numbers that the constraints leave: positive at a strict optimum, infinite where
            no number is left, nan where it is not computed.
        errors: estimated absolute errors of the objective, Omega or the period, and free numbers by discretisation.
        resolution: harmonics, or intervals of the mesh.
        starts: numbers of the starts that led here.
    """

    objective: float
    parameters: Mapping[str, float]
    orbits: tuple[CosineOrbit, ...] | tuple[Orbit, ...]
    quantities: tuple[Mapping[str, Any], ...]
    checks: tuple[PlainCheck, ...]
    conditions: Mapping[str, Array]
    active: tuple[str, ...]
    kkt: Kkt
    curvature: float
    errors: Mapping[str, float]
    resolution: int
    starts: tuple[int, ...]

    def __repr__(self) -> str:
        free = ", ".join(f"{name} = {value:.10g}" for name, value in list(self.parameters.items())[:4])
        return f"<Optimum: objective {self.objective:.10g} at {free}{', ...' if len(self.parameters) > 4 else ''}>"

    @classmethod
    def of(cls, nlp: Nlp, solution: Solution, found: Optimality, free_names: Sequence[str], **known: Any) -> Optimum:
        """The optimum at the end of Ipopt, with the conditions of optimality there and all else by name."""
        residual, free = nlp.residual(solution.x), solution.x[nlp.measured].tolist()
        return cls(
            objective=solution.objective, parameters=dict(zip(free_names, free, strict=True)), kkt=found.kkt,
            conditions={name: residual[rows] for name, rows in nlp.limits.conditions.items()}, active=found.active,
            curvature=found.curvature, **known,
        )  # fmt: skip

    def __getattr__(self, name: str) -> Any:
        quantities = self.__dict__.get("quantities", ({},))[0]
        if name not in quantities:
            raise AttributeError(f"optimum: given {name}; {accepted_names(name, quantities)}")
        return quantities[name]

    def is_near(self, other: Optimum, tolerance: float) -> bool:
        """Whether objective, free numbers and frequencies are those of another optimum, relative to them or to 1."""
        one, two = (
            np.array([o.objective, *o.parameters.values(), *(q["Omega"] for q in o.quantities)]) for o in (self, other)
        )
        return bool(np.all(np.abs(one - two) <= tolerance * np.maximum(1.0, np.abs(one))))

    @property
    def orbit(self) -> Any:
        """The first orbit."""
        return self.orbits[0]

    @property
    def check(self) -> PlainCheck:
        """The first orbit beside a plain solution."""
        return self.checks[0]

    @property
    def on_family(self) -> bool | None:
        """Whether every orbit belongs to the mode's family; None where that is open, or any orbit will do."""
        known = [check.on_family(q["Omega"]) for check, q in zip(self.checks, self.quantities, strict=True)]
        return None if None in known else all(known)
