"""Words for results: their title and rows of a name and a value, which modules register by class."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import singledispatch
from typing import Any

import numpy as np

from casadi_skin.certify.certificate import Certificate, ProvedStability, ProvedStretch
from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.dynamics.starts import Spreading
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.lattice.linear import Bands, LatticeModes
from casadi_skin.model.arguments import cut
from casadi_skin.optimise.kick import SmallestKick
from casadi_skin.optimise.optimum import Optimum
from casadi_skin.optimise.search import SearchResult
from casadi_skin.optimise.search_orbit import ParetoFront
from casadi_skin.points.diagram import Diagram
from casadi_skin.points.edge_curve import EdgeCurve
from casadi_skin.stability.growth import TransientGrowth
from casadi_skin.stability.localised import LocalisedFloquet
from casadi_skin.stability.result import Floquet
from casadi_skin.stability.tongues.diagram import LocalisedDiagram, StabilityDiagram
from casadi_skin.zero.statics import Spectrum
from casadi_skin.zero.unresolved import count_in_words

MOST = 6  # special points, parameters or states that are named
Rows = list[tuple[str, str]]


@singledispatch
def words(result: Any) -> tuple[str, Rows]:
    """Title of a result, and its rows; raises TypeError for other objects."""
    raise TypeError(f"no result: {type(result).__name__}")


def model_name(model: Any) -> str:
    """A model in a few words."""
    return str(model.name) if hasattr(model, "name") else repr(model)


def with_error(value: float, error: float) -> str:
    """A number with its error."""
    return f"{value:.12g} +- {error:.1e}"


def parameter_rows(values: Mapping[str, float]) -> Rows:
    """The row of parameters; none where there are none."""
    shown = {name: value for name, value in values.items() if name != "period"}
    return [("parameters", named(shown))] if shown else []


def named(values: Mapping[str, float]) -> str:
    """Values by name, the first of many."""
    return listed([f"{name} = {value:.8g}" for name, value in values.items()])


def found(entries: Sequence[str], unresolved: Collection[object]) -> str:
    """What is found on a branch, one after the other: with its count as the least where something is unresolved."""
    if not unresolved:
        return listed(entries)
    return f"{count_in_words(len(entries), unresolved)}: {listed(entries)}" if entries else "none found; see unresolved"


def listed(items: Any) -> str:
    """Items, the first of many, and how many there are."""
    texts = [str(item) for item in items]
    more = f", ... ({len(texts)} in all)" if len(texts) > MOST else ""
    return (", ".join(texts[:MOST]) + more) or "none"


def complex_words(value: complex) -> str:
    """A complex number in six digits."""
    return f"{value.real:.6g}" if value.imag == 0 else f"{value.real:.6g}{value.imag:+.6g}i"


# Orbits, equilibria, branches, multipliers and evolutions in a few words ----------------------------------------------


@words.register
def _(result: Orbit) -> tuple[str, Rows]:
    family, known = isinstance(result.space, Family), result.known_floquet or vars(result).get("_floquet")
    rows = [("S", f"{result.S:.10g}"), ("Omega", with_error(result.Omega, result.Omega_error))] if family else []
    rows += [("period", with_error(result.period, result.period_error)), *parameter_rows(result.parameters)]
    rows += [("error", f"{result.profile_error:.1e}, relative, of the state")]
    rows += [("stability", _stability(known) if known is not None else "not computed; see floquet()")]
    return f"Orbit of {model_name(result.model)}", rows


@words.register
def _(result: Equilibrium) -> tuple[str, Rows]:
    states = named(dict(zip(result.space.state_names, result.positions.tolist(), strict=True)))
    stable = "stable" if result.stable else f"unstable: {result.unstable} eigenvalues with a positive real part"
    rows = [("state", states), *parameter_rows(result.parameters), ("error", f"{result.error:.1e}, relative")]
    return f"Equilibrium of {model_name(result.model)}", [*rows, ("stability", stable)]


@words.register
def _(result: Solution) -> tuple[str, Rows]:
    start, end = result.interval
    rows = [("interval", f"{start:g} to {end:g}, {result.intervals} intervals"), *parameter_rows(result.parameters)]
    if result.optimum is not None:
        rows.append(("objective", f"{result.objective:.10g}: {result.status}"))
    return f"Solution of {model_name(result.model)}", [*rows, ("error", f"{result.error:.1e}, relative")]


@words.register
def _(result: Branch) -> tuple[str, Rows]:
    values, name = result.values if result.parameter else np.zeros(0), result.parameter or "alone"
    kind = type(result.solutions[0]).__name__.lower() if result.solutions else "solution"
    plural = {"orbit": "orbits", "equilibrium": "equilibria"}.get(kind, "solutions")
    what = "family of orbits" if isinstance(result.space, Family) else f"branch of {plural}"
    rows = [("points", str(len(result)))]
    if values.size:
        rows.append((name, f"{values[0]:.8g} to {values[-1]:.8g}, within {values.min():.8g} to {values.max():.8g}"))
    if result.with_stability and not result.space.stability_included:
        stable = int(np.count_nonzero(result.stable))
        rows.append(("stable", f"{stable} of {len(result)} points"))
        known = result.with_events and result.changes_known
        changes = found([f"{c.value:.8g}" for c in result.changes], result.unresolved) if known else ""
        rows += [("changes of stability", changes)] if known else []
    elif result.solutions and not result.space.stability_included and result.space.closes:
        rows.append(("stability", "not computed; stability=True in follow computes it"))
    special = result.special_points if result.space.locates_folds else ()
    if special:
        rows.append(("special points", listed([f"{p.kind} at {p.parameters[p.parameter]:.8g}" for p in special])))
    left = result.known_unresolved
    rows += [("unresolved", listed([str(stretch) for stretch in left]))] if left else []
    missing = result.not_located if "_sought" in vars(result) else ()
    rows += [("not located", listed([str(point) for point in missing]))] if missing else []
    return f"{what.capitalize()} of {model_name(result.space.model)}", [*rows, ("end", result.reason)]


@words.register
def _(result: Diagram) -> tuple[str, Rows]:
    special = [f"{p.kind} at {p.parameters[p.parameter]:.8g}" for p in result.special_points]
    rows = [("branches", str(len(result))), ("points", str(sum(len(branch) for branch in result)))]
    rows += [("special points", listed(special)), ("not started", listed(result.failures))]
    return f"Diagram of {model_name(result.branches[0].space.model)} in {result.branches[0].parameter}", rows


@words.register
def _(result: EdgeCurve) -> tuple[str, Rows]:
    rows = [("points", str(len(result))), ("kind", result.kind)]
    for name, values in ((result.parameter, result[result.parameter]), ("S", result.S)):
        rows.append((name, f"{values[0]:.8g} to {values[-1]:.8g}, within {values.min():.8g} to {values.max():.8g}"))
    rows += [("error of S", f"up to {np.max(result.errors):.1e}"), ("end", result.reason)]
    return f"Edge of a tongue of {model_name(result.points[0].orbit.model)}", rows


@words.register
def _(result: Floquet) -> tuple[str, Rows]:
    largest = listed([complex_words(value) for value in sorted(result.others, key=abs, reverse=True)])
    rows = [("multipliers", f"{result.multipliers.size}, {result.trivial} of them trivial"), ("largest", largest)]
    if isinstance(result, LocalisedFloquet):
        rows[0] = ("localised", f"{result.mu.size} pairs beside the trivial one, on {result.sites} sites at the edge")
        rows += _of_waves(result)
    return "Floquet multipliers", [*rows, ("error", f"{result.error:.1e}"), ("stability", _stability(result))]


def _of_waves(result: LocalisedFloquet) -> Rows:
    """Arcs of the continuous spectrum, their overlaps, and pairs that depend on the number of sites."""
    arcs = listed([f"{start:.6g} to {end:.6g}" for start, end in result.continuous.arcs])
    overlaps = listed([f"{o.angles[0]:.6g} to {o.angles[1]:.6g}" for o in result.continuous.overlaps])
    rows = [("waves", f"arcs of the circle, omega T from {arcs}"), ("they overlap", f"at omega T from {overlaps}")]
    if result.continuous.overlaps == ():
        rows[1] = ("they overlap", "nowhere with those of opposite signature")
    count = f"{result.finite_size.size} pairs off the circle, up to {result.finite_size_modulus:.6g}"
    rows.append(("finite-size", f"{count}; they depend on the number of sites"))
    if result.unresolved.size:
        rows.append(("undecided", f"{result.unresolved.size} pairs; more stability_sites decide"))
    if result.counted is None:
        rows.append(("not counted", f"stability is that of the cut problem of {result.sites} sites"))
    elif result.counted != result.listed:
        words = f"{result.counted} outside the circle, {result.listed} in the list"
        words += ": too weakly localised to be resolved by the cut"
        rows.append(("counted", words))
    return rows


@words.register
def _(result: Spectrum) -> tuple[str, Rows]:
    rows = [("eigenvalues", listed([complex_words(value) for value in result.values]))]
    rows += [("error", f"{np.max(result.errors):.1e}"), ("stability", "stable" if result.stable else "unstable")]
    return "Eigenvalues of the linearisation", rows


@words.register
def _(result: Evolution) -> tuple[str, Rows]:
    rows = [("times", f"{result.t.size}, from {result.t[0]:g} to {result.t[-1]:g}"), ("states", listed(result.names))]
    rows += [*parameter_rows(result.parameters), ("method", f"{result.method}, tolerance {result.tolerance:.1e}")]
    return f"Time evolution of {model_name(result.model)}", rows


def _stability(floquet: Floquet) -> str:
    if floquet.stable:
        return "stable"
    outside = f"{floquet.unstable_real} real and {floquet.unstable_complex} complex multipliers outside"
    if floquet.max_abs_multiplier == 1.0:  # the cut of a tail does not resolve them
        return f"unstable: {outside}"
    return f"unstable: {outside}, largest modulus {floquet.max_abs_multiplier:.8g}"


# Analyses in a few words: stability along a branch, growth, proofs, searches, kicks, modes and bands ------------------


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


# Any result in a few words, as lines for print ------------------------------------------------------------------------

LONGEST = 100  # characters of a value


def described(result: Any) -> tuple[str, Rows]:
    """Title of a result, and its rows, each value cut to a line; raises TypeError for other objects."""
    head, rows = words(result)
    return head, [(name, cut(value, LONGEST)) for name, value in rows]


def lines(result: Any) -> str:
    """A result in a few lines."""
    head, rows = described(result)
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join([head, *(f"  {name:<{width}}  {value}" for name, value in rows)])
