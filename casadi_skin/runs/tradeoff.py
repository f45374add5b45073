"""What accuracy costs: every method at every tolerance on one family, as tables, a page of advice, and a picture."""

from __future__ import annotations

import argparse
import math
import pickle
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import groupby, product
from math import nan
from pathlib import Path
from statistics import median
from timeit import Timer
from typing import Any, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from scipy.optimize import linear_sum_assignment

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.follow import BranchRun
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import in_words
from casadi_skin.model.methods import CONTINUATIONS, CORRECTORS, FLOWS, SHOOTING, TRANSCRIPTIONS, TRIGONOMETRIC
from casadi_skin.results.figures.style import blank, colours, drawn, finished, title
from casadi_skin.runs.binding import bound
from casadi_skin.runs.output import InputError
from casadi_skin.runs.reading import read_scene
from casadi_skin.runs.scene import PRESET_TOLERANCES
from casadi_skin.runs.study import Study, letter, run_study
from casadi_skin.solve.processes import Worker
from casadi_skin.stability.flows import OrbitState
from casadi_skin.stability.multipliers import floquets
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.zero.family import FamilyRequest, Method, Targets, family_request
from casadi_skin.zero.problem import Array

Result = TypeVar("Result")
Multipliers = tuple[ComplexArray, float]  # mu of an orbit, and the largest estimated error over max(1, |mu|)

ORBITS = "orbits"  # kinds of settings: the family without multipliers,
FLOW = "flow"  # multipliers of orbits that are given,
PRESET = "preset"  # the family with multipliers and changes of stability, by the default methods
ERRORS = ("Omega", "profile", "mu")  # relative; of mu relative to max(1, |mu|)
BOUNDED_ERRORS = {ORBITS: slice(0, 2), FLOW: slice(2, 3), PRESET: slice(0, 3)}  # by the tolerance of a setting
MEASURED_TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
QUICK_TOLERANCES = (1e-4, 1e-8, 1e-12)
TIGHTEST_TOLERANCE = 1e-13
TABLE_TOLERANCES = QUICK_TOLERANCES  # of the rows that the page shows
SHOOTING_POSITIONS = 6  # shooting integrates the sensitivities of all states to all: measured up to here
PROFILE_PHASES = 65  # of a quarter of the period
SMALLEST_ERROR = 1e-16  # written for an error of exactly zero
SHORTEST_TIMING, PROCESSOR_TICK = 0.02, 1e-6  # seconds
DEFAULT_REPEATS = 5
PARTS_OF_FAMILY = 5  # at whose ends errors are measured unless the scene requests orbits
DEFAULT_AT = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)  # no value next to a change of stability, where mu meet
EQUAL_ERRORS = 1.5  # factor between errors that count as equal on a Pareto front
SINGLE_RUN_NOISE, MEDIAN_NOISE = 1.5, 1.1  # factors between times that mean something
IDLE_SHARE = 0.95  # of the processor, below which the machine was busy


# Settings -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """Methods and a tolerance for a family, and once it is measured its cost and true errors: a row of the tables.

    Processor times in seconds: the median of repeated runs with the least and the most, and apart from these what the
    first run took longer to build. Memory: the peak of a process that does nothing else. Errors are the largest over
    the points; nan where there is none. `processor_share` is the share of processor times in the time that passed,
    `at_reference_round_off` says that the references differ by as much, and `told` that the program says of its own
    result that the tolerance was out of reach; `failure` is the reason, in a line, why there is no result.
    """

    kind: str
    method: str  # in words, or the name of a preset
    transcription: str
    walker: str
    corrector: str
    flow: str
    tolerance: float
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

    def of(self, family: FamilyRequest) -> FamilyRequest:
        """The family by these methods."""
        names = ("transcription", "walker", "corrector", "flow")
        chosen = {name: value for name in names if (value := getattr(self, name))}
        return replace(family, tolerance=self.tolerance, method=replace(family.method, **chosen))

    @property
    def errors(self) -> Array:
        """Errors of Omega, of the profile and of mu."""
        return np.array([self.Omega_error, self.profile_error, self.mu_error])

    @property
    def error(self) -> float:
        """The largest error that the tolerance bounds."""
        return largest(self.errors, self.kind)


def largest(errors: Array, kind: str) -> float:
    """The largest of the errors that the tolerance of a setting of a kind bounds; nan where there is none."""
    return float(np.fmax.reduce(errors[BOUNDED_ERRORS[kind]]))


def settings_of(family: FamilyRequest, tolerances: Iterable[float]) -> list[Setting]:
    """The presets, every method that finds orbits and every flow map, at every tolerance, in this order."""
    own, walker, count = str(family.method.transcription), str(family.method.walker), positions(family)
    found = [Setting(PRESET, name, own, walker, "ipopt", "splitting", at) for name, at in PRESET_TOLERANCES.items()]
    for transcription in TRANSCRIPTIONS:
        cosines, integrated = transcription == TRIGONOMETRIC, transcription == SHOOTING
        if (cosines and own != TRIGONOMETRIC) or (integrated and count > SHOOTING_POSITIONS):
            continue
        walkers = [each for each in CONTINUATIONS if each == "arclength" or (cosines and each == walker)]
        for how in product((transcription,), walkers, reversed(list(CORRECTORS))):
            found += [Setting(ORBITS, ", ".join(how), *how, "", at) for at in tolerances]
    flows = [Setting(FLOW, flow, "", "", "", flow, at) for flow in FLOWS for at in tolerances]
    return [*found, *(flows if count > 1 else [])]


def positions(family: FamilyRequest) -> int:
    """Number of positions that move."""
    return int(family.coordinates.scaled.state.numel())


# Computing ----------------------------------------------------------------------------------------------------------


def followed(space: Family, stability: bool = False) -> tuple[Branch, list[Orbit]]:
    """A family to its end, and its requested orbits; raises ArithmeticError where it has not all of them.

    Its problems are built when they are first used, and kept by the space.
    """
    branch = BranchRun(space, stability).to_end()
    if not branch.complete:
        raise ArithmeticError(branch.reason)
    return branch, [orbit for orbit in branch.orbits if orbit.point.requested]


def multipliers_of(space: Family, orbits: Sequence[Orbit]) -> list[Multipliers]:
    """mu of each orbit by the flow of a family, and the largest estimated error over max(1, |mu|)."""
    states = [OrbitState(orbit.point.problem, orbit.point.z) for orbit in orbits]
    found = floquets(space.flow, states, space.accelerations, space.tolerance, space.coordinates.symplectic)
    return [(f.mu, float(np.max(f.mu_error / np.maximum(1.0, np.abs(f.mu)), initial=0.0))) for f in found]


def paired(values: ComplexArray, others: ComplexArray) -> ComplexArray:
    """The others in the order in which they belong to `values`: the sum of relative distances is least."""
    distances = np.abs(values[:, None] - others[None, :]) / np.maximum(1, np.abs(values))[:, None]
    return np.asarray(others[linear_sum_assignment(distances.astype(float))[1]])


class Reference:
    """Orbits at the requested S and their mu at the tightest tolerance, by two transcriptions.

    Raises ArithmeticError where the family does not reach them.

    Attributes:
        orbits, mu: by the transcription of the family.
        differences: between the two transcriptions, shape (orbits, 3), at least rounding; of mu the estimated error.
        agreement: the largest of them, shape (3,).
    """

    COLUMNS = ("S", "Omega", *(f"{name}_difference" for name in ERRORS))

    def __init__(self, family: FamilyRequest) -> None:
        own, walker = str(family.method.transcription), str(family.method.walker)
        first = Setting(ORBITS, "", own, walker, "newton", "", TIGHTEST_TOLERANCE)
        second = replace(first, transcription="gauss" if own == TRIGONOMETRIC else "radau", walker="arclength")
        self._space = Family(first.of(family))
        self.orbits = followed(self._space)[1]
        self.mu = self.multipliers(self.orbits)
        others = followed(Family(second.of(family)))[1]
        self.differences = self._errors(others, self.multipliers(others))
        rounding = np.array([[orbit.point.problem.round_off] for orbit in self.orbits])
        self.differences[:, :2] = np.maximum(self.differences[:, :2], rounding)  # they may agree by chance
        known = ~np.isnan(self.differences[:, 2])
        self.differences[known, 2] = np.maximum(self.differences[:, 2], [error for _, error in self.mu])[known]
        self.agreement: Array = np.fmax.reduce(self.differences)

    def multipliers(self, orbits: Sequence[Orbit]) -> list[Multipliers]:
        """mu of orbits by the flow at the tightest tolerance."""
        if positions(self._space.request) == 1:
            return [(np.zeros(0, complex), 0.0)] * len(orbits)
        return multipliers_of(self._space, orbits)

    def errors_of(self, orbits: Sequence[Orbit], multipliers: Sequence[Multipliers]) -> Array:
        """Largest true errors of orbits and of mu; raises ArithmeticError where they are not at the same S."""
        if [orbit.S for orbit in orbits] != [orbit.S for orbit in self.orbits]:
            raise ArithmeticError(f"{len(orbits)} points at the S asked for; the reference has {len(self.orbits)}")
        return np.asarray(np.fmax.reduce(self._errors(orbits, multipliers)))

    def _errors(self, orbits: Sequence[Orbit], multipliers: Sequence[Multipliers]) -> Array:
        """Differences of each orbit and its mu from those of the reference, shape (orbits, 3)."""
        found, phases = list[tuple[float, float, float]](), np.linspace(0.0, 0.5 * np.pi, PROFILE_PHASES)
        for orbit, (mu, _), exact, (known, _) in zip(orbits, multipliers, self.orbits, self.mu, strict=True):
            right = exact.evaluate(phases / exact.Omega)
            profile = float(np.max(np.abs(orbit.evaluate(phases / orbit.Omega) - right)) / np.max(np.abs(right)))
            off = nan
            if mu.size == known.size > 0:
                off = float(np.max(np.abs(paired(known, mu) - known) / np.maximum(1.0, np.abs(known))))
            found.append((abs(orbit.Omega / exact.Omega - 1.0), profile, off))
        return np.array(found)

    def rows(self) -> Iterator[dict[str, object]]:
        """Rows of reference.csv: each orbit and how far that of the second transcription is from it."""
        for orbit, differences in zip(self.orbits, self.differences.tolist(), strict=True):
            yield dict(zip(self.COLUMNS, (orbit.S, orbit.Omega, *differences), strict=True))


# Measuring ----------------------------------------------------------------------------------------------------------


def timed(act: Callable[[], Result], repeats: int) -> tuple[Result, dict[str, float]]:
    """The last result, and the times of a setting by name, of `repeats` runs after a first one.

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


def measure(family: FamilyRequest, setting: Setting, reference: Reference, repeats: int) -> Setting:
    """A setting with its cost but for memory, and true errors; a failure is its reason in a line."""
    try:
        space, several = Family(setting.of(family)), positions(family) > 1
        if setting.kind == FLOW:
            mu, times = timed(lambda: multipliers_of(space, reference.orbits), repeats)
            errors = reference.errors_of(reference.orbits, mu)
            errors[:2] = nan
            size, points = (2 * positions(family)) ** 2, len(mu)
            told = any(estimate > setting.tolerance for _, estimate in mu)
        else:
            (branch, orbits), times = timed(lambda: followed(space, setting.kind == PRESET), repeats)
            own = setting.kind == PRESET and several
            mu = [(orbit.floquet().mu, 0.0) for orbit in orbits] if own else reference.multipliers(orbits)
            errors = reference.errors_of(orbits, mu)
            size, points = max(orbit.point.z.size for orbit in orbits), len(branch.orbits)
            told = any(orbit.point.at_round_off for orbit in orbits)
    except ArithmeticError as error:
        return replace(setting, failure=in_words(error))
    marked = largest(errors, setting.kind) <= largest(reference.agreement, setting.kind)
    shown = dict(zip((f"{name}_error" for name in ERRORS), np.maximum(errors, SMALLEST_ERROR).tolist(), strict=True))
    known: dict[str, Any] = {**times, **shown, "unknowns": size, "points": points, "told": told}
    return replace(setting, at_reference_round_off=marked, **known)


def peak_memory(task: tuple[FamilyRequest | None, bool] = (None, False), *_: object) -> float:
    """Peak resident memory of this process in MB, once it has followed a family; NaN where the system does not say."""
    family, stability = task
    if family is not None:
        followed(Family(family), stability)
    status = Path("/proc/self/status")  # getrusage counts the memory of the process that started this one, too
    peak = re.search(r"VmHWM:\s*(\d+)", status.read_text(encoding="utf-8")) if status.exists() else None
    if peak is not None:
        return 1.024e-3 * int(peak[1])
    try:
        import resource
    except ImportError:  # on Windows
        return nan
    return (1e-6 if sys.platform == "darwin" else 1.024e-3) * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def memory_of(family: FamilyRequest | None, stability: bool = False) -> float:
    """Peak memory in MB of a new process that follows a family, or only loads what that takes."""
    worker = Worker()
    try:
        return float(worker.compute(pickle.dumps(peak_memory), (family, stability)))
    finally:
        worker.end()


# The study: tables, a page of advice, a picture -----------------------------------------------------------------------


@dataclass
class WorkPrecision(Study):
    """The study of one family: tradeoff.csv, flows.csv, reference.csv, recommendations.md and a picture."""

    family: FamilyRequest
    quick: bool = False
    repeats: int = DEFAULT_REPEATS
    measured: list[Setting] = field(default_factory=list)

    part = "settings"

    def run(self) -> None:
        self.say("reference")
        reference = Reference(self.family)
        self.write_table("reference", Reference.COLUMNS, reference.rows())
        baseline = memory_of(None)
        settings = settings_of(self.family, QUICK_TOLERANCES if self.quick else MEASURED_TOLERANCES)
        self.say("warming up")  # the loading at a first use is no part of any setting's time
        for setting in {s.method: s for s in reversed(settings)}.values():
            measure(self.family, setting, reference, 0)

        def work(setting: Setting) -> None:
            measured, of_flow = measure(self.family, setting, reference, self.repeats), setting.kind == FLOW
            if not measured.failure and (not self.quick or setting.kind == PRESET):
                memory = memory_of(setting.of(self.family), setting.kind != ORBITS)
                measured = replace(measured, memory_MB=memory)
            self.measured.append(measured)
            rows = [m for m in self.measured if (m.kind == FLOW) == of_flow]
            self.write_rows("flows" if of_flow else "tradeoff", rows)

        try:
            self.work_through(settings, lambda setting: f"{setting.method}, tolerance {setting.tolerance:.0e}", work)
        finally:
            if any(m.seconds == m.seconds for m in self.measured):
                known = reference.agreement
                text = recommendations(self.family, self.measured, known, baseline, self.repeats)
                self.write_text("recommendations.md", text)
                self.write_figure("tradeoff", work_precision_figure(self.family, self.measured, known))

    def write_rows(self, stem: str, measured: Iterable[Setting]) -> None:
        """Write a table of settings."""
        self.write_table(stem, [column.name for column in fields(Setting)], map(asdict, measured))

    def report(self) -> Iterator[str]:
        yield from advices(self.measured)
        yield from map(preset_words, of_kind(self.measured, PRESET))


def run(arguments: argparse.Namespace) -> int:
    """The command `casadi-skin tradeoff`; returns its exit status."""
    if arguments.repeats is not None and arguments.repeats < 1:
        raise InputError(f"tradeoff: given --repeats {arguments.repeats}; accepted: a whole number >= 1")
    family = family_request(Chain(24, 1.0, 0.25, -1.0), 1, 1.0, at=DEFAULT_AT)  # the paper's softening end breather
    if arguments.scene is not None:
        family = _family_of(arguments.scene)
    repeats = arguments.repeats or (1 if arguments.quick else DEFAULT_REPEATS)
    return run_study(WorkPrecision(arguments.out, family, arguments.quick, repeats), arguments)


def _family_of(path: Path) -> FamilyRequest:
    """The first family of a scene, with every position an unknown and by default methods."""
    scene = read_scene(path)
    families = [] if scene.family is None else bound(scene, path).families
    if not families or families[0].coordinates.localised is not None:
        accepted = "a scene with a table [family], and a model of finite length"
        raise InputError(f"{path}: asks for no family that can be measured; accepted: {accepted}")
    family, end = families[0], families[0].amplitude_max
    at = family.targets.at or tuple(end * part / PARTS_OF_FAMILY for part in range(1, PARTS_OF_FAMILY + 1))
    return FamilyRequest(family.model, family.mode, end, Targets(at), parameters=family.parameters, method=Method())


# Words --------------------------------------------------------------------------------------------------------------


def of_kind(measured: Iterable[Setting], kind: str) -> list[Setting]:
    """The settings of a kind."""
    return [m for m in measured if m.kind == kind]


def duration(seconds: float) -> str:
    """A time with about three digits and its unit."""
    if seconds >= 1.0:
        return f"{seconds:.2f} s"
    return f"{1e3 * seconds:.0f} ms" if seconds >= 0.1 else f"{1e3 * seconds:.3g} ms"


def front_of(measured: Sequence[Setting], kind: str, known: Array) -> list[Setting]:
    """The settings of a kind that no other beats in time or error without losing in the other, by rising time.

    Errors within a factor EQUAL_ERRORS, and those up to that of the reference, count as equal.
    """
    floor, front = float(np.nan_to_num(largest(known, kind))), list[Setting]()
    requested = [m for m in of_kind(measured, kind) if m.seconds == m.seconds and m.error == m.error]
    for m in sorted(requested, key=lambda m: (m.seconds, max(m.error, floor))):
        if not front or EQUAL_ERRORS * max(m.error, floor) < max(front[-1].error, floor):
            front.append(m)
    return front


def advice(settings: Sequence[Setting], wanted: float) -> str:
    """The setting to use to a wanted error, and how much faster that is than the next method.

    Settings count whose tolerance promises the wanted error and whose true error keeps it.
    """
    kept = [m for m in settings if m.tolerance <= 1.001 * wanted and m.error <= wanted]
    if not kept:
        return "no setting measured here promises and keeps it"
    best = min(kept, key=lambda m: m.seconds)
    words = f"{best.method} at tolerance {best.tolerance:.0e}, {duration(best.seconds)}"
    others = [m for m in kept if m.method != best.method]
    if not others:
        return f"{words}; no other method reaches it"
    following = min(others, key=lambda m: m.seconds)
    name = f"{following.method} ({duration(following.seconds)})"
    noise = SINGLE_RUN_NOISE if following.seconds_min == following.seconds_max else MEDIAN_NOISE
    if best.seconds >= following.seconds_min or noise * best.seconds >= following.seconds:
        return f"{words}; not distinguished by these times from {name}"
    return f"{words}; {following.seconds / best.seconds:.2g} times faster than the next, {name}"


def advices(measured: Sequence[Setting]) -> list[str]:
    """A line for each kind of result and errors with the same advice."""
    tolerances = sorted({m.tolerance for m in measured if m.kind != PRESET}, reverse=True)
    lines = []
    for settings, what in ((of_kind(measured, ORBITS), "Omega and the profile"), (of_kind(measured, FLOW), "mu")):
        for text, group in groupby(tolerances if settings else (), key=lambda wanted: advice(settings, wanted)):
            wanted = [f"{tolerance:.0e}" for tolerance in group]
            span = wanted[0] if len(wanted) == 1 else f"{wanted[0]} and down to {wanted[-1]}"
            lines.append(f"For {what} to {span}: {text}.")
    return lines


def preset_words(preset: Setting) -> str:
    """The cost of a preset and its true errors."""
    start = f"`{preset.method}` ({preset.tolerance:.0e}): "
    if preset.failure:
        return f"{start}{preset.failure}."
    errors = zip(ERRORS, preset.errors.tolist(), strict=True)
    known = ", ".join(f"{name} {error:.1e}" for name, error in errors if error == error)
    over, cost = preset.error / preset.tolerance, f"{duration(preset.seconds)} with multipliers"
    kept = "kept" if over <= 1.0 else f"missed by a factor {over:.2g}"
    return f"{start}{cost} and {preset.points} points; true errors {known}; the tolerance is {kept}."


def front_words(measured: Sequence[Setting], kind: str, known: Array) -> Iterator[str]:
    """The methods of the Pareto front by rising time."""
    front, parts = front_of(measured, kind, known), []
    for method, group in groupby(front, key=lambda m: m.method):
        points = [f"{m.error:.1e} in {duration(m.seconds)}" for m in group]
        parts.append(f"{method} " + (f"from {points[0]} to {points[-1]}" if len(points) > 1 else f"at {points[0]}"))
    what, count = "orbits" if kind == ORBITS else "multipliers", len(of_kind(measured, kind))
    if front:
        yield f"The Pareto front of {what}, {len(front)} of {count} settings: {'; '.join(parts)}."


def broken_promises(measured: Sequence[Setting]) -> Iterator[str]:
    """Settings whose true error is above their tolerance, and those that failed, each a line."""
    for m in measured:
        where, over = f"{m.method}, tolerance {m.tolerance:.0e}", m.error / m.tolerance
        if m.failure:
            yield f"{where}: no result: {m.failure}."
        elif over > 1.0 and not m.at_reference_round_off:
            said = "the program says so" if m.told else "the program does not say so"
            yield f"{where}: true error {m.error:.1e}, {over:.2g} times that; {said}."


def table(measured: Sequence[Setting]) -> Iterator[str]:
    """Lines of a table in Markdown: settings at a few tolerances, and the presets."""
    heads = ("method", "tolerance", "time (least to most)", "building", "peak memory", "unknowns")
    yield f"| {' | '.join((*heads, 'error of Omega', 'profile', 'mu'))} |"
    yield "| --- |" + " ---: |" * 8
    for m in measured:
        if m.failure or not any(math.isclose(m.tolerance, tolerance) for tolerance in TABLE_TOLERANCES):
            continue
        spread = f" ({duration(m.seconds_min)} to {duration(m.seconds_max)})" if m.seconds_min < m.seconds_max else ""
        cells = (
            f"{'' if m.kind == ORBITS else m.kind + ' '}{m.method}{'*' if m.at_reference_round_off else ''}",
            f"{m.tolerance:.0e}",
            duration(m.seconds) + spread,
            duration(m.building_seconds),
            f"{m.memory_MB:.0f} MB" if m.memory_MB == m.memory_MB else "",
            f"{m.unknowns}",
            *("" if value != value else f"{value:.1e}" for value in m.errors.tolist()),
        )
        yield f"| {' | '.join(cells)} |"


def recommendations(
    family: FamilyRequest, measured: Sequence[Setting], known: Array, baseline: float, repeats: int
) -> str:
    """The whole page as Markdown: measurements, recommendations, places of the presets, and the table."""
    own, (Omega, profile, mu) = family.method.transcription, known.tolist()
    of_mu = f", and their mu to {mu:.1e}" if mu == mu else ""
    timed = [m for m in measured if m.processor_share == m.processor_share]
    share = sum(m.processor_share * m.seconds for m in timed) / (sum(m.seconds for m in timed) or 1.0)
    busy = f" The machine was busy: the process had a processor for {share:.0%} of the time that passed."
    starts = f"is that of a process of its own, {baseline:.0f} MB of which it takes to start"
    memory = starts if baseline == baseline else "is not told by this system"
    text = (
        f"Family j = {family.mode} of {title(family.model, family.parameters)} to S = {family.amplitude_max:g}; errors "
        f"are true, relative, the largest at S = {', '.join(f'{S:.6g}' for S in family.targets.at)}, against orbits by "
        f"{own} to {TIGHTEST_TOLERANCE:.0e}. A second transcription agrees with these to "
        f"{max(Omega, SMALLEST_ERROR):.1e} of Omega and {profile:.1e} of the profile{of_mu}; settings as good "
        f"as that are marked *. Processor times: medians of {repeats} run{'s' if repeats > 1 else ''} after a first "
        f"one, whose surplus is the building; of flows, for the multipliers of all these orbits. The mu of orbits are "
        f"those along them at the tightest tolerance. Peak memory {memory}; "
        f"of flows, with the family.{busy if timed and share <= IDLE_SHARE else ''}"
    )
    sections = {
        "What to use": advices(measured),
        "Where the presets sit": [preset_words(m) for m in of_kind(measured, PRESET)],
        "Pareto fronts": [words for kind in (ORBITS, FLOW) for words in front_words(measured, kind, known)],
        "Not kept": list(broken_promises(measured)),
    }
    parts = ["# What accuracy costs", text]
    parts += [f"## {name}\n\n" + "\n".join(f"- {line}" for line in lines) for name, lines in sections.items() if lines]
    if positions(family) > SHOOTING_POSITIONS:
        reason = f"{positions(family)} positions move, and it is measured up to {SHOOTING_POSITIONS}"
        parts.append(f"Shooting is left out: {reason}, as it integrates the sensitivity of every state to every one.")
    return "\n\n".join([*parts, "## Measured\n\n" + "\n".join(table(measured))]) + "\n"


# The picture --------------------------------------------------------------------------------------------------------

TRANSCRIPTION_MARKERS, FLOW_MARKERS = "os^D", "Pv<X"
LOWEST_ERROR = 1e-17  # of the axes


def _look(setting: Setting) -> dict[str, Any]:
    """Marker, colour and line of a method: full markers are Newton's, open ones Ipopt's; series are dashed."""
    of_flow = setting.kind == FLOW
    names, markers = (list(FLOWS), FLOW_MARKERS) if of_flow else (list(TRANSCRIPTIONS), TRANSCRIPTION_MARKERS)
    place = names.index(setting.flow if of_flow else setting.transcription)
    colour, marker = colours(len(names))[place], markers[place % len(markers)]
    dashes = (0, (4.0, 1.5)) if setting.walker == "series" else "-"
    look: dict[str, Any] = {"marker": marker, "color": colour, "ls": dashes, "ms": 5.5 if of_flow else 5.0}
    return look | ({"mfc": "white"} if setting.corrector == "ipopt" else {})


def _draw(axes: Axes, measured: Sequence[Setting], kind: str, known: Array) -> None:
    """Each method a line through its tolerances, the front behind them, the presets, and the reference's round-off."""
    for method, group in groupby([m for m in of_kind(measured, kind) if not m.failure], key=lambda m: m.method):
        those = list(group)
        middle, low, high = np.array([[m.seconds, m.seconds_min, m.seconds_max] for m in those]).T
        spread = np.maximum([middle - low, high - middle], 0.0)
        label = f"flow: {method}" if kind == FLOW else method
        looks: dict[str, Any] = {"lw": 0.9, "elinewidth": 0.6, "zorder": 3, **_look(those[0])}
        axes.errorbar(middle, [m.error for m in those], xerr=spread, label=label, **looks)
    front = np.array([[m.seconds, m.error] for m in front_of(measured, kind, known)])
    if front.size:
        axes.step(*front.T, where="post", color="0.75", lw=5.0, label="Pareto front", zorder=1, solid_capstyle="round")
    label = "preset, orbits and multipliers"
    for m in of_kind(measured, PRESET):
        error = largest(m.errors, kind)
        if error == error:
            axes.plot(m.seconds, error, "*", label=label, zorder=6, ms=11, mfc="black", mec="white", mew=0.8)
            box = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.6}
            axes.annotate(m.method, (m.seconds, error), (7, 6), textcoords="offset points", zorder=7, bbox=box)
            label = "_"
    axes.set(xscale="log", yscale="log")
    axes.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))  # labels of more in a decade overlap
    low, high = axes.get_ylim()
    floor = largest(known, kind)
    if floor > 0:
        label = "at the reference's round-off"
        axes.axhspan(LOWEST_ERROR, floor, fc="0.93", ec="0.6", lw=0.6, hatch="....", label=label, zorder=0)
        low = min(low, floor / 10.0)
    axes.set_ylim(max(low, LOWEST_ERROR), high * 2.0)


@drawn
def work_precision_figure(family: FamilyRequest, measured: Sequence[Setting], known: Array) -> Figure:
    """True error against time: orbits at the left, multipliers at the right; bars from the least to the most time.

    Errors up to those in `known`, by which the references differ, lie in a hatched band.
    """
    figure = blank(10.6, 6.0)
    orbits, multipliers = figure.subplots(1, 2)
    _draw(orbits, measured, ORBITS, known)
    _draw(multipliers, measured, FLOW, known)
    lows, highs = zip(orbits.get_ylim(), multipliers.get_ylim(), strict=True)
    for axes in (orbits, multipliers):
        axes.set_ylim(min(lows), max(highs))
    of_orbits, of_mu = (
        r"relative error of $\Omega$ or of the profile, the larger",
        r"error of $\mu$ relative to $\max(1, |\mu|)$",
    )
    orbits.set(xlabel="processor time for the family without multipliers (s)", ylabel=of_orbits)
    multipliers.set(xlabel=f"processor time for the multipliers of {len(family.targets.at)} orbits (s)", ylabel=of_mu)
    letter(orbits, "a", "orbits: transcription, walker, corrector")
    letter(multipliers, "b", "multipliers: flow map")
    if not of_kind(measured, FLOW):
        words = "no multipliers measured"
        multipliers.text(0.5, 0.5, words, ha="center", va="center", transform=multipliers.transAxes)
    model = title(family.model, family.parameters)
    figure.suptitle(rf"$j = {family.mode}$ to $S = {family.amplitude_max:g}$, {model}")
    return finished(figure, (orbits, multipliers), 4)
