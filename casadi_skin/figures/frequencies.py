"""Frequency against amplitude of families: stability, the linear band, the theory's line (paper, Fig. 3a, d and 7)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import End
from casadi_skin.figures.style import (
    AMPLITUDE,
    blank,
    colours,
    common_chain,
    finished,
    style,
    title,
)
from casadi_skin.lattice.chain import Chain
from casadi_skin.theory import linear, multiple_scales

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.orbits.branch import Branch

LABELS = 24  # as many as fit one above the other beside the frequencies


def family_path(branch: Branch, shift: bool) -> Array:
    """S and Omega (or Omega - omega_j) from the linear mode on in arclength order, shape (points + 1, 2)."""
    values = [orbit.Omega_shift if shift else orbit.Omega for orbit in branch.orbits]
    return np.column_stack([np.append(0.0, branch.S), np.append(0.0 if shift else branch.start.Omega, values)])


def stability_pieces(branch: Branch, path: Array, shift: bool) -> list[tuple[bool | None, Array]]:
    """Stretches of the path with one stability each (None: not computed), neighbours sharing the change between them.

    Changes that were not located are placed midway between the two points.
    """
    if not branch.with_stability or not branch.orbits:
        return [(None, path)]
    stable = np.append(branch.stable[0], branch.stable)  # the linear mode counts with the first orbit
    flips = np.flatnonzero(stable[1:] != stable[:-1])
    pieces: list[tuple[bool | None, Array]] = []
    rest = path[:0]
    for index, (flip, first) in enumerate(zip(flips, np.append(0, flips + 1), strict=False)):
        before, after = path[flip], path[flip + 1]
        joint = 0.5 * (before + after)
        if len(branch.changes) >= flips.size:
            change = branch.changes[index]
            part = (change.S - before[0]) / ((after[0] - before[0]) or 1.0)
            joint = np.array([change.S, before[1] + part * (after[1] - before[1]) if shift else change.Omega])
        pieces.append((bool(stable[flip]), np.vstack([rest, path[first : flip + 1], joint])))
        rest = joint[None]
    return [*pieces, (bool(stable[-1]), np.vstack([rest, path[flips[-1] + 1 if flips.size else 0 :]]))]


def _draw_family(axes: Axes, branch: Branch, path: Array, shift: bool, colour: Array) -> None:
    looks: dict[bool | None, dict[str, Any]] = {
        True: {"label": "stable", "lw": 2.0},
        False: {"label": "unstable", "lw": 2.0, "ls": (0, (3.0, 1.6))},
        None: {"label": "stability not computed", "lw": 0.9},
    }
    pieces = stability_pieces(branch, path, shift)
    for stable, piece in pieces:
        axes.plot(*piece.T, color=colour, zorder=3, **looks[stable])
    if len(pieces) > 1:
        joints = np.array([piece[-1] for _, piece in pieces[:-1]])
        axes.plot(*joints.T, "|", ms=7, mew=0.9, color="black", label="change of stability", zorder=5)
    if branch.space.linear is not None:
        _draw_theory(axes, *branch.space.linear, np.array([0.0, path[:, 0].max()]), shift)
    marked = [i + 1 for i, orbit in enumerate(branch.orbits) if orbit.point.requested]
    if marked:
        axes.plot(*path[marked].T, "o", ms=4, mfc="white", mec=colour, label="requested", zorder=6, clip_on=False)
    if branch.end is not End.REACHED:
        axes.plot(*path[-1], "x", ms=6, color="black", label="ended early", zorder=7)


def _draw_theory(axes: Axes, chain: Chain, mode: int, S: Array, shift: bool) -> None:
    parameters = (chain.sites, chain.alpha, chain.gamma, chain.g, mode)
    theory = multiple_scales.frequency_slope(*parameters) * S if shift else multiple_scales.frequency(*parameters, S)
    axes.plot(
        S, theory, color="black", lw=0.8, ls=(0, (1.0, 3.0)), label="multiple scales, first order in $S$", zorder=4
    )


def draw_band(axes: Axes, chain: Chain, offset: float = 0.0) -> None:
    """From omega_1 to omega_N of the chain, a line where they are the same; less `offset`."""
    modes = np.array([1, chain.sites])
    finite = not chain.infinite
    squares = linear.squared_frequency(chain.sites, chain.alpha, chain.gamma, modes) if finite else chain.band()
    low, high = np.sqrt(np.maximum(squares, 0.0)) - offset
    is_line = squares[1] - squares[0] <= 1e-12 * abs(squares[1])
    label, width = ("linear frequency", 2.5) if is_line else ("linear band", 0.0)
    axes.axhspan(low, high, fc="0.9", ec="0.75", lw=width, label=label, zorder=0)


def label_ends(axes: Axes, branches: Sequence[Branch], ends: Array) -> None:
    """Write each family's mode where its line ends; of those at the right outside the frame, apart from each other."""
    (low, high), right = axes.get_ylim(), axes.get_xlim()[1]
    heights = (ends[:, 1] - low) / (high - low)
    outside = [int(i) for i in np.argsort(heights, kind="stable") if ends[i, 0] > 0.97 * right]
    inside = set(range(len(branches))) - set(outside)
    outside = outside[:: -(-len(outside) // LABELS) or 1]
    gap, places = 0.048 if len(outside) < 22 else 1.0 / LABELS, heights[outside]
    for i in range(1, len(places)):
        places[i] = max(places[i], places[i - 1] + gap)
    for i in range(len(places))[::-1]:
        places[i] = min(places[i], 1.0 - gap * (len(places) - 1 - i))
    leader = {"arrowstyle": "-", "lw": 0.5, "color": "0.45", "shrinkA": 0, "shrinkB": 0}
    common: dict[str, Any] = {"va": "center", "xycoords": "data", "annotation_clip": False}
    for i, place in zip(outside, places, strict=True):
        text, at = f"$j = {branches[i].space.coordinates.mode_number}$", (1.045, float(place))
        axes.annotate(text, tuple(ends[i]), at, textcoords="axes fraction", arrowprops=leader, **common)
    for i in inside:
        text = f"$j = {branches[i].space.coordinates.mode_number}$"
        axes.annotate(text, tuple(ends[i]), (6, 0), textcoords="offset points", zorder=8, **common)


def frequency_figure(branches: Sequence[Branch]) -> Figure:
    """Omega against S of families of one chain, stable solid and unstable dashed (paper, Fig. 3a and d).

    Of one family whose frequency hardly moves, Omega - omega_j is shown. Raises ValueError for no branch, and for
    branches of different chains.
    """
    chain = common_chain(branches)
    with style():
        figure = blank(6.0, 4.6)
        axes = figure.add_subplot()
        paths = [family_path(branch, False) for branch in branches]
        shift = len(branches) == 1 and bool(np.ptp(paths[0][:, 1]) < 1e-4 * paths[0][0, 1])
        if shift:
            paths = [family_path(branches[0], True)]
        draw_band(axes, chain, branches[0].start.Omega if shift else 0.0)
        for branch, path, colour in zip(branches, paths, colours(len(branches)), strict=True):
            _draw_family(axes, branch, path, shift, colour)
        points = np.concatenate(paths)
        low, high = points[:, 1].min(), points[:, 1].max()
        margin = 0.07 * (high - low) or 0.05 * (high or 1.0)
        axes.set(xlim=(0.0, points[:, 0].max() or 1.0), ylim=(low - margin, high + margin), title=title(chain))
        label_ends(axes, branches, np.array([path[-1] for path in paths]))
        mode = branches[0].space.coordinates.mode_number
        label = rf"frequency shift $\Omega - \omega_{{{mode}}}$" if shift else r"frequency $\Omega$"
        axes.set(xlabel=AMPLITUDE, ylabel=label)
        return finished(figure, [axes], 3, in_black=True)
