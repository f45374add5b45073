"""Analyses in a few words: stability along a branch, growth, proofs, searches, kicks, modes and bands."""

from __future__ import annotations

import numpy as np

from casadi_skin.certify.certificate import Certificate, ProvedStability, ProvedStretch
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.follow.unresolved import count_in_words
from casadi_skin.lattice.linear import Bands, LatticeModes
from casadi_skin.lattice.spreading import Spreading
from casadi_skin.optimise.kick import SmallestKick
from casadi_skin.optimise.optimum import Optimum
from casadi_skin.optimise.search import SearchResult
from casadi_skin.optimise.search_orbit import ParetoFront
from casadi_skin.results.wording import Rows, found, listed, model_name, named, parameter_rows, with_error, words
from casadi_skin.stability.growth import TransientGrowth
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.localised_diagram import LocalisedDiagram


@words.register
def _(result: SpecialPoint) -> tuple[str, Rows]:
    name = result.parameter
    rows = [(name, with_error(result.parameters[name], result.error))]
    rows += parameter_rows({n: value for n, value in result.parameters.items() if n != name})
    rows += [("loses", listed(result.lost))] if result.lost else []
    return f"Special point ({result.kind}) of {model_name(result.solution.model)}", rows


@words.register
def _(result: StabilityDiagram) -> tuple[str, Rows]:
    rows = [("S", f"{result.pieces[0].S(np.array([result.start]))[0]:.8g} to {_last(result):.8g}")]
    rows += [("changes", found([f"{change.S:.8g}" for change in result.changes], result.unresolved))]
    count = count_in_words(len(result.tongues), result.unresolved)
    rows += [("tongues", f"{count}, deepest log |multiplier| {_deepest(result):.6g}")]
    rows += [("unresolved", listed([f"{u.S_start:.6g} to {u.S_end:.6g}" for u in result.unresolved]))]
    return "Stability along a family", rows


@words.register
def _(result: LocalisedDiagram) -> tuple[str, Rows]:
    rows = [("changes", found([f"{change.kind} at {change.S:.8g}" for change in result.changes], result.unresolved))]
    rows += [("further", listed([f"{change.kind} at {change.S:.8g}" for change in result.further]))]
    rows += [("unresolved", listed([f"{u.S_start:.6g} to {u.S_end:.6g}" for u in result.unresolved]))]
    return "Localised multipliers along a family", rows


def _last(diagram: StabilityDiagram) -> float:
    return float(diagram.pieces[-1].S(np.array([diagram.end]))[0])


def _deepest(diagram: StabilityDiagram) -> float:
    return max((tongue.growth for tongue in diagram.tongues), default=0.0)


@words.register
def _(result: TransientGrowth) -> tuple[str, Rows]:
    largest = int(np.argmax(result.log10_bounded))
    rows = [("times", f"{result.t.size}, from 0 to {result.t[-1]:g}")]
    rows += [("largest bounded", f"10^{result.log10_bounded[largest]:.6g} at t = {result.t[largest]:.6g}")]
    rows += [("largest of all", f"10^{np.max(result.log10_gain):.6g}")]
    return "Transient growth of perturbations", rows


@words.register
def _(result: Certificate) -> tuple[str, Rows]:
    if not result.proved:
        return "No proof of an orbit", [("S", repr(result.S)), ("reason", result.reason)]
    c, odd = result.constants, "odd " if result.step == 2 else ""
    rows = [("S", repr(result.S)), ("Omega", f"{result.Omega_digits}; computed one within {result.Omega_error:.2g}")]
    rows += [("radius", f"{result.radius:.2g}, alone within {result.uniqueness:.2g}, of norm {result.size:.3g}")]
    rows += [("constants", f"Y = {c.Y:.3g}, Z = {c.Z:.3g}, W = {c.W:.3g}")]
    return "Proof of an orbit", [*rows, ("harmonics", f"{result.harmonics} {odd}ones, nu = {result.weight!r}")]


@words.register
def _(result: ProvedStability) -> tuple[str, Rows]:
    rows = [("S", repr(result.S)), ("verdict", result.verdict)]
    if result.signatures.size:
        plus = int(np.sum(result.signatures > 0))
        rows += [("exponents", f"{result.signatures.size}: {plus} of Krein signature +, the others of -")]
    rows += [("unstable exponent", f"{result.exponent:.6g} +- {result.radius:.2g}")] if result.radius > 0 else []
    return "Proof of stability", rows + ([("reason", result.reason)] if result.reason else [])


@words.register
def _(result: ProvedStretch) -> tuple[str, Rows]:
    rows = [("S", f"{result.S_start!r} to {result.S_end!r}"), ("pieces", str(result.pieces))]
    rows += [("radius", f"{result.radius:.2g}")] if np.isfinite(result.radius) else []
    return "Proof that a family is one curve", rows + ([("reason", result.reason)] if result.reason else [])


@words.register
def _(result: SearchResult) -> tuple[str, Rows]:
    rows = [(f"optimum {k}", _optimum(optimum)) for k, optimum in enumerate(result.optima[:4], start=1)]
    rows += [("optima", f"{len(result.optima)}, and {len(result.others)} of other families")]
    return f"Search of {model_name(result.model)}", [
        *rows,
        ("starts", str(len(result.outcomes))),
        ("end", result.reason),
    ]


def _optimum(optimum: Optimum) -> str:
    free = dict(list(optimum.parameters.items())[:4])
    return f"objective {optimum.objective:.10g} at {named(free) if free else 'no free number'}"


@words.register
def _(result: ParetoFront) -> tuple[str, Rows]:
    ends = zip(result.names, result.values.min(axis=0), result.values.max(axis=0), strict=True)
    rows = [("points", f"{len(result.points)}, and {result.dominated} that others dominate")]
    return "Pareto front", [*rows, *((name, f"{low:.8g} to {high:.8g}") for name, low, high in ends)]


@words.register
def _(result: SmallestKick) -> tuple[str, Rows]:
    rows = [("norm", f"{result.norm:.10g} ({result.norm_name})"), ("escapes", f"at t = {result.escape_time:.6g}")]
    rows += [("linear growth", f"{result.linear_norm:.6g}"), ("far end alone", f"{result.far_end_norm:.6g}")]
    return f"Smallest kick of {model_name(result.orbit.model)}", [*rows, ("status", result.status)]


@words.register
def _(result: Spreading) -> tuple[str, Rows]:
    rows = [("times", f"{result.t.size}, from {result.t[0]:g} to {result.t[-1]:g}")]
    rows += [("participation", f"{result.participation[0]:.4g} to {result.participation[-1]:.4g} sites")]
    rows += [("second moment", f"{result.second_moment[0]:.4g} to {result.second_moment[-1]:.4g}")]
    return f"Energy over {result.energies.shape[1]} sites in time", rows


@words.register
def _(result: LatticeModes) -> tuple[str, Rows]:
    omega = result.frequencies
    rows = [("frequencies", f"{omega[0].real:.8g} to {omega[-1].real:.8g}" + ("" if result.real else ", some complex"))]
    rows += [("participation", f"{result.participation.min():.4g} to {result.participation.max():.4g} sites")]
    return f"Linear modes: {omega.size}", rows


@words.register
def _(result: Bands) -> tuple[str, Rows]:
    low, high = result.squares.real.min(axis=0), result.squares.real.max(axis=0)
    rows = [("omega^2", listed([f"{a:.6g} to {b:.6g}" for a, b in zip(low, high, strict=True)]))]
    rows += [("gaps", listed([f"{a:.6g} to {b:.6g}" for a, b in result.gaps]))]
    return f"Bands: {low.size}", [*rows, ("|beta|", listed([f"{beta:.6g}" for beta in result.beta]))]
