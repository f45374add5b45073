"""Tables of a scene as frozen objects: a chain, its families, accuracy and methods.

In each `Meta` the title says what a key is, the description what it accepts: messages, the JSON schema and the
documentation quote it. The model is dimensionless.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias, get_args

import msgspec
from msgspec import Meta, Struct

from casadi_skin.model import methods

Preset = Literal["draft", "standard", "reference"]
if TYPE_CHECKING:
    Transcription: TypeAlias = str
    Corrector: TypeAlias = str
    Walker: TypeAlias = str
    Flow: TypeAlias = str
    Tail: TypeAlias = str
else:  # the names of methods are those of the one registry
    Transcription = Literal[tuple(methods.TRANSCRIPTIONS)]
    Corrector = Literal[tuple(methods.CORRECTORS)]
    Walker = Literal[tuple(methods.CONTINUATIONS)]
    Flow = Literal[tuple(dict.fromkeys((*methods.FLOWS, *methods.FULL_PERIOD_FLOWS)))]
    Tail = Literal[methods.TAILS]

PRESETS: tuple[str, ...] = get_args(Preset)
PRESET_TOLERANCES: Mapping[str, float] = MappingProxyType({"draft": 1e-4, "standard": 1e-8, "reference": 1e-12})

_MAX_SITES = 10_000_000
_MAX_POINTS = 1_000_000
_MAX_INTERVALS = 1500  # the same as in orbits.method, which loads numerics
_POINTS = 2000  # the same as in orbits.method, which loads numerics


def one_of(names: Iterable[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


# A bound at the largest float is how msgspec is made to refuse inf; nan fails every comparison.
Finite = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
Positive = Annotated[float, Meta(gt=0, le=sys.float_info.max)]
Sites = Annotated[int, Meta(ge=1, le=_MAX_SITES)] | Annotated[float, Meta(gt=sys.float_info.max)]  # a number, or inf
Mode = Annotated[int, Meta(extra_json_schema={"minimum": 1})]  # checked below, where sites is known
NamedMode = Literal["first", "last"]
Modes = Annotated[tuple[Mode | NamedMode, ...], Meta(min_length=1)]
Tolerance = Annotated[float, Meta(ge=1e-13, le=1e-2)]


class Table(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of a scene: immutable, every key by name, no other key."""


class ChainTable(Table, frozen=True):
    """The chain: its length, stiffness, nonreciprocity and nonlinearity."""

    sites: Annotated[Sites, Meta(title="Sites N", description=f"a whole number >= 1 and <= {_MAX_SITES}, or inf")]
    alpha: Annotated[Finite, Meta(title="On-site stiffness", description="a finite number")]
    gamma: Annotated[float, Meta(ge=-1, le=1, title="Nonreciprocity", description="a number >= -1 and <= 1")]
    g: Annotated[Finite, Meta(title="Cubic on-site coefficient", description="a finite number")]


class SpectrumTable(Table, frozen=True):
    """Linear frequencies and modes; the table has no keys."""


class FamilyTable(Table, frozen=True):
    """The families to follow, each from its linear mode: of a chain, or of a model of second order that rests at 0."""

    mode: Annotated[
        Mode | NamedMode | Modes,
        Meta(
            title="Linear modes",
            description='a mode from 1 to sites (of a model: positions), "first" or "last", or a list of such modes',
        ),
    ]
    amplitude_max: Annotated[Positive, Meta(title="Largest S = ||y||^2", description="a finite number > 0")]
    at: Annotated[
        tuple[Positive, ...],
        Meta(title="Points at these S", description="a list of numbers > 0, ascending up to amplitude_max"),
    ] = ()
    at_Omega: Annotated[
        tuple[Positive, ...],
        Meta(title="Points at these frequencies", description="a list of numbers > 0, each once"),
    ] = ()
    at_period: Annotated[
        tuple[Positive, ...],
        Meta(title="Points at these periods", description="a list of numbers > 0, each once, up to period_max"),
    ] = ()
    period_max: Annotated[
        Positive | None,
        Meta(
            title="Period at which a family ends that has not come to amplitude_max",
            description="a finite number > 0, above the period of the linear mode (left out: no end)",
        ),
    ] = None
    max_points: Annotated[
        Annotated[int, Meta(ge=1, le=_MAX_POINTS)],
        Meta(
            title="Points after which a family ends wherever it is",
            description=f"a whole number >= 1 and <= {_MAX_POINTS} (left out: {_POINTS})",
        ),
    ] = _POINTS
    film: Annotated[
        bool,
        Meta(
            title="Film (GIF) of the mode at the last point asked for, or else at the end", description="true or false"
        ),
    ] = False

    def modes(self, sites: float) -> tuple[int, ...]:
        """Numbers of the requested modes; "last" is -1 in an infinite chain, which has no other but "first"."""
        requested = self.mode if isinstance(self.mode, tuple) else (self.mode,)
        last = -1 if sites == math.inf else int(sites)
        return tuple({"first": 1, "last": last}[mode] if isinstance(mode, str) else mode for mode in requested)


class StabilityTable(Table, frozen=True):
    """Floquet multipliers of every orbit."""

    events: Annotated[bool, Meta(title="Locate changes of stability", description="true or false")] = True
    vectors: Annotated[
        bool, Meta(title="Keep the Floquet vectors at requested points", description="true or false")
    ] = False
    sites: Annotated[
        Annotated[int, Meta(ge=8, le=2000)] | None,
        Meta(
            title="Sites at the edge of a long chain on whose motion stability is computed",
            description="a whole number from 8 to 2000, with a tail that is eliminated (left out: all sites; of "
            "infinitely or very many as many as localised multipliers need)",
        ),
    ] = None


class AccuracyTable(Table, frozen=True):
    """The allowed relative error of the results, by a preset or as a number."""

    preset: Annotated[Preset | None, Meta(title="Named tolerance", description=one_of(PRESETS))] = None
    tolerance: Annotated[
        Tolerance | None, Meta(title="Relative tolerance", description="a number >= 1e-13 and <= 1e-2")
    ] = None

    certify: Annotated[
        bool | Literal["all"],
        Meta(
            title="Proofs that orbits exist: of those asked for, or of all",
            description='true, false or "all"; with [family], needs the extra certify',
        ),
    ] = False

    @property
    def relative_tolerance(self) -> float:
        """The tolerance: the number, else that of the preset, else that of "standard"."""
        return PRESET_TOLERANCES[self.preset or "standard"] if self.tolerance is None else self.tolerance


class MethodTable(Table, frozen=True):
    """The interchangeable methods, by name; those left out are chosen for the model."""

    transcription: Annotated[
        Transcription | None,
        Meta(
            title="Discretisation",
            description=f"{one_of(methods.TRANSCRIPTIONS)} (left out: trigonometric for families whose model is odd "
            "and reversible, else gauss)",
        ),
    ] = None
    degree: Annotated[
        Annotated[int, Meta(ge=1, le=12)] | None,
        Meta(
            title="Degree of the polynomials of gauss and radau",
            description="a whole number >= 1 (families: 2) and <= 12, with one of gauss, radau (left out: families "
            "5 to 12 by the tolerance, others 6)",
        ),
    ] = None
    intervals: Annotated[
        Annotated[int, Meta(ge=1, le=_MAX_INTERVALS)] | None,
        Meta(
            title="Intervals of the first mesh of an orbit or a solution",
            description=f"a whole number >= 1 and <= {_MAX_INTERVALS} (left out: 12)",
        ),
    ] = None
    corrector: Annotated[Corrector, Meta(title="Solver of a point", description=one_of(methods.CORRECTORS))] = "ipopt"
    walker: Annotated[
        Walker | None,
        Meta(
            title="Way along a family",
            description=f"{one_of(methods.CONTINUATIONS)} (left out: series with transcription trigonometric and "
            "polynomial forces, else arclength)",
        ),
    ] = None
    flow: Annotated[
        Flow | None,
        Meta(
            title="Flow map of stability",
            description=f"{one_of(methods.FLOWS)} for families (left out: splitting); "
            f"{one_of(methods.FULL_PERIOD_FLOWS)} for orbits (left out: collocation)",
        ),
    ] = None
    tail: Annotated[
        Tail | None,
        Meta(
            title="Linear tail of a long chain",
            description=f"{one_of(methods.TAILS)} (left out: eliminated where it pays, and without [stability])",
        ),
    ] = None


# Tables of a scene of a lattice that is declared in it: cells, sites and bonds, boundaries, values of parameters ------

_Text = Annotated[str, Meta(min_length=1)]
_Formula = _Text | Finite
_Count = Annotated[int, Meta(ge=1, le=100_000)]
_Along = Annotated[int, Meta(ge=1, le=1_000_000_000_000)] | Annotated[float, Meta(gt=sys.float_info.max)]  # or inf
MOST_CELLS = 100_000  # whose sites may all be unknown; the same as in lattice.declaration, which loads numerics
_Step = Annotated[int, Meta(ge=-100_000, le=100_000)]
_Boundary = Literal["fixed", "free", "periodic"]
_FORMULA = "a number, or a formula in quotes: numbers, parameters, n and m, + - * / ^ and elementary functions"


class UniformTable(Table, frozen=True):
    """Values by cell that are drawn evenly, with a seed."""

    low: Annotated[Finite, Meta(title="Lowest value", description="a finite number")]
    high: Annotated[Finite, Meta(title="Highest value", description="a finite number")]
    seed: Annotated[Annotated[int, Meta(ge=0)], Meta(title="Seed", description="a whole number >= 0")]


class SiteTable(Table, frozen=True):
    """A site of each cell: mass * y'' = -onsite - damping * y' + drive + forces of bonds."""

    name: Annotated[_Text, Meta(title="What bonds call the site", description="a name")]
    onsite: Annotated[_Formula, Meta(title="Restoring force", description=f"{_FORMULA}; in y too")] = "0"
    mass: Annotated[_Formula, Meta(title="Mass", description=_FORMULA)] = "1"
    damping: Annotated[_Formula, Meta(title="Factor of -y' in the force", description=f"{_FORMULA}; in y, v too")] = "0"
    drive: Annotated[
        _Formula, Meta(title="Force in time", description=f"{_FORMULA}; in t too, periodic, such as cos(omega*t)")
    ] = "0"


class BondTable(Table, frozen=True):
    """A bond of each cell, with a force F(d) of its extension d = y_to - y_from."""

    start: Annotated[_Text, Meta(title="Site that the bond starts from", description="the name of a site")] = (
        msgspec.field(name="from")
    )
    end: Annotated[_Text, Meta(title="Site that the bond leads to", description="the name of a site")] = msgspec.field(
        name="to"
    )
    offset: Annotated[
        _Step | tuple[_Step, ...],
        Meta(title="Cells from the one to the other", description="a list of whole numbers, one along each direction"),
    ]
    force: Annotated[_Formula, Meta(title="Force F(d)", description=f"{_FORMULA}; in d too")] = "d"
    gain: Annotated[
        tuple[_Formula, _Formula],
        Meta(
            title="The force on `from` is gain[0] * F(d), on `to` it is -gain[1] * F(d)",
            description=f"two of these: {_FORMULA}",
        ),
    ] = ("1", "1")


class LatticeTable(Table, frozen=True):
    """A lattice: cells along one or two directions, their sites and bonds; formulas are data and are never run."""

    cells: Annotated[
        _Along | Annotated[tuple[_Count, ...], Meta(min_length=1, max_length=2)],
        Meta(title="Cells along each direction", description="a whole number >= 1, inf, or a list of one or two"),
    ]
    site: Annotated[
        Annotated[tuple[SiteTable, ...], Meta(min_length=1)],
        Meta(title="Sites of a cell", description="one table [[lattice.site]] or more, with name"),
    ]
    bond: Annotated[
        tuple[BondTable, ...],
        Meta(title="Bonds of a cell", description="tables [[lattice.bond]] with from, to and offset"),
    ] = ()
    boundary: Annotated[
        _Boundary | tuple[_Boundary, ...],
        Meta(
            title="What is beyond the ends: neighbours at 0, none, or the other end",
            description='"fixed", "free", "periodic", or a list of one a direction',
        ),
    ] = "fixed"
    parameters: Annotated[
        dict[str, Finite | _Text | tuple[Finite | tuple[Finite, ...], ...] | UniformTable],
        Meta(
            title="Values of parameters by name",
            description="a table of finite numbers; by cell lists, formulas in n and m, or { low, high, seed }",
        ),
    ] = msgspec.field(default_factory=dict)
    edge: Annotated[
        Literal["first", "last"] | None,
        Meta(
            title="Edge whose breathers are followed, the tail behind it linear",
            description='"first" or "last" (left out: all sites; of more than 100000 cells the end that they lean to)',
        ),
    ] = None
    forcing_period: Annotated[
        _Text | None,
        Meta(
            title="Period of the drives",
            description="a formula in parameters (left out: that of the sines and cosines of t)",
        ),
    ] = None

    @property
    def long(self) -> bool:
        """Whether all but the cells at one edge are a linear tail."""
        return self.edge is not None or (not isinstance(self.cells, tuple) and self.cells > MOST_CELLS)


# The table [map]: parameters of the scene that vary, and how their cells are computed ---------------------------------

MOST_POINTS = 100_000
_Points = Annotated[int, Meta(ge=2, le=MOST_POINTS)]
_NAMES = "a list of names of quantities"


class RangeTable(Table, frozen=True):
    """An axis of a map: values from one number to another, evenly or in equal ratios."""

    start: Annotated[int | Finite, Meta(title="First value", description="a finite number")] = msgspec.field(
        name="from"
    )
    to: Annotated[int | Finite, Meta(title="Last value", description="a finite number, not the first one")]
    points: Annotated[_Points, Meta(title="Number of values", description=f"a whole number >= 2 and <= {MOST_POINTS}")]
    log: Annotated[bool, Meta(title="Equal ratios in place of equal differences", description="true or false")] = False
    resolution: Annotated[
        Positive | None,
        Meta(
            title="Largest difference (ratio, with log) of neighbours where a watched quantity changes",
            description="a finite number > 0, with log > 1 (left out: nothing is refined along this axis)",
        ),
    ] = None


_Value = int | Finite | _Text
_Together = Annotated[tuple[_Value, ...], Meta(min_length=2)]  # a value for each of several parameters
AxisTable = RangeTable | Annotated[tuple[_Value | _Together, ...], Meta(min_length=1)]


class MapTable(Table, frozen=True):
    """A map of the scene over its parameters; every key that is none of these is an axis, named by its parameter."""

    axes: Annotated[
        dict[str, AxisTable],
        Meta(
            title="Axes by parameter; each may stand in [map] itself",
            description="tables { from, to, points, log, resolution }, or lists of values; beside names with commas "
            'between them lists of lists, such as "g, mode" = [[-1.0, "first"], [1.0, "last"]]',
        ),
    ] = msgspec.field(default_factory=dict)
    quantities: Annotated[
        Annotated[tuple[_Text, ...], Meta(min_length=1)] | None,
        Meta(title="Quantities kept and drawn", description=f"{_NAMES} (left out: all that the scene has)"),
    ] = None
    watch: Annotated[
        Annotated[tuple[_Text, ...], Meta(min_length=1)] | dict[str, tuple[Finite, ...]] | None,
        Meta(
            title="Quantities where whose changes cells are refined",
            description=f"{_NAMES}, or a table of lists of levels by name (left out: stable and end)",
        ),
    ] = None
    boundary: Annotated[
        bool, Meta(title="The boundary of stability is followed and drawn over the map", description="true or false")
    ] = False
    growth: Annotated[
        Annotated[float, Meta(ge=0, le=1e300)],
        Meta(
            title="Growth over a period, log |multiplier|, from which on an instability is the first one",
            description="a finite number >= 0",
        ),
    ] = 0.0
    cell_limit: Annotated[
        Positive | None,
        Meta(title="Seconds that a cell may take", description="a finite number > 0 (left out: no limit)"),
    ] = None


OPTIONS: tuple[str, ...] = MapTable.__struct_encode_fields__
