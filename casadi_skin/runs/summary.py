"""Summary of a run on standard output."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.certify.certificate import STABLE, UNDECIDED, UNSTABLE
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.space import EQUILIBRIA, FAMILY, ORBITS
from casadi_skin.results.quantities import certified, places_of
from casadi_skin.results.tables import UNRESOLVED
from casadi_skin.runs.output import print_table
from casadi_skin.runs.parts import mode_of
from casadi_skin.zero.kinds import count_in_words

if TYPE_CHECKING:
    from casadi_skin.runs.run import Run


def print_summary(run: Run) -> None:
    """A table of the families, or of the points of another branch that a reader looks for; and where results are."""
    branches = [branch for branch in run.branches if len(branch)]
    families = not run.branches or run.branches[0].space.connects == FAMILY
    if run.branches and families:
        stability = ["max |multiplier|", "changes"] if run.request.scene.stability is not None else []
        columns = ["mode", "points", "S", "Omega", "its error", *stability, "seconds"]
        print_table(run.request.scene.title, columns, _family_rows(run))
        for lines in (_thresholds(run.branches), _stability(branches), _proofs(branches), _offshoots(run)):
            for line in lines:
                print(line)
    elif branches:
        columns, rows = (_diagram if run.request.scene.has_diagram else _points)(run, branches)
        print_table(run.request.scene.title or run.request.ode.name, columns, rows)
        if not run.request.scene.has_diagram and branches[0].with_events and len(branches[0]) > 1:
            print("changes of stability were sought where neighbouring points differ; others may lie between points")
    for task in run.tasks:
        print(*task.words(), sep="\n")
    print(f"{'' if families else _counted(branches) + '; '}results in {run.directory}")


def _counted(branches: Sequence[Branch]) -> str:
    points = sum(len(branch) for branch in branches)
    return f"{points} point{'' if points == 1 else 's'}"


# Families -------------------------------------------------------------------------------------------------------------


def _family_rows(run: Run) -> Iterator[list[str]]:
    """A row a family; the largest modulus of a multiplier is that of orbits, and in the tongues between them."""
    for branch, seconds in zip(run.branches, [*run.seconds, 0.0], strict=False):
        cells = [str(mode_of(branch)), str(len(branch))]
        if not len(branch):
            yield cells
            continue
        last = branch.orbits[-1]
        cells += [f"{last.S:.6g}", f"{last.Omega:.10g}", f"{max(o.Omega_error for o in branch.orbits):.1e}"]
        if branch.with_stability:
            tongues = () if branch.stability_diagram is None else branch.stability_diagram.tongues
            largest = max([float(branch.max_abs_multiplier.max()), *(tongue.max_abs_multiplier for tongue in tongues)])
            known = count_in_words(len(branch.changes), branch.unresolved) if branch.with_events else ""
            cells += [f"{largest:.8g}", known or "not sought"]
        yield [*cells, f"{seconds:.2f}"]


def _thresholds(branches: Sequence[Branch]) -> Iterator[str]:
    for branch in branches:
        if branch.threshold is not None:
            words = f"end breather of the infinite chain born at S_c = {branch.threshold:.10g}"
            yield f"mode {mode_of(branch)}: {words}"


def _stability(branches: Sequence[Branch]) -> Iterator[str]:
    """Stability beyond the columns: unresolved stretches, and changes that were not sought."""
    computed = [branch for branch in branches if branch.with_stability]
    if any(not branch.with_events for branch in computed):
        yield "changes of stability between points were not sought"
    for branch in computed:
        for stretch in branch.unresolved:
            where = f"from S = {stretch.S_start:.6g} to {stretch.S_end:.6g}"
            yield f"mode {mode_of(branch)}: changes of stability are not known {where}: {stretch.reason}"
        for point in branch.not_located if "_sought" in vars(branch) else ():
            yield f"mode {mode_of(branch)}: not located: {point}"
        for passed in (branch.passed_resonances or ()) if branch.with_events else ():
            yield f"mode {mode_of(branch)}: {passed}"


def _proofs(branches: Sequence[Branch]) -> Iterator[str]:
    """Number of orbits that are proved to exist, the accuracy of Omega that this proves, and their stability."""
    for branch in branches:
        asked, mode, space = certified(branch), f"mode {mode_of(branch)}", branch.space
        if not asked:
            continue
        proved = [orbit.certificate for orbit in asked if orbit.certificate.proved]
        width = max((c.Omega[1] - c.Omega[0] for c in proved), default=0.0)
        words = f"; Omega enclosed to {width:.1e}, orbits to {max(c.radius for c in proved):.1e}" if proved else ""
        yield f"{mode}: {len(proved)} of {len(asked)} orbits proved to exist{words}"
        if space.request.certify == "all":
            try:
                yield f"{mode}: {branch.certify(0.0, float(branch.S[-1]))!r}"
            except ValueError as error:
                yield f"{mode}: not proved to be one curve: {error}"
        if branch.with_stability:
            verdicts = [orbit.proved_stability.verdict for orbit in asked]
            counts = ", ".join(f"{verdicts.count(v)} {v}" for v in (STABLE, UNSTABLE, UNDECIDED))
            yield f"{mode}: proved stability: {counts}"


def _offshoots(run: Run) -> Iterator[str]:
    """Branches and curves followed from families."""
    found = run.offshoots
    if found.leaving:
        points = _counted([branch for _, branch in found.leaving])
        yield f"branches that leave: {len(found.leaving)}, with {points}"
    if found.edges:
        yield f"edges of tongues: {len(found.edges)}, with {sum(len(curve) for *_, curve in found.edges)} points"


# Other branches -------------------------------------------------------------------------------------------------------


def _diagram(run: Run, branches: Sequence[Branch]) -> tuple[list[str], Iterator[list[str]]]:
    """A row for the first and the last point of each branch, and for special points."""
    table = run.request.scene.continuation
    asked = () if table is None else (table.parameter, *([] if table.curve is None else [table.curve.parameter]))
    names = [name for name in asked if branches[0].parameter]
    contents = {FAMILY: "cycles", ORBITS: "cycles", EQUILIBRIA: "equilibria"}

    def rows() -> Iterator[list[str]]:
        for number, branch in enumerate(branches, start=1):
            first, last = branch.solutions[0], branch.solutions[-1]
            what = "curve" if branch.space.kind else contents.get(first.space.connects, "solutions")
            ends = [("start", first.parameters, "", _stable(branch, 0))]
            ends += [("end", last.parameters, "", _stable(branch, -1))] if len(branch) > 1 else []
            special = [
                (point.kind, point.parameters, f"{point.error:.1e}", point.criticality if point.has_criticality else "")
                for point in branch.special_points
            ]
            unresolved = [
                (UNRESOLVED, {**first.parameters, branch.parameter: stretch.start},
                 f"{abs(stretch.end - stretch.start):.1e}", stretch.kind)
                for stretch in branch.passed_over
            ]  # fmt: skip
            for kind, values, error, words in (ends[0], *special, *unresolved, *ends[1:]):
                yield [f"{number}: {what}", kind, *(f"{values[name]:.10g}" for name in names), error, words]

    return ["branch", "", *names, "its error", ""], rows()


def _stable(branch: Branch, place: int) -> str:
    if not branch.with_stability:
        return ""
    return "stable" if branch.solutions[place].stable else "unstable"


def _points(run: Run, branches: Sequence[Branch]) -> tuple[list[str], Iterator[list[str]]]:
    """A row for the first and the last point, requested points, and folds."""
    branch = branches[0]
    first = branch.solutions[0]
    columns = ["point", "", *([branch.parameter] if branch.parameter else [])]
    columns += ["period"] if first.is_orbit else []
    columns += [f"largest {first.space.state_names[0]}", "its error", *(["max |mult.|"] * branch.with_stability)]

    def rows() -> Iterator[list[str]]:
        for place in places_of(branch):
            solution: Any = place.solution
            last = place.index == len(branch) - 1
            marks = {"start": place.index == 0, "asked for": place.requested, place.special: place.special, "end": last}
            words = [word for word, holds in marks.items() if holds and word]
            if not words:
                continue
            row = [str(place.index), ", ".join(words) if len(branch) > 1 else "alone"]
            row += [f"{solution.parameters[branch.parameter]:.8g}"] if branch.parameter else []
            row += [f"{solution.period:.10g}"] if solution.is_orbit else []
            row += [f"{place.extremes[1][0]:.8g}", f"{solution.error:.1e}"]
            if branch.with_stability:
                moduli = np.abs(place.floquet.others)
                row.append(f"{moduli.max():.6g}" if moduli.size else "")
            yield row

    return columns, rows()
