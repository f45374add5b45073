"""How analyses are shown: stability along a branch, growth, proofs, searches, kicks, spreading, modes and bands."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.certify.certificate import Certificate, ProvedStability, ProvedStretch
from casadi_skin.dynamics.starts import Spreading
from casadi_skin.follow.family_series import FamilySeries
from casadi_skin.lattice.linear import Bands, LatticeModes
from casadi_skin.model.arguments import with_error
from casadi_skin.points.gradient import Gradient
from casadi_skin.results import words
from casadi_skin.results.figures.bands import draw_bands
from casadi_skin.results.figures.designs import draw_path
from casadi_skin.results.figures.evolutions import sizes_of
from casadi_skin.results.figures.families import draw_series
from casadi_skin.results.figures.multipliers import draw_moduli
from casadi_skin.results.figures.style import AMPLITUDE_LABEL, draw_curves, next_colour, number_sites, plain
from casadi_skin.results.tables import EVENT_COLUMNS, edge_rows, series_columns
from casadi_skin.search.design import Design
from casadi_skin.search.fit import Fit
from casadi_skin.search.kick import SmallestKick
from casadi_skin.search.pareto import ParetoFront
from casadi_skin.stability.growth import TransientGrowth
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.zero.kinds import count_in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes


# Stability along a family, and the growth of perturbations ------------------------------------------------------------


@words.show.register
def _(result: StabilityDiagram) -> words.Shown:
    if result.localised:
        return _localised(result)
    first, last = (result.S(np.array([end]))[0] for end in (result.start, result.end))
    count = count_in_words(len(result.tongues), result.unresolved)
    deepest = max((tongue.growth for tongue in result.tongues), default=0.0)
    rows = [("S", f"{first:.8g} to {last:.8g}")]
    rows += [("changes", words.found([f"{change.S:.8g}" for change in result.changes], result.unresolved))]
    rows += [("tongues", f"{count}, deepest log |multiplier| {deepest:.6g}"), words.stretches(result.unresolved)]

    def draw(axes: Axes) -> None:
        draw_moduli(axes, result, next_colour(axes), "family")
        axes.set(xlabel=AMPLITUDE_LABEL, ylabel=r"largest $|\lambda|$ over a period")

    def columns() -> words.Columns:
        return _edges(result, result.changes, ("mode",))

    return words.Shown("Stability along a family", rows, draw, "changes of stability", columns)


def _localised(result: StabilityDiagram) -> words.Shown:
    rows = [("changes", words.found(words.changes(result.changes), result.unresolved))]
    rows += [("further", words.listed(words.changes(result.further))), words.stretches(result.unresolved)]

    def draw(axes: Axes) -> None:
        for kind in dict.fromkeys(change.kind for change in result.all):
            chosen = [change for change in result.all if change.kind == kind]
            axes.plot([c.S for c in chosen], [c.angle for c in chosen], "o", label=kind)
        axes.set(xlabel=AMPLITUDE_LABEL, ylabel=r"angle of $\lambda$ over half a period", ylim=(-0.1, np.pi + 0.1))

    def columns() -> words.Columns:
        return _edges(result, result.all, ("mode", *(name for name in EVENT_COLUMNS if "tongue" in name)))

    return words.Shown("Localised multipliers along a family", rows, draw, "changes of localised multipliers", columns)


def _edges(result: StabilityDiagram, edges: Sequence[Any], without: Collection[str]) -> words.Columns:
    rows = [*edge_rows(1, result, edges)]
    columns = {name: [row[name] for row in rows] for name in EVENT_COLUMNS if name not in without}
    return {"change": np.arange(1, len(rows) + 1), **columns}


@words.show.register
def _(result: TransientGrowth) -> words.Shown:
    t, largest = result.t, int(np.argmax(result.log10_bounded))
    rows = [("times", f"{t.size}, from 0 to {t[-1]:g}")]
    rows += [("largest bounded", f"10^{result.log10_bounded[largest]:.6g} at t = {t[largest]:.6g}")]
    rows += [("largest of all", f"10^{np.max(result.log10_gain):.6g}")]
    gains = {name: getattr(result, name) for name in ("log10_gain", "log10_bounded", "log10_trivial")}

    def draw(axes: Axes) -> None:
        labels = ("all perturbations", "bounded ones", "trivial pair")
        draw_curves(axes, t, dict(zip(labels, gains.values(), strict=True)), in_cycle=True)
        axes.set(xlabel="time $t$", ylabel=r"$\log_{10}$ of the largest gain", xlim=(t[0], t[-1]))

    meaning = "largest amplification of perturbations against time"
    return words.Shown("Transient growth of perturbations", rows, draw, meaning, lambda: {"t": t, **gains})


@words.show.register
def _(result: FamilySeries) -> words.Shown:
    rows = [(f"order {k}", with_error(float(v), float(result.Omega_error[k]))) for k, v in enumerate(result.Omega[:4])]
    rows += [("digits", f"{result.digits[-1]:.1f} of order {result.order}")]
    rows += [("radius in S", result.radius_in_words)]

    title, meaning = f"Omega of mode {result.mode} in powers of {result.variable}", "power series of a family"
    return words.Shown(title, rows, lambda axes: draw_series(axes, result), meaning, lambda: series_columns(result))


# Proofs ---------------------------------------------------------------------------------------------------------------


@words.show.register
def _(result: Certificate) -> words.Shown:
    c, odd, rows = result.constants, "odd " if result.step == 2 else "", [("S", repr(result.S))]
    if result.proved:
        rows += [("Omega", f"{result.Omega_digits}; computed one within {result.Omega_error:.2g}")]
        rows += [("radius", f"{result.radius:.2g}, alone within {result.uniqueness:.2g}, of norm {result.size:.3g}")]
        rows += [("constants", f"Y = {c.Y:.3g}, Z = {c.Z:.3g}, W = {c.W:.3g}")]
        rows += [("harmonics", f"{result.harmonics} {odd}ones, nu = {result.weight!r}")]
    else:
        rows += [("reason", result.reason)]

    def draw(axes: Axes) -> None:
        if not result.proved:
            raise ValueError("plot: the certificate has no proof; accepted: one with enclosures")
        low, high = result.profile
        positions = np.arange(1, low.size + 1)
        smallest = np.where(low * high > 0.0, np.minimum(np.abs(low), np.abs(high)), 0.0)
        largest = np.maximum(np.abs(low), np.abs(high))
        axes.semilogy(positions, largest, "o", mfc="none", label="$|y_n(0)|$, proved upper bound")
        axes.semilogy(positions, largest - smallest, "_", ms=7, color="0.4", label="width of its enclosure")
        number_sites(axes, 1, low.size, "position $n$")

    def columns() -> words.Columns:
        low, high = result.profile
        return {"position": np.arange(1, low.size + 1), "lower": low, "upper": high}

    title = f"{'P' if result.proved else 'No p'}roof of an orbit"
    return words.Shown(title, rows, draw, "enclosures of displacements", columns)


@words.show.register
def _(result: ProvedStability) -> words.Shown:
    rows = [("S", repr(result.S)), ("verdict", result.verdict)]
    if result.signatures.size:
        plus = int(np.sum(result.signatures > 0))
        rows += [("exponents", f"{result.signatures.size}: {plus} of Krein signature +, the others of -")]
    rows += [("unstable exponent", f"{result.exponent:.6g} +- {result.radius:.2g}")] if result.radius > 0 else []
    rows += [("reason", result.reason)] if result.reason else []

    def draw(axes: Axes) -> None:
        if not result.signatures.size:
            raise ValueError("plot: no exponents are enclosed one by one; accepted: a proof of stability with brackets")
        for sign, mark, label in ((1, "+", "Krein signature $+$"), (-1, "x", "Krein signature $-$")):
            chosen = np.flatnonzero(result.signatures == sign)
            if chosen.size:
                middle, widths = result.brackets[chosen].mean(axis=1), np.ptp(result.brackets[chosen], axis=1)
                look: dict[str, Any] = {"fmt": mark, "ms": 6, "lw": 1.0, "capsize": 2.0, "label": label}
                axes.errorbar(middle, chosen + 1, xerr=0.5 * widths, **look)
        axes.set(xlabel=r"exponent $\sigma$, enclosed", ylabel="number of the exponent")
        axes.set_yticks(range(1, result.signatures.size + 1, 1 + result.signatures.size // 10))

    def columns() -> words.Columns:
        low, high = result.brackets.T
        return {"exponent": np.arange(1, low.size + 1), "lower": low, "upper": high, "signature": result.signatures}

    return words.Shown("Proof of stability", rows, draw, "enclosures of exponents", columns)


@words.show.register
def _(result: ProvedStretch) -> words.Shown:
    ends = np.array([result.S_start, *result.breaks, result.S_end])
    columns = {"piece": np.arange(1, ends.size), "S_start": ends[:-1], "S_end": ends[1:]}
    rows = [("S", f"{result.S_start!r} to {result.S_end!r}"), ("pieces", str(result.pieces))]
    rows += [("radius", f"{result.radius:.2g}")] if np.isfinite(result.radius) else []
    rows += [("reason", result.reason)] if result.reason else []

    def draw(axes: Axes) -> None:
        axes.stairs(np.diff(ends), ends, baseline=None, color="black", lw=1.2, label="length of the proved piece")
        axes.plot(ends[:-1], np.diff(ends), "o", ms=3, color="black")
        axes.set(xlabel=AMPLITUDE_LABEL, ylabel="length in $S$")
        axes.set_ylim(bottom=0.0)

    return words.Shown("Proof that a family is one curve", rows, draw, "proved pieces of a family", lambda: columns)


# Searches and kicks ---------------------------------------------------------------------------------------------------


@words.show.register
def _(result: Design) -> words.Shown:
    which = "largest" if result.maximise else "least"
    rows = [(result.quantity, f"{with_error(result.value, result.error)}, the {which}")]
    rows += [("at", words.named(result.parameters)), ("end", result.reason), ("by", result.engine)]
    held = ", ".join(f"{value:.6g} by {bound}" for bound, value in list(result.multipliers.items())[: words.MOST_NAMED])
    rows += [("derivatives", held)] if held else []
    rows += [("others", words.listed(f"{one.value:.10g}" for one in result.others))] if result.others else []

    table = {"design": np.arange(1, len(result.path) + 1), result.quantity: result.values}
    table |= dict(zip(result.parameters, result.path.T, strict=True))
    return words.Shown("Design", rows, lambda axes: draw_path(axes, result), "the way to a design", lambda: table)


@words.show.register
def _(result: ParetoFront) -> words.Shown:
    both = dict(zip(result.names, result.values.T, strict=True))
    table = {**both, **{name: [point[name] for point in result.points] for name in result.points[0].parameters}}
    rows = [("points", f"{len(result.points)}, and {result.dominated} that others dominate")]
    rows += [(name, words.range_of(values)) for name, values in both.items()]

    def draw(axes: Axes) -> None:
        axes.plot(*result.values.T, "o-", ms=4)
        axes.set(xlabel=plain(result.names[0]), ylabel=plain(result.names[1]))

    return words.Shown("Pareto front", rows, draw, "a Pareto front", lambda: table)


@words.show.register
def _(result: SmallestKick) -> words.Shown:
    sites = np.arange(1, result.displacements.size + 1)
    columns = {"displacement": result.displacements, "velocity": result.velocities}
    rows = [("norm", f"{result.norm:.10g} ({result.norm_name})"), ("escapes", f"at t = {result.escape_time:.6g}")]
    rows += [("linear growth", f"{result.linear_norm:.6g}"), ("far end alone", f"{result.far_end_norm:.6g}")]

    def draw(axes: Axes) -> None:
        for mark, (label, values) in zip(("o-", "s--"), columns.items(), strict=True):
            axes.plot(sites, values, mark, mfc="none", lw=0.8, label=label)
        axes.axhline(0.0, color="0.7", lw=0.7, zorder=0)
        number_sites(axes, 1, sites.size, "site $n$")
        axes.set_ylabel("smallest kick")

    title, table = f"Smallest kick of {words.model_words(result.orbit.model)}", {"site": sites, **columns}
    return words.Shown(title, [*rows, ("status", result.status)], draw, "the smallest kick", lambda: table)


@words.show.register
def _(result: Gradient) -> words.Shown:
    names, slopes, errors = list(result), np.array(list(result.values())), np.array(list(result.errors.values()))
    rows = [(name, with_error(result[name], result.errors[name])) for name in names] + [("held", result.held)]

    def draw(axes: Axes) -> None:
        axes.bar([plain(name) for name in names], slopes, yerr=errors, fill=False)
        axes.axhline(0.0, color="0.7", lw=0.7, zorder=0)
        axes.set(xlabel="parameter", ylabel=f"derivative of {plain(result.of)}")

    table = {"parameter": names, "derivative": slopes, "error": errors}
    return words.Shown(f"Gradient of {result.of}", rows, draw, "derivatives by parameters", lambda: table)


@words.show.register
def _(result: Fit) -> words.Shown:
    names, values, deviations = zip(*result.measured, strict=True)
    rows = [(name, with_error(value, result.deviations[name])) for name, value in result.values.items()]
    rows += [("chi square", f"{result.chi_square:.4g} of {len(names)} residuals"), ("end", result.reason)]
    numbers = np.arange(1, len(names) + 1)

    def draw(axes: Axes) -> None:
        axes.plot(numbers, result.residuals, "o", color="black", ms=4)
        axes.axhspan(-1.0, 1.0, color="0.9", zorder=0)
        axes.set(xlabel="measured quantity", ylabel="located minus measured, over the deviation", xticks=numbers)

    table = {"quantity": list(names), "measured": values, "deviation": deviations, "residual": result.residuals}
    return words.Shown("Fit", rows, draw, "residuals of a fit", lambda: table)


# Lattices: spreading of energy, linear modes, bands -------------------------------------------------------------------


@words.show.register
def _(result: Spreading) -> words.Shown:
    t, numbers = result.t, {"participation": result.participation, "second_moment": result.second_moment}
    centres = {f"centre_{k}": values for k, values in enumerate(result.centre.T, start=1)}
    rows = [words.samples(t)]
    rows += [("participation", f"{result.participation[0]:.4g} to {result.participation[-1]:.4g} sites")]
    rows += [("second moment", f"{result.second_moment[0]:.4g} to {result.second_moment[-1]:.4g}")]

    def draw(axes: Axes) -> None:
        draw_curves(axes, t, sizes_of(result), in_cycle=True)
        axes.set(xlabel="time $t$", xlim=(t[0], t[-1]))
        axes.set_ylim(bottom=0.0)

    title, table = f"Energy over {result.energies.shape[1]} sites in time", {"t": t, "energy": result.total}
    return words.Shown(title, rows, draw, "spreading of the energy", lambda: {**table, **centres, **numbers})


@words.show.register
def _(result: LatticeModes) -> words.Shown:
    omega, ends = result.frequencies, result.frequencies.real[[0, -1]]
    rows = [("frequencies", f"{ends[0]:.8g} to {ends[1]:.8g}" + ("" if result.real else ", some complex"))]
    rows += [("participation", f"{words.range_of(result.participation, 4)} sites")]
    columns = {"omega": omega.real, "growth": omega.imag, "participation": result.participation}

    def draw(axes: Axes) -> None:
        axes.plot(result.participation, omega.real, "o", mfc="none")
        axes.set(xlabel="participation ratio (sites)", ylabel=r"linear frequency $\omega$")

    table = {"mode": np.arange(1, omega.size + 1), **columns}
    return words.Shown(f"Linear modes: {omega.size}", rows, draw, "linear modes", lambda: table)


@words.show.register
def _(result: Bands) -> words.Shown:
    low, high = result.squares.real.min(axis=0), result.squares.real.max(axis=0)
    rows = [("omega^2", words.ranges(zip(low, high, strict=True))), ("gaps", words.ranges(result.gaps))]
    rows += [("|beta|", words.listed([f"{beta:.6g}" for beta in result.beta]))]
    columns = {"point": np.arange(len(result.wave_numbers))}
    columns |= {f"k_{i}": values for i, values in enumerate(result.wave_numbers.T, start=1)}
    columns |= {f"omega2_{i}": values.real for i, values in enumerate(result.squares.T, start=1)}

    def draw(axes: Axes) -> None:
        draw_bands(axes, result)
        axes.set_xlabel(r"wave number $k/\pi$")

    return words.Shown(f"Bands: {low.size}", rows, draw, "bands", lambda: columns)
