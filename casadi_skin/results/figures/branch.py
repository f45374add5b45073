"""A branch of orbits or solutions of any model against its parameter; one of them in time and in its phase plane."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit, cosine_curve
from casadi_skin.follow.solution import Solution
from casadi_skin.results.figures.style import DASHES, blank, colours, finished, number, plain, style
from casadi_skin.results.figures.style import title as model_title
from casadi_skin.results.quantities import extremes
from casadi_skin.zero.problem import Array, Indices
from casadi_skin.zero.settings import End
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.follow.branch import Branch


# A branch as lines in a plane: a piece for each stretch of one stability, and marks of special points -----------------

SAME_PLACE = 5e-3  # of the extent of a branch: a distance that a picture does not show
LOOKS: dict[bool | None, dict[str, Any]] = {
    True: {"label": "stable", "lw": 2.0},
    False: {"label": "unstable", "lw": 2.0, "ls": (0, (3.0, 1.6))},
    None: {"label": "stability not computed", "lw": 0.9},
}
CLOSE = 0.008  # of the width of a picture: marks that are closer overlap
ROUNDING = 1e-6  # of a quantity: a change that is no course of a curve
FEWEST, INSIDE = 4, 12  # points through which a curve is drawn smooth, and points drawn between two of them
STRIP = 0.025  # of the height of a picture: a strip along its lower edge
MARKS = {  # the symbols of the field, as far as there are any
    "fold": ("D", "0.6"),
    "branch point": ("o", "white"),
    "hopf": ("s", "black"),
    "period doubling": ("^", "0.6"),
    "torus": ("h", "0.6"),
    "homoclinic": ("X", "white"),
    "heteroclinic": ("P", "white"),
    "bound": ("|", "black"),
    "cusp": ("v", "black"),
    "bogdanov-takens": ("o", "black"),
    "zero-hopf": ("P", "black"),
    "generalized hopf": ("*", "black"),
    "hopf-hopf": ("X", "black"),
    "degenerate pitchfork": ("d", "white"),
    "degenerate transcritical": ("D", "white"),
    "double branch point": ("8", "black"),
    "cusp of cycles": ("v", "white"),
    "generalized period doubling": ("<", "white"),
    "chenciner": (">", "white"),
    "1:1 resonance": ("$1$", "black"),
    "1:2 resonance": ("$2$", "black"),
    "1:3 resonance": ("$3$", "black"),
    "1:4 resonance": ("$4$", "black"),
    "fold-flip": ("p", "white"),
    "fold-torus": ("H", "white"),
    "flip-torus": ("8", "white"),
    "torus-torus": ("X", "white"),
}
PLAIN = ("d", "0.8")
LIMITS = ("homoclinic", "heteroclinic")  # possible ends of a branch of cycles


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


def smooth(path: Array) -> Array:
    """A curve through points of the plane by modified Akima splines, which do not overshoot.

    Arguments:
        path: the points in their order, shape (points, 2).

    Returns:
        The points with others between them, shape (more, 2); the points alone where they are fewer than four.
    """
    from scipy.interpolate import Akima1DInterpolator

    extent = np.maximum(np.ptp(path, axis=0), ROUNDING * np.max(np.abs(path), axis=0, initial=0.0))
    lengths = np.hypot(*(np.diff(path, axis=0) / np.where(extent > 0.0, extent, 1.0)).T)
    path = path[np.append(True, lengths > 0.0)]
    if len(path) < FEWEST or not np.all(np.isfinite(path)):
        return path
    places = np.append(0.0, np.cumsum(lengths[lengths > 0.0]))
    parts = np.linspace(0.0, 1.0, INSIDE + 1, endpoint=False)
    between = places[:-1, None] + np.diff(places)[:, None] * parts
    curve = Akima1DInterpolator(places, path, method="makima")(between)
    curve[:, 0] = path[:-1]
    return np.vstack([curve.reshape(-1, 2), path[-1:]])


def special_places(branch: Branch, path: Array) -> dict[int, str]:
    """Kinds of the special points that were located while the branch was followed, by their places in a path."""
    lead = len(path) - len(branch)
    return {lead + i: s.point.special for i, s in enumerate(branch.solutions) if s.point.special}


def draw_lines(
    axes: Axes,
    branch: Branch,
    path: Array,
    pieces: Sequence[tuple[bool | None, Array]],
    colour: Any,
    strip: bool = False,
) -> None:
    """The path of a branch in pieces, as `stability_pieces` makes them, with marks of its changes of stability.

    Pieces of one stability are one line with gaps between them: a line takes a fifth of a millisecond, a gap nothing.
    With `strip`, changes whose marks would overlap are shown by a strip along the lower edge, dark where unstable.
    """
    gap = np.full((1, 2), np.nan)
    for stable in dict.fromkeys(stable for stable, _ in pieces):
        line = np.vstack([part for known, piece in pieces if known is stable for part in (gap, piece)])[1:]
        axes.plot(*line.T, color=colour, zorder=3, **(LOOKS[stable] if _may_be_stable(branch) else {"lw": 1.4}))
    joints = np.array([piece[-1] for _, piece in pieces[:-1]]).reshape(-1, 2)
    joints = joints[~_are_marked(joints, path[list(special_places(branch, path))], np.ptp(path, axis=0))]
    if joints.size and strip and np.all(np.diff(path[:, 0]) > 0.0) and crowded(joints[:, 0]):
        bars = [(piece[0, 0], np.ptp(piece[:, 0])) for stable, piece in pieces if stable is False]
        look: dict[str, Any] = {"fc": "0.25", "ec": "none", "transform": axes.get_xaxis_transform(), "zorder": 4}
        axes.broken_barh(bars, (0.0, STRIP), label="unstable, along the amplitude", **look)
    elif joints.size:
        axes.plot(*thinned(joints).T, "|", ms=7, mew=0.9, color="black", label="change of stability", zorder=5)


def _are_marked(joints: Array, special: Array, extent: Array) -> NDArray[np.bool_]:
    """Which changes of stability lie at a special point as far as a picture shows, shape (joints,)."""
    apart = np.abs(joints[:, None] - special) <= SAME_PLACE * extent
    return np.asarray(np.any(np.all(apart, axis=2), axis=1))


def label_of(words: str, piece: Array, path: Array) -> str:
    """Legend entry of a stretch; none where the stretch is too short to be seen on the whole path."""
    return words if np.any(np.ptp(piece, axis=0) > SAME_PLACE * np.ptp(path, axis=0)) else "_nolegend_"


def crowded(places: Array) -> bool:
    """Whether marks at places along an axis would overlap."""
    return bool(np.any(np.diff(np.sort(places)) < CLOSE * np.max(np.abs(places), initial=0.0)))


def thinned(places: Array) -> Array:
    """Marks of shape (marks, 2) without those that would overlap the one before along the axis."""
    least, kept = 2.0 * CLOSE * np.max(np.abs(places[:, 0])), [0]
    for i in range(1, len(places)):
        if np.abs(places[i, 0] - places[kept[-1], 0]) >= least:
            kept.append(i)
    return np.asarray(places[kept])


def _may_be_stable(branch: Branch) -> bool:
    """Whether its solutions are orbits."""
    return all(isinstance(solution, Orbit) for solution in branch.solutions[:1])


def draw_marks(axes: Axes, branch: Branch, path: Array, colour: Any) -> None:
    """Marks of folds, of values that were requested, and of an early end."""
    places = special_places(branch, path)
    for kind in dict.fromkeys(places.values()):
        chosen = [i for i, found in places.items() if found == kind]
        marker, face = MARKS.get(kind, PLAIN)
        axes.plot(*path[chosen].T, marker, color="black", ms=5, mfc=face, mec="black", ls="none", label=kind, zorder=5)
    lead = len(path) - len(branch)
    marked = [lead + i for i, solution in enumerate(branch.solutions) if solution.point.requested]
    if marked:
        axes.plot(
            *path[marked].T,
            "o",
            color=colour,
            ms=4,
            mfc="white",
            mec=colour,
            label="requested",
            zorder=6,
            clip_on=False,
        )
    reached = branch.stopped or (lead + len(branch) - 1 in places and places[lead + len(branch) - 1] in LIMITS)
    if branch.end not in (End.REACHED, End.RETURNED, End.CLOSED) and not reached:
        axes.plot(*path[-1], "x", ms=6, color="black", label="ended early", zorder=7)


SAMPLES = 2001  # of an orbit
SHOWN = 6  # states drawn against time


def branch_figure(branch: Branch, title: str = "") -> Figure:
    """Largest and smallest value of the first state, and the period or the largest multiplier, against the parameter.

    Stable stretches are solid, unstable ones dashed; folds and requested points are marked.

    Arguments:
        branch: a branch of orbits or solutions in a parameter; for families see `frequency_figure`.
        title: stands in place of the name of the model.

    Returns:
        The figure.

    Raises:
        ValueError: the branch is a family, or has no solutions.
    """
    space = branch.space
    if not isinstance(space, BoundarySpace) or not space.parameter or not branch.solutions:
        given = "a family" if isinstance(space, Family) else "one without a parameter or solutions"
        given = "one of equilibria, see bifurcation_figure" if space.stability_included else given
        raise ValueError(f"branch: given {given}; accepted: a branch of orbits or solutions in a parameter")
    state = plain(space.state_names[0])
    low, high = np.array([[side[0] for side in extremes(solution)] for solution in branch.solutions]).T
    from matplotlib.lines import Line2D

    panels: list[tuple[str, list[Array]]] = [(f"{state}: largest and smallest value", [high, low])]
    panels += _second_panel(branch, space)
    with style():
        figure = blank(6.0, 3.6 if len(panels) == 1 else 5.6)
        axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
        for panel, (label, curves) in zip(axes, panels, strict=True):
            for curve, colour in zip(curves, colours(len(curves)), strict=True):
                path = np.column_stack([branch.values, curve])
                draw_lines(panel, branch, path, stability_pieces(branch, path), colour)
                draw_marks(panel, branch, path, "black")
            if len(curves) == 2:
                handles = [Line2D([], [], color=colour, lw=2.0) for colour in colours(2)]
                panel.legend(handles, ["largest", "smallest"], loc="best")
            panel.set_ylabel(label)
        axes[-1].set_xlabel(plain(space.parameter))
        axes[0].set_title(_title(branch.solutions[0], title, (space.parameter, *space.statement.free)), y=1.0)
        return finished(figure, axes, 5, in_black=True, plain=True)


def _second_panel(branch: Branch, space: BoundarySpace) -> list[tuple[str, list[Array]]]:
    """The period where it is unknown, else the largest multiplier where there are multipliers."""
    if space.periodic is not None and PERIOD in space.statement.free:
        return [("period", [branch.period])]
    if not branch.with_stability or not branch.orbits[0].floquet().others.size:
        return []
    return [("largest |multiplier|", [branch.max_abs_multiplier])]


def orbit_figure(solution: Solution, title: str = "") -> Figure:
    """States against time over the interval or the period and, of two or more, the plane of the first two.

    Of many states the first six are drawn; of many positions of a family those that move most, the largest first.

    Arguments:
        solution: an orbit of any kind, or a solution of a boundary-value problem.
        title: stands in place of the name of the model.

    Returns:
        The figure.
    """
    chosen, t, known = drawn_states(solution), times(solution), len(solution.space.state_names)
    names, x, plane = _names(solution, chosen), _states(solution, t, chosen), in_plane(solution, t)
    with style():
        figure = blank(5.0 if plane is None else 8.0, 3.6)
        axes = figure.subplots(1, 1 if plane is None else 2, squeeze=False)[0]
        for i, colour in enumerate(colours(len(names))):
            axes[0].plot(t, x[:, i], color=colour, ls=DASHES[i], lw=1.4, label=names[i])
        more = f" ({len(names)} of {known})" if known > len(names) else ""
        axes[0].set(xlabel="t", ylabel=f"states{more}", xlim=(t[0], t[-1]))
        if plane is not None:
            points, labels = plane
            axes[1].plot(*points.T, color="black", lw=1.4)
            words = "t = 0" if isinstance(solution, Orbit) else f"t = {t[0]:.4g}"
            axes[1].plot(*points[0], "o", ms=5, mfc="white", mec="black", label=words)
            axes[1].set(xlabel=labels[0], ylabel=labels[1])
        figure.suptitle(orbit_title(solution, title))
        return finished(figure, axes, SHOWN + 1, plain=True)


def drawn_states(solution: Solution) -> Indices:
    """Indices of the states that are drawn, six at the most: of a family with more positions those that move most."""
    count = len(solution.space.state_names)
    if count <= SHOWN or not isinstance(solution.space, Family):
        return np.arange(min(count, SHOWN))
    return np.argsort(-np.abs(_states(solution, np.zeros(1), np.arange(count))[0]), kind="stable")[:SHOWN]


def _names(solution: Solution, chosen: Indices) -> list[str]:
    return [plain(solution.space.state_names[i]) for i in chosen]


def _states(solution: Solution, t: Array, chosen: Indices) -> Array:
    if isinstance(solution, Orbit):
        return solution.evaluate(t, solution.output_sites[chosen])
    return solution.evaluate(t)[:, chosen]


def times(solution: Solution) -> Array:
    """Times over the interval or the period at which a solution looks smooth: those of its mesh among them."""
    start, end = solution.interval
    even = np.linspace(start, end, SAMPLES)
    if not isinstance(solution.point.problem, BoundaryProblem):
        return even
    return np.unique(np.concatenate([even, np.clip(solution.t, start, end)]))


def in_plane(solution: Solution, t: Array) -> tuple[Array, tuple[str, str]] | None:
    """Points of a solution in the plane of the first two states drawn, shape (times, 2), and the names of the axes.

    Of an orbit of a family with one position that and its velocity; None for another solution with one state.
    """
    chosen = drawn_states(solution)[:2]
    names, x = _names(solution, chosen), _states(solution, t, chosen)
    if len(names) > 1:
        return x, (names[0], names[1])
    if not (isinstance(solution, Orbit) and isinstance(solution.space, Family)):
        return None
    velocity = cosine_curve(solution).points(solution.Omega * t)[0][:, 1]
    return np.column_stack([x, velocity]), (names[0], rf"velocity of {names[0]} over $\Omega$")


def orbit_title(solution: Solution, name: str = "") -> str:
    """A solution in words: its model, with mode and S of an orbit of a family, or with the period of another orbit."""
    words = _title(solution, name, ())
    if isinstance(solution.space, Family):
        assert isinstance(solution, Orbit)
        return f"{words}, $j = {solution.space.coordinates.mode_number}$, $S = {number(solution.S)}$"
    return f"{words}, period ${number(solution.period)}$" if isinstance(solution, Orbit) else words


def _title(solution: Solution, name: str, without: tuple[str, ...]) -> str:
    known = {key: value for key, value in solution.parameters.items() if key not in without}
    return model_title(solution.space.model, known, name)
