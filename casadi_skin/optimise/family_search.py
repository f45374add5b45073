"""A search among the orbits of one mode's family, in odd cosines, of a chain or of a model of second order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar

import numpy as np

from casadi_skin.follow.orbit import Orbit
from casadi_skin.optimise.cosine_orbit import CosineOrbit
from casadi_skin.optimise.family_nlp import FamilyNlp
from casadi_skin.optimise.family_statement import FamilyStatement
from casadi_skin.optimise.nlp import Solution
from casadi_skin.optimise.optimality import FLAT, optimality
from casadi_skin.optimise.optimum import Optimum, PlainCheck
from casadi_skin.optimise.search_problem import Ending, Outcome, Start, judged, sampled_starts
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.zero.cosines import prolongation_matrix
from casadi_skin.zero.problem import Array
from casadi_skin.zero.trigonometric import TrigonometricProblem

HARMONICS = (6, 8, 10, 12, 15, 18, 24, 32, 48, 64, 96)
UNKNOWN_HARMONICS = 12  # where the first start has no orbit that shows how many it needs
MOVED = 1e-2  # relative change of Omega by more harmonics of what is an optimum on the coarse grid alone


@dataclass(frozen=True)
class FamilySearch(FamilyStatement):
    """A search among the orbits of a family (see `SearchProblem`); `harmonics` are those on which starts are solved."""

    harmonics: int = 0
    resolution_name: ClassVar[str] = "harmonics"

    @property
    def wanted(self) -> str:
        return f"on the family of mode {self.family.mode}"

    @property
    def hint(self) -> str:
        return ""

    @property
    def columns(self) -> tuple[str, ...]:
        return ("S", "Omega", *self.family.columns)

    def members(self, free: Sequence[float] | Array, amplitudes: Sequence[float] | None = None) -> list[Orbit] | None:
        """The orbits of the family at these free numbers, see `ChainFamily.members`; raises ArithmeticError."""
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
        """The optimum on as many harmonics as the tolerance requires.

        An orbit off the family is refined no further than the first step that shows this.
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


@lru_cache(maxsize=16)
def family_nlp(search: FamilySearch, harmonics: int) -> FamilyNlp:
    """The nonlinear programme of a search; the last few are kept, since starts share them."""
    return FamilyNlp(search, harmonics)
