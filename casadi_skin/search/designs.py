"""Designs: parameters at which a quantity of located solutions is best, by SLSQP on gradients of these.

    minimise f(p, x_1(p), ..., x_m(p))  over p within bounds,  c_low <= c(p, x_1(p), ..., x_m(p)) <= c_high,

where x_i(p) are quantities of special points, orbits and equilibria that are located again at every p, by continuation
from the nearest known design. Their derivatives by p are those of the equations that they solve, no differences; f and
c are CasADi expressions in p and x. SLSQP: Kraft (1988), by scipy, in variables scaled by their ranges. Its end
is an optimum where the conditions of Karush, Kuhn and Tucker hold, with multipliers by non-negative least squares.
Where constraints cannot be met, it is the design with the least sum of squares of violations over their `heights`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.model.arguments import function_of, number_within, truth
from casadi_skin.model.result import in_turn
from casadi_skin.search.design import FEASIBLE, Design, Ending, best_of, optimum_words
from casadi_skin.search.design_problem import DesignProblem, Quantity, Rows
from casadi_skin.search.located import LocatedThing
from casadi_skin.solve.processes import Report, SearchProgress
from casadi_skin.solve.watch import check_time_limit
from casadi_skin.zero.problem import EPSILON, Array

MOST_ITERATIONS, MORE_ITERATIONS = 40, 10  # of SLSQP, and as many for each parameter
MOST_RUNS = 3  # of SLSQP, which starts again where it ends at no optimum
MOST_KNOWN = 16  # designs that are kept, of which the nearest is where the next is located from
ACCURACY = 1e-16  # of the scaled objective, at which SLSQP ends by itself; what is sought ends it before
OPTIMAL, SOUGHT = 1e-7, 2e-8  # of the largest scaled gradient: what an optimum may leave, and what is sought
FLAT = 1e-2  # of a constraint's largest gradient and value, below which a gradient does not say what is small
HELD_RTOL, PART_BESIDE = 1e-13, 0.01  # of a value, what it changes by where it is held; of scales, to another design
VALUE_ROUNDING = 4.0 * EPSILON  # of a quantity that is made of a few operations
NEAREST_DESIGNS, LARGEST_PART_ACROSS = 3, 0.3  # from which curvature is estimated; of a way, across active bounds
NEAR_BOUND = 1e-7  # of its range: a number at its bound
RESTORING_STEPS = 2  # of Newton's method on active constraints, from an end of SLSQP
SHORTEST_SHARE = 2.0**-12  # of the way between two designs: the smallest step of the continuation
FAR_OFF, FALLING, PATIENCE = 1e-3, 0.9, 8  # violations above the first that do not fall to this share in so many steps
MOST_LOST = 20  # designs from one start at which not everything is located, before it ends
FAR_WORSE = 1e10  # the scaled objective where not everything is located


@in_turn
def optimise(
    quantity: Quantity,
    of: Any,
    *,
    over: Sequence[str],
    subject_to: Sequence[Any] = (),
    bounds: Mapping[str, Any] | None = None,
    maximise: bool = False,
    starts: int = 1,
    seed: int = 0,
    tolerance: float = 1e-8,
    progress: Report | None = None,
) -> Design:
    """Find parameters at which a quantity of located solutions is best.

    Arguments:
        quantity: a name of what `of` has (of a special point the parameter that it was found in; of an equilibrium or
            an orbit a quantity that `gradient` takes; of an orbit of a family those of `FamilyExpressions`), a formula
            in such names, or a function of them: it gets an object for each of `of`, with quantities as attributes,
            and returns a scalar CasADi expression. Formulas about several name whose each is, "b.r - a.r".
        of: a special point, an orbit or an equilibrium; or several: a list, whose items are a, b, ..., or by name.
        over: names of the parameters that are free; of a family S too, of a chain alpha_n for one stiffness a site.
        subject_to: constraints, each a quantity that is to vanish, or (quantity, lower, upper).
        bounds: (lower, upper) by name, None where there is none: of the parameters, and of quantities.
        maximise: whether the quantity is maximised.
        starts: number of starts: the own parameters first, then a Halton sequence within the bounds; where one is
            missing from half to twice the own value, so that a 0 without bounds stays.
        seed: of that sequence.
        tolerance: relative error of the value by discretisation, of orbits of a family.
        progress: called with a `SearchProgress` at every design.

    Returns:
        The best `Design`. Where none is an optimum it is the last one, which says so in `found` and `reason`. Ctrl-C
        ends the search with the best so far.

    Raises:
        ValueError, TypeError: arguments that are not accepted, before anything is solved.
        ArithmeticError: what is optimised is not located at any start.
    """
    truth("maximise", maximise)
    problem = DesignProblem.of(quantity, of, over, subject_to, bounds, maximise)
    return best_design(problem, problem.places(starts, seed), tolerance, progress, so_far=True)


def best_design(
    problem: DesignProblem, starts: Sequence[Array], tolerance: float, progress: Report | None = None,
    so_far: bool = False,
) -> Design:  # fmt: skip
    """The best design from several starts, after Ctrl-C the best `so_far`; raises ArithmeticError for none at any."""
    number_within("tolerance", tolerance, 1e-12, 1e-2)
    ends, gone = list[Design](), ""
    for number, start in enumerate(starts, start=1):
        search = Search(problem, progress, number, len(starts))
        try:
            ends.append(search.optimum(start, tolerance))
        except KeyboardInterrupt:
            if not so_far or not (ends or search.path):
                raise
            ends += [search.so_far()] if search.path else []
            gone = f"{Ending.INTERRUPTED.value} at start {number} of {len(starts)}"
            break
    if all(end.status is Ending.NOT_LOCATED for end in ends):
        raise ArithmeticError(f"optimise: what is optimised is {ends[0].reason}")
    return best_of(ends, gone)


# The way to an optimum from one start ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Bound:
    """An active bound or constraint, in words, and the normal that points to its inner side, in scaled parameters.

    `row` is that of the constraint, 0 of a parameter, and `gap` how far inside the design is; `side` is -1 of an upper
    bound.
    """

    words: str
    normal: Array
    row: int
    gap: float
    side: float


@dataclass(frozen=True, eq=False)
class Conditions:
    """The conditions of first order: what is `left` of the gradient, violation, and bounds with their weights."""

    left: Array
    optimality: float
    violation: float
    worst: str
    bounds: Sequence[tuple[Bound, float]]


class Sought(Exception):  # noqa: N818
    """Ends SLSQP."""


@dataclass(frozen=True, eq=False)
class Place:
    """What is located at a design p, and objective and constraints there."""

    p: Array
    things: tuple[LocatedThing, ...]
    rows: Rows | None = None


class Search:
    """The designs from one start on."""

    def __init__(self, problem: DesignProblem, progress: Report | None, number: int = 1, starts: int = 1) -> None:
        function_of("progress", progress, "a SearchProgress")
        self.number, self.starts, self.failure = number, starts, ""  # why not all is located at the last p, in words
        self.problem, self.progress, self.sign = problem, progress, -1.0 if problem.maximise else 1.0
        self.known = [Place(np.repeat(problem.values, problem.counts), problem.things)]  # the last one at the end
        self.path, self.values = list[Array](), list[float]()
        self.limits = np.array([row[1:] for row in problem.rows]).reshape(-1, 2).T  # of the constraints
        self.sizes = np.zeros(1 + len(problem.rows))  # of the largest scaled gradients on the way
        self.first = np.empty(0)  # heights at the first design
        self.lost = list[Array]()  # designs at which not everything is located
        self.infeasible = False  # whether the constraints cannot be met near the last end
        self.held = False  # whether the quantity does not change with what is free

    # Designs --------------------------------------------------------------------------------------------------------

    def moved(self, p: Array) -> tuple[LocatedThing, ...] | None:
        """Everything at p, by continuation from the nearest known design, in halved steps where one is too long."""
        near = min(self.known, key=lambda place: float(np.linalg.norm((place.p - p) / self.problem.scales)))
        start, done, share, things = near.p, 0.0, 1.0, near.things
        while done < 1.0 and np.any(p != start):
            check_time_limit(f"design {len(self.path) + 1}")
            ahead = min(1.0, done + share)
            to = p if ahead == 1.0 else start + ahead * (p - start)
            values = dict(zip(self.problem.over, to.tolist(), strict=True))
            moved: Any = tuple(takewhile(lambda thing: thing is not None, (thing.near(values) for thing in things)))
            if len(moved) == len(things):
                done, share, things = ahead, 2.0 * share, moved
                continue
            share *= 0.5
            if share < SHORTEST_SHARE:
                self.known.insert(0, Place(start + done * (p - start), things))  # not to come so far again
                return None
        return things

    def rows(self, p: Array) -> Rows | None:
        """Objective and constraints at p; None where not everything is located there."""
        for k, place in enumerate(self.known):
            if place.rows is not None and np.array_equal(p, place.p):
                self.known.append(self.known.pop(k))
                return place.rows
        if self.lost and np.array_equal(p, self.lost[-1]):
            return None
        things, self.failure = self.moved(p), ""
        self.lost.append(p.copy())  # taken back where it returns rows
        if things is None:
            return None
        try:
            found = rows, slopes = self.problem.evaluated(things)
        except ArithmeticError as error:  # what is located has no derivatives there
            self.failure = f": {error}"
            return None
        finite = np.isfinite(rows) & np.all(np.isfinite(slopes), axis=1)
        if not np.all(finite):
            name = [self.problem.quantity, *(row[0] for row in self.problem.rows)][np.argmin(finite)]
            self.failure = f": {name} or its derivative is no number there"
            return None
        self.lost.pop()
        self.sizes = np.maximum(self.sizes, np.max(np.abs(slopes * self.problem.scales), axis=1))
        self.known = [*self.known[-MOST_KNOWN:], Place(p.copy(), things, found)]
        self.first = self.first if self.first.size else self.heights(found)
        self.path.append(p.copy())
        self.values.append(float(rows[0]))
        if self.progress is not None:
            named = ", ".join(f"{name} = {value:.8g}" for name, value in zip(self.problem.over[:4], p, strict=False))
            where = self.number, self.starts, self.number - 1, len(self.path)
            self.progress(SearchProgress(*where, float(rows[0]), self.conditions(p).violation, named))
        return found

    def so_far(self) -> Design:
        """The best of the known designs."""
        known = [(one.p, one.rows[0][0]) for one in self.known if one.rows is not None]
        ranks = [(max(self.conditions(p).violation, FEASIBLE), self.sign * value) for p, value in known]
        p, _ = known[ranks.index(min(ranks))]
        found = self._optimum(p, self.conditions(p), (np.inf, np.inf), "")
        words = f"{Ending.INTERRUPTED.value}; {len(self.path)} designs"
        return replace(found, status=Ending.INTERRUPTED, reason=words)

    def optimum(self, p: Array, tolerance: float) -> Design:
        """The end of SLSQP, on finer discretisations until it is at the tolerance."""
        while self.rows(p) is not None:
            p, words = self._solved(p)
            conditions, things = self.conditions(p), self.known[-1].things
            error, slope_error = self._errors(conditions)
            finer = [thing.finer for thing in things] if error < np.inf else []
            if error <= tolerance * max(map(abs, self.values)) or all(thing is None for thing in finer):
                self.held = self._is_held(p)
                return self._optimum(p, conditions, (error + self._still_to_gain(conditions), slope_error), words)
            self.known = [Place(p, tuple(two or one for one, two in zip(things, finer, strict=True)))]
        return self._design(p)

    # SLSQP, in x = p/scales, with objective and constraints over the sizes of their gradients -------------------------

    def _solved(self, p: Array) -> tuple[Array, str]:
        """The best end of SLSQP, with its last words; of constraints that cannot be met the design of least violation.

        It starts again from an end that is no optimum, and from the nearest design where constraints are not met.
        """
        ends, words = list[tuple[float, Array, str]](), ""
        if not self.sizes[0]:  # the gradient vanishes at the start: its size is that where constraints are met nearby
            self._on_constraints(p)
        for _ in range(MOST_RUNS):
            if not self.infeasible:
                p, words = self._run(p)
                p = self._on_constraints(p)
            if self.conditions(p).violation > FEASIBLE:
                p, _ = self._run(p, nearest=True)
                restored = self._on_constraints(p)
                p = restored if self.conditions(restored).violation <= FEASIBLE else p
            conditions = self.conditions(p)
            self.infeasible = conditions.violation > FEASIBLE
            ends.append((conditions.optimality, p, words))
            if self.infeasible or conditions.optimality <= SOUGHT:
                break
        _, p, words = ends[-1] if self.infeasible else min(ends, key=lambda end: end[0])
        self.rows(p)
        return p, words

    def _on_constraints(self, p: Array) -> Array:
        """The design nearby where active and violated constraints hold, to rounding where they nearly do."""
        for _ in range(RESTORING_STEPS):
            held = [b for b, weight in self.conditions(p).bounds if b.row and (weight > 0.0 or b.gap < 0.0)]
            if any(bound.gap for bound in held):
                step = np.linalg.lstsq(np.array([b.normal for b in held]), -np.array([b.gap for b in held]))[0]
                moved = np.clip(p + step * self.problem.scales, *self.problem.ends)
                p = moved if self.rows(moved) is not None else p
        return p

    def _run(self, p: Array, nearest: bool = False) -> tuple[Array, str]:
        """Where SLSQP ends, with its last words; or the design `nearest` to the constraints, by their violations."""
        from scipy.optimize import minimize

        first, scales, ends, (lows, highs) = self.rows(p), self.problem.scales, self.problem.ends, self.limits
        assert first is not None
        last, tried, missed, unit = first, p, list[float](), 1.0
        factor, heights = self.sign / (self.sizes[0] or 1.0), self.first if nearest else self.heights(first)

        def at(x: Array) -> tuple[Array, Array, bool]:
            """The rows at x and their derivatives by it, those of the last design where it is not located."""
            nonlocal last
            found = self.rows(np.clip(x * scales, *ends))
            last = last if found is None else found
            return last[0], last[1] * scales, found is not None

        def value(x: Array) -> Any:
            """The objective; or half the sum of squares of violations, over that at the start."""
            rows, slopes, there = at(x)
            if not nearest:
                return factor * (rows[0] - first[0][0]) if there else FAR_WORSE, factor * slopes[0]
            off = (np.maximum(rows[1:] - highs, 0.0) - np.maximum(lows - rows[1:], 0.0)) / heights
            return off @ off / (2.0 * unit) if there else FAR_WORSE, (off / heights) @ slopes[1:] / unit

        def stop(x: Array) -> None:
            """Ends SLSQP where a design that it tries is what is sought, and where violations do not fall."""
            nonlocal tried
            tried = np.clip(x * scales, *ends)
            if len(self.lost) >= MOST_LOST:
                raise Sought
            if nearest or self.rows(tried) is None:
                return
            conditions = self.conditions(tried)
            missed.append(conditions.violation)
            waits = len(missed) > PATIENCE and min(missed[-PATIENCE:]) > max(FALLING * min(missed[:-PATIENCE]), FAR_OFF)
            if waits or (missed[-1] <= FEASIBLE and conditions.optimality <= SOUGHT):
                raise Sought

        unit = value(p / scales)[0] or 1.0 if nearest else 1.0
        equal, constraints, rows = lows == highs, list[dict[str, Any]](), np.arange(1, lows.size + 1)
        for kind, which, bounds, side in (
            ("eq", equal, lows, 1.0), ("ineq", np.isfinite(lows) & ~equal, lows, 1.0),
            ("ineq", np.isfinite(highs) & ~equal, highs, -1.0),
        ):  # fmt: skip
            k, b, c = rows[which], bounds[which], side / heights[which]
            if k.size and not nearest:
                fun: Any = lambda x, k=k, b=b, c=c: c * (at(x)[0][k] - b)  # noqa: E731
                jac: Any = lambda x, k=k, c=c: c[:, None] * at(x)[1][k]  # noqa: E731
                constraints.append({"type": kind, "fun": fun, "jac": jac})
        solve: Any = minimize  # its stub wants arguments of every method
        try:
            result = solve(
                value, p / scales, jac=True, method="SLSQP", bounds=(ends / scales).T, constraints=constraints,
                callback=stop, options={"ftol": ACCURACY, "maxiter": MOST_ITERATIONS + MORE_ITERATIONS * p.size},
            )  # fmt: skip
            end, words = np.clip(result.x * scales, *ends), " ".join(str(result.message).split())
            words = "the value does not change" if result.success else words
        except Sought:
            ended = "not everything is located beyond" if len(self.lost) >= MOST_LOST else "violations do not fall"
            end, words = tried, ended
        return (end if self.rows(end) is not None else self.known[-1].p), words

    # Conditions of optimality ---------------------------------------------------------------------------------------

    def heights(self, found: Rows) -> Array:
        """Sizes of constraints, in which violations are measured: of their scaled gradients, and a part of values."""
        values = np.abs([found[0][1:], *self.limits])
        flat = FLAT * np.maximum(self.sizes[1:], np.max(np.where(np.isfinite(values), values, 0.0), axis=0))
        heights = np.maximum(np.max(np.abs(found[1][1:] * self.problem.scales), axis=1), flat)
        return np.where(heights > 0.0, heights, 1.0)

    def conditions(self, p: Array) -> Conditions:
        """The conditions of Karush, Kuhn and Tucker at a design: gradient = sum of normals times weights >= 0."""
        from scipy.optimize import nnls

        problem, found = self.problem, self.rows(p)
        assert found is not None
        scales, rows, slopes = problem.scales, found[0], found[1] * problem.scales
        active, violation, worst = list[Bound](), 0.0, ""
        names, limits = [*problem.over, *(row[0] for row in problem.rows)], np.hstack([problem.ends, self.limits])
        normals, heights = np.vstack([np.diag(scales), slopes[1:]]), np.append(scales, self.heights(found))
        numbered = zip(names, np.append(p, rows[1:]), normals, heights, *limits, strict=True)
        for row, (name, value, normal, height, *ends) in enumerate(numbered, start=1 - p.size):
            gap = max(ends[0] - value, value - ends[1], 0.0)
            if gap / height > violation:
                violation, worst = gap / height, f"{name} is off by {gap:.3g}"
            for end, side, sign in zip(ends, (1.0, -1.0), (">=", "<="), strict=True):
                if side * (value - end) <= NEAR_BOUND * height:
                    words = f"{name} {'=' if ends[0] == ends[1] else sign} {end:.10g}"
                    active.append(Bound(words, side * normal, max(row, 0), side * (value - end), side))
        left, weights = self.sign * slopes[0], np.zeros(len(active))
        if active:
            normals = np.array([bound.normal for bound in active]).T
            heights = np.maximum(np.linalg.norm(normals, axis=0), 1e-300)
            weights = nnls(normals / heights, left)[0] / heights
            left = left - normals @ weights
        bounds = list(zip(active, weights.tolist(), strict=True))
        return Conditions(left, float(np.max(np.abs(left))) / (self.sizes[0] or 1.0), violation, worst, bounds)

    def _is_held(self, p: Array) -> bool:
        """Whether the quantity does not change with what is free, not even beside p, which may be an optimum."""
        before = len(self.path)
        for side in (1.0, -1.0):
            if self.sizes[0] <= HELD_RTOL * max(map(abs, self.values)):
                self.rows(np.clip(p + side * PART_BESIDE * self.problem.scales, *self.problem.ends))
        self.rows(p)
        return before < len(self.path) and bool(self.sizes[0] <= HELD_RTOL * max(map(abs, self.values)))

    def _still_to_gain(self, conditions: Conditions) -> float:
        """By how much the value may be off that of the optimum, by what is left of the gradient, g.

        From another design, w away, at which the gradient of the Lagrangian along the way is G: g^2/k by the curvature
        k = (G - g)/w, and g w (g/G)^(1/(m - 1)) by |x|^m, m = G w over the fall of the value, where w is far longer
        than what is left. Of the nearest designs along active bounds the largest, twice.
        """
        *others, (p, rows, slopes) = [(one.p, *one.rows) for one in self.known if one.rows is not None]
        weights, left = np.append(self.sign, np.zeros(len(self.problem.rows))), float(np.linalg.norm(conditions.left))
        for bound, weight in conditions.bounds:
            weights[bound.row] -= bound.side * weight * (bound.row > 0)  # bounds of parameters are straight
        normals = np.array([bound.normal for bound, _ in conditions.bounds]).reshape(-1, p.size)
        found = list[tuple[float, float, float]]()
        for one, values, derivatives in others:
            way = (one - p) / self.problem.scales
            length, across = np.linalg.norm(way), np.linalg.norm(np.linalg.lstsq(normals, normals @ way)[0])
            if length > 0.0 and across <= LARGEST_PART_ACROSS * length:
                near, far = (float(weights @ by @ (one - p)) for by in (slopes, derivatives))
                fall, most = float(weights @ (values - rows)), float(left * length)
                power = 1.0 / (max(far / fall, 2.0) - 1.0) if fall > 0.0 else 1.0
                by_curvature = most**2 / (far - near) if far > near else most
                found.append((float(length), by_curvature, most * min(most / far, 1.0) ** power if far > 0.0 else most))
        nearest = sorted(found)[:NEAREST_DESIGNS]
        return 2.0 * max([*(gain for _, gain, _ in nearest), *(gain for *_, gain in nearest[:1])], default=left)

    def _errors(self, conditions: Conditions) -> tuple[float, float]:
        """Estimated errors of the value, also by what bounds and constraints are off by, and of the optimality."""
        try:
            rows, slopes = self.problem.errors(self.known[-1].things)
        except ArithmeticError:  # of the finer ones
            return np.inf, np.inf
        off, own = 0.0 if self.infeasible else 1.0, np.append(0.0, rows[1:])  # bounds of parameters have no errors
        held = sum(weight * (own[b.row] + off * abs(b.gap)) for b, weight in conditions.bounds)
        left = float(np.max(slopes[0] * self.problem.scales)) / (self.sizes[0] or 1.0)
        return float(rows[0] + held + VALUE_ROUNDING * abs(self.values[-1])), left

    def _optimum(self, p: Array, conditions: Conditions, errors: tuple[float, float], words: str) -> Design:
        problem, multipliers, place = self.problem, dict[str, float](), self.known[-1]
        things, rows = place.things, place.rows
        assert rows is not None
        for bound, weight in conditions.bounds:
            multipliers[bound.words] = multipliers.get(bound.words, 0.0) + self.sign * bound.side * weight
        ending, reason = Ending.FOUND, optimum_words(multipliers)
        if self.held:
            reason = f"every design is one: {problem.quantity} does not change with {', '.join(problem.over)}"
        if conditions.violation > FEASIBLE:
            ending = Ending.INFEASIBLE
            reason = f"{ending.value}; {conditions.worst} at the nearest design"
        elif conditions.optimality > OPTIMAL:
            ending = Ending.NO_OPTIMUM
            reason = f"{ending.value}, {conditions.optimality:.1e} of the gradient is left: {words}"
        values = np.split(rows[0][1:], np.cumsum(problem.sizes)[:-1]) if problem.sizes else []
        return replace(
            self._design(p), value=float(rows[0][0]), error=errors[0],
            located=tuple(thing.solution for thing in things),
            quantities=tuple(quantities_of(thing) for thing in things),
            conditions={c.name: part for c, part in zip(problem.conditions, values, strict=True)},
            multipliers=multipliers, optimality=conditions.optimality, optimality_error=errors[1],
            violation=conditions.violation, path=np.array([*self.path, p]),
            values=np.array([*self.values, rows[0][0]]), status=ending,
            reason=f"{reason}; {len(self.path)} designs",
        )  # fmt: skip

    def _design(self, p: Array) -> Design:
        """A design at which not everything is located."""
        problem = self.problem
        return Design(
            problem.quantity, problem.maximise, np.nan, np.nan, dict(zip(problem.over, p.tolist(), strict=True)),
            dict(zip(problem.over, map(tuple, problem.ends.T.tolist()), strict=True)), p[None], np.full(1, np.nan),
            Ending.NOT_LOCATED, f"{Ending.NOT_LOCATED.value}{self.failure}",
        )  # fmt: skip


def quantities_of(thing: LocatedThing) -> dict[str, Any]:
    """Quantities of what is located by name, numbers or arrays."""
    expressions, names = thing.expressions, thing.expressions.names
    columns = [ca.densify(ca.SX(expressions.value(name))) for name in names]
    values = ca.Function("quantities", [expressions.symbols], columns).call([thing.numbers])
    arrays = [np.array(value).ravel() for value in values]
    return {name: float(v[0]) if v.size == 1 else v for name, v in zip(names, arrays, strict=True)}
