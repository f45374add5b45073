"""The unknowns of a family in terms of the orbits of its model: scaled positions, amplitude, linear mode.

A family is solved in scaled positions q: the positions of the model are y = a D q, with the amplitude a = sqrt(S), a
diagonal matrix D of positive factors, and sum_n (D_n q_n(0))^2 = 1, so that S = sum_n y_n(0)^2 exactly. The linear mode
is then the regular start S = 0. Where D makes the equations symmetric it keeps digits that products of couplings in
opposite directions would lose (Hatano and Nelson 1996).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import NoQuantityError
from casadi_skin.zero.cosines import quarter_phases
from casadi_skin.zero.problem import Array, Indices, Problem

if TYPE_CHECKING:
    from casadi_skin.zero.settings import Point

LOG10 = float(np.log(10.0))


@dataclass(frozen=True, eq=False)
class Localised:
    """Stability of localised perturbations alone, at the edge of a linear tail that is too long, or cut.

    Attributes:
        sites: numbers of sites at the edge to be tried, until all that decays into the tail is decided.
        bands: lowest and highest frequency of each linear band of the tail.
        cut_first: whether the tail is before the first of these sites; else it is behind the last.
        stiffness: symmetric, of one cell of the tail with unit masses, shape (sites, sites).
        coupling: s > 0 of the bonds that join cells.
        inlet, outlet: sites of a cell that are joined to the far side and to the edge's side.
        attached: index of the position that is joined to the tail.
    """

    sites: tuple[int, ...]
    bands: tuple[tuple[float, float], ...]
    cut_first: bool
    stiffness: Array
    coupling: float
    inlet: int
    outlet: int
    attached: int


class Coordinates(ABC):
    """Scaled coordinates of one family, with the linear mode that it grows from; dimensionless.

    `mode_number` counts modes by ascending linear frequency from 1. `symplectic` is true where the flow of the scaled
    equations is Hamiltonian in (q, q'). `S_rate` is the relative change of S per that of the free parameter.
    """

    mode_number: int
    symplectic: bool = True
    S_rate: float = 1.0

    # The equations --------------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def scaled(self) -> OdeModel:
        """Equations of q: second order, one free parameter, a normalisation."""

    @property
    def solved(self) -> OdeModel:
        """The equations that an orbit is solved with: those of `scaled`, with terms that isolate their solutions."""
        return self.scaled

    @property
    @abstractmethod
    def log_scale(self) -> Array:
        """Logarithms of the factors D, shape (scaled positions,)."""

    @cached_property
    def scale(self) -> Array:
        """The factors D, shape (scaled positions,)."""
        return np.exp(self.log_scale)

    @property
    @abstractmethod
    def mode(self) -> Array:
        """The linear mode in scaled positions, normalised, shape (scaled positions,)."""

    def amplitude(self, positions: Array) -> float:
        """sqrt(S) of positions at rest, shape (scaled positions,)."""
        return float(np.linalg.norm(positions))

    @property
    @abstractmethod
    def frequency(self) -> float:
        """Frequency of the linear mode."""

    @property
    def start_unknown(self) -> float:
        """The unknown in Omega's place at the linear mode."""
        return self.frequency

    @abstractmethod
    def parameter_of(self, S: float) -> float:
        """The free parameter of the scaled equations at an S."""

    @abstractmethod
    def S_of(self, parameter: float) -> float:
        """S at a value of the free parameter."""

    def transcription(self, resolution: int) -> Problem | None:
        """The problem that these coordinates need in place of a general transcription; None where they need none."""
        return None

    @property
    def is_whole(self) -> bool:
        """Whether every position is an unknown, as the stability of the family needs."""
        return True

    @property
    def localised(self) -> Localised | None:
        """Where stability is that of localised perturbations alone, their sites; None where it is that of all."""
        return None

    def cut(self, sites: int) -> tuple[Any, int | str]:
        """The model of so many sites at the edge alone, and the mode of the same family there."""
        raise NotImplementedError

    def on_cut_sites(self, problem: Problem, z: Array, cut: Coordinates) -> Array:
        """The unknowns of the same orbit on the sites of a `cut` alone, from the coordinates of the family there."""
        raise NotImplementedError

    def check_whole(self, purpose: str = "what is asked for") -> None:  # noqa: B027  most have every position as an unknown
        """Raises ValueError for a task that needs more positions than can be unknowns."""

    def jump(self, positions: Callable[[], Array]) -> str:
        """That the forces jump along positions of the model, shape (places, positions); empty where they do not.

        Most forces are known not to, and the positions are not computed for these.
        """
        return ""

    # Output -----------------------------------------------------------------------------------------------------------

    @property
    @abstractmethod
    def model(self) -> OdeModel:
        """The equations of motion of the positions y, second order."""

    @property
    @abstractmethod
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters of the model by name."""

    @property
    def position_names(self) -> tuple[str, ...]:
        """Names of the positions at `output_sites`."""
        return self.model.state_names[: self.model.size]

    @property
    def output_sites(self) -> Indices:
        """Numbers of the positions in files and pictures, counted from 1."""
        return np.arange(1, self.mode.size + 1)

    @property
    def linear_profile(self) -> tuple[Array, Array]:
        """log10 of the sizes of the linear mode of norm 1 at `output_sites`, and the signs; -inf and 0 at rest."""
        with np.errstate(divide="ignore"):
            logs = np.log(np.abs(self.mode)) + self.log_scale
        logs = logs - 0.5 * np.log(np.sum(np.exp(2.0 * (logs - np.max(logs))))) - np.max(logs)
        return logs / LOG10, np.sign(self.mode)

    @property
    def attributes(self) -> Mapping[str, float]:
        """A key of the model among others of its kind, for files."""
        return self.parameters

    @property
    def description(self) -> str:
        """The coordinates that the family is solved in, in words."""
        return "positions of the model"

    def band(self) -> tuple[float, float] | None:
        """Squares of the lowest and highest linear frequency; None where these are not known."""
        return None

    def regime(self, point: Point) -> Enum | None:
        """Regime of an eliminated linear part of the model at a point; None where nothing is eliminated."""
        return None

    def log_solved(self, point: Point, z: Array, smallest: float) -> tuple[Array, Array]:
        """Natural logarithms of |q(0)| and the signs, each (scaled positions,); -inf and 0 where a position rests.

        `z` are the unknowns of `point` with small components right relative to themselves down to `smallest` times
        the largest.
        """
        q = point.problem.sample(z, np.zeros(1))[0][: self.mode.size]
        with np.errstate(divide="ignore"):
            return np.log(np.abs(q)), np.sign(q)

    def log_displacements(
        self, point: Point, solved: tuple[Array, Array], sites: Indices | None
    ) -> tuple[Array, Array]:
        """Natural logarithms and signs of D q(0) at sites, from those of q at the positions solved for."""
        chosen = numbered(sites, self.mode.size)
        return (solved[0] + self.log_scale)[chosen], solved[1][chosen]

    def displacements(self, problem: Problem, z: Array, theta: Array, sites: Indices | None) -> Array:
        """D q at phases theta of the sites numbered, all by default, shape (len(theta), sites)."""
        chosen = numbered(sites, self.mode.size)
        return np.asarray((self.scale * problem.sample(z, theta))[:, chosen])

    # Quantities -----------------------------------------------------------------------------------------------------

    @cached_property
    def _hamiltonian(self) -> ca.Function:
        scaled = self.scaled
        return ca.Function("H", [scaled.state, scaled.velocity, scaled.parameters], [scaled.hamiltonian])

    def energy(self, problem: Problem, z: Array) -> float:
        """Energy over S at phase zero, where all velocities vanish; raises ValueError where none is conserved."""
        if self.scaled.hamiltonian is None:
            raise NoQuantityError(f"energy: {self.model.name} declares no hamiltonian")
        q = problem.sample(z, np.zeros(1))[0]
        return float(self._hamiltonian(q, np.zeros(q.size), z[problem.parameter_index]))

    @abstractmethod
    def nonlinear_forces(self, q: Array, parameter: float) -> Array:
        """The scaled forces without their linear part, at places q, shape (places, scaled positions)."""

    @property
    def left_mode(self) -> Array:
        """The left eigenvector of the linear mode, shape (scaled positions,)."""
        return self.mode

    def projections(self, problem: Problem, z: Array, theta: Array) -> tuple[float, float, float]:
        """Nonlinear forces and positions of the fundamental, projected on the linear mode, and a bound of the second.

        `theta` are midpoints of equal parts of the period's quarter or half.
        """
        q, cosine, left = problem.sample(z, theta), 2.0 / theta.size * np.cos(theta), self.left_mode
        forces, fundamental = self.nonlinear_forces(q, float(z[problem.parameter_index])), cosine @ q
        size = float(np.linalg.norm(fundamental) * np.linalg.norm(left))
        return -float(cosine @ forces @ left), float(fundamental @ left), size

    def Omega_shift(self, problem: Problem, z: Array) -> float:
        """Omega minus the linear frequency, formed without subtraction where the shift is small.

        The fundamental of the equations, projected on the linear mode, has it without cancellation.
        """
        theta = 2.0 * quarter_phases(max(64, 4 * problem.resolution))
        return shift_by_projection(problem.frequency(z), self.frequency, *self.projections(problem, z, theta))

    @property
    def free_motions(self) -> Array:
        """Directions along which forces neither act nor change, as orthonormal columns in scaled positions: momenta."""
        return np.empty((self.mode.size, 0))

    @property
    def resting(self) -> tuple[int, float]:
        """Number of positions that rest beside those solved for, linear oscillators, and their frequency."""
        return 0, 0.0

    @property
    def without_vectors(self) -> str:
        """Why vectors of the scaled flow have no image among the positions of the model; empty where they have one."""
        return ""


def numbered(sites: Indices | None, count: int) -> Indices:
    """Indices of sites numbered from 1; raises ValueError for sites that are not there."""
    if sites is None:
        return np.arange(count)
    if sites.size and (sites.min() < 1 or sites.max() > count):
        raise ValueError(f"sites: given {sites.min()} to {sites.max()}; accepted: 1 to {count}")
    return np.asarray(sites - 1, dtype=np.int64)


def normalised(mode: Array, scale: Array) -> Array:
    """A mode scaled to sum_n (D_n q_n)^2 = 1, largest displacement positive."""
    q = mode / np.sqrt(np.sum((scale * mode) ** 2))
    return np.asarray(q * np.sign(q[np.argmax(np.abs(scale * q))]))


def shift_by_projection(Omega: float, omega: float, nonlinear: float, overlap: float, size: float) -> float:
    """Omega - omega from Omega^2 - omega^2 = nonlinear / overlap, or by subtraction where the overlap is small.

    `size` bounds the overlap: the product of the norms of both vectors.
    """
    by_projection = nonlinear / overlap / (Omega + omega)
    subtraction_is_better = 100.0 * size / abs(overlap) * abs(by_projection) > omega
    return Omega - omega if subtraction_is_better else by_projection
