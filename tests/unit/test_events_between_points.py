"""Multipliers that cross the circle and come back between two points of a branch: how many the search finds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cycles_in_closed_form import Block, Truth
from scipy.integrate import quad

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.events import Event, _Free, events_between
from casadi_skin.follow.point import Joined
from casadi_skin.follow.samples import Crossing, Sample, SampledStretch
from casadi_skin.follow.search import TANGENT_DIFFERENCE_STEP, ExponentSampler, beside_on_tangent
from casadi_skin.follow.special_points import _Turns
from casadi_skin.stability.result import FULL_TURN, Exponents
from casadi_skin.zero.kinds import CROSSING_KINDS
from casadi_skin.zero.settings import ErrorEstimate, Point

Growth = Callable[[Any], Any]
BELLS: list[Growth] = [lambda u: np.exp(-u * u), lambda u: 1 / (1 + u * u), lambda u: 1 / np.cosh(u) ** 2]
LINE: Any = SimpleNamespace(prolong=lambda z, other: z, parameter_index=0, may_move=False)


def at(s: float) -> Point:
    """The point of a straight branch at a place along it."""
    return Point(LINE, np.array([s]), np.ones(1), ErrorEstimate(0.0, 0.0), 1.0, 0)


@dataclass
class Line:
    """A straight branch with one multiplier whose logarithm is given and one inside; what is computed is counted."""

    growth: Growth
    sets: int = 0
    corrected: int = 0

    def exponents(self, point: Point) -> Exponents:
        s = float(point.z[0])
        return Exponents(np.array([self.growth(s), -2.0 - 0.05 * s], dtype=complex), np.full(2, 1e-9))

    def alone(self, point: Point) -> Any:
        self.sets += 1
        return SimpleNamespace(exponents=self.exponents(point))

    def ahead(self, point: Point) -> Any:
        return self.alone(beside_on_tangent(point, TANGENT_DIFFERENCE_STEP))

    def metric(self, *_: Any) -> Any:
        return np.ones(1)

    def joined(self, first: Point, last: Point) -> Joined:
        return Joined(first.z, first.tangent, np.ones(1), last)

    def unrefined_along(self, before: Point, after: Point, fraction: float) -> Point:
        self.corrected += 1
        return at(before.z[0] + fraction * (after.z[0] - before.z[0]))

    def found(self, places: Any) -> int:
        """The number of events between points at places, in order."""
        space: Any = SimpleNamespace(point_solver=self, multipliers_alone=self.alone, multipliers_ahead=self.ahead)
        space.parameter, space.value = "s", lambda name, point: float(point.z[0])
        known, found, sampler = [(point, self.exponents(point)) for point in map(at, places)], 0, None
        for ends in pairwise(known):
            length = float(ends[1][0].z[0] - ends[0][0].z[0])
            sampler = ExponentSampler(space, *ends, length=length, before=sampler)
            found += len(events_between(space, sampler)[0])
        return found


def flat(random: np.random.Generator, dip: Growth, centre: float) -> Growth:
    size, length = 10 ** random.uniform(-3, 0.5), random.uniform(4, 40) * random.choice([-1, 1])
    return lambda s: size * (1 + 0.8 * np.tanh((s - centre) / length) - dip(s))


def valley(random: np.random.Generator, dip: Growth, centre: float) -> Growth:
    floor, power = 10 ** random.uniform(-3, 0), random.choice([2, 4])
    return lambda s: np.abs((s - centre) / 3) ** power + floor * (1 - dip(s))


def slope(random: np.random.Generator, dip: Growth, centre: float) -> Growth:
    size, rate = 10 ** random.uniform(-3, 0.5), random.uniform(0.1, 0.8) * random.choice([-1, 1])
    return lambda s: size * (np.exp(rate * (s - centre)) - dip(s))


def parabola(random: np.random.Generator, dip: Growth, centre: float) -> Growth:
    """A parabola through zero twice in place of the dip: values before foretell those behind."""
    size, half, lean = 10.0 ** random.uniform((-3, -2, -6), (0.5, 0.3, -1))
    return lambda s: size * ((s - centre) ** 2 - half**2) * (1 + lean * (s - centre))


@pytest.mark.parametrize(
    ("shape", "least", "sets"), [(flat, 0.9, 1.6), (valley, 0.95, 2.1), (slope, 0.92, 1.8), (parabola, 1.0, 3.0)]
)
def test_crossings_there_and_back_within_a_step_are_found_as_often_as_with_a_sample_on_every_step(
    shape: Callable[..., Growth], least: float, sets: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dips from a sixth of a step to five steps wide, on steps of 0.8 to 1.25.

    With rates computed for each stretch anew and a corrected point on each that its ends do not clear it was 0.911,
    0.953 and 0.936 of 1200 models each, with 3.1, 4.6 and 3.6 sets of multipliers a step.
    """

    def located(search: _Free, stretch: SampledStretch, passage: Crossing) -> Event:
        place = search.sigma(stretch.first.point) + stretch.root(stretch.leading + passage.quantity)
        return Event(place / search.length, None, passage.kind, passage.angle, passage.jump)  # type: ignore[arg-type]

    monkeypatch.setattr(_Free, "located", located)
    random, found, planted, computed, steps = np.random.default_rng(1), 0, 0, 0, 0
    for _ in range(80):
        centre, width, over = random.uniform(5, 7), 10 ** random.uniform(-0.8, 0.7), 1 + 10 ** random.uniform(-2, 0.3)
        bell = BELLS[random.integers(3)]
        line = Line(shape(random, lambda s: over * bell((s - centre) / width), centre))  # noqa: B023
        places = random.uniform(0, 1) + np.append(0.0, np.cumsum(random.uniform(0.8, 1.25, 12)))
        with np.errstate(over="ignore"):
            values = line.growth(np.linspace(places[0], places[-1], 20_001))
            many, crossings = line.found(places), int(np.sum(values[1:] * values[:-1] < 0.0))
        assert many <= crossings
        found, planted = found + many, planted + crossings
        computed, steps = computed + line.sets, steps + places.size - 1
    assert found >= least * planted
    assert computed <= sets * steps


def test_multipliers_far_from_the_circle_are_computed_once_a_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside those with their errors, at each point of a branch; near the circle once more, for their rates."""
    computed, alone = list[float](), BoundarySpace.multipliers_alone

    def counted(space: BoundarySpace, point: Point) -> Any:
        computed.append(point.parameter)
        return alone(space, point)

    monkeypatch.setattr(BoundarySpace, "multipliers_alone", counted)
    far: Any = Truth((Block((-0.3, -0.1), 0.7),)).follow()
    assert len(computed) <= 0.3 * len(far.values)
    computed.clear()
    near: Any = Truth((Block((-0.01, -0.3), 0.7),)).follow()
    assert len(computed) <= 1.3 * len(near.values)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_real_multiplier_that_passes_zero_within_a_step_crosses_where_it_is_outside(way: float) -> None:
    """From 0.9 to -3.1, or back: the period doubles."""

    def exponents(s: float) -> Any:
        mu = 0.9 - 4.0 * (s if way > 0.0 else 1.0 - s)
        values = np.array([np.log(abs(mu)) + (1j * np.pi if mu < 0.0 else 0.0)])
        return Exponents(values, np.full(1, 1e-9)), np.array([-4.0 * way / mu], dtype=complex)

    ends = [(at(s), *exponents(s)) for s in (0.0, 1.0)]
    samples = tuple(
        Sample(point, np.ones(1), known.values, rates, known.noise, turn=FULL_TURN) for point, known, rates in ends
    )
    (crossing,) = SampledStretch.of(samples).crossings(CROSSING_KINDS)
    assert (crossing.kind, crossing.angle, crossing.jump) == ("period doubling", np.pi, int(way))


@pytest.mark.parametrize("growth", [-3.0, 2.0])
@pytest.mark.parametrize("place", [0.3, 0.5, 0.7])
def test_two_folds_on_a_stretch_are_no_growth_along_a_canard(growth: float, place: float) -> None:
    """The parameter is the integral of its rate, which is exponential, but for a dip below zero."""
    problem: Any = SimpleNamespace(parameter_index=1, parameter_size=lambda z: 1.0)
    search: Any = SimpleNamespace(moving=problem, row=np.array([1.0, 0.0]), sigma=lambda point: point.z[0])

    def grows(dip: float, error: float = 0.0) -> bool:
        def rate(s: float) -> float:
            return float(1e-6 * np.exp(growth * s) * (1.0 - dip * np.exp(-(((s - place) / 0.15) ** 2))))

        estimate = ErrorEstimate(0.0, 0.0, parameter=error)
        places = ((0.0, 0.0), (1.0, quad(rate, 0.0, 1.0, epsabs=0.0)[0]))
        ends = (Point(problem, np.array(z), np.array([1.0, rate(z[0])]), estimate, 1.0, 0) for z in places)
        return _Turns._grows(search, *ends)

    assert grows(0.0)
    assert not grows(1.2)
    assert not grows(0.0, 1e-6)  # where errors of the parameter hide it
