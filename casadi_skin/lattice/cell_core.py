"""Coordinates of an edge mode of a long lattice: the nonlinear cells at its edge, and the linear tail eliminated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from casadi_skin.lattice.cell_motion import edge_motion, pinned_vectors, tail_coefficients
from casadi_skin.lattice.cell_tail import CellTail, Place
from casadi_skin.lattice.cell_tail_parameter import CellTailParameter
from casadi_skin.lattice.long_lattice import Core, LongLattice, core_model, core_of
from casadi_skin.lattice.tail_parameter import Regime
from casadi_skin.lattice.tail_problem import CoreWithTailProblem
from casadi_skin.model.methods import TRIGONOMETRIC
from casadi_skin.zero.cosines import cosine_matrix
from casadi_skin.zero.family import Localised, Method, normalised
from casadi_skin.zero.linear_modes import linear_modes
from casadi_skin.zero.model_coordinates import DEEPEST_LOG_SCALE, ModelCoordinates, check_alone
from casadi_skin.zero.problem import Array, Indices, Problem
from casadi_skin.zero.settings import Point
from casadi_skin.zero.statement import named_values

BESIDE_CORE = 100  # sites beside the core on which stability is computed at first
CELL_DOUBLINGS = 2  # of the cells, where multipliers that decay into the tail are not decided
WITHIN_SCALES = 0.95  # of the span of scales that positions may have
CLOSE_EIGENVALUES_RTOL = 1e-4  # relative distance of two lambda below which their difference is a slope


class CellCoreWithTail(ModelCoordinates):
    """The cells at the edge are unknown; the rest is linear and eliminated."""

    def __init__(
        self, lattice: LongLattice, core: Core, number: int, amplitude_max: float, stability_sites: int | None = None
    ) -> None:
        self.lattice, self.core, self.edge_mode = lattice, core, lattice.modes[number - 1]
        whole, p = lattice.of_cells(core.cells + 1), len(lattice.sites)
        model, weights = core_model(lattice, whole), whole.structure.log_weights
        at_edge = slice(-p, None) if lattice.at_last else slice(p)
        self._edge_weight = 1.0 if weights is None else float(np.exp(-np.min(weights[at_edge])))
        force = ca.substitute(model.rhs, model.parameters, ca.DM(list(named_values(model, {}).values())))
        squares = linear_modes(force, model.state, model.name).squares
        nearest = int(np.argmin(np.abs(squares - self.edge_mode.square))) + 1
        super().__init__(model, nearest, None, amplitude_max)
        self.mode_number, self._amplitude_max, self._stability_sites = number, amplitude_max, stability_sites
        self._cuts: dict[int, CellsAtEdge] = {}

    def _check_mode(self) -> None:
        """Among modes of this edge alone: the core's cut may have one of the same frequency, which the tail has not."""
        modes = self.lattice.modes
        squares = np.array([mode.square for mode in modes])
        check_alone(squares, modes.index(self.edge_mode) + 1, self._model.name, self._model.half_period is not None)

    @cached_property
    def tail(self) -> CellTail:
        """The tail, up to the core."""
        return self.lattice.tail(self.core.cells)

    @property
    def attached(self) -> int:
        """Index of the core's site that is joined to the tail."""
        last = 0 if self.lattice.at_last else (self.core.cells - 1) * len(self.lattice.sites)
        return last + self.lattice.inlet

    def parameter(self, harmonics: int) -> CellTailParameter:
        """The unknown in place of Omega."""
        return CellTailParameter(self.tail, self.edge_mode.gap, harmonics, self.core.slowest, self.lattice.lean)

    def transcription(self, resolution: int) -> Problem:
        return CoreWithTailProblem(self.scaled, resolution, self.parameter(resolution), self.attached)

    @property
    def is_whole(self) -> bool:
        return False

    def check_whole(self, purpose: str = "what is asked for") -> None:
        words = f"{purpose} is that of all sites, accepted: a Lattice of fewer cells"
        raise ValueError(f"cells: given {self.lattice.cells} with a linear tail; {words}")

    # Stability of localised perturbations --------------------------------------------------------------------------

    @cached_property
    def localised(self) -> Localised | None:
        if not self.symplectic:
            return None
        p, most = len(self.lattice.sites), self.lattice.cells - 1
        if self.lattice.lean != 0.0:  # scales of positions are doubles
            most = min(most, WITHIN_SCALES * DEEPEST_LOG_SCALE / -abs(self.lattice.lean))
        first = self.core.cells + math.ceil(BESIDE_CORE / p)
        tried = [first * 2**k for k in range(CELL_DOUBLINGS + 1)]
        if self._stability_sites is not None:
            tried = [math.ceil(self._stability_sites / p)]
        sites = tuple(dict.fromkeys(p * int(min(cells, most)) for cells in tried))
        ends = [math.sqrt(max(edge.square, 0.0)) for edge in self.tail.edges]
        bands, lattice = tuple(zip(ends[::2], ends[1::2], strict=True)), self.lattice
        return Localised(
            sites, bands, lattice.at_last, lattice.cell, lattice.coupling, lattice.inlet, lattice.outlet, self.attached
        )

    def cut(self, sites: int) -> tuple[EdgeCells, int]:
        return EdgeCells(self._cells_at_edge(sites)), self.mode_number

    def _cells_at_edge(self, sites: int) -> CellsAtEdge:
        if sites not in self._cuts:
            core = Core(sites // len(self.lattice.sites), self.core.slowest)
            self._cuts[sites] = CellsAtEdge(self.lattice, core, self.mode_number, self._amplitude_max)
        return self._cuts[sites]

    def on_cut_sites(self, problem: Problem, z: Array, sites: int) -> Array:
        assert isinstance(problem, CoreWithTailProblem)
        H, p, cut = problem.resolution, len(self.lattice.sites), self._cells_at_edge(sites)
        core = z[: problem.states].reshape(-1, H)
        places = self.parameter(H).places(float(z[problem.Omega_index]))
        values, site = problem.values(z), problem.coefficients(z)[self.attached]
        beyond = range(self.core.cells + 1, sites // p + 1)
        cells = tail_coefficients(self.lattice, beyond, places, (values.across, values.down), site)
        order = slice(None, None, -1) if self.lattice.at_last else slice(None)
        tail = cells[:, order].reshape(H, -1).T @ cosine_matrix(H)
        both = np.concatenate([tail, core] if self.lattice.at_last else [core, tail])
        at_edge = -1 if self.lattice.at_last else 0
        unit = self.scale[at_edge] / cut.scale[at_edge]  # of the two gauges
        return np.concatenate([unit * both.ravel(), [problem.frequency(z), z[problem.parameter_index]]])

    @property
    def description(self) -> str:
        cells = f"{self.core.cells} cells at the edge, where nonlinear forces are felt"
        return f"the gauge; unknown are {cells}, and the linear tail is eliminated exactly"

    def regime(self, point: Point) -> Regime:
        """Whether Omega is pinned to a band."""
        assert isinstance(point.problem, CoreWithTailProblem)
        return point.problem.regime(point.z)

    def band(self) -> tuple[float, float]:
        edges = self.tail.edges
        return edges[0].square, edges[-1].square

    # The linear mode --------------------------------------------------------------------------------------------------

    @property
    def frequency(self) -> float:
        return float(np.sqrt(self.edge_mode.square))

    @cached_property
    def _tail_angle(self) -> float:
        """The angle of the linear mode's tail, from that which begins at the second cell."""
        mode, first, last = self.edge_mode, self.lattice.tail(1), self.tail
        if not mode.pinned or np.isfinite(self.lattice.cells):
            return last.angle(mode.place)
        start, angle = np.array([np.sin(mode.angle), np.cos(mode.angle)]), mode.angle
        for vector in pinned_vectors(first, mode.place.edge, start, self.core.cells - 1):
            turn = float(np.arctan2(*vector)) - angle
            angle += turn - np.pi * round(turn / np.pi)
        return angle

    @property
    def start_unknown(self) -> float:
        return self._tail_angle

    @cached_property
    def mode(self) -> Array:
        motion = edge_motion(self.lattice, self.core.cells, self.edge_mode.square, self._tail_angle)
        return normalised(motion, self.scale)

    # Quantities -------------------------------------------------------------------------------------------------------

    @property
    def output_sites(self) -> Indices:
        count, whole = self.mode.size, self.lattice.cells * len(self.lattice.sites)
        first = (whole - count if np.isfinite(whole) else -count) if self.lattice.at_last else 0
        return np.arange(1, count + 1) + int(first)

    @property
    def position_names(self) -> tuple[str, ...]:
        names, p = [site.name for site in self.lattice.sites], len(self.lattice.sites)
        cells = [(int(n) - 1) // p + 1 for n in self.output_sites]
        prefix = [f"{name}_" if p > 1 else "" for name in names]
        return tuple(f"y_{prefix[i % p]}{cell}" for i, cell in enumerate(cells))

    def _in_core(self, sites: Indices | None) -> Indices | None:
        """Sites numbered from 1 in the core; raises ValueError for those of the tail."""
        if sites is None:
            return None
        first, last = int(self.output_sites[0]), int(self.output_sites[-1])
        if sites.size and (sites.min() < first or sites.max() > last):
            raise ValueError(f"sites: given {sites.min()} to {sites.max()}; accepted: {first} to {last}, at the edge")
        return np.asarray(sites - first + 1)

    def displacements(self, problem: Problem, z: Array, theta: Array, sites: Indices | None) -> Array:
        return super().displacements(problem, z, theta, self._in_core(sites))

    def log_displacements(
        self, point: Point, solved: tuple[Array, Array], sites: Indices | None
    ) -> tuple[Array, Array]:
        return super().log_displacements(point, solved, self._in_core(sites))

    def energy(self, problem: Problem, z: Array) -> float:
        """Infinite where an infinite tail moves along; weights are 1 at the edge.

        Products of two harmonics add up to a term at the end of the tail (Green's identity).
        """
        assert isinstance(problem, CoreWithTailProblem)
        core = super().energy(problem, z)
        parameter, values = self.parameter(problem.resolution), problem.values(z)
        places, s = parameter.places(float(z[problem.Omega_index])), self.tail.coupling
        site = problem.coefficients(z)[self.attached]
        size = site / values.down
        beside, squares = size * values.across, ((2.0 * np.arange(problem.resolution) + 1.0) * values.Omega) ** 2
        apart = squares[None, :] - squares[:, None]
        np.fill_diagonal(apart, 1.0)
        products = -s * (np.outer(beside, site) - np.outer(site, beside)) / apart
        np.fill_diagonal(products, [a**2 * self.tail.squares(place) for a, place in zip(size, places, strict=True)])
        tail = 0.5 * float(np.sum(products @ squares)) - 0.5 * s * float(np.sum(site) * np.sum(beside))
        rest, moving = np.zeros(self.mode.size), np.eye(self.mode.size)[self.attached]
        parameter_value = float(z[problem.parameter_index])
        energies = [float(self._hamiltonian(rest, v, parameter_value)) for v in (moving, rest)]
        return (core + 2.0 * (energies[0] - energies[1]) * tail) * self._edge_weight

    def Omega_shift(self, problem: Problem, z: Array) -> float:
        """From the distance to the edge of the band where that is known better, else by projection on the mode."""
        assert isinstance(problem, CoreWithTailProblem)
        place = self.tail.at_angle(self.edge_mode.gap, float(z[problem.Omega_index]))
        Omega, mode = problem.frequency(z), self.edge_mode.place
        if mode.edge == place.edge and self.edge_mode.pinned:
            return (place.off - mode.off) / (Omega + self.frequency)
        by_core = self._projections(problem, z)
        coefficient = problem.coefficients(z)[self.attached, 0] * self.mode[self.attached]
        overlap = by_core[1] + coefficient * self._tail_overlap(place, Omega)
        by_projection = by_core[0] / overlap / (Omega + self.frequency)
        subtraction_is_better = 100.0 * by_core[2] / abs(overlap) * abs(by_projection) > self.frequency
        return Omega - self.frequency if subtraction_is_better else float(by_projection)

    def _projections(self, problem: CoreWithTailProblem, z: Array) -> tuple[float, float, float]:
        """Nonlinear forces and positions of the fundamental projected on the mode's part in the core, and a bound."""
        theta = (np.arange(2 * max(32, problem.resolution)) + 0.5) * np.pi / (4 * max(32, problem.resolution))
        q, cosine = problem.sample(z, theta), 2.0 / theta.size * np.cos(theta)
        parameter = np.full((1, theta.size), float(z[problem.parameter_index]))
        forces, fundamental = np.array(self._nonlinear.map(theta.size)(q.T, parameter)).T, cosine @ q
        size = float(np.linalg.norm(fundamental) * np.linalg.norm(self.mode))
        return -float(cosine @ forces @ self.mode), float(fundamental @ self.mode), size

    def _tail_overlap(self, place: Place, Omega: float) -> float:
        """Sum of products of two waves' amplitudes over the tail, relative to that at the core's site."""
        tail, square = self.tail, self.edge_mode.square
        apart = Omega**2 - square
        if abs(apart) > CLOSE_EIGENVALUES_RTOL * square:
            return float(tail.coupling * (math.tan(tail.angle(place)) - math.tan(self._tail_angle)) / apart)
        middle = tail.place(square + 0.5 * apart)
        return float(tail.squares(middle) / math.cos(tail.angle(middle)) ** 2)


class CellsAtEdge(CellCoreWithTail):
    """So many cells at the edge by themselves, without the bond to those beyond: all positions are unknowns."""

    localised = None

    def transcription(self, resolution: int) -> None:  # type: ignore[override]
        return None

    @property
    def is_whole(self) -> bool:
        return True


@dataclass(frozen=True, eq=False)
class EdgeCells:
    """Cells at the edge of a long lattice as a model that has coordinates for its families."""

    coordinates: CellsAtEdge

    def family_coordinates(self, mode: int | str, amplitude_max: float, method: Method) -> CellsAtEdge:
        """Those given, whatever the mode and the method."""
        return self.coordinates


def long_lattice_coordinates(
    lattice: LongLattice, mode: int | str, amplitude_max: float, method: Method
) -> CellCoreWithTail:
    """Coordinates of the family that grows from an edge mode of a long lattice to S = `amplitude_max`.

    Raises ValueError, naming the argument, for a mode or a method without such a family.
    """
    number = lattice.mode_number(mode)
    if method.transcription not in (None, TRIGONOMETRIC):
        raise ValueError("method: accepted with a linear tail: transcription trigonometric")
    if method.tail == "full":
        raise ValueError('tail: given "full" with a LongLattice; accepted: eliminated')
    core = core_of(lattice, lattice.modes[number - 1], amplitude_max)
    sites, p = method.stability_sites, len(lattice.sites)
    if sites is not None and not core.cells < sites / p < lattice.cells:
        accepted = f"more sites than those of {core.cells} cells, where forces are nonlinear, and fewer than all"
        raise ValueError(f"stability_sites: given {sites}; accepted: {accepted}")
    return CellCoreWithTail(lattice, core, number, amplitude_max, sites)
