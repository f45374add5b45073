"""Settings of a work-precision diagram, their measured cost and errors, and the Pareto front."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from math import nan
from typing import Any

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.methods import CONTINUATIONS, CORRECTORS, FLOWS, SHOOTING, TRANSCRIPTIONS, TRIGONOMETRIC
from casadi_skin.runs.scene import PRESET_TOLERANCES
from casadi_skin.zero.request import FamilyRequest, family_request

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12)
QUICK_TOLERANCES = (1e-4, 1e-8, 1e-12)
PARTS_OF_FAMILY = 5  # by default
SHOOTING_SITES = 6  # shooting integrates the sensitivities of all states to all: measured up to here
SAME_ERROR = 1.5  # factor between errors that count as equal on a Pareto front
SMALLEST = 1e-16  # written for an error of exactly zero


@dataclass(frozen=True)
class FamilyCase:
    """A family from a linear mode to S = `amplitude_max`, whose errors are measured at the S of `at`."""

    chain: Chain
    mode: int
    amplitude_max: float
    at: tuple[float, ...]

    def with_points(self) -> FamilyCase:
        """The family with its own points, or with equal parts of it where there are none."""
        if self.at:
            return self
        end = self.amplitude_max
        return replace(self, at=(*(end * k / PARTS_OF_FAMILY for k in range(1, PARTS_OF_FAMILY)), end))

    def request(self, **methods: Any) -> FamilyRequest:
        """The request of the family to the package, by the methods of the setting."""
        return family_request(self.chain, self.mode, self.amplitude_max, at=self.at, **methods)

    @property
    def shooting_left_out(self) -> bool:
        """Whether the chain is too long for shooting to be measured."""
        return self.chain.sites > SHOOTING_SITES


class Kind(StrEnum):
    """Computation of a setting."""

    ORBITS = "orbits"  # the family without multipliers
    FLOW = "flow"  # multipliers of orbits that are given
    PRESET = "preset"  # the family with multipliers and changes of stability, by the default methods


@dataclass(frozen=True)
class Setting:
    """Methods and a tolerance for a family; `name` is that of a preset."""

    kind: Kind
    family: FamilyCase
    tolerance: float = 1e-8
    transcription: str = "trigonometric"
    walker: str = "series"
    corrector: str = "ipopt"
    flow: str = "splitting"
    name: str = ""

    @property
    def methods(self) -> dict[str, Any]:
        """The methods and the tolerance as keywords of `follow_family`."""
        names = ("tolerance", "transcription", "walker", "corrector", "flow")
        return {name: getattr(self, name) for name in names}

    @property
    def orbit_methods(self) -> str:
        """The methods that find orbits, in words."""
        return f"{self.transcription}, {self.walker}, {self.corrector}"

    @property
    def method(self) -> str:
        """The methods that are measured, in words, or the preset."""
        return {Kind.PRESET: self.name, Kind.FLOW: self.flow, Kind.ORBITS: self.orbit_methods}[self.kind]


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
    def orbit_error(self) -> float:
        """The larger of the errors of Omega and of the profile."""
        return max(self.Omega_error, self.profile_error)

    @property
    def error(self) -> float:
        """The largest error that the tolerance bounds."""
        return bounded(self.setting.kind, self.Omega_error, self.profile_error, self.mu_error)

    def row(self) -> dict[str, object]:
        """Cells by column."""
        kind = self.setting.kind
        unused = {Kind.ORBITS: ("flow",), Kind.FLOW: ("transcription", "walker", "corrector")}.get(kind, ())
        return {**vars(self.setting), "method": self.setting.method, **vars(self), **dict.fromkeys(unused)}


COLUMNS = (
    *("kind", "method", "transcription", "walker", "corrector", "flow", "tolerance"),
    *(field.name for field in fields(Measured) if field.name != "setting"),
)


def bounded(kind: Kind, Omega: float, profile: float, mu: float) -> float:
    """The largest of the errors that the tolerance of a setting of this kind bounds; nan where there is none."""
    errors = {Kind.ORBITS: (Omega, profile), Kind.FLOW: (mu,), Kind.PRESET: (Omega, profile, mu)}[kind]
    return max((value for value in errors if value == value), default=nan)


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
    requested = [m for m in measured if m.setting.kind is kind and not m.failure]
    floor = known if known == known else 0.0
    return [requested[i] for i in pareto_front([(m.seconds, max(m.error, floor)) for m in requested], SAME_ERROR)]


def orbit_settings(family: FamilyCase, tolerances: Iterable[float]) -> list[Setting]:
    """Every method that finds orbits at every tolerance; shooting for short chains."""
    return [
        Setting(Kind.ORBITS, family, tolerance, transcription, walker, corrector)
        for transcription in TRANSCRIPTIONS
        if not (transcription == SHOOTING and family.shooting_left_out)
        for walker in (CONTINUATIONS if transcription == TRIGONOMETRIC else ("arclength",))
        for corrector in reversed(list(CORRECTORS))
        for tolerance in tolerances
    ]


def flow_settings(family: FamilyCase, tolerances: Iterable[float]) -> list[Setting]:
    """Every flow map at every tolerance; none where a single site moves."""
    if family.chain.sites == 1 or abs(family.chain.gamma) == 1.0:
        return []
    return [Setting(Kind.FLOW, family, tolerance, flow=flow) for flow in FLOWS for tolerance in tolerances]


def preset_settings(family: FamilyCase, walker: str) -> list[Setting]:
    """The presets with the default methods, of which `walker` is one."""
    return [Setting(Kind.PRESET, family, tol, walker=walker, name=name) for name, tol in PRESET_TOLERANCES.items()]
