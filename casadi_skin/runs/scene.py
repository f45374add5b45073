"""The whole request of one run, of a chain or of any model: one scene with its tables by name."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias, get_args

import msgspec
from msgspec import Meta, Struct

from casadi_skin.model import methods
from casadi_skin.model.methods import COLLOCATION, GAUSS, SPLITTING, TRIGONOMETRIC
from casadi_skin.optimise.names import FREE, NAMED

# Tables of a scene as frozen objects: a chain, its families, accuracy and methods -------------------------------------

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


# Tables of a scene of any model: a file that makes it, an orbit or a boundary-value problem, a continuation -----------

AMPLITUDE = "S"  # the parameter of branches that leave families
SELECTED = "select"  # the parameter by which a continuation moves the value in [orbit] select
CONSERVED = "hamiltonian"  # the conserved quantity, among what select may name

Leaving = Literal["hopf", "branch point", "period doubling"]
LEAVING: tuple[str, ...] = get_args(Leaving)  # the same as in equilibria, which loads numerics

_MAX_CYCLES = 1000
_MAX_BRANCHES = 1000

_Named = dict[str, Finite]
_One = Annotated[dict[str, Finite], Meta(min_length=1, max_length=1)]
_STATES = "a list of finite numbers, one a state, or a table of numbers by the names of states (left out: 0)"


class ModelTable(Table, frozen=True):
    """The model: a file that makes it. Running the scene runs the code in a Python file."""

    file: Annotated[
        _Text,
        Meta(
            title="File of the model, beside the scene unless it has a path",
            description="a Python file, or a .json file written by save_model",
        ),
    ]
    name: Annotated[
        _Text | None,
        Meta(
            title="Name in the Python file",
            description="an OdeModel or a BoundaryValueProblem, or a function without arguments that returns one; "
            "none with a .json file",
        ),
    ] = None
    parameters: Annotated[
        _Named,
        Meta(title="Values of parameters", description="a table of finite numbers by the names of parameters"),
    ] = msgspec.field(default_factory=dict)


class OrbitTable(Table, frozen=True):
    """A periodic orbit of the model: a guess of its period and states, and conditions that select it."""

    start: Annotated[
        tuple[Finite, ...] | _Named, Meta(title="State that a simulation starts from", description=_STATES)
    ]
    transient: Annotated[
        Positive | None,
        Meta(
            title="Time simulated before the cycle that is the guess",
            description="a finite number > 0 (autonomous models: this or period)",
        ),
    ] = None
    period: Annotated[
        Positive | None,
        Meta(
            title="Guessed period: the guess is one period from the start",
            description="a finite number > 0 (autonomous models: this or transient; forced models: neither is needed)",
        ),
    ] = None
    select: Annotated[
        _One | None,
        Meta(
            title="Value at phase zero that picks an orbit of a family",
            description="a table with one number by the name of a state, an output, what is conserved or "
            f'"{CONSERVED}"; for conservative models and symmetric orbits',
        ),
    ] = None
    section: Annotated[
        _One | None,
        Meta(
            title="Value at phase zero that fixes the phase",
            description="a table with one number by the name of a state or an output (left out: an integral condition)",
        ),
    ] = None
    symmetric: Annotated[
        bool, Meta(title="Reversible orbit: half of it, or a quarter, is unknown", description="true or false")
    ] = False
    rotations: Annotated[
        dict[str, int] | None,
        Meta(
            title="Turns of angles in a period, after which the orbit closes but for 2 pi times as much",
            description="a table of whole numbers by the names of states in which the model has the period 2 pi",
        ),
    ] = None
    cycles: Annotated[
        Annotated[int, Meta(ge=1, le=_MAX_CYCLES)],
        Meta(
            title="Periods of the forcing after which the orbit closes",
            description=f"a whole number >= 1 and <= {_MAX_CYCLES}; forced models",
        ),
    ] = 1


class EquilibriumTable(Table, frozen=True):
    """An equilibrium of the model, near a guess."""

    start: Annotated[
        tuple[Finite, ...] | _Named,
        Meta(title="State near which it is sought, or that a simulation starts from", description=_STATES),
    ]
    transient: Annotated[
        Positive | None,
        Meta(
            title="Time simulated before, until the model rests",
            description="a finite number > 0 (left out: the start itself is the guess)",
        ),
    ] = None


class CurveTable(Table, frozen=True):
    """A second parameter in which folds, Hopf points, period doublings and tori are followed."""

    parameter: Annotated[_Text, Meta(title="Second parameter", description="the name of a parameter")]
    to: Annotated[Finite, Meta(title="Value at which curves end", description="a finite number")]
    further: Annotated[
        bool,
        Meta(
            title="Whether edges with unstable orbits on both sides are followed too, those in further_events.csv",
            description="true or false; beside [family] alone (left out: false)",
        ),
    ] = False


class SolutionTable(Table, frozen=True):
    """A solution of the boundary-value problem that the file states."""

    guess: Annotated[
        _Text | tuple[Finite, ...] | _Named,
        Meta(
            title="Where the solution is sought",
            description=f"{_STATES}, or the name of a function of t in the Python file",
        ),
    ]


class ContinuationTable(Table, frozen=True):
    """The branch of equilibria, orbits or solutions in one parameter, through folds."""

    parameter: Annotated[
        _Text,
        Meta(
            title="Parameter",
            description=f'the name of a parameter, or "{SELECTED}": the value in [orbit] select; beside [family] '
            f'"{AMPLITUDE}"',
        ),
    ]
    to: Annotated[Finite, Meta(title="Value at which the branch ends", description="a finite number")]
    at: Annotated[
        tuple[Finite, ...],
        Meta(title="Points exactly at these values", description="a list of finite numbers, each once"),
    ] = ()
    back_to: Annotated[
        Finite | None,
        Meta(
            title="Value at which a branch ends that comes back beyond its start",
            description="a finite number on the other side of the start (left out: it ends at the value of its start)",
        ),
    ] = None
    max_points: Annotated[
        Annotated[int, Meta(ge=1, le=_MAX_POINTS)],
        Meta(
            title="Points after which the branch ends wherever it is",
            description=f"a whole number >= 1 and <= {_MAX_POINTS}",
        ),
    ] = 2000
    max_step: Annotated[
        Annotated[float, Meta(gt=0, le=10)],
        Meta(
            title="Longest step, 1 being a change of the states by their own size",
            description="a number > 0 and <= 10",
        ),
    ] = 0.2
    switch: Annotated[
        tuple[Leaving, ...],
        Meta(
            title="Special points at which the branches that leave are followed too",
            description=f"a list of {one_of(LEAVING)}, each once; "
            "hopf beside [equilibrium] and [orbit]; multipliers, and so period doublings, need [stability]",
        ),
    ] = ()
    depth: Annotated[
        Annotated[int, Meta(ge=0)] | None,
        Meta(
            title="Special points one after the other that may lie between the branch and the followed one",
            description="a whole number >= 0; not beside [family] (left out: any number, half of what crosses)",
        ),
    ] = None
    limit: Annotated[
        Annotated[int, Meta(ge=1, le=_MAX_BRANCHES)],
        Meta(
            title="Branches of the diagram, at most",
            description=f"a whole number >= 1 and <= {_MAX_BRANCHES}",
        ),
    ] = 30
    curve: Annotated[
        CurveTable | None,
        Meta(
            title="Second parameter in which folds, Hopf points, doublings, tori and edges of tongues are followed",
            description="a table with parameter, the name of another parameter, and to, a number; beside "
            "[equilibrium], [orbit], [solution] or, with S free, [family]; period doublings and tori need [stability]",
        ),
    ] = None


# Tables of a scene beside orbits: their time evolution, C code and FMUs, a search -------------------------------------

Fmi = Literal["3.0", "2.0"]
CPart = Literal["rhs", "jacobian", "variational", "flow", "residual", "newton", "orbit", "ipopt"]
if TYPE_CHECKING:
    Evolver: TypeAlias = str
    Format: TypeAlias = str
else:  # the names of integrators are those of the one registry
    Evolver = Literal[tuple(methods.INTEGRATORS)]
    Format = Literal[methods.FORMATS]
FMI_VERSIONS: tuple[str, ...] = get_args(Fmi)
C_PARTS: tuple[str, ...] = get_args(CPart)  # the same as in export, which loads numerics

_MAX_SAMPLES = 1_000_000
_MAX_STARTS = 10_000
_MAX_WORKERS = 256


class DynamicsTable(Table, frozen=True):
    """The time evolution of one orbit, perturbed or not, from phase zero: of a family at S, else of the last orbit.

    Without [family] and [orbit] that of a mode, a kick, a direction or noise about rest.
    """

    S: Annotated[
        Positive | None,
        Meta(title="S of the orbit of a family", description="a finite number > 0, up to amplitude_max"),
    ] = None
    mode: Annotated[
        Mode | None,
        Meta(
            title="Mode of its family, or linear mode that moves",
            description="one of the modes of [family], required where these are several; without [family] and [orbit] "
            "a linear mode from 1",
        ),
    ] = None
    moving: Annotated[
        bool,
        Meta(
            title="Whether the start has velocities in place of displacements",
            description="true or false; without [family] and [orbit]",
        ),
    ] = False
    duration: Annotated[Positive | None, Meta(title="Time to its end", description="a finite number > 0")] = None
    periods: Annotated[
        Positive | None, Meta(title="Periods of the orbit to its end", description="a finite number > 0")
    ] = None
    samples: Annotated[
        Annotated[int, Meta(ge=2, le=_MAX_SAMPLES)] | None,
        Meta(
            title="Number of times written, first and last included",
            description=f"a whole number >= 2 and <= {_MAX_SAMPLES} (left out: 20 a period, 401 to 4001 in all)",
        ),
    ] = None
    method: Annotated[Evolver, Meta(title="Integrator", description=one_of(methods.INTEGRATORS))] = "cvodes"
    tolerance: Annotated[
        Tolerance, Meta(title="Relative tolerance of one step", description="a number >= 1e-13 and <= 1e-2")
    ] = 1e-11
    size: Annotated[
        Positive | None,
        Meta(
            title="Norm of the perturbation, or of the start",
            description="a finite number > 0, with one of site, vector, seed (without an orbit also mode)",
        ),
    ] = None
    site: Annotated[
        Mode | None,
        Meta(
            title="Displaced site",
            description="a site from 1 to sites (of a model: positions; of one of first order: states)",
        ),
    ] = None
    vector: Annotated[
        Annotated[tuple[Finite, ...], Meta(min_length=1)] | None,
        Meta(
            title="Direction of the perturbation",
            description="a list of numbers: a displacement a site, or these and a velocity a site; of a model of first "
            "order a number a state",
        ),
    ] = None
    seed: Annotated[
        Annotated[int, Meta(ge=0, le=2**63 - 1)] | None,
        Meta(title="Seed of random displacements", description="a whole number >= 0 and < 2^63"),
    ] = None


class FiguresTable(Table, frozen=True):
    """The pictures of a run."""

    formats: Annotated[
        tuple[Format, ...],
        Meta(
            title="Formats in which each picture is written",
            description=f"a list of {one_of(methods.FORMATS)}; [] for none",
        ),
    ] = ("png",)


class ExportTable(Table, frozen=True):
    """The model, or one of its orbits, as C code or as an FMU."""

    c: Annotated[
        Literal["all"] | Annotated[tuple[CPart, ...], Meta(min_length=1)] | None,
        Meta(title="Parts written as C, in DIR/export", description=f'"all", or a list of {one_of(C_PARTS)}'),
    ] = None
    fmu: Annotated[
        Annotated[str, Meta(pattern=r"^\w[\w.-]*\.fmu$")] | None,
        Meta(title="Functional Mock-up Unit, in DIR", description="a file name without folders that ends in .fmu"),
    ] = None
    fmi: Annotated[Fmi, Meta(title="Version of its interface", description=one_of(FMI_VERSIONS))] = "3.0"
    inputs: Annotated[
        tuple[str, ...],
        Meta(title="Inputs of the FMU", description="names of forces on sites, such as f_1, and of parameters"),
    ] = ()
    S: Annotated[
        Positive | None,
        Meta(
            title="S of the orbit",
            description="a finite number > 0, up to amplitude_max (left out: the last orbit beside [orbit], else the "
            "model without an orbit)",
        ),
    ] = None
    mode: Annotated[
        Mode | None,
        Meta(
            title="Mode of its family",
            description="one of the modes of [family]; required with S where these are several",
        ),
    ] = None


class SearchCondition(Table, frozen=True):
    """A quantity of the orbit that is held between bounds, or equal to a number."""

    quantity: Annotated[str, Meta(title="Name of the quantity", description="a quantity by name")]
    equal: Annotated[Finite | None, Meta(title="Its value", description="a finite number")] = None
    lower: Annotated[Finite | None, Meta(title="Lower bound", description="a finite number")] = None
    upper: Annotated[Finite | None, Meta(title="Upper bound", description="a finite number")] = None


class SearchTable(Table, frozen=True):
    """An orbit found by optimisation: free numbers, objective, constraints."""

    objective: Annotated[
        str,
        Meta(title="Quantity that is optimised", description=one_of(NAMED), extra_json_schema={"enum": list(NAMED)}),
    ]
    free: Annotated[
        Annotated[tuple[str, ...], Meta(min_length=1)],
        Meta(title="What is free", description=f"a list of {one_of(FREE)}, each once"),
    ]
    maximise: Annotated[bool, Meta(title="Maximise in place of minimise", description="true or false")] = False
    bounds: Annotated[
        dict[str, tuple[float, float]],
        Meta(
            title="Bounds of free numbers and of quantities",
            description="a table of names, each with a list [lower, upper]; -inf or inf where there is none",
        ),
    ] = msgspec.field(default_factory=dict)
    constraints: Annotated[
        tuple[SearchCondition, ...],
        Meta(
            title="Quantities held",
            description="a list of tables with quantity, and equal or lower and upper or one of these",
        ),
    ] = ()
    mode: Annotated[
        Mode | NamedMode | None,
        Meta(
            title="Linear mode of the family",
            description='a mode from 1 to sites, "first" or "last" (left out: last for g > 0, first for g < 0)',
        ),
    ] = None
    S: Annotated[Positive, Meta(title="S of the orbit, or of the first start", description="a finite number > 0")] = 1.0
    starts: Annotated[
        Annotated[int, Meta(ge=1, le=_MAX_STARTS)],
        Meta(title="Number of starts", description=f"a whole number >= 1 and <= {_MAX_STARTS}"),
    ] = 8
    seed: Annotated[
        Annotated[int, Meta(ge=0, le=2**63 - 1)],
        Meta(title="Seed of the starts but for the first", description="a whole number >= 0 and < 2^63"),
    ] = 0
    deflate: Annotated[
        bool, Meta(title="Use starts that led to a known optimum again, away from it", description="true or false")
    ] = False
    workers: Annotated[
        Annotated[int, Meta(ge=1, le=_MAX_WORKERS)],
        Meta(title="Processes that share the starts", description=f"a whole number >= 1 and <= {_MAX_WORKERS}"),
    ] = 1


class Scene(Table, frozen=True):
    """A request of one run, of a chain, a lattice or a model; a table that is None is neither built nor computed."""

    chain: ChainTable | None = None
    lattice: LatticeTable | None = None
    model: ModelTable | None = None
    spectrum: SpectrumTable | None = None
    family: FamilyTable | None = None
    equilibrium: EquilibriumTable | None = None
    orbit: OrbitTable | None = None
    solution: SolutionTable | None = None
    continuation: ContinuationTable | None = None
    stability: StabilityTable | None = None
    dynamics: DynamicsTable | None = None
    search: SearchTable | None = None
    export: ExportTable | None = None
    figures: FiguresTable = msgspec.field(default_factory=FiguresTable)
    map: MapTable | None = None
    accuracy: AccuracyTable = msgspec.field(default_factory=AccuracyTable)
    method: MethodTable = msgspec.field(default_factory=MethodTable)
    title: Annotated[str | None, Meta(title="Title of the results", description="a string")] = None
    time_limit: Annotated[
        Annotated[float, Meta(gt=0.0, le=1e7)] | None,
        Meta(title="Seconds that a run or a map may take", description="a number > 0 and <= 1e7"),
    ] = None

    @property
    def sites(self) -> float | None:
        """Number of sites of the chain, infinite for an endless one; None where the scene is one of a model."""
        return None if self.chain is None else self.chain.sites

    def modes(self) -> tuple[int | str, ...]:
        """The modes whose families are followed, numbers where the chain's length is known."""
        if self.family is None:
            return ()
        requested = self.family.mode if isinstance(self.family.mode, tuple) else (self.family.mode,)
        return requested if self.sites is None else self.family.modes(self.sites)

    @property
    def methods(self) -> MethodTable:
        """The table [method] with the names chosen where it leaves them out, as far as the scene alone decides."""
        chosen: dict[str, str] = {}
        if self.family is not None:
            chosen = {"flow": SPLITTING} | ({} if self.chain is None else {"transcription": TRIGONOMETRIC})
        elif self.orbit is not None or self.solution is not None:
            chosen = {"flow": COLLOCATION, "transcription": GAUSS}
        left_out = {name: value for name, value in chosen.items() if getattr(self.method, name) is None}
        return msgspec.structs.replace(self.method, **left_out)

    @property
    def has_diagram(self) -> bool:
        """Whether branches that leave, or curves in two parameters, belong to the branch that is followed."""
        table = self.continuation
        further = table is not None and (table.curve is not None or bool(table.switch) or table.depth is not None)
        return self.equilibrium is not None or (further and self.family is None)

    def same_request(self, other: Scene) -> bool:
        """Whether the other scene states the same request, whatever its title and its limit of time."""
        given = {"title": None, "time_limit": None}
        mine, theirs = (msgspec.structs.replace(s, method=s.methods, **given) for s in (self, other))
        return mine == theirs


TABLES: Mapping[str, type[Table]] = MappingProxyType(
    {
        "chain": ChainTable,
        "lattice": LatticeTable,
        "model": ModelTable,
        "spectrum": SpectrumTable,
        "family": FamilyTable,
        "equilibrium": EquilibriumTable,
        "orbit": OrbitTable,
        "solution": SolutionTable,
        "continuation": ContinuationTable,
        "stability": StabilityTable,
        "dynamics": DynamicsTable,
        "search": SearchTable,
        "export": ExportTable,
        "figures": FiguresTable,
        "map": MapTable,
        "accuracy": AccuracyTable,
        "method": MethodTable,
    }
)
