"""What a scene may ask for, as frozen objects: the tables of its TOML file.

In each `Meta` the title says what a key is, the description what it accepts: messages, the JSON schema and the
documentation quote it. The model is dimensionless.
"""

import math
import sys
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta, Struct

from casadi_skin.optimise.names import FREE, NAMED

Preset = Literal["draft", "standard", "reference"]
Transcription = Literal["trigonometric", "gauss", "radau", "shooting"]
Corrector = Literal["ipopt", "newton"]
Walker = Literal["arclength", "series"]
Flow = Literal["splitting", "cvodes", "gauss", "rk4"]
Tail = Literal["eliminated", "full"]
Evolver = Literal["cvodes", "dop853", "symplectic"]
Fmi = Literal["3.0", "2.0"]
CPart = Literal["rhs", "jacobian", "variational", "flow", "residual", "newton", "orbit", "ipopt"]

PRESETS: tuple[str, ...] = get_args(Preset)
TRANSCRIPTIONS: tuple[str, ...] = get_args(Transcription)
CORRECTORS: tuple[str, ...] = get_args(Corrector)
WALKERS: tuple[str, ...] = get_args(Walker)
FLOWS: tuple[str, ...] = get_args(Flow)
TAILS: tuple[str, ...] = get_args(Tail)
EVOLVERS: tuple[str, ...] = get_args(Evolver)
FMI_VERSIONS: tuple[str, ...] = get_args(Fmi)
C_PARTS: tuple[str, ...] = get_args(CPart)  # the same as in export.exported_model, which loads numerics
PRESET_TOLERANCES: Mapping[str, float] = MappingProxyType({"draft": 1e-4, "standard": 1e-8, "reference": 1e-12})

_MAX_SITES = 10_000_000
_MAX_SAMPLES = 1_000_000
_MAX_POINTS = 1_000_000
_MAX_STARTS = 10_000
_MAX_WORKERS = 256
_POINTS = 2000  # the same as in orbits.request, which loads numerics


def _one_of(names: Iterable[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


# A bound at the largest float is how msgspec is made to refuse inf; nan fails every comparison.
_Finite = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
_Positive = Annotated[float, Meta(gt=0, le=sys.float_info.max)]
_Sites = Annotated[int, Meta(ge=1, le=_MAX_SITES)] | Annotated[float, Meta(gt=sys.float_info.max)]  # a number, or inf
_Mode = Annotated[int, Meta(extra_json_schema={"minimum": 1})]  # checked below, where sites is known
_Named = Literal["first", "last"]
_Modes = Annotated[tuple[_Mode | _Named, ...], Meta(min_length=1)]
_Tolerance = Annotated[float, Meta(ge=1e-13, le=1e-2)]


class Table(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of a scene: immutable, every key by name, no other key."""


class ChainTable(Table, frozen=True):
    """The chain: its length, stiffness, nonreciprocity and nonlinearity."""

    sites: Annotated[_Sites, Meta(title="Sites N", description=f"a whole number >= 1 and <= {_MAX_SITES}, or inf")]
    alpha: Annotated[_Finite, Meta(title="On-site stiffness", description="a finite number")]
    gamma: Annotated[float, Meta(ge=-1, le=1, title="Nonreciprocity", description="a number >= -1 and <= 1")]
    g: Annotated[_Finite, Meta(title="Cubic on-site coefficient", description="a finite number")]


class SpectrumTable(Table, frozen=True):
    """Linear frequencies and modes are asked for; there is nothing to set."""


class FamilyTable(Table, frozen=True):
    """The families to follow, each from the linear mode that it grows from."""

    mode: Annotated[
        _Mode | _Named | _Modes,
        Meta(title="Linear modes", description='a mode from 1 to sites, "first" or "last", or a list of such modes'),
    ]
    amplitude_max: Annotated[_Positive, Meta(title="Largest S = ||y||^2", description="a finite number > 0")]
    at: Annotated[
        tuple[_Positive, ...],
        Meta(title="Points at these S", description="a list of numbers > 0, ascending up to amplitude_max"),
    ] = ()
    at_Omega: Annotated[
        tuple[_Positive, ...],
        Meta(title="Points at these frequencies", description="a list of numbers > 0, each once"),
    ] = ()
    at_period: Annotated[
        tuple[_Positive, ...],
        Meta(title="Points at these periods", description="a list of numbers > 0, each once, up to period_max"),
    ] = ()
    period_max: Annotated[
        _Positive | None,
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
        """Numbers of the modes asked for; "last" is -1 in an infinite chain, which has no other but "first"."""
        asked = self.mode if isinstance(self.mode, tuple) else (self.mode,)
        last = -1 if sites == math.inf else int(sites)
        return tuple({"first": 1, "last": last}[mode] if isinstance(mode, str) else mode for mode in asked)


class StabilityTable(Table, frozen=True):
    """Floquet multipliers along the families are asked for."""

    events: Annotated[bool, Meta(title="Locate changes of stability", description="true or false")] = True
    vectors: Annotated[
        bool, Meta(title="Keep the Floquet vectors at the points of `at`", description="true or false")
    ] = False


class DynamicsTable(Table, frozen=True):
    """The time evolution of one orbit, perturbed or not, from the phase where all velocities vanish."""

    S: Annotated[_Positive, Meta(title="S of the orbit", description="a finite number > 0, up to amplitude_max")]
    mode: Annotated[
        _Mode | None,
        Meta(title="Mode of its family", description="one of the modes of [family]; required where these are several"),
    ] = None
    duration: Annotated[_Positive | None, Meta(title="Time to its end", description="a finite number > 0")] = None
    periods: Annotated[
        _Positive | None, Meta(title="Periods of the orbit to its end", description="a finite number > 0")
    ] = None
    samples: Annotated[
        Annotated[int, Meta(ge=2, le=_MAX_SAMPLES)] | None,
        Meta(
            title="Number of times written, first and last included",
            description=f"a whole number >= 2 and <= {_MAX_SAMPLES} (left out: 20 a period, 401 to 4001 in all)",
        ),
    ] = None
    method: Annotated[Evolver, Meta(title="Integrator", description=_one_of(EVOLVERS))] = "cvodes"
    tolerance: Annotated[
        _Tolerance, Meta(title="Relative tolerance of one step", description="a number >= 1e-13 and <= 1e-2")
    ] = 1e-11
    size: Annotated[
        _Positive | None,
        Meta(title="Norm of the perturbation", description="a finite number > 0, with one of site, vector, seed"),
    ] = None
    site: Annotated[_Mode | None, Meta(title="Displaced site", description="a site from 1 to sites")] = None
    vector: Annotated[
        Annotated[tuple[_Finite, ...], Meta(min_length=1)] | None,
        Meta(
            title="Direction of the perturbation",
            description="a list of numbers: a displacement a site, or these and a velocity a site",
        ),
    ] = None
    seed: Annotated[
        Annotated[int, Meta(ge=0, le=2**63 - 1)] | None,
        Meta(title="Seed of random displacements", description="a whole number >= 0 and < 2^63"),
    ] = None


class ExportTable(Table, frozen=True):
    """The chain, or one of its orbits, out of Python."""

    c: Annotated[
        Literal["all"] | Annotated[tuple[CPart, ...], Meta(min_length=1)] | None,
        Meta(title="Parts written as C, in DIR/export", description=f'"all", or a list of {_one_of(C_PARTS)}'),
    ] = None
    fmu: Annotated[
        Annotated[str, Meta(pattern=r"^\w[\w.-]*\.fmu$")] | None,
        Meta(title="Functional Mock-up Unit, in DIR", description="a file name without folders that ends in .fmu"),
    ] = None
    fmi: Annotated[Fmi, Meta(title="Version of its interface", description=_one_of(FMI_VERSIONS))] = "3.0"
    S: Annotated[
        _Positive | None,
        Meta(
            title="S of the orbit",
            description="a finite number > 0, up to amplitude_max (left out: the chain without an orbit)",
        ),
    ] = None
    mode: Annotated[
        _Mode | None,
        Meta(
            title="Mode of its family",
            description="one of the modes of [family]; required with S where these are several",
        ),
    ] = None


class SearchCondition(Table, frozen=True):
    """A quantity of the orbit that is held between bounds, or equal to a number."""

    quantity: Annotated[str, Meta(title="Name of the quantity", description="a quantity by name")]
    equal: Annotated[_Finite | None, Meta(title="Its value", description="a finite number")] = None
    lower: Annotated[_Finite | None, Meta(title="Lower bound", description="a finite number")] = None
    upper: Annotated[_Finite | None, Meta(title="Upper bound", description="a finite number")] = None


class SearchTable(Table, frozen=True):
    """An orbit found by optimisation: what is free, what is optimised, what must hold."""

    objective: Annotated[
        str,
        Meta(title="Quantity that is optimised", description=_one_of(NAMED), extra_json_schema={"enum": list(NAMED)}),
    ]
    free: Annotated[
        Annotated[tuple[str, ...], Meta(min_length=1)],
        Meta(title="What is free", description=f"a list of {_one_of(FREE)}, each once"),
    ]
    maximise: Annotated[bool, Meta(title="Maximise in place of minimise", description="true or false")] = False
    bounds: Annotated[
        dict[str, tuple[float, float]],
        Meta(
            title="Bounds of what is free, and of quantities",
            description="a table of names, each with a list [lower, upper]; -inf or inf where there is none",
        ),
    ] = {}
    constraints: Annotated[
        tuple[SearchCondition, ...],
        Meta(
            title="Quantities held",
            description="a list of tables with quantity, and equal or lower and upper or one of these",
        ),
    ] = ()
    mode: Annotated[
        _Mode | _Named | None,
        Meta(
            title="Linear mode of the family",
            description='a mode from 1 to sites, "first" or "last" (left out: last for g > 0, first for g < 0)',
        ),
    ] = None
    S: Annotated[_Positive, Meta(title="S of the orbit, or of the first start", description="a finite number > 0")] = (
        1.0
    )
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


class AccuracyTable(Table, frozen=True):
    """The relative error allowed in the results, by a preset or as a number."""

    preset: Annotated[Preset | None, Meta(title="Named tolerance", description=_one_of(PRESETS))] = None
    tolerance: Annotated[
        _Tolerance | None, Meta(title="Relative tolerance", description="a number >= 1e-13 and <= 1e-2")
    ] = None

    @property
    def relative_tolerance(self) -> float:
        """The tolerance that holds: the number, else that of the preset, else that of "standard"."""
        return PRESET_TOLERANCES[self.preset or "standard"] if self.tolerance is None else self.tolerance


class MethodTable(Table, frozen=True):
    """The interchangeable methods, by name."""

    transcription: Annotated[Transcription, Meta(title="Discretisation", description=_one_of(TRANSCRIPTIONS))] = (
        "trigonometric"
    )
    degree: Annotated[
        Annotated[int, Meta(ge=2, le=12)] | None,
        Meta(
            title="Degree of the polynomials of gauss and radau",
            description="a whole number >= 2 and <= 12, with one of gauss, radau (left out: 5 to 12 by the tolerance)",
        ),
    ] = None
    corrector: Annotated[Corrector, Meta(title="Solver of a point", description=_one_of(CORRECTORS))] = "ipopt"
    walker: Annotated[
        Walker | None,
        Meta(
            title="Way along a family",
            description=f"{_one_of(WALKERS)} (left out: series with transcription trigonometric, else arclength)",
        ),
    ] = None
    flow: Annotated[Flow, Meta(title="Flow map of stability", description=_one_of(FLOWS))] = "splitting"
    tail: Annotated[
        Tail | None,
        Meta(
            title="Linear tail of a long chain",
            description=f"{_one_of(TAILS)} (left out: eliminated where it pays, and without [stability])",
        ),
    ] = None


class Scene(Table, frozen=True):
    """All that one run is asked for; what is None is neither built nor computed."""

    chain: ChainTable
    spectrum: SpectrumTable | None = None
    family: FamilyTable | None = None
    stability: StabilityTable | None = None
    dynamics: DynamicsTable | None = None
    search: SearchTable | None = None
    export: ExportTable | None = None
    accuracy: AccuracyTable = msgspec.field(default_factory=AccuracyTable)
    method: MethodTable = msgspec.field(default_factory=MethodTable)
    title: Annotated[str | None, Meta(title="Title of the results", description="a string")] = None

    def same_request(self, other: object) -> bool:
        """Whether the other scene is one of a chain as well, and equal but for the title."""
        if not isinstance(other, Scene):
            return False
        return msgspec.structs.replace(self, title=None) == msgspec.structs.replace(other, title=None)


TABLES: Mapping[str, type[Table]] = MappingProxyType(
    {
        "chain": ChainTable,
        "spectrum": SpectrumTable,
        "family": FamilyTable,
        "stability": StabilityTable,
        "dynamics": DynamicsTable,
        "search": SearchTable,
        "export": ExportTable,
        "accuracy": AccuracyTable,
        "method": MethodTable,
    }
)
