"""An orbit in arrays and numbers: a sum of odd cosines, without the equations that it came from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.solution import Orbit
from casadi_skin.zero.cosines import cosine_matrix
from casadi_skin.zero.problem import Array


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
