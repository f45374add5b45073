"""The axes of a map: what they may be together, their values, and where these go in a scene."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from casadi_skin.model.arguments import cut, did_you_mean, nearest
from casadi_skin.runs.rules import SceneError, refusal, toml_repr
from casadi_skin.runs.scene import OPTIONS, ChainTable, RangeTable, Scene

ACCEPTED_AXES = "a table { from, to, points }, or a list of values"
AMPLITUDE = ("family", "S")  # the orbit at an amplitude: cells that differ by it alone are orbits of one family
MAPPED_TASKS = ("family", "equilibrium", "orbit", "solution", "search")  # the tasks of cells
TOGETHER_SEPARATOR = ","  # between the names of parameters that one axis moves
MOST_CELLS = 10_000_000  # of a map at its finest: an index of them is kept in memory
Path = tuple[str, ...]


# Axes with their values -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Axis:
    """An axis of a map.

    Attributes:
        name: as [map] calls it.
        paths: where its values go in a scene; several where it moves several parameters.
        values: at its finest; of several parameters in words.
        given: values for the scene, one for each path; empty where these are the values.
        stride: values from one of the coarsest to the next.
        numeric: whether it is a range, along which pictures are drawn.
        log: whether its values have equal ratios.
    """

    name: str
    paths: tuple[Path, ...]
    values: tuple[Any, ...]
    stride: int = 1
    numeric: bool = False
    log: bool = False
    given: tuple[tuple[Any, ...], ...] = ()

    @property
    def names(self) -> list[str]:
        """Names of its parameters."""
        return [name.strip() for name in self.name.split(TOGETHER_SEPARATOR)] if self.given else [self.name]

    @property
    def worded(self) -> bool:
        """Whether some of its values are words."""
        return any(isinstance(value, str) for value in self.values)

    def settings(self, place: int) -> list[tuple[Path, Any]]:
        """The path of the value at a place, and the value."""
        return list(zip(self.paths, self.given[place] if self.given else (self.values[place],), strict=True))


def check_map(scene: Scene) -> None:
    """Raises SceneError for axes that cannot be meant."""
    table = scene.map
    if table is None:
        return
    if not scene.given(*MAPPED_TASKS):
        accepted = "beside [family], [equilibrium], [orbit], [solution] or [search]"
        raise refusal("[map]", "with a scene that asks for no solution", accepted)
    if not table.axes:
        raise SceneError(f"[map]: no axis; accepted: a parameter of the scene with {ACCEPTED_AXES}")
    axes_of(scene)
    if table.growth and scene.stability is None:
        raise refusal("[map] growth", f"{table.growth!r} without [stability]", "beside [stability]")
    if scene.sites == math.inf and (table.growth or table.boundary):
        name = "growth" if table.growth else "boundary"
        accepted = "with a whole number of sites: an infinite chain has no tongues to be followed"
        raise refusal(f"[map] {name}", "with sites = inf", accepted)


def axes_of(scene: Scene) -> tuple[Axis, ...]:
    """The axes of a scene with a [map]; raises SceneError for those that cannot be meant."""
    given: Mapping[str, Any] = {} if scene.map is None else scene.map.axes
    ranges: dict[str, RangeTable] = {name: axis for name, axis in given.items() if not isinstance(axis, tuple)}
    if len(ranges) > 2:
        raise refusal(f"[map] {list(ranges)[2]}", "a third range", "one or two ranges, and lists beside them")
    seen, size, resolved = dict[Path, str](), 1, any(axis.resolution for axis in ranges.values())
    for name, axis in sorted(given.items(), key=lambda item: item[0] not in ranges):
        if name in ranges:
            _check_range(name, axis)
        else:
            _check_list(name, axis)
        size *= (axis.points - 1) * _stride(axis) + 1 if name in ranges else len(axis)
    for name in given:
        for path in paths_of(scene, name):
            if path in seen:
                raise refusal(f"[map] {cut(name)}", f"the same parameter as {cut(seen[path])}", "each parameter once")
            seen[path] = name
    if size > MOST_CELLS:
        finest = " at its finest" if resolved else ""
        raise refusal("[map]", f"more than {MOST_CELLS} cells{finest}", f"at most {MOST_CELLS}")
    return tuple(_axis(name, paths_of(scene, name), axis, name in ranges) for name, axis in given.items())


def _axis(name: str, paths: tuple[Path, ...], axis: Any, is_range: bool) -> Axis:
    if is_range:
        return Axis(name, paths, _values(axis), _stride(axis), True, axis.log)
    words = tuple(f"({', '.join(map(str, value))})" for value in axis) if len(paths) > 1 else ()
    return Axis(name, paths, words or axis, given=axis if words else ())


def _check_range(name: str, axis: RangeTable) -> None:
    place = f"[map] {cut(name)}"
    if TOGETHER_SEPARATOR in name:
        raise refusal(place, "a range for several parameters", "a list of lists")
    if axis.start == axis.to:
        raise refusal(f"{place}, to", f"{axis.to!r}, where it starts", "another number")
    if not math.isfinite(axis.to - axis.start):
        raise refusal(f"{place}, to", f"{axis.to!r}, farther from {axis.start!r} than numbers reach", "a nearer one")
    if axis.log and not (axis.start > 0 and axis.to > 0):
        raise refusal(f"{place}, log", f"true from {axis.start!r} to {axis.to!r}", "with numbers > 0")
    if axis.resolution is not None and axis.log and axis.resolution <= 1:
        raise refusal(f"{place}, resolution", repr(axis.resolution), "with log = true a ratio > 1")


def _check_list(name: str, axis: tuple[object, ...]) -> None:
    place, count = f"[map] {cut(name)}", len(name.split(TOGETHER_SEPARATOR))
    for i, value in enumerate(axis):
        if (len(value) if isinstance(value, tuple) else 1) != count:
            accepted = f"a list of {count} values in each" if count > 1 else "numbers or names"
            plain = list(value) if isinstance(value, tuple) else value
            raise refusal(place, f"{toml_repr(plain)} as item {i + 1}", accepted)
        if value in axis[:i]:
            raise refusal(place, f"{toml_repr(value)} as item {i + 1} again", "each value once")


def _values(axis: RangeTable) -> tuple[Any, ...]:
    """All values of a range at its finest."""
    count, difference = (axis.points - 1) * _stride(axis), axis.to - axis.start
    whole = isinstance(axis.start, int) and isinstance(axis.to, int) and not axis.log
    if whole and difference % count == 0:
        return (*range(int(axis.start), int(axis.to), int(difference) // count), axis.to)
    ratio = axis.to / axis.start if axis.log else 1.0
    between = (
        axis.start * ratio ** (k / count) if axis.log else axis.start + difference * (k / count)
        for k in range(1, count)
    )
    return (float(axis.start), *map(float, between), float(axis.to))


def _stride(axis: RangeTable) -> int:
    """Values of a range at its finest from one of its coarsest to the next; no more than those of too many cells."""
    stride = 1
    if axis.resolution is not None:
        length = abs(math.log(axis.to / axis.start)) if axis.log else abs(axis.to - axis.start)
        finest = math.log(axis.resolution) if axis.log else axis.resolution
        while length / ((axis.points - 1) * stride) > finest * (1 + 1e-12) and stride <= MOST_CELLS:
            stride *= 2
    return stride


# Where values go in a scene -------------------------------------------------------------------------------------------


def paths_of(scene: Scene, name: str) -> tuple[Path, ...]:
    """Targets of the values of an axis: one place, or one for each of the parameters that a name holds."""
    found = tuple(path_of(scene, part.strip()) for part in name.split(TOGETHER_SEPARATOR))
    if len(found) > 1 and AMPLITUDE in found:
        raise refusal(f"[map] {cut(name)}", "S among several", "S alone, or amplitude_max")
    return found


def path_of(scene: Scene, name: str) -> Path:
    """Keys, from the table on, of the parameter of a scene that an axis names; raises SceneError for an unknown one.

    A name is that of a parameter of the model, of `mode`, `S` or `seed`, or TABLE.KEY, such as "continuation.to".
    """
    parts = tuple(name.split("."))
    if len(parts) > 1:
        if not all(parts) or parts[0] == "map" or parts[0] not in Scene.__struct_encode_fields__:
            raise refusal(f"[map] {cut(name)}", "no key of the scene", "TABLE.KEY")
        return parts
    known = _named_paths(scene)
    if name in known:
        return known[name]
    if scene.model is not None:  # which names it has shows with the model alone
        return "model", "parameters", name
    near = nearest(name, (*known, *OPTIONS))
    words = f"{', '.join(known)}, or TABLE.KEY; options: {', '.join(OPTIONS)}"
    raise SceneError(f"[map] {cut(name)}: neither a parameter of the scene nor an option; {did_you_mean(near, words)}")


def _named_paths(scene: Scene) -> dict[str, Path]:
    found: dict[str, Path] = {}
    if scene.chain is not None:
        found = {key: ("chain", key) for key in ChainTable.__struct_encode_fields__}
        found["N"] = ("chain", "sites")
    if scene.lattice is not None:
        found |= {key: ("lattice", "parameters", key) for key in scene.lattice.parameters}
        found.setdefault("cells", ("lattice", "cells"))
    if scene.family is not None:
        found |= {"mode": ("family", "mode"), "S": AMPLITUDE, "amplitude_max": ("family", "amplitude_max")}
    if scene.search is not None:
        found |= {"mode": ("search", "mode"), "S": ("search", "S")}
    drawn = {} if scene.lattice is None else scene.lattice.parameters
    seeds: list[Path] = [("lattice", "parameters", name, "seed") for name, v in drawn.items() if hasattr(v, "seed")]
    seeds += [("search", "seed")] if scene.search is not None else []
    seeds += [("dynamics", "seed")] if scene.dynamics is not None and scene.dynamics.seed is not None else []
    if len(seeds) == 1:
        found.setdefault("seed", seeds[0])
    return found


def set_value(raw: dict[str, Any], path: Path, value: object) -> None:
    """Put a value into the tables of a scene, which are changed; tables on the way are made."""
    *tables, key = path
    for name in tables:
        inner = raw.get(name)
        raw[name] = dict(inner) if isinstance(inner, Mapping) else {}
        raw = raw[name]
    raw[key] = value
