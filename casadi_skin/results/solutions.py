"""How solutions, branches, multipliers and evolutions are shown: lines, tables, and drawings into axes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.fmu.map_orbit import MapOrbit
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Equilibrium, Orbit, Solution
from casadi_skin.follow.space import EQUILIBRIA, FAMILY, ORBITS
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.model.arguments import check_name, short_repr, with_error
from casadi_skin.points.diagram import Diagram
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.results import words
from casadi_skin.results.figures.branches import courses, draw_edge, draw_marks, draw_pieces, stability_pieces
from casadi_skin.results.figures.families import family_path, family_pieces
from casadi_skin.results.figures.multipliers import draw_plane
from casadi_skin.results.figures.style import amplitude_label, draw_curves, next_colour, plain
from casadi_skin.results.quantities import numbers_of, unique_names
from casadi_skin.results.tables import edge_columns
from casadi_skin.stability.result import CutTail, Floquet
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest import Spectrum

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SAMPLES, FINE = 401, 501  # times of an orbit: in a table, drawn
SHOWN = 6  # states that are drawn where none are named
MOST_IN_COLUMN = 4  # words of a legend


# States in time -------------------------------------------------------------------------------------------------------


@words.show.register
def _(result: Solution) -> words.Shown:
    start, end = result.interval
    rows = [("interval", f"{start:g} to {end:g}, {result.intervals} intervals"), *words.parameters(result.parameters)]
    if result.optimum is not None:
        rows.append(("objective", f"{result.objective:.10g}: {result.status}"))
    return _in_time("Solution", result, [*rows, ("error", f"{result.error:.1e}, relative")])


@words.show.register
def _(result: Orbit) -> words.Shown:
    known = result.known_floquet or vars(result).get("_floquet")
    rows: words.Rows = []
    if result.space.connects == FAMILY:
        rows = [("S", f"{result.S:.10g}"), ("Omega", with_error(result.Omega, result.Omega_error))]
    rows += [("period", with_error(result.period, result.period_error)), *words.parameters(result.parameters)]
    rows += [("error", f"{result.profile_error:.1e}, relative, of the state")]
    rows += [("stability", _stability(known) if known is not None else "not computed; see floquet()")]
    return _in_time("Orbit", result, rows)


def _in_time(what: str, result: Any, rows: words.Rows) -> words.Shown:
    space, (start, end), in_family = result.space, result.interval, result.space.connects == FAMILY

    def columns() -> words.Columns:
        t = np.linspace(start, end, SAMPLES)
        return _states(t, space.state_names, result.evaluate(t, *([space.output_sites] if in_family else [])))

    def draw(axes: Axes, states: Sequence[str] | None = None) -> int:
        t = np.linspace(start, end, FINE)
        names = space.coordinates.position_names if in_family else space.state_names
        return _draw_states(axes, t, result.evaluate(t), names, states)

    meaning = "states over the interval or the period"
    return words.Shown(f"{what} of {words.model_words(result.model)}", rows, draw, meaning, columns)


@words.show.register
def _(result: Evolution) -> words.Shown:
    rows = [words.samples(result.t), ("states", words.listed(result.names)), *words.parameters(result.parameters)]
    rows += [("method", f"{result.method}, tolerance {result.tolerance:.1e}")]

    def draw(axes: Axes, states: Sequence[str] | None = None) -> int:
        return _draw_states(axes, result.t, result.states, result.names, states)

    title = f"Time evolution of {words.model_words(result.model)}"
    return words.Shown(title, rows, draw, "states in time", lambda: _states(result.t, result.names, result.states))


@words.show.register
def _(result: MapOrbit) -> words.Shown:
    moduli = [with_error(abs(v), e) for v, e in zip(result.multipliers, result.multiplier_errors, strict=True)]
    rows = [("period", with_error(result.period, result.period_error)), *words.parameters(result.parameters)]
    state = zip(result.state_names, result.state, result.state_error, strict=True)
    rows += [("state", words.listed(f"{name} = {with_error(value, error)}" for name, value, error in state))]
    rows += [("multipliers", words.complex_numbers(result.multipliers)), ("moduli", words.listed(moduli))]
    if not result.solver_seen:
        rows += [("solver", "its error does not show: errors are those of the FMU's map alone")]
    if not np.all(np.isfinite(result.state_error)):
        why = "1 may be a multiplier, as where something is conserved, or others are not known"
        rows += [("errors", f"not bounded: {why}")]
    unresolved = f"unresolved: {words.complex_numbers(result.undecided)} may be on the unit circle"
    rows += [("stability", {True: "stable", False: "unstable", None: unresolved}[result.stable])]

    def draw(axes: Axes, states: Sequence[str] | None = None) -> int:
        return _draw_states(axes, result.t, result.states, result.state_names, states)

    columns = partial(_states, result.t, result.state_names, result.states)
    return words.Shown(f"Orbit of {result.name}, of its map", rows, draw, "states over the period", columns)


def _states(t: Any, names: Iterable[Any], values: Any) -> words.Columns:
    return {"t": t, **dict(zip(unique_names(map(str, names), ["t"]), values.T, strict=False))}


def _draw_states(axes: Axes, t: Array, values: Array, names: Sequence[str], states: Sequence[str] | None) -> int:
    known = [str(name) for name in names]
    if isinstance(states, str) or not isinstance(states, Sequence | None):
        raise TypeError(f"states: given {short_repr(states)}; accepted: a list of names")
    most = np.sort(np.argsort(-np.ptp(values[:, : len(known)], axis=0), kind="stable")[:SHOWN])  # those that move most
    chosen = [known[i] for i in most] if states is None else list(states)
    for name in chosen:
        check_name("states", name, known)
    draw_curves(axes, t, {plain(name): values[:, known.index(name)] for name in chosen}, in_cycle=True)
    axes.set(xlabel="time $t$", xlim=(t[0], t[-1]))
    return 1 if len(chosen) < MOST_IN_COLUMN else 2


# Branches and their points --------------------------------------------------------------------------------------------


@words.show.register
def _(result: Equilibrium) -> words.Shown:
    values = dict(zip(result.space.state_names, result.positions.tolist(), strict=True))
    stable = "stable" if result.stable else f"unstable: {result.unstable} eigenvalues with a positive real part"
    rows = [("state", words.named(values)), *words.parameters(result.parameters)]
    rows += [("error", f"{result.error:.1e}, relative"), ("stability", stable)]

    def columns() -> words.Columns:
        states = dict(zip(unique_names(values, ["error"]), values.values(), strict=True))
        known = {name: value for name, value in result.parameters.items() if name not in states}
        row = {"equilibrium": 0, **known, **states, "stable": result.stable, "error": result.error}
        return {name: [value] for name, value in row.items()}

    title = f"Equilibrium of {words.model_words(result.model)}"
    return words.Shown(title, rows, words.show(result.spectrum).draw, "an equilibrium", columns)


@words.show.register
def _(result: Branch) -> words.Shown:
    space, values = result.space, result.values if result.parameter else np.zeros(0)
    plural = {FAMILY: "Family of orbits", ORBITS: "Branch of orbits", EQUILIBRIA: "Branch of equilibria"}
    what = plural.get(space.connects, "Branch of solutions")
    rows = [("points", str(len(result)))]
    if values.size:
        rows.append((result.parameter, words.course(values)))
    if result.with_stability and not space.stability_included:
        rows.append(("stable", f"{int(np.count_nonzero(result.stable))} of {len(result)} points"))
        if result.with_events and result.changes_known:
            changes = [f"{change.value:.8g}" for change in result.changes]
            rows.append(("changes of stability", words.found(changes, result.unresolved)))
    elif result.solutions and not space.stability_included and space.closes:
        rows.append(("stability", "not computed; stability=True in follow computes it"))
    special = result.special_points if space.locates_folds else ()
    missing = result.not_located if "_sought" in vars(result) else ()
    rows += [("special points", words.special_points(special))] if special else []
    rows += [("unresolved", words.listed(result.known_unresolved))] if result.known_unresolved else []
    rows += [("not located", words.listed(missing))] if missing else []

    def draw(axes: Axes, x: str | None = None, y: str | None = None, colour: Any = None) -> None:
        if not result.solutions:
            raise ValueError("plot: the branch has no points; accepted: one with points")
        if space.connects == FAMILY and x is None and y in (None, "Omega"):
            path = family_path(result, False)
            pieces = family_pieces(result, path)
            labels = amplitude_label(space.model), r"frequency $\Omega$"
        else:
            first = x or result.parameter or next(iter(result.solutions[0].parameters), "")
            second = y or _second(result)
            path = np.column_stack([_along(result, first), _along(result, second)])
            pieces = stability_pieces(result, path) if first == result.parameter else [(None, path)]
            labels = plain(first), plain(second)
        colour = next_colour(axes) if colour is None else colour
        kind = {FAMILY: "", ORBITS: "orbits", EQUILIBRIA: "equilibria"}.get(space.connects, "solutions")
        draw_pieces(axes, result, path, pieces, colour, kind)
        draw_marks(axes, result, path, colour)
        axes.set(xlabel=labels[0], ylabel=labels[1])

    return words.Shown(f"{what} of {words.model_words(space.model)}", [*rows, ("end", result.reason)], draw)


def _second(branch: Branch) -> str:
    """The default quantity drawn upwards: the free parameter of a curve, else the first state."""
    space = branch.space
    free = [name for name in space.free if name != "period" and not name.startswith("unfolding")]
    return str(free[0] if space.connects == EQUILIBRIA and free else space.state_names[0])


def _along(branch: Branch, name: str) -> Array:
    """A quantity along a branch: a parameter, a state, or a number of the table.

    Of a state that moves its largest value, of an orbit of a family the value at t = 0.
    """
    states, solutions = branch.space.state_names, branch.solutions
    known = [*solutions[0].parameters, branch.parameter, *states]
    check_name("plot", name, dict.fromkeys([*known, *numbers_of(branch)]))
    if name not in states or name in solutions[0].parameters:
        return branch[name]
    place = states.index(name)
    if branch.space.connects != FAMILY:
        return courses(branch, place)[0]
    return np.array([orbit.evaluate(0.0, branch.space.output_sites)[place] for orbit in branch.orbits])


@words.show.register
def _(result: Diagram) -> words.Shown:
    rows = [("branches", str(len(result))), ("points", str(sum(len(branch) for branch in result)))]
    rows += [("special points", words.special_points(result.special_points))]
    rows += [("not started", words.listed(result.failures))]
    first = result.branches[0]

    def draw(axes: Axes, x: str | None = None, y: str | None = None) -> None:
        colours = [next_colour(axes), next_colour(axes)]
        for branch in result.branches:
            words.show(branch).draw(axes, x=x, y=y, colour=colours[branch.space.connects == ORBITS])

    return words.Shown(f"Diagram of {words.model_words(first.space.model)} in {first.parameter}", rows, draw)


@words.show.register
def _(result: SpecialPoint) -> words.Shown:
    name, values = result.parameter, result.parameters
    rows = [(name, with_error(values[name], result.error)), *words.parameters(values, name)]
    rows += [("loses", words.listed(result.lost))] if result.lost else []

    def columns() -> words.Columns:
        known = {name: [value] for name, value in values.items()}
        return {"special point": [0], "kind": [result.kind], **known, "error": [result.error]}

    title = f"Special point ({result.kind}) of {words.model_words(result.solution.model)}"
    return words.Shown(title, rows, words.show(result.solution).draw, f"a {result.kind}", columns)


@words.show.register
def _(result: EdgeCurve) -> words.Shown:
    rows = [("points", str(len(result))), ("kind", result.kind)]
    rows += [(result.parameter, words.course(result[result.parameter])), ("S", words.course(result.S))]
    rows += [("error of S", f"up to {np.max(result.errors):.1e}"), ("end", result.reason)]

    def draw(axes: Axes, colour: Any = None) -> None:
        draw_edge(axes, result, ls="-" if result.kind == "real" else "--", lw=1.8, color=colour)

    title = f"Edge of a tongue of {words.model_words(result.points[0].orbit.model)}"
    return words.Shown(title, rows, draw, "the edge of a tongue of instability", lambda: edge_columns(result))


# Multipliers and eigenvalues ------------------------------------------------------------------------------------------


@words.show.register
def _(result: Floquet) -> words.Shown:
    rows = [("multipliers", f"{result.multipliers.size}, {result.trivial} of them trivial")]
    rows += [("largest", words.complex_numbers(sorted(result.others, key=abs, reverse=True)))]
    if result.tail is not None:
        text = f"{result.mu.size} pairs beside the trivial one, on {result.tail.sites} sites at the edge"
        rows[0] = ("localised", text)
        rows += _of_waves(result, result.tail)
    rows += [("error", f"{result.error:.1e}"), ("stability", _stability(result))]

    def columns() -> words.Columns:
        is_trivial = np.arange(result.multipliers.size) < result.trivial
        outside = np.append(np.zeros(result.trivial, dtype=bool), result.outside)
        return _plane("multiplier", result.multipliers, trivial=is_trivial, outside=outside)

    title = "Floquet multipliers"
    return words.Shown(title, rows, lambda axes: draw_plane(axes, result), title, columns)


def _stability(floquet: Floquet) -> str:
    if floquet.stable:
        return "stable"
    outside = f"{floquet.unstable_real} real and {floquet.unstable_complex} complex multipliers outside"
    if floquet.max_abs_multiplier == 1.0:  # the cut of a tail does not resolve them
        return f"unstable: {outside}"
    return f"unstable: {outside}, largest modulus {floquet.max_abs_multiplier:.8g}"


def _of_waves(result: Floquet, tail: CutTail) -> words.Rows:
    """Arcs of the continuous spectrum, their overlaps, and pairs that depend on the number of sites."""
    overlaps = tail.continuous.overlaps
    text = f"at omega T from {words.ranges(o.angles for o in overlaps)}"
    rows = [("waves", f"arcs of the circle, omega T from {words.ranges(tail.continuous.arcs)}")]
    rows += [("they overlap", text if overlaps else "nowhere with those of opposite signature")]
    count = f"{tail.finite_size.size} pairs off the circle, up to {tail.finite_size_modulus:.6g}"
    rows.append(("finite-size", f"{count}; they depend on the number of sites"))
    if tail.unresolved.size:
        rows.append(("undecided", f"{tail.unresolved.size} pairs; more stability_sites decide"))
    if result.counted is None:
        rows.append(("not counted", f"stability is that of the cut problem of {tail.sites} sites"))
    elif result.counted != result.listed:
        text = f"{result.counted} outside the circle, {result.listed} in the list"
        rows.append(("counted", f"{text}: too weakly localised to be resolved by the cut"))
    return rows


@words.show.register
def _(result: Spectrum) -> words.Shown:
    rows = [("eigenvalues", words.complex_numbers(result.values)), ("error", f"{np.max(result.errors):.1e}")]
    rows += [("stability", "stable" if result.stable else "unstable")]

    def draw(axes: Axes) -> None:
        axes.axvline(0.0, color="0.6", lw=0.8, zorder=1)
        unstable = result.values.real > result.errors
        for chosen, mark, label in ((~unstable, "o", "stable"), (unstable, "s", "unstable")):
            if np.any(chosen):
                shown = result.values[chosen]
                axes.plot(shown.real, shown.imag, mark, ms=4.5, mfc="none", label=label, zorder=3)
        axes.set(xlabel="real part", ylabel="imaginary part")

    def columns() -> words.Columns:
        return _plane("eigenvalue", result.values, error=result.errors)

    return words.Shown("Eigenvalues of the linearisation", rows, draw, "eigenvalues", columns)


def _plane(index: str, values: Any, **more: Any) -> words.Columns:
    number = np.arange(1, values.size + 1)
    return {index: number, "real": values.real, "imaginary": values.imag, "modulus": np.abs(values), **more}
