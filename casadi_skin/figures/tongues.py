"""Stability along a family as its diagram has it: the frequency curve, multipliers through tongues, their angles."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.bvp.problem import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from casadi_skin.orbits.branch import Branch
    from casadi_skin.stability.tongues import StabilityDiagram, Tongue, Unresolved

POINTS = 300  # along a family, evenly
IN_TONGUE = 17  # in a tongue that a picture shows the shape of
CLOSE = 0.1  # of pi: angles farther apart at neighbouring places are not joined
SIGNATURES = {1: ("#c05000", "-", "signature $+$"), -1: ("#2060b0", (0, (4.0, 1.2)), "signature $-$")}
SHADE: dict[str, Any] = {"fc": "0.88", "ec": "0.6", "hatch": "////", "lw": 0.0, "zorder": 0}


def frequency_pieces(branch: Branch, diagram: StabilityDiagram, shift: bool) -> list[tuple[bool | None, Array]]:
    """Stretches of a family with one stability each, neighbours sharing the change between them.

    Arguments:
        branch: the family.
        diagram: its stability.
        shift: whether heights are Omega - omega_j in place of Omega.

    Returns:
        Stability of each stretch, None where it is not resolved, and its points (S, height), shape (points, 2).
    """
    at = diagram.coordinates(POINTS, in_tongue=2)
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
        axes.axvspan(stretch.S_start, stretch.S_end, label="changes of stability not resolved", **SHADE)


def moduli(diagram: StabilityDiagram) -> Array:
    """S and the largest |multiplier| along a family, through the deepest place of every tongue; shape (points, 2)."""
    extent = diagram.end - diagram.start
    wide = [t for t in diagram.tongues if _length(t) > extent / POINTS]
    bent = 0.5 - 0.5 * np.cos(np.pi * np.arange(IN_TONGUE) / (IN_TONGUE - 1))
    at = [np.linspace(diagram.start, diagram.end, POINTS), *(t.start.coordinate + bent * _length(t) for t in wide)]
    even = np.unique(np.concatenate(at))
    values = diagram.max_abs_multiplier(even)
    narrow = [t for t in diagram.tongues if _length(t) <= extent / POINTS]
    edges = np.array([(t.start.coordinate, t.end.coordinate) for t in narrow]).reshape(-1, 2)
    bottoms = np.array([t.max_abs_multiplier for t in narrow])
    c = np.concatenate([even, edges.ravel(), edges.mean(axis=1)])
    heights = np.interp(c, even, values)
    covered = np.zeros(c.size, dtype=bool)
    for t in wide:
        covered |= (c >= t.start.coordinate) & (c <= t.end.coordinate)
    heights[~covered] = 1.0
    heights[even.size + edges.size :] = np.maximum(heights[even.size + edges.size :], bottoms)
    order = np.argsort(c, kind="stable")
    return np.column_stack([diagram.S(c[order]), heights[order]])


def _length(tongue: Tongue) -> float:
    return tongue.end.coordinate - tongue.start.coordinate


def draw_moduli(axes: Axes, diagram: StabilityDiagram, colour: Array, label: str) -> None:
    """The largest |multiplier| against S through all tongues, with a tick below where stability changes."""
    line = moduli(diagram)
    axes.plot(*line.T, color=colour, lw=1.2, label=label, zorder=2)
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

    edges = [edge.place.coordinate for edge in diagram.changes]
    at = np.unique(np.append(np.linspace(diagram.start, diagram.end, POINTS), edges))
    S, angles = diagram.S(at), diagram.rotation_angles(at) / np.pi
    for sign, (colour, dashes, label) in SIGNATURES.items():
        lines = _followed(S, np.where(np.sign(angles) == sign, np.abs(angles), np.nan))
        looks: dict[str, Any] = {"colors": colour, "linewidths": 0.7, "linestyles": dashes, "zorder": 2}
        axes.add_collection(LineCollection(lines, label=label, **looks))
    for kind, marker, words in (("complex", "D", "collision"), ("real", "s", "real pair")):
        places = [(e.S, e.angle / np.pi) for e in diagram.changes if e.kind == kind]
        if places:
            mark: dict[str, Any] = {
                "ms": 3.6,
                "mfc": "white",
                "mec": "black",
                "mew": 0.7,
                "zorder": 4,
                "clip_on": False,
            }
            axes.plot(*np.transpose(places), marker, ls="none", label=f"stability changes: {words}", **mark)
    if diagram.further:
        further = np.array([(e.S, e.angle / np.pi) for e in diagram.further])
        axes.plot(*further.T, ".", ms=2.0, color="0.3", label="of orbits that are unstable already", zorder=3)
    shade_unresolved(axes, diagram.unresolved)
    root = r"\lambda^{1/2}" if diagram.power == 2 else r"\lambda"
    axes.set(ylim=(0.0, 1.0), ylabel=rf"angle of ${root}$ over $\pi$")


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
            mutual = (apart.argmin(axis=0)[nearest] == np.arange(values.size)) & (apart.min(axis=1) <= CLOSE)
            joined[mutual] = nearest[mutual]
        following = [active[k] if k >= 0 else [] for k in joined.tolist()]
        lines += [line for line in following if not line]
        for line, value in zip(following, values.tolist(), strict=True):
            line.append((place, value))
        active, last = following, values
    return [np.array(line) for line in lines]
