"""The plan of a map: the number of cells, the cost of one (measured now) and of all."""

from __future__ import annotations

from pathlib import Path

from casadi_skin.runs.map_cell import Computer, Job
from casadi_skin.runs.map_drive import duration
from casadi_skin.runs.map_grid import Grid, plain
from casadi_skin.runs.map_lines import check_boundary
from casadi_skin.runs.map_store import check_quantities
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import Scene

SHORT = 5.0  # seconds of a first cell, imports among them, below which it is measured again


def map_lines(scene: Scene, request: Request, path: Path) -> list[tuple[str, str]]:
    """Pairs (subject, text) that describe the map of a scene; raises SceneError for one that cannot be meant."""
    grid, table = Grid.of(scene), scene.map
    check_quantities(request, grid)
    check_boundary(scene, grid)
    assert table is not None
    cells = grid.coarsest
    family = grid.family(int(cells[len(cells) // 2]))
    (middle,), tasks = grid.tasks(family), len(cells) // len(family)
    computer = Computer(Job(plain(scene), str(path.resolve()), table.growth))
    result = computer.compute(middle)
    if result.seconds < SHORT:
        result = computer.compute(middle)
    sizes = " x ".join(f"{len(range(0, len(axis.values), axis.stride))} {axis.name}" for axis in grid.axes)
    families = f", orbits of {tasks} families" if grid.amplitude is not None else ""
    finest = (
        f"; refined where {', '.join(table.watch or ('stable', 'end'))} change, to {grid.size}" if grid.refined else ""
    )
    lines = [
        ("map", ", ".join(_axis_words(grid, i) for i in range(len(grid.axes)))),
        ("cells", f"{sizes} = {cells.size}{families}{finest}"),
    ]
    one, all_of_them = result.seconds / len(middle.cells), result.seconds * tasks
    failed = f"; it failed: {result.reason}" if result.kind else ""
    words = (
        f"{duration(one)} for one (measured on {grid.name(middle.cells[0])}{failed}); {duration(all_of_them)} for all"
    )
    more = ", more where cells are refined" if grid.refined else ""
    limit = f"; at most {duration(table.cell_limit)} a cell" if table.cell_limit is not None else ""
    unused = [f"[{name}]" for name in ("spectrum", "dynamics", "export") if getattr(scene, name) is not None]
    if unused:
        lines.append(("not in cells", f"{', '.join(unused)}, films and pictures of single cells"))
    return [*lines, ("cost of cells", f"{words} with one worker{more}{limit}")]


def _axis_words(grid: Grid, place: int) -> str:
    axis = grid.axes[place]
    first, last = axis.values[0], axis.values[-1]
    if not axis.numeric:
        shown = [str(value) for value in axis.values]
        return f"{axis.name} = {', '.join(shown if len(shown) < 8 else [*shown[:3], '...', shown[-1]])}"
    return f"{axis.name} from {first:g} to {last:g}{' in equal ratios' if axis.log else ''}"
