"""A search among the orbits of one mode's family, in odd cosines, of a chain or of a model of second order."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, Self

import casadi as ca
import numpy as np

from casadi_skin.follow.solution import Orbit
from casadi_skin.model.arguments import accepted_names, number, number_within, short_repr
from casadi_skin.model.expressions import is_comparison, real_array
from casadi_skin.optimise.families import FreeNumber, ModelFamily, Observables
from casadi_skin.optimise.nlp import FLAT_CURVATURE, Nlp, Solution, optimality
from casadi_skin.optimise.search_problem import (
    Condition,
    CosineOrbit,
    Ending,
    Optimum,
    Outcome,
    PlainCheck,
    Start,
    checked_bounds,
    checked_conditions,
    free_names,
    judged,
    named,
    sampled_starts,
)
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.zero.cosines import TrigonometricProblem, prolongation_matrix
from casadi_skin.zero.problem import Array

# Statement of a search among the orbits of one mode's family, in odd cosines, of a chain or of a model ----------------

Quantity = str | Callable[..., Any]  # a name, or a function of Observables (of several orbits: a tuple of them)

FAINTEST_S = 1e-6  # S where no lower bound is given
HARMONICS_OFFERED = (6, 8, 10, 12, 15, 18, 24, 32, 48, 64, 96)
GUESS: Mapping[str, Any] = {"tolerance": 1e-4, "corrector": "newton"}  # of orbits that a start is solved from
UNKNOWN_HARMONICS = 12  # where the first start has no orbit that shows how many it needs
MOVED_OMEGA_RTOL = 1e-2  # relative change of Omega by more harmonics of what is an optimum on the coarse grid alone


@dataclass(frozen=True)
class FamilySearch:
    """Search among the orbits of a family at the amplitudes S, which share the parameters.

    Where "S" is free, `amplitudes` has that of the first start; `several` is true where S is a list; `harmonics` are
    those on which starts are solved.
    """

    family: ModelFamily
    amplitudes: tuple[float, ...]
    several: bool
    objective: Quantity
    maximise: bool
    free: tuple[str, ...]
    bounds: tuple[tuple[float, float], ...]
    conditions: tuple[Condition, ...]
    tolerance: float = 1e-8
    harmonics: int = 0
    resolution_name: ClassVar[str] = "harmonics"
    of_family: ClassVar[bool] = True
    hint: ClassVar[str] = ""

    @classmethod
    def of(
        cls,
        chain_or_model: Any,
        *,
        objective: Quantity | None = None,
        mode: int | str | None = None,
        S: object = 1.0,
        parameters: Mapping[str, float] | None = None,
        free: Sequence[str],
        bounds: Mapping[str, Any] | None = None,
        constraints: Sequence[Any] = (),
        maximise: bool = False,
        tolerance: float = 1e-8,
    ) -> Self:
        """From the arguments of `search_orbit`; raises ValueError and TypeError for values that are not accepted."""
        if objective is None:
            raise ValueError("objective: given none; accepted: the name of a quantity, or a function of observables")
        if not hasattr(chain_or_model, "searched_family"):
            raise TypeError(f"chain_or_model: given {short_repr(chain_or_model)}; accepted: a Chain or an OdeModel")
        family: ModelFamily = chain_or_model.searched_family(mode, parameters)
        several = isinstance(S, list | tuple | np.ndarray)
        amplitudes = tuple(real_array("S", S).ravel().tolist()) if several else (number("S", S, "a finite number > 0"),)
        if not amplitudes or min(amplitudes) <= 0:
            raise ValueError(f"S: given {short_repr(S)}; accepted: a finite number > 0, or a list of such numbers")
        known = {"S": (FAINTEST_S, math.inf)} | {name: (f.lower, f.upper) for name, f in family.free.items()}
        names = free_names(free, known)
        if several and "S" in names:
            raise ValueError("free: given S with a list of S; accepted: S free with one number as its start")
        fixed, quantities = [name for name in known if name not in names], family.equations({}, ca.SX.sym("S")).names
        limits, more = checked_bounds(bounds, {name: known[name] for name in names}, fixed, quantities)
        if "S" in names:
            low, high = limits["S"]
            if low < 0 or high <= 0:
                raise ValueError(f"bounds[S]: given {short_repr([low, high])}; accepted: bounds within 0 to inf")
            limits["S"] = max(low, FAINTEST_S), high
        number_within("tolerance", tolerance, 1e-12, 1e-2)
        conditions = (*checked_conditions(constraints, (Callable,), "a function of the observables"), *more)
        search = cls(
            family.limited({name: limits[name] for name in names if name != "S"}), amplitudes, several, objective,
            bool(maximise), names, tuple(limits[name] for name in names), conditions, float(tolerance),
        )  # fmt: skip
        search._check_expressions()
        return search

    # The statement ----------------------------------------------------------------------------------------------------

    @property
    def model(self) -> Any:
        return self.family.model

    @property
    def _numbers(self) -> dict[str, FreeNumber]:
        known = {"S": FreeNumber(self.amplitudes[0], FAINTEST_S, math.inf, ("S",)), **self.family.free}
        return {name: known[name] for name in self.free}

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free numbers, one each."""
        return tuple(name for number in self._numbers.values() for name in number.names)

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Bounds of the free numbers, one pair each."""
        pairs = zip(self.bounds, self._numbers.values(), strict=True)
        return tuple(pair for pair, number in pairs for _ in number.names)

    def symbols(self, harmonics: int) -> tuple[ca.SX, tuple[Observables, ...]]:
        """The free numbers as symbols, shape (free numbers, 1), and the orbits made of them."""
        symbols = {name: ca.SX.sym(name, len(number.names)) for name, number in self._numbers.items()}
        values = {name: symbol for name, symbol in symbols.items() if name != "S"}
        amplitudes = [symbols.get("S", ca.SX.sym("S")) for _ in self.amplitudes]
        orbits = tuple(Observables(self.family.equations(values, S), harmonics) for S in amplitudes)
        return ca.vertcat(*symbols.values()), orbits

    def evaluated(self, quantity: Quantity, orbits: tuple[Observables, ...]) -> Any:
        """A quantity of these orbits."""
        if isinstance(quantity, str):
            return orbits[0].value(quantity)
        return quantity(orbits if self.several else orbits[0])

    def values(self, free: Sequence[float] | Array) -> dict[str, Any]:
        """Free numbers by name: numbers, or arrays where every component has one."""
        places, found = iter(np.asarray(free, dtype=float)), dict[str, Any]()
        for name, free_number in self._numbers.items():
            values = np.array([next(places) for _ in free_number.names])
            found[name] = float(values[0]) if free_number.names == (name,) else values
        return found

    # Checks ---------------------------------------------------------------------------------------------------------

    def _check_expressions(self) -> None:
        """Make every expression once, on two harmonics: names, kinds and shapes are refused here, before any solve."""
        free, orbits = self.symbols(harmonics=2)
        objective = self._expression("objective", self.objective, orbits)
        if objective.is_constant():
            raise ValueError(f"objective: given the constant {objective}; accepted: a quantity of the orbit")
        if objective.shape != (1, 1):
            raise ValueError(f"objective: given an expression of shape {objective.shape}; accepted: a scalar")
        equalities = 0
        for condition in self.conditions:
            rows = self._expression(f"constraints, {condition.name}", condition.quantity, orbits)
            equalities += rows.numel() if condition.equality else 0
        if equalities > free.numel():
            words = f"given {equalities} equalities with {free.numel()} free ({', '.join(self.free)})"
            raise ValueError(f"constraints: {words}; accepted: no more equalities than free numbers")

    def _expression(self, place: str, quantity: Quantity, orbits: tuple[Observables, ...]) -> ca.SX:
        if isinstance(quantity, str):
            if quantity not in orbits[0].names:
                raise ValueError(f"{place}: given {short_repr(quantity)}; {accepted_names(quantity, orbits[0].names)}")
            if self.several and not orbits[0].is_shared(quantity):
                given = f"{short_repr(quantity)} with a list of S"
                raise ValueError(f"{place}: given {given}; accepted: a function of the orbits")
        elif not callable(quantity):
            raise TypeError(f"{place}: given {short_repr(quantity)}; accepted: a name or a function of the observables")
        try:
            made = self.evaluated(quantity, orbits)
        except AttributeError as error:
            raise ValueError(f"{place}: {str(error).removeprefix('observable: ')}") from None
        except (TypeError, ValueError, NotImplementedError, RuntimeError, IndexError) as error:
            raise TypeError(f"{place}: the function given fails: {' '.join(str(error).split())[:200]}") from None
        if isinstance(made, bool) or not isinstance(made, int | float | ca.SX | ca.DM):
            raise TypeError(f"{place}: given a function that returns {short_repr(made)}; accepted: a CasADi expression")
        expression = ca.SX(made)
        if is_comparison(expression):
            given = f"a comparison, {short_repr(made)}"
            raise ValueError(f"{place}: given {given}; accepted: a difference, x - 1 for x == 1")
        if not (expression.is_column() and expression.numel() > 0):
            given = f"an expression of shape {expression.shape}"
            raise ValueError(f"{place}: given {given}; accepted: a scalar or a column")
        return expression

    # The search -------------------------------------------------------------------------------------------------------

    @property
    def wanted(self) -> str:
        return f"on the family of mode {self.family.mode}"

    @property
    def columns(self) -> tuple[str, ...]:
        return ("S", "Omega", *self.family.columns)

    def members(
        self, free: Sequence[float] | Array, amplitudes: Sequence[float] | None = None, **options: Any
    ) -> list[Orbit] | None:
        """The orbits of the family at these free numbers, see `ModelFamily.members`; raises ArithmeticError."""
        values = self.values(free)
        S = values.pop("S", None)
        wanted = self.amplitudes if S is None else (S,)
        try:
            options = {"tolerance": self.tolerance} | options
            return self.family.members(values, wanted if amplitudes is None else amplitudes, options)
        except ValueError as error:  # parameters at which there is no such family
            raise ArithmeticError(str(error)) from None

    # Starts ---------------------------------------------------------------------------------------------------------

    def starts(self, count: int, seed: int, first: Sequence[float] | None = None) -> tuple[Start, ...]:
        values = self.values(first) if first is not None else {n: number.value for n, number in self._numbers.items()}
        rows = sampled_starts([float(np.mean(value)) for value in values.values()], self.bounds, count, seed)
        repeats = [len(number.names) for number in self._numbers.values()]
        return tuple(Start(k, tuple(np.repeat(row, repeats).tolist())) for k, row in enumerate(rows, start=1))

    def prepared(self, first: Start) -> FamilySearch:
        """On as many harmonics as the first start's orbits need."""
        try:
            needed = max(member.harmonics for member in self.members(first.free) or ())
        except ArithmeticError:
            needed = UNKNOWN_HARMONICS
        return replace(self, harmonics=next((h for h in HARMONICS_OFFERED[:-1] if h >= needed), HARMONICS_OFFERED[-2]))

    def nlp_at(self, start: Start) -> tuple[FamilyNlp, Array]:
        nlp = family_nlp(self, self.harmonics)
        return nlp, nlp.packed(start.free, self.members(start.free, **GUESS) or ())

    # Optima ---------------------------------------------------------------------------------------------------------

    def polish(self, outcome: Outcome, starts: tuple[int, ...]) -> Optimum | None:
        """The optimum on as many harmonics as the tolerance requires.

        An orbit off the family is refined no further than the first step that shows this.
        """
        nlp, solution, best = family_nlp(self, self.harmonics), outcome.solution, None
        assert solution is not None
        for harmonics in (h for h in HARMONICS_OFFERED if h > self.harmonics):
            finer = family_nlp(self, harmonics)
            better = finer.solve(nlp.prolonged(solution.x, finer), warm=True)
            if judged(finer, outcome.start, better).ending is not Ending.CONVERGED:
                break
            errors = self._differences(nlp, solution, finer, better)
            nlp, solution = finer, better
            best = self._optimum(nlp, solution, starts, errors)
            flat = best.curvature < FLAT_CURVATURE  # no resolution would make it converge
            if errors["Omega"] > MOVED_OMEGA_RTOL * best.Omega and not flat:
                return None
            converged = errors["objective"] <= self.tolerance * max(1.0, abs(best.objective))
            if flat or best.on_family is False or (converged and errors["Omega"] <= self.tolerance * best.Omega):
                break
        return best

    def _differences(self, nlp: FamilyNlp, solution: Solution, finer: FamilyNlp, better: Solution) -> dict[str, float]:
        """Differences of objective, Omega and free numbers between two numbers of harmonics."""
        moved = np.abs(better.x - nlp.prolonged(solution.x, finer))[: len(self.free_names)]
        turned = np.max(np.abs(finer.frequencies(better.x) - nlp.frequencies(solution.x)))
        errors = {"objective": abs(better.objective - solution.objective), "Omega": float(turned)}
        return errors | dict(zip(self.free_names, moved.tolist(), strict=True))

    def _optimum(
        self, nlp: FamilyNlp, solution: Solution, starts: tuple[int, ...], errors: dict[str, float]
    ) -> Optimum:
        x, found = solution.x, optimality(nlp, solution)
        values, orbits = self.values(x[: nlp.free_count]), []
        for k, Omega in enumerate(nlp.frequencies(x)):
            S = nlp.amplitude(x, k)
            scale = self.family.scale(values, S)
            displacements = nlp.state_of(x, k) * scale[:, None]
            orbits.append(CosineOrbit.at_nodes(self.family.at(values), S, float(Omega), displacements))
        checks = tuple(self._check(nlp, x, k) for k in range(len(orbits)))
        return Optimum.of(
            nlp, solution, found, self.free_names, orbits=tuple(orbits), quantities=tuple(nlp.values(x)), checks=checks,
            errors=errors, resolution=nlp.harmonics, starts=starts,
        )  # fmt: skip

    def _check(self, nlp: FamilyNlp, x: Array, orbit: int) -> PlainCheck:
        """One orbit solved again by Newton's method on more harmonics, and beside the family from S = 0."""
        values, S, Omega = self.values(x[: nlp.free_count]), nlp.amplitude(x, orbit), float(nlp.frequencies(x)[orbit])
        harmonics = next(h for h in HARMONICS_OFFERED if h > nlp.harmonics or h == HARMONICS_OFFERED[-1])
        problem = TrigonometricProblem(self.family.plain(values), harmonics)
        state = (nlp.state_of(x, orbit) @ prolongation_matrix(nlp.harmonics, harmonics)).ravel()
        guess = np.concatenate([state, [Omega, S]])
        correction = NewtonCorrector(problem).correct(guess, problem.parameter_row(), S)
        turned = problem.frequency(correction.z) - Omega
        moved = problem.profile_change(guess, correction.z - guess)
        residual = problem.relative_residual(correction.z)
        family, words = self._beside_family(x[: nlp.free_count], S, Omega)
        return PlainCheck(
            correction.converged, turned, max(moved, abs(turned) / Omega), residual, harmonics, family, words
        )

    def _beside_family(self, free: Array, S: float, Omega: float) -> tuple[float | None, str]:
        try:
            members = self.members(free, [S])
        except ArithmeticError as error:
            return None, " ".join(str(error).split())
        return None if members is None else Omega - members[0].Omega, ""


# The orbits of a search in odd cosines as a nonlinear programme -------------------------------------------------------

SLOWEST_SQUARE = 1e-6  # Omega^2 beside the largest stiffness: the square root is kept above it
IPOPT_OPTIONS: Mapping[str, Any] = {
    "ipopt.tol": 1e-10,
    "ipopt.constr_viol_tol": 1e-10,
    "ipopt.compl_inf_tol": 1e-9,
    "ipopt.max_iter": 400,  # rounding of the start alone makes 120 to 250 of a chain with every stiffness free
    "ipopt.theta_max_fact": 1.0,  # no iterate violates more than the start, or 1: far from orbits nothing is bounded
    "ipopt.diverging_iterates_tol": 1e8,
}


class FamilyNlp(Nlp):
    """The nonlinear programme of a search on a number of harmonics."""

    def __init__(self, search: FamilySearch, harmonics: int) -> None:
        self.search, self.harmonics = search, harmonics
        free, orbits = search.symbols(harmonics)
        objective = ca.SX(search.evaluated(search.objective, orbits))
        conditions = [ca.SX(search.evaluated(c.quantity, orbits)) for c in search.conditions]
        self.has_tangent = any(orbit.tangent is not None for orbit in orbits)
        if self.has_tangent:
            _ = [orbit.slope(orbit.S) for orbit in orbits]  # all orbits have the same unknowns
        equations = [orbit.residual() for orbit in orbits]
        self.free_count, self._orbits = int(free.numel()), orbits
        self._shape = (len(orbits), 1 + self.has_tangent, search.family.size * harmonics + 1)
        x, held = ca.vertcat(free, *(o.unknowns for o in orbits)), [] if "S" in search.free else [o.S for o in orbits]
        bounds = {
            name: ([i], *ends) for i, (name, ends) in enumerate(zip(search.free_names, search.limits, strict=True))
        }
        scales = [high - low if np.isfinite(high - low) else 1.0 for low, high in search.limits]
        super().__init__(
            x, objective, ca.vertcat(*equations),
            bounds | {"": (self._parts(np.arange(x.numel()))[:, 0, -1], SLOWEST_SQUARE, np.inf)},
            named(search.conditions, conditions), p=ca.vertcat(*held) if held else ca.SX(0, 1),
            values=search.amplitudes if held else (), jacobian=self._by_blocks(free, equations, conditions),
            maximise=search.maximise, options=IPOPT_OPTIONS, measured=range(self.free_count),
            place=ca.vertcat(free / ca.DM(scales), *(orbit.Omega_squared for orbit in orbits)),
        )  # fmt: skip

    def _by_blocks(self, free: ca.SX, equations: list[ca.SX], conditions: list[ca.SX]) -> ca.SX:
        """Derivative of the constraints, block by block: dense rows beside dense columns would spoil the colouring."""

        def blocks(columns: Sequence[ca.SX]) -> list[ca.SX]:
            states = [part for column in columns for part in ca.vertsplit(column, self._shape[2])]
            return [block for part in states for block in (part[:-1], part[-1])]

        rows, columns = (*blocks(equations), *conditions), (free, *blocks([o.unknowns for o in self._orbits]))
        return ca.vertcat(*(ca.horzcat(*(ca.jacobian(row, column) for column in columns)) for row in rows))

    # Places of the unknowns -----------------------------------------------------------------------------------------

    def _parts(self, x: Array) -> Array:
        """A view of the orbits' unknowns, shape (orbits, 1 or 2 with the tangent, values with Omega^2)."""
        return x[self.free_count :].reshape(self._shape)

    def state_of(self, x: Array, orbit: int) -> Array:
        """Values at the nodes of one orbit, shape (components, harmonics)."""
        return self._parts(x)[orbit, 0, :-1].reshape(-1, self.harmonics)

    def frequencies(self, x: Array) -> Array:
        """Omega of every orbit, shape (orbits,)."""
        return np.asarray(np.sqrt(self._parts(x)[:, 0, -1]))

    def amplitude(self, x: Array, orbit: int) -> float:
        """S of one orbit."""
        search = self.search
        return float(x[search.free_names.index("S")]) if "S" in search.free else search.amplitudes[orbit]

    # Points ---------------------------------------------------------------------------------------------------------

    def packed(self, free: Sequence[float], members: Sequence[Orbit]) -> Array:
        """Unknowns from the free numbers and the orbits; tangents are solved for."""
        from scipy.sparse.linalg import splu

        theta = (np.arange(self.harmonics) + 0.5) * np.pi / (2 * self.harmonics)
        x = np.concatenate([free, np.zeros(int(np.prod(self._shape)))])
        search, values = self.search, self.search.values(free)
        for part, member in zip(self._parts(x), members, strict=True):
            q = member.evaluate(theta / member.Omega) / search.family.scale(values, member.S)
            part[0] = np.append(q.T.ravel(), member.Omega**2)
        if self.has_tangent:
            residual, jacobian, state = self.residual(x), self.jacobian(x), self._shape[2]
            for k, part in enumerate(self._parts(x)):
                rows = slice((2 * k + 1) * state, (2 * k + 2) * state)
                columns = slice(rows.start + self.free_count, rows.stop + self.free_count)
                part[1] = -splu(jacobian[rows, columns]).solve(residual[rows])
        return x

    def prolonged(self, x: Array, finer: FamilyNlp) -> Array:
        """The same point on another number of harmonics."""
        parts, matrix = self._parts(x), prolongation_matrix(self.harmonics, finer.harmonics)
        states = parts[..., :-1].reshape(*self._shape[:2], -1, self.harmonics) @ matrix
        return np.append(
            x[: self.free_count], np.dstack([states.reshape(*self._shape[:2], -1), parts[..., -1:]]).ravel()
        )

    def values(self, x: Array) -> list[dict[str, Any]]:
        """Quantities of every orbit by name, numbers or arrays; slopes only where there are tangents."""
        found = []
        for orbit in self._orbits:
            names = [n for n in orbit.names if self.has_tangent or not n.endswith("_slope")]
            function = ca.Function("values", [self._x, self._p], [ca.densify(orbit.value(n)) for n in names])
            results = [np.array(value).ravel() for value in function.call([x, self.p])]
            found.append({n: float(v[0]) if v.size == 1 else v for n, v in zip(names, results, strict=True)})
        return found


@lru_cache(maxsize=16)
def family_nlp(search: FamilySearch, harmonics: int) -> FamilyNlp:
    """The nonlinear programme of a search; the last few are kept, since starts share them."""
    return FamilyNlp(search, harmonics)
