"""Measuring settings: the time of repeated runs, the memory of one more, and the true errors of what came out."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from math import nan
from statistics import median
from typing import TypeVar

import numpy as np

from casadi_skin.orbits.family import Family
from casadi_skin.orbits.follow import Following
from casadi_skin.stability.result import Floquet
from casadi_skin.studies.work_precision.measured import SMALLEST, Kind, Measured, Setting
from casadi_skin.studies.work_precision.memory import memory_of
from casadi_skin.studies.work_precision.reference import (
    TIGHTEST_FLOW,
    Errors,
    Reference,
    floquets_along,
    mu_distance,
    requested_orbits,
    seen,
    walked,
)

Result = TypeVar("Result")
Times = tuple[float, float, float, float, float]
TICK = 1e-6  # seconds, which no processor time is below
SHORTEST = 0.02  # seconds that one timing lasts


def measure(setting: Setting, reference: Reference, repeats: int, with_memory: bool) -> Measured:
    """Cost and true errors of a setting; where it fails, a line that tells why in place of a result."""
    try:
        act = _flow if setting.kind is Kind.FLOW else _family
        measured = act(setting, reference, repeats)
    except ArithmeticError as error:
        return Measured(setting, failure=" ".join(str(error).split()))
    return replace(measured, memory=memory_of(setting)) if with_memory else measured


def timed(act: Callable[[], Result], repeats: int) -> tuple[Result, Times]:
    """The last result, and the times of `Measured` in its order, of `repeats` runs after a first one.

    Of a short run several are timed together; without repeats there is no time.
    """
    started = time.process_time()
    result = act()
    first = time.process_time() - started
    together = 1
    times: list[float] = []
    elapsed = 0.0
    while len(times) < repeats:
        started, clock = time.process_time(), time.perf_counter()
        for _ in range(together):
            result = act()
        seconds = max((time.process_time() - started) / together, TICK)
        if together == 1 and seconds < SHORTEST:
            together = math.ceil(SHORTEST / seconds) + 1
            continue
        times.append(seconds)
        elapsed += (time.perf_counter() - clock) / together
    if not times:
        return result, (nan, nan, nan, nan, nan)
    middle = median(times)
    return result, (middle, min(times), max(times), max(first - middle, 0.0), sum(times) / elapsed)


def _family(setting: Setting, reference: Reference, repeats: int) -> Measured:
    """A family without multipliers, whose mu are then computed along its orbits; or a whole run, with its own."""
    stability = setting.kind is Kind.PRESET
    tools = Family(setting.request)

    def act() -> Following:
        walk = walked(tools, stability)
        requested_orbits(walk)  # a family that ends early is not walked again
        return walk

    walk, times = timed(act, repeats)
    orbits = requested_orbits(walk)
    if stability and tools.coordinates.core.sites > 1:
        found = [orbit.floquet() for orbit in orbits]
    else:
        found = floquets_along(tools, reference.flow, [orbit.point for orbit in orbits], TIGHTEST_FLOW)
    errors = reference.errors_of([seen(orbit, f.mu) for orbit, f in zip(orbits, found, strict=True)])
    unknowns = max(orbit.point.problem.size for orbit in walk.orbits)
    told = any(orbit.at_round_off for orbit in orbits) or (stability and any(_over(f, setting) for f in found))
    measured = Measured(setting, *times, unknowns=unknowns, points=len(walk.orbits), told=told)
    return _judged(measured, errors, reference)


def _flow(setting: Setting, reference: Reference, repeats: int) -> Measured:
    """Multipliers along the orbits of the reference."""
    tools = Family(setting.request)
    points = [orbit.point for orbit in reference.orbits]
    found, times = timed(lambda: floquets_along(tools, tools.flow, points, setting.tolerance), repeats)
    distances = [mu_distance(truth.mu, f.mu) for truth, f in zip(reference.truths, found, strict=True)]
    told, unknowns = any(_over(f, setting) for f in found), tools.coordinates.scaled.full_size**2
    measured = Measured(setting, *times, unknowns=unknowns, points=len(points), told=told)
    return _judged(measured, Errors(nan, nan, max(distances)), reference)


def _over(found: Floquet, setting: Setting) -> bool:
    """Whether the estimated error of a mu is above the tolerance."""
    return bool(np.any(found.mu_error > setting.tolerance * np.maximum(1.0, np.abs(found.mu))))


def _judged(measured: Measured, errors: Errors, reference: Reference) -> Measured:
    """With its errors, marked where the reference is not known well enough for those that the tolerance bounds."""
    known = reference.agreement
    pairs = ((errors.Omega, known.Omega), (errors.profile, known.profile), (errors.mu, known.mu))
    values = [max(error, SMALLEST) if error == error else error for error, _ in pairs]
    judged = replace(measured, Omega_error=values[0], profile_error=values[1], mu_error=values[2])
    floor = {
        Kind.ORBITS: max(known.Omega, known.profile),
        Kind.FLOW: known.mu,
        Kind.PRESET: np.nanmax([known.Omega, known.profile, known.mu]),
    }[measured.setting.kind]
    return replace(judged, at_reference=bool(judged.error <= floor))
