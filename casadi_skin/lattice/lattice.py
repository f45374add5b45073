"""Lattices as data: sites of a cell, bonds between them, boundaries; one or two dimensions; dimensionless.

Those of very many cells, or infinitely many, have an edge with its linear modes, and a linear tail.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import casadi as ca
import numpy as np

from casadi_skin.lattice.chain import WithOwnParameters, declared_chain
from casadi_skin.lattice.declaration import FIXED, PERIODIC, Array, Bond, Declaration, Site, Uniform, Value, listed
from casadi_skin.lattice.equations import Structure, forcing_period_of
from casadi_skin.lattice.tail import End, Place, Tail
from casadi_skin.model.arguments import check_name, short_repr
from casadi_skin.model.formula import Number
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.model_coordinates import FIRST, LAST, LinearSpectrum, number_of_mode, symmetrising_scale
from casadi_skin.zero.statement import named_values

if TYPE_CHECKING:
    from casadi_skin.zero.coordinates import Coordinates
    from casadi_skin.zero.family import Method

__all__ = ["Bond", "Lattice", "Site", "Uniform"]


class Lattice(OdeModel):
    """A lattice as a model: mass * y'' = -onsite - damping * y' + drive + forces of bonds at every site.

    Without damping and drive the model is of second order, and its reversal, its oddness, its conserved energy and its
    momentum are declared where `structure` shows that they hold. Positions are called y_1, y_2, ..., of several sites
    in a cell y_a_1, y_b_1, ..., in two dimensions y_1_1, y_1_2, ...; velocities v_1, ...

    Arguments:
        cells: cells along each direction, a whole number or one or two of them.
        sites: the sites of one cell.
        bonds: the bonds from the sites of one cell.
        boundary: "fixed" (missing neighbours are held at 0), "free" (their bonds are absent) or "periodic"; one word
            for all directions, or one for each.
        parameters: their values by name: a number, which can be followed; or by cell a list, a formula in n and m, or
            a `Uniform`.
        name: of the model.
        forcing_period: of the drives, a formula in parameters; left out, it is that of the sines and cosines of t in
            them where these have one.

    Raises:
        ValueError, TypeError: the message names the place, the value and the accepted values.
    """

    declaration: Declaration  # type: ignore[misc]
    structure: Structure

    def __init__(
        self,
        cells: int | Sequence[int],
        sites: Sequence[Site],
        bonds: Sequence[Bond] = (),
        boundary: str | Sequence[str] = FIXED,
        parameters: Mapping[str, Value] | None = None,
        name: str = "lattice",
        forcing_period: str | None = None,
    ) -> None:
        along = (cells,) if isinstance(cells, int) else listed("cells", cells, int, "a whole number, or one or two")
        walls = (boundary,) * len(along) if isinstance(boundary, str) else listed("boundary", boundary, str, "words")
        if not isinstance(parameters, Mapping | None):
            raise TypeError(f"parameters: given {short_repr(parameters)}; accepted: values by name")
        if not isinstance(name, str):
            raise TypeError(f"name: given {short_repr(name)}; accepted: a string")
        declaration = Declaration(
            along, listed("sites", sites, Site, "a list of sites"), listed("bonds", bonds, Bond, "a list of bonds"),
            walls, dict(parameters or {}),
        )  # fmt: skip
        structure = Structure(declaration)
        object.__setattr__(self, "declaration", declaration)
        object.__setattr__(self, "structure", structure)
        period = forcing_period_of(structure, forcing_period)
        common: dict[str, Any] = {
            "name": name, "parameters": structure.parameters, "nominal": structure.nominal, "checked": False,
        }  # fmt: skip
        if structure.reversible:
            n, momentum = declaration.size, {}
            if structure.momentum and structure.energy is not None:
                momentum = {"momentum": ca.sum1(ca.gradient(structure.energy, structure.v))}
            super().__init__(
                state=structure.y, rhs=structure.accelerations, order=2, velocity=structure.v,
                reversal=(1,) * n + (-1,) * n, half_period=(-1,) * (2 * n) if structure.odd else None,
                hamiltonian=structure.energy, conserved=momentum, **common,
            )  # fmt: skip
        else:
            state, rhs = ca.vertcat(structure.y, structure.v), ca.vertcat(structure.v, structure.accelerations)
            time = None if period is None else structure.t
            super().__init__(state=state, rhs=rhs, time=time, forcing_period=period, **common)

    @cached_property
    def with_numbers_apart(self) -> tuple[OdeModel, Mapping[str, Number | None]]:
        """The equations and the energy with every number of the formulas as a parameter, and the numbers by name.

        For proofs of lattices without damping and drive: no arithmetic of numbers is rounded.
        """
        declaration, numbers = self.declaration.with_numbers_apart()
        found = Structure(declaration)
        return OdeModel(
            self.name, found.y, found.accelerations, found.parameters, 2, found.v, hamiltonian=found.energy,
            checked=False,
        ), numbers  # fmt: skip

    @property
    def equations(self) -> Structure:
        """The equations of motion in CasADi symbols."""
        return self.structure

    def stiffness(self, parameters: Mapping[str, float] | None = None) -> Array:
        """K of y'' = -K y about rest without damping and drives, shape (sites, sites), at values of the parameters."""
        equations, values = self.equations, list(named_values(self, parameters).values())
        derivative = ca.densify(ca.jacobian(equations.accelerations, equations.y))
        function = ca.Function("K", [equations.y, equations.v, equations.t, equations.parameters], [-derivative])
        return np.array(function(0, 0, 0, values))

    def of_cells(self, cells: int | Sequence[int]) -> Lattice:
        """The same lattice of another number of cells, which are alike."""
        d = self.declaration
        values = {
            name: value for name, value in d.parameters.items() if not isinstance(d.by_cell.get(name), np.ndarray)
        }
        return Lattice(cells, d.sites, d.bonds, d.boundary, values, self.name)

    def family_coordinates(
        self, mode: int | str, amplitude_max: float, method: Method, parameters: Mapping[str, float] | None = None
    ) -> Coordinates:
        """Those of the chain where the lattice declares one with such a family; see `follow_family`."""
        values = named_values(self, parameters)
        chain = declared_chain(self.declaration, self.equations.reversible, values)
        if chain is not None:
            try:
                found: Any = chain.family_coordinates(mode, amplitude_max, method)
            except ValueError:
                if method.tail is not None:
                    raise
            else:
                found.declared = self, values
                return found  # type: ignore[no-any-return]
        coordinates: Coordinates = super().family_coordinates(mode, amplitude_max, method, parameters)
        return coordinates

    def __repr__(self) -> str:
        return f"Lattice({self.name}, cells = {list(self.declaration.cells)}, {self.declaration.size} sites)"


# Long lattices: their edge, and its linear modes ----------------------------------------------------------------------

SAMPLE_CELLS = 6  # cells of a lattice from which the properties of one cell are read
FEWEST = 8  # cells of a lattice that is long
ROUND_OFF = 1e-12


@dataclass(frozen=True)
class EdgeMode:
    """A linear mode at the edge: bound in a gap, or pinned to an edge of a band, where it decays by the gauge alone.

    `angle` is that of the tail which begins at the second cell.
    """

    place: Place
    square: float
    angle: float

    @property
    def pinned(self) -> bool:
        """Whether this is pinned to an edge of a band."""
        return self.place.in_band


@dataclass(frozen=True, eq=False)
class LongLattice(WithOwnParameters):
    """A lattice of so many alike cells that all but those at one edge are linear; one direction; dimensionless.

    Attributes:
        cells: number of cells, 8 or more, or `math.inf`.
        sites, bonds: of one cell, as of a `Lattice`; one bond, or several between the same two sites, joins
            neighbouring cells.
        boundary: "fixed" or "free".
        parameters: numbers by name.
        edge: "first" or "last", the end whose breathers are followed; left out, that to which the lattice leans.
        name: of the model.

    Raises ValueError and TypeError, naming the place, what was given and the accepted values.
    """

    cells: float
    sites: Sequence[Site]
    bonds: Sequence[Bond]
    boundary: str = FIXED
    parameters: Mapping[str, float] = field(default_factory=dict)
    edge: str | None = None
    name: str = "lattice"

    def __post_init__(self) -> None:
        whole = isinstance(self.cells, int) and not isinstance(self.cells, bool)
        endless = isinstance(self.cells, float) and self.cells == math.inf
        if not (endless or (whole and self.cells >= FEWEST)):
            accepted = f"a whole number >= {FEWEST}, or inf (with fewer a Lattice)"
            raise ValueError(f"cells: given {short_repr(self.cells)}; accepted: {accepted}")
        lattice = self.sample
        if self.boundary == PERIODIC:
            raise ValueError(f"boundary: given {PERIODIC}, which has no edge; accepted: fixed, free")
        if self.edge is not None:
            check_name("edge", self.edge, (FIRST, LAST))
        if differing := lattice.declaration.differing:
            words = f"cells that differ by {', '.join(differing)}"
            raise ValueError(f"lattice: given {words}; accepted with a linear tail: cells alike")
        if not lattice.structure.reversible or not lattice.structure.odd:
            words = "damped or driven" if not lattice.structure.reversible else "not odd: there are even harmonics"
            raise ValueError(f"lattice: given forces that are {words}; accepted with a linear tail: odd forces alone")
        _ = self.joined

    @property
    def labels(self) -> tuple[tuple[str, float], ...]:
        """Symbols in TeX and values that distinguish lattices, for titles."""
        return (r"\mathrm{cells}", self.cells), *((rf"\mathrm{{{k}}}", v) for k, v in self.parameters.items())

    def of_cells(self, cells: int) -> Lattice:
        """The same lattice with so many cells, all of whose sites are positions."""
        return Lattice(cells, self.sites, self.bonds, self.boundary, self.parameters, self.name)

    @cached_property
    def sample(self) -> Lattice:
        """The same lattice with a few cells."""
        return self.of_cells(SAMPLE_CELLS)

    # Cells in the gauge -----------------------------------------------------------------------------------------------

    @cached_property
    def _symmetric(self) -> tuple[Array, Array]:
        """Stiffness of the sample in the gauge, and the logarithms of its factors."""
        stiffness = self.sample.stiffness()
        log_scale = symmetrising_scale(stiffness)
        if log_scale is None:
            raise ValueError(
                "lattice: given cells without a gauge; accepted with a linear tail: a lattice that has one"
            )
        scale = np.exp(log_scale)
        return stiffness / scale[:, None] * scale, log_scale

    def _block(self, row: int, column: int) -> Array:
        p = len(self.sites)
        return self._symmetric[0][row * p : (row + 1) * p, column * p : (column + 1) * p]

    @cached_property
    def joined(self) -> tuple[int, int]:
        """Sites of a cell and of the next between which the cells are joined; raises ValueError for other bonds."""
        links = np.argwhere(self._block(2, 3) != 0.0)
        if len(links) != 1 or np.any(self._block(1, 3) != 0.0):
            words = "of one site of a cell with one of the next"
            raise ValueError(f"bonds: given cells joined otherwise; accepted with a linear tail: bonds {words} alone")
        return int(links[0, 0]), int(links[0, 1])

    @property
    def at_last(self) -> bool:
        """Whether the edge is the last cell."""
        return self.lean_to_last >= 0.0 if self.edge is None else self.edge == LAST

    @cached_property
    def lean_to_last(self) -> float:
        """Logarithm by which displacements of waves grow from a cell to the next."""
        logs = self._symmetric[1].reshape(SAMPLE_CELLS, -1)
        lean = float(np.mean(logs[3] - logs[2]))
        return lean if abs(lean) > ROUND_OFF else 0.0

    @property
    def lean(self) -> float:
        """Logarithm by which displacements of waves fall from cell to cell, away from the edge."""
        return self.lean_to_last if self.at_last else -self.lean_to_last

    @property
    def inlet(self) -> int:
        """Site of a cell that is joined to the cell farther from the edge."""
        return self.joined[1] if self.at_last else self.joined[0]

    @property
    def outlet(self) -> int:
        """Site of a cell that is joined to the cell nearer to the edge."""
        return self.joined[0] if self.at_last else self.joined[1]

    @cached_property
    def cell(self) -> Array:
        """Stiffness of a cell in the gauge, shape (sites, sites)."""
        return 0.5 * (self._block(2, 2) + self._block(2, 2).T)

    @cached_property
    def edge_cell(self) -> Array:
        """Stiffness of the cell at the edge in the gauge."""
        last = SAMPLE_CELLS - 1 if self.at_last else 0
        return 0.5 * (self._block(last, last) + self._block(last, last).T)

    @property
    def bond_sign(self) -> float:
        """-1 where the bonds between cells push apart: amplitudes then change their sign from cell to cell."""
        return -float(np.sign(self._block(2, 3)[self.joined]))

    @cached_property
    def coupling(self) -> float:
        """Strength of the bonds between cells in the gauge."""
        return abs(float(self._block(2, 3)[self.joined]))

    def tail(self, core: int) -> Tail:
        """The tail of all cells but `core` of them at the edge."""
        strength, far = self.coupling, 0 if self.at_last else SAMPLE_CELLS - 1
        wall = float(self.cell[self.inlet, self.inlet] - self._block(far, far)[self.inlet, self.inlet]) / strength
        return Tail(self.cells - core, self.cell, strength, self.inlet, self.outlet, wall)

    # Linear modes -----------------------------------------------------------------------------------------------------

    @cached_property
    def modes(self) -> tuple[EdgeMode, ...]:
        """Linear modes at the edge, by ascending frequency: bound ones, and where the lattice leans pinned ones."""
        tail, found = self.tail(1), []
        for gap in range(len(tail.edges) // 2 + 1):
            edges = tail.sides(gap)
            ends = [None if edge is None else End(1, edge, self._together(tail, edge)) for edge in edges]
            low, high = (self._limit(tail, end, side) for end, side in zip(ends, (-1.0, 1.0), strict=True))
            for turns in range(math.ceil(low / np.pi), math.floor(high / np.pi) + 1):
                place = tail.resolved(ends, lambda _, at: self._together(tail, at), turns * np.pi)[1]
                square = tail.square(place)
                found.append(EdgeMode(place, square, turns * np.pi + self._missing(square)))
        return tuple(sorted((mode for mode in found if mode.square > 0.0), key=lambda mode: mode.square))

    def _missing(self, square: float) -> float:
        """The angle that the edge cell has at its bond to the tail; falls with lambda."""
        values, weights = self._at_inlet
        with np.errstate(divide="ignore"):
            response = float(np.sum(weights / (values - square)))
        return float(np.arctan2(1.0, self.coupling * response) - np.pi * np.sum(values < square))

    @cached_property
    def _at_inlet(self) -> tuple[Array, Array]:
        """Eigenvalues of the edge cell, and squares of their vectors at its bond to the tail, where these are seen."""
        values, vectors = np.linalg.eigh(self.edge_cell)
        weights = vectors[self.inlet] ** 2
        return values[weights > ROUND_OFF], weights[weights > ROUND_OFF]

    def _together(self, tail: Tail, place: Place) -> float:
        """The angle of the tail without that of the edge cell, a multiple of pi for a mode; grows with lambda."""
        return tail.angle(place) - self._missing(tail.square(place))

    def _limit(self, tail: Tail, end: End | None, side: float) -> float:
        """The largest, or the least, such angle of a mode: in the gap, and of a pinned one in the first lobe beyond."""
        highest = tail.edges[-1]
        if end is None:
            return self._together(tail, tail.anywhere(1e3 * highest if side > 0.0 else min(0.0, tail.edges[0])))
        if self.lean <= 0.0:
            return self._together(tail, Place(end.edge.edge, -side * ROUND_OFF * highest))
        if not np.isfinite(tail.cells):
            return end.angle + side * np.pi
        turn = side * tail.first_turn(end.edge.edge)
        lobe = tail.at_angle(end.edge.gap, tail.angle(end.edge) + turn)
        return end.angle + side * min(abs(self._together(tail, lobe) - end.angle), np.pi)

    def linear_spectrum(self, parameters: Mapping[str, float] | None = None) -> LinearSpectrum:
        """The ends of the bands; the lattice has too many modes for more."""
        squares = self.tail(1).edges
        ends = squares[0], squares[-1]
        bands = tuple(zip(squares[::2], squares[1::2], strict=True))
        return LinearSpectrum(np.empty(0), ends, lambda _: np.empty(0), ends, bands)

    def tunable_model(self) -> OdeModel:
        """Raises ValueError: there are too many equations."""
        raise ValueError("[lattice]: given one with a linear tail, whose equations are not written down")

    def mode_number(self, mode: int | str) -> int:
        """The number of a mode that may be named "first" or "last"; raises ValueError for one that is not there."""
        if not self.modes:
            words = "none is bound in a gap, and the lattice does not lean there"
            raise ValueError(f"mode: the lattice has no mode at this edge ({words}); accepted: a Lattice")
        return number_of_mode(mode, len(self.modes), " of the modes at the edge")

    family_coordinates: ClassVar[Callable[..., Coordinates]]
    """Coordinates of the family that grows from a mode at the edge to S = `amplitude_max`; see `follow_family`."""


# The number of cells at an edge of a long lattice that are nonlinear, and these by themselves as a model --------------

NEGLIGIBLE_FORCE_RATIO = 1e-16  # of the nonlinear forces: the part that the tail may leave out
LONGEST_CORE = 2000  # sites
KEPT_DECAY_RATIO = 0.5  # of the decay of a bound mode's displacements: down to it the core holds all that is nonlinear
LOOKED_AT_HARMONICS = 4  # that are looked at before anything is solved


@dataclass(frozen=True)
class Core:
    """The number of unknown cells, and the decay a cell in the gauge for which these are enough."""

    cells: int
    slowest: float


def nonlinear_cells(rate: float, reach: float, most: int) -> int:
    """Cells outside of which forces are below round-off, counted to somewhat beyond `most`.

    Arguments:
        rate: logarithm by which the square of displacements falls from cell to cell.
        reach: size of the nonlinear forces at the edge, relative to the linear ones.
    """
    cells = 2
    while cells <= most and cells * rate < 2.0 * math.log(cells + 1) + math.log(reach / NEGLIGIBLE_FORCE_RATIO):
        cells += max(1, cells // 64)
    return cells


def core_of(lattice: LongLattice, mode: EdgeMode, amplitude_max: float) -> Core:
    """The cells outside of which nonlinear forces are below round-off; raises ValueError where there are none."""
    tail = lattice.tail(1)
    decay = tail.decay(mode.place) if not mode.pinned else 0.0
    for k in range(3, 2 * LOOKED_AT_HARMONICS, 2):
        try:
            falls = tail.decay(tail.place(k**2 * mode.square)) + lattice.lean
        except ArithmeticError:
            falls = 0.0
        if falls <= 0.0:
            words = f"{k} times the frequency of the mode, which the tail carries away"
            raise ValueError(f"mode: given one with {words}; accepted: harmonics that decay, or a Lattice of all sites")
    reach = max(1.0, amplitude_max * _nonlinearity(lattice, amplitude_max))
    for slowest in (0.0, KEPT_DECAY_RATIO * (decay + lattice.lean) - lattice.lean) if decay > 0.0 else (0.0,):
        most = LONGEST_CORE // len(lattice.sites)
        cells = nonlinear_cells(2.0 * (slowest + lattice.lean), reach, most)
        if cells <= most:
            if cells + 2 > lattice.cells:
                accepted = f"more than {cells + 2} cells, of which so many are nonlinear, or a Lattice"
                raise ValueError(f"cells: given {lattice.cells}; accepted: {accepted}")
            return Core(cells, slowest)
    words = f"one that falls by {max(decay + lattice.lean, 0.0):.3g} a cell"
    raise ValueError(f"mode: given {words}; accepted: {LONGEST_CORE} nonlinear sites at the edge at most")


def _nonlinearity(lattice: LongLattice, amplitude_max: float) -> float:
    """The nonlinear part of the forces on one site over its displacement and its amplitude squared."""
    model, a = lattice.sample, math.sqrt(amplitude_max)
    values = list(named_values(model, {}).values())
    force = ca.Function("f", [model.state, model.parameters], [model.rhs, ca.jacobian(model.rhs, model.state)])
    _, J = force(0, values)
    unit = np.eye(model.size)
    beside = [np.array(force(a * e, values)[0]).ravel() - a * np.array(J @ e).ravel() for e in unit]
    largest = np.max(np.abs(beside), initial=0.0, where=np.isfinite(beside))
    return float(largest / a**3 / np.max(np.abs(np.array(J))))


def core_model(lattice: LongLattice, whole: Lattice) -> OdeModel:
    """The cells at the edge of a lattice by themselves, with the cell beyond them held at rest."""
    p = len(lattice.sites)
    n = whole.size - p
    kept, beyond = (slice(p, None), slice(None, p)) if lattice.at_last else (slice(None, n), slice(n, None))

    held, at_rest = ca.vertcat(whole.state[beyond], ca.SX(whole.velocity)[beyond]), ca.SX.zeros(2 * p)
    energy = None if whole.hamiltonian is None else ca.substitute(whole.hamiltonian, held, at_rest)
    return OdeModel(
        lattice.name, whole.state[kept], ca.substitute(whole.rhs, held, at_rest)[kept], whole.parameters, 2,
        ca.SX(whole.velocity)[kept], nominal=whole.nominal, hamiltonian=energy, reversal=(1,) * n + (-1,) * n,
        half_period=(-1,) * (2 * n), checked=False,
    )  # fmt: skip
