"""Analyses drawn into axes: stability along a branch, growth, proofs, searches, kicks, modes and bands."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.certify.certificate import Certificate, ProvedStability, ProvedStretch
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.lattice.linear import Bands, LatticeModes
from casadi_skin.lattice.spreading import Spreading
from casadi_skin.optimise.kick import SmallestKick
from casadi_skin.optimise.search import SearchResult
from casadi_skin.optimise.search_orbit import ParetoFront
from casadi_skin.results.figures.drawing import draw, legend_once
from casadi_skin.results.figures.search import draw_starts
from casadi_skin.results.figures.style import AMPLITUDE, DASHES, number_sites, plain
from casadi_skin.results.figures.tongues import draw_moduli
from casadi_skin.stability.growth import TransientGrowth
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.localised_diagram import LocalisedDiagram

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes


@draw.register(SpecialPoint)
def _(result: SpecialPoint, axes: Axes, states: Sequence[str] | None = None) -> None:
    options = {} if states is None else {"states": states}
    draw(result.solution, axes, **options)


@draw.register(StabilityDiagram)
def _(result: StabilityDiagram, axes: Axes) -> None:
    colour = axes._get_lines.get_next_color()  # type: ignore[attr-defined]
    draw_moduli(axes, result, colour, "family")
    axes.set(xlabel=AMPLITUDE, ylabel=r"largest $|\lambda|$ over a period")
    legend_once(axes)


@draw.register(LocalisedDiagram)
def _(result: LocalisedDiagram, axes: Axes) -> None:
    for kind in dict.fromkeys(change.kind for change in result.all):
        chosen = [change for change in result.all if change.kind == kind]
        axes.plot([c.S for c in chosen], [c.angle for c in chosen], "o", label=kind)
    axes.set(xlabel=AMPLITUDE, ylabel=r"angle of $\lambda$ over half a period", ylim=(-0.1, np.pi + 0.1))
    legend_once(axes)


@draw.register(TransientGrowth)
def _(result: TransientGrowth, axes: Axes) -> None:
    lines = (("all perturbations", result.log10_gain), ("bounded ones", result.log10_bounded),
             ("trivial pair", result.log10_trivial))  # fmt: skip
    for dashes, (label, values) in zip(DASHES, lines, strict=False):
        axes.plot(result.t, values, ls=dashes, label=label)
    axes.set(xlabel="time $t$", ylabel=r"$\log_{10}$ of the largest gain", xlim=(result.t[0], result.t[-1]))
    legend_once(axes)


@draw.register(Certificate)
def _(result: Certificate, axes: Axes) -> None:
    if not result.proved:
        raise ValueError("plot: the certificate has no proof; accepted: one with enclosures")
    low, high = result.profile
    positions = np.arange(1, low.size + 1)
    smallest = np.where(low * high > 0.0, np.minimum(np.abs(low), np.abs(high)), 0.0)
    largest = np.maximum(np.abs(low), np.abs(high))
    axes.semilogy(positions, largest, "o", mfc="none", label="$|y_n(0)|$, proved upper bound")
    axes.semilogy(positions, largest - smallest, "_", ms=7, color="0.4", label="width of its enclosure")
    number_sites(axes, 1, low.size, "position $n$")
    legend_once(axes)


@draw.register(ProvedStability)
def _(result: ProvedStability, axes: Axes) -> None:
    if not result.signatures.size:
        raise ValueError("plot: no exponents are enclosed one by one; accepted: a proof of stability with brackets")
    for sign, mark, label in ((1, "+", "Krein signature $+$"), (-1, "x", "Krein signature $-$")):
        chosen = np.flatnonzero(result.signatures == sign)
        if not chosen.size:
            continue
        axes.errorbar(
            result.brackets[chosen].mean(axis=1), chosen + 1, xerr=0.5 * np.ptp(result.brackets[chosen], axis=1),
            fmt=mark, ms=6, lw=1.0, capsize=2.0, label=label,
        )  # fmt: skip
    axes.set(xlabel=r"exponent $\sigma$, enclosed", ylabel="number of the exponent")
    axes.set_yticks(range(1, result.signatures.size + 1, 1 + result.signatures.size // 10))
    legend_once(axes)


@draw.register(ProvedStretch)
def _(result: ProvedStretch, axes: Axes) -> None:
    ends = np.array([result.S_start, *result.breaks, result.S_end])
    axes.stairs(np.diff(ends), ends, baseline=None, color="black", lw=1.2, label="length of the proved piece")
    axes.plot(ends[:-1], np.diff(ends), "o", ms=3, color="black")
    axes.set(xlabel=AMPLITUDE, ylabel="length in $S$")
    axes.set_ylim(bottom=0.0)
    legend_once(axes)


@draw.register(SearchResult)
def _(result: SearchResult, axes: Axes) -> None:
    draw_starts(axes, result, "objective")
    legend_once(axes)


@draw.register(ParetoFront)
def _(result: ParetoFront, axes: Axes) -> None:
    axes.plot(*result.values.T, "o-", ms=4)
    axes.set(xlabel=plain(result.names[0]), ylabel=plain(result.names[1]))


@draw.register(SmallestKick)
def _(result: SmallestKick, axes: Axes) -> None:
    sites = np.arange(1, result.displacements.size + 1)
    for mark, label, values in (("o-", "displacement", result.displacements), ("s--", "velocity", result.velocities)):
        axes.plot(sites, values, mark, mfc="none", lw=0.8, label=label)
    axes.axhline(0.0, color="0.7", lw=0.7, zorder=0)
    number_sites(axes, 1, sites.size, "site $n$")
    axes.set_ylabel("smallest kick")
    legend_once(axes)


@draw.register(Spreading)
def _(result: Spreading, axes: Axes) -> None:
    axes.plot(result.t, result.participation, label="participation number (sites)")
    axes.plot(result.t, result.second_moment, ls=DASHES[1], label="second moment (cells squared)")
    axes.set(xlabel="time $t$", xlim=(result.t[0], result.t[-1]))
    axes.set_ylim(bottom=0.0)
    legend_once(axes)


@draw.register(LatticeModes)
def _(result: LatticeModes, axes: Axes) -> None:
    axes.plot(result.participation, result.frequencies.real, "o", mfc="none")
    axes.set(xlabel="participation ratio (sites)", ylabel=r"linear frequency $\omega$")


@draw.register(Bands)
def _(result: Bands, axes: Axes) -> None:
    along = result.wave_numbers[:, 0] / np.pi
    if result.wave_numbers.shape[1] == 2:
        along = np.linspace(0.0, 3.0, len(along))
        axes.set_xticks(range(4), [r"$\Gamma$", "X", "M", r"$\Gamma$"])
    axes.plot(along, np.sqrt(np.maximum(result.squares.real, 0.0)), color="black")
    axes.set(xlabel=r"wave number $k/\pi$", ylabel=r"linear frequency $\omega$")
