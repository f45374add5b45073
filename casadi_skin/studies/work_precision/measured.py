"""What the trade-off of speed for accuracy consists of: settings, what was measured of each, and the Pareto front."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from math import nan

from casadi_skin.orbits.request import family_request
from casadi_skin.results.tables import Cell
from casadi_skin.scene import CORRECTORS, FLOWS, PRESET_TOLERANCES, TRANSCRIPTIONS, WALKERS

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
QUICK_TOLERANCES = (1e-4, 1e-8, 1e-12)
SHOOTING_SITES = 6  # shooting integrates the sensitivities of all states to all: measured up to here
SAME_ERROR = 1.5  # factor between errors that count as equal on a Pareto front
SMALLEST = 1e-16  # what stands for an error of exactly zero


class Kind(Enum):
    """What a setting computes."""

    ORBITS = "orbits"  # the family without multipliers
    FLOW = "flow"  # multipliers of orbits that are given
    PRESET = "preset"  # the family with multipliers and changes of stability, by the default methods


@dataclass(frozen=True)
class Setting:
    """Methods and a tolerance; `name` is that of a preset."""

    kind: Kind
    request: FamilyRequest
    name: str = ""

    @property
    def tolerance(self) -> float:
        """The tolerance asked for."""
        return self.request.tolerance

    @property
    def method(self) -> str:
        """Its methods in words, or the preset."""
        request = self.request
        if self.kind is Kind.PRESET:
            return self.name
        if self.kind is Kind.FLOW:
            return request.flow
        return f"{request.transcription}, {request.way}, {request.corrector}"


@dataclass(frozen=True)
class Measured:
    """Cost and true errors of one setting.

    Processor times in seconds: the median of repeated runs with the least and the most, and apart from these what the
    first run took longer to build; `processor` is their share in the time that passed. Memory in MB: the peak of a
    process that does nothing else. Errors are relative, the largest over the points; nan where there is none.
    `told` is whether the program says of its own result that the tolerance was out of reach; `failure` tells in a line
    why there is none.
    """

    setting: Setting
    seconds: float = nan
    fastest: float = nan
    slowest: float = nan
    building: float = nan
    processor: float = nan
    memory: float = nan
    unknowns: int = 0
    points: int = 0
    Omega_error: float = nan
    profile_error: float = nan
    mu_error: float = nan
    at_reference: bool = False  # the references differ by as much
    told: bool = False
    failure: str = ""

    @property
    def orbit_error(self) -> float:
        """The larger of the errors of Omega and of the profile."""
        return max(self.Omega_error, self.profile_error)

    @property
    def error(self) -> float:
        """The largest error that the tolerance bounds."""
        bounded = {
            Kind.ORBITS: [self.Omega_error, self.profile_error],
            Kind.FLOW: [self.mu_error],
            Kind.PRESET: [self.Omega_error, self.profile_error, self.mu_error],
        }[self.setting.kind]
        return max((value for value in bounded if value == value), default=nan)

    def row(self) -> dict[str, Cell]:
        """Cells by column; empty where there is nothing."""
        request, kind = self.setting.request, self.setting.kind
        numbers = (self.seconds, self.fastest, self.slowest, self.building, self.memory)
        errors = (self.Omega_error, self.profile_error, self.mu_error)
        values: tuple[Cell, ...] = (
            kind.value,
            self.setting.method,
            "" if kind is Kind.FLOW else request.transcription,
            "" if kind is Kind.FLOW else request.way,
            "" if kind is Kind.FLOW else request.corrector,
            "" if kind is Kind.ORBITS else request.flow,
            request.tolerance,
            *("" if value != value else value for value in numbers),
            self.unknowns,
            self.points,
            *("" if value != value else value for value in errors),
            "" if self.processor != self.processor else self.processor,
            int(self.at_reference),
            int(self.told),
            self.failure,
        )
        return dict(zip(COLUMNS, values, strict=True))


COLUMNS = (
    *("kind", "method", "transcription", "walker", "corrector", "flow", "tolerance"),
    *("seconds", "seconds_min", "seconds_max", "building_seconds", "memory_MB", "unknowns", "points"),
    *("Omega_error", "profile_error", "mu_error", "processor_share", "at_reference_round_off", "told", "failure"),
)


def pareto_front(points: Sequence[tuple[float, float]], same: float = 1.0) -> list[int]:
    """Indices of the points (cost, error) that no other beats in one without losing in the other, by rising cost.

    Errors within a factor `same` count as equal, and of equal points the cheapest stays. Points with nan are left out.
    """
    front: list[int] = []
    order = sorted((i for i, p in enumerate(points) if p[0] == p[0] and p[1] == p[1]), key=lambda i: points[i])
    for i in order:
        if not front or same * points[i][1] < points[front[-1]][1]:
            front.append(i)
    return front


def front_of(measured: Sequence[Measured], kind: Kind, known: float) -> list[Measured]:
    """The Pareto front of the settings of a kind; errors up to `known`, that of the reference, count as equal."""
    asked = [m for m in measured if m.setting.kind is kind and not m.failure]
    floor = known if known == known else 0.0
    return [asked[i] for i in pareto_front([(m.seconds, max(m.error, floor)) for m in asked], SAME_ERROR)]


def orbit_settings(request: FamilyRequest, tolerances: Iterable[float]) -> list[Setting]:
    """Every method that finds orbits at every tolerance, from the request of a family; shooting for short chains."""
    settings = []
    for transcription in TRANSCRIPTIONS:
        if transcription == "shooting" and shooting_left_out(request):
            continue
        for walker in WALKERS if transcription == "trigonometric" else WALKERS[:1]:
            for corrector in CORRECTORS[::-1]:
                methods = {"transcription": transcription, "walker": walker, "corrector": corrector, "degree": None}
                settings += [_setting(Kind.ORBITS, request, tol, **methods) for tol in tolerances]
    return settings


def shooting_left_out(request: FamilyRequest) -> bool:
    """Whether the chain is too long for shooting to be measured."""
    return request.chain.sites > SHOOTING_SITES


def flow_settings(request: FamilyRequest, tolerances: Iterable[float]) -> list[Setting]:
    """Every flow map at every tolerance."""
    return [_setting(Kind.FLOW, request, tol, flow=flow) for flow in FLOWS for tol in tolerances]


def preset_settings(request: FamilyRequest) -> list[Setting]:
    """The presets with the default methods."""
    return [replace(_setting(Kind.PRESET, request, tol), name=name) for name, tol in PRESET_TOLERANCES.items()]


def _setting(kind: Kind, request: FamilyRequest, tolerance: float, **methods: str | None) -> Setting:
    chain, mode, amplitude_max, at = request.chain, request.mode, request.amplitude_max, request.at
    return Setting(kind, family_request(chain, mode, amplitude_max, at, tolerance, **methods))  # type: ignore[arg-type]
