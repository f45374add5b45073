"""Profiles of requested orbits beside their linear mode (paper, Fig. 3b, e)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.results.figures.style import (
    blank,
    colours,
    common_model,
    family,
    finished,
    is_sum_of_squares,
    number,
    number_sites,
    position_label,
    style,
    title,
)
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.follow.branch import Branch
    from casadi_skin.follow.orbit import Orbit

MARKERS, LINES = "os^Dv<", ("-", "--", "-.", ":")
DEEPEST = -290.0  # log10 of sizes that are drawn as they are
DECADES = 2.0  # that an axis spans whose whole powers of ten are ticks enough: each tick takes half a millisecond
MARKED_SITES = 60  # profiles of longer lattices are lines without markers, of the positions that move


def _logarithms(orbit: Orbit) -> Array:
    """log10 of |y_n(0)|/||y||, nan at rest and at nodes, shape (positions,)."""
    logs = orbit.log10_displacements(orbit.output_sites)[0] - np.log10(_norm(orbit))
    around = np.pad(logs, 1, constant_values=-np.inf)
    return np.where(logs > np.maximum(around[:-2], around[2:]) - 13.0, logs, np.nan)


def _norm(orbit: Orbit) -> float:
    """||y|| at t = 0."""
    return float(np.sqrt(orbit.S)) if is_sum_of_squares(orbit.model) else float(np.linalg.norm(orbit.profile))


def moving(profiles: Array) -> tuple[int, int]:
    """First and last position where profiles (some, positions) exceed 1e-3 of their largest; all of a short lattice."""
    largest = np.max(np.abs(profiles), axis=1, keepdims=True)
    seen = np.flatnonzero(np.any(np.abs(profiles) > 1e-3 * largest, axis=0)) + 1
    sites = profiles.shape[1]
    return (int(seen[0]), int(seen[-1])) if sites > MARKED_SITES else (1, sites)


def requested(branch: Branch, at_most: int) -> dict[tuple[float, int], Orbit]:
    """Requested orbits by value and the number of times that it was passed before, evenly picked where there are more.

    The value is that of the quantity that the branch is followed in.
    """
    found = [(value, o) for value, o in zip(branch.values.tolist(), branch.orbits, strict=True) if o.point.requested]
    values, orbits = [value for value, _ in found], [orbit for _, orbit in found]
    keys = [(value, values[:i].count(value)) for i, value in enumerate(values)]
    picked = [round(i) for i in np.linspace(0, len(orbits) - 1, min(at_most, len(orbits)))]
    return {keys[i]: orbits[i] for i in picked}


def _looks(keys: Sequence[tuple[float, int]], marked: bool) -> dict[tuple[float, int], dict[str, Any]]:
    """How profiles at each S are drawn: markers, which shrink so that those of coinciding profiles show, or dashes."""
    looks: dict[tuple[float, int], dict[str, Any]] = {}
    for k, (key, colour) in enumerate(zip(keys, colours(len(keys)), strict=True)):
        passage = f" (passage {key[1] + 1})" if key[1] else ""
        marker = {"marker": MARKERS[k % len(MARKERS)], "ms": 5.0 - 2.0 * k / len(keys), "mfc": "white"}
        dashes = marker if marked else {"ls": LINES[k % len(LINES)]}
        looks[key] = {"color": colour, "lw": 0.9, "label": f"$S = {number(key[0])}${passage}", **dashes}
    return looks


def _draw_profiles(
    panels: Sequence[Axes], branch: Branch, orbits: dict[tuple[float, int], Orbit], looks: dict[Any, dict[str, Any]]
) -> None:
    """Profiles over the linear mode: as they are in the first panel, sizes in the second, if there is one.

    Sizes that would come near the smallest double are drawn as powers of ten.
    """
    from matplotlib.ticker import MaxNLocator, NullLocator

    coordinates = family(branch).coordinates
    mode_logs, signs = coordinates.linear_profile
    n, mode = coordinates.output_sites, signs * 10.0**mode_logs
    dot = "o" if mode.size == 1 else None
    first, *second = panels
    first.plot(n, mode, marker=dot, color="0.65", lw=3, ms=9, label="linear mode")
    for key, orbit in orbits.items():
        y = orbit.evaluate(0.0, n) / _norm(orbit)
        first.plot(n, y * (np.sign(y @ mode) or 1.0), **looks[key])
    mode_logs = np.where(np.isfinite(mode_logs), mode_logs, np.nan)
    for axes in second:
        logs = {key: _logarithms(orbit) for key, orbit in orbits.items()}
        deep = any(np.nanmin(values) < DEEPEST for values in (mode_logs, *logs.values()))
        axes.plot(n, mode_logs if deep else 10.0**mode_logs, marker=dot, color="0.65", lw=3, ms=9)
        for key, values in logs.items():
            axes.plot(n, values if deep else 10.0**values, **looks[key])
        if deep:
            axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))
            axes.yaxis.set_major_formatter(lambda power, _: rf"$10^{{{power:.0f}}}$")
        else:
            axes.set_yscale("log")
            powers = np.concatenate([mode_logs, *logs.values()])
            if np.nanmax(powers) - np.nanmin(powers) > DECADES:
                axes.yaxis.set_minor_locator(NullLocator())
    panels[0].axhline(0.0, color="0.45", lw=0.5, zorder=0)
    panels[0].set_title(f"$j = {coordinates.mode_number}$", loc="left", y=1.0)
    panels[0].set_ylabel(r"$y_n(0)\,/\,\Vert y\Vert$")
    for axes in panels[1:]:
        axes.set_ylabel(r"$|y_n(0)|\,/\,\Vert y\Vert$")


def profile_figure(branches: Sequence[Branch]) -> Figure | None:
    """Profiles y_n(0) of requested orbits, scaled to norm 1, over the linear mode.

    A row a family, at most six orbits each, with the sign that overlaps with the linear mode; of a long lattice the
    positions that move. Where a profile spans more than 3 decades, sizes at all positions stand beside them on a
    logarithmic scale.

    Arguments:
        branches: families of one model at the same values of its parameters.

    Returns:
        The figure; None where nothing was requested.

    Raises:
        ValueError: there is no branch, one is no family, or they are of different models.
    """
    model, parameters = common_model(branches)
    chosen = [(branch, orbits) for branch in branches if (orbits := requested(branch, len(MARKERS)))]
    if not chosen:
        return None
    shown = family(chosen[0][0]).coordinates.output_sites
    profiles = np.array([orbit.evaluate(0.0, shown) for _, orbits in chosen for orbit in orbits.values()])
    logs = np.array([_logarithms(orbit) for _, orbits in chosen for orbit in orbits.values()])
    steep = bool(np.any(np.nanmax(logs, axis=1) > np.nanmin(logs, axis=1) + 3.0))
    keys = sorted({key for _, orbits in chosen for key in orbits})
    rows, columns = len(chosen), 2 if steep else 1
    with style():
        looks = _looks(keys, shown.size <= MARKED_SITES)
        figure = blank(3.7 * columns, 0.9 + (2.6 if rows == 1 else 1.5 * rows))
        panels = figure.subplots(rows, columns, sharex="col", squeeze=False)
        for row, (branch, orbits) in zip(panels, chosen, strict=True):
            _draw_profiles(row, branch, orbits, looks)
        low, high = moving(profiles)
        for axes, ends in zip(panels[-1], ((shown[low - 1], shown[high - 1]), (shown[0], shown[-1])), strict=False):
            number_sites(axes, int(ends[0]), int(ends[1]), position_label(model))
        figure.suptitle(title(model, parameters))
        figure.align_ylabels()
        return finished(figure, panels[:, 0], columns * (2 if any(passage for _, passage in keys) else 3), plain=True)
