"""Solutions of any model: states against time, phase planes and portraits, and an orbit in motion as a film."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.closed_curve import cosine_curve
from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.follow.space import EQUILIBRIA, FAMILY, ORBITS
from casadi_skin.model.files import TemporaryFolder, replacing
from casadi_skin.model.result import in_turn
from casadi_skin.results.figures import style
from casadi_skin.results.figures.branches import solution_title
from casadi_skin.zero.problem import Array, Indices
from casadi_skin.zero.stated_problem import BoundaryProblem

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ORBIT_SAMPLES = 2001  # of an orbit
STATES_SHOWN = 6  # states drawn against time


@style.drawn
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
    figure = style.blank(5.0 if plane is None else 8.0, 3.6)
    axes = figure.subplots(1, 1 if plane is None else 2, squeeze=False)[0]
    style.draw_curves(axes[0], t, dict(zip(names, x.T, strict=True)), lw=1.4)
    more = f" ({len(names)} of {known})" if known > len(names) else ""
    axes[0].set(xlabel="t", ylabel=f"states{more}", xlim=(t[0], t[-1]))
    if plane is not None:
        points, labels = plane
        axes[1].plot(*points.T, color="black", lw=1.4)
        words = f"t = {t[0]:.4g}"
        axes[1].plot(*points[0], "o", ms=5, mfc="white", mec="black", label=words)
        axes[1].set(xlabel=labels[0], ylabel=labels[1])
    figure.suptitle(orbit_title(solution, title))
    return style.finished(figure, axes, STATES_SHOWN + 1)


def drawn_states(solution: Solution) -> Indices:
    """Indices of the states that are drawn, six at the most: of a family with more positions those that move most."""
    count = len(solution.space.state_names)
    if count <= STATES_SHOWN or solution.space.connects != FAMILY:
        return np.arange(min(count, STATES_SHOWN))
    return np.argsort(-np.abs(_states(solution, np.zeros(1), np.arange(count))[0]), kind="stable")[:STATES_SHOWN]


def _names(solution: Solution, chosen: Indices) -> list[str]:
    return [style.plain(solution.space.state_names[i]) for i in chosen]


def _states(solution: Any, t: Array, chosen: Indices) -> Array:
    if solution.space.connects not in (FAMILY, ORBITS):
        return np.asarray(solution.evaluate(t)[:, chosen])
    return np.asarray(solution.evaluate(t, solution.output_sites[chosen]))


def times(solution: Solution) -> Array:
    """Times over the interval or the period at which a solution looks smooth: those of its mesh among them."""
    start, end = solution.interval
    even = np.linspace(start, end, ORBIT_SAMPLES)
    if not isinstance(solution.point.problem, BoundaryProblem):
        return even
    return np.unique(np.concatenate([even, np.clip(solution.t, start, end)]))


def in_plane(solution: Any, t: Array) -> tuple[Array, tuple[str, str]] | None:
    """Points of a solution in the plane of the first two states drawn, shape (times, 2), and the names of the axes.

    Of an orbit of a family with one position that and its velocity; None for another solution with one state.
    """
    chosen = drawn_states(solution)[:2]
    names, x = _names(solution, chosen), _states(solution, t, chosen)
    if len(names) > 1:
        return x, (names[0], names[1])
    if solution.space.connects != FAMILY:
        return None
    velocity = cosine_curve(solution).points(solution.Omega * t)[0][:, 1]
    return np.column_stack([x, velocity]), (names[0], rf"velocity of {names[0]} over $\Omega$")


def orbit_title(solution: Any, name: str = "") -> str:
    """A solution in words: its model, with mode and S of an orbit of a family, or with the period of another orbit."""
    words, connects = solution_title(solution, name), solution.space.connects
    if connects == FAMILY:
        return f"{words}, $j = {solution.space.coordinates.mode_number}$, $S = {style.number(solution.S)}$"
    return f"{words}, period ${style.number(solution.period)}$" if connects == ORBITS else words


# Several solutions of one model side by side: their phase portrait, and a state over time -----------------------------

MOST_SOLUTIONS = 6  # solutions that are drawn
CHOSEN_ORBITS = 4  # orbits of a branch, by default


@style.drawn
def portrait_figure(solutions: Sequence[Solution], title: str = "") -> Figure:
    """Orbits and equilibria in the plane of the first two states, and the first of these against time.

    Arguments:
        solutions: one to six of one model; of one state alone time courses are drawn.
        title: stands in place of the name of the model.

    Returns:
        The figure; solutions are labelled by the parameters in which they differ.

    Raises:
        ValueError: there are no solutions, or more than six.
    """
    if not 1 <= len(solutions) <= MOST_SOLUTIONS:
        raise ValueError(f"solutions: given {len(solutions)}; accepted: 1 to {MOST_SOLUTIONS}")
    names = [style.plain(name) for name in solutions[0].space.state_names[:2]]
    in_plane = len(names) > 1
    words, common = _words(solutions)
    longest = max((s.interval[1] for s in solutions), default=0.0) or 1.0
    figure = style.blank(8.0 if in_plane else 5.0, 3.8)
    axes = figure.subplots(1, 1 + in_plane, squeeze=False)[0]
    for solution, colour, dashes, label in zip(
        solutions, style.colours(len(solutions)), style.LINE_DASHES, words, strict=False
    ):
        at_rest = solution.space.connects == EQUILIBRIA
        t = np.array([0.0, longest]) if at_rest else times(solution)
        x = solution.evaluate(t)
        axes[0].plot(t, x[:, 0], color=colour, ls=dashes, lw=1.4, label=label)
        if in_plane:
            look = {"marker": "o", "ms": 5, "mec": "black", "ls": "none"} if at_rest else {"ls": dashes, "lw": 1.4}
            axes[1].plot(*x[:, :2].T, color=colour, label=label, **look)
    axes[0].set(xlabel="t", ylabel=names[0])
    if in_plane:
        axes[1].set(xlabel=names[0], ylabel=names[1])
    figure.suptitle(style.title(solutions[0].space.model, common, title))
    return style.finished(figure, axes, 3)


def chosen_solutions(branches: Sequence[Branch]) -> list[Solution]:
    """Solutions for a portrait: the requested ones, else an equilibrium where cycles are born and a few of these.

    None where no orbit is among the branches: equilibria alone are seen in the diagram.
    """
    held = [s for branch in branches for s in branch.solutions]
    requested = [s for s in held if s.point.requested]
    cycles = next((branch.solutions for branch in branches if branch.space.connects in (FAMILY, ORBITS)), ())
    if requested and cycles:
        return requested[:MOST_SOLUTIONS]
    moving = [s for s in cycles[1:] if not s.point.special]  # the first one has no amplitude
    places = np.unique(np.linspace(0, len(moving) - 1, CHOSEN_ORBITS + 1)[1:].astype(int)) if moving else ()
    born = [s for s in held if s.point.special == "hopf" and s.space.connects == EQUILIBRIA][:1]
    return [*born, *(moving[place] for place in places)] if moving else []


def _words(solutions: Sequence[Solution]) -> tuple[list[str], dict[str, float]]:
    """A label for each solution, by the parameters in which they differ, and the parameters that they share."""
    first, labels = solutions[0].parameters, list[str]()
    shared = dict(set(first.items()).intersection(*(solution.parameters.items() for solution in solutions)))
    for solution in solutions:
        own = {name: value for name, value in solution.parameters.items() if name in first and name not in shared}
        period = getattr(solution, "period", None)
        values = [f"{style.plain(name)} = {value:.4g}" for name, value in own.items()]
        labels.append(", ".join([*values, "at rest" if period is None else f"period {period:.4g}"]))
    return labels, {name: value for name, value in first.items() if name in shared}


# An orbit in motion as a film, GIF or MP4, through matplotlib: the displacements of a lattice, or a phase plane -------

FRAMES_PER_PERIOD = 48  # of one period
ANIMATION_FEW = 2  # positions of a model of one's own that are not drawn as a lattice
CLOCK_ROOM = 0.2  # of the height of a plane, for the clock

Show = Callable[[int], "tuple[Artist, ...]"]


@in_turn
def animate(orbit: Orbit, path: Path | str, periods: int = 1, frames: int = FRAMES_PER_PERIOD) -> Path:
    """Write an orbit over whole periods as a film: a GIF repeats without a jump, MP4 needs the program ffmpeg.

    Of a lattice the displacements y_n(t) are drawn at their positions; of another model a point that moves along the
    orbit in the plane of the first two states, and of a single state one along its curve in time.

    Arguments:
        orbit: any orbit.
        path: the file; its ending chooses .gif or .mp4.
        periods: number of periods.
        frames: of each period.

    Returns:
        The path.

    Raises:
        ValueError: another ending, or counts that are too small.
        RuntimeError: ffmpeg is missing.
    """
    target = Path(path)
    writers = {".gif": "pillow", ".mp4": "ffmpeg"}
    if target.suffix not in writers:
        raise ValueError(f"path: given {target.name!r}; accepted: a name that ends with {' or '.join(writers)}")
    if periods < 1 or frames < 2:
        raise ValueError(f"periods, frames: given {periods}, {frames}; accepted: at least 1 period of 2 frames")

    from matplotlib import animation

    if not animation.writers.is_available(writers[target.suffix]):
        raise RuntimeError(f"{target.name}: matplotlib finds no {writers[target.suffix]}; accepted: .gif")
    turns = np.arange(periods * frames) / frames
    with style.style():
        figure = style.blank(5.0, 3.0)
        axes = figure.subplots()
        positions = _positions(orbit)
        move = _lattice(axes, orbit, turns, positions) if positions else _plane(axes, orbit, turns)
        clock = axes.text(0.03, 0.93, "", transform=axes.transAxes, va="top")
        figure.suptitle(orbit_title(orbit))

        def show(frame: int) -> tuple[Artist, ...]:
            clock.set_text(rf"$t/T = {turns[frame]:.2f}$")
            return (*move(frame), clock)

        film = animation.FuncAnimation(figure, show, frames=turns.size)
        folder = TemporaryFolder("casadi_skin_film_")  # which goes where this process is killed meanwhile, too
        try:
            drawn = folder.path / target.name
            film.save(drawn, writer=writers[target.suffix], fps=24, dpi=100)
            with replacing(target) as temporary:
                shutil.copyfile(drawn, temporary)
        finally:
            folder.remove()
    return target


def _positions(orbit: Orbit) -> int:
    """Number of positions of a lattice; 0 for a model that is drawn in a plane."""
    space: Any = orbit.space
    count = len(orbit.output_sites) if space.connects == FAMILY else space.positions
    return count if count > ANIMATION_FEW or orbit.model.labels else 0


def _lattice(axes: Axes, orbit: Orbit, turns: Array, positions: int) -> Show:
    """Displacements at their positions."""
    n = orbit.output_sites[:positions]
    y = orbit.evaluate(orbit.period * turns, n)
    limit = 1.08 * float(np.max(np.abs(y)))
    axes.set(xlim=(n[0] - 1, n[-1] + 1), ylim=(-limit, limit), ylabel=r"$y_n(t)$")
    style.number_sites(axes, int(n[0]), int(n[-1]), style.position_label(orbit.model))
    axes.axhline(0.0, color="0.6", lw=0.6)
    stems = axes.vlines(n, 0.0, y[0], color="0.6", lw=0.8)
    (points,) = axes.plot(n, y[0], "o", ms=4, color="black", clip_on=False)

    def show(frame: int) -> tuple[Artist, ...]:
        points.set_ydata(y[frame])
        stems.set_segments([np.array([[x, 0.0], [x, value]]) for x, value in zip(n, y[frame], strict=True)])
        return points, stems

    return show


def _plane(axes: Axes, orbit: Orbit, turns: Array) -> Show:
    """A point on the orbit in the plane of two states, or on its curve in time."""
    whole, labels = _in_plane(orbit, times(orbit))
    places, _ = _in_plane(orbit, orbit.period * turns)
    axes.plot(*whole.T, color="0.6", lw=1.2)
    (point,) = axes.plot(*places[:1].T, "o", ms=6, color="black", clip_on=False)
    axes.set(xlabel=labels[0], ylabel=labels[1])
    axes.margins(0.1)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + CLOCK_ROOM * (high - low))

    def show(frame: int) -> tuple[Artist, ...]:
        point.set_data(*places[frame : frame + 1].T)
        return (point,)

    return show


def _in_plane(orbit: Orbit, t: Array) -> tuple[Array, tuple[str, str]]:
    """Points of the orbit in a plane at times, shape (times, 2), and the quantities of its axes."""
    plane = in_plane(orbit, t)
    if plane is not None:
        return plane
    x = orbit.evaluate(t)
    names = "$t/T$", style.plain(orbit.space.state_names[0])
    return np.column_stack([np.mod(t, orbit.period) / orbit.period, x]), names
