"""A map as computed: values of quantities over its axes, read from its journals on demand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import check_name
from casadi_skin.model.files import TemporaryFolder
from casadi_skin.model.result import WithVerbs
from casadi_skin.runs.map_one_file import save_map
from casadi_skin.runs.map_store import DONE, ENDED, FAILED, REASON, STATUS, UNKNOWN, Columns, Store

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Map(WithVerbs):
    """Quantities of a scene over its parameters.

    Attributes:
        directory: where its journals, tables and pictures are.
        columns: its quantities, on the disk.
        complete: whether every cell is computed, or was tried twice.
        waits: whether shares of a batch array are not there yet.
        boundary: lines of changes of stability in the plane of the ranges, shape (points, 2) each, by the places of
            the other axes.
        folder: the temporary folder of a map that was read from one file; None of one in its directory.
    """

    directory: Path
    columns: Columns
    complete: bool
    waits: bool = False
    boundary: Mapping[tuple[int, ...], tuple[NDArray[np.float64], ...]] = field(default_factory=dict)
    folder: TemporaryFolder | None = None

    @property
    def store(self) -> Store:
        """The records of its cells."""
        return self.columns.store

    @property
    def axes(self) -> Mapping[str, NDArray[Any]]:
        """Values along each axis by name."""
        return {axis.name: np.array(axis.values) for axis in self.store.grid.axes}

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return self.store.grid.shape

    @property
    def status(self) -> NDArray[np.int8]:
        """0 of a cell that is not computed, 1 done, 2 where a branch ended early, 3 failed; shape as the axes."""
        return self.store.states.reshape(self.shape)

    def failures(self, most: int | None = None) -> list[tuple[str, str]]:
        """Cells that failed or ended early, in words, each with its reason; no more than `most` of them."""
        cells = np.flatnonzero(self.store.states >= ENDED)[:most].tolist()
        return [(self.store.grid.name(cell), self.columns.text(REASON, cell)) for cell in cells]

    @property
    def names(self) -> list[str]:
        """Names of the quantities."""
        return self.columns.names

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Values of a quantity by name, shape as the axes: NaN or an empty text where there is none.

        Raises ValueError, with the nearest known name, for an unknown one.
        """
        check_name("quantity", name, self.names)
        if name in self.columns.numbers:
            return np.array(self.columns.numbers[name]).reshape(self.shape)
        cells = np.flatnonzero(self.columns.lengths(name)).tolist()
        texts = np.full(self.store.grid.size, "", dtype=object)
        for cell in cells:
            texts[cell] = self.columns.text(name, cell)
        return texts.reshape(self.shape)

    def summary(self) -> str:
        """The numbers of cells in words."""
        states = self.store.states
        counts = [(DONE, "done"), (ENDED, "ended early"), (FAILED, "failed")]
        words = [f"{np.sum(states == s)} {word}" for s, word in counts if np.any(states == s)]
        mean = self.store.seconds / max(self.store.finished, 1)
        refined = f" of {self.store.grid.size} at the finest" if self.store.grid.refined else ""
        return f"{int(np.sum(states != UNKNOWN))} cells{refined}: {', '.join(words) or 'none'}; {mean:.3g} s a cell"

    def __repr__(self) -> str:
        sizes = " x ".join(f"{len(axis.values)} {axis.name}" for axis in self.store.grid.axes)
        return f"<Map: {sizes}; {self.summary()}>"

    def save(self, path: str | Path) -> Path:
        """Write the map to one file, from which `casadi_skin.read_map` reads it with the same bits.

        Raises ValueError for the path of a directory or in none, OSError where the file cannot be written.
        """
        return save_map(self.directory, path)

    figure: ClassVar[Callable[..., Figure]]
    """The picture of a quantity with all its panels: `casadi_skin.runs.map_pictures.picture`."""
    plot: ClassVar[Callable[..., Axes]]
    """Draw a quantity over the ranges of the map into matplotlib axes: `casadi_skin.runs.map_pictures.plot`."""

    def lines(self, chosen: tuple[int, ...]) -> tuple[NDArray[np.float64], ...]:
        """Lines of the boundary at places of the axes that are no ranges."""
        return self.boundary.get(chosen, ())

    def to_dataframe(self) -> pandas.DataFrame:
        """A pandas DataFrame with a row a computed cell, as in map.csv; raises ImportError, naming the extra."""
        try:
            import pandas
        except ImportError as error:
            extra = 'it comes with the extra: pip install "casadi-skin[pandas]"'
            raise ImportError(f"pandas is not installed; {extra}") from error
        cells = np.flatnonzero(self.store.states != UNKNOWN)
        columns: dict[str, Any] = {}
        for axis, places in zip(self.store.grid.axes, self.store.grid.places(cells).T, strict=True):
            columns[axis.name] = np.array(axis.values)[places]
        columns["status"] = [STATUS[state] for state in self.store.states[cells]]
        columns |= {name: self[name].ravel()[cells] for name in self.names}
        columns[REASON] = [self.columns.text(REASON, cell) for cell in cells.tolist()]
        return pandas.DataFrame(columns)

    def to_xarray(self) -> xarray.Dataset:
        """The map as an xarray Dataset, as in map.nc; raises ImportError, naming the extra, without xarray."""
        try:
            import xarray as xr
        except ImportError as error:
            words = 'xarray is not installed; it comes with the extra: pip install "casadi-skin[xarray]"'
            raise ImportError(words) from error
        dimensions = tuple(axis.name for axis in self.store.grid.axes)
        meanings = self.store.meanings
        found = {n: xr.Variable(dimensions, self[n], {"long_name": meanings.get(n, n)}) for n in self.names}
        return xr.Dataset({"status": (dimensions, self.status), **found}, coords=dict(self.axes))
