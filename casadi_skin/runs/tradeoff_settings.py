"""Settings of a work-precision diagram, measured: time, memory and true errors of one family by each of them.

True errors are distances to the same orbits by odd cosines (Gauss collocation where they are not odd) at the tightest
tolerance. A second transcription, also at the tightest tolerance, says how well that reference is known: errors below
the distance of the two are marked, and drawn in a hatched band.
"""

from __future__ import annotations

import math
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from math import nan
from pathlib import Path
from statistics import median
from timeit import Timer
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.following import Following, run_following
from casadi_skin.follow.orbit import Orbit
from casadi_skin.model.methods import CONTINUATIONS, CORRECTORS, FLOWS, SHOOTING, TRANSCRIPTIONS, TRIGONOMETRIC
from casadi_skin.runs.scene import PRESET_TOLERANCES
from casadi_skin.stability.flows import OrbitState
from casadi_skin.stability.multipliers import floquets
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.zero.request import FamilyRequest

Result = TypeVar("Result")

MEASURED_TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
QUICK_TOLERANCES = (1e-4, 1e-8, 1e-12)
TIGHTEST_TOLERANCE = 1e-13
SHOOTING_POSITIONS = 6  # shooting integrates the sensitivities of all states to all: measured up to here
PROFILE_PHASES = 65  # of a quarter of the period
SMALLEST_ERROR = 1e-16  # written for an error of exactly zero
SHORTEST_TIMING, PROCESSOR_TICK = 0.02, 1e-6  # seconds


# Settings -----------------------------------------------------------------------------------------------------------


class Kind(StrEnum):
    """Computation of a setting."""

    ORBITS = "orbits"  # the family without multipliers
    FLOW = "flow"  # multipliers of orbits that are given
    PRESET = "preset"  # the family with multipliers and changes of stability, by the default methods


@dataclass(frozen=True)
class Setting:
    """Methods and a tolerance for a family; `name` is that of a preset."""

    kind: Kind
    tolerance: float
    transcription: str
    walker: str
    corrector: str = "ipopt"
    flow: str = "splitting"
    name: str = ""

    @property
    def method(self) -> str:
        """The methods that are measured, in words, or the preset."""
        orbits = f"{self.transcription}, {self.walker}, {self.corrector}"
        return {Kind.PRESET: self.name, Kind.FLOW: self.flow, Kind.ORBITS: orbits}[self.kind]

    def of(self, family: FamilyRequest) -> FamilyRequest:
        """The family by these methods."""
        names = ("transcription", "walker", "corrector", "flow")
        method = replace(family.method, **{name: getattr(self, name) for name in names})
        return replace(family, tolerance=self.tolerance, method=method)


def settings_of(family: FamilyRequest, tolerances: Iterable[float]) -> list[Setting]:
    """The presets, every method that finds orbits and every flow map, at every tolerance, in this order."""
    own, odd = str(family.method.transcription), family.method.transcription == TRIGONOMETRIC
    walker = str(family.method.walker)
    presets = [Setting(Kind.PRESET, tol, own, walker, name=name) for name, tol in PRESET_TOLERANCES.items()]
    orbits = [
        Setting(Kind.ORBITS, tolerance, transcription, continuation, corrector)
        for transcription in TRANSCRIPTIONS
        if (odd or transcription != TRIGONOMETRIC) and not (transcription == SHOOTING and shooting_left_out(family))
        for continuation in (CONTINUATIONS if transcription == TRIGONOMETRIC else ("arclength",))
        if continuation == "arclength" or walker == continuation
        for corrector in reversed(list(CORRECTORS))
        for tolerance in tolerances
    ]
    flows = [Setting(Kind.FLOW, tol, own, walker, flow=flow) for flow in FLOWS for tol in tolerances]
    return [*presets, *orbits, *(flows if positions(family) > 1 else [])]


def positions(family: FamilyRequest) -> int:
    """Number of positions that move."""
    return int(family.coordinates.scaled.state.numel())


def shooting_left_out(family: FamilyRequest) -> bool:
    """Whether there are too many positions for shooting to be measured."""
    return positions(family) > SHOOTING_POSITIONS


# Computing ----------------------------------------------------------------------------------------------------------


class Errors(NamedTuple):
    """Largest relative errors of Omega, profile and mu; of mu relative to max(1, |mu|), nan where there is none."""

    Omega: float
    profile: float
    mu: float = nan

    def bounded_by(self, kind: Kind) -> float:
        """The largest of those that the tolerance of a setting of this kind bounds."""
        errors = {Kind.ORBITS: self[:2], Kind.FLOW: self[2:], Kind.PRESET: self[:]}[kind]
        return max((value for value in errors if value == value), default=nan)


class Computation:
    """A family by one setting, whose problems are built when they are first used and then kept."""

    def __init__(self, request: FamilyRequest) -> None:
        self.space = Family(request)

    def follow(self, stability: bool = False) -> tuple[Branch, list[Orbit]]:
        """The family to its end, and its requested orbits; raises ArithmeticError where it has not all of them."""
        branch = run_following(Following(self.space, stability), None)
        if not branch.complete:
            raise ArithmeticError(branch.reason)
        return branch, [orbit for orbit in branch.orbits if orbit.point.requested]

    def multipliers(self, orbits: Sequence[Orbit]) -> list[tuple[ComplexArray, float]]:
        """mu of each orbit by the flow of the setting, and the largest estimated error over max(1, |mu|)."""
        states = [OrbitState(orbit.point.problem, orbit.point.z) for orbit in orbits]
        symplectic, space = self.space.coordinates.symplectic, self.space
        found = floquets(space.flow, states, space.accelerations, space.tolerance, symplectic)
        return [(f.mu, float(np.max(f.mu_error / np.maximum(1.0, np.abs(f.mu)), initial=0.0))) for f in found]


def paired(values: ComplexArray, others: ComplexArray) -> ComplexArray:
    """The others in the order in which they belong to `values`: the sum of relative distances is least."""
    distances = np.abs(values[:, None] - others[None, :]) / np.maximum(1, np.abs(values))[:, None]
    return np.asarray(others[linear_sum_assignment(distances.astype(float))[1]])


class Reference:
    """Orbits at the requested S and their mu at the tightest tolerance, by two transcriptions.

    Raises ArithmeticError where the family does not reach them.
    """

    COLUMNS = ("S", "Omega", "Omega_difference", "profile_difference", "mu_difference")

    def __init__(self, family: FamilyRequest) -> None:
        own, walker = str(family.method.transcription), str(family.method.walker)
        first = Setting(Kind.ORBITS, TIGHTEST_TOLERANCE, own, walker, "newton")
        second = replace(first, transcription="gauss" if own == TRIGONOMETRIC else "radau", walker="arclength")
        self._computation = Computation(first.of(family))
        self.orbits = self._computation.follow()[1]
        self.mu = self.multipliers(self.orbits)
        others = Computation(second.of(family)).follow()[1]
        differences = [self._errors(*each) for each in self._beside(others, self.multipliers(others))]
        estimates = [estimate for _, estimate in self.mu]
        self.differences = [e._replace(mu=max(e.mu, mu)) for e, mu in zip(differences, estimates, strict=True)]

    @property
    def agreement(self) -> Errors:
        """Largest differences between the two transcriptions; of mu at least the estimated error."""
        return _largest(self.differences)

    def multipliers(self, orbits: Sequence[Orbit]) -> list[tuple[ComplexArray, float]]:
        """mu of orbits by the flow at the tightest tolerance."""
        if positions(self._computation.space.request) == 1:
            return [(np.zeros(0, complex), 0.0)] * len(orbits)
        return self._computation.multipliers(orbits)

    def errors_of(self, orbits: Sequence[Orbit], multipliers: Sequence[tuple[ComplexArray, float]]) -> Errors:
        """Largest true errors of orbits and of mu; raises ArithmeticError where they are not at the same S."""
        if [orbit.S for orbit in orbits] != [orbit.S for orbit in self.orbits]:
            raise ArithmeticError(f"{len(orbits)} points at the S asked for; the reference has {len(self.orbits)}")
        return _largest([self._errors(*each) for each in self._beside(orbits, multipliers)])

    def _beside(self, orbits: Sequence[Orbit], multipliers: Sequence[tuple[ComplexArray, float]]) -> Iterator[Any]:
        for orbit, (mu, _), exact, (known, _) in zip(orbits, multipliers, self.orbits, self.mu, strict=True):
            yield orbit, mu, exact, known

    @staticmethod
    def _errors(orbit: Orbit, mu: ComplexArray, exact: Orbit, known: ComplexArray) -> Errors:
        phases = np.linspace(0.0, 0.5 * np.pi, PROFILE_PHASES)
        right = exact.evaluate(phases / exact.Omega)
        profile = np.max(np.abs(orbit.evaluate(phases / orbit.Omega) - right)) / np.max(np.abs(right))
        both = mu.size == known.size > 0
        off = np.abs(paired(known, mu) - known) / np.maximum(1.0, np.abs(known)) if both else np.array([nan])
        return Errors(abs(orbit.Omega / exact.Omega - 1.0), float(profile), float(np.max(off)))

    def rows(self) -> Iterator[dict[str, object]]:
        """Rows of reference.csv: each orbit and how far that of the second transcription is from it."""
        for orbit, errors in zip(self.orbits, self.differences, strict=True):
            yield dict(zip(self.COLUMNS, (orbit.S, orbit.Omega, *errors), strict=True))


def _largest(errors: Sequence[Errors]) -> Errors:
    return Errors(*(max(column) for column in zip(*errors, strict=True)))


# Measuring ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Measured:
    """Cost and true errors of one setting.

    Processor times in seconds: the median of repeated runs with the least and the most, and apart from these what the
    first run took longer to build. Memory: the peak of a process that does nothing else. Errors are relative, the
    largest over the points; nan where there is none. `processor_share` is the share of processor times in the time that
    passed, `at_reference_round_off` says that the references differ by as much, and `told` that the program says of its
    own result that the tolerance was out of reach; `failure` is the reason, in a line, why there is no result.
    """

    setting: Setting
    seconds: float = nan
    seconds_min: float = nan
    seconds_max: float = nan
    building_seconds: float = nan
    memory_MB: float = nan
    unknowns: int = 0
    points: int = 0
    Omega_error: float = nan
    profile_error: float = nan
    mu_error: float = nan
    processor_share: float = nan
    at_reference_round_off: bool = False
    told: bool = False
    failure: str = ""

    @property
    def error(self) -> float:
        """The largest error that the tolerance bounds."""
        return Errors(self.Omega_error, self.profile_error, self.mu_error).bounded_by(self.setting.kind)

    def row(self) -> dict[str, object]:
        """Cells by column."""
        unused = {Kind.ORBITS: ("flow",), Kind.FLOW: ("transcription", "walker", "corrector")}
        method = {"method": self.setting.method}
        return {**vars(self.setting), **method, **vars(self), **dict.fromkeys(unused.get(self.setting.kind, ()))}


COLUMNS = (
    *("kind", "method", "transcription", "walker", "corrector", "flow", "tolerance"),
    *(field.name for field in fields(Measured) if field.name != "setting"),
)


def timed(act: Callable[[], Result], repeats: int) -> tuple[Result, dict[str, float]]:
    """The last result, and the times of `Measured` by name, of `repeats` runs after a first one.

    Of a short run several are timed together; without repeats there is no time.
    """
    results: list[Result] = []
    timer = Timer(lambda: results.__setitem__(slice(0, 1), [act()]), timer=time.process_time)
    first, clock = timer.timeit(1), time.perf_counter()
    if not repeats:
        return results[0], {}
    once = timer.timeit(1)
    together = 1 if once >= SHORTEST_TIMING else math.ceil(SHORTEST_TIMING / max(once, PROCESSOR_TICK)) + 1
    times = [max(seconds / together, PROCESSOR_TICK) for seconds in timer.repeat(repeats, together)]
    share, middle = (once + together * sum(times)) / (time.perf_counter() - clock), median(times)
    known = {"seconds": middle, "seconds_min": min(times), "seconds_max": max(times), "processor_share": share}
    return results[0], {**known, "building_seconds": max(first - middle, 0.0)}


def measure(family: FamilyRequest, setting: Setting, reference: Reference, repeats: int) -> Measured:
    """Cost but for memory, and true errors, of a setting; a failure is its reason in a line in place of a result."""
    by_flow = setting.kind is Kind.FLOW
    try:
        computation = Computation(setting.of(family))
        if by_flow:
            mu, times = timed(lambda: computation.multipliers(reference.orbits), repeats)
            errors = Errors(nan, nan, reference.errors_of(reference.orbits, mu).mu)
            size, points = (2 * positions(family)) ** 2, len(mu)
            told = any(estimate > setting.tolerance for _, estimate in mu)
        else:
            stability = setting.kind is Kind.PRESET
            (branch, orbits), times = timed(lambda: computation.follow(stability), repeats)
            own = stability and positions(family) > 1
            mu = [(orbit.floquet().mu, 0.0) for orbit in orbits] if own else reference.multipliers(orbits)  # type: ignore[attr-defined]
            errors = reference.errors_of(orbits, mu)
            size, points = max(orbit.point.z.size for orbit in orbits), len(branch.orbits)
            told = any(orbit.point.at_round_off for orbit in orbits)
    except ArithmeticError as error:
        return Measured(setting, failure=" ".join(str(error).split()))
    shown = [max(error, SMALLEST_ERROR) if error == error else error for error in errors]
    marked = errors.bounded_by(setting.kind) <= reference.agreement.bounded_by(setting.kind)
    measured = Measured(setting, unknowns=size, points=points, at_reference_round_off=marked, told=told)
    true: dict[str, Any] = dict(zip(("Omega_error", "profile_error", "mu_error"), shown, strict=True))
    return replace(measured, **{**times, **true})


def peak_memory(family: FamilyRequest | None = None, stability: bool = False) -> float:
    """Peak resident memory of this process in MB, once it has followed a family; nan where no system reports it."""
    if family is not None:
        Computation(family).follow(stability)
    status = Path("/proc/self/status")  # getrusage counts the memory of the process that started this one, too
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text(encoding="utf-8").splitlines() if ":" in line)
        return 1.024e-3 * int(lines["VmHWM"].split()[0]) if "VmHWM" in lines else nan
    if sys.platform == "win32":
        return nan
    import resource

    return (1e-6 if sys.platform == "darwin" else 1.024e-3) * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def memory_of(family: FamilyRequest | None, stability: bool = False) -> float:
    """Peak memory in MB of a new process that follows a family, or only loads what that takes."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as process:
        return process.submit(peak_memory, family, stability).result()
