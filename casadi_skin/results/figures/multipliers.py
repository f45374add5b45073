"""Floquet multipliers against amplitude and in the complex plane (paper, Fig. 5a-c)."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.results.figures import style
from casadi_skin.stability.result import CutTail, Floquet
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.follow.branch import Branch
    from casadi_skin.follow.solution import Orbit
    from casadi_skin.stability.tongues.diagram import StabilityDiagram
    from casadi_skin.zero.kinds import Unresolved


# Stability along a family as its diagram has it: the frequency curve, multipliers through tongues, their angles -------

FAMILY_POINTS = 300  # along a family, evenly: with 201 lines of angles that meet are joined wrongly
IN_TONGUE, FEW_IN_TONGUE = 17, 7  # in a tongue, and in one of as many as these
MANY_TONGUES = 40
CLOSE_ANGLES = 0.1  # of pi: angles farther apart at neighbouring places are not joined
SIGNATURE_LOOKS = {1: ("#c05000", "-", "signature $+$"), -1: ("#2060b0", (0, (4.0, 1.2)), "signature $-$")}
SHADED_AREA: dict[str, Any] = {"fc": "0.88", "ec": "0.6", "hatch": "////", "lw": 0.0, "zorder": 0}


def frequency_pieces(branch: Branch, diagram: StabilityDiagram, shift: bool) -> list[tuple[bool | None, Array]]:
    """Stretches of a family with one stability each, neighbours sharing the change between them.

    Arguments:
        branch: the family.
        diagram: its stability.
        shift: whether heights are Omega - omega_j in place of Omega.

    Returns:
        Stability of each stretch, None where it is not resolved, and its points (S, height), shape (points, 2).
    """
    at = diagram.coordinates(FAMILY_POINTS, in_tongue=2)
    gaps = [(u.coordinate_start, u.coordinate_end) for u in diagram.unresolved]
    stops = {diagram.start, diagram.end, *(change.place.coordinate for change in diagram.changes)}
    ends = sorted({min(max(c, diagram.start), diagram.end) for c in (*stops, *(c for gap in gaps for c in gap))})
    joints = np.array(ends)  # taken together, so that neighbours share them to the last digit
    heights = _heights(branch, diagram, joints, shift)
    pieces: list[tuple[bool | None, Array]] = []
    for i, (left, right) in enumerate(itertools.pairwise(ends)):
        middle = 0.5 * (left + right)
        inner = at[(at > left) & (at < right)]
        line = np.vstack([heights[i], _heights(branch, diagram, inner, shift), heights[i + 1]])
        known = not any(a <= middle <= b for a, b in gaps)
        pieces.append((diagram.is_stable(middle) if known else None, line))
    return pieces


def _heights(branch: Branch, diagram: StabilityDiagram, coordinates: Array, shift: bool) -> Array:
    """S and Omega, or Omega - omega_j, at coordinates, shape (points, 2)."""
    S = diagram.S(coordinates)
    return np.column_stack([S, _shifts(branch, S) if shift else diagram.Omega(coordinates)])


def _shifts(branch: Branch, S: Array) -> Array:
    """Omega - omega_j at amplitudes, where it is too small for a difference: between points by straight lines."""
    values, shifts = branch.S, np.array([orbit.Omega_shift for orbit in branch.orbits])
    order = np.argsort(values)
    return np.asarray(np.interp(S, np.append(0.0, values[order]), np.append(0.0, shifts[order])))


def shade_unresolved(axes: Axes, unresolved: Sequence[Unresolved]) -> None:
    """A band over each stretch on which changes of stability may be missing."""
    for stretch in unresolved:
        axes.axvspan(stretch.S_start, stretch.S_end, label="changes of stability not resolved", **SHADED_AREA)


def moduli(diagram: StabilityDiagram) -> Array:
    """S and the largest |multiplier| along a family, through every tongue; shape (points, 2)."""
    at = diagram.coordinates(FAMILY_POINTS, IN_TONGUE if len(diagram.tongues) < MANY_TONGUES else FEW_IN_TONGUE)
    return np.column_stack([diagram.S(at), diagram.max_abs_multiplier(at)])


def draw_moduli(axes: Axes, diagram: StabilityDiagram, colour: Array, label: str) -> None:
    """The largest |multiplier| against S through all tongues, with a tick below where stability changes."""
    axes.plot(*moduli(diagram).T, color=colour, lw=1.2, label=label, zorder=2)
    for kind, length, width in (("real", 0.06, 1.6), ("complex", 0.035, 0.6)):
        S = [change.S for change in diagram.changes if change.kind == kind]
        if S:
            span: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "color": "black", "lw": width}
            axes.vlines(S, 0.0, length, label=f"change of stability ({kind})", **span)
    shade_unresolved(axes, diagram.unresolved)


def draw_angles(axes: Axes, diagram: StabilityDiagram) -> None:
    """Angles of the multipliers on the unit circle against S by Krein signature, with the places where two leave it.

    Where lines of both signatures cross, multipliers collide; lines that end have left the circle.
    """
    from matplotlib.collections import LineCollection

    even = np.linspace(diagram.start, diagram.end, FAMILY_POINTS)
    at = np.unique(np.append(even, [change.place.coordinate for change in diagram.changes]))
    S, angles = diagram.S(at), diagram.angles_and_growths(at)[0] / np.pi
    for sign, (colour, dashes, label) in SIGNATURE_LOOKS.items():
        lines = _followed(S, np.where(np.sign(angles) == sign, np.abs(angles), np.nan))
        looks: dict[str, Any] = {"colors": colour, "linewidths": 0.7, "linestyles": dashes, "zorder": 2}
        axes.add_collection(LineCollection(lines, label=label, **looks))
    for kind, marker, words in (("complex", "D", "collision"), ("real", "s", "real pair")):
        places = [(e.S, e.angle / np.pi) for e in diagram.changes if e.kind == kind]
        if places:
            mark: dict[str, Any] = {"ms": 3.6, "mfc": "white", "mec": "black", "mew": 0.7, "ls": "none"}
            words = f"stability changes: {words}"
            axes.plot(*np.transpose(places), marker, label=words, zorder=4, clip_on=False, **mark)
    if diagram.further:
        further = np.array([(e.S, e.angle / np.pi) for e in diagram.further])
        axes.plot(*further.T, ".", ms=2.0, color="0.3", label="of orbits that are unstable already", zorder=3)
    shade_unresolved(axes, diagram.unresolved)
    of = "the root of " if diagram.power == 2 else ""
    axes.set(ylim=(0.0, 1.0), ylabel=rf"angle of {of}$\lambda$ over $\pi$")


def _followed(S: Array, angles: Array) -> list[Array]:
    """Lines (points, 2) through the angles of one signature, NaN where there is none; angles (places, m)."""
    lines: list[list[tuple[float, float]]] = []
    active: list[list[tuple[float, float]]] = []
    last = np.empty(0)
    for place, row in zip(S.tolist(), angles, strict=True):
        values = row[np.isfinite(row)]
        joined = np.full(values.size, -1)  # the line that each angle follows: each is the other's nearest
        if last.size and values.size:
            apart = np.abs(values[:, None] - last)
            nearest = apart.argmin(axis=1)
            mutual = (apart.argmin(axis=0)[nearest] == np.arange(values.size)) & (apart.min(axis=1) <= CLOSE_ANGLES)
            joined[mutual] = nearest[mutual]
        following = [active[k] if k >= 0 else [] for k in joined.tolist()]
        lines += [line for line in following if not line]
        for line, value in zip(following, values.tolist(), strict=True):
            line.append((place, value))
        active, last = following, values
    return [np.array(line) for line in lines]


FRAME_RADIUS = 3.0  # multipliers farther from 0 than this are named in words
MODULUS_LABEL = r"$\left|\lambda\right|$"
TRIVIAL_LEFT_OUT = ("", " (trivial one left out)", " (trivial pair left out)")


def _draw_moduli(axes: Axes, branch: Branch, diagram: StabilityDiagram | None) -> None:
    """|lambda| of all multipliers off the circle, the largest as a line, against the quantity followed."""
    values = branch.values
    found = [orbit.floquet() for orbit in branch.orbits]
    off = [np.abs(floquet.others[~floquet.on_circle]) for floquet in found]
    at = np.repeat(values, [moduli.size for moduli in off])
    if at.size:
        axes.plot(at, np.concatenate(off), ".", ms=3, color="0.25", zorder=3)
    axes.axhline(1.0, color="0.6", lw=0.8, zorder=1)
    if diagram is not None:
        draw_moduli(axes, diagram, style.colours(1)[0], f"largest {MODULUS_LABEL}")
    else:
        _draw_between_points(axes, branch)
    largest = branch.max_abs_multiplier.max()
    if largest > 10.0:
        axes.set_yscale("log")
        axes.set_ylim(bottom=max(axes.get_ylim()[0], 0.2 / largest))  # multipliers of strong damping come near to 0
    elif largest == 1.0:
        axes.set_ylim(0.9, 1.1)
    if branch.space.is_family:
        axes.set(xlim=(0.0, 1.03 * values.max()), xlabel=style.amplitude_label(branch.space.model))
    else:
        axes.set_xlabel(style.plain(branch.parameter))
    trivial = found[0].trivial
    more = f" ({trivial} trivial ones left out)"  # each quantity that is conserved has two
    axes.set_ylabel(f"{MODULUS_LABEL}{TRIVIAL_LEFT_OUT[trivial] if trivial < len(TRIVIAL_LEFT_OUT) else more}")


def _draw_between_points(axes: Axes, branch: Branch) -> None:
    """The largest |lambda| of each orbit joined by lines, through 1 where a change of stability was located."""
    line: list[tuple[float, float]] = []
    stable, changes = branch.stable, list(branch.located)
    for i, (value, orbit) in enumerate(zip(branch.values.tolist(), branch.orbits, strict=True)):
        if i and stable[i] != stable[i - 1] and changes:  # multipliers leave the circle at the change itself
            line.append((changes.pop(0).value, 1.0))
        line.append((value, orbit.floquet().max_abs_multiplier))
    axes.plot(*np.transpose(line), color=style.colours(1)[0], lw=1.3, label=f"largest {MODULUS_LABEL}", zorder=2)
    for change in branch.located:
        look: dict[str, Any] = {"color": "0.4", "lw": 0.6, "ls": "-" if change.kind == "real" else "--", "zorder": 0}
        axes.axvline(change.value, label=f"change of stability ({change.kind})", **look)


def draw_plane(axes: Axes, floquet: Floquet) -> None:
    """Multipliers of one orbit in the complex plane, marked by kind."""
    from matplotlib.ticker import MaxNLocator

    others, on_circle, real = floquet.others, floquet.on_circle, floquet.real
    near, angle = np.abs(others) <= FRAME_RADIUS, np.linspace(0.0, 2.0 * np.pi, 361)
    axes.plot(np.cos(angle), np.sin(angle), color="0.7", lw=1.0, zorder=1)
    for label, chosen, marker, size, fill in (
        ("on the unit circle", on_circle, "o", 4.0, "white"),
        ("real, off the circle", ~on_circle & real, "s", 5.0, "black"),
        ("complex, off the circle", ~on_circle & ~real, "^", 5.5, "0.6"),
    ):
        shown = others[chosen & near]
        if shown.size:
            axes.plot(shown.real, shown.imag, marker, ms=size, mfc=fill, mec="black", mew=0.8, label=label, zorder=3)
    if floquet.tail is not None:
        _draw_waves(axes, floquet.tail)
    if floquet.trivial:
        words = "trivial pair" if floquet.trivial == 2 else "trivial multiplier"
        axes.plot([1.0], [0.0], "+", ms=8, color="black", label=words, zorder=4)
    if not near.all():
        axes.text(0.03, 0.03, f"{np.count_nonzero(~near)} out of the frame", transform=axes.transAxes)
    reach = 1.12 * float(np.max(np.abs(others[near]), initial=1.15))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel=r"Re $\lambda$", ylabel=r"Im $\lambda$")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))  # -1, 0, 1: a tick takes half a millisecond


def _draw_waves(axes: Axes, tail: CutTail) -> None:
    """Arcs of the continuous spectrum beside the circle, and on it their overlaps; multipliers of finite size."""

    def draw(angles: Iterable[tuple[float, float]], radius: float, label: str, **look: Any) -> None:
        for i, (start, end) in enumerate(angles):
            angle = np.linspace(start, min(end, start + 2.0 * np.pi), 181)
            words = label if i == 0 else "_"
            axes.plot(radius * np.cos(angle), radius * np.sin(angle), label=words, solid_capstyle="butt", **look)

    for sign, radius in ((1, 1.07), (-1, 0.93)):
        colour, dashes, words = SIGNATURE_LOOKS[sign]
        turned = np.sort(sign * tail.continuous.arcs, axis=1).tolist()
        draw(turned, radius, f"waves, {words}", color=colour, lw=1.6, ls=dashes, zorder=2)
    both = [pair for a, b in (one.angles for one in tail.continuous.overlaps) for pair in ((a, b), (-b, -a))]
    draw(both, 1.0, "waves of both", color="0.7", lw=3.0, zorder=1)
    if tail.finite_size.size:
        values = tail.of_finite_size.others
        label = f"finite-size, {tail.sites} sites"
        axes.plot(values.real, values.imag, ".", ms=2.5, color="0.35", label=label, zorder=3)


def requested(branch: Branch, at_most: int) -> dict[tuple[float, int], Orbit]:
    """Requested orbits by value and the number of times that it was passed before, evenly picked where there are more.

    The value is that of the quantity that the branch is followed in.
    """
    found = [(value, o) for value, o in zip(branch.values.tolist(), branch.orbits, strict=True) if o.point.requested]
    values, orbits = [value for value, _ in found], [orbit for _, orbit in found]
    keys = [(value, values[:i].count(value)) for i, value in enumerate(values)]
    picked = [round(i) for i in np.linspace(0, len(orbits) - 1, min(at_most, len(orbits)))]
    return {keys[i]: orbits[i] for i in picked}


@style.drawn
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
    if diagram is not None and not diagram.pieces:
        diagram = None
    with_angles = diagram is not None and diagram.symplectic
    figure, panels = _panels(len(chosen), with_angles)
    _draw_moduli(panels["a"], branch, diagram)
    panels["a"].set_title("(a)", loc="left", y=1.0)
    if diagram is not None and with_angles:
        draw_angles(panels["b"], diagram)
        panels["b"].set(xlim=panels["a"].get_xlim(), xlabel=panels["a"].get_xlabel())
        panels["b"].set_title("(b)", loc="left", y=1.0)
    for letter, ((value, passage), orbit) in zip("cde" if with_angles else "bcd", chosen.items(), strict=False):
        draw_plane(panels[letter], orbit.floquet())
        largest = orbit.floquet().max_abs_multiplier
        words = rf"{_place(branch, value, passage)}, max $\left|\lambda\right| = {style.number(largest, 4)}$"
        panels[letter].set_title(f"({letter})  {words}", loc="left", y=1.0)
        panels["a"].plot(value, largest, "o", ms=5, mfc="white", mec="black", zorder=5, clip_on=False)
        look: dict[str, Any] = {"ha": "right", "bbox": {"fc": "white", "ec": "none", "pad": 0.5}, "zorder": 6}
        panels["a"].annotate(letter, (value, largest), (-5, 6), textcoords="offset points", **look)
    figure.suptitle(_title(branch, title))
    return style.finished(figure, panels.values(), 3)


def _panels(planes: int, with_angles: bool) -> tuple[Figure, dict[str, Axes]]:
    """A figure with a panel of moduli (a), one of angles (b) where there is one, and complex planes."""
    if with_angles:
        figure = style.blank(*((7.0, 8.6), (7.0, 8.4), (8.4, 8.0))[planes - 1])
        rows = ("aaaaaa;bbbbbb;.cccc.", "aaaaaa;bbbbbb;cccddd", "aaaaaa;bbbbbb;ccddee")[planes - 1]
        return figure, figure.subplot_mosaic(rows, height_ratios=(0.8, 1.0, 1.0))
    figure = style.blank(*((6.8, 3.9), (9.6, 3.9), (6.8, 7.0))[planes - 1])
    panels = figure.subplot_mosaic(("ab", "abc", "ab;cd")[planes - 1])
    panels["a"].set_box_aspect(1)
    return figure, panels


def _place(branch: Branch, value: float, passage: int) -> str:
    """A value of the quantity followed, in words, and how often it was passed before."""
    name, again = style.plain(branch.parameter), f" (passage {passage + 1})" if passage else ""
    is_family = branch.space.is_family
    return (f"$S = {style.number(value)}$" if is_family else f"{name} = ${style.number(value)}$") + again


def _title(branch: Branch, name: str) -> str:
    known = {key: value for key, value in branch.orbits[0].parameters.items() if key != branch.parameter}
    words = style.title(branch.space.model, known, name)
    return f"family $j = {branch.space.coordinates.mode_number}$; {words}" if branch.space.is_family else words
