"""Families: frequency against amplitude with the linear band and the theory, and profiles (paper, Figs. 3 and 7)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family_series import FamilySeries
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.linear import band_edges, lattice_modes
from casadi_skin.results.figures import style
from casadi_skin.results.figures.branches import Pieces, draw_changes, draw_marks, draw_pieces, stability_pieces
from casadi_skin.results.figures.multipliers import frequency_pieces, requested, shade_unresolved
from casadi_skin.zero.model_coordinates import linear_spectrum
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FLAT_HEIGHT_RATIO = 0.02  # of the height of a picture: a change of frequency that it does not show
LINEAR_SCALE_RATIO = 30.0  # ratio of shifts that one linear scale does not show
# Of the largest S, and of that of the shortest family: where logarithmic scales begin.
LOG_SCALE_NEAR, LOG_SCALE_SHORT = 1e-2, 0.1
MOST_LABELS = 24  # as many as fit one above the other beside the frequencies


def family_path(branch: Branch, shift: bool) -> Array:
    """S and Omega (or Omega - omega_j) from the linear mode on in arclength order, shape (points + 1, 2)."""
    values = [orbit.Omega_shift if shift else orbit.Omega for orbit in branch.orbits]
    return np.column_stack([np.append(0.0, branch.S), np.append(0.0 if shift else branch.start.Omega, values)])


def family_pieces(branch: Branch, path: Array, shift: bool = False) -> Pieces:
    """The path of a family, as `family_path` makes it, in stretches of one stability each, exact where it is known."""
    diagram = branch.stability_diagram
    if diagram is None or not diagram.pieces:
        return stability_pieces(branch, path)
    return frequency_pieces(branch, diagram, shift)


def _draw_theory(axes: Axes, branch: Branch, S: Array, shift: bool) -> None:
    """The frequency to first order in S, where the family is a power series; of a shift its slope alone."""
    try:
        start, *_, slope = branch.series(1 if branch.space.S_rate == 1.0 else 2).Omega
    except (ValueError, ArithmeticError):  # forces that are no polynomials, an endless tail, a resonance
        return
    look: dict[str, Any] = {"color": "black", "lw": 0.8, "ls": (0, (1.0, 3.0)), "zorder": 4}
    axes.plot(S, slope * S + (0.0 if shift else start), label="multiple scales, first order in $S$", **look)


def draw_band(axes: Axes, model: Any, offset: float = 0.0, parameters: Mapping[str, float] | None = None) -> None:
    """From the lowest to the highest linear frequency of each band, a line where they are the same; less `offset`.

    Bands of a lattice are those of its cell; frequencies between them, or of cells that differ, are lines.
    """
    drawn = set[str]()
    for low, high in _bands(model, parameters):
        is_line = high - low <= 1e-12 * abs(high)
        label, width = ("linear frequency", 2.5) if is_line else ("linear band", 0.0)
        ends = np.sqrt(np.maximum((low, high), 0.0)) - offset
        axes.axhspan(*ends, fc="0.9", ec="0.75", lw=width, label=None if label in drawn else label, zorder=0)
        drawn.add(label)


def _bands(model: Any, parameters: Mapping[str, float] | None) -> Sequence[tuple[float, float]]:
    """Ends of bands in omega^2, with both the same for a frequency that lies in none."""
    if model.declaration is None:
        spectrum = linear_spectrum(model, parameters)
        return spectrum.bands or (spectrum.ends,)
    own = lattice_modes(model, parameters).squares.real
    known = [] if model.declaration.differing else band_edges(model, parameters)
    slack = 1e-9 * float(np.max(np.abs(own)))
    apart = [square for square in own.tolist() if not any(a - slack <= square <= b + slack for a, b in known)]
    return [*known, *((square, square) for square in apart)]


def label_ends(axes: Axes, branches: Sequence[Branch], ends: Array) -> None:
    """Write each family's mode where its line ends; of those at the right outside the frame, apart from each other."""
    (low, high), right = axes.get_ylim(), axes.get_xlim()[1]
    heights = (ends[:, 1] - low) / (high - low)
    outside = [i for i in np.argsort(heights, kind="stable").tolist() if ends[i, 0] > 0.97 * right]
    inside = set(range(len(branches))) - set(outside)
    outside = outside[:: -(-len(outside) // MOST_LABELS) or 1]
    gap, places = 0.048 if len(outside) < 22 else 1.0 / MOST_LABELS, heights[outside]
    for i in range(1, len(places)):
        places[i] = max(places[i], places[i - 1] + gap)
    for i in range(len(places))[::-1]:
        places[i] = min(places[i], 1.0 - gap * (len(places) - 1 - i))
    leader = {"arrowstyle": "-", "lw": 0.5, "color": "0.45", "shrinkA": 0, "shrinkB": 0}
    common: dict[str, Any] = {"va": "center", "xycoords": "data", "annotation_clip": False}
    names = [f"$j = {style.family(branch).coordinates.mode_number}$" for branch in branches]
    for i, place in zip(outside, places, strict=True):
        at = (1.045, float(place))
        axes.annotate(names[i], tuple(ends[i]), at, textcoords="axes fraction", arrowprops=leader, **common)
    for i in inside:
        axes.annotate(names[i], tuple(ends[i]), (6, 0), textcoords="offset points", zorder=8, **common)


def _hardly_move(paths: Sequence[Array]) -> bool:
    """Whether one of several families changes its frequency by less than a picture of all of them shows."""
    moved = [float(np.ptp(path[:, 1])) for path in paths]
    return len(paths) > 1 and min(moved) < FLAT_HEIGHT_RATIO * float(np.ptp(np.concatenate(paths)[:, 1]))


def _draw_shifts(axes: Axes, branches: Sequence[Branch]) -> None:
    """Omega - omega_j of families against S; their sizes on logarithmic scales where these differ too much."""
    paths = [family_path(branch, True) for branch in branches]
    ends = np.array([path[-1] for path in paths])
    sizes = np.abs(ends[:, 1])
    apart = bool(sizes.max() > LINEAR_SCALE_RATIO * sizes.min() > 0.0)
    for branch, path, colour in zip(branches, paths, style.colours(len(branches)), strict=True):
        pieces = family_pieces(branch, path, True)
        if apart:
            path, pieces = np.abs(path), [(stable, np.abs(piece)) for stable, piece in pieces]
        draw_pieces(axes, branch, path, pieces, colour)
        draw_changes(axes, branch, path, pieces)
        draw_marks(axes, branch, path, colour)
    right = float(ends[:, 0].max())
    axes.set(xlabel=style.amplitude_label(branches[0].space.model), xlim=(0.0, right))
    if not apart:
        axes.set_ylabel(r"frequency shift $\Omega - \omega_j$")
        label_ends(axes, branches, ends)
        return
    left = min(LOG_SCALE_NEAR * right, LOG_SCALE_SHORT * float(ends[:, 0].min()))
    limits = 0.1 * float(np.min(sizes * left / ends[:, 0])), 2.0 * float(sizes.max())
    label = r"frequency shift $|\Omega - \omega_j|$"
    axes.set(xscale="log", yscale="log", xlim=(left, right), ylim=limits, ylabel=label)
    for branch, end, size in zip(branches, ends, sizes, strict=True):
        name = f"$j = {style.family(branch).coordinates.mode_number}$"
        axes.annotate(name, (end[0], size), (6, 0), textcoords="offset points", va="center", annotation_clip=False)


@style.drawn
def frequency_figure(branches: Sequence[Branch]) -> Figure:
    """Omega against S of families, stable solid and unstable dashed (paper, Fig. 3a and d).

    Of one family whose frequency hardly moves, Omega - omega_j is shown; where one of several hardly moves,
    all these shifts stand beside the frequencies.

    Arguments:
        branches: one or more families of one model at the same values of its parameters.

    Returns:
        The figure.

    Raises:
        ValueError: there is no branch, one is no family, or they are of different models.
    """
    model, parameters = style.common_model(branches)
    paths = [family_path(branch, False) for branch in branches]
    beside = _hardly_move(paths)
    figure = style.blank(11.0 if beside else 6.0, 4.6)
    axes = figure.add_subplot(1, 1 + beside, 1)
    shift = len(branches) == 1 and bool(np.ptp(paths[0][:, 1]) < 1e-4 * paths[0][0, 1])
    if shift:
        paths = [family_path(branches[0], True)]
    draw_band(axes, model, branches[0].start.Omega if shift else 0.0, parameters)
    for branch, path, colour in zip(branches, paths, style.colours(len(branches)), strict=True):
        pieces = family_pieces(branch, path, shift)
        draw_pieces(axes, branch, path, pieces, colour)
        draw_changes(axes, branch, path, pieces, strip=len(branches) == 1)
        if branch.unresolved:
            shade_unresolved(axes, branch.unresolved)
        _draw_theory(axes, branch, np.array([0.0, path[:, 0].max()]), shift)
        draw_marks(axes, branch, path, colour)
    points = np.concatenate(paths)
    low, high = points[:, 1].min(), points[:, 1].max()
    margin = 0.07 * (high - low) or 0.05 * (high or 1.0)
    axes.set(xlim=(0.0, points[:, 0].max() or 1.0), ylim=(low - margin, high + margin))
    axes.set_title(style.title(model, parameters), y=1.0)
    label_ends(axes, branches, np.array([path[-1] for path in paths]))
    if beside:
        _draw_shifts(figure.add_subplot(1, 2, 2), branches)
    mode = style.family(branches[0]).coordinates.mode_number
    label = rf"frequency shift $\Omega - \omega_{{{mode}}}$" if shift else r"frequency $\Omega$"
    axes.set(xlabel=style.amplitude_label(model), ylabel=label)
    return style.finished(figure, [axes], 3, in_black=True)


# The power series of a family: its sums over the family, with the radius of convergence -------------------------------

SHOWN_ORDERS = (1, 2, 4, 8, 16, 32, 64, 128)  # below that of the series
SUMS_TO_RADIUS = 1.25  # of the radius, up to which sums are drawn
SERIES_SAMPLES = 301


def draw_series(axes: Axes, series: FamilySeries, to: float | None = None) -> None:
    """Sums against S, up to a value of S or somewhat beyond the radius, which is a line with its error as a band."""
    radius, error = (series.radius, series.radius_error) if np.isfinite(series.radius) else (to or 1.0, 0.0)
    S = np.linspace(0.0, to or SUMS_TO_RADIUS * radius, SERIES_SAMPLES)
    orders = [*(k for k in SHOWN_ORDERS if k < series.order), series.order]
    for k, colour in zip(orders, style.colours(len(orders)), strict=True):
        axes.plot(S, series.frequency(S, k), lw=0.9, color=colour, label=f"order {k}")
    inside = series.frequency(np.linspace(0.0, min(0.9 * radius, S[-1])))
    room = 0.3 * float(np.ptp(inside)) or 0.05 * float(inside[0])
    axes.set(xlabel=style.AMPLITUDE_LABEL, ylabel=r"frequency $\Omega$", xlim=(0.0, S[-1]))
    axes.set_ylim(float(inside.min()) - room, float(inside.max()) + room)
    if np.isfinite(series.radius):
        axes.axvline(radius, color="0.4", lw=0.8, ls="--", label="radius of convergence")
        axes.axvspan(max(radius - error, 0.0), radius + error, fc="0.9", ec="none", zorder=0)


@style.drawn
def series_figure(branch: Branch, series: FamilySeries) -> Figure:
    """Omega against S of a family, and the sums of its power series.

    Arguments:
        branch: the family.
        series: its `branch.series`.

    Returns:
        The figure.

    Raises:
        ValueError: the branch is no family.
    """
    model, parameters = style.common_model([branch])
    figure, path = style.blank(6.0, 4.4), family_path(branch, False)
    axes = figure.add_subplot()
    draw_series(axes, series, float(path[:, 0].max()))
    axes.plot(*path.T, color="0.75", lw=4.0, zorder=1, label="family")
    ends = *axes.get_ylim(), float(path[:, 1].min()), float(path[:, 1].max())
    axes.set(ylim=(min(ends), max(ends)), xlabel=style.amplitude_label(model))
    axes.set_title(style.title(model, parameters), y=1.0)
    return style.finished(figure, [axes], 4)


# Profiles of requested orbits beside their linear mode (paper, Fig. 3b, e) --------------------------------------------

MARKERS, LINES = "os^Dv<", ("-", "--", "-.", ":")
DEEPEST_LOG_SIZE = -290.0  # log10 of sizes that are drawn as they are
DECADES_OF_TICKS = 2.0  # that an axis spans whose powers of ten are ticks enough: each takes half a millisecond


def _logarithms(orbit: Orbit) -> Array:
    """log10 of |y_n(0)|/||y||, nan at rest and at nodes, shape (positions,)."""
    logs = orbit.log10_displacements(orbit.output_sites)[0] - np.log10(_norm(orbit))
    around = np.pad(logs, 1, constant_values=-np.inf)
    return np.where(logs > np.maximum(around[:-2], around[2:]) - 13.0, logs, np.nan)


def _norm(orbit: Orbit) -> float:
    """||y|| at t = 0."""
    return float(np.sqrt(orbit.S)) if style.is_sum_of_squares(orbit.model) else float(np.linalg.norm(orbit.profile))


def _looks(keys: Sequence[tuple[float, int]], marked: bool) -> dict[tuple[float, int], dict[str, Any]]:
    """How profiles at each S are drawn: markers, which shrink so that those of coinciding profiles show, or dashes."""
    looks: dict[tuple[float, int], dict[str, Any]] = {}
    for k, (key, colour) in enumerate(zip(keys, style.colours(len(keys)), strict=True)):
        passage = f" (passage {key[1] + 1})" if key[1] else ""
        marker = {"marker": MARKERS[k % len(MARKERS)], "ms": 5.0 - 2.0 * k / len(keys), "mfc": "white"}
        dashes = marker if marked else {"ls": LINES[k % len(LINES)]}
        looks[key] = {"color": colour, "lw": 0.9, "label": f"$S = {style.number(key[0])}${passage}", **dashes}
    return looks


def _draw_profiles(
    panels: Sequence[Axes], branch: Branch, orbits: dict[tuple[float, int], Orbit], looks: dict[Any, dict[str, Any]]
) -> None:
    """Profiles over the linear mode: as they are in the first panel, sizes in the second, if there is one.

    Sizes that would come near the smallest double are drawn as powers of ten.
    """
    from matplotlib.ticker import MaxNLocator, NullLocator

    coordinates = style.family(branch).coordinates
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
        deep = any(np.nanmin(values) < DEEPEST_LOG_SIZE for values in (mode_logs, *logs.values()))
        axes.plot(n, mode_logs if deep else 10.0**mode_logs, marker=dot, color="0.65", lw=3, ms=9)
        for key, values in logs.items():
            axes.plot(n, values if deep else 10.0**values, **looks[key])
        if deep:
            axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))
            axes.yaxis.set_major_formatter(lambda power, _: rf"$10^{{{power:.0f}}}$")
        else:
            axes.set_yscale("log")
            powers = np.concatenate([mode_logs, *logs.values()])
            if np.nanmax(powers) - np.nanmin(powers) > DECADES_OF_TICKS:
                axes.yaxis.set_minor_locator(NullLocator())
        axes.set_ylabel(r"$|y_n(0)|\,/\,\Vert y\Vert$")
    first.axhline(0.0, color="0.45", lw=0.5, zorder=0)
    first.set_title(f"$j = {coordinates.mode_number}$", loc="left", y=1.0)
    first.set_ylabel(r"$y_n(0)\,/\,\Vert y\Vert$")


@style.drawn
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
    model, parameters = style.common_model(branches)
    chosen = [(branch, orbits) for branch in branches if (orbits := requested(branch, len(MARKERS)))]
    if not chosen:
        return None
    shown = style.family(chosen[0][0]).coordinates.output_sites
    profiles = np.array([orbit.evaluate(0.0, shown) for _, orbits in chosen for orbit in orbits.values()])
    logs = np.array([_logarithms(orbit) for _, orbits in chosen for orbit in orbits.values()])
    steep = bool(np.any(np.nanmax(logs, axis=1) > np.nanmin(logs, axis=1) + 3.0))
    keys, rows, columns = sorted({key for _, orbits in chosen for key in orbits}), len(chosen), 1 + steep
    looks = _looks(keys, shown.size <= style.MARKED_SITES)
    figure = style.blank(3.7 * columns, 0.9 + (2.6 if rows == 1 else 1.5 * rows))
    panels = figure.subplots(rows, columns, sharex="col", squeeze=False)
    for row, (branch, orbits) in zip(panels, chosen, strict=True):
        _draw_profiles(row, branch, orbits, looks)
    low, high = style.moving(profiles)
    for axes, ends in zip(panels[-1], ((shown[low - 1], shown[high - 1]), (shown[0], shown[-1])), strict=False):
        style.number_sites(axes, int(ends[0]), int(ends[1]), style.position_label(model))
    figure.suptitle(style.title(model, parameters))
    figure.align_ylabels()
    several = any(passage for _, passage in keys)
    return style.finished(figure, panels[:, 0], columns * (2 if several else 3))


# Orbits of a lattice in two dimensions: displacements in the plane, and their sizes -----------------------------------

MOST_ORBITS = 3  # side by side
DEEPEST_PLANE = -8.0  # of the logarithms drawn


@style.drawn
def plane_figure(branch: Branch) -> Figure | None:
    """Displacements at t = 0 over their norm in the plane, and their decimal logarithms, one column a requested orbit.

    Arguments:
        branch: a family.

    Returns:
        The figure; None where the model is no lattice in two dimensions, or no orbit was requested.

    Raises:
        ValueError: the branch is no family.
    """
    lattice = style.family(branch).model
    orbits = [orbit for orbit in branch.orbits if orbit.point.requested][-MOST_ORBITS:]
    if lattice.declaration is None or len(lattice.declaration.cells) != 2 or not orbits:
        return None
    rows, columns = lattice.declaration.cells[0], lattice.declaration.cells[1] * len(lattice.declaration.sites)
    figure = style.blank(0.6 + 2.8 * len(orbits), 5.2)
    panels = figure.subplots(2, len(orbits), squeeze=False)
    for k, orbit in enumerate(orbits):
        y = orbit.profile.reshape(rows, columns) / np.sqrt(orbit.S)
        largest = float(np.max(np.abs(y)))
        with np.errstate(divide="ignore"):
            logs = np.maximum(np.log10(np.abs(y)), DEEPEST_PLANE)
        looks: Sequence[tuple[np.ndarray, str, float, float, str]] = (
            (y, "RdBu", -largest, largest, rf"$y(0)/\|y\|$, $S = {style.number(orbit.S)}$"),
            (logs, "viridis", float(np.min(logs)), 0.0, r"$\log_{10}|y(0)|/\|y\|$"),
        )
        for panel, (values, colours, low, high, words) in zip(panels[:, k], looks, strict=True):
            extent = (0.5, rows + 0.5, 0.5, columns + 0.5)
            image = panel.imshow(values.T, cmap=colours, vmin=low, vmax=high, origin="lower", extent=extent)
            figure.colorbar(image, ax=panel, shrink=0.8, use_gridspec=False)
            across = "cell $m$" if len(lattice.declaration.sites) == 1 else "sites along $m$"
            panel.set(title=words, xlabel="cell $n$", ylabel=across)
    figure.suptitle(style.title(lattice, style.family(branch).coordinates.parameters))
    return style.finished(figure, (), 1)
