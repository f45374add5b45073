"""Tables of a scene beside orbits: their time evolution, C code and FMUs, a search.

As in the other tables, titles say what a key is and descriptions what it accepts.
"""

from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias, get_args

import msgspec
from msgspec import Meta

from casadi_skin.model import methods
from casadi_skin.optimise.names import FREE, NAMED
from casadi_skin.runs.scene_tables import Finite, Mode, NamedMode, Positive, Table, Tolerance, one_of

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
