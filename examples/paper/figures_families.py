"""Figures 3, 4 and 7 of the paper: twelve families with two modes of theirs, sensitivity, and theory."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter
from paper_data import (
    ALPHA,
    AMPLITUDE_MAX,
    SITES,
    STATED_P,
    STATED_Q,
    Array,
    PaperData,
    Rows,
    Sensitivity,
    analytical_sensitivity,
    stacked,
    table,
)

from casadi_skin import Branch, Evolution, Orbit, closed_forms
from casadi_skin.results.figures.evolutions import draw_spacetime
from casadi_skin.results.figures.families import LINES, MARKERS, draw_band, family_path, family_pieces, label_ends
from casadi_skin.results.figures.style import (
    AMPLITUDE_LABEL,
    blank,
    colours,
    finished,
    number,
    number_sites,
    style,
    title,
)
from casadi_skin.results.quantities import columns_of, csv_row, places_of
from casadi_skin.results.tables import EVENT_COLUMNS, event_rows
from casadi_skin.runs.study import letter

Drawn = tuple[Figure, dict[str, Rows]]
DASHED = (0, (3.0, 1.6))  # unstable
# Dashes of the theory's lines in figure 7, by mode, as its caption has them
DASHES = ((0, (5, 2)), (0, (5, 5)), (0, (1, 1)), (0, (5, 2, 1, 2)), (0, (1, 4)), (0, ()))


def sites_table(t: Array, displacements: Array) -> Rows:
    """Displacements (time, site) against time, a column a site."""
    sites = {f"y_{n}": column for n, column in enumerate(displacements.T, start=1)}
    return table(t=t, **sites)


def draw_space_time(figure: Figure, axes: Axes, evolution: Evolution) -> None:
    """Displacements in time as an image with its colour bar."""
    image = draw_spacetime(axes, evolution)
    axes.set(xlabel="time $t$", yticks=[1, 6, 12, 18, 24])
    figure.colorbar(image, ax=axes, label="$y_n(t)$", aspect=25, pad=0.02, use_gridspec=False)


def families_table(families: dict[float, dict[int, Branch]]) -> Rows:
    """All points of families by g and mode, with the columns of family.csv."""
    rows = [
        {"g": g, **csv_row(columns_of(branch), place)}
        for g, branches in families.items()
        for branch in branches.values()
        for place in places_of(branch)
    ]
    return list(rows[0]), rows


def changes_table(families: dict[float, dict[int, Branch]]) -> Rows:
    """Changes of stability of families by g and mode, with the columns of events.csv."""
    rows = [
        {"g": g, **row}
        for g, branches in families.items()
        for mode, branch in branches.items()
        if branch.stability_diagram is not None
        for row in event_rows(mode, branch.stability_diagram)
    ]
    return ["g", *EVENT_COLUMNS], rows


# Figure 3 -----------------------------------------------------------------------------------------------------------


def _draw_families(axes: Axes, families: dict[int, Branch], marked: Orbit, marker: str) -> None:
    """Omega against S, stable solid and unstable dashed, over the grey band; one orbit marked."""
    branches = list(families.values())
    paths = [family_path(branch, False) for branch in branches]
    draw_band(axes, marked.model)
    for branch, path, colour in zip(branches, paths, colours(len(branches)), strict=True):
        for stable, piece in family_pieces(branch, path):
            axes.plot(*piece.T, color=colour, lw=2.0, ls="-" if stable else DASHED, zorder=3)
        at = [(change.value, change.Omega) for change in branch.changes]
        axes.plot(*np.reshape(at, (-1, 2)).T, "|", ms=8, mew=0.8, color="black", zorder=5)
    for dashes, label in (("-", "stable"), (DASHED, "unstable")):
        axes.plot([], [], color="black", lw=2.0, ls=dashes, label=label)
    axes.plot([], [], "|", ms=8, mew=0.8, color="black", label="change of stability")
    look: dict[str, Any] = {"ms": 13.0 if marker == "*" else 8.0, "mfc": "white", "mec": "black"}
    words = "mode of (b) and (c)" if marker == "*" else "mode of (e) and (f)"
    axes.plot(marked.S, marked.Omega, marker, zorder=6, label=words, **look)
    points = np.concatenate(paths)
    axes.set(xlim=(0.0, AMPLITUDE_MAX), ylim=(points[:, 1].min() - 0.08, points[:, 1].max() + 0.08))
    label_ends(axes, branches, np.array([path[-1] for path in paths]))
    axes.set(xlabel=AMPLITUDE_LABEL, ylabel=r"frequency $\Omega$")


def _draw_profile(axes: Axes, orbit: Orbit, mode_number: int) -> None:
    """The profile over the linear mode of the same norm."""
    mode = orbit.model.linear_spectrum().mode(mode_number) * np.sqrt(orbit.S)
    n = np.arange(1, SITES + 1)
    sign = np.sign(mode @ orbit.profile)
    axes.axhline(0.0, color="0.45", lw=0.5, zorder=0)
    axes.plot(n, sign * mode, color="0.65", lw=3, label=r"linear mode, $\sqrt{S}\,u_n/\Vert u\Vert$")
    axes.plot(n, orbit.profile, "o-", ms=4, lw=0.8, color="black", mfc="white", label="nonlinear mode, $y_n(0)$")
    axes.set_ylabel("$y_n(0)$")
    number_sites(axes, 1, SITES, "site $n$")


def families_figure(data: PaperData) -> Drawn:
    """Families of g = +1 and -1, and profile and time evolution of a mode of each (paper, Fig. 3)."""
    families = {1.0: data.hardening, -1.0: data.softening}
    orbits = {1.0: data.hardening_orbit, -1.0: data.softening_orbit}
    tables = {"fig3_families": families_table(families), "fig3_changes": changes_table(families)}
    profiles: list[Rows] = []
    with style():
        figure = blank(12.0, 7.6)
        panels = figure.subplot_mosaic("abc;def", width_ratios=(1.25, 0.9, 1.2))
        for g, mode, letters, marker in ((1.0, SITES, "abc", "*"), (-1.0, 1, "def", "o")):
            orbit = orbits[g]
            evolution = data.evolution(orbit)
            left, middle, right = (panels[name] for name in letters)
            _draw_families(left, families[g], orbit, marker)
            letter(left, letters[0], rf"$g = {g:+g}$ ({'hardening' if g > 0 else 'softening'})")
            _draw_profile(middle, orbit, mode)
            letter(middle, letters[1], rf"$g = {g:+g}$, $j = {mode}$, $S = {number(orbit.S)}$")
            draw_space_time(figure, right, evolution)
            letter(right, letters[2], rf"$\Omega = {orbit.Omega:.5f}$, $T_b = {orbit.period:.4f}$")
            sites = np.arange(1, SITES + 1)
            profiles.append(table(g=g, mode=mode, S=orbit.S, Omega=orbit.Omega, site=sites, y=orbit.profile))
            tables[f"fig3_evolution_j{mode}"] = sites_table(evolution.t, evolution.displacements)
        chain = data.chain(1.0)
        figure.suptitle(title(chain).replace(", $g = 1$", ""))
        tables["fig3_profiles"] = stacked(profiles)
        return finished(figure, [panels[name] for name in "adb"], 4), tables


# Figure 7 -----------------------------------------------------------------------------------------------------------


def theory_figure(data: PaperData) -> Drawn:
    """Multiple scales beside continuation, g = +1: frequencies, and the ratio of the shifts (paper, Fig. 7)."""
    branches = list(data.hardening.values())
    chain = data.chain(1.0)
    with style():
        figure = blank(9.6, 4.6)
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        paths, rows = [], []
        for (mode, branch), colour, dashes in zip(data.hardening.items(), colours(len(branches)), DASHES, strict=True):
            path = family_path(branch, False)
            slope = closed_forms.frequency_slope(chain.sites, chain.alpha, chain.gamma, chain.g, mode)
            theory = branch.start.Omega + slope * path[:, 0]
            left.plot(*path.T, color=colour, lw=3.5, alpha=0.55)
            left.plot(path[:, 0], theory, color="black", lw=1.0, ls=dashes)
            shifts = np.array([orbit.Omega_shift for orbit in branch.orbits])
            ratio = (theory[1:] - branch.start.Omega) / shifts
            right.plot(branch.S, ratio, color=colour, lw=1.3, ls=dashes, label=f"$j = {mode}$")
            known = {"S": branch.S, "Omega": branch.Omega, "Omega_theory": theory[1:]}
            rows.append(table(mode=mode, **known, shift=shifts, shift_theory_over_shift=ratio))
            paths.append(path)
        left.plot([], [], color="0.65", lw=3.5, label="continuation")
        left.plot([], [], color="black", lw=1.0, label="multiple scales, first order in $S$ (dashes by $j$)")
        points = np.concatenate(paths)
        left.set(xlim=(0.0, AMPLITUDE_MAX), ylim=(points[:, 1].min() - 0.08, points[:, 1].max() + 0.12))
        label_ends(left, branches, np.array([path[-1] for path in paths]))
        left.set(xlabel=AMPLITUDE_LABEL, ylabel=r"frequency $\Omega$")
        right.axhline(1.0, color="0.6", lw=0.8, zorder=0)
        right.set(xlim=(0.0, AMPLITUDE_MAX), xlabel=AMPLITUDE_LABEL)
        right.set_ylabel(r"shift $\Omega - \omega_j$: multiple scales / continuation")
        letter(left, "a")
        letter(right, "b")
        figure.suptitle(title(chain))
        return finished(figure, (left, right), 4), {"fig7_theory": stacked(rows)}


# Figure 4 -------------------------------------------------------------------------------------------------------------


GUIDE_SITES = 36  # length of a guide e^(-qN)
GUIDE_DECADES = 0.42  # and of a guide r^-p in decades of r
Curve = tuple[Array, Array]


def ratio_of(gamma: Array) -> Array:
    """r = (1 + gamma)/(1 - gamma)."""
    return np.asarray((1.0 + gamma) / (1.0 - gamma))


def _draw_points(axes: Axes, series: Sequence[tuple[str, Curve]], curves: Sequence[Curve], markers: str) -> None:
    """Computed points with their label, and the analytical curve through them."""
    looks = zip(colours(len(series)), markers, strict=False)
    for (label, points), curve, (colour, marker) in zip(series, curves, looks, strict=False):
        axes.plot(*curve, color=colour, lw=1.2, zorder=2)
        axes.plot(*points, marker, ms=5.0, mfc="white", ls="none", color=colour, label=label, zorder=3)


def _draw_guides(
    axes: Axes, curves: Sequence[Curve], slopes: dict[str, float], length: float, log_x: bool = False
) -> None:
    """A tangent of each slope, by its label, where the logarithm of the curve has it last, or comes nearest to it."""
    for (X, Y), (label, slope), dashes in zip(curves, slopes.items(), LINES, strict=False):
        x, y = np.log(X) if log_x else X, np.log(Y)
        off = np.gradient(y, x) - slope
        crossings = np.flatnonzero(np.diff(np.sign(off)))
        i = crossings[-1] if crossings.size else np.argmin(np.abs(off))
        ends = np.maximum(x[i] + np.array([-0.5, 0.5]) * length, -np.inf if log_x else x[0])
        values = np.exp(y[i] + slope * (ends - x[i]))
        axes.plot(np.exp(ends) if log_x else ends, values, color="black", lw=1.0, ls=dashes, label=label, zorder=4)


def _by_size(sizes: Array, gamma: float) -> Curve:
    """The analytical sensitivity at all numbers of sites within those given."""
    N = np.arange(sizes[0], sizes[-1] + 1)
    return N.astype(float), np.array([analytical_sensitivity(int(n), gamma) for n in N])


def _draw_by_size(axes: Axes, series: dict[float, Sensitivity]) -> None:
    """Sensitivity against N on a logarithmic axis, with the paper's e^(-qN) as tangents."""
    curves = [_by_size(s.N, gamma) for gamma, s in series.items()]
    points = [(rf"$\gamma = {gamma:g}$, numerical", (s.N, s.numerical)) for gamma, s in series.items()]
    _draw_points(axes, points, curves, MARKERS)
    slopes = {f"$e^{{-qN}}$, $q = {STATED_Q[gamma]:.2f}$": -STATED_Q[gamma] for gamma in series}
    _draw_guides(axes, curves, slopes, GUIDE_SITES)
    axes.set(yscale="log", xlabel="lattice size $N$", ylabel=r"sensitivity factor $\mathcal{S}$")


def _draw_law(axes: Axes, series: dict[float, Sensitivity]) -> None:
    """(N+1)^3 times the sensitivity, which tends to a constant for every gamma."""
    curves = [(N, (N + 1) ** 3 * S) for N, S in (_by_size(s.N, gamma) for gamma, s in series.items())]
    _draw_points(axes, [("_", (s.N, s.cube * s.numerical)) for s in series.values()], curves, MARKERS)
    for s in series.values():
        limit, dashes = s.cube_limit[0], (0, (6.0, 3.0))
        axes.axhline(limit, color="black", lw=0.8, ls=dashes, label=r"limit for $N \to \infty$", zorder=1)
        axes.annotate(f"${limit:.1f}$", (1.01, limit), xycoords=axes.get_yaxis_transform(), va="center")
    axes.set(yscale="log", ylim=(4.0, 500.0), xlabel="lattice size $N$", ylabel=r"$(N+1)^3\,\mathcal{S}$")


def _draw_by_gamma(axes: Axes, series: dict[int, Sensitivity]) -> None:
    """Sensitivity against r on logarithmic axes, with the paper's r^-p as tangents."""
    gammas = {N: np.linspace(s.gamma[0], s.gamma[-1], 201) for N, s in series.items()}
    curves = [(ratio_of(c), np.array([analytical_sensitivity(N, float(x)) for x in c])) for N, c in gammas.items()]
    points = [(f"$N = {N}$, numerical", (ratio_of(s.gamma), s.numerical)) for N, s in series.items()]
    _draw_points(axes, points, curves, MARKERS[3:])
    axes.plot([], [], color="0.4", lw=1.2, label="analytical")
    slopes = {f"$r^{{-p}}$, $p = {STATED_P[N]:g}$": -STATED_P[N] for N in series}
    _draw_guides(axes, curves, slopes, GUIDE_DECADES * np.log(10.0), log_x=True)
    axes.set(xscale="log", yscale="log", xlabel=r"$r = (1 + \gamma)/(1 - \gamma)$")
    axes.set_ylabel(r"sensitivity factor $\mathcal{S}$")
    axes.xaxis.set_major_locator(FixedLocator([1, 2, 3, 4, 6, 8]))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())


def sensitivity_figure(data: PaperData) -> Drawn:
    """Sensitivity of mode 1, g = 1, against N and against gamma, numerical and analytical (paper, Fig. 4)."""
    by_size, by_gamma = data.sensitivity_by_size, data.sensitivity_by_gamma
    with style():
        figure = blank(11.4, 4.6)
        size, law, gamma = figure.subplots(1, 3)
        _draw_by_size(size, by_size)
        _draw_law(law, by_size)
        _draw_by_gamma(gamma, by_gamma)
        letter(size, "a", "$e^{-qN}$, tangent where its rate holds")
        letter(law, "b", r"the law for large $N$, $\mathcal{S} \propto (N+1)^{-3}$")
        letter(gamma, "c", "$r^{-p}$, tangent where its power holds")
        figure.suptitle(rf"$j = 1$, $\alpha = {ALPHA:g}$, $g = 1$, numerical: $S$ from 0 to 0.01 (dimensionless)")
        finished(figure, (size, gamma, law), 4)
    return figure, {
        "fig4_size": stacked([s.table() for s in by_size.values()]),
        "fig4_gamma": stacked([s.table() for s in by_gamma.values()]),
    }
