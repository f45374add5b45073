"""What a scene wants out of Python, in a run: C code in DIR/export and an FMU of the chain, or of one of its orbits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from casadi_skin.export.c_code import export_c
from casadi_skin.export.fmu import export_fmu
from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.runs.directory import EXPORT
from casadi_skin.runs.request import scene_chain
from casadi_skin.scene import ExportTable, Scene


def export_scene(scene: Scene, branches: Sequence[Branch], directory: Path) -> tuple[Path, ...]:
    """Write what the scene's [export] asks for, and return where it is; what a resumed run has is kept.

    Raises ValueError where the branch does not reach S or a part cannot be exported, ArithmeticError where no orbit is
    found.
    """
    export = _table(scene)
    target, written = directory / EXPORT, []
    if export.c is not None:
        if not (target.exists() and any(target.iterdir())):  # it is written whole or not at all
            export_c(exported(scene, branches), target, None if export.c == "all" else export.c)
        written.append(target)
    if export.fmu is not None:
        tolerance = scene.accuracy.relative_tolerance
        of = exported(scene, branches)
        written.append(export_fmu(of, directory / export.fmu, export.fmi, tolerance=tolerance))
    return tuple(written)


def exported(scene: Scene, branches: Sequence[Branch]) -> Chain | Orbit:
    """The chain, or the orbit at S where its branch first passes it; raises as `export_scene` does."""
    export = _table(scene)
    if export.S is None:
        return scene_chain(scene)
    found = [branch for branch in branches if export.mode in (None, branch.space.coordinates.mode_number)]
    if not found:
        raise ValueError(f"mode {export.mode}: its family was not computed")
    return found[0].at(export.S)


def plan_export(scene: Scene) -> list[tuple[str, str]]:
    """Pairs (subject, text) that tell what is exported."""
    export = _table(scene)
    of = "the chain"
    if export.S is not None:
        assert scene.family is not None
        mode = export.mode or scene.family.modes(scene.chain.sites)[0]
        of = f"the orbit j = {mode}, S = {export.S:g}"
    lines = []
    if export.c is not None:
        parts = "all parts that need libm only" if export.c == "all" else ", ".join(export.c)
        lines.append(("export", f"C code of {of} in {EXPORT}/: {parts}"))
    if export.fmu is not None:
        lines.append(("export", f"FMU of {of} in {export.fmu}: FMI {export.fmi}, Model Exchange and Co-Simulation"))
    return lines


def _table(scene: Scene) -> ExportTable:
    if scene.export is None:
        raise ValueError("scene: given one without [export]; accepted: one with it")
    return scene.export
