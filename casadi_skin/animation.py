"""A breathing mode in motion: displacements of all sites over a period, as GIF or MP4 through matplotlib."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from casadi_skin.figures.style import blank, number, number_sites, style, title
from casadi_skin.files import replacing
from casadi_skin.orbits.orbit import Orbit

FRAMES = 48  # of one period


def animate(orbit: Orbit, path: Path | str, periods: int = 1, frames: int = FRAMES) -> Path:
    """Write the displacements y_n(t) of an orbit over whole periods as a film; the ending chooses .gif or .mp4.

    A GIF repeats without a jump. MP4 needs the program ffmpeg. Raises ValueError for another ending or counts below 1,
    RuntimeError where ffmpeg is missing.
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
    t = orbit.period * np.arange(periods * frames) / frames
    n = orbit.output_sites
    y = orbit.evaluate(t, n)
    with style():
        figure = blank(5.0, 3.0)
        axes = figure.subplots()
        limit = 1.08 * float(np.max(np.abs(y)))
        axes.set(xlim=(n[0] - 1, n[-1] + 1), ylim=(-limit, limit), ylabel=r"$y_n(t)$")
        number_sites(axes, int(n[0]), int(n[-1]), "site $n$")
        axes.axhline(0.0, color="0.6", lw=0.6)
        stems = axes.vlines(n, 0.0, y[0], color="0.6", lw=0.8)
        (points,) = axes.plot(n, y[0], "o", ms=4, color="black", clip_on=False)
        clock = axes.text(0.03, 0.93, "", transform=axes.transAxes, va="top")
        figure.suptitle(f"{title(orbit.chain)}, $j = {orbit.tools.request.mode}$, $S = {number(orbit.S)}$")

        def show(frame: int) -> tuple[object, ...]:
            points.set_ydata(y[frame])
            stems.set_segments([np.array([[x, 0.0], [x, value]]) for x, value in zip(n, y[frame], strict=True)])
            clock.set_text(rf"$t/T = {t[frame] / orbit.period:.2f}$")
            return points, stems, clock

        film = animation.FuncAnimation(figure, show, frames=t.size)  # type: ignore[arg-type]
        with replacing(target) as temporary:
            film.save(temporary, writer=writers[target.suffix], fps=24, dpi=100)
    return target
