"""Equations of motion of a declared lattice, in CasADi symbols, and the properties that these have.

Gauge, energy, momentum, oddness and mirrors are checked at random points.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.lattice.declaration import CELL_INDICES, Array, Declaration, Indices, Links, read_formula
from casadi_skin.model.expressions import antiderivative, expression
from casadi_skin.model.formula import Name, Operation, Tree
from casadi_skin.model.polynomial import NotPolynomialError, homogeneous_parts
from casadi_skin.zero.model_coordinates import tree_of


class Equations:
    """The equations of motion of a declared lattice, in CasADi symbols: formulas of all cells at once, as columns."""

    def __init__(self, declaration: Declaration) -> None:
        self.declaration = declaration
        self.cells, self.links = declaration.all_cells(), declaration.links
        places = [
            "_".join([*([site.name] if len(declaration.sites) > 1 else []), *(str(k + 1) for k in cell)])
            for cell in self.cells.tolist()
            for site in declaration.sites
        ]
        self.y, self.v = (ca.vertcat(*(ca.SX.sym(f"{x}_{place}") for place in places)) for x in "yv")
        self.t = ca.SX.sym("t")
        self.parameters = ca.vertcat(*(ca.SX.sym(name) for name in declaration.scalars))
        self.parameters = self.parameters if declaration.scalars else ca.SX(0, 1)
        self.nominal = tuple(declaration.scalars.values())
        self.wall = declaration.size  # the index of walls among the ends of links
        self.symbols = dict(zip(declaration.scalars, ca.vertsplit(self.parameters), strict=True))
        self._check_at_rest()

    # Formulas at cells ------------------------------------------------------------------------------------------------

    def values(self, cells: Indices) -> dict[str, ca.SX]:
        """Values of parameters and indices in some cells: a column, or one value where it is the same in all."""
        values = dict(self.symbols) | {
            name: ca.SX(ca.DM(k + 1.0)) for name, k in zip(CELL_INDICES, cells.T, strict=False)
        }
        for name, value in self.declaration.by_cell.items():
            if isinstance(value, np.ndarray):  # of numbers, or of names of parameters
                entries = value[tuple(cells.T)].tolist()
                named = value.dtype == object
                values[name] = ca.vertcat(*(self.symbols[e] for e in entries)) if named else ca.SX(ca.DM(entries))
            else:
                values[name] = expression(value, values)
        return values

    def at(self, kind: str, number: int, field: str, cells: Indices, **variables: ca.SX) -> ca.SX:
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
    def ends(self) -> Indices:
        """Indices of the starts and ends of all links, bond by bond, shape (links, 2)."""
        return np.concatenate([np.empty((0, 2), np.int64), *(np.stack(links[1:], axis=1) for links in self.links)])

    @cached_property
    def inner(self) -> Indices:
        """Places among these of the links between two sites."""
        return np.flatnonzero(self.ends.max(axis=1, initial=0) < self.wall)

    def extensions(self, links: Links) -> ca.SX:
        """d = y_end - y_start, with 0 at a wall, a column."""
        positions = ca.vertcat(self.y, 0)
        return positions[links.end.tolist()] - positions[links.start.tolist()]

    @cached_property
    def gains(self) -> list[tuple[ca.SX, ca.SX]]:
        """Of each bond columns of the gains at the starts and at the ends of its links."""
        return [
            (self.at("bond", b, "gain 1", links.cells), self.at("bond", b, "gain 2", links.cells))
            for b, links in enumerate(self.links)
        ]

    @property
    def all_gains(self) -> ca.SX:
        """The gains of all links, shape (links, 2)."""
        return ca.vertcat(ca.SX(0, 2), *(ca.horzcat(*pair) for pair in self.gains))

    # The whole lattice ------------------------------------------------------------------------------------------------

    @cached_property
    def masses(self) -> ca.SX:
        """Mass of every site, a column."""
        return self.of_sites("mass")

    @cached_property
    def accelerations(self) -> ca.SX:
        """y'' of every site."""
        onsite, damping, drive = (self.of_sites(field) for field in ("onsite", "damping", "drive"))
        forces = ca.vertcat(drive - onsite - damping * self.v, 0)  # the last is that on the walls
        for b, links in enumerate(self.links):
            force = self.at("bond", b, "force", links.cells, d=self.extensions(links))
            for ends, gain in zip((links.end, links.start), (-self.gains[b][1], self.gains[b][0]), strict=True):
                forces[ends.tolist()] += gain * force
        return forces[:-1] / self.masses

    @cached_property
    def damped(self) -> bool:
        """Whether velocities enter the forces."""
        return bool(ca.depends_on(self.accelerations, self.v))

    @cached_property
    def driven(self) -> bool:
        """Whether time enters the forces by itself."""
        return bool(ca.depends_on(self.accelerations, self.t))

    @property
    def reversible(self) -> bool:
        """Whether time may be reversed: there is neither damping nor drive."""
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


# Properties of a lattice, checked at random points --------------------------------------------------------------------

SAME_VALUE_RTOL = 1e-12  # relative difference of values that are the same but for rounding, per site
RANDOM_POINTS = 3  # random points
RANDOM_AMPLITUDES = (1.0, 0.1, 0.01)  # of random positions: the first at which all forces are finite
# Relative change of parameters at random points: a property of the declared values alone is not declared.
PARAMETER_SPREAD = 0.1
DEEPEST_GAIN = 50  # operations on operations in gains that are compared
# Logarithm of a weight of the energy that is still a double when squared displacements multiply it.
LARGEST_LOG_WEIGHT = 600.0


def _is_zero(array: Array, beside: Array, count: int = 1) -> bool:
    """Whether the largest entry is rounding beside that of another array; false where one is not finite."""
    return bool(np.max(np.abs(array), initial=0.0) <= SAME_VALUE_RTOL * count * np.max(np.abs(beside), initial=0.0))


@dataclass(frozen=True)
class Trial:
    """Random parameters, their gains and masses, and a random state with unit sizes."""

    parameters: Array
    gains: Array
    masses: Array
    y: Array
    v: Array
    t: float
    field: ca.Function

    def accelerations(self, y: Array, v: Array) -> Array:
        """Accelerations in another state at the same time and parameters, shape (sites,)."""
        return np.array(self.field(y, v, self.t, self.parameters)).ravel()

    def is_odd(self, driven: bool) -> bool:
        """Whether the forces beside the drive change their sign with the state."""
        rest = self.accelerations(0.0 * self.y, 0.0 * self.v) if driven else 0.0
        there, back = (self.accelerations(sign * self.y, sign * self.v) - rest for sign in (1.0, -1.0))
        return _is_zero(there + back, there)

    def keeps_momentum(self) -> bool:
        """Whether the weighted forces add up to zero; in a lattice without gauge envelope."""
        forces = self.masses * self.accelerations(self.y, self.v)
        alike = np.array_equal(self.gains[:, 0], self.gains[:, 1])
        return alike and bool(abs(forces.sum()) <= SAME_VALUE_RTOL * np.sum(np.abs(forces)))

    def is_mirrored(self, order: Indices) -> bool:
        """Whether the lattice is the same with its sites in another order."""
        there, image = self.accelerations(self.y, self.v), self.accelerations(self.y[order], self.v[order])
        return _is_zero(image - there[order], there)


# Values that are not finite hold nowhere.
quietly = np.errstate(invalid="ignore", over="ignore", divide="ignore")


class Structure(Equations):
    """The equations of motion with their properties, checked at random states and parameters near the declared ones.

    Weights c_i > 0 with c_i gain_i = c_j gain_j on every bond, the smallest 1 in each connected part, are its gauge: in
    positions scaled by their square roots the forces are a gradient.
    """

    @cached_property
    def trials(self) -> list[Trial]:
        """The declared parameters, then others near them."""
        generator, nominal = np.random.default_rng(0), np.array(self.nominal)
        spread = np.array([PARAMETER_SPREAD if name.isidentifier() else 0.0 for name in self.symbols])  # numbers stay
        evaluate = ca.Function("f", [self.parameters], [ca.densify(self.all_gains), self.masses])
        field = ca.Function("a", [self.y, self.v, self.t, self.parameters], [ca.densify(self.accelerations)])
        trials = []
        for k in range(RANDOM_POINTS):
            parameters = nominal * (1.0 + (spread * generator.uniform(-1, 1, nominal.size) if k else 0.0))
            gains, masses = map(np.array, evaluate(parameters))
            y, v = (generator.normal(size=self.y.numel()) for _ in "yv")
            t = generator.normal()
            for amplitude in RANDOM_AMPLITUDES:
                trial = Trial(parameters, gains, masses.ravel(), amplitude * y, v, t, field)
                if np.all(np.isfinite(trial.accelerations(trial.y, v))):
                    break
            trials.append(trial)
        return trials

    # Weights with which the forces are a gradient, and the energy that these give -------------------------------------

    @property
    def log_weights(self) -> Array | None:
        """Logarithms of the weights at the declared values, shape (sites,); None where gains of a loop disagree."""
        return None if self._weights is None else self._weights[0]

    @cached_property
    @quietly
    def _weights(self) -> tuple[Array, list[ca.SX]] | None:
        """The same, and the weights as expressions."""
        ends, gains = self.ends[self.inner], self.all_gains[self.inner.tolist(), :]
        tree = list(tree_of(self.wall, ends.tolist(), range(self.wall)))
        for trial in reversed(self.trials):  # the declared parameters are the last
            rates, logs = np.log(trial.gains[self.inner, 0] / trial.gains[self.inner, 1]), np.zeros(self.wall)
            for k, here, there, forwards in tree:  # c_end / c_start
                logs[there] = logs[here] + rates[k] if forwards else logs[here] - rates[k]
            off = np.abs(np.diff(logs[ends])[:, 0] - rates)
            if not np.all(off <= SAME_VALUE_RTOL * self.wall):
                return None
        firsts, expressions = np.argsort(logs, kind="stable"), [ca.SX(1)] * self.wall  # of each part the least is first
        for k, here, there, forwards in tree_of(self.wall, ends.tolist(), firsts.tolist()):
            first, second = ca.horzsplit(gains[k, :])
            alike = ca.is_equal(first, second, DEEPEST_GAIN)
            ratio = 1 if alike else first / second if forwards else second / first
            expressions[there] = expressions[here] * ratio
        (values,) = self.at_nominal(ca.log(ca.vertcat(*expressions)))
        return values, expressions

    @cached_property
    def energies(self) -> ca.SX | None:
        """Kinetic and onsite energy of every site and half of that of its bonds, a column; None for unknown potentials.

        A bond to a wall belongs to its one site. Weights are those of the gauge; without one, or where doubles do not
        hold them, they are 1, and a bond has the mean of its gains.
        """
        weights = self._weights if self._has_weights else None
        declaration, kinds = self.declaration, {"onsite": "y", "force": "d"}
        potentials: dict[tuple[str, int, str], ca.Function] = {}
        for key, formula in declaration.formulas.items():
            if key[2] in kinds:
                potentials[key] = antiderivative(formula, kinds[key[2]])
                if potentials[key] is None:
                    return None

        def potential(key: tuple[str, int, str], cells: Indices, at: ca.SX) -> ca.SX:
            values, name = self.values(cells), kinds[key[2]]
            others = [values[other] for other in declaration.formulas[key].names if other != name]
            rows = [at.T, *(ca.repmat(other, 1, len(cells)) if other.numel() == 1 else other.T for other in others)]
            return potentials[key](*rows).T

        sites, wall = len(declaration.sites), declaration.size
        c = ca.vertcat(*weights[1], 1) if weights else ca.SX.ones(wall + 1)
        energies = ca.vertcat(c[:-1] * self.masses * self.v**2 / 2, 0)  # the last is that of the walls
        for s in range(sites):
            at = list(range(s, wall, sites))
            energies[at] += c[at] * potential(("site", s, "onsite"), self.cells, self.y[at])
        for b, links in enumerate(self.links):
            energy, gains = potential(("bond", b, "force"), links.cells, self.extensions(links)), self.gains[b]
            inner = ca.DM(np.maximum(links.start, links.end) < wall)
            mean = (gains[0] + gains[1]) / 2
            for ends, gain in zip(links[1:], gains, strict=True):
                strength = gain if weights else ca.if_else(inner, mean, gain)
                energies[ends.tolist()] += c[ends.tolist()] * strength * energy * (1 - inner / 2)
        return energies[:-1]

    @property
    def _has_weights(self) -> bool:
        """Whether there are weights, and doubles hold them."""
        return self.log_weights is not None and bool(np.max(self.log_weights, initial=0.0) <= LARGEST_LOG_WEIGHT)

    @cached_property
    @quietly
    def energy(self) -> ca.SX | None:
        """The sum of `energies` in the gauge; None where it is not conserved, or a force has no known antiderivative.

        It is conserved where it keeps its value, at random states of the gauge, to rounding of its own terms.
        """
        if not (self._has_weights and self.reversible) or self.energies is None:
            return None
        energy, scale = ca.sum1(self.energies), np.exp(-0.5 * np.asarray(self.log_weights))
        slope = ca.densify(ca.gradient(energy, ca.vertcat(self.y, self.v)))
        change = slope * ca.vertcat(self.v, self.accelerations)
        rate = ca.Function("rate", [self.y, self.v, self.parameters], [change])
        for trial in self.trials:
            terms = np.array(rate(scale * trial.y, scale * trial.v, trial.parameters))
            if not abs(terms.sum()) <= SAME_VALUE_RTOL * terms.size * np.sum(np.abs(terms)):
                return None
        return energy

    # Symmetries -------------------------------------------------------------------------------------------------------

    @cached_property
    @quietly
    def odd(self) -> bool:
        """Whether the forces change sign with the positions."""
        return all(trial.is_odd(self.driven) for trial in self.trials)

    @cached_property
    @quietly
    def momentum(self) -> bool:
        """Whether the sum of c mass v is conserved."""
        return self.hamiltonian and all(trial.keeps_momentum() for trial in self.trials)

    @cached_property
    @quietly
    def mirrors(self) -> tuple[int, ...]:
        """Directions, from 1, along which the mirrored lattice is the same, the sites of a cell in reversed order."""
        d = self.declaration
        numbers = np.arange(d.size).reshape(*d.cells, len(d.sites))
        orders = [np.flip(np.flip(numbers, axis=k), axis=-1).ravel() for k in range(len(d.cells))]
        return tuple(k for k, order in enumerate(orders, start=1) if all(t.is_mirrored(order) for t in self.trials))

    @cached_property
    def polynomial(self) -> bool:
        """Whether all forces are polynomials of positions and velocities."""
        at = ca.vertcat(self.parameters, self.t), ca.vertcat(ca.DM(self.nominal), 0)
        try:
            homogeneous_parts(ca.substitute(self.accelerations, *at), ca.vertcat(self.y, self.v))
        except (NotPolynomialError, ValueError):
            return False
        return True

    @property
    def hamiltonian(self) -> bool:
        """Whether the flow is Hamiltonian in scaled positions."""
        return self.log_weights is not None and self.reversible

    def lines(self) -> list[tuple[str, str]]:
        """Pairs (subject, words) for people."""
        return [
            ("gauge", self._gauge()),
            ("flow", self._flow()),
            ("forces", f"{'polynomial' if self.polynomial else 'not polynomial'}, {'odd' if self.odd else 'not odd'}"),
            ("conserved", self._conserved()),
            ("mirrors", f"along direction {' and '.join(map(str, self.mirrors))}" if self.mirrors else "none"),
        ]

    def _gauge(self) -> str:
        if self.log_weights is None:
            return "none: the gains around a loop of bonds do not agree; digits may be lost where bonds lean one way"
        span = 0.5 * float(np.max(self.log_weights))
        return "none needed: bonds act alike both ways" if span == 0 else (
            f"a diagonal one; displacements lean by a factor of up to {np.exp(min(span, 700.0)):.3g}")  # fmt: skip

    def _flow(self) -> str:
        if not self.reversible:
            return " and ".join(w for w, holds in (("damped", self.damped), ("driven", self.driven)) if holds)
        if self.hamiltonian:
            return "Hamiltonian and reversible"
        return "reversible, and Hamiltonian in no diagonal gauge: multipliers have no Krein signatures"

    def _conserved(self) -> str:
        found = ["energy"] if self.energy is not None else []
        if self.hamiltonian and self.energy is None:
            found.append("an energy that is not written, for a force has no antiderivative that is known")
        return ", ".join([*found, *(["momentum"] if self.momentum else [])]) or "nothing that is known"
