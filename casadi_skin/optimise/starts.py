"""Where a search starts, and what one start leads to."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from casadi_skin.lattice.chain import Chain
from casadi_skin.optimise.iteration_callback import Monitor
from casadi_skin.optimise.optimality import Kkt, kkt
from casadi_skin.optimise.request import SearchRequest
from casadi_skin.optimise.search_nlp import VIOLATION, SearchNlp, Solution, programme
from casadi_skin.orbits.follow import follow_family
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.theory.linear import Array
from casadi_skin.threads import one_thread

CONVERGED = 1e-7  # Kkt.largest of an optimum, whatever Ipopt says of it
SAME = 1e-4  # distance of places, relative to their scales, below which optima are the same
MARGIN = 0.02  # of a range, which starts keep from its ends
INFEASIBLE = ("Infeasible_Problem_Detected", "Restoration_Failed")
HARMONICS = (6, 8, 10, 12, 15, 18, 24, 32, 48, 64, 96)


class Ending(Enum):
    """How one start ended."""

    CONVERGED = "an optimum"
    INFEASIBLE = "nothing near the start meets the constraints"
    UNBOUNDED = "ran off without bound"
    INTERRUPTED = "interrupted"
    FAILED = "not converged in the iterations allowed"
    NO_ORBIT = "no orbit to start from"


@dataclass(frozen=True)
class Start:
    """A start: its number from 1, and the free numbers that it starts from."""

    number: int
    free: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a start led to; `solution` is None where there was no orbit to start from."""

    start: Start
    ending: Ending
    words: str
    solution: Solution | None = None
    violation: float = np.inf
    worst: str = ""  # the constraint that is violated most
    gap: float = np.inf  # by how much, in its own units
    deflated: bool = False  # whether it kept away from optima that were known

    @property
    def feasible(self) -> bool:
        """Whether every constraint is met."""
        return self.violation <= VIOLATION


def sample_starts(request: SearchRequest, count: int, seed: int) -> tuple[Start, ...]:
    """The chain's own parameters first, clipped to the bounds; then a Halton sequence (Halton 1960; Owen 2017).

    Where a bound is missing the range is from half to twice the chain's own value. Every site of a nonuniform start
    has the same alpha.
    """
    from scipy.stats import qmc

    own = {"S": request.amplitudes[0], "alpha_n": request.chain.alpha}
    first, ranges = [], []
    for name, (low, high) in zip(request.free, request.bounds, strict=True):
        value = own[name] if name in own else float(getattr(request.chain, name))
        span = sorted((0.5 * value, 2.0 * value)) if value != 0 else [-1.0, 1.0]
        low, high = (max(low, span[0]) if high == np.inf else low), high
        ends = (low if np.isfinite(low) else span[0], high if np.isfinite(high) else span[1])
        inside = MARGIN * (ends[1] - ends[0])
        ranges.append((ends[0] + inside, ends[1] - inside))
        first.append(float(np.clip(value, *ranges[-1])))
    drawn = qmc.Halton(len(ranges), scramble=True, seed=np.random.default_rng(seed)).random(max(count - 1, 0))
    lows, highs = np.array(ranges).T
    rows = [np.array(first), *(lows + drawn * (highs - lows))]
    repeats = [request.chain.sites if name == "alpha_n" else 1 for name in request.free]
    return tuple(Start(k, tuple(np.repeat(row, repeats).tolist())) for k, row in enumerate(rows, start=1))


def chain_at(request: SearchRequest, free: tuple[float, ...] | Array) -> Chain:
    """The chain of these free numbers; of a nonuniform one, that with the mean alpha."""
    values, own = dict(zip(request.free_names, free, strict=True)), request.chain
    alphas = [value for name, value in values.items() if name.startswith("alpha")]
    alpha = float(np.mean(alphas)) if alphas else own.alpha
    return replace(own, alpha=alpha, gamma=float(values.get("gamma", own.gamma)), g=float(values.get("g", own.g)))


def family_orbits(request: SearchRequest, free: tuple[float, ...]) -> list[Orbit]:
    """The orbits of the mode's family at these free numbers; raises ValueError or ArithmeticError where one is not."""
    values = dict(zip(request.free_names, free, strict=True))
    amplitudes = (values["S"],) if "S" in values else request.amplitudes
    at = sorted(set(amplitudes))
    branch = follow_family(
        chain_at(request, free), request.mode, at[-1], at=at, tolerance=request.tolerance, tail="full"
    )
    return [branch.at(S=S) for S in amplitudes]


def gauge_values(orbit: Orbit, harmonics: int) -> Array:
    """Scaled gauge positions q at the nodes, shape (sites, harmonics)."""
    theta = (np.arange(harmonics) + 0.5) * np.pi / (2 * harmonics)
    return np.asarray(orbit.point.problem.sample(orbit.point.z, theta).T)


def first_harmonics(request: SearchRequest, start: Start) -> int:
    """Harmonics on which the starts are solved: those that the first start's orbits need."""
    try:
        needed = max(orbit.harmonics for orbit in family_orbits(request, start.free))
    except (ValueError, ArithmeticError):
        needed = 12
    return next((level for level in HARMONICS[:-1] if level >= needed), HARMONICS[-2])


def run_start(
    request: SearchRequest, start: Start, harmonics: int, known: tuple[Array, ...] = (), monitor: Monitor | None = None
) -> Outcome:
    """Solve the search from one start: an orbit of the family there, then Ipopt; `known` places are kept away from.

    What keeps away from known optima may end on the ball round one of them: it is solved again without, and then leads
    to a new optimum or back to the known one.
    """
    with one_thread():
        try:
            orbits = family_orbits(request, start.free)
        except (ValueError, ArithmeticError) as error:
            return Outcome(start, Ending.NO_ORBIT, " ".join(str(error).split()))
        nlp = programme(request, harmonics)
        solution = nlp.solve(packed(nlp, start, orbits), monitor, known)
        if known and solution.words != "User_Requested_Stop":
            solution = nlp.solve(solution.x, monitor)
        return replace(outcome(nlp, start, solution), deflated=bool(known))


def packed(nlp: SearchNlp, start: Start, orbits: list[Orbit]) -> Array:
    """Unknowns of the programme at these orbits."""
    return nlp.pack(np.array(start.free), [(gauge_values(orbit, nlp.harmonics), orbit.Omega) for orbit in orbits])


def outcome(nlp: SearchNlp, start: Start, solution: Solution) -> Outcome:
    """What a solution is: an optimum where our own conditions of optimality say so."""
    finite = bool(np.all(np.isfinite(solution.x)))
    gaps = nlp.violations(solution.x) if finite else np.full(1, np.inf)
    violation, worst = float(np.max(gaps)), nlp.row_names()[int(np.argmax(gaps))] if finite else "every constraint"
    optimality = kkt(nlp, solution) if finite else Kkt(np.inf, np.inf, np.inf)
    if solution.words == "User_Requested_Stop":
        ending = Ending.INTERRUPTED
    elif solution.words == "Diverging_Iterates":
        ending = Ending.UNBOUNDED
    elif optimality.largest <= CONVERGED and violation <= CONVERGED:
        ending = Ending.CONVERGED
    elif solution.words in INFEASIBLE:
        ending = Ending.INFEASIBLE
    else:
        ending = Ending.FAILED
    return Outcome(start, ending, solution.words, solution, optimality.violation, worst, violation)


def same_place(nlp: SearchNlp, first: Array, second: Array) -> bool:
    """Whether two points are the same optimum."""
    distance = np.abs(nlp.place(first) - nlp.place(second)) / nlp.scales
    return bool(np.max(distance) <= SAME)
