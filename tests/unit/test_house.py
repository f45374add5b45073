"""The structure of the package: no circle of modules, and rooms that import from below alone."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "casadi_skin"
FLOORS = (  # from the ground up; rooms of one floor may import from each other
    {"_version"},
    {"model", "native"},
    {"zero"},
    {"lattice", "solve"},
    {"stability"},
    {"follow"},
    {"points", "dynamics"},
    {"certify", "search"},
    {"export", "fmu"},
    {"results"},
    {"runs"},
    {"__main__"},
)


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in PACKAGE.rglob("*.py")}


def imported(path: Path) -> Iterator[str]:
    """Modules of the package that a module imports, also within functions and for types alone."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("casadi_skin"):
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in MODULES else str(node.module)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.startswith("casadi_skin."))


# The package itself names verbs by strings, which it looks up when they are called: nothing below it does.
GRAPH = {name: set(imported(path)) - {name, "casadi_skin"} for name, path in MODULES.items() if name != "casadi_skin"}


def test_no_modules_import_each_other_in_a_circle() -> None:
    TopologicalSorter(GRAPH).prepare()  # raises CycleError, which names the circle


def test_rooms_import_from_below() -> None:
    floor = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
    rooms = {(one.split(".")[1], other.split(".")[1]) for one, others in GRAPH.items() for other in others}
    assert not {(one, other) for one, other in rooms if floor[other] > floor[one]}
