"""Multipliers and frequencies in physical coordinates, against the same computation in the gauge.

Both sides take the same orbit, the same steps and the same eigenvalue routine; the coordinates alone differ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.results.figures.style import blank, colours, finished, style
from casadi_skin.runs.study import letter
from tests.studies.exact import DOUBLES, Array, CosineEquations, NotSolvedError
from tests.studies.integration import couplings, monodromy_eigenvalues

RELATIVE = 1e-12  # local tolerance of DOP853
HARMONICS = 6  # of the orbits that Newton's method finds
AMPLITUDES = 4  # steps in S to them
GAMMAS = (0.1, 0.25, 0.5, 0.7)
SIZES = (4, 8, 12, 16, 24, 32, 40, 48, 60, 80)
QUICK_SIZES = (4, 12, 24, 48)
AMPLITUDE = 0.05
EPSILON = float(np.finfo(float).eps)
MARKERS = "os^D"
HIGHEST = 1e2
LOWEST = 1e-17  # of the axes, where smaller errors are drawn
PHYSICAL_PANELS = {
    "multiplier": "largest |multiplier| of a stable orbit",
    "frequency": "linear frequencies",
    "orbit": r"$\Omega$ of orbits found from linear modes",
}


@dataclass(frozen=True)
class Comparison:
    """Errors of one chain in physical coordinates and in the gauge, each computed in the same way.

    `multiplier_*`: distance of the largest |multiplier| of a stable orbit from 1; `mu_error` is what the package
    estimates of that orbit. `frequency_*`: largest relative error of a linear frequency. `orbit_*`: the largest
    relative error of Omega of three orbits at the same S, found from computed linear modes (first, middle, last);
    nan where one is not found. `law` is 0.1 eps r^((N-1)/2).
    """

    sites: int
    gamma: float
    S: float
    Omega: float
    law: float
    multiplier_physical: float
    multiplier_gauge: float
    mu_error: float
    frequency_physical: float
    frequency_gauge: float
    orbit_physical: float
    orbit_gauge: float


def compare(sites: int, gamma: float) -> Comparison | None:
    """The comparison for mode 1 with g = -1 at a small S, or None where that orbit is not stable."""
    chain, modes = Chain(sites, 1.0, gamma, -1.0), (1, sites // 2, sites)
    orbits = {mode: _orbit(chain, mode) for mode in modes}
    known = orbits[1].floquet()
    if not known.stable:
        return None
    law = 0.1 * EPSILON * float(np.exp((sites - 1) * np.arctanh(gamma)))
    errors: dict[str, float] = {}
    for label, gauge in (("physical", False), ("gauge", True)):
        below, above = couplings(chain, gauge)
        D = (2.0 + chain.alpha) * np.eye(sites) - below * np.eye(sites, k=-1) - above * np.eye(sites, k=1)
        errors[f"multiplier_{label}"] = _off_the_circle(orbits[1], gauge)
        errors[f"frequency_{label}"] = _frequency_error(D, chain.linear_frequencies())
        errors[f"orbit_{label}"] = float(np.max([_orbit_error(orbits[mode], mode, D, gauge) for mode in modes]))
    return Comparison(sites, gamma, orbits[1].S, orbits[1].Omega, law, mu_error=known.error, **errors)


def _orbit(chain: Chain, mode: int) -> Orbit:
    branch = follow_family(chain, mode, AMPLITUDE, at=(AMPLITUDE,), tolerance=1e-12, corrector="newton")
    orbit: Orbit = branch.at(S=AMPLITUDE)
    return orbit


def _frequency_error(D: Array, exact: Array) -> float:
    """Largest distance of a computed frequency from that of its rank, over the largest frequency."""
    found = np.sqrt(np.linalg.eigvals(D).astype(complex))
    found = found[np.argsort(found.real)]
    return float(np.max(np.abs(found - exact)) / np.max(exact))


def _off_the_circle(orbit: Orbit, gauge: bool) -> float:
    """Distance of the largest |multiplier| from 1, which it is for a stable orbit; the two nearest 1 left out."""
    values = monodromy_eigenvalues(orbit, gauge=gauge, rtol=RELATIVE, atol=RELATIVE)
    rest = values[np.argsort(np.abs(values - 1.0))[2:]]
    return float(abs(np.max(np.abs(rest)) - 1.0))


def _orbit_error(orbit: Orbit, mode: int, D: Array, gauge: bool) -> float:
    """Relative error of Omega of the orbit that Newton's method finds, in steps of S from the computed linear mode."""
    chain, scale = orbit.model, orbit.model.rho if gauge else np.ones(orbit.model.sites)
    values, vectors = np.linalg.eig(D)
    place = int(np.argsort(values.real)[mode - 1])
    shape, Omega = np.real(vectors[:, place]), math.sqrt(abs(values[place].real))
    c = np.outer(shape / np.linalg.norm(scale * shape), np.eye(1, HARMONICS))
    for S in orbit.S * np.linspace(1.0 / AMPLITUDES, 1.0, AMPLITUDES):
        try:
            c, Omega = CosineEquations(chain, S, scale * math.sqrt(S), HARMONICS, DOUBLES).solve(c, Omega)
        except NotSolvedError:
            return math.nan
    return abs(abs(Omega) - orbit.Omega) / orbit.Omega


# The picture ----------------------------------------------------------------------------------------------------------


def physical_figure(compared: Sequence[Comparison]) -> Figure:
    """Errors in physical coordinates against the number of sites, a line a gamma; in the gauge as crosses."""
    with style():
        figure = blank(10.6, 4.1)
        panels = figure.subplots(1, 3, sharey=True)
        for axes, name, panel in zip(panels, PHYSICAL_PANELS, "abc", strict=True):
            _draw_errors(axes, compared, name)
            letter(axes, panel, PHYSICAL_PANELS[name])
        panels[0].set_ylabel("error")
        return finished(figure, panels, 3)


def _draw_errors(axes: Axes, compared: Sequence[Comparison], name: str) -> None:
    gammas = sorted({c.gamma for c in compared})
    for gamma, colour, marker in zip(gammas, colours(len(gammas)), MARKERS * len(gammas), strict=False):
        of_gamma = [c for c in compared if c.gamma == gamma]
        sites = [c.sites for c in of_gamma]
        physical = [_drawn(getattr(c, f"{name}_physical")) for c in of_gamma]
        gauge = [_drawn(getattr(c, f"{name}_gauge")) for c in of_gamma]
        label = rf"physical, $\gamma = {gamma:g}$"
        axes.plot(sites, physical, marker=marker, color=colour, ms=4.5, lw=1.0, label=label, zorder=3)
        axes.plot(sites, gauge, "+", color="black", ms=6, label="gauge", zorder=4)
        if name != "orbit":
            n = np.linspace(min(sites), max(sites), 100)
            law = 0.1 * EPSILON * np.exp((n - 1) * np.arctanh(gamma))
            label = r"$0.1\,\varepsilon\, r^{(N-1)/2}$" if gamma == gammas[-1] else "_"
            axes.plot(n, law, ":", color=colour, lw=1.0, label=label)
    axes.set(yscale="log", ylim=(LOWEST / 2.0, HIGHEST), xlabel="sites $N$", yticks=10.0 ** np.arange(-16, 3, 4))


def _drawn(error: float) -> float:
    """An error within the axes; where there is no result, at the upper edge."""
    return min(max(error, LOWEST), HIGHEST) if not math.isnan(error) else HIGHEST
