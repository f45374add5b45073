"""Measuring settings: the time of repeated runs, the memory of one more, and the true errors of the results.

The peak memory is that of a process of its own: `python -m` with the name of this module.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from math import nan
from pathlib import Path
from statistics import median
from timeit import Timer
from typing import TypeVar

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.stability.result import ReversibleFloquet
from casadi_skin.studies.exact_multipliers import reduced
from casadi_skin.studies.work_precision.computing import Computation, requested_orbits
from casadi_skin.studies.work_precision.reference import Errors, Reference
from casadi_skin.studies.work_precision.settings import SMALLEST, Kind, Measured, Setting, bounded

Result = TypeVar("Result")
TICK = 1e-6  # seconds, which no processor time is below
SHORTEST = 0.02  # seconds that one timing lasts
MEGABYTE = 1e6
LONGEST = 3600.0  # seconds


def measure(setting: Setting, reference: Reference, repeats: int, with_memory: bool) -> Measured:
    """Cost and true errors of a setting; where it fails, the reason in a line in place of a result."""
    try:
        measured = (_measure_flow if setting.kind is Kind.FLOW else _measure_family)(setting, reference, repeats)
    except ArithmeticError as error:
        return Measured(setting, failure=" ".join(str(error).split()))
    return replace(measured, memory_MB=memory_of(setting)) if with_memory else measured


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
    together = 1 if once >= SHORTEST else math.ceil(SHORTEST / max(once, TICK)) + 1
    times = [max(seconds / together, TICK) for seconds in timer.repeat(repeats, together)]
    share, middle = (once + together * sum(times)) / (time.perf_counter() - clock), median(times)
    known = {"seconds": middle, "seconds_min": min(times), "seconds_max": max(times), "processor_share": share}
    return results[0], {**known, "building_seconds": max(first - middle, 0.0)}


def _measure_family(setting: Setting, reference: Reference, repeats: int) -> Measured:
    """A family without multipliers, whose mu are then computed along its orbits; or a whole run, with its own."""
    stability, computation = setting.kind is Kind.PRESET, Computation(setting)

    def follow() -> tuple[Branch, list[Orbit]]:
        branch = computation.follow(stability)
        return branch, requested_orbits(branch)  # a family that ends early is not followed again

    (branch, orbits), times = timed(follow, repeats)
    found = [reduced(orbit) for orbit in orbits] if stability else reference.multipliers(orbits)
    told = any(orbit.at_round_off for orbit in orbits) or (stability and any(_over(f, setting) for f in found))
    size = max(orbit.point.problem.size for orbit in branch.orbits)
    measured = Measured(setting, **times, unknowns=size, points=len(branch), told=told)  # type: ignore[arg-type]
    return _judged(measured, reference.errors_of(orbits, found), reference.agreement)


def _measure_flow(setting: Setting, reference: Reference, repeats: int) -> Measured:
    """Multipliers along the orbits of the reference."""
    computation, orbits = Computation(setting), reference.orbits
    found, times = timed(lambda: computation.multipliers(orbits), repeats)
    errors = Errors(nan, nan, reference.errors_of(orbits, found).mu)
    told, size = any(_over(floquet, setting) for floquet in found), 2 * setting.family.chain.sites
    measured = Measured(setting, **times, unknowns=size**2, points=len(orbits), told=told)  # type: ignore[arg-type]
    return _judged(measured, errors, reference.agreement)


def _over(found: ReversibleFloquet, setting: Setting) -> bool:
    """Whether the estimated error of a mu is above the tolerance."""
    return bool(np.any(found.mu_error > setting.tolerance * np.maximum(1.0, np.abs(found.mu))))


def _judged(measured: Measured, errors: Errors, known: Errors) -> Measured:
    """With its errors, marked where the reference is not known well enough for those that the tolerance bounds."""
    Omega, profile, mu = (max(error, SMALLEST) if error == error else error for error in errors)
    judged = replace(measured, Omega_error=Omega, profile_error=profile, mu_error=mu)
    return replace(judged, at_reference_round_off=judged.error <= bounded(measured.setting.kind, *known))


# Memory -------------------------------------------------------------------------------------------------------------


def peak_memory() -> float:
    """Peak resident memory of this process so far in MB; nan where the system does not report it.

    From /proc where there is one: the peak that getrusage gives there counts the memory of the process that started
    this one.
    """
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text(encoding="utf-8").splitlines() if ":" in line)
        if "VmHWM" in lines:
            return 1024.0 * int(lines["VmHWM"].split()[0]) / MEGABYTE
    try:
        import resource
    except ImportError:
        return nan
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEGABYTE


def memory_of(setting: Setting | None) -> float:
    """Peak memory in MB of a process that computes the setting once, or only imports what it takes; nan after an hour.

    Of a flow: the family with its multipliers, at the same tolerance. Raises ArithmeticError where the process fails.
    """
    stability = setting is not None and setting.kind is not Kind.ORBITS
    request = None if setting is None else [asdict(setting.family), setting.methods | {"stability": stability}]
    words = json.dumps(request)
    try:
        done = subprocess.run(
            [sys.executable, "-m", __name__, words], capture_output=True, text=True, timeout=LONGEST, check=True
        )
    except subprocess.TimeoutExpired:
        return nan
    except subprocess.CalledProcessError as error:
        reason = (error.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise ArithmeticError(f"peak memory of {words} was not measured: {reason}") from error
    return float(done.stdout)


def main(words: str) -> None:
    """Follow the family of a request, once, and print the peak memory in MB."""
    request = json.loads(words)
    if request is not None:
        family, options = request
        follow_family(Chain(**family.pop("chain")), **family, **options)
    print(peak_memory())


if __name__ == "__main__":
    main(sys.argv[1])
