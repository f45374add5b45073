"""A search among the orbits of one mode's family, in odd cosines, of a chain or of a model of second order."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from casadi_skin.arguments import number, numbers, short_repr
from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.trigonometric import TrigonometricProblem, prolongation_matrix
from casadi_skin.models.expressions import is_comparison
from casadi_skin.optimise.chain_family import ChainFamily
from casadi_skin.optimise.family_nlp import FamilyNlp
from casadi_skin.optimise.model_family import ModelFamily
from casadi_skin.optimise.names import nearest_name
from casadi_skin.optimise.nlp import Solution
from casadi_skin.optimise.observables import FreeNumber, Member, Observables
from casadi_skin.optimise.optimality import FLAT, optimality
from casadi_skin.optimise.result import CosineOrbit, Optimum, PlainCheck
from casadi_skin.optimise.search_arguments import Condition, checked_bounds, checked_conditions, free_names
from casadi_skin.optimise.search_problem import Ending, Outcome, Start, judged, sampled_starts
from casadi_skin.solvers.newton import NewtonCorrector

Family = ChainFamily | ModelFamily
Quantity = str | Callable[..., Any]  # a name, or a function of Observables (of several orbits: a tuple of them)

HARMONICS = (6, 8, 10, 12, 15, 18, 24, 32, 48, 64, 96)
UNKNOWN_HARMONICS = 12  # where the first start has no orbit that tells how many it needs
MOVED = 1e-2  # relative change of Omega by more harmonics of what is an optimum on the coarse grid alone
FAINTEST = 1e-6  # S where no lower bound is given


@dataclass(frozen=True)
class FamilySearch:
    """A search for orbits of a family at the amplitudes S, which share the parameters (see `SearchProblem`).

    Where "S" is free, `amplitudes` has that of the first start; `several` tells that S was given as a list. `harmonics`
    are those on which starts are solved.
    """

    family: Family
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

    @classmethod
    def of(
        cls,
        family: Family,
        *,
        S: object,
        objective: Quantity,
        free: Sequence[str],
        bounds: Mapping[str, Any] | None = None,
        constraints: Sequence[Any] = (),
        maximise: bool = False,
        tolerance: float = 1e-8,
    ) -> FamilySearch:
        """From the arguments of `search_orbit`; raises ValueError and TypeError for what cannot be meant."""
        several = not (isinstance(S, int | float) or hasattr(S, "__float__"))
        amplitudes = numbers("S", S) if several else (number("S", S, "a finite number > 0"),)
        if not amplitudes or min(amplitudes) <= 0:
            raise ValueError(f"S: given {short_repr(S)}; accepted: a finite number > 0, or a list of such numbers")
        known = {"S": (FAINTEST, math.inf)} | {name: (f.lower, f.upper) for name, f in family.free.items()}
        names = free_names(free, known)
        if several and "S" in names:
            raise ValueError("free: given S with a list of S; accepted: S free with one number as its start")
        fixed, quantities = [name for name in known if name not in names], family.equations({}, ca.SX.sym("S")).names
        limits, more = checked_bounds(bounds, {name: known[name] for name in names}, fixed, quantities)
        if "S" in names:
            low, high = limits["S"]
            if low < 0 or high <= 0:
                raise ValueError(f"bounds[S]: given {short_repr([low, high])}; accepted: bounds within 0 to inf")
            limits["S"] = max(low, FAINTEST), high
        if not 1e-12 <= number("tolerance", tolerance) <= 1e-2:
            raise ValueError(f"tolerance: given {tolerance!r}; accepted: 1e-12 to 1e-2")
        conditions = (*checked_conditions(constraints, (Callable,), "a function of the observables"), *more)
        search = cls(
            family.limited({name: limits[name] for name in names if name != "S"}), amplitudes, several, objective,
            bool(maximise), names, tuple(limits[name] for name in names), conditions, float(tolerance),
        )  # fmt: skip
        search._check_expressions()
        return search

    # What is asked --------------------------------------------------------------------------------------------------

    @property
    def model(self) -> Any:
        return self.family.model

    @property
    def wanted(self) -> str:
        return f"on the family of mode {self.family.mode}"

    @property
    def hint(self) -> str:
        return ""

    @property
    def columns(self) -> tuple[str, ...]:
        return ("S", "Omega", *self.family.columns)

    @property
    def _numbers(self) -> dict[str, FreeNumber]:
        known = {"S": FreeNumber(self.amplitudes[0], FAINTEST, math.inf, ("S",)), **self.family.free}
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
        """What is free by name: numbers, or arrays where every component has one."""
        places, found = iter(np.asarray(free, dtype=float)), dict[str, Any]()
        for name, free_number in self._numbers.items():
            values = np.array([next(places) for _ in free_number.names])
            found[name] = float(values[0]) if free_number.names == (name,) else values
        return found

    def members(self, free: Sequence[float] | Array, amplitudes: Sequence[float] | None = None) -> list[Member] | None:
        """The orbits of the family at these free numbers, see `Family.members`; raises ArithmeticError."""
        values = self.values(free)
        S = values.pop("S", None)
        wanted = self.amplitudes if S is None else (S,)
        try:
            return self.family.members(values, wanted if amplitudes is None else amplitudes, self.tolerance)
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
        return replace(self, harmonics=next((h for h in HARMONICS[:-1] if h >= needed), HARMONICS[-2]))

    def nlp_at(self, start: Start) -> tuple[FamilyNlp, Array]:
        nlp = family_nlp(self, self.harmonics)
        return nlp, nlp.packed(start.free, self.members(start.free) or ())

    # Optima ---------------------------------------------------------------------------------------------------------

    def polish(self, outcome: Outcome, starts: tuple[int, ...]) -> Optimum | None:
        """The optimum on as many harmonics as the tolerance asks for.

        An orbit off the family is taken no farther than the first step that shows it.
        """
        nlp, solution, best = family_nlp(self, self.harmonics), outcome.solution, None
        assert solution is not None
        for harmonics in (h for h in HARMONICS if h > self.harmonics):
            finer = family_nlp(self, harmonics)
            better = finer.solve(nlp.prolonged(solution.x, finer), warm=True)
            if judged(finer, outcome.start, better).ending is not Ending.CONVERGED:
                break
            errors = self._differences(nlp, solution, finer, better)
            nlp, solution = finer, better
            best = self._optimum(nlp, solution, starts, errors)
            flat = best.curvature < FLAT  # no resolution would make it converge
            if errors["Omega"] > MOVED * best.Omega and not flat:
                return None
            converged = errors["objective"] <= self.tolerance * max(1.0, abs(best.objective))
            if flat or best.on_family is False or (converged and errors["Omega"] <= self.tolerance * best.Omega):
                break
        return best

    def _differences(self, nlp: FamilyNlp, solution: Solution, finer: FamilyNlp, better: Solution) -> dict[str, float]:
        """What objective, Omega and free numbers differ by on two numbers of harmonics."""
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
            orbits.append(CosineOrbit.of(S, float(Omega), nlp.state_of(x, k) * scale[:, None]))
        checks = tuple(self._check(nlp, x, k) for k in range(len(orbits)))
        return Optimum.of(
            nlp, solution, found, self.free_names, orbits=tuple(orbits), quantities=tuple(nlp.values(x)), checks=checks,
            errors=errors, resolution=nlp.harmonics, starts=starts,
        )  # fmt: skip

    def _check(self, nlp: FamilyNlp, x: Array, orbit: int) -> PlainCheck:
        """One orbit solved again by Newton's method on more harmonics, and beside the family from S = 0."""
        values, S, Omega = self.values(x[: nlp.free_count]), nlp.amplitude(x, orbit), float(nlp.frequencies(x)[orbit])
        model, parameter = self.family.plain(values, S)
        harmonics = next(h for h in HARMONICS if h > nlp.harmonics or h == HARMONICS[-1])
        problem = TrigonometricProblem(model, harmonics)
        state = (nlp.state_of(x, orbit) @ prolongation_matrix(nlp.harmonics, harmonics)).ravel()
        guess = np.concatenate([state, [Omega, parameter]])
        correction = NewtonCorrector(problem).correct(guess, problem.parameter_row(), parameter)
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
                raise ValueError(f"{place}: given {short_repr(quantity)}; {nearest_name(quantity, orbits[0].names)}")
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


@lru_cache(maxsize=16)
def family_nlp(search: FamilySearch, harmonics: int) -> FamilyNlp:
    """The nonlinear programme of a search; the last few are kept, since starts share them."""
    return FamilyNlp(search, harmonics)
