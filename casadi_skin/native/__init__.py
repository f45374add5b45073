"""Kernels in C, built with the package where there is a compiler; without one numpy takes the same steps.

`kernels.library` beside this file has all of them, on x86-64 for any processor, for AVX2 and for AVX-512;
hatch_build.py compiles it when the package is built, nothing is compiled or cached at run time. Products are rounded
before they are added: numbers are those of numpy but for the order of sums. The library knows nothing of Python. The
tables below say how the arguments of its functions and the fields of its structures follow one another.

| source | what it computes | the same by numpy |
| --- | --- | --- |
| bordered.c | factors and solutions of bands with borders | `solve.bordered` |
| collocation.c | factors of collocation equations | `solve.bordered` |
| dense.c | factors of small matrices | `solve.bordered` |
| equations.c | collocation equations, and Newton steps on finer meshes | `zero.discretisation`, `solve.levels` |
| splitting.c | steps of a model, transition matrices along orbits | CasADi in `dynamics.evolve`, `stability.flows` |
| segments.c | steps of a chain with first and second derivatives | `search.kick_flow` |
| program.c, places.c | expressions, operations that are alike together, or at many places | CasADi |
| rests.c | equilibria along a stretch, and the sides of their eigenvalues | `follow.rest_events` |
| decoupling.c | bases that make matrices block diagonal | `stability.tongues.blocks` |
| elimination.c | cells of a row eliminated from its free end on | `stability.tongues.hill` |
| interval_maps.c | maps over the intervals of collocation | `stability.full_period` |
| multipliers.c, eigenvalues.c | the multipliers of a closed chain of maps | `stability.closed_maps` |
| orbits.c | the same of an orbit at once, with their errors | `stability.full_period` |
| taylor.c | power series of branches, and those with a linear tail | `zero.cosines`, `lattice.core_with_tail` |
| fmus.c | numbers of an FMU at several points in one call | `fmu.fmu_component` |
"""

from __future__ import annotations

import ctypes
import struct
import zlib
from collections import defaultdict
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.operations import CODES, Program
from casadi_skin.model.polynomial import Monomials

Array = NDArray[np.float64]
Numbers = NDArray[Any]  # real or complex
Indices = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Pattern = tuple[NDArray[np.int32], NDArray[np.int32]]  # indptr and indices of the rows of J
Levels = Sequence[tuple[Indices, Indices, Array]]  # nodes known, nodes wanted, weights of these in those

LIBRARY = Path(__file__).with_name("kernels.library")
# By the kinds of arguments or of fields: i an integer, r a real number, a an array or a structure, w one that is there
# and may be written to.
FUNCTIONS = {
    "bordered_solve": "aaia",
    "bordered_steps": "aiaaaiaaaa",
    "collocation_factors": "waaarwwww",
    "collocation_solve": "wwiw",
    "collocation_solve_transposed": "wwiw",
    "collocation_equations": "waaww",
    "collocation_jacobians": "waaiaaw",
    "largest_terms": "iaaaaa",
    "collocation_times": "aaaa",
    "collocation_null_vector": "wwwaarrww",
    "collocation_missed": "wwaaww",
    "collocation_change": "wwaaww",
    "collocation_improved": "wwwwaaaawwwww",
    "collocation_sizes": "waw",
    "collocation_metric": "warw",
    "collocation_speed": "waaww",
    "collocation_corrected": "wwawawarwwwwww",
    "collocation_interpolated": "waiaiiawi",
    "collocation_newton": "wwaaiiwraiaaawwwiwww",
    "collocation_density": "waaaarrrww",
    "shifted": "waaaw",
    "drift": "waaaarwww",
    "transitions": "iiiiaaiaaaaia",
    "stepped": "aiaaiiaaa",
    "segments": "aiaraaaaa",
    "at_places": "w",
    "dense_factors": "waaww",
    "dense_solve": "wwiw",
    "rests_along": "wiiraawww",
    "keep_sides": "wiara",
    "invariant": "iiiiiaaaiaaairaa",
    "contracts": "iiiiaaairraa",
    "eliminated": "aiaaaaaa",
    "interval_maps": "aiiaaaaa",
    "multipliers": "iiiiirriaaaaaaa",
    "orbit_multipliers": "waaiw",
    "orbit_multipliers_by_parts": "wwaaaaiiww",
    "judged_multipliers": "iwarrw",
    "series_put": "ai",
    "series_right": "ai",
    "series_solve": "aaaa",
    "fmu_at": "wwii",
}
TERMS = "iaaaaaa"
LAYOUT = "iiii" + 4 * "iaa" + "aarraaa"
ROW = "iiiiii" + "aa"
METHOD = "iaa"
SERIES = "iiiii" + "aaaaaaaa" + 2 * (TERMS + "aa")
TAIL = "iiiiiii" + "aaaaaaaaaa" + "r"

PROGRAM = "iiiaaa"
CHAIN = "iirraaa"
OPERATIONS = (
    "add", "sub", "mul", "div", "neg", "sq", "twice", "inv", "pow", "constpow", "exp", "log", "sqrt", "sin", "cos",
    "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "atan2", "hypot", "expm1",
    "log1p", "erf", "floor", "ceil", "fabs", "sign", "lt", "le", "eq", "ne", "not", "and", "or", "if_else_zero",
    "fmin", "fmax", "copysign",
)  # fmt: skip
KINDS = {CODES[name]: number for number, name in enumerate(OPERATIONS)} | {ca.OP_CONST: -1}  # numbers in program.c

ENDINGS = {2: "", 4: "_avx2", 8: "_avx512"}  # of the names of functions, by the numbers that a register holds
LANES = 8  # right-hand sides that bordered.c takes together, and components that splitting.c does, at least
MOST = 7  # unknowns beside the band that bordered.c has room for


# The library, and what its functions take ----------------------------------------------------------------------------


class _Writable:
    """An argument that is an array that may be written to, or a structure."""

    from_param = (ctypes.c_char * 0).from_buffer  # where its numbers begin, and no function of Python between


def address(array: Any) -> int:
    """Where the numbers of an array begin; the array has to be contiguous, row by row."""
    try:
        return ctypes.addressof(_Writable.from_param(array))
    except TypeError:  # not to be written to: five times as long
        interface = array.__array_interface__
        assert interface["strides"] is None
        return int(interface["data"][0])


class _Address:
    """An argument that is any array or a structure, or None where a kernel does without."""

    @staticmethod
    def from_param(array: Any) -> Any:
        """What ctypes passes as an address, in a fifth of `address`'s time where it may be written to."""
        try:
            return _Writable.from_param(array)
        except TypeError:  # not to be written to, or None
            return ctypes.c_void_p(None if array is None else address(array))


TYPES: Mapping[str, Any] = {"i": ctypes.c_int64, "r": ctypes.c_double, "a": _Address, "w": _Writable}


@cache
def kernels() -> Mapping[str, Any]:
    """The functions by name; none where the package was built without a C compiler, or for another system.

    A library of other sources than those beside it has other arguments, and would end the process: it is left alone.
    """
    try:
        if _is_cut_off(LIBRARY):
            return {}
        library = ctypes.CDLL(str(LIBRARY))
        if library.sources() != digest_of_sources():
            return {}
        ending = ENDINGS[library.numbers_together()]
        found: Mapping[str, Any] = {name: getattr(library, name + ending) for name in FUNCTIONS}
    except (OSError, AttributeError):  # AttributeError: built from older sources
        return {}
    for name, kinds in FUNCTIONS.items():
        found[name].argtypes = [TYPES[kind] for kind in kinds]
    return found


def _is_cut_off(library: Path) -> bool:
    """Whether a library in ELF ends before its table of sections does: to load it would end the process."""
    with library.open("rb") as file:
        head = file.read(64)
    if len(head) < 64 or head[:5] != b"\x7fELF\x02":
        return False
    place, size, count = *struct.unpack_from("<Q", head, 40), *struct.unpack_from("<HH", head, 58)
    return bool(library.stat().st_size < place + size * count)


def digest_of_sources() -> int:
    """That of the sources beside this file, as hatch_build.py compiles it into the library."""
    sources = sorted(Path(__file__).parent.glob("*.[ch]"))
    return zlib.crc32(b"".join(path.read_bytes() for path in sources)) & 0x7FFFFFFF


def kernels_in_words() -> str:
    """Which kernels are in use: `compiled for AVX2`, `compiled`, or `numpy`, also where the library is of no use."""
    if not kernels():
        return "numpy; the library is cut off, of other sources or of another system" if LIBRARY.exists() else "numpy"
    _, _, processor = kernels()["invariant"].__name__.partition("_")
    return "compiled" + {"": "", "avx2": " for AVX2", "avx512": " for AVX-512"}[processor]


def _call(name: str, *arguments: Any) -> None:
    if kernels()[name](*arguments):
        raise MemoryError(f"the compiled kernel `{name}`")


class Structure(np.ndarray[Any, Any]):
    """Integers, real numbers and addresses of arrays, of one of the kinds above, which keeps these arrays alive."""

    _fields: tuple[Any, ...]

    def __new__(cls, kinds: str, *fields: Any) -> Self:
        """The structure of fields of these kinds: numbers, and contiguous arrays, None where a kernel does without."""
        words = [
            field or 0 if kind != "a" or field is None else address(field)
            for kind, field in zip(kinds, fields, strict=True)
        ]
        packed = struct.pack("=" + kinds.replace("i", "q").replace("a", "Q").replace("r", "d"), *words)
        found = np.frombuffer(bytearray(packed), dtype=np.int64).view(cls)
        found._fields = fields
        return found


def _terms(groups: Sequence[Monomials]) -> tuple[Any, ...]:
    """Terms one by one: their number, powers of the parameter, degrees, rows, first factors, factors, coefficients."""
    counts, none = [group.rows.size for group in groups], np.zeros(0, dtype=np.int64)
    degrees = np.repeat(np.array([group.degree for group in groups], dtype=np.int64), counts)
    powers = np.repeat(np.array([group.power for group in groups], dtype=np.int64), counts)
    rows = np.concatenate([none, *(group.rows for group in groups)])
    factors = np.concatenate([none, *(group.factors.T.ravel() for group in groups)])
    coefficients = np.concatenate([np.zeros(0), *(group.coefficients for group in groups)])
    return degrees.size, powers, degrees, rows, np.cumsum(degrees) - degrees, factors, coefficients


# Memory of factors, which an operating system takes as long to give as the factors take ------------------------------

MOST_KEPT = 8_000_000  # numbers of memory that is used again

_free = list[Array]()


def memory_of(size: int) -> Array:
    """Room for as many numbers, that of factors which nobody holds any more if there is some."""
    for k, known in enumerate(_free):
        if size <= known.size <= 2 * size:
            return _free.pop(k)
    return np.empty(size)


def give_back(memory: Array) -> None:
    """Let the memory of factors be used again."""
    _free.append(memory)
    while sum(known.size for known in _free) > MOST_KEPT:
        _free.pop(0)


# Bands with borders: bordered.c --------------------------------------------------------------------------------------


class BorderedKernel:
    """Factors and solutions of matrices of one layout.

    Arguments:
        sizes: number of unknowns in the band, of all, and the half bandwidth.
        places: source and target of the non-zeros inside the band, right of it, below it, and in the corner.
        pattern: rows and columns of the non-zeros.
        limits: growth of a right-hand side that only a singular matrix gives, and the residual of a solution that is
            accurate, relative to the largest entries of matrix and solution.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int],
        places: Sequence[tuple[Indices, Indices]],
        pattern: tuple[Indices, Indices],
        limits: tuple[float, float],
    ) -> None:
        banded, self._size, width = sizes
        parts = [field for source, target in places for field in (source.size, source, target)]
        extents = _extents(banded, width, places[0][1])
        self.layout = Structure(LAYOUT, *sizes, pattern[0].size, *parts, *pattern, *limits, *extents)
        edge = self._size - banded + 1
        room = banded * (3 * width + 2 + 2 * edge) + edge * (3 * edge - 1)  # integers among them
        self._room = room + LANES * (banded + 1)
        self._defect, self._scratch = np.empty(self._size), np.empty(self._room)

    def memory(self) -> Array:
        """Room for one factorised matrix."""
        return memory_of(self._room)

    def steps(self, z: Array, nonzeros: Array, rows: Array, x: Array, memory: Array | None = None) -> Array | None:
        """Signs of the determinants of matrices at states, (states, size); None where one is singular but for rounding.

        Right-hand sides x, (states, each, size), are overwritten by solutions; the last but one of each has residuals
        in general position, the last is for the closing row alone. `memory` keeps the factors of the last state.
        """
        memory, signs = self._scratch if memory is None else memory, np.empty(len(z))
        data = z, nonzeros, rows, x.shape[1], x, signs, memory, self._defect
        return None if kernels()["bordered_steps"](self.layout, len(z), *data) else signs

    def solve(self, memory: Array, x: Array) -> None:
        """Overwrite right-hand sides, (count, size), by solutions with the factors in `memory`."""
        _call("bordered_solve", self.layout, memory, len(x), x)


def _extents(banded: int, width: int, targets: Indices) -> tuple[Indices, Indices, Indices]:
    """The last row with an entry in columns up to each, columns alike, and entries above the diagonal of factors.

    Rows and columns next to a tail have entries farther off than others, for which the band is wider than they need.
    """
    columns, places = np.divmod(targets, 3 * width + 1)
    rows, deep = columns + places - 2 * width, np.arange(banded)
    reach = deep.copy()
    np.maximum.at(deep, columns, rows)
    np.maximum.at(reach, rows, columns)
    deep, reach = np.maximum.accumulate(deep), np.maximum.accumulate(reach)
    return deep, reach, np.arange(banded) - np.searchsorted(reach[deep], np.arange(banded))


# Expressions, and steps of models of second order: program.c, splitting.c ---------------------------------------------


def program_lists(program: Program, numbers: Sequence[float], parameters: Array) -> Structure | None:
    """The first result of a program of a state and parameters; None where an operation is not among OPERATIONS.

    Operations of one kind and depth are one list where their arguments are at equal steps. Those that depend on
    parameters alone come first.
    """
    states, first, groups = program.inputs[0], sum(program.inputs), defaultdict[Any, list[int]](list)
    keys = [(place < states, 0, -1) for place in range(first)]
    arguments = [()] * first + [places for _, *places in program.operations]
    for k, (code, *places) in enumerate(program.operations, start=first):
        if code not in KINDS:
            return None
        moves, depth = any(keys[n][0] for n in places), 1 + max((keys[n][1] for n in places), default=-1)
        keys.append((moves, depth, KINDS[code]))
        groups[keys[k]].append(k)
    place, order, known = list(range(len(keys))), list[int](), dict[Any, int]()
    for key in sorted(groups):  # constants first
        members = sorted(groups[key], key=lambda k: [place[n] for n in sorted(arguments[k], key=lambda n: keys[n][0])])
        for k in members:
            given = (key, *(place[n] for n in arguments[k])) if arguments[k] else k
            place[k] = known.setdefault(given, first + len(order))  # what is the same is taken once
            if place[k] == first + len(order):
                order.append(k)
    constants = first + len(numbers)
    values = np.concatenate([np.zeros(states), parameters, numbers, np.zeros(first + len(order) - constants)])
    kind = np.array([keys[k] for k in order[len(numbers) :]]).reshape(-1, 3)
    given_at = np.array([[place[arguments[k][n]] for n in (0, -1)] for k in order[len(numbers) :]]).reshape(-1, 2)
    steps = np.diff(given_at, axis=0, append=0)
    alike = np.append(False, np.all(kind[1:] == kind[:-1], axis=1))[: len(kind)]
    new = ~alike
    new[2:] |= alike[1:-1] & np.any(steps[1:-1] != steps[:-2], axis=1)
    at = np.flatnonzero(new)
    columns = [kind[at, 2], np.diff(at, append=len(kind)), constants + at, given_at[at, 0], steps[at, 0]]
    lists = np.column_stack([*columns, given_at[at, 1], steps[at, 1]])
    results = np.array([place[n or 0] for n in program.results[0]])
    return Structure(PROGRAM, states, int(np.sum(kind[at, 0] == 0)), len(at), lists, results, values)


def stepped(
    program: Structure, sequence: Sequence[Array], counts: Indices, steps: Array, states: Array, chained: bool = False
) -> None:
    """Take steps of q'' = f(q) from each of the states, (points, 2n), in their place.

    Arguments:
        program: of f.
        sequence: kicks and drifts.
        counts: numbers of steps, (points,).
        steps: their lengths, (points,).
        states: contiguous; where one is no longer finite, so are those that are chained to it.
        chained: whether all but the first begin where the one before ends.
    """
    _call("stepped", program, sequence[0].size, *sequence, chained, len(states), counts, steps, states)


# Steps of a chain with their derivatives: segments.c -----------------------------------------------------------------


def segments(
    sequence: tuple[Array, Array], chain: tuple[float, float, Array], counts: Indices, h: float, states: Array,
    multipliers: Array | None,
) -> tuple[Array, Array, Array | None]:  # fmt: skip
    """As `search.kick_flow.segments`, with kicks and drifts of a step, and stiffness, coupling, cubic terms."""
    (kicks, drifts), (stiffness, coupling, cubic), (count, size) = sequence, chain, states.shape
    given = Structure(CHAIN, size // 2, kicks.size, stiffness, coupling, kicks, drifts, cubic)
    after, jacobians = np.empty((count, size)), np.empty((count, size, size + 1))
    hessians = None if multipliers is None else np.empty((count, size + 1, size + 1))
    _call("segments", given, count, counts, h, states, multipliers, after, jacobians, hessians)
    return after, jacobians, hessians


# Variational flow along orbits: splitting.c --------------------------------------------------------------------------


def transitions(
    pattern: Pattern, reaches: tuple[int, int], sequence: tuple[Array, Array], steps: Array, jacobians: Array
) -> Array:
    """Transition matrices, (points, 2n, 2n), by kicks and drifts.

    Arguments:
        pattern: of J.
        reaches: of one kick, the half bandwidth of J, and of all, beyond which results are zero.
        sequence: kicks and drifts.
        steps: their lengths, (points,).
        jacobians: non-zeros of J at the kicks, (points, kicks, non-zeros).
    """
    (indptr, indices), (kicks, drifts) = pattern, sequence
    (points, count, nonzeros), size = jacobians.shape, indptr.size - 1
    if not jacobians[:1].flags.c_contiguous:
        jacobians = np.ascontiguousarray(jacobians)
    assert (kicks.size, drifts.size, nonzeros) == (count, count - 1, indices.size)
    result = np.zeros((points, 2 * size, 2 * size))
    data = indptr, indices, count, kicks, drifts, np.ascontiguousarray(steps), jacobians[:1]
    stride = jacobians.strides[0] // jacobians.itemsize
    _call("transitions", points, size, *reaches, *data, stride, result)
    return result


# Blocks of matrices at the nodes of intervals: decoupling.c ----------------------------------------------------------


def invariant(
    K: Numbers, same: Booleans, columns: Indices, levels: Levels, iterations: int, enough: float
) -> tuple[Numbers, Booleans]:
    """T at the nodes, in steps until one is no larger than `enough`, and for which intervals these are few.

    Arguments are those of `stability.tongues.blocks`: K (intervals, nodes, size, size), `same` (intervals, size,
    size), `columns` (intervals, columns).
    """
    intervals, nodes, size, _ = K.shape
    T = np.zeros((intervals, nodes, size, columns.shape[1]), dtype=K.dtype)
    done = np.zeros(intervals, dtype=bool)
    counts = np.array([[known.size, wanted.size] for known, wanted, _ in levels])
    numbers = np.concatenate([each for known, wanted, _ in levels for each in (known, wanted)])
    weights = np.concatenate([prediction.ravel() for _, _, prediction in levels])
    shape = intervals, nodes, size, columns.shape[1], K.itemsize // 8
    data = np.ascontiguousarray(K), np.ascontiguousarray(columns), np.ascontiguousarray(same)
    _call("invariant", *shape, *data, len(levels), counts, numbers, weights, iterations, enough, T, done)
    return T, done


def contracts(K: Numbers, same: Booleans, steps: int, small: float, largest: float) -> tuple[Numbers, Booleans]:
    """Diagonals of the blocks at the nodes, (intervals, nodes, size), and for which intervals steps become small."""
    intervals, nodes, size, _ = K.shape
    diagonals, done = np.zeros((intervals, nodes, size), dtype=K.dtype), np.zeros(intervals, dtype=bool)
    data = np.ascontiguousarray(K), np.ascontiguousarray(same), np.arange(size)
    _call("contracts", intervals, nodes, size, K.itemsize // 8, *data, steps, small, largest, diagonals, done)
    return diagonals, done


# A row of cells: elimination.c ---------------------------------------------------------------------------------------


def eliminated(
    blocks: Array, springs: Array, ends: tuple[int, int], sites: int, squares: Any
) -> tuple[Array, Any, Any]:
    """All cells but the first, for several squares of frequencies.

    Arguments:
        blocks: stiffness of all sidebands, shape (cells, size, size), at least two cells.
        springs: of the bond from each cell to the next, shape (cells - 1,).
        ends: sites of a cell and of the next one that a bond joins.
        sites: number of sites of a cell.
        squares: real or complex, shape (values, size).

    Returns:
        Logarithms and phases of the product of all determinants, (values,), and the inverse at the second cell,
        (values, size, size).

    Raises:
        numpy.linalg.LinAlgError: a pivot vanishes.
    """
    (values, size), is_complex = squares.shape, np.iscomplexobj(squares)
    parts = 2 if is_complex else 1
    assert blocks.shape[1:] == (size, size)
    assert springs.shape == (len(blocks) - 1,)
    data = np.ascontiguousarray(blocks), np.ascontiguousarray(springs)
    row = Structure(ROW, len(blocks), size, parts, sites, *ends, *data)
    split = np.ascontiguousarray(np.stack([squares.real, squares.imag][:parts], axis=1))
    inverse, logs, phases = np.empty((values, parts, size, size)), np.empty(values), np.empty((values, 2))
    room = np.empty(parts * size * size), np.empty(size, dtype=np.int64)
    _call("eliminated", row, values, split, inverse, logs, phases, *room)
    if not np.all(np.isfinite(logs)):
        raise np.linalg.LinAlgError("Singular matrix")
    if is_complex:
        return logs, phases[:, 0] + 1j * phases[:, 1], inverse[:, 0] + 1j * inverse[:, 1]
    return logs, phases[:, 0], inverse[:, 0]


# Maps over intervals, (maps, n, n), and multipliers of their product: interval_maps.c, multipliers.c ------------------

MOST_STATES = 16  # for which these are faster than numpy's products of matrices


def interval_maps(method: Structure, lengths: Array, jacobians: Array) -> tuple[Array, float]:
    """Maps over intervals by a method of kind METHOD from derivatives at stages (K, d, n, n), and log det of all."""
    K, d, n, _ = jacobians.shape
    maps, contraction = np.empty((K, n, n)), np.empty(1)
    memory = np.empty(LANES * ((d * n) ** 2 + (3 * d + 2) * n * n) + (d * n) ** 2)
    _call("interval_maps", method, K, n, lengths, np.ascontiguousarray(jacobians), maps, contraction, memory)
    return maps, float(contraction[0])


def multipliers(
    maps: Array, known: tuple[int, Array, Array], units: Array, product: Sequence[float], rounding: bool, frame: Array
) -> Array:
    """Multipliers of maps (K, n, n) as `stability.closed_maps` has them: the steps are described there.

    Arguments:
        maps: of at most MOST_STATES states.
        known: number of trivial multipliers, their directions and their gradients.
        units: of the states.
        product: sign and logarithm of its determinant; that is NaN where it is not known.
        rounding: whether what rounding makes of them is wanted.
        frame: an orthogonal matrix in general position.

    Returns:
        In a row n logarithms, real and imaginary parts of the phases, and what rounding makes of those that are not
        trivial; the product of the maps; and how many are trivial, the logarithm of the product's size, its norm in
        balanced units, and whether a periodic Schur form was needed.

    Raises:
        numpy.linalg.LinAlgError: eigenvalues do not converge.
    """
    K, n, _ = maps.shape
    trivial, right, left = known
    found, memory = np.empty(n * (n + 4) + 4), np.empty((8 * K + 40) * n * n + 20 * n + 4 * K)
    shape = K, n, right.shape[1], left.shape[1], trivial, product[1], product[0], rounding
    if kernels()["multipliers"](*shape, maps, right, left, units, frame, found, memory):
        raise np.linalg.LinAlgError("Eigenvalues did not converge")
    return found


# Power series of branches: taylor.c ----------------------------------------------------------------------------------


class TaylorKernel:
    """Orders of a series in turn: `unknowns` has shape (orders + 1, sites * nodes + 2), Omega and parameter last.

    Arguments:
        unknowns: the array that orders are put into.
        second_derivative: matrix of d^2/dtheta^2 on the values at the nodes.
        at_zero: weights of the values at the nodes in that at phase zero.
        force: terms of the right-hand side.
        norm: terms of the normalisation, of the states at phase zero.
    """

    def __init__(
        self,
        unknowns: Array,
        second_derivative: Array,
        at_zero: Array,
        force: Sequence[Monomials],
        norm: Sequence[Monomials],
    ) -> None:
        (orders, size), nodes = unknowns.shape, at_zero.size
        sites, highest = (size - 2) // nodes, max([1, *(group.power for group in (*force, *norm))])
        shapes = (orders, sites * nodes), (orders, sites), (highest + 1, orders), orders, size
        room = [np.zeros(shape) for shape in shapes]
        data = second_derivative, at_zero, unknowns, *room
        terms = (*_with_products(force, orders * nodes), *_with_products(norm, orders))
        self._series = Structure(SERIES, nodes, sites, orders - 1, size, highest, *data, *terms)
        self._unknowns, self._right_side = unknowns, room[-1]

    def put(self, k: int, z: Array) -> None:
        """Take over order k and complete what depends on it."""
        self._unknowns[k] = z
        _call("series_put", self._series, k)

    def right_side(self, k: int) -> Array:
        """Right-hand side of order k, shape (size,); its array is used again."""
        _call("series_right", self._series, k)
        return self._right_side

    def solve_all(self, layout: Structure, factors: Array, tail: Structure | None) -> None:
        """All orders beyond the first two, by factors in the memory of a `BorderedKernel`, with a tail or without."""
        _call("series_solve", self._series, tail, layout, factors)


def _with_products(groups: Sequence[Monomials], length: int) -> tuple[Any, ...]:
    """Terms with where their products of two, three, ... states begin, `length` numbers each, and room for these."""
    terms = _terms([group for group in groups if group.power + group.degree > 1])  # of others an order has no part
    ends = np.cumsum(np.maximum(terms[2] - 1, 0) * length)
    first = np.concatenate([np.zeros(1, dtype=np.int64), ends])
    return *terms, first, np.zeros(first[-1])
