"""Results drawn into axes: branches against any quantity, orbits in time, multipliers and eigenvalues in the plane."""

from __future__ import annotations

from collections.abc import Sequence
from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.model.arguments import check_name, short_repr
from casadi_skin.points.diagram import Diagram
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.results.extremes import extremes
from casadi_skin.results.figures.bifurcation import CURVES, WIDTHS
from casadi_skin.results.figures.branch_lines import LOOKS, draw_marks, label_of, smooth, stability_pieces
from casadi_skin.results.figures.frequencies import family_path, family_pieces
from casadi_skin.results.figures.style import DASHES, amplitude_label, plain
from casadi_skin.results.quantities import numbers_of
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statics import Spectrum

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SAMPLES = 501  # of an orbit
SHOWN = 6  # components, where none are named
MOST_IN_COLUMN = 4  # words of a legend


@singledispatch
def draw(result: Any, axes: Axes, **options: Any) -> None:
    """Draw a result into axes; raises TypeError for other objects, ValueError where there is nothing to draw."""
    raise TypeError(f"no result that can be drawn: {type(result).__name__}")


@draw.register(Branch)
def _(result: Branch, axes: Axes, x: str | None = None, y: str | None = None, colour: Any = None) -> None:
    if not result.solutions:
        raise ValueError("plot: the branch has no points; accepted: one with points")
    space, name = result.space, result.parameter
    if isinstance(space, Family) and x is None and y in (None, "Omega"):
        path = family_path(result, False)
        pieces = family_pieces(result, path)
        labels = amplitude_label(space.model), r"frequency $\Omega$"
    else:
        first = name or next(iter(result.solutions[0].parameters), "")
        chosen = x or first, y or _second(result)
        path = np.column_stack([_along(result, quantity) for quantity in chosen])
        pieces = stability_pieces(result, path) if chosen[0] == name else [(None, path)]
        if not isinstance(space, Family):
            pieces = [(stable, smooth(piece)) for stable, piece in pieces]
        labels = plain(chosen[0]), plain(chosen[1])
    if colour is None:
        colour = axes._get_lines.get_next_color()  # type: ignore[attr-defined]  # that of the next line, as axes.plot takes
    for stable, piece in pieces:
        look = _look(result, stable)
        axes.plot(*piece.T, color=colour, zorder=3, **{**look, "label": label_of(look["label"], piece, path)})
    draw_marks(axes, result, path, colour)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    legend_once(axes)


@draw.register(Diagram)
def _(result: Diagram, axes: Axes, x: str | None = None, y: str | None = None) -> None:
    colours = [axes._get_lines.get_next_color() for _ in range(2)]  # type: ignore[attr-defined]
    for branch in result.branches:
        orbits = bool(branch.solutions) and isinstance(branch.solutions[0], Orbit)
        draw(branch, axes, x=x, y=y, colour=colours[orbits])


def _look(branch: Branch, stable: bool | None) -> dict[str, Any]:
    """Line style of a stretch: of a family by its stability, else by its kind too, with broader lines for orbits."""
    if isinstance(branch.space, Family):
        return LOOKS[stable]
    orbits = isinstance(branch.solutions[0], Orbit)
    curve = CURVES.get((str(getattr(branch.space, "kind", "")), orbits))
    if curve is not None:
        return {"lw": 1.8, "ls": curve[1], "label": curve[0]}
    kind = "orbits" if orbits else "equilibria" if isinstance(branch.solutions[0], Equilibrium) else "solutions"
    label = kind if stable is None else f"{kind}, {LOOKS[stable]['label']}"
    return {**LOOKS[stable], "lw": WIDTHS[orbits], "label": label}


def _second(branch: Branch) -> str:
    """The default quantity drawn upwards: the free parameter of a curve, else the first state."""
    space = branch.space
    free = [name for name in space.free if name != "period" and not name.startswith("unfolding")]
    return free[0] if isinstance(branch.solutions[0], Equilibrium) and free else space.state_names[0]


def _along(branch: Branch, name: str) -> Array:
    """A quantity along a branch: a parameter, a state, or a number of the table.

    Of a state that moves its largest value, of an orbit of a family the value at t = 0.
    """
    states, solutions = branch.space.state_names, branch.solutions
    known = [*solutions[0].parameters, branch.parameter, *states]
    check_name("plot", name, dict.fromkeys([*known, *numbers_of(branch)]))
    if name in states and name not in solutions[0].parameters:
        place = states.index(name)
        if isinstance(branch.space, Family):
            return np.array([orbit.evaluate(0.0, branch.space.output_sites)[place] for orbit in branch.orbits])
        if isinstance(solutions[0], Equilibrium):
            return np.array([solution.evaluate(0.0)[place] for solution in solutions])
        return np.array([extremes(solution)[1][place] for solution in solutions])
    return branch[name]


@draw.register(EdgeCurve)
def _(result: EdgeCurve, axes: Axes, colour: Any = None) -> None:
    dashes = "-" if result.kind == "real" else "--"
    axes.plot(*smooth(np.column_stack([result[result.parameter], result.S])).T, ls=dashes, lw=1.8, color=colour)
    axes.set(xlabel=plain(result.parameter), ylabel=amplitude_label(result.points[0].orbit.model))


@draw.register(Solution)
def _(result: Solution, axes: Axes, states: Sequence[str] | None = None) -> None:
    start, end = result.interval
    t = np.linspace(start, end, SAMPLES)
    _draw_states(axes, t, result.evaluate(t), _names(result), states)


def _names(solution: Solution) -> Sequence[str]:
    """Names of the results of `evaluate`."""
    if isinstance(solution.space, Family):
        return solution.space.coordinates.position_names
    return solution.space.state_names


@draw.register(Evolution)
def _(result: Evolution, axes: Axes, states: Sequence[str] | None = None) -> None:
    _draw_states(axes, result.t, result.states, result.names, states)


def _draw_states(axes: Axes, t: Array, values: Array, names: Sequence[str], states: Sequence[str] | None) -> None:
    known = [str(name) for name in names]
    if isinstance(states, str) or not isinstance(states, Sequence | None):
        raise TypeError(f"states: given {short_repr(states)}; accepted: a list of names")
    chosen = list(states) if states is not None else _largest(known, values)
    for i, name in enumerate(chosen):
        check_name("states", name, known)
        axes.plot(t, values[:, known.index(name)], ls=DASHES[i % len(DASHES)], label=plain(name))
    axes.set(xlabel="time $t$", xlim=(t[0], t[-1]))
    legend_once(axes, 1 if len(chosen) < MOST_IN_COLUMN else 2)


def _largest(names: Sequence[str], values: Array) -> list[str]:
    """The names of the components that move most, in their order."""
    order = np.sort(np.argsort(-np.ptp(values[:, : len(names)], axis=0), kind="stable")[:SHOWN])
    return [names[i] for i in order]


@draw.register(Equilibrium)
def _(result: Equilibrium, axes: Axes) -> None:
    draw(result.spectrum, axes)


@draw.register(Spectrum)
def _(result: Spectrum, axes: Axes) -> None:
    axes.axvline(0.0, color="0.6", lw=0.8, zorder=1)
    _draw_plane(axes, result.values, result.values.real > result.errors)
    axes.set(xlabel=r"real part", ylabel=r"imaginary part")


@draw.register(Floquet)
def _(result: Floquet, axes: Axes) -> None:
    from matplotlib.patches import Circle

    axes.add_patch(Circle((0.0, 0.0), 1.0, fill=False, ec="0.6", lw=0.8, zorder=1))
    trivial, others = result.multipliers[: result.trivial], result.others
    axes.plot(trivial.real, trivial.imag, "+", color="0.4", ms=7, label="trivial", zorder=3)
    _draw_plane(axes, others, result.outside)
    axes.set(xlabel="real part", ylabel="imaginary part", aspect="equal")
    axes.set_adjustable("datalim")


def _draw_plane(axes: Axes, values: ComplexArray, unstable: Any) -> None:
    """Points in the complex plane, unstable ones distinguished by their marks too."""
    for chosen, mark, label in ((~unstable, "o", "stable"), (unstable, "s", "unstable")):
        if np.any(chosen):
            axes.plot(values[chosen].real, values[chosen].imag, mark, ms=4.5, mfc="none", label=label, zorder=3)
    legend_once(axes)


def legend_once(axes: Axes, columns: int = 1) -> None:
    """A legend in which each label stands once, together with earlier lines."""
    drawn, labels = axes.get_legend_handles_labels()
    if not labels:
        return
    handles = {name: drawn[labels.index(name)] for name in labels}
    look: dict[str, Any] = {"frameon": True, "framealpha": 0.8, "edgecolor": "none", "fontsize": "small"}
    legend = axes.legend(handles.values(), handles.keys(), ncols=columns, **look)
    for handle, label in zip(legend.legend_handles, handles, strict=True):
        lines = [line for line, name in zip(drawn, labels, strict=True) if name == label and hasattr(line, "get_color")]
        colours = {str(line.get_color()) for line in lines}
        if len(colours) > 1 and handle is not None:  # of several branches, each in its colour
            handle.set(color="black")
