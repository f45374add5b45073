"""The tables of a scene, and the scene: what each key is, what it accepts, and what it is where it is left out.

A field of a `Table` is a key of TOML. The docstring of the table says what each key is and what it accepts: messages,
the JSON schema and the documentation quote it. Where it does not say what is accepted, the type does, and {} stands for
the words of the type. The model is dimensionless; numbers of a model of one's own are in the units that it is written
in.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Mapping
from functools import cache
from inspect import cleandoc
from types import MappingProxyType, NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
from msgspec import Meta, Struct, field

from casadi_skin.model import methods
from casadi_skin.model.methods import Continuation, Corrector, Flow, Format, Integrator, Tail, Transcription

AMPLITUDE = "S"  # the parameter of branches that leave families
SELECTED = "select"  # the parameter by which a continuation moves the value in [orbit] select
CONSERVED = "hamiltonian"  # the conserved quantity, among what select may name
MOST_CELLS = 100_000  # whose sites may all be unknown; the same as in lattice.declaration, which loads numerics
PRESET_TOLERANCES: Mapping[str, float] = MappingProxyType({"draft": 1e-4, "standard": 1e-8, "reference": 1e-12})

# Kinds of values: a bound at the largest float is how msgspec is made to refuse inf; nan fails every comparison -------

LARGEST_NUMBER = sys.float_info.max
Infinite = Annotated[float, Meta(gt=LARGEST_NUMBER)]
Finite = Annotated[float, Meta(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
Positive = Annotated[float, Meta(gt=0, le=LARGEST_NUMBER)]
Text = Annotated[str, Meta(min_length=1)]
Tolerance = Annotated[float, Meta(ge=1e-13, le=1e-2)]
Seed = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Count = Annotated[int, Meta(ge=1, le=1_000_000)]
Samples = Annotated[int, Meta(ge=2, le=1_000_000)]
Thousands = Annotated[int, Meta(ge=1, le=1000)]
Intervals = Annotated[int, Meta(ge=1, le=1500)]  # the same as in zero.family, which loads numerics
Cells = Annotated[int, Meta(ge=1, le=MOST_CELLS)]
CellsAlong = Annotated[int, Meta(ge=1, le=1_000_000_000_000)] | Infinite
Mode = Annotated[int, Meta(extra_json_schema={"minimum": 1})]  # checked where the number of sites is known
NamedMode = Literal["first", "last"]
Modes = Annotated[tuple[Mode | NamedMode, ...], Meta(min_length=1)]
Numbers = dict[str, Finite]
One = Annotated[dict[str, Finite], Meta(min_length=1, max_length=1)]
State = tuple[Finite, ...] | Numbers
Names = Annotated[tuple[Text, ...], Meta(min_length=1)]
Formula = Text | Finite
Boundary = Literal["fixed", "free", "periodic"]
Step = Annotated[int, Meta(ge=-100_000, le=100_000)]
Preset = Literal["draft", "standard", "reference"]
Leaving = Literal["hopf", "branch point", "period doubling"]
Fixed = Literal["period", "frequency"]
CPart = Literal["rhs", "jacobian", "variational", "flow", "residual", "newton", "orbit", "ipopt"]
LEAVING: tuple[str, ...] = get_args(Leaving)  # the same as in points.diagram, which loads numerics
C_PARTS: tuple[str, ...] = get_args(CPart)  # the same as in export, which loads numerics


# The words of keys ----------------------------------------------------------------------------------------------------


def one_of(names: Iterable[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


WORDS = {  # in docstrings of tables, by what stands in braces there
    "formula": "a number, or a formula in quotes: numbers, parameters, n and m, + - * / ^ and elementary functions",
    "states": "a list of finite numbers, one a state, or a table of numbers by the names of states (left out: 0)",
    "leaving": one_of(LEAVING),
    "c_parts": one_of(C_PARTS),
    "formats": one_of(methods.FORMATS),
    "flows": one_of(methods.FLOWS),
    "full_period_flows": one_of(methods.FULL_PERIOD_FLOWS),
}


class Table(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A table of a scene: immutable, every key by name, no other key."""


@cache
def words(table: type[Table]) -> Mapping[str, tuple[str, str]]:
    """What each key of a table is and what it accepts, by the name that the key has in TOML."""
    _, _, given = cleandoc(table.__doc__ or "").partition("Attributes:\n")  # as compilers from 3.13 on leave it
    entries = re.split(r"\n {4}(?=\w)", f"\n{given}")[1:]
    said = {name: " ".join(text.split()) for name, _, text in (entry.partition(":") for entry in entries)}
    found, hints = dict[str, tuple[str, str]](), get_type_hints(table, include_extras=True)
    for key, name in zip(table.__struct_encode_fields__, table.__struct_fields__, strict=True):
        title, _, accepted = said.get(name, "").partition("; accepted: ")
        known = {**WORDS, "": words_of(hints[name])}
        for mark in re.findall(r"\{(\w*)\}", accepted):
            accepted = accepted.replace(f"{{{mark}}}", known[mark])
        found[key] = title, accepted or known[""]
    return found


def accepted_by(table: type[Table], key: str) -> str:
    """What a key of a table accepts, in words."""
    return words(table)[key][1]


def words_of(kind: Any) -> str:
    """What a type accepts, in words; empty where its key has to say it."""
    if kind is bool:
        return "true or false"
    if get_origin(kind) is Literal:
        return one_of(get_args(kind))
    if get_origin(kind) in (Union, UnionType):
        some = [inner for inner in get_args(kind) if inner is not NoneType]
        return words_of(some[0]) if len(some) == 1 else ""
    limits = getattr(kind, "__metadata__", (Meta(),))[0]
    if limits.ge == -LARGEST_NUMBER or limits.le == LARGEST_NUMBER:
        return "a finite number" if limits.gt is None else f"a finite number > {limits.gt}"
    if limits.ge is None:
        return ""
    least = f"{'a whole number' if get_args(kind)[0] is int else 'a number'} >= {limits.ge}"
    return least if limits.le is None else f"{least} and <= {limits.le}"


# A chain, a lattice or a model ----------------------------------------------------------------------------------------


class ChainTable(Table, frozen=True):
    """The chain: its length, stiffness, nonreciprocity and nonlinearity.

    Attributes:
        sites: Sites N; accepted: a whole number >= 1 and <= 10000000, or inf
        alpha: On-site stiffness
        gamma: Nonreciprocity
        g: Cubic on-site coefficient
    """

    sites: Annotated[int, Meta(ge=1, le=10_000_000)] | Infinite
    alpha: Finite
    gamma: Annotated[float, Meta(ge=-1, le=1)]
    g: Finite


class UniformTable(Table, frozen=True):
    """Values by cell that are drawn evenly, with a seed.

    Attributes:
        low: Lowest value
        high: Highest value
        seed: Seed
    """

    low: Finite
    high: Finite
    seed: Annotated[int, Meta(ge=0)]


class SiteTable(Table, frozen=True):
    """A site of each cell: mass * y'' = -onsite - damping * y' + drive + forces of bonds.

    Attributes:
        name: What bonds call the site; accepted: a name
        onsite: Restoring force; accepted: {formula}; in y too
        mass: Mass; accepted: {formula}
        damping: Factor of -y' in the force; accepted: {formula}; in y, v too
        drive: Force in time; accepted: {formula}; in t too, periodic, such as cos(omega*t)
    """

    name: Text
    onsite: Formula = "0"
    mass: Formula = "1"
    damping: Formula = "0"
    drive: Formula = "0"


class BondTable(Table, frozen=True):
    """A bond of each cell, with a force F(d) of its extension d = y_to - y_from.

    Attributes:
        start: Site that the bond starts from; accepted: the name of a site
        end: Site that the bond leads to; accepted: the name of a site
        offset: Cells from the one to the other; accepted: a list of whole numbers, one along each direction
        force: Force F(d); accepted: {formula}; in d too
        gain: The force on `from` is gain[0] * F(d), on `to` it is -gain[1] * F(d); accepted: two of these: {formula}
    """

    start: Text = field(name="from")
    end: Text = field(name="to")
    offset: Step | tuple[Step, ...]
    force: Formula = "d"
    gain: tuple[Formula, Formula] = ("1", "1")


class LatticeTable(Table, frozen=True):
    """A lattice: cells along one or two directions, their sites and bonds; formulas are data and are never run.

    Attributes:
        cells: Cells along each direction; accepted: a whole number >= 1, inf, or a list of one or two
        site: Sites of a cell; accepted: one table [[lattice.site]] or more, with name
        bond: Bonds of a cell; accepted: tables [[lattice.bond]] with from, to and offset
        boundary: What is beyond the ends: neighbours at 0, none, or the other end; accepted: "fixed", "free",
            "periodic", or a list of one a direction
        parameters: Values of parameters by name; accepted: a table of finite numbers; by cell lists, formulas in n
            and m, or { low, high, seed }
        edge: Edge whose breathers are followed, the tail behind it linear; accepted: "first" or "last" (left out: all
            sites; of more than 100000 cells the end that they lean to)
        forcing_period: Period of the drives; accepted: a formula in parameters (left out: that of the sines and
            cosines of t)
    """

    cells: CellsAlong | Annotated[tuple[Cells, ...], Meta(min_length=1, max_length=2)]
    site: Annotated[tuple[SiteTable, ...], Meta(min_length=1)]
    bond: tuple[BondTable, ...] = ()
    boundary: Boundary | tuple[Boundary, ...] = "fixed"
    parameters: dict[str, Finite | Text | tuple[Finite | tuple[Finite, ...], ...] | UniformTable] = field(
        default_factory=dict
    )
    edge: NamedMode | None = None
    forcing_period: Text | None = None

    @property
    def long(self) -> bool:
        """Whether all but the cells at one edge are a linear tail."""
        return self.edge is not None or (not isinstance(self.cells, tuple) and self.cells > MOST_CELLS)


class ModelTable(Table, frozen=True):
    """The model: a file that makes it. Running the scene runs the code in a Python file.

    Attributes:
        file: File of the model, beside the scene unless it has a path; accepted: a Python file, or a .json file
            written by save_model
        name: Name in the Python file; accepted: an OdeModel or a BoundaryValueProblem, or a function without
            arguments that returns one; none with a .json file
        parameters: Values of parameters; accepted: a table of finite numbers by the names of parameters
    """

    file: Text
    name: Text | None = None
    parameters: Numbers = field(default_factory=dict)


# What is sought: families, equilibria, orbits, solutions, and the branches that they belong to ------------------------


class SpectrumTable(Table, frozen=True):
    """Linear frequencies and modes; the table has no keys."""


class FamilyTable(Table, frozen=True):
    """The families to follow, each from its linear mode: of a chain, or of a model of second order that rests at 0.

    Attributes:
        mode: Linear modes; accepted: a mode from 1 to sites (of a model: positions), "first" or "last", or a list of
            such modes
        amplitude_max: Largest S = ||y||^2
        at: Points at these S; accepted: a list of numbers > 0, ascending up to amplitude_max
        at_Omega: Points at these frequencies; accepted: a list of numbers > 0, each once
        at_period: Points at these periods; accepted: a list of numbers > 0, each once, up to period_max
        period_max: Period at which a family ends that has not come to amplitude_max; accepted: {}, above the period
            of the linear mode (left out: no end)
        max_points: Points after which a family ends wherever it is; accepted: {} (left out: 2000)
        series: Highest order of the power series of Omega and of the profile in S; accepted: {} (left out: no
            series); of forces that are polynomials
        film: Film (GIF) of the mode at the last point asked for, or else at the end
    """

    mode: Mode | NamedMode | Modes
    amplitude_max: Positive
    at: tuple[Positive, ...] = ()
    at_Omega: tuple[Positive, ...] = ()
    at_period: tuple[Positive, ...] = ()
    period_max: Positive | None = None
    max_points: Count = 2000
    series: Annotated[int, Meta(ge=1, le=200)] | None = None  # as in follow.family_series, which loads numerics
    film: bool = False


class EquilibriumTable(Table, frozen=True):
    """An equilibrium of the model, near a guess.

    Attributes:
        start: State near which it is sought, or that a simulation starts from; accepted: {states}
        transient: Time simulated before, until the model rests; accepted: {} (left out: the start itself is the
            guess)
    """

    start: State
    transient: Positive | None = None


class OrbitTable(Table, frozen=True):
    """A periodic orbit of the model: a guess of its period and states, and conditions that select it.

    Attributes:
        start: State that a simulation starts from; accepted: {states}
        transient: Time simulated before the cycle that is the guess; accepted: {} (autonomous models: this or period)
        period: Guessed period: the guess is one period from the start; accepted: {} (autonomous models: this or
            transient; forced models: neither is needed)
        select: Value at phase zero that picks an orbit of a family; accepted: a table with one number by the name of
            a state, an output, what is conserved or "hamiltonian"; for conservative models and symmetric orbits
        section: Value at phase zero that fixes the phase; accepted: a table with one number by the name of a state or
            an output (left out: an integral condition)
        symmetric: Reversible orbit: half of it, or a quarter, is unknown
        rotations: Turns of angles in a period, after which the orbit closes but for 2 pi times as much; accepted: a
            table of whole numbers by the names of states in which the model has the period 2 pi
        cycles: Periods of the forcing after which the orbit closes; accepted: {}; forced models
    """

    start: State
    transient: Positive | None = None
    period: Positive | None = None
    select: One | None = None
    section: One | None = None
    symmetric: bool = False
    rotations: dict[str, int] | None = None
    cycles: Thousands = 1


class SolutionTable(Table, frozen=True):
    """A solution of the boundary-value problem that the file states.

    Attributes:
        guess: Where the solution is sought; accepted: {states}, or the name of a function of t in the Python file
    """

    guess: Text | tuple[Finite, ...] | Numbers


class CurveTable(Table, frozen=True):
    """A second parameter in which folds, Hopf points, period doublings and tori are followed.

    Attributes:
        parameter: Second parameter; accepted: the name of a parameter
        to: Value at which curves end
        further: Whether edges with unstable orbits on both sides are followed too, those in further_events.csv;
            accepted: {}; beside [family] alone (left out: false)
    """

    parameter: Text
    to: Finite
    further: bool = False


class ContinuationTable(Table, frozen=True):
    """The branch of equilibria, orbits or solutions in one parameter, through folds.

    Attributes:
        parameter: Parameter; accepted: the name of a parameter, or "select": the value in [orbit] select; beside
            [family] "S"
        to: Value at which the branch ends
        at: Points exactly at these values; accepted: a list of finite numbers, each once
        back_to: Value at which a branch ends that comes back beyond its start; accepted: {} on the other side of the
            start (left out: it ends at the value of its start)
        max_points: Points after which the branch ends wherever it is
        max_step: Longest step, 1 being a change of the states by their own size; accepted: a number > 0 and <= 10
        fixed: What orbits that [orbit] select picks keep in place of its value; accepted: "period" or "frequency",
            which are the same; beside [orbit] with select
        period_max: Period at which a branch of orbits ends that has not come to `to`; accepted: {}, above that of its
            start; beside [orbit] with a model that is not forced (left out: orbits that come to a homoclinic or
            heteroclinic orbit end where the parameter is that of the limit within the tolerance)
        monitors: Values of states, of orbits at phase zero, at which special points are located, where a state passes
            one and does not only touch it; accepted: a table with one number or more by the names of states; beside
            [equilibrium], [orbit] or [solution]
        switch: Special points at which the branches that leave are followed too; accepted: a list of {leaving}, each
            once; hopf beside [equilibrium] and [orbit]; multipliers, and so period doublings, need [stability]
        depth: Special points one after the other that may lie between the branch and the followed one; accepted: {};
            not beside [family] (left out: any number, half of what crosses)
        limit: Branches of the diagram, at most
        curve: Second parameter in which folds, Hopf points, doublings, tori and edges of tongues are followed;
            accepted: a table with parameter, the name of another parameter, and to, a number; beside [equilibrium],
            [orbit], [solution] or, with S free, [family]; period doublings and tori need [stability]
        gradient: Derivatives of special points by all other parameters, in gradient.csv
    """

    parameter: Text
    to: Finite
    at: tuple[Finite, ...] = ()
    back_to: Finite | None = None
    max_points: Count = 2000
    max_step: Annotated[float, Meta(gt=0, le=10)] = 0.2
    fixed: Fixed | None = None
    period_max: Positive | None = None
    monitors: Numbers | None = None
    switch: tuple[Leaving, ...] = ()
    depth: Annotated[int, Meta(ge=0)] | None = None
    limit: Thousands = 30
    curve: CurveTable | None = None
    gradient: bool = False


class StabilityTable(Table, frozen=True):
    """Floquet multipliers of every orbit.

    Attributes:
        events: Locate changes of stability
        vectors: Keep the Floquet vectors at requested points
        gradient: Derivatives of S at changes of stability by all parameters, in gradient.csv; accepted: {}; beside a
            [family] (left out: false)
        sites: Sites at the edge of a long chain on whose motion stability is computed; accepted: a whole number from
            8 to 2000, with a tail that is eliminated (left out: all sites; of infinitely or very many as many as
            localised multipliers need)
    """

    events: bool = True
    vectors: bool = False
    gradient: bool = False
    sites: Annotated[int, Meta(ge=8, le=2000)] | None = None


# Beside these: time evolution, a design, C code and FMUs, pictures, maps ----------------------------------------------


class DynamicsTable(Table, frozen=True):
    """The time evolution of one orbit, perturbed or not, from phase zero: of a family at S, else of the last orbit.

    Without [family] and [orbit] that of a mode, a kick, a direction or noise about rest.

    Attributes:
        S: S of the orbit of a family; accepted: {}, up to amplitude_max
        mode: Mode of its family, or linear mode that moves; accepted: one of the modes of [family], required where
            these are several; without [family] and [orbit] a linear mode from 1
        moving: Whether the start has velocities in place of displacements; accepted: {}; without [family] and [orbit]
        duration: Time to its end
        periods: Periods of the orbit to its end
        samples: Number of times written, first and last included; accepted: {} (left out: 20 a period, 401 to 4001 in
            all)
        method: Integrator
        tolerance: Relative tolerance of one step; accepted: a number >= 1e-13 and <= 1e-2
        size: Norm of the perturbation, or of the start; accepted: {}, with one of site, vector, seed (without an
            orbit also mode)
        site: Displaced site; accepted: a site from 1 to sites (of a model: positions; of one of first order: states)
        vector: Direction of the perturbation; accepted: a list of numbers: a displacement a site, or these and a
            velocity a site; of a model of first order a number a state
        seed: Seed of random displacements; accepted: a whole number >= 0 and < 2^63
    """

    S: Positive | None = None
    mode: Mode | None = None
    moving: bool = False
    duration: Positive | None = None
    periods: Positive | None = None
    samples: Samples | None = None
    method: Integrator = "cvodes"
    tolerance: Tolerance = 1e-11
    size: Positive | None = None
    site: Mode | None = None
    vector: Annotated[tuple[Finite, ...], Meta(min_length=1)] | None = None
    seed: Seed | None = None


class DesignCondition(Table, frozen=True):
    """A quantity that is held between bounds, or equal to a number.

    Attributes:
        quantity: What is held; accepted: a quantity by name, or a formula in such names
        equal: Its value
        lower: Lower bound
        upper: Upper bound
    """

    quantity: Text
    equal: Finite | None = None
    lower: Finite | None = None
    upper: Finite | None = None


class DesignTable(Table, frozen=True):
    """Parameters at which a quantity of orbits of a family, or of special points, is best.

    Attributes:
        quantity: What is optimised; accepted: a quantity by name, or a formula in such names; of several orbits or
            points with the letter of each before it, as "b.r - a.r"
        over: Free parameters; accepted: a list of names, each once
        maximise: Maximise in place of minimise
        bounds: Bounds of free parameters and of quantities; accepted: a table of names, each with a list [lower,
            upper]; -inf or inf where there is none
        subject_to: Quantities held; accepted: a list of tables with quantity, and equal or lower and upper or one of
            these
        mode: Linear mode of the family; accepted: a mode from 1 to sites, "first" or "last" (left out: last for g >
            0, first for g < 0)
        S: S of the orbit, or of several; accepted: a finite number > 0, or a list of such numbers (left out: 1)
        of: Special points of the branch of [continuation]; accepted: a list of kinds, each with its number where there
            are several: ["hopf", "fold 2"]
        starts: Number of starts
        seed: Seed of the starts but for the first; accepted: a whole number >= 0 and < 2^63
    """

    quantity: Text
    over: Names
    maximise: bool = False
    bounds: dict[str, tuple[float, float]] = field(default_factory=dict)
    subject_to: tuple[DesignCondition, ...] = ()
    mode: Mode | NamedMode | None = None
    S: Positive | Annotated[tuple[Positive, ...], Meta(min_length=1)] | None = None
    of: tuple[Text, ...] = ()
    starts: Annotated[int, Meta(ge=1, le=10_000)] = 1
    seed: Seed = 0


class ExportTable(Table, frozen=True):
    """The model, or one of its orbits, as C code or as an FMU.

    Attributes:
        c: Parts written as C, in DIR/export; accepted: "all", or a list of {c_parts}
        fmu: Functional Mock-up Unit, in DIR; accepted: a file name without folders that ends in .fmu
        fmi: Version of its interface
        inputs: Inputs of the FMU; accepted: names of forces on sites, such as f_1, and of parameters
        S: S of the orbit; accepted: {}, up to amplitude_max (left out: the last orbit beside [orbit], else the model
            without an orbit)
        mode: Mode of its family; accepted: one of the modes of [family]; required with S where these are several
    """

    c: Literal["all"] | Annotated[tuple[CPart, ...], Meta(min_length=1)] | None = None
    fmu: Annotated[str, Meta(pattern=r"^\w[\w.-]*\.fmu$")] | None = None
    fmi: Literal["3.0", "2.0"] = "3.0"
    inputs: tuple[str, ...] = ()
    S: Positive | None = None
    mode: Mode | None = None


class FiguresTable(Table, frozen=True):
    """The pictures of a run.

    Attributes:
        formats: Formats in which each picture is written; accepted: a list of {formats}; [] for none
    """

    formats: tuple[Format, ...] = ("png",)


class RangeTable(Table, frozen=True):
    """An axis of a map: values from one number to another, evenly or in equal ratios.

    Attributes:
        start: First value; accepted: a finite number
        to: Last value; accepted: a finite number, not the first one
        points: Number of values
        log: Equal ratios in place of equal differences
        resolution: Largest difference (ratio, with log) of neighbours where a watched quantity changes; accepted: {},
            with log > 1 (left out: nothing is refined along this axis)
    """

    start: int | Finite = field(name="from")
    to: int | Finite
    points: Annotated[int, Meta(ge=2, le=100_000)]
    log: bool = False
    resolution: Positive | None = None


_Value = int | Finite | Text
_Together = Annotated[tuple[_Value, ...], Meta(min_length=2)]  # a value for each of several parameters
AxisList = Annotated[tuple[_Value | _Together, ...], Meta(min_length=1)]


class MapTable(Table, frozen=True):
    """A map of the scene over its parameters; every key that is none of these is an axis, named by its parameter.

    Attributes:
        axes: Axes by parameter; each may stand in [map] itself; accepted: tables { from, to, points, log, resolution
            }, or lists of values; beside names with commas between them lists of lists, such as "g, mode" = [[-1.0,
            "first"], [1.0, "last"]]
        quantities: Quantities kept and drawn; accepted: a list of names of quantities (left out: all that the scene
            has)
        watch: Quantities where whose changes cells are refined; accepted: a list of names of quantities, or a table
            of lists of levels by name (left out: stable and end)
        along: Parameter along which one branch serves all cells, from the solution at the first of them; accepted: a
            range of a parameter of the model, beside [equilibrium] or [orbit] alone (left out: of orbits those cells
            alone that lie between two whose own starts lead to it)
        boundary: The boundary of stability is followed and drawn over the map
        growth: Growth over a period, log |multiplier|, from which on an instability is the first one; accepted: a
            finite number >= 0
        cell_limit: Seconds that a cell may take; accepted: {} (left out: no limit)
    """

    axes: dict[str, RangeTable | AxisList] = field(default_factory=dict)
    quantities: Names | None = None
    watch: Names | dict[str, tuple[Finite, ...]] | None = None
    along: Text | None = None
    boundary: bool = False
    growth: Annotated[float, Meta(ge=0, le=1e300)] = 0.0
    cell_limit: Positive | None = None


# How it is computed ---------------------------------------------------------------------------------------------------


class AccuracyTable(Table, frozen=True):
    """The allowed relative error of the results, by a preset or as a number.

    Attributes:
        preset: Named tolerance
        tolerance: Relative tolerance; accepted: a number >= 1e-13 and <= 1e-2
        certify: Proofs that orbits exist: of those asked for, or of all; accepted: true, false or "all"; with
            [family], needs the extra certify
    """

    preset: Preset | None = None
    tolerance: Tolerance | None = None
    certify: bool | Literal["all"] = False

    @property
    def relative_tolerance(self) -> float:
        """The tolerance: the number, else that of the preset, else that of "standard"."""
        return PRESET_TOLERANCES[self.preset or "standard"] if self.tolerance is None else self.tolerance


class MethodTable(Table, frozen=True):
    """The interchangeable methods, by name; those left out are chosen for the model.

    Attributes:
        transcription: Discretisation; accepted: {} (left out: trigonometric for families whose model is odd and
            reversible, else gauss)
        degree: Degree of the polynomials of gauss and radau; accepted: a whole number >= 1 (families: 2) and <= 12,
            with one of gauss, radau (left out: families 5 to 12 by the tolerance, others 6)
        intervals: Intervals of the first mesh of an orbit or a solution; accepted: {} (left out: 12)
        corrector: Solver of a point
        walker: Way along a family; accepted: {} (left out: series with transcription trigonometric and polynomial
            forces, else arclength)
        flow: Flow map of stability; accepted: {flows} for families (left out: splitting); {full_period_flows} for
            orbits (left out: collocation)
        tail: Linear tail of a long chain; accepted: {} (left out: eliminated where it pays, and without [stability])
    """

    transcription: Transcription | None = None
    degree: Annotated[int, Meta(ge=1, le=12)] | None = None
    intervals: Intervals | None = None
    corrector: Corrector = "ipopt"
    walker: Continuation | None = None
    flow: Flow | None = None
    tail: Tail | None = None


class Scene(Table, frozen=True):
    """A request of one run, of a chain, a lattice or a model; a table that is None is neither built nor computed.

    Attributes:
        title: Title of the results; accepted: a string
        time_limit: Seconds that a run or a map may take; accepted: a number > 0 and <= 1e7
    """

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
    design: DesignTable | None = None
    export: ExportTable | None = None
    figures: FiguresTable = field(default_factory=FiguresTable)
    map: MapTable | None = None
    accuracy: AccuracyTable = field(default_factory=AccuracyTable)
    method: MethodTable = field(default_factory=MethodTable)
    title: str | None = None
    time_limit: Annotated[float, Meta(gt=0.0, le=1e7)] | None = None

    @property
    def sites(self) -> float | None:
        """Number of sites of the chain, infinite for an endless one; None where the scene is one of a model."""
        return None if self.chain is None else self.chain.sites

    def modes(self) -> tuple[int | str, ...]:
        """The modes whose families are followed: numbers of a chain, -1 for the "last" of an endless one."""
        if self.family is None:
            return ()
        requested = self.family.mode if isinstance(self.family.mode, tuple) else (self.family.mode,)
        ends: dict[object, int] = {}
        if self.sites is not None:
            ends = {"first": 1, "last": -1 if self.sites == math.inf else int(self.sites)}
        return tuple(ends.get(mode, mode) for mode in requested)

    def given(self, *names: str) -> list[str]:
        """Which of the tables by these names the scene has."""
        return [name for name in names if getattr(self, name) is not None]

    @property
    def methods(self) -> MethodTable:
        """The table [method] with the names chosen where it leaves them out, as far as the scene alone decides."""
        chosen: dict[str, str] = {}
        if self.family is not None:
            chosen = {"flow": methods.SPLITTING}
            chosen |= {} if self.chain is None else {"transcription": methods.TRIGONOMETRIC}
        elif self.orbit is not None or self.solution is not None:
            chosen = {"flow": methods.COLLOCATION, "transcription": methods.GAUSS}
        left_out = {name: value for name, value in chosen.items() if getattr(self.method, name) is None}
        return msgspec.structs.replace(self.method, **left_out)

    @property
    def with_gradient(self) -> bool:
        """Whether derivatives of what is located are asked for."""
        return any(table is not None and table.gradient for table in (self.stability, self.continuation))

    @property
    def has_diagram(self) -> bool:
        """Whether branches that leave, or curves in two parameters, belong to the branch that is followed."""
        table = self.continuation
        further = table is not None and (table.curve is not None or bool(table.switch) or table.depth is not None)
        return self.equilibrium is not None or (further and self.family is None)

    def same_request(self, other: Scene) -> bool:
        """Whether the other scene states the same request, whatever its title and its limit of time."""
        plain = [msgspec.structs.replace(s, method=s.methods, title=None, time_limit=None) for s in (self, other)]
        return plain[0] == plain[1]


ACCEPTED_AXES = "a table { from, to, points }, or a list of values"  # of a map
OPTIONS: tuple[str, ...] = MapTable.__struct_encode_fields__
TABLES: Mapping[str, type[Table]] = MappingProxyType(
    {
        name: next(part for part in (hint, *get_args(hint)) if isinstance(part, type) and issubclass(part, Table))
        for name, hint in get_type_hints(Scene).items()
        if name not in ("title", "time_limit")
    }
)
