"""Recommendations in words, computed from the measurements of a work-precision study."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby

from casadi_skin.studies.work_precision.reference import TIGHTEST, Errors
from casadi_skin.studies.work_precision.settings import (
    SHOOTING_SITES,
    SMALLEST,
    FamilyCase,
    Kind,
    Measured,
    bounded,
    front_of,
)

Quantity = tuple[str, Kind, str]  # its name, the settings that compute it, and the attribute with its true error
OMEGA: Quantity = ("Omega", Kind.ORBITS, "Omega_error")
PROFILE: Quantity = ("the profile", Kind.ORBITS, "profile_error")
MU: Quantity = ("mu", Kind.FLOW, "mu_error")
IDLE = 0.95  # share of the processor below which a machine counts as busy
SINGLE_RUN, SEVERAL_RUNS = 1.5, 1.1  # factor between times, of one run or medians, that means something
TABLE_TOLERANCES = (1e-4, 1e-8, 1e-12)


def duration(seconds: float) -> str:
    """A time with about three digits and its unit."""
    milliseconds = 1e3 * seconds
    if seconds >= 1.0:
        return f"{seconds:.2f} s"
    return f"{milliseconds:.0f} ms" if milliseconds >= 100.0 else f"{milliseconds:.3g} ms"


def fastest(measured: Iterable[Measured], wanted: float, error: str) -> Measured | None:
    """The fastest whose tolerance promises the wanted error and whose true error keeps it, or None."""
    kept = [m for m in measured if m.setting.tolerance <= 1.001 * wanted and getattr(m, error) <= wanted]
    return min(kept, key=lambda m: m.seconds, default=None)


def distinguished(faster: Measured, slower: Measured) -> bool:
    """Whether the times differ by more than noise, and the median is below all of the other's."""
    noise = SINGLE_RUN if slower.seconds_min == slower.seconds_max else SEVERAL_RUNS
    return faster.seconds < slower.seconds_min and noise * faster.seconds < slower.seconds


def advice(measured: Sequence[Measured], wanted: float, quantity: Quantity) -> str:
    """The setting to use for a quantity to a wanted error, and how much faster that is than the next method."""
    _, kind, error = quantity
    settings = [m for m in measured if m.setting.kind is kind]
    best = fastest(settings, wanted, error)
    if best is None:
        return "no setting measured here promises and keeps it"
    words = f"{best.setting.method} at tolerance {best.setting.tolerance:.0e}, {duration(best.seconds)}"
    following = fastest([m for m in settings if m.setting.method != best.setting.method], wanted, error)
    if following is None:
        return f"{words}; no other method reaches it"
    name = f"{following.setting.method} ({duration(following.seconds)})"
    if not distinguished(best, following):
        return f"{words}; not distinguished by these times from {name}"
    return f"{words}; {following.seconds / best.seconds:.2g} times faster than the next, {name}"


def advices(measured: Sequence[Measured], tolerances: Sequence[float]) -> list[str]:
    """A line for each quantity and errors with the same advice; Omega and the profile as one where theirs agree."""
    names = [OMEGA, PROFILE, *([MU] if any(m.setting.kind is Kind.FLOW for m in measured) else [])]
    texts = {quantity[0]: [advice(measured, wanted, quantity) for wanted in tolerances] for quantity in names}
    if texts["Omega"] == texts["the profile"]:
        texts = {"Omega and the profile": texts.pop("Omega"), **texts}
        del texts["the profile"]
    lines = []
    for what, each in texts.items():
        for text, group in groupby(zip(tolerances, each, strict=True), key=lambda pair: pair[1]):
            wanted = [f"{tolerance:.0e}" for tolerance, _ in group]
            span = wanted[0] if len(wanted) == 1 else f"{wanted[0]} and down to {wanted[-1]}"
            lines.append(f"For {what} to {span}: {text}.")
    return lines


def promised(measured: Sequence[Measured]) -> list[float]:
    """The tolerances of the methods measured, descending."""
    return sorted({m.setting.tolerance for m in measured if m.setting.kind is not Kind.PRESET}, reverse=True)


def by_transcription(measured: Sequence[Measured], wanted: float) -> str:
    """The fastest orbits of each transcription to a wanted error of Omega and profile."""
    orbits = [m for m in measured if m.setting.kind is Kind.ORBITS]
    found = []
    for name in dict.fromkeys(m.setting.transcription for m in orbits):
        best = fastest([m for m in orbits if m.setting.transcription == name], wanted, "orbit_error")
        found.append(f"{name} {duration(best.seconds) if best else 'does not keep it'}")
    return f"Orbits to {wanted:.0e}, the fastest of each transcription: {', '.join(found)}."


def front_words(measured: Sequence[Measured], kind: Kind, known: float) -> str:
    """The methods of the Pareto front by rising time."""
    front, settings = front_of(measured, kind, known), sum(m.setting.kind is kind for m in measured)
    if not front:
        return ""
    parts = []
    for method, group in groupby(front, key=lambda m: m.setting.method):
        points = [f"{m.error:.1e} in {duration(m.seconds)}" for m in group]
        parts.append(f"{method} " + (f"from {points[0]} to {points[-1]}" if len(points) > 1 else f"at {points[0]}"))
    what = "orbits" if kind is Kind.ORBITS else "multipliers"
    return f"The Pareto front of {what}, {len(front)} of {settings} settings: {'; '.join(parts)}."


def preset_words(preset: Measured, measured: Sequence[Measured]) -> str:
    """The cost of a preset, its true errors, and how much faster other settings are."""
    name, tolerance = preset.setting.name, preset.setting.tolerance
    if preset.failure:
        return f"`{name}` ({tolerance:.0e}): {preset.failure}."
    errors = [f"Omega {preset.Omega_error:.1e}", f"profile {preset.profile_error:.1e}"]
    if preset.mu_error == preset.mu_error:
        errors.append(f"mu {preset.mu_error:.1e}")
    kept = "kept" if preset.error <= tolerance else f"missed by a factor {preset.error / tolerance:.2g}"
    words = f"`{name}` ({tolerance:.0e}): {duration(preset.seconds)} with multipliers and {preset.points} points; true "
    words += f"errors {', '.join(errors)}; the tolerance is {kept}."
    orbits = [m for m in measured if m.setting.kind is Kind.ORBITS]
    default = preset.setting.orbit_methods
    same = next((m for m in orbits if m.setting.method == default and m.setting.tolerance == tolerance), None)
    best = fastest(orbits, tolerance, "orbit_error")
    if same is None or best is None or same.failure:
        return words
    words += f" Its orbits alone take {duration(same.seconds)}"
    if best.setting.method == default or not distinguished(best, same):
        return f"{words}; nothing measured here is faster and keeps the tolerance."
    return (
        f"{words}, {same.seconds / best.seconds:.2g} times as long as the fastest that keeps the tolerance: "
        f"{best.setting.method}, {duration(best.seconds)}."
    )


def broken_promises(measured: Sequence[Measured]) -> list[str]:
    """Settings whose true error is above their tolerance, and those that failed, each a line."""
    lines = []
    for m in measured:
        where = f"{m.setting.method}, tolerance {m.setting.tolerance:.0e}"
        if m.failure:
            lines.append(f"{where}: no result: {m.failure}.")
        elif m.error > m.setting.tolerance and not m.at_reference_round_off:
            said = "the program says so" if m.told else "the program does not say so"
            lines.append(f"{where}: true error {m.error:.1e}, {m.error / m.setting.tolerance:.2g} times that; {said}.")
    return lines


def busy(measured: Sequence[Measured]) -> str:
    """A sentence where other work kept the process from a processor for more than a little of the time."""
    timed = [m for m in measured if m.processor_share == m.processor_share]
    share = sum(m.processor_share * m.seconds for m in timed) / (sum(m.seconds for m in timed) or 1.0)
    if not timed or share > IDLE:
        return ""
    return f" The machine was busy: the process had a processor for {share:.0%} of the time that passed."


def table(measured: Sequence[Measured], tolerances: Sequence[float]) -> list[str]:
    """Lines of a table in Markdown: settings at the tolerances."""
    heads = ["method", "tolerance", "time (least to most)", "building", "peak memory", "unknowns"]
    heads += ["error of Omega", "profile", "mu"]
    lines = [f"| {' | '.join(heads)} |", "| --- |" + " ---: |" * (len(heads) - 1)]
    for m in measured:
        if not any(abs(m.setting.tolerance / t - 1.0) < 1e-9 for t in tolerances) or m.failure:
            continue
        name = f"preset {m.setting.name}" if m.setting.kind is Kind.PRESET else m.setting.method
        name = f"flow {name}" if m.setting.kind is Kind.FLOW else name
        spread = duration(m.seconds)
        if m.seconds_min < m.seconds_max:
            spread += f" ({duration(m.seconds_min)} to {duration(m.seconds_max)})"
        memory = f"{m.memory_MB:.0f} MB" if m.memory_MB == m.memory_MB else ""
        errors = [_error(value) for value in (m.Omega_error, m.profile_error, m.mu_error)]
        mark = "*" if m.at_reference_round_off else ""
        cells = (
            f"{name}{mark}",
            f"{m.setting.tolerance:.0e}",
            spread,
            duration(m.building_seconds),
            memory,
            f"{m.unknowns}",
        )
        lines.append(f"| {' | '.join((*cells, *errors))} |")
    return lines


def _error(value: float) -> str:
    return "" if value != value else f"{value:.1e}"


def recommendations(
    family: FamilyCase, measured: Sequence[Measured], known: Errors, baseline: float, repeats: int
) -> str:
    """The whole page as Markdown: measurements, recommendations, places of the presets, and the table."""
    chain = family.chain
    tolerances = promised(measured)
    fronts = (front_words(measured, kind, bounded(kind, *known)) for kind in (Kind.ORBITS, Kind.FLOW))
    shared = [t for t in TABLE_TOLERANCES if any(abs(t / other - 1.0) < 1e-9 for other in tolerances)]
    mu = f", and their mu to {known.mu:.1e}" if known.mu == known.mu else ""
    text = (
        f"Family j = {family.mode} of the chain N = {chain.sites}, alpha = {chain.alpha:g}, gamma = {chain.gamma:g}, "
        f"g = {chain.g:g} to S = {family.amplitude_max:g}; errors are true, relative, the largest at S = "
        f"{', '.join(f'{S:.6g}' for S in family.at)}, against orbits and mu in long double. With these, orbits by "
        f"collocation to {TIGHTEST:.0e} agree to {max(known.Omega, SMALLEST):.1e} of Omega and {known.profile:.1e} of "
        f"the profile{mu}; settings as good as that are marked *. Processor times: medians "
        f"of {repeats} run{'s' if repeats > 1 else ''} after a first one, whose surplus is the building; of flows, for "
        f"the multipliers of all these orbits. The mu of orbits are those that collocation finds along them. Peak "
        f"memory is that of a process of its own, {baseline:.0f} MB of which it takes to start; of flows, with the "
        f"family.{busy(measured)}"
    )
    sections = {
        "What to use": advices(measured, tolerances) + [by_transcription(measured, t) for t in shared],
        "Where the presets sit": [preset_words(m, measured) for m in measured if m.setting.kind is Kind.PRESET],
        "Pareto fronts": [words for words in fronts if words],
        "Not kept": broken_promises(measured),
    }
    parts = ["# What accuracy costs", text]
    parts += [f"## {name}\n\n" + "\n".join(f"- {line}" for line in lines) for name, lines in sections.items() if lines]
    if family.shooting_left_out:
        reason = f"the chain has {chain.sites} sites, and it is measured up to {SHOOTING_SITES}"
        parts.append(
            f"Shooting is left out: {reason}, since it integrates the sensitivity of every state to every one."
        )
    parts.append("## Measured\n\n" + "\n".join(table(measured, TABLE_TOLERANCES)))
    return "\n\n".join(parts) + "\n"
