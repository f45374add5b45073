"""Pictures of a map: a quantity each, over the axes that are ranges; other axes have a panel a value."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from casadi_skin.figures.map import MapAxis, Panel, map_figure, panel_title
from casadi_skin.figures.style import save
from casadi_skin.maps.grid import Axis
from casadi_skin.maps.store import ENDED, UNKNOWN

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from casadi_skin.maps.result import Map

LEFT_OUT = ("points", "at_round_off", "residual", "profile_error", "S_error", "intervals")
MOST_DRAWN = 1025  # values along an axis of a picture


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
    """The picture of a quantity of a map."""
    axes = found.store.grid.axes
    along = _along(axes)
    others = [i for i in range(len(axes)) if i not in along]
    values, status = found[name].astype(float), found.status
    values = np.where(np.isfinite(values), values, np.nan)
    panels = []
    for chosen in product(*(range(len(axes[i].values)) for i in others)):
        index: list[int | slice] = [slice(None)] * len(axes)
        for i, k in zip(others, chosen, strict=True):
            index[i] = k
        words = panel_title(
            [axes[i].name for i in others], [axes[i].values[k] for i, k in zip(others, chosen, strict=True)]
        )
        part, states = values[tuple(index)], status[tuple(index)]
        strides = [axes[i].stride for i in along]
        panels.append(
            Panel(words, filled(part, states, strides), states >= ENDED, states != UNKNOWN, found.lines(chosen))
        )
    drawn = [MapAxis(axes[i].name, numbers(axes[i]), axes[i].log) for i in along]
    return map_figure(name, found.store.meanings.get(name, name), drawn, panels)


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
