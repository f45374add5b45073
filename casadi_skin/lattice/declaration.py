"""Declaration of a lattice: sites of a cell, bonds, cells along each direction, boundaries, values by cell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import check_name, number, short_repr, whole
from casadi_skin.model.formula import (
    CONSTANTS,
    FUNCTIONS,
    Formula,
    FormulaError,
    Name,
    Number,
    parse_formula,
    walk,
    with_names_of_numbers,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
FIXED, FREE, PERIODIC = "fixed", "free", "periodic"
BOUNDARIES = (FIXED, FREE, PERIODIC)
CELL_INDICES = ("n", "m")  # the number of the cell along each direction, from 1
RESERVED_NAMES = ("y", "v", "d", "t", *CELL_INDICES, *CONSTANTS, *FUNCTIONS)
MOST_SITES = 100_000  # of a lattice


@dataclass(frozen=True)
class Site:
    """A site of a cell: mass * y'' = -onsite - damping * v + drive + forces of bonds; dimensionless.

    Attributes:
        name: name by which bonds refer to it.
        onsite: restoring force, a formula in y.
        mass: a formula in parameters.
        damping: factor of -v, a formula in y and v.
        drive: force, a formula in t.

    Every formula may have parameters in it, and n and m, the numbers of the cell along each direction from 1.
    """

    name: str
    onsite: str = "0"
    mass: str = "1"
    damping: str = "0"
    drive: str = "0"


@dataclass(frozen=True)
class Bond:
    """A bond of one site to another, in the cell that is `offset` away, with a force F(d) of d = y_end - y_start.

    Attributes:
        start: name of the site in a cell.
        end: name of the site in the other cell.
        offset: cells along each direction; one whole number in a lattice of one direction.
        force: F, a formula in d.
        gain: the force on `start` is gain[0] * F(d), that on `end` is -gain[1] * F(d); formulas in parameters.

    Index and values by cell are those of the cell of `start`; outside of a wall, of the cell beside it.
    """

    start: str
    end: str
    offset: tuple[int, ...]
    force: str = "d"
    gain: tuple[str, str] = ("1", "1")

    def __post_init__(self) -> None:
        offset: Any = self.offset
        if isinstance(offset, int) and not isinstance(offset, bool):
            object.__setattr__(self, "offset", (offset,))


@dataclass(frozen=True)
class Uniform:
    """Values by cell drawn evenly from `low` to `high` by numpy's default generator with a seed."""

    low: float
    high: float
    seed: int

    def values(self, cells: tuple[int, ...]) -> Array:
        """One value a cell, shape of `cells`."""
        return np.random.default_rng(self.seed).uniform(self.low, self.high, cells)


Kind = TypeVar("Kind")
Value: TypeAlias = float | str | Sequence[float] | Sequence[Sequence[float]] | Uniform


class Links(NamedTuple):
    """All links of one bond, shape (links,) each: the cells whose values they have, and indices of their ends.

    The index of a wall is the number of all sites. Cells have the shape (links, directions).
    """

    cells: Indices
    start: Indices
    end: Indices


@dataclass(frozen=True)
class Declaration:
    """A lattice as declared, checked.

    Attributes:
        cells: number of cells along each direction, one or two.
        sites: of one cell.
        bonds: between these.
        boundary: "fixed", "free" or "periodic" along each direction.
        parameters: numbers by name; by cell a list, a formula in n and m, or a `Uniform`.

    Raises ValueError and TypeError, naming the place, the value and the accepted values.
    """

    cells: tuple[int, ...]
    sites: tuple[Site, ...]
    bonds: tuple[Bond, ...]
    boundary: tuple[str, ...]
    parameters: Mapping[str, Value]

    def __post_init__(self) -> None:
        if len(self.cells) not in (1, 2):
            raise ValueError(f"cells: given {short_repr(self.cells)}; accepted: one or two whole numbers")
        for count in self.cells:
            whole("cells", count, 1, MOST_SITES)
        if not self.sites:
            raise ValueError("sites: given none; accepted: one site a cell or more")
        if self.size > MOST_SITES:
            raise ValueError(f"cells: given {self.size} sites in all; accepted: up to {MOST_SITES}")
        if len(self.boundary) != len(self.cells):
            accepted = f"one word, or {len(self.cells)}: one along each direction"
            raise ValueError(f"boundary: given {short_repr(self.boundary)}; accepted: {accepted}")
        for word in self.boundary:
            check_name("boundary", word, BOUNDARIES)
        self._check_names()
        for i, bond in enumerate(self.bonds, start=1):
            self._check_bond(f"bond {i}", bond)
        _ = self.formulas, self.by_cell

    @property
    def size(self) -> int:
        """Number of sites in all."""
        return math.prod(self.cells) * len(self.sites)

    def _check_names(self) -> None:
        names = [site.name for site in self.sites]
        for i, name in enumerate(names):
            if not isinstance(name, str) or not name.isidentifier() or name in names[:i]:
                raise ValueError(f"site {i + 1} name: given {short_repr(name)}; accepted: a name of its own")
        for name in self.parameters:
            if not isinstance(name, str) or not name.isidentifier() or not name.isascii() or name in RESERVED_NAMES:
                accepted = f"names but for {', '.join(RESERVED_NAMES[:6])}, pi and functions"
                raise ValueError(f"parameters: given the name {short_repr(name)}; accepted: {accepted}")

    def _check_bond(self, place: str, bond: Bond) -> None:
        names = [site.name for site in self.sites]
        listed(f"{place} offset", bond.offset, int, "whole numbers, one along each direction")
        if not isinstance(bond.gain, list | tuple):
            raise TypeError(f"{place} gain: given {short_repr(bond.gain)}; accepted: two formulas")
        check_name(f"{place} from", bond.start, names)
        check_name(f"{place} to", bond.end, names)
        if len(bond.offset) != len(self.cells) or not all(isinstance(k, int) for k in bond.offset):
            accepted = f"{len(self.cells)} whole number{'s'[: len(self.cells) - 1]}, one along each direction"
            raise ValueError(f"{place} offset: given {short_repr(list(bond.offset))}; accepted: {accepted}")
        around = [k % c if b == PERIODIC else k for k, c, b in zip(bond.offset, self.cells, self.boundary, strict=True)]
        if bond.start == bond.end and not any(around):
            words = f"{list(bond.offset)}, which leads from each {bond.start} to itself"
            raise ValueError(f"{place} offset: given {words}; accepted: one that leads to another site")
        if len(bond.gain) != 2:
            raise ValueError(f"{place} gain: given {short_repr(list(bond.gain))}; accepted: two formulas")

    # Formulas -------------------------------------------------------------------------------------------------------

    @cached_property
    def formulas(self) -> dict[tuple[str, int, str], Formula]:
        """Formulas of sites and bonds by kind, number from 0 and field; the gains are "gain 1" and "gain 2"."""
        found, known = {}, (*self.parameters, *CELL_INDICES[: len(self.cells)])
        variables = {"onsite": ("y",), "mass": (), "damping": ("y", "v"), "drive": ("t",)}
        for i, site in enumerate(self.sites):
            for field, names in variables.items():
                found["site", i, field] = read_formula(f"site {i + 1} {field}", getattr(site, field), (*names, *known))
        for i, bond in enumerate(self.bonds):
            found["bond", i, "force"] = read_formula(f"bond {i + 1} force", bond.force, ("d", *known))
            for k, gain in enumerate(bond.gain, start=1):
                found["bond", i, f"gain {k}"] = read_formula(f"bond {i + 1} gain {k}", gain, known)
        return found

    @cached_property
    def by_cell(self) -> dict[str, Array | Formula]:
        """Parameters with a value for each cell: arrays of the shape of `cells`, or formulas after their arguments."""
        found: dict[str, Array | Formula] = {}
        for name, value in self.parameters.items():
            place = f"parameters {name}"
            if isinstance(value, Uniform):
                for field in fields(value):
                    number(f"{place} {field.name}", getattr(value, field.name))
                whole(f"{place} seed", value.seed, 0)
                if not math.isfinite(float(value.high) - float(value.low)):
                    raise ValueError(f"{place}: given {value}; accepted: a finite distance from low to high")
                found[name] = value.values(self.cells)
            elif name not in self.scalars and not isinstance(value, str):
                found[name] = self._array(place, value)
        known = (*self.parameters, *CELL_INDICES[: len(self.cells)])
        waiting = {
            k: read_formula(f"parameters {k}", v, known) for k, v in self.parameters.items() if isinstance(v, str)
        }
        while waiting:  # each after those that it is made of
            ready = [name for name, formula in waiting.items() if not set(formula.names) & set(waiting)]
            if not ready:
                name = next(iter(waiting))
                given = f'parameters {name}: given "{waiting[name].text}"'
                raise ValueError(f"{given}, which depends on itself; accepted: formulas in other parameters")
            found |= {name: waiting.pop(name) for name in ready}
        return found

    @cached_property
    def scalars(self) -> dict[str, float]:
        """Parameters that are one number for all cells."""
        plain = {k: v for k, v in self.parameters.items() if not isinstance(v, str | Uniform | Sequence | np.ndarray)}
        return {name: number(f"parameters {name}", value) for name, value in plain.items()}

    @property
    def differing(self) -> list[str]:
        """Names of indices and parameters in the formulas that have another value in another cell."""
        used = {name for formula in self.formulas.values() for name in formula.names}
        return sorted({*CELL_INDICES, *self.by_cell} & used)

    def _array(self, place: str, value: object) -> Array:
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError):
            array = np.array(np.nan)
        if array.shape != self.cells or not np.all(np.isfinite(array)):
            shape = " lists of ".join(map(str, self.cells))
            given = f"numbers of shape {list(array.shape)}" if array.ndim else short_repr(value)
            raise ValueError(f"{place}: given {given}; accepted: {shape} finite numbers, one a cell")
        return array

    # Numbers of formulas --------------------------------------------------------------------------------------------

    def with_numbers_apart(self) -> tuple[Declaration, dict[str, Number | None]]:
        """The declaration with every number of the forces as a parameter, and these numbers by their names.

        So no arithmetic of numbers is rounded. Exponents stay; the number pi is None, which is no fraction.
        """
        found = Declaration(self.cells, self.sites, self.bonds, self.boundary, self.parameters)
        forces = {key: formula for key, formula in self.formulas.items() if key[2] not in ("damping", "drive")}
        used = [*forces.values(), *(value for value in self.by_cell.values() if isinstance(value, Formula))]
        nodes = [node for formula in used for node in walk(formula.tree)]
        names = {node.name for node in nodes if isinstance(node, Name)}
        numbers: dict[str, Number | None] = {node.text: node for node in nodes if isinstance(node, Number)}
        numbers |= dict.fromkeys(names & set(CONSTANTS))

        def apart(formula: Formula) -> Formula:
            return Formula(formula.text, with_names_of_numbers(formula.tree))

        by_cell: dict[str, Any] = {}
        for name, value in {
            **dict(zip(CELL_INDICES, np.indices(self.cells) + 1.0, strict=False)),
            **self.by_cell,
        }.items():
            if isinstance(value, Formula):
                by_cell[name] = apart(value)
            elif name in names:
                texts = [repr(entry) for entry in value.ravel().tolist()]
                by_cell[name] = np.array(texts, dtype=object).reshape(self.cells)
                numbers |= {text: Number(text) for text in texts}
        values = {name: CONSTANTS[name] if number is None else number.value for name, number in numbers.items()}
        found.__dict__.update(
            formulas=self.formulas | {key: apart(formula) for key, formula in forces.items()},
            by_cell=by_cell,
            scalars=self.scalars | values,
        )
        return found, numbers

    # The whole lattice ----------------------------------------------------------------------------------------------

    def all_cells(self) -> Indices:
        """Numbers of all cells from 0, the last direction fastest, shape (cells, directions)."""
        return np.indices(self.cells).reshape(len(self.cells), -1).T

    @cached_property
    def links(self) -> list[Links]:
        """The links of each bond, those to walls too, in the order of their cells."""
        cells, sites = self.all_cells(), np.arange(self.size).reshape(-1, len(self.sites))
        of_name, found = {site.name: sites[:, i] for i, site in enumerate(self.sites)}, []
        for bond in self.bonds:
            start, end = (np.append(of_name[name], self.size) for name in (bond.start, bond.end))
            ahead, behind = (self._neighbours(cells, sense * np.array(bond.offset)) for sense in (1, -1))
            inner, outer = np.flatnonzero(ahead >= 0), np.flatnonzero(behind == len(cells))
            order = np.argsort(np.concatenate([inner, outer]), kind="stable")
            starts = np.concatenate([start[inner], np.full(outer.size, self.size)])
            ends = np.concatenate([end[ahead[inner]], end[outer]])
            found.append(Links(np.concatenate([cells[inner], cells[outer]])[order], starts[order], ends[order]))
        return found

    def _neighbours(self, cells: Indices, offset: Indices) -> Indices:
        """Numbers of the cells that are so far away; that of all cells behind a fixed wall, -1 for an absent bond."""
        there, boundary = cells + offset, np.array(self.boundary)
        there = np.where(boundary == PERIODIC, there % self.cells, there)
        outside, found = (there < 0) | (there >= self.cells), np.full(len(cells), len(cells))
        inside = ~outside.any(axis=1)
        found[inside] = np.ravel_multi_index(tuple(there[inside].T), self.cells)
        found[(outside & (boundary == FREE)).any(axis=1)] = -1
        return found


def listed(name: str, given: object, kind: type[Kind], accepted: str) -> tuple[Kind, ...]:
    """The entries of a list, all of one kind; raises TypeError for anything else."""
    entries = tuple(given) if isinstance(given, list | tuple) else None
    if entries is None or not all(isinstance(entry, kind) and not isinstance(entry, bool) for entry in entries):
        raise TypeError(f"{name}: given {short_repr(given)}; accepted: {accepted}")
    return entries


def read_formula(place: str, text: object, known: Sequence[str]) -> Formula:
    """A formula in known names; raises ValueError that begins with the place."""
    if isinstance(text, int | float) and not isinstance(text, bool):
        text = repr(number(place, text))
    if not isinstance(text, str):
        raise TypeError(f"{place}: given {short_repr(text)}; accepted: a formula in quotes, or a number")
    try:
        formula = parse_formula(text)
        formula.check_names(known)
    except FormulaError as error:
        raise ValueError(f"{place}: {error}") from None
    return formula
