"""Equations of motion of a declared lattice, in CasADi symbols."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import CELL_INDICES, Declaration, Link, read_formula
from casadi_skin.model.expressions import expression
from casadi_skin.model.formula import Name, Operation, Tree
from casadi_skin.zero.linear_modes import tree_of


class Equations:
    """The equations of motion of a declared lattice, in CasADi symbols: formulas of all cells at once, as columns."""

    def __init__(self, declaration: Declaration) -> None:
        self.declaration = declaration
        self.cells = list(declaration.all_cells())
        places = [
            "_".join([*([site.name] if len(declaration.sites) > 1 else []), *(str(k + 1) for k in cell)])
            for cell in self.cells
            for site in declaration.sites
        ]
        self.y, self.v = (ca.vertcat(*(ca.SX.sym(f"{x}_{place}") for place in places)) for x in "yv")
        self.t = ca.SX.sym("t")
        self.parameters = ca.vertcat(*(ca.SX.sym(name) for name in declaration.scalars))
        self.parameters = self.parameters if declaration.scalars else ca.SX(0, 1)
        self.nominal = tuple(declaration.scalars.values())
        self.symbols = dict(zip(declaration.scalars, ca.vertsplit(self.parameters), strict=True))
        self.links: tuple[Link, ...] = tuple(declaration.links())
        self._check_at_rest()

    # Formulas at cells ------------------------------------------------------------------------------------------------

    def values(self, cells: Sequence[tuple[int, ...]]) -> dict[str, ca.SX]:
        """Values of parameters and indices in some cells: a column, or one value where it is the same in all."""
        along = np.array(cells, dtype=float).reshape(len(cells), -1).T
        values = dict(self.symbols) | {
            name: ca.SX(ca.DM(k + 1.0)) for name, k in zip(CELL_INDICES, along, strict=False)
        }
        for name, value in self.declaration.by_cell.items():
            if isinstance(value, np.ndarray):  # of numbers, or of names of parameters
                entries = [value[cell] for cell in cells]
                named = value.dtype == object
                values[name] = ca.vertcat(*(self.symbols[e] for e in entries)) if named else ca.SX(ca.DM(entries))
            else:
                values[name] = expression(value, values)
        return values

    def at(self, kind: str, number: int, field: str, cells: Sequence[tuple[int, ...]], **variables: ca.SX) -> ca.SX:
        """A formula of a site or a bond in some cells, a column."""
        values = self._everywhere if cells is self.cells else self.values(cells)
        found = expression(self.declaration.formulas[kind, number, field], values | variables)
        return ca.densify(ca.repmat(found, len(cells), 1) if found.numel() == 1 else found)

    @cached_property
    def _everywhere(self) -> dict[str, ca.SX]:
        return self.values(self.cells)

    def of_sites(self, field: str) -> ca.SX:
        """A formula of all sites, at their own position, velocity and time, a column."""
        count, found = len(self.declaration.sites), ca.SX.zeros(self.declaration.size)
        for s in range(count):
            found[s::count] = self.at("site", s, field, self.cells, y=self.y[s::count], v=self.v[s::count], t=self.t)
        return found

    @cached_property
    def inner(self) -> list[int]:
        """Indices of the links between two sites."""
        return [k for k, link in enumerate(self.links) if link.inner]

    @cached_property
    def ends(self) -> list[tuple[int, int]]:
        """Start and end of these."""
        return [(self.links[k].start, self.links[k].end) for k in self.inner]  # type: ignore[misc]

    @cached_property
    def tree(self) -> list[tuple[int, int, int, bool]]:
        """Those of a tree from the first site of each connected part, see `tree_of`."""
        return list(tree_of(self.y.numel(), self.ends, range(self.y.numel())))

    def links_of(self, bond: int) -> list[Link]:
        """The links of a bond, in the order of cells."""
        return [link for link in self.links if link.bond == bond]

    def extensions(self, links: Sequence[Link]) -> ca.SX:
        """d = y_end - y_start, with 0 at a wall, a column."""
        positions, wall = ca.vertcat(self.y, 0), self.declaration.size
        start, end = [link.start for link in links], [link.end for link in links]
        there, here = (positions[[wall if i is None else i for i in ends]] for ends in (end, start))
        return there - here

    @cached_property
    def gains(self) -> list[tuple[ca.SX, ca.SX]]:
        """The gains at the start and at the end of every link."""
        found: list[tuple[ca.SX, ca.SX]] = []
        for b in range(len(self.declaration.bonds)):
            cells = [link.cell for link in self.links_of(b)]
            columns = (ca.vertsplit(self.at("bond", b, f"gain {k}", cells)) if cells else [] for k in (1, 2))
            found += list(zip(*columns, strict=True))
        return found

    # The whole lattice ------------------------------------------------------------------------------------------------

    @cached_property
    def masses(self) -> ca.SX:
        """Mass of every site, a column."""
        return self.of_sites("mass")

    @cached_property
    def accelerations(self) -> ca.SX:
        """y'' of every site."""
        onsite, damping, drive = (self.of_sites(field) for field in ("onsite", "damping", "drive"))
        forces = drive - onsite - damping * self.v
        for b in range(len(self.declaration.bonds)):
            links = self.links_of(b)
            force = self.at("bond", b, "force", [link.cell for link in links], d=self.extensions(links))
            gains = [self.gains[k] for k, link in enumerate(self.links) if link.bond == b]
            for side, sign in ((1, -1.0), (0, 1.0)):
                ends = [(link.start, link.end)[side] for link in links]
                moved = [k for k, i in enumerate(ends) if i is not None]
                gain = ca.vertcat(ca.SX(0, 1), *(gains[k][side] for k in moved))
                forces[[ends[k] for k in moved]] += sign * (gain * force[moved])
        return forces / self.masses

    @cached_property
    def damped(self) -> bool:
        """Whether velocities enter the forces."""
        return bool(ca.depends_on(self.accelerations, self.v))

    @cached_property
    def driven(self) -> bool:
        """Whether time enters the forces by itself."""
        return bool(ca.depends_on(self.accelerations, self.t))

    @property
    def autonomous(self) -> bool:
        """Whether there is neither damping nor drive."""
        return not (self.damped or self.driven)

    # Checks -----------------------------------------------------------------------------------------------------------

    def at_nominal(self, *results: ca.SX, at_zero: Mapping[str, ca.SX] | None = None) -> list[Any]:
        """Expressions in parameters, and in further symbols that are 0, as arrays, at the declared values."""
        zeros = list((at_zero or {}).values())
        function = ca.Function("f", [self.parameters, *zeros], [ca.densify(result) for result in results])
        found = function(self.nominal, *(0.0 for _ in zeros)) if results else []  # in numbers: 0 * inf is not 0
        found = found if isinstance(found, list | tuple) else [found]
        return [np.array(value).ravel() for value in found]

    def _check_at_rest(self) -> None:
        """Raises ValueError, with the place, for forces not finite at rest, and masses and gains out of range."""
        declaration = self.declaration
        for kind, number, field in declaration.formulas:
            variables = {name: ca.SX.sym(name) for name in "yvdt"}
            (values,) = self.at_nominal(self.at(kind, number, field, self.cells, **variables), at_zero=variables)
            text, place = declaration.formulas[kind, number, field].text, f"{kind} {number + 1} {field}"
            bad, accepted = ~np.isfinite(values), "a formula that is finite at rest"
            if field == "mass" and not bad.any():
                bad, accepted = values <= 0, "a mass > 0"
            if field.startswith("gain") and not bad.any():
                bad, accepted = values == 0, "gains that are not 0, so that a bond acts both ways"
            if bad.any():
                k = int(np.argmax(bad))
                where = ", ".join(str(i + 1) for i in self.cells[k])
                value = "not finite" if np.isnan(values[k]) else f"{values[k]:g}"
                raise ValueError(f'{place}: given "{text}", which is {value} in cell {where}; accepted: {accepted}')


# The period of the drives of a lattice --------------------------------------------------------------------------------

SAME_FREQUENCY_RTOL = 1e-12  # relative difference of frequencies that are the same but for rounding
ACCEPTED_DRIVES = "accepted: sines and cosines of t of one frequency, or with forcing_period"


def forcing_period_of(equations: Equations, given: str | None) -> ca.SX | None:
    """The period of the drives, None without any.

    Arguments:
        equations: of the lattice.
        given: a formula in parameters for the period; None where it is that of the sines and cosines of t.

    Raises:
        ValueError: there is a period given and no drive, or the drives have none that shows.
    """
    if not equations.driven:
        if given is not None:
            raise ValueError(f"forcing_period: given {given!r} without a drive; accepted: with a drive in t")
        return None
    if given is not None:
        formula = read_formula("forcing_period", given, tuple(equations.declaration.scalars))
        period = expression(formula, equations.symbols)
        (value,) = equations.at_nominal(period)
        if not 0 < value[0] < np.inf:
            raise ValueError(f"forcing_period: given {given!r}, which is {value[0]:g}; accepted: a finite number > 0")
        return period
    rates = list(_rates(equations))
    (values,) = equations.at_nominal(ca.vertcat(*rates))
    values = np.abs(values)
    if (
        np.ptp(values) > SAME_FREQUENCY_RTOL * np.max(values)
        or not np.all(np.isfinite(values))
        or not np.max(values) > 0
    ):
        words = " and ".join(f"{value:g}" for value in np.unique(values)[:3])
        raise ValueError(f"drive: given drives of frequencies {words}; {ACCEPTED_DRIVES}")
    return 2.0 * np.pi / ca.fabs(rates[0])


def _rates(equations: Equations) -> Iterator[ca.SX]:
    """The derivative with respect to t of the argument of every sine and cosine in the drives, in every cell."""
    t, declaration = ca.SX.sym("t"), equations.declaration
    for s in range(len(declaration.sites)):
        formula = declaration.formulas["site", s, "drive"]
        for argument in _arguments(formula.tree, f'site {s + 1} drive: given "{formula.text}"'):
            rates = ca.jacobian(expression(argument, equations.values(equations.cells) | {"t": t}), t)
            if ca.depends_on(rates, t):
                raise ValueError(f'site {s + 1} drive: given "{formula.text}"; {ACCEPTED_DRIVES}')
            yield from (rate for rate in ca.vertsplit(ca.densify(rates)) if not rate.is_zero())


def _arguments(tree: Tree, given: str) -> Iterator[Tree]:
    """Arguments of the sines and cosines; raises ValueError for t outside of them."""
    if isinstance(tree, Name) and tree.name == "t":
        raise ValueError(f"{given}; {ACCEPTED_DRIVES}")
    if not isinstance(tree, Operation):
        return
    if tree.kind in ("sin", "cos"):
        yield tree.parts[0]
        return
    for part in tree.parts:
        yield from _arguments(part, given)
