"""An orbit in motion as a film, GIF or MP4, through matplotlib: the displacements of a lattice, or a phase plane."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.orbit import Orbit
from casadi_skin.model.files import replacing
from casadi_skin.model.ode import OdeModel
from casadi_skin.results.figures.branch import in_plane, orbit_title, times
from casadi_skin.results.figures.style import blank, number_sites, plain, position_label, style
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

FRAMES = 48  # of one period
FEW = 2  # positions of a model of one's own that are not drawn as a lattice
ROOM = 0.2  # of the height of a plane, for the clock

Show = Callable[[int], "tuple[Artist, ...]"]


def animate(orbit: Orbit, path: Path | str, periods: int = 1, frames: int = FRAMES) -> Path:
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
    with style():
        figure = blank(5.0, 3.0)
        axes = figure.subplots()
        positions = _positions(orbit)
        move = _lattice(axes, orbit, turns, positions) if positions else _plane(axes, orbit, turns)
        clock = axes.text(0.03, 0.93, "", transform=axes.transAxes, va="top")
        figure.suptitle(orbit_title(orbit))

        def show(frame: int) -> tuple[Artist, ...]:
            clock.set_text(rf"$t/T = {turns[frame]:.2f}$")
            return (*move(frame), clock)

        film = animation.FuncAnimation(figure, show, frames=turns.size)
        with replacing(target) as temporary:
            film.save(temporary, writer=writers[target.suffix], fps=24, dpi=100)
    return target


def _positions(orbit: Orbit) -> int:
    """Number of positions of a lattice; 0 for a model that is drawn in a plane."""
    space = orbit.space
    count = space.positions if isinstance(space, BoundarySpace) else len(orbit.output_sites)
    return count if count > FEW or not isinstance(orbit.model, OdeModel) else 0


def _lattice(axes: Axes, orbit: Orbit, turns: Array, positions: int) -> Show:
    """Displacements at their positions."""
    n = orbit.output_sites[:positions]
    y = orbit.evaluate(orbit.period * turns, n)
    limit = 1.08 * float(np.max(np.abs(y)))
    axes.set(xlim=(n[0] - 1, n[-1] + 1), ylim=(-limit, limit), ylabel=r"$y_n(t)$")
    number_sites(axes, int(n[0]), int(n[-1]), position_label(orbit.model))
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
    axes.set_ylim(low, high + ROOM * (high - low))

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
    return np.column_stack([np.mod(t, orbit.period) / orbit.period, x]), ("$t/T$", plain(orbit.space.state_names[0]))
