"""Stability along a family as its diagram has it: the frequency curve, multipliers through tongues, their angles."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from casadi_skin.follow.branch import Branch
    from casadi_skin.follow.unresolved import Unresolved
    from casadi_skin.stability.tongues.diagram import StabilityDiagram, Tongue

POINTS = 300  # along a family, evenly
IN_TONGUE, FEW_IN_TONGUE = 17, 7  # in a tongue that a picture shows the shape of, and in a short one beside even places
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


@dataclass(frozen=True)
class Sampled:
    """A family at places along it, even ones and its changes: angles over pi, NaN off the circle, and largest growths.

    `S` and `growths` have shape (places,), `angles` (places, m); they are None where multipliers have no signatures.
    """

    at: Array
    S: Array
    growths: Array
    angles: Array | None


def sampled(diagram: StabilityDiagram) -> Sampled:
    """The multipliers that a picture of a family shows, computed once."""
    at = np.append(np.linspace(diagram.start, diagram.end, POINTS), [c.place.coordinate for c in diagram.changes])
    at, angles = np.unique(at), None
    if diagram.symplectic:
        angles, growths = diagram.angles_and_growths(at)
        angles /= np.pi
    else:
        growths = diagram.growths(at)
    return Sampled(at, diagram.S(at), np.max(growths, axis=1, initial=0.0), angles)


def moduli(diagram: StabilityDiagram, known: Sampled | None = None) -> Array:
    """S and the largest |multiplier| along a family, through the deepest place of every tongue; shape (points, 2).

    Tongues that lie below others are left out: the largest multiplier is not theirs.
    """
    known = known or sampled(diagram)
    step = (diagram.end - diagram.start) / POINTS
    shown = [t for t in diagram.tongues if t.growth > _lowest(t, known)]
    inner = [t.start.coordinate + _bent(_length(t) / step) * _length(t) for t in shown if _length(t) > step]
    at = np.concatenate([known.at, *inner])
    inside = np.max(diagram.growths(at[known.at.size :]), axis=1, initial=0.0)
    at, first = np.unique(at, return_index=True)
    values = np.append(known.growths, inside)[first]
    narrow = [t for t in shown if _length(t) <= step]
    edges = np.array([(t.start.coordinate, t.end.coordinate) for t in narrow]).reshape(-1, 2)
    bottoms = np.array([t.growth for t in narrow])
    c = np.concatenate([at, edges.ravel(), edges.mean(axis=1)])
    heights = np.interp(c, at, values)
    heights[at.size + edges.size :] = np.maximum(heights[at.size + edges.size :], bottoms)
    order = np.argsort(c, kind="stable")
    return np.column_stack([diagram.S(c[order]), np.exp(heights[order])])


def _bent(steps: float) -> Array:
    """Places in [0, 1], closer towards its ends, for a tongue as long as some steps between even places."""
    count = IN_TONGUE if steps > IN_TONGUE else FEW_IN_TONGUE
    return 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, count))


def _lowest(tongue: Tongue, known: Sampled) -> float:
    """The least growth at places in a tongue, and beside it."""
    start, end = np.searchsorted(known.at, (tongue.start.coordinate, tongue.end.coordinate))
    return float(np.min(known.growths[max(start - 1, 0) : end + 1]))


def _length(tongue: Tongue) -> float:
    return tongue.end.coordinate - tongue.start.coordinate


def draw_moduli(axes: Axes, diagram: StabilityDiagram, colour: Array, label: str, known: Sampled | None = None) -> None:
    """The largest |multiplier| against S through all tongues, with a tick below where stability changes."""
    line = moduli(diagram, known)
    axes.plot(*line.T, color=colour, lw=1.2, label=label, zorder=2)
    for kind, length, width in (("real", 0.06, 1.6), ("complex", 0.035, 0.6)):
        S = [change.S for change in diagram.changes if change.kind == kind]
        if S:
            span: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "color": "black", "lw": width}
            axes.vlines(S, 0.0, length, label=f"change of stability ({kind})", **span)
    shade_unresolved(axes, diagram.unresolved)


def draw_angles(axes: Axes, diagram: StabilityDiagram, known: Sampled) -> None:
    """Angles of the multipliers on the unit circle against S by Krein signature, with the places where two leave it.

    Where lines of both signatures cross, multipliers collide; lines that end have left the circle.
    """
    from matplotlib.collections import LineCollection

    angles = known.angles
    assert angles is not None
    for sign, (colour, dashes, label) in SIGNATURES.items():
        lines = _followed(known.S, np.where(np.sign(angles) == sign, np.abs(angles), np.nan))
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
            mutual = (apart.argmin(axis=0)[nearest] == np.arange(values.size)) & (apart.min(axis=1) <= CLOSE)
            joined[mutual] = nearest[mutual]
        following = [active[k] if k >= 0 else [] for k in joined.tolist()]
        lines += [line for line in following if not line]
        for line, value in zip(following, values.tolist(), strict=True):
            line.append((place, value))
        active, last = following, values
    return [np.array(line) for line in lines]
