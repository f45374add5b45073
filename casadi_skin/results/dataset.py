"""A table of variables with named dimensions: the one form from which CSV, netCDF and xarray are made."""

from __future__ import annotations

import csv
import math
import platform
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from casadi_skin._version import __version__
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.space import EQUILIBRIA, FAMILY, ORBITS, SOLUTIONS
from casadi_skin.model.arguments import needs_extra
from casadi_skin.model.files import replacing
from casadi_skin.results.quantities import BOTH, NETCDF, PROFILE_PHASES, Cell, Place, places_of, quantities_of

if TYPE_CHECKING:
    import xarray
    from scipy.io import netcdf_file


# netCDF 3 files by scipy: names and texts in UTF-8, numbers of attributes in double precision, CF-1.8 -----------------

LARGEST_IN_MEMORY = 100_000  # bytes of a variable that waits in memory until its file is written
LARGEST_WHOLE_NUMBER = 2**31  # of whole numbers in netCDF 3
NETCDF_FILL_VALUE = 9.969209968386869e36  # the fill value of netCDF for doubles
OF_ALL = {"Conventions": "CF-1.8", "history": f"written by casadi_skin {__version__}"}


@contextmanager
def new_file(path: Path, attributes: Mapping[str, Any]) -> Iterator[netcdf_file]:
    """A file with 64-bit offsets and these attributes, which takes the place of `path` when it is whole."""
    from scipy.io import netcdf_file

    with replacing(path) as temporary, netcdf_file(temporary, "w", version=2) as file:
        put_attributes(file, {**OF_ALL, **attributes})
        yield file


def put_attributes(target: Any, attributes: Mapping[str, Any]) -> None:
    """Set attributes of a file or a variable; an empty text is "untitled", as netCDF has none."""
    for name, value in attributes.items():
        if isinstance(value, str):
            value = (value or "untitled").encode()
        elif isinstance(value, float):
            value = np.float64(value)  # scipy writes Python's in single precision
        setattr(target, stored_name(name), value)


def stored_name(name: str) -> str:
    """A name as scipy is to have it, which writes a character a byte: the bytes are those of UTF-8."""
    return name.encode().decode("latin-1")


def read_name(name: str) -> str:
    """A name as it was before `stored_name`."""
    return name.encode("latin-1").decode(errors="replace")


def characters(texts: NDArray[Any]) -> NDArray[np.bytes_]:
    """Texts as bytes of one length, filled with blanks: netCDF 3's convention; shape (*shape of the texts, length)."""
    words, places = np.unique(np.asarray(texts, dtype=object), return_inverse=True)
    encoded = [str(word).encode() for word in words.tolist()]
    width = max([1, *map(len, encoded)])
    table = np.frombuffer(b"".join(word.ljust(width) for word in encoded), "S1").reshape(len(encoded), width)
    return np.asarray(table[places.reshape(np.shape(texts))])


def on_disk(kind: DTypeLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """An array of zeros on the disk, in a file that has no name and goes with it."""
    with tempfile.TemporaryFile() as file:
        return np.memmap(file, kind, "w+", shape=shape)


@dataclass(frozen=True, eq=False)
class Variable:
    """Values with their dimensions and meaning; where `may_be_empty` a value that is not finite is left out."""

    name: str
    dimensions: tuple[str, ...]
    values: NDArray[Any]
    meaning: str
    may_be_empty: bool = False
    attributes: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Dataset:
    """Variables that share dimensions, and attributes of all."""

    variables: Sequence[Variable]
    attributes: Mapping[str, Any] = field(default_factory=dict)


def versions() -> dict[str, str]:
    """Versions of the packages that computed the results."""
    import casadi
    import scipy

    used = {f"{package.__name__}_version": package.__version__ for package in (casadi, np, scipy)}
    return {"casadi_skin_version": __version__, **used, "python_version": platform.python_version()}


# netCDF ---------------------------------------------------------------------------------------------------------------


def write_netcdf(path: Path, dataset: Dataset) -> None:
    """Write a dataset as netCDF 3 with 64-bit offsets, replacing the file in one step.

    Complex values have a last dimension `part` (real, imaginary), text one for its characters. Raises ArithmeticError,
    naming the place, on a value that is not finite and may not be empty.
    """
    with new_file(path, dataset.attributes) as file:
        for variable in dataset.variables:
            _put(file, variable)


def _put(file: netcdf_file, variable: Variable) -> None:
    dimensions, data = variable.dimensions, np.asarray(variable.values)
    if data.dtype.kind in "USO":
        dimensions, data = (*dimensions, f"{variable.name}_length"), characters(data)
    elif np.iscomplexobj(data):
        dimensions, data = (*dimensions, "part"), np.stack([data.real, data.imag], axis=-1)
    if data.dtype.kind == "f":
        data = _known(variable, dimensions, data)
    stored_names = [stored_name(name) for name in dimensions]
    for name, size in zip(stored_names, data.shape, strict=True):
        if name not in file.dimensions:
            file.createDimension(name, size)
    kind = "c" if data.dtype.kind == "S" else "i4" if data.dtype.kind in "bi" else "f8"
    stored = file.createVariable(stored_name(variable.name), kind, stored_names)
    if data.nbytes > LARGEST_IN_MEMORY:  # all variables wait for the end of the file
        stored.__dict__["data"] = on_disk(stored.data.dtype, data.shape)  # set plainly it becomes an attribute too
    stored[:] = data
    fill = {"_FillValue": NETCDF_FILL_VALUE} if variable.may_be_empty else {}
    put_attributes(stored, {"long_name": variable.meaning, **variable.attributes, **fill})


def _known(variable: Variable, dimensions: tuple[str, ...], data: NDArray[Any]) -> NDArray[Any]:
    """The values with netCDF's fill value where they may be empty; raises ArithmeticError for others that are."""
    finite = np.isfinite(data)
    if variable.may_be_empty:
        return np.where(finite, data, NETCDF_FILL_VALUE)
    faulty = np.argwhere(~finite)
    if faulty.size:
        place = ", ".join(f"{dimension} {i}" for dimension, i in zip(dimensions, faulty[0].tolist(), strict=True))
        value = data[tuple(faulty[0])]
        raise ArithmeticError(f"{variable.name}: {value} at {place} (counted from 0); it is not written")
    return data


def to_xarray(dataset: Dataset, coordinates: Sequence[str] = ()) -> xarray.Dataset:
    """The dataset as one of xarray; values that may be empty are NaN there.

    Raises ImportError, naming the extra, where xarray is not installed.
    """
    with needs_extra("xarray", "xarray"):
        import xarray as xr
    variables = {v.name: xr.Variable(v.dimensions, v.values, {"long_name": v.meaning}) for v in dataset.variables}
    chosen = {name: variables.pop(name) for name in coordinates if name in variables}
    return xr.Dataset(variables, chosen, dict(dataset.attributes))


# Branches as datasets -------------------------------------------------------------------------------------------------


def dataset_of(branches: Sequence[Branch], vectors: bool = False) -> Dataset:
    """All branches along one dimension `point`, in the order given and in arclength order within each.

    Arguments:
        branches: families of one model, or one other branch; at least one solution in all.
        vectors: whether Floquet vectors at requested points are among the variables.

    Returns:
        Variables named as in the table of quantities, with names of states and parameters, sites, phases and meshes.
    """
    held = [branch for branch in branches if len(branch)]
    widest = max(held, key=lambda branch: max((getattr(s, "harmonics", 0) for s in branch.solutions), default=0))
    places = [place for branch in held for place in places_of(branch)]
    variables = _axes(held[0])
    for quantity in quantities_of(widest):
        if quantity.where in (NETCDF, BOTH):
            values = np.array([quantity.of(place) for place in places])
            dimensions = ("point", *quantity.dimensions)
            variables.append(Variable(quantity.name, dimensions, values, quantity.meaning, quantity.may_be_empty))
    if held[0].space.connects in (ORBITS, SOLUTIONS):
        variables.append(_mesh(places))
    chosen = [i for i, place in enumerate(places) if place.requested]
    if vectors and chosen:
        found = np.stack([places[i].solution.floquet_vectors() for i in chosen])
        dimensions, meaning = ("requested_point", "component", "multiplier"), "place along `point`, from 0"
        variables += [
            Variable("vectors_point", ("requested_point",), np.array(chosen), meaning),
            Variable("vectors", dimensions, found, "Floquet vectors (positions, velocities) at t = 0, columns"),
        ]
    return Dataset(variables)


def _axes(branch: Branch) -> list[Variable]:
    """Coordinates along the dimensions of the quantities."""
    solution, connects = branch.solutions[0], branch.space.connects
    if connects == FAMILY:
        meaning = "number of the site, from 1; up to 0 in an infinite chain with gamma > 0"
        return [Variable("site", ("site",), branch.orbits[0].output_sites, meaning)]
    axes = [Variable("state_name", ("state",), np.array(solution.space.state_names), "names along `state`")]
    if solution.parameters:
        names = np.array(list(solution.parameters))
        axes.append(Variable("parameter_name", ("parameter",), names, "names along `parameter`"))
    if connects == EQUILIBRIA:
        return axes
    return [*axes, Variable("phase", ("phase",), PROFILE_PHASES, "place in the interval or the period, from 0 to 1")]


def _mesh(places: Sequence[Place]) -> Variable:
    longest = max(place.solution.intervals for place in places)
    edges = [np.append(p.solution.mesh, np.full(longest - p.solution.intervals, np.nan)) for p in places]
    meaning = "ends of the intervals of the part that was unknown; empty after it"
    return Variable("mesh", ("point", "edge"), np.stack(edges), meaning, may_be_empty=True)


def branch_to_xarray(branch: Branch) -> xarray.Dataset:
    """A branch as an xarray Dataset along `point`; raises ImportError, naming the extra, without xarray."""
    space: Any = branch.space
    attributes = {"tolerance": space.tolerance}
    if space.connects == FAMILY:
        attributes = {**space.coordinates.attributes, "mode": space.coordinates.mode_number, **attributes}
    return to_xarray(replace(dataset_of([branch]), attributes=attributes), ("site",))


# CSV ------------------------------------------------------------------------------------------------------------------


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Cell]]) -> None:
    """Write rows under `columns` with 17 significant digits, replacing the file in one step.

    Raises ArithmeticError on a value that is not finite, naming its row (from 1) and column.
    """
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(_line(row, columns, place) for place, row in enumerate(rows, start=1))


def write_columns(path: Path, columns: Mapping[str, Any]) -> None:
    """Write columns of numbers, each an array of one length, as `write_csv` does."""
    rows = np.column_stack(list(columns.values())).tolist()
    write_csv(path, list(columns), (dict(zip(columns, row, strict=True)) for row in rows))


def _line(row: Mapping[str, Cell], columns: Sequence[str], place: int) -> list[str]:
    """Cells of a row in text; raises ArithmeticError naming row and column of a value that is not finite."""
    for column in columns:
        value = row[column]
        if isinstance(value, float) and not math.isfinite(value):
            named = ", ".join(f"{name} {row[name]}" for name in ("mode", "point", "S", "t") if name in row)
            raise ArithmeticError(f"{column}: {value} in row {place} ({named}); it is not written")
    return [f"{row[c]:.17g}" if isinstance(row[c], float) else str(row[c]) for c in columns]


# Files that are not what a run wrote: cut off, changed, or made by somebody else --------------------------------------

WRONG_FILE_ERRORS = (ArithmeticError, AttributeError, LookupError, MemoryError, TypeError, ValueError, csv.Error)
ACCEPTED_FILES = "accepted: a file as a run or a map writes it"


def check_whole(path: Path) -> None:
    """Raises ValueError, naming the file, where a netCDF file or a table of a run was cut off or cannot be read."""
    with readable(path):
        if path.suffix == ".csv":
            with path.open("rb") as table:
                table.seek(max(path.stat().st_size - 1, 0))
                if table.read(1) != b"\n":
                    raise ValueError("its last row is cut off")
            return
        from scipy.io import netcdf_file

        with netcdf_file(path, "r", mmap=False) as file:  # all variables are read
            if not file.variables:
                raise ValueError("it has no variables")


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Raises ValueError, naming the file, where its contents cannot be read or do not fit together."""
    try:
        yield
    except OSError as error:  # also of a place in the file that is none
        raise ValueError(f"{path}: cannot be read: {error.strerror}; {ACCEPTED_FILES}") from error
    except WRONG_FILE_ERRORS as error:
        why = f"damaged: {type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")
        raise ValueError(f"{path}: {why}; {ACCEPTED_FILES}") from error
