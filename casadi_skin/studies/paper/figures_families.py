"""Figures 3 and 7 of the paper: twelve families with two modes of theirs, and the families beside the theory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.figures.branch_lines import stability_pieces
from casadi_skin.figures.frequencies import draw_band, family_path, label_ends
from casadi_skin.figures.style import AMPLITUDE, blank, colours, finished, number, number_sites, style, title
from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.results.quantities import csv_row, places_of, quantities_of
from casadi_skin.runs.writing import EVENT_COLUMNS, event_rows
from casadi_skin.studies.paper.panels import Drawn, Table, draw_space_time, sites_table, stacked, table
from casadi_skin.studies.paper.paper_data import AMPLITUDE_MAX, SITES, PaperData
from casadi_skin.studies.study import letter
from casadi_skin.theory import multiple_scales

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DASHED = (0, (3.0, 1.6))  # unstable
# Dashes of the theory's lines in figure 7, by mode, as its caption has them
DASHES = ((0, (5, 2)), (0, (5, 5)), (0, (1, 1)), (0, (5, 2, 1, 2)), (0, (1, 4)), (0, ()))


def families_table(families: dict[float, dict[int, Branch]]) -> Table:
    """All points of families by g and mode, with the columns of family.csv."""
    rows = [
        {"g": g, **csv_row(quantities_of(branch), place)}
        for g, branches in families.items()
        for branch in branches.values()
        for place in places_of(branch)
    ]
    return list(rows[0]), rows


def changes_table(families: dict[float, dict[int, Branch]]) -> Table:
    """Changes of stability of families by g and mode, with the columns of events.csv."""
    rows = [
        {"g": g, **row}
        for g, branches in families.items()
        for branch in branches.values()
        for row in event_rows(branch)
    ]
    return ["g", *EVENT_COLUMNS], rows


# Figure 3 -----------------------------------------------------------------------------------------------------------


def _draw_families(axes: Axes, families: dict[int, Branch], marked: Orbit, marker: str) -> None:
    """Omega against S, stable solid and unstable dashed, over the grey band; one orbit marked."""
    branches = list(families.values())
    paths = [family_path(branch, False) for branch in branches]
    draw_band(axes, marked.model)
    for branch, path, colour in zip(branches, paths, colours(len(branches)), strict=True):
        for stable, piece in stability_pieces(branch, path, False):
            axes.plot(*piece.T, color=colour, lw=2.0, ls="-" if stable else DASHED, zorder=3)
        at = [(change.S, change.Omega) for change in branch.changes]
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
    axes.set(xlabel=AMPLITUDE, ylabel=r"frequency $\Omega$")


def _draw_profile(axes: Axes, orbit: Orbit, j: int) -> None:
    """The profile over the linear mode of the same norm."""
    mode = orbit.model.linear_spectrum().mode(j) * np.sqrt(orbit.S)
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
    profiles: list[Table] = []
    with style():
        figure = blank(12.0, 7.6)
        panels = figure.subplot_mosaic("abc;def", width_ratios=(1.25, 0.9, 1.2))
        for g, mode, letters, marker in ((1.0, 24, "abc", "*"), (-1.0, 1, "def", "o")):
            orbit = orbits[g]
            evolution = data.evolution(orbit)
            left, middle, right = (panels[name] for name in letters)
            _draw_families(left, families[g], orbit, marker)
            letter(left, letters[0], rf"$g = {g:+g}$ ({'hardening' if g > 0 else 'softening'})")
            _draw_profile(middle, orbit, mode)
            letter(middle, letters[1], rf"$g = {g:+g}$, $j = {mode}$, $S = {number(orbit.S)}$")
            draw_space_time(figure, right, evolution)
            letter(right, letters[2], rf"$\Omega = {orbit.Omega:.5f}$, $T_b = {orbit.period:.4f}$")
            summary = {"g": np.full(SITES, g), "mode": np.full(SITES, mode), "S": np.full(SITES, orbit.S)}
            rest = {"Omega": np.full(SITES, orbit.Omega), "site": np.arange(1, SITES + 1), "y": orbit.profile}
            profiles.append(table(**summary, **rest))
            tables[f"fig3_evolution_j{mode}"] = sites_table(evolution.t, evolution.displacements)
        chain = data.chain(1.0)
        figure.suptitle(title(chain).replace(", $g = 1$", ""))
        tables["fig3_profiles"] = stacked(profiles)
        return finished(figure, [panels[name] for name in "adb"], 8), tables


# Figure 7 -----------------------------------------------------------------------------------------------------------


def _theory(chain: Chain, mode: int, S: Array) -> Array:
    return multiple_scales.frequency(chain.sites, chain.alpha, chain.gamma, chain.g, mode, S)


def theory_figure(data: PaperData) -> Drawn:
    """Multiple scales beside continuation, g = +1: frequencies, and the ratio of the shifts (paper, Fig. 7)."""
    branches = list(data.hardening.values())
    with style():
        figure = blank(9.6, 4.6)
        left, right = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
        paths, rows = [], []
        for (mode, branch), colour, dashes in zip(data.hardening.items(), colours(len(branches)), DASHES, strict=True):
            path = family_path(branch, False)
            theory = _theory(data.chain(1.0), mode, path[:, 0])
            left.plot(*path.T, color=colour, lw=3.5, alpha=0.55)
            left.plot(path[:, 0], theory, color="black", lw=1.0, ls=dashes)
            shifts = np.array([orbit.Omega_shift for orbit in branch.orbits])
            ratio = (theory[1:] - branch.start.Omega) / shifts
            right.plot(branch.S, ratio, color=colour, lw=1.3, ls=dashes, label=f"$j = {mode}$")
            columns = {"mode": np.full(len(branch), mode), "S": branch.S, "Omega": branch.Omega}
            rows.append(table(**columns, Omega_theory=theory[1:], shift=shifts, shift_theory_over_shift=ratio))
            paths.append(path)
        left.plot([], [], color="0.65", lw=3.5, label="continuation")
        left.plot([], [], color="black", lw=1.0, label="multiple scales, first order in $S$ (dashes by $j$)")
        points = np.concatenate(paths)
        left.set(xlim=(0.0, AMPLITUDE_MAX), ylim=(points[:, 1].min() - 0.08, points[:, 1].max() + 0.12))
        label_ends(left, branches, np.array([path[-1] for path in paths]))
        left.set(xlabel=AMPLITUDE, ylabel=r"frequency $\Omega$")
        right.axhline(1.0, color="0.6", lw=0.8, zorder=0)
        right.set(xlim=(0.0, AMPLITUDE_MAX), xlabel=AMPLITUDE)
        right.set_ylabel(r"shift $\Omega - \omega_j$: multiple scales / continuation")
        letter(left, "a")
        letter(right, "b")
        figure.suptitle(title(data.chain(1.0)))
        return finished(figure, (left, right), 4), {"fig7_theory": stacked(rows)}
