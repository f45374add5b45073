"""Odd cosines on the nonlinear core of a long lattice, whose linear tail is eliminated exactly.

Coordinates of an edge mode of a long lattice: the nonlinear cells at its edge, and the linear tail eliminated.

Forces of order 3 and more on displacements that fall by exp(-lean) a cell are below round-off from some cell on. The
cells up to there are a core, whose positions are unknowns; the others answer its last site harmonic by harmonic, which
`Tail` has in closed form. So the number of unknowns does not depend on the length, which may be infinite.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.lattice.chain import check_no_parameters
from casadi_skin.lattice.lattice import Core, EdgeMode, LongLattice, core_model, core_of
from casadi_skin.lattice.tail import Place, Tail
from casadi_skin.lattice.tail_parameter import Regime, TailParameter, TailValues
from casadi_skin.model.methods import TRIGONOMETRIC
from casadi_skin.model.ode import OdeModel
from casadi_skin.native import TAIL, Structure
from casadi_skin.zero.coordinates import Localised, normalised, shift_by_projection
from casadi_skin.zero.cosines import (
    KEPT_RESOLUTIONS,
    CosineEquations,
    PolynomialForm,
    TaylorRecursion,
    TrigonometricProblem,
    cosine_matrix,
    quarter_phases,
)
from casadi_skin.zero.family import Method
from casadi_skin.zero.model_coordinates import DEEPEST_LOG_SCALE, ModelCoordinates, check_alone
from casadi_skin.zero.problem import (
    FREQUENCY_WEIGHT,
    Array,
    Buffers,
    Indices,
    Problem,
    Scalar,
    SingularError,
    Solve,
    sparse_matrix,
)
from casadi_skin.zero.settings import Point


class EquationsWithTail:
    """The equations of a core and of the tail, from those of the core by itself and from values of the tail.

    In the place of Omega z has u. Those of the attached site are by harmonic: (T R) down - s/Omega^2 (T q) across with
    the core's residual R and the matrix T from values at nodes to coefficients. Arguments of the function are z, the
    numbers of the core, (s, Omega, Omega_slope), across, across_slope, down and down_slope.

    Attributes:
        shared: objects that all problems with these equations share, whatever their tails.
        touched: unknowns in the equations of the attached site, Omega among them at `own_Omega`.
        inside, by_Omega: places of their derivatives and of those by Omega among the non-zeros of the core's Jacobian.
    """

    def __init__(self, core: CosineEquations, harmonics: int, attached: int) -> None:
        H, size, rows = harmonics, core.function.size1_in(0), slice(attached * harmonics, (attached + 1) * harmonics)
        place, T = size - 2, ca.DM((2.0 / H) * cosine_matrix(H))
        z, numbers = (ca.MX.sym(name, core.function.size1_in(k)) for k, name in enumerate(("z", "numbers")))
        scalars, values = ca.MX.sym("scalars", 3), [ca.MX.sym(name, H) for name in ("a", "da", "d", "dd")]
        (s, Omega, slope), (across, across_slope, down, down_slope) = ca.vertsplit(scalars), values
        own, jacobian = core.function(ca.vertcat(z[:place], Omega, z[place + 1 :]), numbers)
        balance, bond = T @ own[rows], s / Omega**2
        site = T @ z[rows]
        i, k = core.pattern
        inside, in_place = (i >= rows.start) & (i < rows.stop), k == place
        self.inside, self.by_Omega = np.flatnonzero(inside), np.flatnonzero(in_place)
        self.touched = np.unique(k[inside])
        self.own_Omega, first = (int(np.searchsorted(self.touched, at)) for at in (place, rows.start))
        block = ca.diag(down) @ (T @ jacobian[rows, self.touched.tolist()])
        block[:, first : first + H] -= ca.diag(bond * across) @ T
        by_u = slope * block[:, self.own_Omega] + down_slope * balance
        block[:, self.own_Omega] = by_u + bond * (2.0 * slope / Omega * across - across_slope) * site
        # Non-zeros by their places: rows of sparse matrices put together would cost as much as the core.
        kept, scaled = (np.flatnonzero(~inside & part) for part in (~in_place, in_place))
        block_columns, block_rows = np.repeat(self.touched, H), np.tile(np.arange(size)[rows], self.touched.size)
        i, k = (np.concatenate([t[kept], t[scaled], b]) for t, b in ((i, block_rows), (k, block_columns)))
        found = jacobian.nz[:]
        nonzeros = ca.vertcat(found[kept.tolist()], slope * found[scaled.tolist()], ca.vec(block))
        jacobian = sparse_matrix((size - 1, size), i, k, nonzeros)
        residual = ca.vertcat(own[: rows.start], down * balance - bond * across * site, own[rows.stop :])
        symbols = z, numbers, scalars, *values
        self.function = ca.Function("equations", symbols, [residual, jacobian])
        self.pattern = tuple(np.array(found, dtype=np.int64) for found in self.function.sparsity_out(1).get_triplet())
        self.buffers, self.shared = Buffers(self.function), dict[Any, Any]()


@lru_cache(maxsize=KEPT_RESOLUTIONS)
def _equations_of(core: CosineEquations, harmonics: int, attached: int) -> EquationsWithTail:
    return EquationsWithTail(core, harmonics, attached)


class CoreWithTailProblem(TrigonometricProblem):
    """Unknowns are the core's positions at the nodes, u in place of Omega, and the free parameter.

    The model is that of the core by itself; its site `attached` is next to the tail, and lacks the bond to it.
    Equations of that site are those of its harmonics, times cos(psi): regular where the tail resonates.
    """

    def __init__(self, model: OdeModel, harmonics: int, tail: TailParameter, attached: int = 0) -> None:
        super().__init__(model, harmonics)
        self.tail, self.attached = tail, attached
        if model.size > 1:
            self.half_bandwidth = (self.half_bandwidth or 0) + harmonics - 1

    def values(self, z: Array) -> TailValues:
        """The tail at z; raises ArithmeticError where a harmonic that should be bound is in the band."""
        return self.tail.values(float(z[self.Omega_index]))

    def frequency(self, z: Array) -> float:
        """Omega of z; NaN, as are the equations, where there is none."""
        try:
            return self.values(z).Omega
        except ArithmeticError:
            return float("nan")

    def frequency_step(self, z: Array, step: Array) -> float:
        return float(self.values(z).Omega_slope * step[self.Omega_index])

    def unknown_at(self, scalar: Scalar, value: float) -> float:
        return self.tail.of_frequency(value) if scalar is Scalar.OMEGA else value

    @cached_property
    def core(self) -> TrigonometricProblem:
        """The same core, without the bond to the tail."""
        return TrigonometricProblem(self.model, self.resolution)

    @cached_property
    def rows(self) -> slice:
        """Equations, and unknown positions, of the attached site."""
        return slice(self.attached * self.resolution, (self.attached + 1) * self.resolution)

    def attached_balance(self, own: Array) -> tuple[Array, Array, Array]:
        """The core's equations of the attached site by harmonic, their derivatives, and those of all by Omega.

        `own` are unknowns of the core by itself. Derivatives are by those `touched`, of the equations times Omega^2 and
        over its value: a bond to the tail balances them.
        """
        residual, nonzeros = self.core.evaluate(own)
        equations, (i, k) = self.equations, self.core.pattern
        inside, at, touched = equations.inside, equations.by_Omega, equations.touched
        block, by_Omega = np.zeros((self.resolution, touched.size)), np.zeros(self.size - 1)
        block[i[inside] - self.rows.start, np.searchsorted(touched, k[inside])] = nonzeros[inside]
        by_Omega[i[at]], balance = nonzeros[at], residual[self.rows]
        block[:, equations.own_Omega] += 2.0 / own[self.Omega_index] * balance
        return self._to_coefficients @ balance, self._to_coefficients @ block, by_Omega

    def recursion(self, form: PolynomialForm, orders: int) -> TailRecursion:
        """Power series of branches."""
        return TailRecursion(self, form, orders)

    @cached_property
    def equations(self) -> EquationsWithTail:  # type: ignore[override]
        return _equations_of(self.core.equations, self.resolution, self.attached)

    def _values(self, z: Array, numbers: Array) -> Sequence[Array]:
        """As those of other problems; not a number where a harmonic that should be bound is in the band."""
        try:
            tail = self.values(z)
        except ArithmeticError:
            return np.full(self.size - 1, np.nan), np.full(self.pattern[0].size, np.nan)
        scalars = np.array([self.tail.coupling, tail.Omega, tail.Omega_slope])
        harmonics = tail.across, tail.across_slope, tail.down, tail.down_slope
        return self._buffers(z, numbers, scalars, *harmonics)

    def by_itself(self, z: Array) -> tuple[TrigonometricProblem, Array]:
        own = z.copy()
        own[self.Omega_index] = self.frequency(z)
        return self.core, own

    def eliminated(self, z: Array) -> tuple[Array, slice, int]:
        H, values = self.resolution, self.values(z)
        bonds = self.tail.coupling / values.Omega**2 * values.across / values.down
        block = -(cosine_matrix(H) * bonds) @ self._to_coefficients
        return block, self.rows, -self.tail.passed(values)

    def rounding(self, z: Array) -> float:
        """That of the core by itself, whose equations have the largest terms."""
        core, own = self.by_itself(z)
        return core.rounding(own)

    def metrics(self, z: Array, parameter_scale: float) -> Array:
        """A change of u by 1 counts as much as a wholly new profile, and the change of Omega that it makes besides."""
        weights: Array = super().metrics(z, parameter_scale)
        for weight, one in zip(weights, z, strict=True):
            weight[self.Omega_index] = 1.0
            try:
                values = self.values(one)
            except ArithmeticError:  # a guess that is none
                continue
            weight[self.Omega_index] += (FREQUENCY_WEIGHT * values.Omega_slope / values.Omega) ** 2
        return weights


# Power series of a branch of the core with its tail, order by order ---------------------------------------------------


class TailRecursion:
    """Coefficients of a branch of one problem with an eliminated tail, by the recursion of its core alone.

    By order are kept u to its powers, (Omega, across, down), and of the attached site by harmonic the positions and the
    core's balance.
    """

    def __init__(self, problem: CoreWithTailProblem, form: PolynomialForm, orders: int) -> None:
        H = problem.resolution
        self.problem, self.orders = problem, orders
        self._touched, self._own_Omega = problem.equations.touched, problem.equations.own_Omega
        self._core = TaylorRecursion(problem.core, form, orders)
        self.end: tuple[int, float] | None = None
        self._along, self._powers = np.zeros((orders + 1, 1 + 2 * H)), np.zeros((orders + 1, orders + 1))
        self._across, self._down = self._along[:, 1 : 1 + H], self._along[:, 1 + H :]
        self._found, self._balance, self._site = (np.zeros((orders + 1, size)) for size in (problem.size, H, H))

    def series(self, z: Array, slope: Array, solve: Solve) -> Array:
        """Coefficients z_0 = z, z_1 = slope, z_2, ..., shape (orders + 1, size); see `TaylorRecursion`.

        Raises SingularError where the tail has no series.
        """
        problem, place, own = self.problem, self.problem.Omega_index, z.copy()
        try:
            tail = problem.tail.series(float(z[place]), self.orders)
        except ArithmeticError as error:
            raise SingularError(str(error)) from error
        self.end = None if np.isnan(tail.end) else (place, float(z[place]) + tail.end)
        self._by_u = tail.coefficients  # by powers of u
        own[place] = self._by_u[0, 0]  # of the core: Omega in the place of u
        self._bond = problem.tail.coupling / own[place] ** 2
        self._found[0], self._along[0], self._site[0] = z, self._by_u[0], problem._to_coefficients @ z[problem.rows]
        self._balance[0], self._block, self._by_Omega = problem.attached_balance(own)
        self._core.put(0, own)
        self._put(1, slope, np.zeros(self._by_u.shape[1]), np.zeros(problem.resolution))
        if not self._core.solve_all(solve, self._structure):
            for k in range(2, self.orders + 1):
                right, *known = self._right_side(k)
                self._put(k, solve(right), *known)
        return self._found.copy()

    def _right_side(self, k: int) -> tuple[Array, Array, Array]:
        """That of order k, with (Omega, across, down) and the balance as if z had no part of order k."""
        H, powers, problem = self.problem.resolution, self._powers, self.problem
        right = self._core.right_side(k)
        powers[2 : k + 1, k] = powers[1:k, k - 1 : 0 : -1] @ powers[1, 1:k]
        along = powers[2 : k + 1, k] @ self._by_u[2 : k + 1]
        balance = self._block[:, self._own_Omega] * along[0] - problem._to_coefficients @ right[problem.rows]
        right[:-1] -= self._by_Omega * along[0]
        lower = np.einsum("jh,jh->h", self._down[1:k], self._balance[k - 1 : 0 : -1])
        lower -= self._bond * np.einsum("jh,jh->h", self._across[1:k], self._site[k - 1 : 0 : -1])
        lower += along[1 + H :] * self._balance[0] - self._bond * along[1 : 1 + H] * self._site[0]
        right[problem.rows] = -self._down[0] * balance - lower
        return right, along, balance

    def _put(self, k: int, z: Array, along: Array, balance: Array) -> None:
        """Take over order k, and complete what depends on it from what does not depend on z."""
        problem, place, own = self.problem, self.problem.Omega_index, z.copy()
        self._found[k], self._powers[1, k], self._along[k] = z, z[place], along + z[place] * self._by_u[1]
        self._site[k] = problem._to_coefficients @ z[problem.rows]
        own[place] *= self._by_u[1, 0]
        self._balance[k] = balance + self._block @ own[self._touched]
        own[place] = self._along[k, 0]
        self._core.put(k, own)

    def _structure(self) -> Structure:
        """What the compiled kernel needs for the same from order 2 on."""
        problem, (orders, size) = self.problem, self._found.shape
        return Structure(
            TAIL, orders - 1, problem.resolution, size, problem.rows.start, problem.Omega_index, self._touched.size,
            self._own_Omega, self._touched, self._by_u, problem._to_coefficients, self._block, self._by_Omega,
            self._along, self._powers, self._balance, self._site, self._found, self._bond,
        )  # fmt: skip


# Coordinates of an edge mode ------------------------------------------------------------------------------------------

BESIDE_CORE = 100  # sites beside the core on which stability is computed at first
SITE_DOUBLINGS = 2  # of the cells, where multipliers that decay into the tail are not decided
WITHIN_SCALES = 0.95  # of the span of scales that positions may have
CLOSE = 1e-5  # difference of two angles below which that of their tangents is a slope


class CoreWithTail(ModelCoordinates):
    """The cells at the edge are unknown; the rest is linear and eliminated."""

    def __init__(
        self,
        lattice: LongLattice,
        core: Core,
        edge_mode: EdgeMode,
        number: int,
        amplitude_max: float,
        stability_sites: int | None = None,
    ) -> None:
        self.lattice, self.core, self.edge_mode = lattice, core, edge_mode
        whole, p = lattice.of_cells(core.cells + 1), len(lattice.sites)
        weights = whole.structure.log_weights
        at_edge = slice(-p, None) if lattice.at_last else slice(p)
        self._edge_weight = 1.0 if weights is None else float(np.exp(-np.min(weights[at_edge])))
        super().__init__(core_model(lattice, whole), 1, None, amplitude_max)
        self.mode_number, self._amplitude_max, self._stability_sites = number, amplitude_max, stability_sites

    def _check_mode(self) -> None:
        """Among modes of this edge alone: the core's cut may have one of the same frequency, which the tail has not."""
        modes = self.lattice.modes
        squares = np.array([mode.square for mode in modes])
        check_alone(squares, modes.index(self.edge_mode) + 1, self._model.name, self._model.half_period is not None)

    def _check_amplitude(self) -> None:
        """S is the sum of squares of positions."""

    @cached_property
    def tail(self) -> Tail:
        """The tail, up to the core."""
        return self.lattice.tail(self.core.cells)

    @property
    def attached(self) -> int:
        """Index of the core's site that is joined to the tail."""
        last = 0 if self.lattice.at_last else (self.core.cells - 1) * len(self.lattice.sites)
        return last + self.lattice.inlet

    def parameter(self, harmonics: int) -> TailParameter:
        """The unknown in place of Omega."""
        return TailParameter(self.tail, self.edge_mode.place, harmonics, self.core.slowest, self.lattice.lean)

    def transcription(self, resolution: int) -> Problem:
        return CoreWithTailProblem(self.scaled, resolution, self.parameter(resolution), self.attached)

    @property
    def is_whole(self) -> bool:
        return False

    def check_whole(self, purpose: str = "what is asked for") -> None:
        words = f"{purpose} is that of all sites, accepted: a Lattice of fewer cells"
        raise ValueError(f"cells: given {self.lattice.cells} with a linear tail; {words}")

    @property
    def description(self) -> str:
        kind = "cells" if len(self.lattice.sites) > 1 else "sites"
        cells = f"{self.core.cells} {kind} at the edge, where nonlinear forces are felt"
        return f"the gauge; unknown are {cells}, and the linear tail is eliminated exactly"

    def regime(self, point: Point) -> Regime:
        """Whether Omega, or three times it, is pinned to a band."""
        problem: CoreWithTailProblem = point.problem
        return problem.tail.regime(problem.values(point.z))

    def band(self) -> tuple[float, float]:
        return self.tail.edges[0], self.tail.edges[-1]

    # Stability of localised perturbations --------------------------------------------------------------------------

    @cached_property
    def localised(self) -> Localised | None:
        if not self.symplectic:
            return None
        lattice, p, most = self.lattice, len(self.lattice.sites), self.lattice.cells - 1
        if lattice.lean != 0.0:  # scales of positions are doubles
            most = min(most, WITHIN_SCALES * DEEPEST_LOG_SCALE / -abs(lattice.lean))
        first = self.core.cells + math.ceil(BESIDE_CORE / p)
        tried = [first * 2**k for k in range(SITE_DOUBLINGS + 1)]
        if self._stability_sites is not None:
            tried = [math.ceil(self._stability_sites / p)]
        sites = tuple(dict.fromkeys(p * int(min(cells, most)) for cells in tried))
        ends = [math.sqrt(max(square, 0.0)) for square in self.tail.edges]
        bands = tuple(zip(ends[::2], ends[1::2], strict=True))
        return Localised(
            sites, bands, lattice.at_last, lattice.cell, lattice.coupling, lattice.inlet, lattice.outlet, self.attached
        )

    def cut(self, sites: int) -> tuple[CellsAtEdge, int]:
        core = Core(sites // len(self.lattice.sites), self.core.slowest)
        cells = CellsAtEdge(self.lattice, core, self.edge_mode, self.mode_number, self._amplitude_max)
        return cells, self.mode_number

    def on_cut_sites(self, problem: Problem, z: Array, cut: Any) -> Array:
        at_edge = -1 if self.lattice.at_last else 0
        unit = self.scale[at_edge] / cut.scale[at_edge]  # of the two gauges
        both = self._on_cells(problem, z, cut.core.cells)
        return np.concatenate([unit * both.ravel(), [problem.frequency(z), z[problem.parameter_index]]])

    def _on_cells(self, problem: Problem, z: Array, cells: int) -> Array:
        """Scaled positions at the nodes on so many cells at the edge, shape (sites, nodes)."""
        H = problem.resolution
        logs, parts = self._in_tail(problem, z, np.arange(1, cells - self.core.cells + 1))
        coefficients = np.exp(logs)[:, :, None] * parts
        order = slice(None, None, -1) if self.lattice.at_last else slice(None)
        tail, core = coefficients[:, order].reshape(H, -1).T @ cosine_matrix(H), z[: problem.states].reshape(-1, H)
        return np.concatenate([tail, core] if self.lattice.at_last else [core, tail])

    # The linear mode --------------------------------------------------------------------------------------------------

    @property
    def frequency(self) -> float:
        return float(np.sqrt(self.edge_mode.square))

    @cached_property
    def _motion(self) -> Array:
        """Amplitudes of the linear mode in the core, and in the cell beyond, from the edge on; (cells, sites)."""
        lattice, mode, p = self.lattice, self.edge_mode, len(self.lattice.sites)
        numbers, unit = np.arange(1, self.core.cells + 1), np.eye(p)[[lattice.inlet]]
        logs, parts = lattice.tail(1).motion(mode.place, mode.angle, numbers)
        across, down = math.sin(mode.angle), math.cos(mode.angle)
        held, bond = lattice.edge_cell - mode.square * np.eye(p), -lattice.coupling * across * unit.T
        *first, size = np.linalg.svd(np.block([[held, bond], [unit, -down * np.eye(1)]]))[2][-1]
        return np.concatenate([[first], size * (lattice.bond_sign**numbers * np.exp(logs))[:, None] * parts])

    @cached_property
    def start_unknown(self) -> float:
        mode = self.edge_mode
        if not mode.pinned or np.isfinite(self.lattice.cells):
            return self.parameter(2).at(self.tail.angle(mode.place))
        edge = self.tail.angle(Place(mode.place.edge))
        across = self._motion[-1, self.lattice.outlet] * self.lattice.bond_sign
        direction = math.atan2(across, self._motion[-2, self.lattice.inlet])
        outwards = -mode.place.side
        return self.parameter(2).at(edge + outwards * (outwards * (direction - edge) % math.pi))

    @cached_property
    def mode(self) -> Array:
        motion = self._motion[:-1]
        return normalised((motion[::-1] if self.lattice.at_last else motion).ravel(), self.scale)

    # Sites of the core and of the tail --------------------------------------------------------------------------------

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

    def _where(self, sites: Indices | None) -> tuple[Indices, Indices]:
        """Numbers of the cells of sites from the edge, from 0, and places in these; ValueError for none that is there.

        Sites are numbered from 1; those of an infinite lattice whose edge is its last cell end with site 0.
        """
        p, whole = len(self.lattice.sites), self.lattice.cells * len(self.lattice.sites)
        sites, last = self.output_sites if sites is None else sites, whole if np.isfinite(whole) else 0
        cells, places = np.divmod(sites - 1, p)
        cells = int(last) // p - 1 - cells if self.lattice.at_last else cells
        if cells.size and (cells.min() < 0 or cells.max() >= self.lattice.cells):
            endless = "whole numbers up to 0" if self.lattice.at_last else "whole numbers from 1"
            known = f"1 to {whole}" if np.isfinite(whole) else endless
            raise ValueError(f"sites: given {sites.min()} to {sites.max()}; accepted: {known}")
        return cells, places

    def _in_core(self, cells: Indices, places: Indices) -> Indices:
        """Indices of sites among the unknown positions."""
        return (self.core.cells - 1 - cells if self.lattice.at_last else cells) * len(self.lattice.sites) + places

    def _log_scale_at(self, cells: Indices, places: Indices) -> Array:
        """Logarithms of the factors D of sites, of the core's outermost cell and beyond."""
        outermost = self._in_core(np.full_like(places, self.core.cells - 1), places)
        return np.asarray(self.log_scale[outermost] - self.lattice.lean * (cells - self.core.cells + 1))

    def _in_tail(self, problem: Any, z: Array, numbers: Indices) -> tuple[Array, Array]:
        """Coefficients of the odd cosines in cells of the tail, numbered from 1 beside the core.

        Returns:
            Logarithms of a factor, shape (harmonics, cells), and the coefficients over it, (harmonics, cells, sites).
        """
        values, sizes = problem.values(z), problem.coefficients(z)[self.attached]
        logs, parts = self.tail.motions(values.places, values.phi, sizes, numbers)
        return logs, self.lattice.bond_sign ** np.asarray(numbers, dtype=float)[:, None] * parts

    def displacements(self, problem: Problem, z: Array, theta: Array, sites: Indices | None) -> Array:
        cells, places = self._where(sites)
        inside, y = cells < self.core.cells, np.empty((theta.size, cells.size))
        y[:, inside] = super().displacements(problem, z, theta, self._in_core(cells[inside], places[inside]) + 1)
        if not inside.all():
            beyond, at = cells[~inside], places[~inside]
            logs, parts = self._in_tail(problem, z, beyond - self.core.cells + 1)
            logs = logs + self._log_scale_at(beyond, at)
            coefficients = np.exp(logs) * parts[:, np.arange(at.size), at]
            y[:, ~inside] = np.cos(np.outer(theta, 2 * np.arange(problem.resolution) + 1)) @ coefficients
        return y

    def log_displacements(
        self, point: Point, solved: tuple[Array, Array], sites: Indices | None
    ) -> tuple[Array, Array]:
        from scipy.special import logsumexp

        cells, places = self._where(sites)
        inside, logs, signs = cells < self.core.cells, np.empty(cells.size), np.empty(cells.size)
        chosen = self._in_core(cells[inside], places[inside])
        logs[inside], signs[inside] = (solved[0] + self.log_scale)[chosen], solved[1][chosen]
        if not inside.all():
            beyond, at = cells[~inside], places[~inside]
            factors, parts = self._in_tail(point.problem, point.z, beyond - self.core.cells + 1)
            sums = logsumexp(factors, axis=0, b=parts[:, np.arange(at.size), at], return_sign=True)
            logs[~inside], signs[~inside] = sums
            logs[~inside] += self._log_scale_at(beyond, at)
        return logs, signs

    # Quantities -------------------------------------------------------------------------------------------------------

    def energy(self, problem: Any, z: Array) -> float:
        """Infinite where an infinite tail moves along; weights are 1 at the edge.

        Products of two harmonics add up to a term at the end of the tail (Green's identity).
        """
        core = super().energy(problem, z)
        values, s = problem.values(z), self.tail.coupling
        site = problem.coefficients(z)[self.attached]
        size = site / values.down
        beside, squares = size * values.across, ((2.0 * np.arange(problem.resolution) + 1.0) * values.Omega) ** 2
        apart = squares[None, :] - squares[:, None]
        np.fill_diagonal(apart, 1.0)
        products = -s * (np.outer(beside, site) - np.outer(site, beside)) / apart
        squared = [a**2 * self.tail.squares(place) for a, place in zip(size, values.places, strict=True)]
        np.fill_diagonal(products, squared)
        tail = 0.5 * float(np.sum(products @ squares)) - 0.5 * s * float(np.sum(site) * np.sum(beside))
        rest, moving = np.zeros(self.mode.size), np.eye(self.mode.size)[self.attached]
        parameter_value = float(z[problem.parameter_index])
        energies = [float(self._hamiltonian(rest, v, parameter_value)) for v in (moving, rest)]
        return (core + 2.0 * (energies[0] - energies[1]) * tail) * self._edge_weight

    def Omega_shift(self, problem: Any, z: Array) -> float:
        """From the distance to the edge of the band beside it, else by projection on the mode."""
        values, Omega, mode = problem.values(z), problem.frequency(z), self.edge_mode.place
        place = values.places[0]
        outside = not place.in_band or not np.isfinite(self.lattice.cells)
        if mode.edge == place.edge and self.edge_mode.pinned and outside:
            return float((place.off - mode.off) / (Omega + self.frequency))
        theta, site = quarter_phases(2 * max(32, problem.resolution)), self.attached
        nonlinear, overlap, size = self.projections(problem, z, theta)
        beyond = self._tail_overlap(place, values.phi[0])
        overlap += problem.coefficients(z)[site, 0] * self.mode[site] * beyond
        return float(shift_by_projection(Omega, self.frequency, nonlinear, overlap, size))

    @property
    def left_mode(self) -> Array:
        return self.mode

    def _tail_overlap(self, place: Place, phi: float) -> float:
        """Sum of products of two waves' amplitudes over the tail, relative to that at the core's site."""
        tail, mode = self.tail, self.edge_mode.place
        other = tail.angle(mode)
        if mode.edge != place.edge or abs(phi - other) > CLOSE:
            apart = tail.square(place) - tail.square(mode) if mode.edge != place.edge else place.off - mode.off
            return float(tail.coupling * math.sin(phi - other) / (math.cos(phi) * math.cos(other) * apart))
        middle = Place(place.edge, 0.5 * (place.off + mode.off))
        return float(tail.squares(middle) / math.cos(tail.angle(middle)) ** 2)


class CellsAtEdge(CoreWithTail):
    """So many cells at the edge by themselves, without the bond to those beyond: all positions are unknowns."""

    localised = None

    def transcription(self, resolution: int) -> None:  # type: ignore[override]
        return None

    @property
    def is_whole(self) -> bool:
        return True

    def family_coordinates(self, *_: Any) -> CellsAtEdge:
        """These, whatever the mode and the method: a model of its own families."""
        return self


def long_lattice_coordinates(
    lattice: LongLattice,
    mode: int | str,
    amplitude_max: float,
    method: Method,
    parameters: Mapping[str, float] | None = None,
) -> CoreWithTail:
    """Coordinates of the family that grows from an edge mode of a long lattice to S = `amplitude_max`.

    Raises ValueError, naming the argument, for a mode or a method without such a family.
    """
    check_no_parameters(parameters)
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
    return CoreWithTail(lattice, core, lattice.modes[number - 1], number, amplitude_max, sites)
