"""Models M x' = f(t, x, p) whose constant mass matrix M may be singular, as differential equations that keep what is
algebraic in them.

Rows of M x' = f are combined until those without derivatives stand alone, 0 = g(t, x, p). Each of these is replaced by
(d/dt + k) g = 0. Then E(x) x' = b with

    E = [E1; g_x],    b = [f1; -g_t - k g],

and where E is singular still, as in mechanics whose constraints are of positions, what is algebraic there is replaced
in the same way (Gear 1988; Baumgarte 1972). As every g decays like exp(-k t), equilibria and periodic orbits are those
of M x' = f. Eigenvalues are its finite ones, of changes that keep g = 0, and -k once for each equation replaced.
(CasADi's `dae_reduce_index` sees where derivatives stand alone, not that rows of M depend on each other, and adds
states.)

Shapes: n states, of which q conditions g leave n - q free; E (n, n), slopes of the conditions (q, n).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.equations import Array, Equations

PASSES = 3  # of scaling
STATE_SIZES = 10.0 ** np.array(sorted(np.linspace(-4.0, 4.0, 25), key=abs))  # where entries of M and df/dx are compared
NEAR_RATIO = 3.0  # of entries and what is usual: as near as at the best place, and the first of such places is taken
CANCELLED_RTOL = 1e-12  # of the terms of a sum: what is left of them is zero
ROUNDED_RTOL = 1e-13  # of the largest entry of a row, by usual sizes of columns: one that is zero but for rounding
NEWTON_STEPS, CONSISTENT_RTOL = 30, 1e-12  # of a state that meets conditions, and its last step, of the state's size


@dataclass
class Rows:
    """Equations E x' = b, with the values of E at a place in general position; all others of its entries vanish.

    An entry is `plain` that is a number, or an expression in parameters: it may be divided by. `columns` are usual
    sizes of entries in each column, which the units of states decide, and `rate` is one of the equations in 1/time.
    """

    model: Equations
    place: tuple[float, Array, Array]
    entries: list[dict[int, ca.SX]]
    right: list[ca.SX]
    values: Array
    plain: NDArray[np.bool_]
    replaced: NDArray[np.bool_]
    columns: Array
    rate: float

    @classmethod
    def of(cls, model: Equations, mass: ca.SX, right: ca.SX) -> Rows:
        """M x' = f."""
        n, (place, columns, rate) = mass.shape[0], _place(model, mass, right, model.nominal)
        values, plain, replaced = np.zeros((n, n)), np.zeros((n, n), dtype=bool), np.zeros(n, dtype=bool)
        rows = cls(model, place, [{} for _ in range(n)], right.elements(), values, plain, replaced, columns, rate)
        for i in range(n):
            rows.put(i, mass[i, :], rows.right[i])
        return rows

    def put(self, i: int, slope: ca.SX, right: ca.SX) -> None:
        """Write the row of an equation."""
        values = np.array(ca.densify(self.model.function("row", slope)(*self.place))).ravel()
        sizes = np.abs(values) / self.columns
        self.values[i] = np.where(sizes > ROUNDED_RTOL * np.max(sizes), values, 0.0)
        self.entries[i] = {j: slope[j] for j in np.flatnonzero(self.values[i]).tolist()}
        moving = ca.vertcat(self.model.state, *([] if self.model.time is None else [self.model.time]))
        self.plain[i] = [j not in self.entries[i] or not ca.depends_on(slope[j], moving) for j in range(values.size)]
        self.right[i] = right

    def eliminated(self, plain: bool, written: bool = True) -> tuple[list[tuple[int, int]], list[int], Rows]:
        """Pivots (row, column), rows without one, and rows after elimination; by plain pivots alone, or by all.

        A row is multiplied by a pivot that moves, as it may vanish elsewhere. Values alone, unless it is `written`.
        """
        copies = [dict(row) for row in self.entries], [*self.right], self.values.copy(), self.plain.copy()
        found = Rows(self.model, self.place, *copies, self.replaced, self.columns, self.rate)
        sizes, pivots, left = np.abs(self.values), list[tuple[int, int]](), list(range(len(self.right)))
        while True:
            values = np.abs(found.values[left]) / self.columns
            shares = values / np.maximum(np.max(values, axis=1, keepdims=True, initial=0.0), 1e-300)
            shares += np.where(found.plain[left], 4.0, 0.0) + np.where(self.replaced[left], 0.0, 2.0)[:, None]
            shares[(values == 0.0) | (plain & ~found.plain[left])] = 0.0
            if not np.any(shares):
                return pivots, left, found
            place, c = np.unravel_index(np.argmax(shares), shares.shape)
            r = left.pop(int(place))
            pivots.append((r, int(c)))
            for i in left:
                if found.values[i, c]:
                    found._subtract(i, r, int(c), sizes, written)

    def _subtract(self, i: int, r: int, c: int, sizes: Array, written: bool) -> None:
        """Take a multiple of the row of a pivot from another row, whose entry there vanishes."""
        plain, pivot, factor = self.plain[r, c], self.values[r, c], self.values[i, c] / self.values[r, c]
        if written:
            own, other = self.entries[i], self.entries[r]
            keep, take = (ca.SX(1.0) if plain else other[c] / pivot), own.pop(c) / (other[c] if plain else pivot)
            self.entries[i] = {j: keep * own.get(j, 0.0) - take * other.get(j, 0.0) for j in {*own, *other} - {c}}
            self.right[i] = keep * self.right[i] - take * self.right[r]
        sizes[i] += abs(factor) * sizes[r]
        self.values[i] -= factor * self.values[r]
        self.values[i, np.abs(self.values[i]) <= CANCELLED_RTOL * sizes[i]] = 0.0
        self.values[i, c] = 0.0
        mixed = self.values[r] != 0.0
        self.plain[i] &= plain & (~mixed | (self.plain[i, c] & self.plain[r]))
        if written:
            self.entries[i] = {j: value for j, value in self.entries[i].items() if self.values[i, j]}

    def solved(self) -> ca.SX:
        """x', of a regular E: by plain pivots first, and what is left at once."""
        pivots, left, rows = self.eliminated(plain=True)
        n, rates = len(self.right), dict[int, Any]()
        others = sorted(set(range(n)) - {c for _, c in pivots})
        if left:
            matrix = ca.vertcat(*(ca.horzcat(*(rows.entries[i].get(j, ca.SX(1, 1)) for j in others)) for i in left))
            rates |= zip(others, ca.solve(matrix, ca.vertcat(*(rows.right[i] for i in left))).elements(), strict=True)
        for r, c in reversed(pivots):
            known = sum((value * rates[j] for j, value in rows.entries[r].items() if j != c), ca.SX(0.0))
            rates[c] = (rows.right[r] - known) / rows.entries[r][c]
        return ca.cse(ca.densify(ca.vertcat(*(rates[j] for j in range(n)))))


def _place(model: Equations, mass: ca.SX, right: ca.SX, usual: Any) -> tuple[tuple[float, Array, Array], Array, float]:
    """A place (time, state, parameters near usual ones), sizes c of entries in columns there, and a rate k.

    |M_ij| ~ r_i c_j and |df_i/dx_j| ~ k r_i c_j, by least squares of logarithms (Curtis and Reid 1972). At the place
    entries are near that: at others exponentials, as of a diode's voltage, hide other terms, are hidden, or overflow.
    """
    n, generator = model.size, np.random.default_rng(0)
    time, x, p = (generator.uniform(0.5, 1.5, size=count) for count in (1, n, model.parameters.numel()))
    p *= 1.0 if usual is None else np.where(usual, usual, 1.0)
    matrices = ca.sparsify(mass), ca.jacobian(right, model.state)
    function = model.function("entries", ca.vertcat(*(each.nz[:] for each in matrices), ca.densify(right)))
    i, j = np.hstack([each.sparsity().get_triplet() for each in matrices]).astype(int)
    kind = np.repeat([0, 1], [each.nnz() for each in matrices])
    for _ in range(PASSES):  # the units of states that one finds are those of the next one's states
        places = [(float(time[0]), size * x, p) for size in STATE_SIZES]
        entries = np.abs([np.array(function(*place)).ravel() for place in places])
        finite = np.flatnonzero(np.all(np.isfinite(entries), axis=1))
        if not finite.size:
            raise ValueError(f"{model.name}: rhs: given derivatives that are not finite at states near 1 or near 0")
        known = np.flatnonzero(np.all(entries[finite, : kind.size] > 0.0, axis=0))
        logs = np.log(entries[np.ix_(finite, known)]).T
        design = np.hstack([np.eye(n)[i[known]], np.eye(n)[j[known]], kind[known, None]])
        least = np.diag(np.repeat([1e-10, 1e-6, 1e-10], [n, n, 1]))  # columns are 1 where rows can be their sizes
        fitted = np.linalg.solve(design.T @ design + least, design.T @ logs)
        off = np.max(np.abs(logs - design @ fitted), axis=0, initial=0.0)
        best = int(np.argmax(off <= np.min(off) + np.log(NEAR_RATIO)))
        columns, rate = np.exp(fitted[n : 2 * n, best]), float(np.exp(fitted[-1, best]))
        x = generator.uniform(0.5, 1.5, size=n) / columns
    return places[finite[best]], columns, rate


@dataclass(frozen=True, eq=False)
class Implicit:
    """A model M x' = f and what stands for it.

    Attributes:
        model: names and symbols.
        right: f.
        rates: k of each condition.
        conditions: g in the order in which they were found, all that a consistent state meets.
        rows: E and b, with the last of the conditions.
        latest: the last condition of each row that was replaced.
        rhs: E^-1 b.
    """

    model: Equations
    right: ca.SX
    rates: Array
    conditions: list[ca.SX]
    rows: Rows
    latest: dict[int, ca.SX]
    rhs: ca.SX

    @classmethod
    def of(cls, model: Equations, mass: ca.SX) -> Implicit:
        """From a model whose right-hand side is f; raises ValueError, naming an entry, where x' is not determined."""
        rows, n, conditions, rates = Rows.of(model, mass, model.rhs), model.size, list[ca.SX](), list[float]()
        latest, decay = dict[int, ca.SX](), model.decay or rows.rate
        if not np.any(rows.values):
            raise ValueError(f"{model.name}: mass: given one without entries; accepted: one of rank 1 or more")
        while rows.eliminated(plain=False, written=False)[1]:
            _, left, reduced = rows.eliminated(plain=False)
            for i in left:
                g = reduced.right[i]
                if len(conditions) == n - 1 or not ca.depends_on(g, model.state):
                    raise ValueError(_undetermined(model, i, len(conditions) == n - 1))
                rates.append(decay * (1.0 + len(conditions) / n))  # apart: eigenvalues are simple
                by_time = ca.SX(0.0) if model.time is None else ca.gradient(g, model.time)
                rows.put(i, ca.jacobian(g, model.state), -by_time - ca.SX(rates[-1]) * g)
                conditions.append(g)
                latest[i] = g
                rows.replaced[i] = True
        if conditions and model.reversal is not None:
            why = "given with a singular mass, whose algebraic equations are met as time goes on alone"
            raise ValueError(f"{model.name}: reversal: {why}; accepted: a hamiltonian, or conserved quantities")
        return cls(model, model.rhs, np.array(rates), conditions, rows, latest, rows.solved())

    @cached_property
    def _conditions(self) -> ca.Function:
        """Function (t, x, p) -> g, their slopes (q, n), and rows E1 that have been left."""
        g = ca.vertcat(ca.SX(0, 1), *self.conditions)
        return self.model.function("conditions", *map(ca.densify, (g, ca.jacobian(g, self.model.state), self._kept)))

    @property
    def _kept(self) -> ca.SX:
        """Rows E1 (n - replaced, n)."""
        n, kept = self.model.size, [i for i in range(self.model.size) if i not in self.latest]
        rows = [[self.rows.entries[i].get(j, ca.SX(0.0)) for j in range(n)] for i in kept]
        return ca.vertcat(ca.SX(0, n), *(ca.horzcat(*row) for row in rows))

    def consistent(self, time: float, state: Array, parameters: Array) -> Array:
        """The state that meets the conditions near another one, with E1 x as it is where that can be.

        Raises ArithmeticError where Newton's method does not come to one.
        """
        x: Array = np.array(state, dtype=float)
        moved = np.inf
        size = np.maximum(np.abs(x), float(np.max(np.abs(x))) or 1.0)
        for _ in range(NEWTON_STEPS):
            g, slope, kept = (np.array(part) for part in self._conditions(time, x, parameters))
            if not g.size or not np.all(np.isfinite(slope)):
                break
            step = -np.linalg.lstsq(slope * size, g.ravel(), rcond=None)[0]
            free = complement(slope * size)
            step -= free @ np.linalg.lstsq(kept * size @ free, kept * size @ step, rcond=None)[0]
            x, before, moved = x + size * step, moved, float(np.max(np.abs(step)))
            if moved <= CONSISTENT_RTOL or (moved <= CONSISTENT_RTOL**0.5 and moved >= 0.5 * before):  # rounding
                return x
        if not self.conditions:
            return x
        raise ArithmeticError(f"{self.model.name}: no state that meets its algebraic equations is found near the start")

    def frames(self, times: Array, states: Array, parameters: Array, units: Array) -> Array:
        """Orthonormal directions y = x/units in which the conditions do not change, shape (times, n, n - q)."""
        slopes = (np.array(self._conditions(t, x, parameters)[1]) for t, x in zip(times, states, strict=True))
        return np.stack([complement(slope * units) for slope in slopes])

    def among_free(self, x: Array, parameters: Array, units: Array) -> Callable[[Array], Array]:
        """What makes of a matrix of derivatives at rest that of changes in these directions."""
        (frame,) = self.frames(np.zeros(1), x[None], parameters, units)
        return lambda matrix: np.asarray(frame.T @ (matrix * units / units[:, None]) @ frame)

    def rate(self, parameters: Array) -> float:
        """A rate of the equations at values of parameters, in 1/time."""
        return _place(self.model, self.model.mass, self.right, parameters)[2]

    def semi_explicit(self, time: float, start: Array, parameters: Array) -> tuple[dict[str, Any], Array]:
        """w' = f1, 0 = g as CasADi's integrators take them, and B, shape (n, n), where (w, z) = B x.

        w is E1 x, each row over its length, and g are over the length of their slopes at the start: IDAS takes rows
        that are small by their unit for singular.
        """
        g = ca.vertcat(*self.latest.values())
        slope = self.model.function("slope", ca.densify(ca.jacobian(g, self.model.state)))
        lengths = np.linalg.norm(np.array(slope(time, start, parameters)), axis=1)
        t, x, p = ca.SX.sym("t"), ca.SX.sym("x", self.model.size), ca.SX.sym("p", parameters.size)
        _, _, kept = self._conditions(0.0, np.zeros(self.model.size), parameters)
        sizes = np.linalg.norm(kept := np.array(kept), axis=1)
        matrix = np.vstack([kept / sizes[:, None], complement(kept).T])
        differential = [self.rows.right[i] for i in range(x.numel()) if i not in self.latest]
        differential = [right / size for right, size in zip(differential, sizes.tolist(), strict=True)]
        g /= np.where(lengths > 0.0, lengths, 1.0)
        f = self.model.function("parts", ca.vertcat(ca.SX(0, 1), *differential), g)
        w, z = ca.SX.sym("w", len(differential)), ca.SX.sym("z", len(self.latest))
        ode, algebraic = f(t, ca.DM(np.linalg.inv(matrix)) @ ca.vertcat(w, z), p)
        return {"t": t, "x": w, "z": z, "p": p, "ode": ode, "alg": algebraic}, matrix


def complement(rows: Array) -> Array:
    """Orthonormal columns to which so many rows are orthogonal, each measured by its own length; (n, n - rows)."""
    sizes = np.linalg.norm(rows, axis=1, keepdims=True)
    right = np.linalg.svd(rows / np.where(sizes > 0.0, sizes, 1.0))[2] if len(rows) else np.eye(rows.shape[1])
    return np.asarray(right[len(rows) :].T)


def _undetermined(model: Equations, row: int, never: bool) -> str:
    """Why derivatives do not follow from the equations, in words."""
    why = "leaves nothing that moves" if never else "repeats others or says nothing of the states"
    given = f"{model.name}: mass: given one with which entry {row + 1} of rhs, beside {model.state_names[row]}, {why}"
    return f"{given}; accepted: equations that determine the motion of every state"


def mass_matrix(given: Any, parameters: ca.SX, size: int) -> ca.SX:
    """A mass matrix as given, in CasADi's expressions; raises TypeError and ValueError for others."""
    accepted = f"{size} x {size} finite numbers, or expressions in parameters"
    try:
        rows = (
            given if isinstance(given, ca.SX | ca.DM | np.ndarray) else ca.vertcat(*(ca.horzcat(*row) for row in given))
        )
        matrix = ca.densify(ca.SX(rows))
    except (TypeError, ValueError, NotImplementedError, RuntimeError):
        raise TypeError(f"mass: given {type(given).__name__} that is no matrix; accepted: {accepted}") from None
    if matrix.shape != (size, size):
        raise ValueError(f"mass: given shape {matrix.shape}; accepted: {accepted}, a row for each equation")
    for place, entry in enumerate(matrix.elements()):
        symbols = [] if entry.is_constant() else ca.symvar(entry)
        strange = [symbol for symbol in symbols if not ca.depends_on(parameters, symbol)]
        if strange or (entry.is_constant() and not np.isfinite(float(entry))):
            at = f"row {place % size + 1}, column {place // size + 1}"
            raise ValueError(f"mass: given {(strange or [entry])[0]} in {at}; accepted: {accepted}")
    return matrix
