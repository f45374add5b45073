"""Summary of a run on standard output."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.certify.certificate import STABLE, UNDECIDED, UNSTABLE
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.space import EQUILIBRIA, FAMILY, ORBITS
from casadi_skin.results.quantities import certified, places_of
from casadi_skin.results.tables import UNRESOLVED
from casadi_skin.runs.output import print_table
from casadi_skin.runs.parts import is_orbit, mode_of
from casadi_skin.zero.kinds import count_in_words

if TYPE_CHECKING:
    from casadi_skin.runs.run import Run


def print_summary(run: Run) -> None:
    """A table of the families, or of the points of another branch that a reader looks for; and where results are."""
    branches = [branch for branch in run.branches if len(branch)]
    if run.branches:
        _print_branches(run, branches)
    for task in run.tasks:
        print(*task.words(), sep="\n")
    families = not run.branches or run.branches[0].space.connects == FAMILY
    print(f"{'' if families else _counted(branches) + '; '}results in {run.directory}")


def _print_branches(run: Run, branches: list[Branch]) -> None:
    """The table of branches, and what it does not show."""
    if run.branches[0].space.connects == FAMILY:
        stability = ["max |multiplier|", "changes"] if run.request.scene.stability is not None else []
        columns = ["mode", "points", "S", "Omega", "its error", *stability, "seconds"]
        print_table(run.request.scene.title, columns, _family_rows(run))
        _print_thresholds(run.branches)
        _print_stability(branches)
        _print_proofs(branches)
        _print_offshoots(run)
    elif branches and run.request.scene.has_diagram:
        _print_diagram(run, branches)
    elif branches:
        _print_points(run, branches[0])
        if branches[0].with_events and len(branches[0]) > 1:
            print("changes of stability were sought where neighbouring points differ; others may lie between points")


def _print_offshoots(run: Run) -> None:
    """Branches and curves followed from families."""
    found = run.offshoots
    if found.leaving:
        points = _counted([branch for _, branch in found.leaving])
        print(f"branches that leave: {len(found.leaving)}, with {points}")
    if found.edges:
        print(f"edges of tongues: {len(found.edges)}, with {sum(len(curve) for *_, curve in found.edges)} points")


def _counted(branches: list[Branch]) -> str:
    points = sum(len(branch) for branch in branches)
    return f"{points} point{'' if points == 1 else 's'}"


def _family_rows(run: Run) -> Iterator[list[str]]:
    """A row a family."""
    for branch, seconds in zip(run.branches, [*run.seconds, 0.0], strict=False):
        cells = [str(mode_of(branch)), str(len(branch))]
        if not len(branch):
            yield cells
            continue
        last = branch.orbits[-1]
        cells += [f"{last.S:.6g}", f"{last.Omega:.10g}", f"{max(o.Omega_error for o in branch.orbits):.1e}"]
        if branch.with_stability:
            known = count_in_words(len(branch.changes), branch.unresolved) if branch.with_events else ""
            cells += [f"{_largest_multiplier(branch):.8g}", known or "not sought"]
        yield [*cells, f"{seconds:.2f}"]


def _largest_multiplier(branch: Branch) -> float:
    """Largest |multiplier| of the orbits, and in the tongues between them where these were sought."""
    tongues = () if branch.stability_diagram is None else branch.stability_diagram.tongues
    return max([float(branch.max_abs_multiplier.max()), *(tongue.max_abs_multiplier for tongue in tongues)])


def _print_thresholds(branches: list[Branch]) -> None:
    for branch in branches:
        if branch.threshold is not None:
            words = f"end breather of the infinite chain born at S_c = {branch.threshold:.10g}"
            print(f"mode {mode_of(branch)}: {words}")


def _print_diagram(run: Run, branches: list[Branch]) -> None:
    """A row for the first and the last point of each branch, and for special points."""
    table = run.request.scene.continuation
    asked = () if table is None else (table.parameter, *([] if table.curve is None else [table.curve.parameter]))
    names = [name for name in asked if branches[0].parameter]
    rows = [
        [f"{number}: {what}", kind, *(f"{values[name]:.10g}" for name in names), error, words]
        for number, branch in enumerate(branches, start=1)
        for what in [_contents(branch)]
        for kind, values, error, words in _diagram_points(branch)
    ]
    print_table(run.request.scene.title or run.request.ode.name, ["branch", "", *names, "its error", ""], rows)


def _contents(branch: Branch) -> str:
    """What the solutions of a branch are."""
    if branch.space.kind:
        return "curve"
    kinds = {FAMILY: "cycles", ORBITS: "cycles", EQUILIBRIA: "equilibria"}
    return kinds.get(branch.solutions[0].space.connects, "solutions")


def _diagram_points(branch: Branch) -> Iterator[tuple[str, Mapping[str, float], str, str]]:
    """What a point is, its parameters, its error, and more words."""
    first, last = branch.solutions[0], branch.solutions[-1]
    yield "start", first.parameters, "", _stability(branch, 0)
    for point in branch.special_points:
        yield point.kind, point.parameters, f"{point.error:.1e}", point.criticality if point.has_criticality else ""
    for stretch in branch.passed_over:
        width = f"{abs(stretch.end - stretch.start):.1e}"
        yield UNRESOLVED, {**first.parameters, branch.parameter: stretch.start}, width, stretch.kind
    if len(branch) > 1:
        yield "end", last.parameters, "", _stability(branch, -1)


def _stability(branch: Branch, place: int) -> str:
    if not branch.with_stability:
        return ""
    return "stable" if branch.solutions[place].stable else "unstable"


def _print_stability(branches: list[Branch]) -> None:
    """Stability of families beyond the columns: unresolved stretches, and changes that were not sought."""
    computed = [branch for branch in branches if branch.with_stability]
    if any(not branch.with_events for branch in computed):
        print("changes of stability between points were not sought")
    for branch in computed:
        for stretch in branch.unresolved:
            where = f"from S = {stretch.S_start:.6g} to {stretch.S_end:.6g}"
            print(f"mode {mode_of(branch)}: changes of stability are not known {where}: {stretch.reason}")
        for point in branch.not_located if "_sought" in vars(branch) else ():
            print(f"mode {mode_of(branch)}: not located: {point}")
        for passed in (branch.passed_resonances or ()) if branch.with_events else ():
            print(f"mode {mode_of(branch)}: {passed}")


def _print_proofs(branches: list[Branch]) -> None:
    """Number of orbits that are proved to exist, and the accuracy of Omega that this proves."""
    for branch in branches:
        asked = certified(branch)
        proved = [orbit.certificate for orbit in asked if orbit.certificate.proved]
        if asked:
            width = max((c.Omega[1] - c.Omega[0] for c in proved), default=0.0)
            words = f"; Omega enclosed to {width:.1e}, orbits to {max(c.radius for c in proved):.1e}" if proved else ""
            print(f"mode {mode_of(branch)}: {len(proved)} of {len(asked)} orbits proved to exist{words}")
        space: Any = branch.space
        if asked and space.connects == FAMILY and space.request.certify == "all":
            print(f"mode {mode_of(branch)}: {_proved_curve(branch)}")
        if asked and branch.with_stability:
            verdicts = [orbit.proved_stability.verdict for orbit in asked]
            counts = ", ".join(f"{verdicts.count(v)} {v}" for v in (STABLE, UNSTABLE, UNDECIDED))
            print(f"mode {mode_of(branch)}: proved stability: {counts}")


def _proved_curve(branch: Branch) -> str:
    """The part of a family that is proved to be one curve from its linear mode."""
    try:
        return repr(branch.certify(0.0, float(branch.S[-1])))
    except ValueError as error:
        return f"not proved to be one curve: {error}"


def _print_points(run: Run, branch: Branch) -> None:
    """A row for the first and the last point, requested points, and folds."""
    first = branch.solutions[0]
    columns = ["point", "", *([branch.parameter] if branch.parameter else [])]
    columns += ["period"] if is_orbit(first) else []
    columns += [f"largest {first.space.state_names[0]}", "its error", *(["max |mult.|"] * branch.with_stability)]
    print_table(run.request.scene.title or run.request.ode.name, columns, _point_rows(branch))


def _point_rows(branch: Branch) -> Iterator[list[str]]:
    for place in places_of(branch):
        solution: Any = place.solution
        last = place.index == len(branch) - 1
        marks = {"start": place.index == 0, "asked for": place.requested, place.special: place.special, "end": last}
        words = [word for word, holds in marks.items() if holds and word]
        if not words:
            continue
        row = [str(place.index), ", ".join(words) if len(branch) > 1 else "alone"]
        row += [f"{solution.parameters[branch.parameter]:.8g}"] if branch.parameter else []
        row += [f"{solution.period:.10g}"] if is_orbit(solution) else []
        row += [f"{place.extremes[1][0]:.8g}", f"{solution.error:.1e}"]
        if branch.with_stability:
            moduli = np.abs(place.floquet.others)
            row.append(f"{moduli.max():.6g}" if moduli.size else "")
        yield row
