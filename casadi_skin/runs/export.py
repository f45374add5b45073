"""The exports of a run: C code in DIR/export and an FMU of its model, or of one of its orbits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from casadi_skin.export.c_code import export_c
from casadi_skin.fmu.archive import export_fmu
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.long_lattice import LongLattice
from casadi_skin.model.ode import OdeModel
from casadi_skin.runs.directory import EXPORT
from casadi_skin.runs.request import Request
from casadi_skin.runs.task_tables import ExportTable
from casadi_skin.runs.writing import mode_of


def export_scene(request: Request, branches: Sequence[Branch], directory: Path) -> tuple[Path, ...]:
    """Write the exports of a scene, and return their place; those of a resumed run are kept.

    Raises ValueError where the branch does not reach S or a part cannot be exported, ArithmeticError where no orbit is
    found.
    """
    export = _table(request)
    target, written = directory / EXPORT, []
    of = exported(request, branches)
    if export.c is not None:
        if not (target.exists() and any(target.iterdir())):  # it is written whole or not at all
            export_c(of, target, None if export.c == "all" else export.c)
        written.append(target)
    if export.fmu is not None:
        target = directory / export.fmu
        written.append(export_fmu(of, target, export.fmi, tolerance=request.tolerance, inputs=export.inputs))
    return tuple(written)


def exported(request: Request, branches: Sequence[Branch]) -> Chain | OdeModel | Orbit:
    """The model, the orbit at S where its family first passes it, or the last orbit of another branch."""
    export = _table(request)
    if export.S is not None:
        found = [branch for branch in branches if export.mode in (None, mode_of(branch))]
        if not found:
            raise ValueError(f"mode {export.mode}: its family was not computed")
        orbit: Orbit = found[0].at(S=export.S)
        return orbit
    if request.scene.orbit is not None and branches:
        return branches[0].orbits[-1]
    assert not isinstance(request.model, LongLattice)
    return request.model


def plan_export(request: Request) -> list[tuple[str, str]]:
    """Pairs (subject, text) that describe the export."""
    export, of = _table(request), "the chain" if isinstance(request.model, Chain) else "the model"
    if export.S is not None:
        of = f"the orbit j = {export.mode or request.families[0].mode}, S = {export.S:g}"
    elif request.scene.orbit is not None:
        of = "the last orbit"
    lines = []
    if export.c is not None:
        parts = "all parts that need libm only" if export.c == "all" else ", ".join(export.c)
        lines.append(("export", f"C code of {of} in {EXPORT}/: {parts}"))
    if export.fmu is not None:
        lines.append(("export", f"FMU of {of} in {export.fmu}: FMI {export.fmi}, Model Exchange and Co-Simulation"))
    return lines


def _table(request: Request) -> ExportTable:
    if request.scene.export is None:
        raise ValueError("scene: given one without [export]; accepted: one with it")
    return request.scene.export
