"""Figure 4 of the paper: sensitivity of the frequency against N and gamma, and the law in N that holds in the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.figures.profiles import LINES, MARKERS
from casadi_skin.figures.style import blank, colours, finished, style
from casadi_skin.studies.paper.panels import Drawn, Table, stacked, table
from casadi_skin.studies.paper.paper_data import (
    ALPHA,
    STATED_P,
    STATED_Q,
    PaperData,
    Sensitivity,
    analytical_sensitivity,
)
from casadi_skin.studies.study import letter
from casadi_skin.theory import multiple_scales

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GUIDE_SITES = 36  # length of a guide e^(-qN)
GUIDE_DECADES = 0.42  # and of a guide r^-p in decades of r


def ratio_of(gamma: Array) -> Array:
    """r = (1 + gamma)/(1 - gamma)."""
    return np.asarray((1.0 + gamma) / (1.0 - gamma))


def _tangent(x: Array, log_value: Array, slope: float) -> tuple[float, float]:
    """Where, last in x, the curve has the slope: abscissa and value; where it is nearest if it never has it."""
    slopes = np.gradient(log_value, x)
    crossings = np.flatnonzero(np.diff(np.sign(slopes - slope)))
    i = crossings[-1] if crossings.size else np.argmin(np.abs(slopes - slope))
    return float(x[i]), float(log_value[i])


def _draw_by_size(axes: Axes, series: dict[float, Sensitivity]) -> None:
    """Sensitivity against N on a logarithmic axis, with the paper's e^(-qN) as tangents."""
    guides: list[tuple[Array, Array, float]] = []
    for (gamma, values), colour, marker in zip(series.items(), colours(len(series)), MARKERS, strict=False):
        sizes = np.arange(int(values.abscissa[0]), int(values.abscissa[-1]) + 1)
        analytical = np.array([analytical_sensitivity(int(N), gamma) for N in sizes])
        axes.plot(sizes, analytical, color=colour, lw=1.2, zorder=2)
        look = {"ms": 5.0, "mfc": "white", "ls": "none", "color": colour}
        axes.plot(
            values.abscissa, values.numerical, marker, label=rf"$\gamma = {gamma:g}$, numerical", zorder=3, **look
        )
        q = STATED_Q[gamma]
        at, log_value = _tangent(sizes.astype(float), np.log(analytical), -q)
        guide = np.maximum(at + np.array([-0.5, 0.5]) * GUIDE_SITES, sizes[0])
        guides.append((guide, np.exp(log_value - q * (guide - at)), q))
    for (guide, value, q), dashes in zip(guides, LINES, strict=False):
        axes.plot(guide, value, color="black", lw=1.0, ls=dashes, label=f"$e^{{-qN}}$, $q = {q:.2f}$", zorder=4)
    axes.set(yscale="log", xlabel="lattice size $N$", ylabel=r"sensitivity factor $\mathcal{S}$")


def _draw_law(axes: Axes, series: dict[float, Sensitivity]) -> None:
    """(N+1)^3 times the sensitivity, which tends to a constant for every gamma."""
    for (gamma, values), colour, marker in zip(series.items(), colours(len(series)), MARKERS, strict=False):
        N, limit = values.abscissa, multiple_scales.sensitivity_limit(ALPHA, gamma, 1.0, 1)
        sizes = np.arange(int(N[0]), int(N[-1]) + 1)
        analytical = [(n + 1) ** 3 * analytical_sensitivity(int(n), gamma) for n in sizes]
        axes.plot(sizes, analytical, color=colour, lw=1.2, zorder=2)
        axes.plot(N, (N + 1) ** 3 * values.numerical, marker, ms=5.0, mfc="white", color=colour, zorder=3)
        axes.axhline(limit, color="black", lw=0.8, ls=(0, (6.0, 3.0)), label=r"limit for $N \to \infty$", zorder=1)
        axes.annotate(f"${limit:.1f}$", (1.01, limit), xycoords=axes.get_yaxis_transform(), va="center")
    axes.set(yscale="log", ylim=(4.0, 500.0), xlabel="lattice size $N$", ylabel=r"$(N+1)^3\,\mathcal{S}$")


def _draw_by_gamma(axes: Axes, series: dict[int, Sensitivity]) -> None:
    """Sensitivity against r on logarithmic axes, with the paper's r^-p as tangents."""
    from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

    guides: list[tuple[Array, Array, float]] = []
    for (N, values), colour, marker in zip(series.items(), colours(len(series)), MARKERS[3:], strict=False):
        gammas = np.linspace(values.abscissa[0], values.abscissa[-1], 201)
        r, abscissa = ratio_of(gammas), ratio_of(values.abscissa)
        analytical = np.array([analytical_sensitivity(N, float(gamma)) for gamma in gammas])
        axes.plot(r, analytical, color=colour, lw=1.2, zorder=2)
        look = {"ms": 5.0, "mfc": "white", "ls": "none", "color": colour}
        axes.plot(abscissa, values.numerical, marker, label=f"$N = {N}$, numerical", zorder=3, **look)
        p = STATED_P[N]
        at, log_value = _tangent(np.log(r), np.log(analytical), -p)
        guide = at + np.array([-0.5, 0.5]) * GUIDE_DECADES * np.log(10.0)
        guides.append((np.exp(guide), np.exp(log_value - p * (guide - at)), p))
    axes.plot([], [], color="0.4", lw=1.2, label="analytical")
    for (guide, value, p), dashes in zip(guides, LINES, strict=False):
        axes.plot(guide, value, color="black", lw=1.0, ls=dashes, label=f"$r^{{-p}}$, $p = {p:g}$", zorder=4)
    axes.set(xscale="log", yscale="log", xlabel=r"$r = (1 + \gamma)/(1 - \gamma)$")
    axes.set_ylabel(r"sensitivity factor $\mathcal{S}$")
    axes.xaxis.set_major_locator(FixedLocator([1, 2, 3, 4, 6, 8]))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())


def _rows(series: dict[float, Sensitivity] | dict[int, Sensitivity], by_size: bool) -> Table:
    """Gamma, N, both values, and (N+1)^3 times the analytical one with its limit."""
    tables = []
    for key, values in series.items():
        fixed = np.full(values.abscissa.size, key)
        N, gamma = (values.abscissa.astype(int), fixed) if by_size else (fixed, values.abscissa)
        limit = np.array([multiple_scales.sensitivity_limit(ALPHA, float(x), 1.0, 1) for x in gamma])
        columns = {"gamma": gamma, "N": N, "numerical": values.numerical, "analytical": values.analytical}
        scaled = (N + 1.0) ** 3 * values.analytical
        tables.append(table(**columns, cube_times_analytical=scaled, cube_limit=limit))
    return stacked(tables)


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
        tables = {"fig4_size": _rows(by_size, True), "fig4_gamma": _rows(by_gamma, False)}
        return finished(figure, (size, gamma, law), 4), tables
