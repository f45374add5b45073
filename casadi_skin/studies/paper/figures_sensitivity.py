"""Figure 4 of the paper: sensitivity of the frequency against N and gamma, and the law in N that holds in the end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

from casadi_skin.bvp.problem import Array
from casadi_skin.figures.profiles import LINES, MARKERS
from casadi_skin.figures.style import blank, colours, finished, style
from casadi_skin.studies.paper.panels import Drawn, stacked
from casadi_skin.studies.paper.paper_data import (
    ALPHA,
    STATED_P,
    STATED_Q,
    PaperData,
    Sensitivity,
    analytical_sensitivity,
)
from casadi_skin.studies.study import letter

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
