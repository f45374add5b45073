"""Orbits, equilibria, branches, multipliers and evolutions in a few words."""

from __future__ import annotations

import numpy as np

from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Equilibrium, Solution
from casadi_skin.points.diagram import Diagram
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.results.wording import (
    Rows,
    complex_words,
    found,
    listed,
    model_name,
    named,
    parameter_rows,
    with_error,
    words,
)
from casadi_skin.stability.localised import LocalisedFloquet
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.statics import Spectrum


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
    elif result.solutions and not result.space.stability_included and getattr(result.space, "closes", True):
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
