"""Floquet multipliers against amplitude and in the complex plane (paper, Fig. 5a-c)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.family import Family
from casadi_skin.results.figures.profiles import requested
from casadi_skin.results.figures.style import amplitude_label, blank, colours, finished, number, plain, style
from casadi_skin.results.figures.style import title as model_title
from casadi_skin.results.figures.tongues import SIGNATURES, Sampled, draw_angles, draw_moduli, sampled
from casadi_skin.stability.localised import LocalisedFloquet

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.follow.branch import Branch
    from casadi_skin.follow.orbit import Orbit

FRAME = 3.0  # multipliers farther from 0 than this are named in words
MODULUS = r"$\left|\lambda\right|$"
TRIVIAL_LEFT_OUT = ("", " (trivial one left out)", " (trivial pair left out)")


def _draw_moduli(axes: Axes, branch: Branch, known: Sampled | None) -> None:
    """|lambda| of all multipliers off the circle, the largest as a line, against the quantity followed."""
    values, diagram = branch.values, branch.stability_diagram
    found = [orbit.floquet() for orbit in branch.orbits]
    off = [np.abs(floquet.others[~floquet.on_circle]) for floquet in found]
    at = np.repeat(values, [moduli.size for moduli in off])
    if at.size:
        axes.plot(at, np.concatenate(off), ".", ms=3, color="0.25", zorder=3)
    axes.axhline(1.0, color="0.6", lw=0.8, zorder=1)
    if diagram is not None and known is not None:
        draw_moduli(axes, diagram, colours(1)[0], f"largest {MODULUS}", known)
    else:
        _draw_between_points(axes, branch)
    largest = branch.max_abs_multiplier.max()
    if largest > 10.0:
        axes.set_yscale("log")
        axes.set_ylim(bottom=max(axes.get_ylim()[0], 0.2 / largest))  # multipliers of strong damping come near to 0
    elif largest == 1.0:
        axes.set_ylim(0.9, 1.1)
    if isinstance(branch.space, Family):
        axes.set(xlim=(0.0, 1.03 * values.max()), xlabel=amplitude_label(branch.space.model))
    else:
        axes.set_xlabel(plain(branch.parameter))
    axes.set_ylabel(f"{MODULUS}{TRIVIAL_LEFT_OUT[branch.orbits[0].floquet().trivial]}")


def _draw_between_points(axes: Axes, branch: Branch) -> None:
    """The largest |lambda| of each orbit joined by lines, through 1 where a change of stability was located."""
    line: list[tuple[float, float]] = []
    stable, changes = branch.stable, list(branch.located)
    for i, (value, orbit) in enumerate(zip(branch.values.tolist(), branch.orbits, strict=True)):
        if i and stable[i] != stable[i - 1] and changes:  # multipliers leave the circle at the change itself
            line.append((changes.pop(0).value, 1.0))
        line.append((value, orbit.floquet().max_abs_multiplier))
    axes.plot(*np.transpose(line), color=colours(1)[0], lw=1.3, label=f"largest {MODULUS}", zorder=2)
    for change in branch.located:
        dashes = "-" if change.kind == "real" else "--"
        axes.axvline(
            change.value, color="0.4", lw=0.6, ls=dashes, label=f"change of stability ({change.kind})", zorder=0
        )


def draw_plane(axes: Axes, orbit: Orbit) -> None:
    """Multipliers of one orbit in the complex plane, marked by kind."""
    from matplotlib.ticker import MaxNLocator

    floquet = orbit.floquet()
    others, on_circle, real = floquet.others, floquet.on_circle, floquet.real
    near, angle = np.abs(others) <= FRAME, np.linspace(0.0, 2.0 * np.pi, 361)
    axes.plot(np.cos(angle), np.sin(angle), color="0.7", lw=1.0, zorder=1)
    for label, chosen, marker, size, fill in (
        ("on the unit circle", on_circle, "o", 4.0, "white"),
        ("real, off the circle", ~on_circle & real, "s", 5.0, "black"),
        ("complex, off the circle", ~on_circle & ~real, "^", 5.5, "0.6"),
    ):
        shown = others[chosen & near]
        if shown.size:
            axes.plot(shown.real, shown.imag, marker, ms=size, mfc=fill, mec="black", mew=0.8, label=label, zorder=3)
    if isinstance(floquet, LocalisedFloquet):
        _draw_waves(axes, floquet)
    if floquet.trivial:
        words = "trivial pair" if floquet.trivial == 2 else "trivial multiplier"
        axes.plot([1.0], [0.0], "+", ms=8, color="black", label=words, zorder=4)
    if not near.all():
        axes.text(0.03, 0.03, f"{np.count_nonzero(~near)} out of the frame", transform=axes.transAxes)
    reach = 1.12 * float(np.max(np.abs(others[near]), initial=1.15))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel=r"Re $\lambda$", ylabel=r"Im $\lambda$")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))  # -1, 0, 1: a tick takes half a millisecond


def _draw_waves(axes: Axes, floquet: LocalisedFloquet) -> None:
    """Arcs of the continuous spectrum beside the circle, and on it their overlaps; multipliers of finite size."""

    def draw(angles: Iterable[tuple[float, float]], radius: float, label: str, **style: Any) -> None:
        for i, (start, end) in enumerate(angles):
            angle = np.linspace(start, min(end, start + 2.0 * np.pi), 181)
            words = label if i == 0 else "_"
            axes.plot(radius * np.cos(angle), radius * np.sin(angle), label=words, solid_capstyle="butt", **style)

    arcs = [(float(start), float(end)) for start, end in floquet.continuous.arcs]
    for sign, radius in ((1, 1.07), (-1, 0.93)):
        colour, dashes, words = SIGNATURES[sign]
        turned = [(sign * start, sign * start + (end - start) * sign) for start, end in arcs]
        ordered = [(min(pair), max(pair)) for pair in turned]
        draw(ordered, radius, f"waves, {words}", color=colour, lw=1.6, ls=dashes, zorder=2)
    overlaps = [overlap.angles for overlap in floquet.continuous.overlaps]
    draw(
        [pair for a, b in overlaps for pair in ((a, b), (-b, -a))], 1.0, "waves of both", color="0.7", lw=3.0, zorder=1
    )
    if floquet.finite_size.size:
        values = floquet.of_finite_size.others
        label = f"finite-size, {floquet.sites} sites"
        axes.plot(values.real, values.imag, ".", ms=2.5, color="0.35", label=label, zorder=3)


def multiplier_figure(branch: Branch, title: str = "") -> Figure | None:
    """Moduli of the multipliers along a branch, and multipliers in the complex plane at up to three requested orbits.

    The last orbit stands in where none was requested (paper, Fig. 5a to c).

    Arguments:
        branch: a family, or another branch of orbits.
        title: stands in place of the name of the model.

    Returns:
        The figure; None where stability was not computed, or all multipliers are trivial.
    """
    if not branch.with_stability or not branch.orbits or branch.orbits[0].floquet().max_abs_multiplier == 0.0:
        return None
    chosen = requested(branch, 3) or {(float(branch.values[-1]), 0): branch.orbits[-1]}
    diagram = branch.stability_diagram
    known = sampled(diagram) if diagram is not None and diagram.pieces else None
    with_angles = known is not None and known.angles is not None
    with style():
        figure, panels = _panels(len(chosen), with_angles)
        _draw_moduli(panels["a"], branch, known)
        panels["a"].set_title("(a)", loc="left", y=1.0)
        if diagram is not None and known is not None and with_angles:
            draw_angles(panels["b"], diagram, known)
            panels["b"].set(xlim=panels["a"].get_xlim(), xlabel=panels["a"].get_xlabel())
            panels["b"].set_title("(b)", loc="left", y=1.0)
        for letter, ((value, passage), orbit) in zip("cde" if with_angles else "bcd", chosen.items(), strict=False):
            draw_plane(panels[letter], orbit)
            largest = orbit.floquet().max_abs_multiplier
            words = rf"{_place(branch, value, passage)}, max $\left|\lambda\right| = {number(largest, 4)}$"
            panels[letter].set_title(f"({letter})  {words}", loc="left", y=1.0)
            panels["a"].plot(value, largest, "o", ms=5, mfc="white", mec="black", zorder=5, clip_on=False)
            box = {"fc": "white", "ec": "none", "pad": 0.5}
            panels["a"].annotate(
                letter, (value, largest), (-5, 6), textcoords="offset points", ha="right", bbox=box, zorder=6
            )
        figure.suptitle(_title(branch, title))
        return finished(figure, panels.values(), 3, plain=True)


def _panels(planes: int, with_angles: bool) -> tuple[Figure, dict[str, Axes]]:
    """A figure with a panel of moduli (a), one of angles (b) where there is one, and complex planes."""
    if with_angles:
        figure = blank(*((7.0, 8.6), (7.0, 8.4), (8.4, 8.0))[planes - 1])
        rows = ("aaaaaa;bbbbbb;.cccc.", "aaaaaa;bbbbbb;cccddd", "aaaaaa;bbbbbb;ccddee")[planes - 1]
        return figure, figure.subplot_mosaic(rows, height_ratios=(0.8, 1.0, 1.0))
    figure = blank(*((6.8, 3.9), (9.6, 3.9), (6.8, 7.0))[planes - 1])
    panels = figure.subplot_mosaic(("ab", "abc", "ab;cd")[planes - 1])
    panels["a"].set_box_aspect(1)
    return figure, panels


def _place(branch: Branch, value: float, passage: int) -> str:
    """A value of the quantity followed, in words, and how often it was passed before."""
    name, again = plain(branch.parameter), f" (passage {passage + 1})" if passage else ""
    is_family = isinstance(branch.space, Family)
    return (f"$S = {number(value)}$" if is_family else f"{name} = ${number(value)}$") + again


def _title(branch: Branch, name: str) -> str:
    known = {key: value for key, value in branch.orbits[0].parameters.items() if key != branch.parameter}
    words = model_title(branch.space.model, known, name)
    return (
        f"family $j = {branch.space.coordinates.mode_number}$; {words}" if isinstance(branch.space, Family) else words
    )
