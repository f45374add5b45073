"""A branch as lines in a plane: a piece for each stretch of one stability, and marks of what stands out on it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import End
from casadi_skin.orbits.orbit import Orbit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from casadi_skin.orbits.branch import Branch

SAME_PLACE = 5e-3  # of the extent of a branch: a distance that a picture does not show
LOOKS: dict[bool | None, dict[str, Any]] = {
    True: {"label": "stable", "lw": 2.0},
    False: {"label": "unstable", "lw": 2.0, "ls": (0, (3.0, 1.6))},
    None: {"label": "stability not computed", "lw": 0.9},
}


def stability_pieces(branch: Branch, path: Array) -> list[tuple[bool | None, Array]]:
    """Stretches of a path with one stability each, neighbours sharing the change between them.

    Arguments:
        branch: the branch.
        path: its points in the plane, shape (points, 2), in its order; the quantity followed comes first, and where
            there is one point more than solutions, that is the limit that the branch starts from.

    Returns:
        Stability of each stretch (None: not computed), and its points. A change that was not located is placed at the
        fold, where one of its two points is that, else midway.
    """
    if not branch.with_stability or not branch.solutions:
        return [(None, path)]
    stable = np.append(np.repeat(branch.stable[:1], len(path) - len(branch)), branch.stable)
    flips = np.flatnonzero(stable[1:] != stable[:-1])
    located, at_fold = len(branch.located) >= flips.size, special_places(branch, path)
    pieces: list[tuple[bool | None, Array]] = []
    rest = path[:0]
    for index, (flip, first) in enumerate(zip(flips, np.append(0, flips + 1), strict=False)):
        before, after = path[flip], path[flip + 1]
        joint = 0.5 * (before + after)
        if located:
            value = branch.located[index].value
            part = (value - before[0]) / ((after[0] - before[0]) or 1.0)
            joint = np.array([value, before[1] + part * (after[1] - before[1])])
        elif flip in at_fold or flip + 1 in at_fold:
            joint = before if flip in at_fold else after
        pieces.append((bool(stable[flip]), np.vstack([rest, path[first : flip + 1], joint])))
        rest = joint[None]
    return [*pieces, (bool(stable[-1]), np.vstack([rest, path[flips[-1] + 1 if flips.size else 0 :]]))]


def special_places(branch: Branch, path: Array) -> dict[int, str]:
    """Kinds of the special points that were located while the branch was followed, by their places in a path."""
    lead = len(path) - len(branch)
    return {lead + i: s.point.special for i, s in enumerate(branch.solutions) if s.point.special}


def draw_lines(
    axes: Axes, branch: Branch, path: Array, pieces: Sequence[tuple[bool | None, Array]], colour: Any
) -> None:
    """The path of a branch in pieces, as `stability_pieces` makes them, with marks of its changes of stability."""
    for stable, piece in pieces:
        axes.plot(*piece.T, color=colour, zorder=3, **(LOOKS[stable] if _may_be_stable(branch) else {"lw": 1.4}))
    joints = np.array([piece[-1] for _, piece in pieces[:-1]]).reshape(-1, 2)
    joints = joints[~_are_marked(joints, path[list(special_places(branch, path))], np.ptp(path, axis=0))]
    if joints.size:
        axes.plot(*joints.T, "|", ms=7, mew=0.9, color="black", label="change of stability", zorder=5)


def _are_marked(joints: Array, special: Array, extent: Array) -> NDArray[np.bool_]:
    """Which changes of stability lie at a special point as far as a picture shows, shape (joints,)."""
    apart = np.abs(joints[:, None] - special) <= SAME_PLACE * extent
    return np.asarray(np.any(np.all(apart, axis=2), axis=1))


def _may_be_stable(branch: Branch) -> bool:
    """Whether its solutions are orbits."""
    return all(isinstance(solution, Orbit) for solution in branch.solutions[:1])


def draw_marks(axes: Axes, branch: Branch, path: Array, colour: Any) -> None:
    """Marks of folds, of values that were requested, and of an early end."""
    places = special_places(branch, path)
    for kind in dict.fromkeys(places.values()):
        chosen = [i for i, found in places.items() if found == kind]
        axes.plot(*path[chosen].T, "D", ms=5, mfc="0.6", mec="black", ls="none", label=kind, zorder=5)
    lead = len(path) - len(branch)
    marked = [lead + i for i, solution in enumerate(branch.solutions) if solution.point.requested]
    if marked:
        axes.plot(*path[marked].T, "o", ms=4, mfc="white", mec=colour, label="requested", zorder=6, clip_on=False)
    if branch.end not in (End.REACHED, End.RETURNED, End.CLOSED) and not branch.stopped:
        axes.plot(*path[-1], "x", ms=6, color="black", label="ended early", zorder=7)
