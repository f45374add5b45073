"""Choices for a boundary-value problem: methods, scales of its unknowns, and the data of orbits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.model import methods
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.symmetry import SymmetryClass
from casadi_skin.zero.method import Method
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statement import Statement

DEGREE, FIRST = 6, 12  # of the polynomials, and intervals of the first mesh, by default


def boundary_method(options: Mapping[str, Any]) -> Method:
    """The methods of a boundary-value problem, every choice made; raises ValueError for values out of range."""
    for name, accepted, first in (
        ("transcription", tuple(methods.COLLOCATION_TABLES), "gauss"),
        ("flow", tuple(methods.FULL_PERIOD_FLOWS), "collocation"),
        ("walker", ("arclength",), "arclength"),
    ):
        options = {name: first, **options}
        if not isinstance(options[name], str) or options[name] not in accepted:
            raise ValueError(f"{name}: given {short_repr(options[name])}; accepted: {', '.join(accepted)}")
    method = Method(**{"degree": DEGREE, "intervals": FIRST, **options})
    method.check_degree(1)
    return method


@dataclass(frozen=True)
class Sizes:
    """Least scales of the components of the state and of the free parameters."""

    states: Array
    scalars: Array

    @classmethod
    def of(cls, statement: Statement, guess: Array) -> Sizes:
        """A thousandth of each component of the guess, as components have units; 1 for a guess of zeros."""
        states = 1e-3 * np.max(np.abs(guess), axis=0) if np.any(guess) else np.ones(guess.shape[1])
        values = np.array([statement.values[name] for name in statement.free])
        return cls(states, np.where(values == 0.0, 1.0, 1e-3 * np.abs(values)))


@dataclass(frozen=True, eq=False)
class Periodic:
    """Data of an orbit: the model as declared, that of first order, the part of the period solved for.

    `turns` are the rotations of the states in a period, none where it is empty.
    """

    given: OdeModel
    model: OdeModel
    symmetry: SymmetryClass
    turns: tuple[int, ...] = ()

    def rotated(self, theta: Array) -> Array:
        """Additions of rotations at phases to states of the solved part, mirrored or not, shape (phases, states)."""
        turn = np.asarray(theta, dtype=float) / (2.0 * np.pi)
        mirrored = np.mod(turn, 1.0) > self.symmetry.value
        return np.asarray(2.0 * np.pi * np.outer(np.floor(turn) + mirrored, self.turns))
