"""Tables of a scene of any model: a file that makes it, an orbit or a boundary-value problem, a continuation.

As in the tables of a scene of a chain, titles say what a key is and descriptions what it accepts. Numbers are in the
units that the model is written in.
"""

from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from casadi_skin.runs.scene_tables import Finite, Positive, Table, one_of

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
