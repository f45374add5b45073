"""Optima solved again as plain orbit problems: by other code, on more harmonics, and along the family from S = 0."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from casadi_skin.bvp.trigonometric import TrigonometricProblem, prolongation_matrix
from casadi_skin.models.ode import OdeModel
from casadi_skin.optimise.search_nlp import SearchNlp
from casadi_skin.optimise.starts import HARMONICS, chain_at, family_orbits
from casadi_skin.solvers.newton import NewtonCorrector
from casadi_skin.theory.linear import Array

ON_FAMILY = 1e-6  # relative difference of Omega to the member of the family


@dataclass(frozen=True)
class PlainCheck:
    """An orbit of a search beside the same orbit problem solved plainly at its parameters.

    `Omega_difference` (absolute) and `residual` (relative to the largest term) are those of Newton's method on the
    equations of the families, on more harmonics. `family_difference` is Omega less that of the member of the mode's
    family at this S, followed from its linear mode, or None where there is none to compare with (alpha_n, or the words
    in `family_words`).
    """

    converged: bool
    Omega_difference: float
    residual: float
    harmonics: int
    family_difference: float | None
    family_words: str = ""

    def on_family(self, Omega: float) -> bool | None:
        """Whether the orbit belongs to the family that grows from the linear mode; None where that is not known."""
        if self.family_difference is None:
            return False if self.family_words else None
        return abs(self.family_difference) <= ON_FAMILY * Omega


def plain_model(programme: SearchNlp, x: Array) -> OdeModel:
    """The gauge equations of the chain at x, of a nonuniform one as well, with kappa = g S as their parameter."""
    model = chain_at(programme.request, programme.free_of(x)).gauge_model()
    if "alpha_n" not in programme.request.free:
        return model
    alpha = programme.parameter(x, "alpha_n")
    uneven, q = ca.SX(alpha - alpha.mean()), model.state
    return replace(model, rhs=model.rhs - uneven * q, hamiltonian=None)


def plain_check(programme: SearchNlp, x: Array, orbit: int) -> PlainCheck:
    """Solve one orbit of x again as a plain orbit problem."""
    harmonics = next(level for level in HARMONICS if level > programme.harmonics or level == HARMONICS[-1])
    problem = TrigonometricProblem(plain_model(programme, x), harmonics)
    S, Omega = programme.amplitude(x, orbit), float(np.sqrt(programme.square_of(x, orbit)))
    kappa = float(programme.parameter(x, "g")) * S
    values = programme.state_of(x, orbit) @ prolongation_matrix(programme.harmonics, harmonics)
    guess = np.concatenate([values.ravel(), [Omega, kappa]])
    correction = NewtonCorrector(problem).correct(guess, problem.parameter_row(), kappa)
    difference = problem.frequency(correction.z) - Omega
    residual = problem.relative_residual(correction.z)
    family, words = _beside_family(programme, x, S, Omega)
    return PlainCheck(correction.converged, difference, residual, harmonics, family, words)


def _beside_family(programme: SearchNlp, x: Array, S: float, Omega: float) -> tuple[float | None, str]:
    request = programme.request
    if "alpha_n" in request.free:
        return None, ""
    plain = replace(request, amplitudes=(S,), several=False)
    try:
        (member,) = family_orbits(plain, tuple(programme.free_of(x).tolist()))
    except (ValueError, ArithmeticError) as error:
        return None, " ".join(str(error).split())
    return Omega - member.Omega, ""
