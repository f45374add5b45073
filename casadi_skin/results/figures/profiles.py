"""Profiles of requested orbits beside their linear mode (paper, Fig. 3b, e)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.results.figures.branch import times
from casadi_skin.results.figures.style import (
    DASHES,
    blank,
    colours,
    common_model,
    family,
    finished,
    is_sum_of_squares,
    number,
    number_sites,
    plain,
    position_label,
    style,
    title,
)
from casadi_skin.results.figures.style import title as model_title
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from casadi_skin.dynamics.starts import Spreading
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


# Several solutions of one model side by side: their phase portrait, and a state over time -----------------------------

MOST = 6  # solutions that are drawn
CHOSEN = 4  # orbits of a branch, by default


def portrait_figure(solutions: Sequence[Solution], title: str = "", states: tuple[int, int] = (0, 1)) -> Figure:
    """Orbits and equilibria in the plane of two states, and the first of these against time.

    Arguments:
        solutions: one to six of one model.
        title: stands in place of the name of the model.
        states: places of the two states among their names, from 0; of one state alone time courses are drawn.

    Returns:
        The figure; solutions are labelled by the parameters in which they differ.

    Raises:
        ValueError: there are no solutions, or more than six.
    """
    if not 1 <= len(solutions) <= MOST:
        raise ValueError(f"solutions: given {len(solutions)}; accepted: 1 to {MOST}")
    names = solutions[0].space.state_names
    in_plane = len(names) > 1
    words, common = _words(solutions)
    longest = max((s.interval[1] for s in solutions), default=0.0) or 1.0
    with style():
        figure = blank(8.0 if in_plane else 5.0, 3.8)
        axes = figure.subplots(1, 1 + in_plane, squeeze=False)[0]
        for solution, colour, dashes, label in zip(solutions, colours(len(solutions)), DASHES, words, strict=False):
            at_rest = isinstance(solution, Equilibrium)
            t = np.array([0.0, longest]) if at_rest else times(solution)
            x = solution.evaluate(t)
            axes[0].plot(t, x[:, states[0]], color=colour, ls=dashes, lw=1.4, label=label)
            if in_plane:
                look = {"marker": "o", "ms": 5, "mec": "black", "ls": "none"} if at_rest else {"ls": dashes, "lw": 1.4}
                axes[1].plot(*x[:, list(states)].T, color=colour, label=label, **look)
        axes[0].set(xlabel="t", ylabel=plain(names[states[0]]))
        if in_plane:
            axes[1].set(xlabel=plain(names[states[0]]), ylabel=plain(names[states[1]]))
        figure.suptitle(model_title(solutions[0].space.model, common, title))
        return finished(figure, axes, 3, plain=True)


def chosen_solutions(branches: Sequence[Branch]) -> list[Solution]:
    """Solutions for a portrait: the requested ones, else an equilibrium where cycles are born and a few of these.

    None where no orbit is among the branches: equilibria alone are seen in the diagram.
    """
    held = [s for branch in branches for s in branch.solutions]
    requested = [s for s in held if s.point.requested]
    cycles = next((branch.solutions for branch in branches if isinstance(branch.solutions[0], Orbit)), ())
    if requested and cycles:
        return requested[:MOST]
    moving = [s for s in cycles[1:] if not s.point.special]  # the first one has no amplitude
    places = np.unique(np.linspace(0, len(moving) - 1, CHOSEN + 1)[1:].astype(int)) if moving else ()
    born = [s for s in held if s.point.special == "hopf" and isinstance(s, Equilibrium)][:1]
    return [*born, *(moving[place] for place in places)] if moving else []


def _words(solutions: Sequence[Solution]) -> tuple[list[str], dict[str, float]]:
    """A label for each solution, by the parameters in which they differ, and the parameters that they share."""
    first = solutions[0].parameters
    shared = {
        name: value
        for name, value in first.items()
        if all(name in s.parameters and s.parameters[name] == value for s in solutions)
    }
    labels = []
    for solution in solutions:
        own = {name: value for name, value in solution.parameters.items() if name in first and name not in shared}
        values = ", ".join(f"{plain(name)} = {value:.4g}" for name, value in own.items())
        period = f", period {solution.period:.4g}" if isinstance(solution, Orbit) else ", at rest"
        labels.append(f"{values}{period}".removeprefix(", "))
    return labels, shared


# Orbits of a lattice in two dimensions: displacements in the plane, and their sizes -----------------------------------

MOST_ORBITS = 3  # side by side
DEEPEST_PLANE = -8.0  # of the logarithms drawn


def plane_figure(branch: Branch) -> Figure | None:
    """Displacements at t = 0 over their norm in the plane, and their decimal logarithms, one column a requested orbit.

    Arguments:
        branch: a family.

    Returns:
        The figure; None where the model is no lattice in two dimensions, or no orbit was requested.

    Raises:
        ValueError: the branch is no family.
    """
    lattice = family(branch).model
    orbits = [orbit for orbit in branch.orbits if orbit.point.requested][-MOST_ORBITS:]
    if not isinstance(lattice, Lattice) or len(lattice.declaration.cells) != 2 or not orbits:
        return None
    rows, columns = lattice.declaration.cells[0], lattice.declaration.cells[1] * len(lattice.declaration.sites)
    with style():
        figure = blank(0.6 + 2.8 * len(orbits), 5.2)
        panels = figure.subplots(2, len(orbits), squeeze=False)
        for k, orbit in enumerate(orbits):
            y = orbit.profile.reshape(rows, columns) / np.sqrt(orbit.S)
            largest = float(np.max(np.abs(y)))
            with np.errstate(divide="ignore"):
                logs = np.maximum(np.log10(np.abs(y)), DEEPEST_PLANE)
            looks: Sequence[tuple[np.ndarray, str, float, float, str]] = (
                (y, "RdBu", -largest, largest, rf"$y(0)/\|y\|$, $S = {number(orbit.S)}$"),
                (logs, "viridis", float(np.min(logs)), 0.0, r"$\log_{10}|y(0)|/\|y\|$"),
            )
            for panel, (values, colours, low, high, words) in zip(panels[:, k], looks, strict=True):
                extent = (0.5, rows + 0.5, 0.5, columns + 0.5)
                image = panel.imshow(values.T, cmap=colours, vmin=low, vmax=high, origin="lower", extent=extent)
                figure.colorbar(image, ax=panel, shrink=0.8, use_gridspec=False)
                panel.set_title(words)
                panel.set_xlabel("cell $n$")
                panel.set_ylabel("cell $m$" if len(lattice.declaration.sites) == 1 else "sites along $m$")
        figure.suptitle(title(lattice, family(branch).coordinates.parameters))
        return finished(figure, (), 1)


# The energy of a lattice in time: by site, its centre, participation number and second moment -------------------------

SPREADING_DECADES = 5.0  # of energies that colours distinguish
MOST_COLUMNS = 2000  # more samples than that no page resolves


def spreading_figure(found: Spreading, lattice: Lattice) -> Figure:
    """Energies of the sites in time as colour, and below them three numbers that locate them.

    Arguments:
        found: of a time evolution.
        lattice: that it is one of.

    Returns:
        The figure.
    """
    from matplotlib.colors import LogNorm

    step = max(1, found.t.size // MOST_COLUMNS)
    energies = np.abs(found.energies[::step]).T
    largest = float(np.max(energies)) or 1.0
    with style():
        figure = blank(6.2, 6.0)
        panels = figure.subplot_mosaic([["a"], ["a"], ["b"], ["c"]], sharex=True)
        numbers = np.arange(1, len(energies) + 1)
        least = largest * 10.0**-SPREADING_DECADES
        drawn = panels["a"].pcolormesh(
            found.t[::step], numbers, np.maximum(energies, least), cmap="cividis", norm=LogNorm(least, largest),
            shading="nearest", rasterized=True,
        )  # fmt: skip
        panels["a"].set_ylabel("site" if len(lattice.declaration.cells) == 1 else "site, along rows")
        figure.colorbar(drawn, ax=panels["a"], label="energy of the site", use_gridspec=False)
        for k, dash in zip(range(found.centre.shape[1]), DASHES, strict=False):
            label = f"along direction {k + 1}" if found.centre.shape[1] > 1 else None
            panels["b"].plot(found.t, found.centre[:, k], color="black", ls=dash, lw=0.9, label=label)
        panels["b"].set_ylabel("centre (cell)")
        if found.centre.shape[1] > 1:
            panels["b"].legend(loc="best")
        panels["c"].plot(found.t, found.participation, color="black", lw=0.9, label="participation number (sites)")
        panels["c"].plot(
            found.t, found.second_moment, color="black", lw=0.9, ls=DASHES[1], label="second moment (cells squared)"
        )
        panels["c"].set_ylim(bottom=0.0)
        panels["c"].legend(loc="best")
        panels["c"].set_xlabel("time $t$")
        figure.suptitle(title(lattice))
        return finished(figure, (), 1)
