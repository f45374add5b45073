"""Contents of a page of a map: quantities over its axes, thinned where there are too many cells."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.results.damaged import readable
from casadi_skin.runs.explorer_data import read_netcdf, short_numbers

MAP = "map.nc"
CELLS = 40_000  # of a map, in all
STATUS = ("not computed", "done", "ended early", "failed")
SKIPPED = ("status", "reason", "regime")


def map_data(directory: Path) -> dict[str, Any]:
    """All that the page shows, as JSON takes it; raises ValueError where the map has no cells."""
    with readable(directory / MAP):
        contents = read_netcdf(directory / MAP)
        empty = not contents[1]["status"].size
    if empty:
        raise ValueError(f"{directory}: a map without cells; accepted: one with at least one")
    with readable(directory / MAP):
        return _contents(directory.name, *contents)


def _contents(
    name: str,
    attributes: Mapping[str, str],
    variables: Mapping[str, NDArray[Any]],
    dimensions: Mapping[str, tuple[str, ...]],
    words: Mapping[str, str],
) -> dict[str, Any]:
    axes = list(dimensions["status"])
    chosen = _thinned(variables["status"].shape)
    index = np.ix_(*chosen)
    status = variables["status"][index]
    whole = [n for n, d in dimensions.items() if list(d) == axes and n not in SKIPPED]
    numbers = {n: short_numbers(variables[n].astype(float)[index]) for n in whole if variables[n].dtype.kind in "fi"}
    left = status.size < variables["status"].size
    return {
        "title": attributes.get("title", "") or name,
        "note": f"{status.size} of {variables['status'].size} cells are shown" if left else "",
        "axes": [_axis(n, variables[n][places], words.get(n, n)) for n, places in zip(axes, chosen, strict=True)],
        "quantities": [{"name": n, "words": words.get(n, n), "values": values} for n, values in numbers.items()],
        "status": status.astype(int).ravel().tolist(),
        "reasons": [str(text) for text in variables["reason"][index].ravel()] if np.any(status > 1) else [],
        "states": list(STATUS),
    }


def _thinned(shape: tuple[int, ...]) -> list[NDArray[np.int64]]:
    """Places along each axis, evenly, so that the cells are few enough; the longest axes are thinned first."""
    sizes = list(shape)
    while np.prod(sizes) > CELLS:
        longest = int(np.argmax(sizes))
        sizes[longest] = (sizes[longest] + 1) // 2
    return [np.unique(np.linspace(0, n - 1, m).round().astype(np.int64)) for n, m in zip(shape, sizes, strict=True)]


def _axis(name: str, values: NDArray[Any], words: str) -> dict[str, Any]:
    numbers = values.dtype.kind in "fi"
    shown = short_numbers(values) if numbers else [str(value) for value in values]
    return {"name": name, "words": words, "values": shown, "numbers": numbers}
