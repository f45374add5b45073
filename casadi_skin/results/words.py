"""Every result in a few lines, and as a table: its title, its rows of words, and columns along its first one.

A class of results is shown by one function, which `show` finds by the class. The columns are those of data frames and
of xarray datasets, each package an extra that is imported on first use; branches have theirs from their quantities.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.certify.certificate import Certificate, ProvedStability, ProvedStretch
from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.dynamics.starts import Spreading
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.follow.space import EQUILIBRIA, FAMILY, ORBITS
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.lattice.linear import Bands, LatticeModes
from casadi_skin.model.arguments import cut
from casadi_skin.optimise.kick import SmallestKick
from casadi_skin.optimise.optimum import Optimum
from casadi_skin.optimise.search import SearchResult
from casadi_skin.optimise.search_orbit import ParetoFront
from casadi_skin.points.diagram import Diagram
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.results.dataset import Dataset, Variable, branch_to_xarray, to_xarray
from casadi_skin.results.quantities import columns_of, places_of, unique_names
from casadi_skin.results.tables import EVENT_COLUMNS, edge_columns, edge_rows
from casadi_skin.stability.growth import TransientGrowth
from casadi_skin.stability.localised import LocalisedFloquet
from casadi_skin.stability.result import Floquet
from casadi_skin.stability.tongues.diagram import LocalisedDiagram, StabilityDiagram
from casadi_skin.zero.statics import Spectrum
from casadi_skin.zero.unresolved import Unresolved, count_in_words

if TYPE_CHECKING:
    import pandas
    import xarray

MOST = 6  # special points, parameters or states that are named
LONGEST = 100  # characters of a value
SAMPLES = 401  # times of an orbit
Rows = list[tuple[str, str]]
Columns = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Shown:
    """A result as it is shown.

    Attributes:
        title, rows: its lines, each value in words.
        meaning: of its table, whose first column is the index; empty of results that are several tables, or branches.
        columns: makes the table.
    """

    title: str
    rows: Rows
    meaning: str = ""
    columns: Callable[[], Columns] = dict


@singledispatch
def show(result: Any) -> Shown:
    """A result as it is shown; raises TypeError for other objects."""
    raise TypeError(f"no result: {type(result).__name__}")


# Any result as lines, as a data frame and as a dataset ----------------------------------------------------------------


def described(result: Any) -> tuple[str, Rows]:
    """Title of a result, and its rows, each value cut to a line; raises TypeError for other objects."""
    shown = show(result)
    return shown.title, [(name, cut(value, LONGEST)) for name, value in shown.rows]


def lines(result: Any) -> str:
    """A result in a few lines."""
    head, rows = described(result)
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join([head, *(f"  {name:<{width}}  {value}" for name, value in rows)])


def to_dataframe(result: Any) -> pandas.DataFrame:
    """A result as a pandas DataFrame; raises ImportError, naming the extra, without pandas."""
    try:
        import pandas
    except ImportError as error:
        extra = 'it comes with the extra: pip install "casadi-skin[pandas]"'
        raise ImportError(f"pandas is not installed; {extra}") from error
    if isinstance(result, Branch):
        columns = columns_of(result)
        return pandas.DataFrame([{q.name: q.of(place) for q in columns} for place in places_of(result)])
    if isinstance(result, Diagram):
        frames = [to_dataframe(branch).assign(branch=n) for n, branch in enumerate(result.branches, start=1)]
        return pandas.concat(frames, ignore_index=True)
    return pandas.DataFrame(show(result).columns())


def to_dataset(result: Any) -> xarray.Dataset:
    """A result as an xarray Dataset: branches along `point`, states along `t`, multipliers along their number."""
    if isinstance(result, Branch):
        return branch_to_xarray(result)
    if isinstance(result, Diagram):
        raise ValueError(
            "to_xarray: given a diagram, whose branches have dimensions of their own; accepted: one branch"
        )
    shown = show(result)
    columns = shown.columns()
    index = next(iter(columns))
    along = [Variable(name, (index,), np.asarray(values), name) for name, values in columns.items()]
    return to_xarray(Dataset(along, {"title": shown.meaning}), (index,))


# Words ----------------------------------------------------------------------------------------------------------------


def with_error(value: float, error: float) -> str:
    """A number with its error."""
    return f"{value:.12g} +- {error:.1e}"


def _model(model: Any) -> str:
    """A model in a few words."""
    return str(getattr(model, "name", repr(model)))


def listed(items: Any) -> str:
    """Items, the first of many, and how many there are."""
    texts = [str(item) for item in items]
    more = f", ... ({len(texts)} in all)" if len(texts) > MOST else ""
    return (", ".join(texts[:MOST]) + more) or "none"


def _named(values: Mapping[str, float]) -> str:
    """Values by name, the first of many."""
    return listed([f"{name} = {value:.8g}" for name, value in values.items()])


def _parameters(values: Mapping[str, float], without: str = "period") -> Rows:
    """The row of parameters; none where there are none."""
    shown = {name: value for name, value in values.items() if name not in ("period", without)}
    return [("parameters", _named(shown))] if shown else []


def _found(entries: Sequence[str], unresolved: Collection[object]) -> str:
    """What is found on a branch, one after the other: with its count as the least where something is unresolved."""
    if not unresolved:
        return listed(entries)
    return f"{count_in_words(len(entries), unresolved)}: {listed(entries)}" if entries else "none found; see unresolved"


def _complex(values: Iterable[complex]) -> str:
    """Complex numbers in six digits."""
    return listed([f"{v.real:.6g}" if v.imag == 0 else f"{v.real:.6g}{v.imag:+.6g}i" for v in values])


def _range(values: Any, digits: int = 8) -> str:
    """Smallest and largest value."""
    return f"{np.min(values):.{digits}g} to {np.max(values):.{digits}g}"


def _ranges(pairs: Iterable[tuple[float, float]]) -> str:
    """Pairs of ends."""
    return listed([f"{a:.6g} to {b:.6g}" for a, b in pairs])


def _course(values: Any) -> str:
    """First and last value, and all between which a branch has."""
    return f"{values[0]:.8g} to {values[-1]:.8g}, within {_range(values)}"


def _times(t: Any) -> tuple[str, str]:
    return "times", f"{t.size}, from {t[0]:g} to {t[-1]:g}"


def _special(points: Iterable[SpecialPoint]) -> str:
    return listed([f"{p.kind} at {p.parameters[p.parameter]:.8g}" for p in points])


def _kinds(changes: Iterable[Any]) -> list[str]:
    return [f"{change.kind} at {change.S:.8g}" for change in changes]


def _unresolved(stretches: Iterable[Unresolved]) -> tuple[str, str]:
    return "unresolved", _ranges((u.S_start, u.S_end) for u in stretches)


def _stability(floquet: Floquet) -> str:
    if floquet.stable:
        return "stable"
    outside = f"{floquet.unstable_real} real and {floquet.unstable_complex} complex multipliers outside"
    if floquet.max_abs_multiplier == 1.0:  # the cut of a tail does not resolve them
        return f"unstable: {outside}"
    return f"unstable: {outside}, largest modulus {floquet.max_abs_multiplier:.8g}"


def _states(t: Any, names: Iterable[Any], values: Any) -> Columns:
    return {"t": t, **dict(zip(unique_names(map(str, names), ["t"]), values.T, strict=False))}


def _plane(index: str, values: Any, **more: Any) -> Columns:
    number = np.arange(1, values.size + 1)
    return {index: number, "real": values.real, "imaginary": values.imag, "modulus": np.abs(values), **more}


# Orbits, equilibria, branches, multipliers and evolutions -------------------------------------------------------------


@show.register
def _(result: Solution) -> Shown:
    start, end = result.interval
    rows = [("interval", f"{start:g} to {end:g}, {result.intervals} intervals"), *_parameters(result.parameters)]
    if result.optimum is not None:
        rows.append(("objective", f"{result.objective:.10g}: {result.status}"))
    return _in_time("Solution", result, [*rows, ("error", f"{result.error:.1e}, relative")])


@show.register
def _(result: Orbit) -> Shown:
    known = result.known_floquet or vars(result).get("_floquet")
    rows: Rows = []
    if result.space.connects == FAMILY:
        rows = [("S", f"{result.S:.10g}"), ("Omega", with_error(result.Omega, result.Omega_error))]
    rows += [("period", with_error(result.period, result.period_error)), *_parameters(result.parameters)]
    rows += [("error", f"{result.profile_error:.1e}, relative, of the state")]
    rows += [("stability", _stability(known) if known is not None else "not computed; see floquet()")]
    return _in_time("Orbit", result, rows)


def _in_time(what: str, result: Any, rows: Rows) -> Shown:
    def columns() -> Columns:
        space, (start, end) = result.space, result.interval
        t = np.linspace(start, end, SAMPLES)
        sites = [space.output_sites] if space.connects == FAMILY else []
        return _states(t, space.state_names, result.evaluate(t, *sites))

    return Shown(f"{what} of {_model(result.model)}", rows, "states over the interval or the period", columns)


@show.register
def _(result: Equilibrium) -> Shown:
    states = _named(dict(zip(result.space.state_names, result.positions.tolist(), strict=True)))
    stable = "stable" if result.stable else f"unstable: {result.unstable} eigenvalues with a positive real part"
    rows = [("state", states), *_parameters(result.parameters), ("error", f"{result.error:.1e}, relative")]

    def columns() -> Columns:
        names = unique_names(result.space.state_names, ["error"])
        states = {name: [value] for name, value in zip(names, result.positions.tolist(), strict=True)}
        values = {name: [value] for name, value in result.parameters.items() if name not in states}
        return {"equilibrium": [0], **values, **states, "stable": [result.stable], "error": [result.error]}

    rows.append(("stability", stable))
    return Shown(f"Equilibrium of {_model(result.model)}", rows, "an equilibrium", columns)


@show.register
def _(result: Branch) -> Shown:
    space, values = result.space, result.values if result.parameter else np.zeros(0)
    plural = {FAMILY: "Family of orbits", ORBITS: "Branch of orbits", EQUILIBRIA: "Branch of equilibria"}
    what = plural.get(space.connects, "Branch of solutions")
    rows = [("points", str(len(result)))]
    if values.size:
        rows.append((result.parameter, _course(values)))
    if result.with_stability and not space.stability_included:
        rows.append(("stable", f"{int(np.count_nonzero(result.stable))} of {len(result)} points"))
        if result.with_events and result.changes_known:
            rows.append(("changes of stability", _found([f"{c.value:.8g}" for c in result.changes], result.unresolved)))
    elif result.solutions and not space.stability_included and space.closes:
        rows.append(("stability", "not computed; stability=True in follow computes it"))
    special = result.special_points if space.locates_folds else ()
    rows += [("special points", _special(special))] if special else []
    left = result.known_unresolved
    rows += [("unresolved", listed(left))] if left else []
    missing = result.not_located if "_sought" in vars(result) else ()
    rows += [("not located", listed(missing))] if missing else []
    return Shown(f"{what} of {_model(space.model)}", [*rows, ("end", result.reason)])


@show.register
def _(result: Diagram) -> Shown:
    rows = [("branches", str(len(result))), ("points", str(sum(len(branch) for branch in result)))]
    rows += [("special points", _special(result.special_points)), ("not started", listed(result.failures))]
    first = result.branches[0]
    return Shown(f"Diagram of {_model(first.space.model)} in {first.parameter}", rows)


@show.register
def _(result: SpecialPoint) -> Shown:
    name, values = result.parameter, result.parameters
    rows = [(name, with_error(values[name], result.error)), *_parameters(values, name)]
    rows += [("loses", listed(result.lost))] if result.lost else []

    def columns() -> Columns:
        known = {name: [value] for name, value in values.items()}
        return {"special point": [0], "kind": [result.kind], **known, "error": [result.error]}

    title = f"Special point ({result.kind}) of {_model(result.solution.model)}"
    return Shown(title, rows, f"a {result.kind}", columns)


@show.register
def _(result: EdgeCurve) -> Shown:
    rows = [("points", str(len(result))), ("kind", result.kind)]
    rows += [(result.parameter, _course(result[result.parameter])), ("S", _course(result.S))]
    rows += [("error of S", f"up to {np.max(result.errors):.1e}"), ("end", result.reason)]
    title = f"Edge of a tongue of {_model(result.points[0].orbit.model)}"
    return Shown(title, rows, "the edge of a tongue of instability", lambda: edge_columns(result))


@show.register
def _(result: Floquet) -> Shown:
    largest = _complex(sorted(result.others, key=abs, reverse=True))
    rows = [("multipliers", f"{result.multipliers.size}, {result.trivial} of them trivial"), ("largest", largest)]
    if isinstance(result, LocalisedFloquet):
        rows[0] = ("localised", f"{result.mu.size} pairs beside the trivial one, on {result.sites} sites at the edge")
        rows += _of_waves(result)

    def columns() -> Columns:
        trivial = np.arange(result.multipliers.size) < result.trivial
        outside = np.append(np.zeros(result.trivial, dtype=bool), result.outside)
        return _plane("multiplier", result.multipliers, trivial=trivial, outside=outside)

    rows += [("error", f"{result.error:.1e}"), ("stability", _stability(result))]
    return Shown("Floquet multipliers", rows, "Floquet multipliers", columns)


def _of_waves(result: LocalisedFloquet) -> Rows:
    """Arcs of the continuous spectrum, their overlaps, and pairs that depend on the number of sites."""
    overlaps = result.continuous.overlaps
    words = f"at omega T from {_ranges(o.angles for o in overlaps)}"
    rows = [("waves", f"arcs of the circle, omega T from {_ranges(result.continuous.arcs)}")]
    rows += [("they overlap", words if overlaps else "nowhere with those of opposite signature")]
    count = f"{result.finite_size.size} pairs off the circle, up to {result.finite_size_modulus:.6g}"
    rows.append(("finite-size", f"{count}; they depend on the number of sites"))
    if result.unresolved.size:
        rows.append(("undecided", f"{result.unresolved.size} pairs; more stability_sites decide"))
    if result.counted is None:
        rows.append(("not counted", f"stability is that of the cut problem of {result.sites} sites"))
    elif result.counted != result.listed:
        words = f"{result.counted} outside the circle, {result.listed} in the list"
        rows.append(("counted", f"{words}: too weakly localised to be resolved by the cut"))
    return rows


@show.register
def _(result: Spectrum) -> Shown:
    rows = [("eigenvalues", _complex(result.values)), ("error", f"{np.max(result.errors):.1e}")]
    rows += [("stability", "stable" if result.stable else "unstable")]
    title = "Eigenvalues of the linearisation"
    return Shown(title, rows, "eigenvalues", lambda: _plane("eigenvalue", result.values, error=result.errors))


@show.register
def _(result: Evolution) -> Shown:
    rows = [_times(result.t), ("states", listed(result.names)), *_parameters(result.parameters)]
    rows += [("method", f"{result.method}, tolerance {result.tolerance:.1e}")]
    title = f"Time evolution of {_model(result.model)}"
    return Shown(title, rows, "states in time", lambda: _states(result.t, result.names, result.states))


# Analyses: stability along a branch, growth, proofs, searches, kicks, modes and bands ---------------------------------


@show.register
def _(result: StabilityDiagram) -> Shown:
    first, last = (float(piece.S(np.array([end]))[0]) for piece, end in zip(
        (result.pieces[0], result.pieces[-1]), (result.start, result.end), strict=True))  # fmt: skip
    count = count_in_words(len(result.tongues), result.unresolved)
    deepest = max((tongue.growth for tongue in result.tongues), default=0.0)
    rows = [("S", f"{first:.8g} to {last:.8g}")]
    rows += [("changes", _found([f"{change.S:.8g}" for change in result.changes], result.unresolved))]
    rows += [("tongues", f"{count}, deepest log |multiplier| {deepest:.6g}"), _unresolved(result.unresolved)]
    title = "Stability along a family"
    return Shown(title, rows, "changes of stability", lambda: _edges(result, result.changes, ("mode",)))


@show.register
def _(result: LocalisedDiagram) -> Shown:
    rows = [("changes", _found(_kinds(result.changes), result.unresolved)), ("further", listed(_kinds(result.further)))]
    without = ("mode", *(name for name in EVENT_COLUMNS if "tongue" in name))
    return Shown(
        "Localised multipliers along a family", [*rows, _unresolved(result.unresolved)],
        "changes of localised multipliers", lambda: _edges(result, result.all, without),
    )  # fmt: skip


def _edges(result: StabilityDiagram | LocalisedDiagram, edges: Sequence[Any], without: Collection[str]) -> Columns:
    rows = [*edge_rows(1, result, edges)]
    columns = {name: [row[name] for row in rows] for name in EVENT_COLUMNS if name not in without}
    return {"change": np.arange(1, len(rows) + 1), **columns}


@show.register
def _(result: TransientGrowth) -> Shown:
    largest = int(np.argmax(result.log10_bounded))
    rows = [("times", f"{result.t.size}, from 0 to {result.t[-1]:g}")]
    rows += [("largest bounded", f"10^{result.log10_bounded[largest]:.6g} at t = {result.t[largest]:.6g}")]
    rows += [("largest of all", f"10^{np.max(result.log10_gain):.6g}")]
    gains = {name: getattr(result, name) for name in ("log10_gain", "log10_bounded", "log10_trivial")}
    meaning = "largest amplification of perturbations against time"
    return Shown("Transient growth of perturbations", rows, meaning, lambda: {"t": result.t, **gains})


@show.register
def _(result: Certificate) -> Shown:
    c, odd, title = result.constants, "odd " if result.step == 2 else "", "Proof of an orbit"
    rows = [("S", repr(result.S))]
    if result.proved:
        rows += [("Omega", f"{result.Omega_digits}; computed one within {result.Omega_error:.2g}")]
        rows += [("radius", f"{result.radius:.2g}, alone within {result.uniqueness:.2g}, of norm {result.size:.3g}")]
        rows += [("constants", f"Y = {c.Y:.3g}, Z = {c.Z:.3g}, W = {c.W:.3g}")]
        rows += [("harmonics", f"{result.harmonics} {odd}ones, nu = {result.weight!r}")]
    else:
        title, rows = "No proof of an orbit", [*rows, ("reason", result.reason)]

    def columns() -> Columns:
        low, high = result.profile
        return {"position": np.arange(1, low.size + 1), "lower": low, "upper": high}

    return Shown(title, rows, "enclosures of displacements", columns)


@show.register
def _(result: ProvedStability) -> Shown:
    rows = [("S", repr(result.S)), ("verdict", result.verdict)]
    if result.signatures.size:
        plus = int(np.sum(result.signatures > 0))
        rows += [("exponents", f"{result.signatures.size}: {plus} of Krein signature +, the others of -")]
    rows += [("unstable exponent", f"{result.exponent:.6g} +- {result.radius:.2g}")] if result.radius > 0 else []
    rows += [("reason", result.reason)] if result.reason else []

    def columns() -> Columns:
        low, high = result.brackets.T
        return {"exponent": np.arange(1, low.size + 1), "lower": low, "upper": high, "signature": result.signatures}

    return Shown("Proof of stability", rows, "enclosures of exponents", columns)


@show.register
def _(result: ProvedStretch) -> Shown:
    rows = [("S", f"{result.S_start!r} to {result.S_end!r}"), ("pieces", str(result.pieces))]
    rows += [("radius", f"{result.radius:.2g}")] if np.isfinite(result.radius) else []
    rows += [("reason", result.reason)] if result.reason else []
    ends = np.array([result.S_start, *result.breaks, result.S_end])
    columns = {"piece": np.arange(1, ends.size), "S_start": ends[:-1], "S_end": ends[1:]}
    return Shown("Proof that a family is one curve", rows, "proved pieces of a family", lambda: columns)


@show.register
def _(result: SearchResult) -> Shown:
    rows = [(f"optimum {k}", _optimum(optimum)) for k, optimum in enumerate(result.optima[:4], start=1)]
    rows += [("optima", f"{len(result.optima)}, and {len(result.others)} of other families")]
    rows += [("starts", str(len(result.outcomes))), ("end", result.reason)]
    return Shown(f"Search of {_model(result.model)}", rows, "optima of a search", lambda: _optima(result.optima))


def _optimum(optimum: Optimum) -> str:
    free = dict(list(optimum.parameters.items())[:4])
    return f"objective {optimum.objective:.10g} at {_named(free) if free else 'no free number'}"


def _optima(optima: Sequence[Optimum]) -> Columns:
    names = list(optima[0].parameters) if optima else []
    columns: Columns = {"optimum": np.arange(1, len(optima) + 1), "objective": [o.objective for o in optima]}
    columns |= {name: [o.parameters[name] for o in optima] for name in names}
    return columns | {"objective_error": [o.errors.get("objective", np.nan) for o in optima]}


@show.register
def _(result: ParetoFront) -> Shown:
    both = dict(zip(result.names, result.values.T, strict=True))
    rows = [("points", f"{len(result.points)}, and {result.dominated} that others dominate")]
    rows += [(name, _range(values)) for name, values in both.items()]
    return Shown("Pareto front", rows, "a Pareto front", lambda: {**_optima(result.points), **both})


@show.register
def _(result: SmallestKick) -> Shown:
    rows = [("norm", f"{result.norm:.10g} ({result.norm_name})"), ("escapes", f"at t = {result.escape_time:.6g}")]
    rows += [("linear growth", f"{result.linear_norm:.6g}"), ("far end alone", f"{result.far_end_norm:.6g}")]
    rows += [("status", result.status)]
    columns = {"displacement": result.displacements, "velocity": result.velocities}
    table = {"site": np.arange(1, result.displacements.size + 1), **columns}
    return Shown(f"Smallest kick of {_model(result.orbit.model)}", rows, "the smallest kick", lambda: table)


@show.register
def _(result: Spreading) -> Shown:
    rows = [_times(result.t)]
    rows += [("participation", f"{result.participation[0]:.4g} to {result.participation[-1]:.4g} sites")]
    rows += [("second moment", f"{result.second_moment[0]:.4g} to {result.second_moment[-1]:.4g}")]
    columns = {"t": result.t, "energy": result.total}
    columns |= {f"centre_{k}": values for k, values in enumerate(result.centre.T, start=1)}
    columns |= {"participation": result.participation, "second_moment": result.second_moment}
    title = f"Energy over {result.energies.shape[1]} sites in time"
    return Shown(title, rows, "spreading of the energy", lambda: columns)


@show.register
def _(result: LatticeModes) -> Shown:
    omega = result.frequencies
    rows = [("frequencies", f"{omega[0].real:.8g} to {omega[-1].real:.8g}" + ("" if result.real else ", some complex"))]
    rows += [("participation", f"{_range(result.participation, 4)} sites")]
    columns = {"omega": omega.real, "growth": omega.imag, "participation": result.participation}
    table = {"mode": np.arange(1, omega.size + 1), **columns}
    return Shown(f"Linear modes: {omega.size}", rows, "linear modes", lambda: table)


@show.register
def _(result: Bands) -> Shown:
    low, high = result.squares.real.min(axis=0), result.squares.real.max(axis=0)
    rows = [("omega^2", _ranges(zip(low, high, strict=True))), ("gaps", _ranges(result.gaps))]
    rows += [("|beta|", listed([f"{beta:.6g}" for beta in result.beta]))]
    columns = {"point": np.arange(len(result.wave_numbers))}
    columns |= {f"k_{i}": values for i, values in enumerate(result.wave_numbers.T, start=1)}
    columns |= {f"omega2_{i}": values.real for i, values in enumerate(result.squares.T, start=1)}
    return Shown(f"Bands: {low.size}", rows, "bands", lambda: columns)
