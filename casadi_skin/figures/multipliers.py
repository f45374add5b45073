"""Floquet multipliers against amplitude and in the complex plane (paper, Fig. 5a-c)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.figures.profiles import requested
from casadi_skin.figures.style import (
    AMPLITUDE,
    blank,
    colours,
    finished,
    number,
    style,
    title,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.orbits.branch import Branch
    from casadi_skin.orbits.orbit import Orbit

FRAME = 3.0  # multipliers farther from 0 than this are told in words
MODULUS = r"$\left|\lambda\right|$"


def _draw_moduli(axes: Axes, branch: Branch) -> None:
    """|lambda| of all multipliers off the circle, the largest as a line, against S."""
    line: list[tuple[float, float]] = []
    stable, changes = branch.stable, list(branch.changes)
    for i, orbit in enumerate(branch.orbits):
        if i and stable[i] != stable[i - 1] and changes:  # multipliers leave the circle at the change itself
            line.append((changes.pop(0).S, 1.0))
        floquet = orbit.floquet()
        line.append((orbit.S, floquet.max_abs_multiplier))
        outer = np.abs(floquet.root[~floquet.is_inside]) ** (2 * floquet.power)
        if outer.size:
            axes.plot(np.full(2 * outer.size, orbit.S), [*outer, *1.0 / outer], ".", ms=3, color="0.25", zorder=3)
    axes.axhline(1.0, color="0.6", lw=0.8, zorder=1)
    axes.plot(*np.transpose(line), color=colours(1)[0], lw=1.3, label=f"largest {MODULUS}", zorder=2)
    for change in branch.changes:
        dashes = "-" if change.kind == "real" else "--"
        axes.axvline(change.S, color="0.4", lw=0.6, ls=dashes, label=f"change of stability ({change.kind})", zorder=0)
    largest = branch.max_abs_multiplier.max()
    if largest > 10.0:
        axes.set_yscale("log")
    elif largest == 1.0:
        axes.set_ylim(0.9, 1.1)
    axes.set(xlim=(0.0, 1.03 * branch.S.max()), xlabel=AMPLITUDE, ylabel=f"{MODULUS} (trivial pair left out)")
    axes.set_box_aspect(1)


def draw_plane(axes: Axes, orbit: Orbit) -> None:
    """Multipliers of one orbit in the complex plane, marked by kind."""
    from matplotlib.ticker import MaxNLocator

    floquet = orbit.floquet()
    others = floquet.multipliers[2:]
    inside, real = np.repeat(floquet.is_inside, 2), np.repeat(floquet.is_real, 2)
    near, angle = np.abs(others) <= FRAME, np.linspace(0.0, 2.0 * np.pi, 361)
    axes.plot(np.cos(angle), np.sin(angle), color="0.7", lw=1.0, zorder=1)
    for label, chosen, marker, size, fill in (
        ("on the unit circle", inside, "o", 4.0, "white"),
        ("real, off the circle", ~inside & real, "s", 5.0, "black"),
        ("complex, off the circle", ~real, "^", 5.5, "0.6"),
    ):
        shown = others[chosen & near]
        if shown.size:
            axes.plot(shown.real, shown.imag, marker, ms=size, mfc=fill, mec="black", mew=0.8, label=label, zorder=3)
    axes.plot([1.0], [0.0], "+", ms=8, color="black", label="trivial pair", zorder=4)
    if not near.all():
        axes.text(0.03, 0.03, f"{np.count_nonzero(~near)} out of the frame", transform=axes.transAxes)
    reach = 1.12 * float(np.max(np.abs(others[near]), initial=1.15))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel=r"Re $\lambda$", ylabel=r"Im $\lambda$")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(6))


def multiplier_figure(branch: Branch) -> Figure | None:
    """Moduli of the multipliers against S, and multipliers in the complex plane at up to three requested orbits.

    The last orbit stands in where none was requested. None where stability was not computed (paper, Fig. 5a to c).
    """
    if not branch.with_stability or not branch.orbits:
        return None
    orbits = list(requested(branch, 3).values()) or [branch.orbits[-1]]
    request, layout = branch.space.request, ("ab", "abc", "ab;cd")[len(orbits) - 1]
    with style():
        figure = blank(*((6.8, 3.9), (9.6, 3.9), (6.8, 7.0))[len(orbits) - 1])
        panels = figure.subplot_mosaic(layout)
        _draw_moduli(panels["a"], branch)
        panels["a"].set_title("(a)", loc="left")
        for letter, orbit in zip("bcd", orbits, strict=False):
            draw_plane(panels[letter], orbit)
            largest = orbit.floquet().max_abs_multiplier
            words = rf"$S = {number(orbit.S)}$, max $\left|\lambda\right| = {number(largest, 4)}$"
            panels[letter].set_title(f"({letter})  {words}", loc="left")
            panels["a"].plot(orbit.S, largest, "o", ms=5, mfc="white", mec="black", zorder=5, clip_on=False)
            box = {"fc": "white", "ec": "none", "pad": 0.5}
            panels["a"].annotate(
                letter, (orbit.S, largest), (-5, 6), textcoords="offset points", ha="right", bbox=box, zorder=6
            )
        figure.suptitle(f"family $j = {request.mode}$; {title(request.chain)}")
        return finished(figure, panels.values(), 3)
