"""Results drawn into axes: branches against any quantity, orbits in time, multipliers and eigenvalues in the plane."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Callable, Sequence
from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.certify.certificate import Certificate, ProvedStability, ProvedStretch
from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.dynamics.starts import Spreading
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.follow.space import EQUILIBRIA, FAMILY, ORBITS
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.lattice.linear import Bands, LatticeModes
from casadi_skin.model.arguments import check_name, check_options, short_repr
from casadi_skin.optimise.kick import SmallestKick
from casadi_skin.optimise.search import SearchResult
from casadi_skin.optimise.search_orbit import ParetoFront
from casadi_skin.points.diagram import Diagram
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.results.figures.branches import courses, draw_marks, draw_pieces, smooth, stability_pieces
from casadi_skin.results.figures.families import family_path, family_pieces
from casadi_skin.results.figures.multipliers import draw_moduli
from casadi_skin.results.figures.search import draw_starts
from casadi_skin.results.figures.style import (
    AMPLITUDE,
    DASHES,
    amplitude_label,
    blank,
    finished,
    number_sites,
    plain,
    style,
)
from casadi_skin.results.quantities import numbers_of
from casadi_skin.results.words import Rows, described
from casadi_skin.stability.growth import TransientGrowth
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Floquet
from casadi_skin.stability.tongues.diagram import LocalisedDiagram, StabilityDiagram
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statics import Spectrum

if TYPE_CHECKING:
    from collections.abc import Sequence

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
    of_family, name = result.space.connects == FAMILY, result.parameter
    if of_family and x is None and y in (None, "Omega"):
        path = family_path(result, False)
        pieces = family_pieces(result, path)
        labels = amplitude_label(result.space.model), r"frequency $\Omega$"
    else:
        chosen = x or name or next(iter(result.solutions[0].parameters), ""), y or _second(result)
        path = np.column_stack([_along(result, quantity) for quantity in chosen])
        pieces = stability_pieces(result, path) if chosen[0] == name else [(None, path)]
        labels = plain(chosen[0]), plain(chosen[1])
    if colour is None:
        colour = axes._get_lines.get_next_color()  # type: ignore[attr-defined]  # that of the next line, as axes.plot takes
    draw_pieces(axes, result, path, pieces, colour)
    draw_marks(axes, result, path, colour)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    legend_once(axes)


@draw.register(Diagram)
def _(result: Diagram, axes: Axes, x: str | None = None, y: str | None = None) -> None:
    colours = [axes._get_lines.get_next_color() for _ in range(2)]  # type: ignore[attr-defined]
    for branch in result.branches:
        draw(branch, axes, x=x, y=y, colour=colours[branch.space.connects == ORBITS])


def _second(branch: Branch) -> str:
    """The default quantity drawn upwards: the free parameter of a curve, else the first state."""
    space = branch.space
    free = [name for name in space.free if name != "period" and not name.startswith("unfolding")]
    return free[0] if space.connects == EQUILIBRIA and free else space.state_names[0]


def _along(branch: Branch, name: str) -> Array:
    """A quantity along a branch: a parameter, a state, or a number of the table.

    Of a state that moves its largest value, of an orbit of a family the value at t = 0.
    """
    states, solutions = branch.space.state_names, branch.solutions
    known = [*solutions[0].parameters, branch.parameter, *states]
    check_name("plot", name, dict.fromkeys([*known, *numbers_of(branch)]))
    if name in states and name not in solutions[0].parameters:
        place = states.index(name)
        if branch.space.connects == FAMILY:
            return np.array([orbit.evaluate(0.0, branch.space.output_sites)[place] for orbit in branch.orbits])
        return courses(branch, place)[0]
    return branch[name]


@draw.register(EdgeCurve)
def _(result: EdgeCurve, axes: Axes, colour: Any = None) -> None:
    dashes = "-" if result.kind == "real" else "--"
    axes.plot(*smooth(np.column_stack([result[result.parameter], result.S])).T, ls=dashes, lw=1.8, color=colour)
    axes.set(xlabel=plain(result.parameter), ylabel=amplitude_label(result.points[0].orbit.model))


@draw.register(Solution)
def _(result: Solution, axes: Axes, states: Sequence[str] | None = None) -> None:
    (start, end), space = result.interval, result.space
    t = np.linspace(start, end, SAMPLES)
    names = space.coordinates.position_names if space.connects == FAMILY else space.state_names  # type: ignore[attr-defined]
    _draw_states(axes, t, result.evaluate(t), names, states)


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


# Analyses drawn into axes: stability along a branch, growth, proofs, searches, kicks, modes and bands -----------------


@draw.register(SpecialPoint)
def _(result: SpecialPoint, axes: Axes, states: Sequence[str] | None = None) -> None:
    options = {} if states is None else {"states": states}
    draw(result.solution, axes, **options)


@draw.register(StabilityDiagram)
def _(result: StabilityDiagram, axes: Axes) -> None:
    colour = axes._get_lines.get_next_color()  # type: ignore[attr-defined]
    draw_moduli(axes, result, colour, "family")
    axes.set(xlabel=AMPLITUDE, ylabel=r"largest $|\lambda|$ over a period")
    legend_once(axes)


@draw.register(LocalisedDiagram)
def _(result: LocalisedDiagram, axes: Axes) -> None:
    for kind in dict.fromkeys(change.kind for change in result.all):
        chosen = [change for change in result.all if change.kind == kind]
        axes.plot([c.S for c in chosen], [c.angle for c in chosen], "o", label=kind)
    axes.set(xlabel=AMPLITUDE, ylabel=r"angle of $\lambda$ over half a period", ylim=(-0.1, np.pi + 0.1))
    legend_once(axes)


@draw.register(TransientGrowth)
def _(result: TransientGrowth, axes: Axes) -> None:
    lines = (("all perturbations", result.log10_gain), ("bounded ones", result.log10_bounded),
             ("trivial pair", result.log10_trivial))  # fmt: skip
    for dashes, (label, values) in zip(DASHES, lines, strict=False):
        axes.plot(result.t, values, ls=dashes, label=label)
    axes.set(xlabel="time $t$", ylabel=r"$\log_{10}$ of the largest gain", xlim=(result.t[0], result.t[-1]))
    legend_once(axes)


@draw.register(Certificate)
def _(result: Certificate, axes: Axes) -> None:
    if not result.proved:
        raise ValueError("plot: the certificate has no proof; accepted: one with enclosures")
    low, high = result.profile
    positions = np.arange(1, low.size + 1)
    smallest = np.where(low * high > 0.0, np.minimum(np.abs(low), np.abs(high)), 0.0)
    largest = np.maximum(np.abs(low), np.abs(high))
    axes.semilogy(positions, largest, "o", mfc="none", label="$|y_n(0)|$, proved upper bound")
    axes.semilogy(positions, largest - smallest, "_", ms=7, color="0.4", label="width of its enclosure")
    number_sites(axes, 1, low.size, "position $n$")
    legend_once(axes)


@draw.register(ProvedStability)
def _(result: ProvedStability, axes: Axes) -> None:
    if not result.signatures.size:
        raise ValueError("plot: no exponents are enclosed one by one; accepted: a proof of stability with brackets")
    for sign, mark, label in ((1, "+", "Krein signature $+$"), (-1, "x", "Krein signature $-$")):
        chosen = np.flatnonzero(result.signatures == sign)
        if not chosen.size:
            continue
        axes.errorbar(
            result.brackets[chosen].mean(axis=1), chosen + 1, xerr=0.5 * np.ptp(result.brackets[chosen], axis=1),
            fmt=mark, ms=6, lw=1.0, capsize=2.0, label=label,
        )  # fmt: skip
    axes.set(xlabel=r"exponent $\sigma$, enclosed", ylabel="number of the exponent")
    axes.set_yticks(range(1, result.signatures.size + 1, 1 + result.signatures.size // 10))
    legend_once(axes)


@draw.register(ProvedStretch)
def _(result: ProvedStretch, axes: Axes) -> None:
    ends = np.array([result.S_start, *result.breaks, result.S_end])
    axes.stairs(np.diff(ends), ends, baseline=None, color="black", lw=1.2, label="length of the proved piece")
    axes.plot(ends[:-1], np.diff(ends), "o", ms=3, color="black")
    axes.set(xlabel=AMPLITUDE, ylabel="length in $S$")
    axes.set_ylim(bottom=0.0)
    legend_once(axes)


@draw.register(SearchResult)
def _(result: SearchResult, axes: Axes) -> None:
    draw_starts(axes, result, "objective")
    legend_once(axes)


@draw.register(ParetoFront)
def _(result: ParetoFront, axes: Axes) -> None:
    axes.plot(*result.values.T, "o-", ms=4)
    axes.set(xlabel=plain(result.names[0]), ylabel=plain(result.names[1]))


@draw.register(SmallestKick)
def _(result: SmallestKick, axes: Axes) -> None:
    sites = np.arange(1, result.displacements.size + 1)
    for mark, label, values in (("o-", "displacement", result.displacements), ("s--", "velocity", result.velocities)):
        axes.plot(sites, values, mark, mfc="none", lw=0.8, label=label)
    axes.axhline(0.0, color="0.7", lw=0.7, zorder=0)
    number_sites(axes, 1, sites.size, "site $n$")
    axes.set_ylabel("smallest kick")
    legend_once(axes)


@draw.register(Spreading)
def _(result: Spreading, axes: Axes) -> None:
    axes.plot(result.t, result.participation, label="participation number (sites)")
    axes.plot(result.t, result.second_moment, ls=DASHES[1], label="second moment (cells squared)")
    axes.set(xlabel="time $t$", xlim=(result.t[0], result.t[-1]))
    axes.set_ylim(bottom=0.0)
    legend_once(axes)


@draw.register(LatticeModes)
def _(result: LatticeModes, axes: Axes) -> None:
    axes.plot(result.participation, result.frequencies.real, "o", mfc="none")
    axes.set(xlabel="participation ratio (sites)", ylabel=r"linear frequency $\omega$")


@draw.register(Bands)
def _(result: Bands, axes: Axes) -> None:
    along = result.wave_numbers[:, 0] / np.pi
    if result.wave_numbers.shape[1] == 2:
        along = np.linspace(0.0, 3.0, len(along))
        axes.set_xticks(range(4), [r"$\Gamma$", "X", "M", r"$\Gamma$"])
    axes.plot(along, np.sqrt(np.maximum(result.squares.real, 0.0)), color="black")
    axes.set(xlabel=r"wave number $k/\pi$", ylabel=r"linear frequency $\omega$")


# Any result drawn into axes -------------------------------------------------------------------------------------------


def plot(result: Any, axes: Axes | None = None, **options: Any) -> Axes:
    """Draw a result into axes, new ones of pyplot by default, and return them; see `Result.plot`."""
    from matplotlib.axes import Axes

    check_options("plot", options, draw.dispatch(type(result)))
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(layout="constrained")[1]
    if not isinstance(axes, Axes):
        raise TypeError(f"axes: given {short_repr(axes)}; accepted: axes of matplotlib, or None")
    draw(result, axes, **options)
    return axes


# Results in notebooks: a small table beside its picture ---------------------------------------------------------------


def html_table(result: Any) -> str:
    """A result as a small table beside its picture, for notebooks."""
    return page(*described(result), lambda axes: plot(result, axes))


def page(head: str, rows: Rows, draw: Callable[[Axes], object]) -> str:
    """Rows as a small table beside the picture that a function draws into axes; without it where that refuses."""
    cells = "".join(f"<tr><th>{html.escape(n)}</th><td>{html.escape(v)}</td></tr>" for n, v in rows)
    table = f"<table><caption>{html.escape(head)}</caption>{cells}</table>"
    return f'<div style="display:flex;gap:2em;align-items:center">{table}{_picture(head, draw)}</div>'


def _picture(head: str, draw: Callable[[Axes], object]) -> str:
    """A picture as part of a page; nothing where there is none."""
    with style():
        figure, stream = blank(4.2, 2.8), io.BytesIO()
        try:
            draw(figure.add_subplot())
        except (ValueError, ArithmeticError):
            return ""
        finished(figure, (), 1).savefig(stream, format="png", dpi=110)
    data = base64.b64encode(stream.getvalue()).decode()
    return f'<img alt="{html.escape(head)}" src="data:image/png;base64,{data}">'
