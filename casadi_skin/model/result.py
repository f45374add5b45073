"""Base of every result: a few lines in print, a table with a picture in notebooks, tables, pictures and files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from casadi_skin.model import methods

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes


class NoQuantityError(ValueError, AttributeError):
    """A quantity that a result of this kind has not: a ValueError for who asks for it, and `hasattr` is False."""


class Result:
    """A result that prints as a few lines, draws itself, becomes tables and is saved; libraries load on first use."""

    def __str__(self) -> str:
        return str(methods.TASKS["lines"].load()(self))

    def _repr_html_(self) -> str:
        """A small table with its picture, for notebooks."""
        return str(methods.TASKS["html"].load()(self))

    def plot(self, axes: Axes | None = None, **options: Any) -> Axes:
        """Draw the result into matplotlib axes.

        Arguments:
            axes: axes to draw into, on top of their contents; new ones of pyplot by default.
            options: `x` and `y` of a branch, names of quantities; `states` of an orbit, a solution or an evolution,
                names of components.

        Returns:
            The axes.

        Raises:
            ValueError: there is no such quantity or component, or nothing to draw.
        """
        drawn: Axes = methods.TASKS["plot"].load()(self, axes, **options)
        return drawn

    def to_dataframe(self) -> pandas.DataFrame:
        """A pandas DataFrame: a row a point of a branch, a time of an orbit, or a multiplier; needs the extra `pandas`.

        Raises ImportError, naming the extra, where pandas is not installed.
        """
        frame: pandas.DataFrame = methods.TASKS["to_dataframe"].load()(self)
        return frame

    def to_xarray(self) -> xarray.Dataset:
        """An xarray Dataset, of a branch with all that its netCDF file has; needs the extra `xarray`.

        Raises ImportError, naming the extra, where xarray is not installed.
        """
        dataset: xarray.Dataset = methods.TASKS["to_xarray"].load()(self)
        return dataset

    def save(self, path: str | Path) -> Path:
        """Write the result to a file of data, from which `casadi_skin.read_result` makes it again, bit for bit.

        Raises ValueError for results of programs, such as FMUs, OSError where the file cannot be written.
        """
        written: Path = methods.TASKS["save"].load()(self, path)
        return written
