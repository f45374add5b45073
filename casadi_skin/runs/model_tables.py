"""Tables of a scene of any model: a file that makes it, an orbit or a boundary-value problem, a continuation.

As in the tables of a scene of a chain, titles say what a key is and descriptions what it accepts. Numbers are in the
units that the model is written in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias, get_args

import msgspec
from msgspec import Meta

from casadi_skin.model import methods
from casadi_skin.optimise.names import FREE, NAMED
from casadi_skin.runs.scene_tables import Finite, Mode, NamedMode, Positive, Table, Tolerance, one_of

AMPLITUDE = "S"  # the parameter of branches that leave families
SELECTED = "select"  # the parameter by which a continuation moves the value in [orbit] select
CONSERVED = "hamiltonian"  # the conserved quantity, among what select may name

Leaving = Literal["hopf", "branch point", "period doubling"]
LEAVING: tuple[str, ...] = get_args(Leaving)  # the same as in equilibria, which loads numerics

_MAX_POINTS = 1_000_000
_MAX_CYCLES = 1000
_MAX_BRANCHES = 1000

_Named = dict[str, Finite]
_Text = Annotated[str, Meta(min_length=1)]
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
