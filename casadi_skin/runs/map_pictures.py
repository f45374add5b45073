"""Pictures of a map: a quantity each, over the axes that are ranges; other axes have a panel a value."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import check_name, cut, short_repr
from casadi_skin.results.figures.map import MapAxis, Panel, draw_map, map_figure, panel_title
from casadi_skin.results.figures.style import save
from casadi_skin.results.words import listed
from casadi_skin.runs.map_grid import Axis
from casadi_skin.runs.map_result import Map
from casadi_skin.runs.map_store import ENDED, UNKNOWN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEFT_OUT = ("points", "at_round_off", "residual", "profile_error", "S_error", "intervals")


def drawn_names(found: Map) -> list[str]:
    """Quantities with a picture: numbers that change over the map, but for error bars."""
    names = []
    for name in found.names:
        if name not in found.columns.numbers:
            continue
        values = found.columns.numbers[name][found.store.states != UNKNOWN]
        known = values[np.isfinite(values)]
        changes = known.size < values.size or float(np.ptp(known)) > 0.0
        if changes and not name.endswith("_error") and name not in LEFT_OUT:
            names.append(name)
    return names


def write_pictures(found: Map) -> None:
    """Draw each quantity as map_NAME."""
    for name in drawn_names(found):
        safe = "".join(char if char.isalnum() or char in "-_" else "_" for char in name)
        save(picture(found, name), found.directory / f"map_{safe}")


def picture(found: Map, name: str) -> Figure:
    """The picture of a quantity of a map: a panel for each combination of values of axes that are lists.

    Raises ValueError for an unknown quantity, or a text.
    """
    check_name("quantity", name, [n for n in found.names if n in found.columns.numbers])
    axes = found.store.grid.axes
    along = _along(axes)
    others = [i for i in range(len(axes)) if i not in along]
    every = product(*(range(len(axes[i].values)) for i in others))
    panels = [_panel(found, name, along, dict(zip(others, chosen, strict=True))) for chosen in every]
    drawn = [MapAxis(axes[i].name, numbers(axes[i]), axes[i].log) for i in along]
    return map_figure(name, found.store.meanings.get(name, name), drawn, panels)


def html(found: Map) -> str:
    """A map as a small table beside the picture of its first quantity that changes, for notebooks."""
    from casadi_skin.results.figures.drawing import page

    rows = [(axis.name, f"{len(axis.values)} values") for axis in found.store.grid.axes]
    rows += [("cells", found.summary()), ("quantities", listed(found.names))]
    names = drawn_names(found)
    lists = {axis.name: axis.values[0] for axis in _lists(found)}
    return page("Map", rows, lambda axes: plot(found, names[0], axes, lists) if names else refuse())


def _lists(found: Map) -> list[Axis]:
    """Axes that are not drawn."""
    axes = found.store.grid.axes
    return [axis for i, axis in enumerate(axes) if i not in _along(axes)]


def refuse() -> None:
    """Raises ValueError: nothing changes over the map."""
    raise ValueError("plot: no quantity changes over the map")


def plot(found: Map, name: str, axes: Axes | None = None, at: Mapping[str, Any] | None = None) -> Axes:
    """Draw a quantity over the ranges of the map into matplotlib axes.

    Arguments:
        found: the map.
        name: the quantity.
        axes: where it is drawn; new ones of pyplot by default.
        at: values of the axes that are lists, by name; one of a single value may be left out.

    Returns:
        The axes.

    Raises:
        ValueError: there is no such quantity, it is a text, or there is no such value of an axis.
    """
    from matplotlib.axes import Axes

    check_name("quantity", name, [n for n in found.names if n in found.columns.numbers])
    ranges = found.store.grid.axes
    along, given = _along(ranges), dict(at or {})
    others = {ranges[i].name: i for i in range(len(ranges)) if i not in along}
    for key in given:
        check_name("at", key, others)
    chosen = {i: _place_of(ranges[i], given) for i in others.values()}
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(layout="constrained")[1]
    if not isinstance(axes, Axes):
        raise TypeError(f"axes: given {short_repr(axes)}; accepted: axes of matplotlib, or None")
    drawn = [MapAxis(ranges[i].name, numbers(ranges[i]), ranges[i].log) for i in along]
    draw_map(axes, name, drawn, _panel(found, name, along, chosen))
    return axes


def _place_of(axis: Axis, given: Mapping[str, Any]) -> int:
    """The value of a list that is drawn: the requested one, or the only one; raises ValueError for no value."""
    if axis.name not in given and len(axis.values) == 1:
        return 0
    value = given.get(axis.name)
    if axis.name not in given or value not in axis.values:
        words = f"given {short_repr(value)}" if axis.name in given else "missing"
        raise ValueError(f"at: {axis.name}: {words}; accepted: {cut(', '.join(map(repr, axis.values)))}")
    return axis.values.index(value)


def _panel(found: Map, name: str, along: list[int], chosen: Mapping[int, int]) -> Panel:
    """The panel of a quantity at certain places of the other axes."""
    axes = found.store.grid.axes
    index = tuple(chosen.get(i, slice(None)) for i in range(len(axes)))
    values, states = found[name].astype(float)[index], found.status[index]
    values = np.where(np.isfinite(values), values, np.nan)
    at = [value for i, k in chosen.items() for value in _values_at(axes[i], k)]
    words = panel_title([name for i in chosen for name in _names_of(axes[i])], at)
    shown = filled(values, states, [axes[i].stride for i in along])
    return Panel(words, shown, states >= ENDED, states != UNKNOWN, found.lines(tuple(chosen.values())))


def _names_of(axis: Axis) -> list[str]:
    """Names of the parameters of an axis, of which several may change together."""
    return [name.strip() for name in axis.name.split(",")] if axis.given else [axis.name]


def _values_at(axis: Axis, place: int) -> tuple[Any, ...]:
    """Their values at a place."""
    return axis.given[place] if axis.given else (axis.values[place],)


def _along(axes: tuple[Axis, ...]) -> list[int]:
    """Axes that are drawn: the ranges; where there is none the longest list of numbers."""
    ranges = [i for i, axis in enumerate(axes) if axis.numeric]
    if ranges:
        return ranges
    lists = [i for i, axis in enumerate(axes) if not any(isinstance(v, str) for v in axis.values)]
    return sorted(lists, key=lambda i: -len(axes[i].values))[:1] or [0]


def numbers(axis: Axis) -> NDArray[np.float64]:
    """Where the values of an axis are drawn: those that are words one after the other."""
    words = any(isinstance(value, str) for value in axis.values)
    return np.arange(len(axis.values), dtype=float) if words else np.array(axis.values, dtype=float)


def filled(values: NDArray[np.float64], states: NDArray[np.int8], strides: list[int]) -> NDArray[np.float64]:
    """Values with those of the nearest computed cell where a refined map computed none."""
    if max(strides) == 1 or not np.any(states == UNKNOWN):
        return values
    from scipy.ndimage import distance_transform_edt

    _, nearest = distance_transform_edt(states == UNKNOWN, sampling=[1.0 / s for s in strides], return_indices=True)
    return np.asarray(values[tuple(nearest)])


# Planes of a map's two ranges, one for each combination of values of its other axes -----------------------------------
