"""Figures 5 and 6 of the paper: Floquet analysis of the softening end breather, and its course after a kick."""

from __future__ import annotations

from typing import Any

import numpy as np
from figures_families import (
    Drawn,
    changes_table,
    draw_space_time,
    families_table,
    sites_table,
)
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from paper_data import KICK, KICK_TIME, SITES, Array, PaperData, Rows, stacked, table

from casadi_skin import Branch, Evolution, Orbit, simulate_orbit, style
from casadi_skin.results.figures.multipliers import MODULUS_LABEL, draw_plane
from casadi_skin.results.figures.multipliers import moduli as moduli_line
from casadi_skin.results.figures.style import AMPLITUDE_LABEL, blank, finished, number, title
from casadi_skin.runs.study import letter

DENSE = 400  # places along the family of which all multipliers are drawn
MARKED = (1.0, 3.0)  # S of panels (b) and (c) of figure 5
KICKED_SITES = (SITES, 1)


# Figure 5 -----------------------------------------------------------------------------------------------------------


def sorted_vectors(orbit: Orbit) -> tuple[NDArray[np.complex128], Array, NDArray[np.bool_]]:
    """Multipliers in increasing modulus (then phase), their vectors' sizes by site, and whether each is trivial.

    Shapes (2N,), (2N, N), (2N,). The size at a site is the norm of displacement and velocity, divided by the largest.
    """
    multipliers, vectors = orbit.floquet().multipliers, orbit.floquet_vectors()
    sizes = np.hypot(np.abs(vectors[:SITES]), np.abs(vectors[SITES:])).T
    order = np.lexsort((np.angle(multipliers), np.round(np.log(np.abs(multipliers)), 9)))
    sizes = np.asarray(sizes[order] / np.max(sizes[order], axis=1, keepdims=True))
    return multipliers[order], sizes, order < 2


def _draw_moduli(axes: Axes, branch: Branch) -> None:
    """|lambda| of all multipliers off the circle against S, and below them a strip that is black where stable."""
    diagram = branch.stability_diagram
    assert diagram is not None
    at = np.linspace(diagram.start, diagram.end, DENSE)
    growth = diagram.growths(at)
    S, logs = np.repeat(diagram.S(at), growth.shape[1]), growth.ravel()
    S, logs = S[logs > 0.0], logs[logs > 0.0]
    axes.axhline(1.0, color="0.6", lw=0.8, zorder=1)
    axes.plot(*moduli_line(diagram).T, color="black", lw=1.0, label=f"largest {MODULUS_LABEL}", zorder=2)
    both = np.concatenate([S, S]), np.exp(np.concatenate([logs, -logs]))
    axes.plot(*both, ".", ms=2.0, color="0.35", label=f"{MODULUS_LABEL} off the unit circle", zorder=3)
    ends = [0.0, *(change.value for change in branch.changes), float(branch.S.max())]
    stable = [bool(branch.stable[0]), *(bool(change.stable_after) for change in branch.changes)]
    for left, right, is_stable in zip(ends[:-1], ends[1:], stable, strict=True):
        if is_stable:
            span: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "fc": "black", "lw": 0.0}
            axes.fill_between([left, right], 0.0, 0.035, label="stable", **span)
    axes.set(xlim=(0.0, 1.01 * branch.S.max()), ylim=(0.66, 1.44), xlabel=AMPLITUDE_LABEL)
    axes.set_ylabel(f"{MODULUS_LABEL} (trivial pair left out)")


def _draw_vectors(figure: Figure, axes: Axes, orbit: Orbit) -> None:
    """Sizes of the Floquet vectors as an image, sites upwards, vectors in increasing modulus to the right."""
    _, sizes, trivial = sorted_vectors(orbit)
    index = np.arange(1, 2 * SITES + 1)
    image = axes.pcolormesh(
        index, np.arange(1, SITES + 1), sizes.T, cmap="Greys", vmin=0.0, vmax=1.0, shading="nearest", rasterized=True
    )
    axes.plot(index[trivial], np.full(2, 1.02), "v", ms=5, color="black", clip_on=False,
              transform=axes.get_xaxis_transform(), label="trivial pair in (d)")  # fmt: skip
    axes.set(xlabel=rf"vector $l$, in increasing {MODULUS_LABEL}", ylabel="site $n$")
    axes.set(xticks=[1, 12, 24, 36, 48], yticks=[1, 6, 12, 18, 24])
    axes.tick_params(top=False, right=False, direction="out")
    figure.colorbar(
        image, ax=axes, label=r"$|z_{l,n}|$ over its largest value", aspect=25, pad=0.02, use_gridspec=False
    )


def _multipliers_table(orbit: Orbit) -> Rows:
    values, _, trivial = sorted_vectors(orbit)
    vector, parts = np.arange(1, values.size + 1), {"real": values.real, "imaginary": values.imag}
    return table(S=orbit.S, vector=vector, **parts, modulus=np.abs(values), trivial=trivial.astype(int))


def _vectors_table(orbit: Orbit) -> Rows:
    values, sizes, _ = sorted_vectors(orbit)
    sites = {f"z_{n}": column for n, column in enumerate(sizes.T, start=1)}
    return table(vector=np.arange(1, values.size + 1), modulus=np.abs(values), **sites)


def floquet_figure(data: PaperData) -> Drawn:
    """Multipliers along the family j = 1, g = -1, at S = 1 and 3, and Floquet vectors at S = 1 (paper, Fig. 5)."""
    branch = data.end_breather
    orbits = [branch.at(S=S) for S in MARKED]
    with style():
        figure = blank(11.4, 7.4)
        panels = figure.subplot_mosaic("aaa;bcd", width_ratios=(1.0, 1.0, 1.25))
        _draw_moduli(panels["a"], branch)
        for S, colour, dashes, name in zip(MARKED, ("purple", "green"), ("--", ":"), "bc", strict=True):
            panels["a"].axvline(
                S, color=colour, lw=1.6, ls=dashes, label=f"$S = {number(S)}$, panel ({name})", zorder=1
            )
        letter(panels["a"], "a")
        for name, orbit in zip("bc", orbits, strict=True):
            draw_plane(panels[name], orbit.floquet())
            largest = orbit.floquet().max_abs_multiplier
            letter(panels[name], name, rf"$S = {number(orbit.S)}$, max {MODULUS_LABEL} $= {number(largest, 5)}$")
        _draw_vectors(figure, panels["d"], orbits[0])
        letter(panels["d"], "d", f"$S = {number(MARKED[0])}$")
        figure.suptitle(f"family $j = 1$; {title(orbits[0].model)}")
        finished(figure, panels.values(), 5)
    families = {-1.0: {1: branch}}
    return figure, {
        "fig5_moduli": families_table(families),
        "fig5_changes": changes_table(families),
        "fig5_multipliers": stacked([_multipliers_table(orbit) for orbit in orbits]),
        "fig5_vectors": _vectors_table(orbits[0]),
    }


# Figure 6 -----------------------------------------------------------------------------------------------------------


def gain(kicked: Evolution, still: Evolution) -> Array:
    """Distance of the kicked from the unperturbed motion over the size of the kick, shape (time,)."""
    apart = np.hstack([kicked.displacements - still.displacements, kicked.velocities - still.velocities])
    return np.asarray(np.linalg.norm(apart, axis=1) / KICK)


def kick_figure(data: PaperData) -> Drawn:
    """Kicks at site 24 and at site 1 of the stable mode, and their gain beside the optimal one (paper, Fig. 6)."""
    orbit, growth = data.softening_orbit, data.growth
    runs = {site: data.kicked(site) for site in KICKED_SITES}
    t = runs[1].t
    still = simulate_orbit(orbit, t)
    gains = {site: gain(run, still) for site, run in runs.items()}
    shown = growth.t <= KICK_TIME
    linear = {site: 10.0 ** growth.of(np.eye(2 * SITES)[site - 1])[shown] for site in KICKED_SITES}
    optimal, bounded = 10.0 ** growth.log10_gain[shown], 10.0 ** growth.log10_bounded[shown]
    with style():
        figure = blank(8.6, 6.8)
        panels = figure.subplot_mosaic("ab;cc")
        for name, site in zip("ab", KICKED_SITES, strict=True):
            axes = panels[name]
            draw_space_time(figure, axes, runs[site])
            axes.annotate(
                r"$\blacktriangleright$", (0.0, site), (-17, 0), textcoords="offset points", ha="right", va="center"
            )
            letter(axes, name, rf"kick at site {site}, $\delta = {KICK:g}$")
        axes = panels["c"]
        axes.plot(growth.t[shown], optimal, "D", color="black", ms=4.5, label="largest possible, linear")
        for site, marker, dashes, grey in ((1, "o", "--", "0.25"), (SITES, "s", "-.", "0.5")):
            axes.plot(t, gains[site], ls=dashes, color=grey, lw=1.0, label=f"kick at site {site}")
            axes.plot(growth.t[shown], linear[site], marker, ms=4.5, mfc="white", color=grey,
                      label=f"kick at site {site}, linear")  # fmt: skip
        axes.set(yscale="log", xlim=(0.0, KICK_TIME), xlabel="time $t$")
        axes.set_ylabel(r"gain $\Vert z(t)\Vert\,/\,\Vert z(0)\Vert$")
        letter(axes, "c", "transient growth of perturbations")
        figure.suptitle(f"$j = 1$, $S = {number(orbit.S)}$; {title(orbit.model)}")
        finished(figure, (axes,), 5)
    quarter = {"t": growth.t[shown], "optimal": optimal, "optimal_without_trivial_pair": bounded}
    return figure, {
        "fig6_kick24": sites_table(t, runs[SITES].displacements),
        "fig6_kick1": sites_table(t, runs[1].displacements),
        "fig6_gain": table(t=t, site_24=gains[SITES], site_1=gains[1]),
        "fig6_optimal": table(**quarter, site_24_linear=linear[SITES], site_1_linear=linear[1]),
    }
