"""Where mu can leave [-1, 0] along a series of matrices: intervals are halved until every block has one or two mu.

No place of an instability is looked for by sampling: an interval is done when its matrices come apart in blocks that
cannot meet, and on blocks of one or two mu the edges of instabilities are zeros of polynomials, all of which are found.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np

from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.blocks import (
    MIDDLE_NODE,
    Blocks,
    Booleans,
    Indices,
    Numbers,
    blocks_of,
    comes_apart,
)
from casadi_skin.stability.tongues.chebyshev import SERIES_DEGREE
from casadi_skin.stability.tongues.diagram import signatures_of
from casadi_skin.stability.tongues.interpolation import FAILURE_ERRORS, Gap, MatrixSeries, in_words
from casadi_skin.stability.tongues.pairs import (
    Block,
    ComplexBlock,
    PairBlock,
    Pairs,
    Segment,
    SingleBlock,
    find_segments,
    is_coarse,
    single_functions,
)
from casadi_skin.stability.tongues.rotation import Spectrum
from casadi_skin.zero.problem import Array

SHORTEST_INTERVAL = 1e-9  # of the piece of branch that an interval is a part of: a shorter one is given up
ENTRIES_AT_A_TIME = 200_000  # of matrices that are taken apart at a time: what stays in the cache of a core
SHORT_INTERVAL = 1e-3  # of the piece: an interval shorter than that whose linear algebra fails is given up
EIGENVALUE_OVERHEAD = 3e4  # of an eigenvalue problem of any size, in units of m^3: measured, about a millisecond
BATCH_WORK = 2e7  # work on intervals that are looked at together, from small coordinates on
BLOCK_ENTRY_RTOL = 1e-9  # of a block's entries: what its series may leave out
SMALL_ROWS = 6  # rows: series whose matrices are stacked to be evaluated
FINE_DEGREE = 2 * SERIES_DEGREE  # degree of the series of a block that needs more than the others of its interval
MOST_INTERVALS = 4096  # intervals of a series to begin with


@dataclass(frozen=True)
class Interval:
    """A part of the interval of a series; `whole` is the length of the piece of branch that it is a part of."""

    series: MatrixSeries
    start: float
    end: float
    whole: float

    @property
    def halves(self) -> tuple[Interval, Interval]:
        """Both halves."""
        middle = 0.5 * (self.start + self.end)
        return replace(self, end=middle), replace(self, start=middle)

    def nodes(self, degree: int) -> Array:
        """Coordinates of the nodes of any degree."""
        return self.start + 0.5 * (self.end - self.start) * (1.0 + chebyshev.nodes(degree))

    @property
    def is_shortest(self) -> bool:
        """Whether it is given up rather than halved."""
        return self.end - self.start <= SHORTEST_INTERVAL * self.whole


NOT_LOOKED_AT = "not looked at: the limit of work is reached"


@dataclass
class Crossings:
    """Result of an analysis: unstable segments in any order, meetings without instability, and unresolved parts.

    `passages` are (coordinate, mu, distance) of pairs of one signature that meet within errors. `intervals` counts
    eigenvalue problems by their size; `spectra` are mu, their rates and signatures at some coordinates.
    """

    segments: list[Segment] = field(default_factory=list)
    passages: list[tuple[float, float, float]] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    intervals: dict[int, int] = field(default_factory=dict)
    spectra: list[Spectrum] = field(default_factory=list)

    @property
    def work(self) -> float:
        """Sum of m^3, and of what small ones cost as well, over the eigenvalue problems."""
        return float(sum(count * (size**3 + EIGENVALUE_OVERHEAD) for size, count in self.intervals.items()))


def find_crossings(
    series: Sequence[MatrixSeries],
    found: Crossings,
    work: float = np.inf,
    progress: Callable[[float], None] | None = None,
    whole: int | None = None,
) -> None:
    """Every instability along series of matrices.

    Arguments:
        series: matrices on intervals, from small coordinates on.
        found: gets unstable segments with their edges; gaps where they are not found.
        work: `found.work` from which on nothing more is looked at; what remains are gaps.
        progress: called with the coordinate up to which everything is looked at.
        whole: number of rows of series that have every mu, whose spectra are kept; that of the first by default.
    """
    whole = series[0].size if whole is None else whole
    waiting = [interval for each in series if each.size for interval in _first(each, found)]
    known: list[Block] = []
    while waiting:
        if found.work >= work:
            found.gaps += [Gap(interval.start, interval.end, NOT_LOOKED_AT) for interval in waiting]
            break
        sums = np.cumsum([float(interval.series.size) ** 3 for interval in waiting])
        count = int(np.searchsorted(sums, BATCH_WORK)) + 1
        halves = _generation(waiting[:count], found, whole, known)
        waiting = sorted([*halves, *waiting[count:]], key=lambda interval: interval.start)
        if progress is not None:
            progress(waiting[0].start if waiting else series[-1].end)
    find_segments(known)
    for block in known:
        found.segments += block.segments
        if isinstance(block, PairBlock) and block.definite:
            found.passages += block.meetings_without_instability()


def _first(series: MatrixSeries, found: Crossings) -> list[Interval]:
    """The intervals to begin with; the whole series is a gap where its linear algebra fails."""
    try:
        return first_intervals(series)
    except FAILURE_ERRORS as error:
        found.gaps.append(Gap(series.start, series.end, in_words(error)))
        return []


def first_intervals(series: MatrixSeries) -> list[Interval]:
    """Equal intervals so short that, at the middle of the series, few mu can meet on each."""
    middle, half, parts = 0.5 * (series.start + series.end), 0.5 * (series.end - series.start), 1
    while parts < MOST_INTERVALS and series.size > 2:
        places = middle + half / parts * chebyshev.nodes(SERIES_DEGREE)
        if comes_apart(series.at(places)[:, 0]):
            break
        parts *= 2
    stops = np.linspace(series.start, series.end, parts + 1).tolist()
    return [Interval(series, a, b, series.end - series.start) for a, b in pairwise(stops)]


@dataclass
class _Part:
    """An interval and what comes out of it: blocks of one mu or off the real axis, pairs, and larger blocks."""

    interval: Interval
    too_long: bool
    blocks: list[Block] = field(default_factory=list)
    pairs: list[tuple[Array, Array, Array, Array]] = field(default_factory=list)
    larger: list[Interval] = field(default_factory=list)


def _generation(intervals: Sequence[Interval], found: Crossings, whole: int, known: list[Block]) -> list[Interval]:
    """Look at intervals; returns their halves, or those of blocks in them, that are still to be looked at.

    The blocks of the others are added to those that are `known`.
    """
    parts = [part for batch in _batches(intervals) for part in _looked_at(batch, found, whole)]
    _finish_pairs(parts)
    longer = [part for part in parts if not part.too_long and not part.interval.is_shortest]
    find_segments([block for part in longer for block in part.blocks if block.is_coarse])
    waiting: list[Interval] = []
    for part in parts:
        if part.too_long and part.interval.is_shortest:
            reason = "more than two multipliers meet in one place, as far as errors show"
            found.gaps.append(Gap(part.interval.start, part.interval.end, reason))
        elif part.too_long or (not part.interval.is_shortest and any(block.is_blurred for block in part.blocks)):
            waiting += part.interval.halves
        else:
            waiting += part.larger
            known += part.blocks
    return waiting


def _batches(intervals: Sequence[Interval]) -> Iterator[list[Interval]]:
    """Intervals of one size each, as many as are best taken together."""
    by_size: dict[int, list[Interval]] = defaultdict(list)
    for interval in intervals:
        by_size[interval.series.size].append(interval)
    for size, group in by_size.items():
        most = max(1, ENTRIES_AT_A_TIME // (size * size * (SERIES_DEGREE + 1)))
        yield from (group[first : first + most] for first in range(0, len(group), most))


def _looked_at(batch: Sequence[Interval], found: Crossings, whole: int) -> list[_Part]:
    """Blocks of intervals of one size; those whose linear algebra fails are too long, or gaps where they are short."""
    try:
        return list(_take_apart(batch, found, whole))
    except FAILURE_ERRORS as error:
        if len(batch) > 1:
            return [part for interval in batch for part in _looked_at([interval], found, whole)]
        (interval,) = batch
        if interval.end - interval.start > SHORT_INTERVAL * interval.whole:
            return [_Part(interval, True)]
        found.gaps.append(Gap(interval.start, interval.end, in_words(error)))
        return []


def _take_apart(batch: Sequence[Interval], found: Crossings, whole: int) -> Iterator[_Part]:
    """Blocks of intervals of one size."""
    size = batch[0].series.size
    found.intervals[size] = found.intervals.get(size, 0) + len(batch)
    matrices, errors = _at_nodes(batch)
    for chosen, blocks in blocks_of(matrices, errors):
        intervals = [batch[k] for k in chosen.tolist()]
        if size == whole:
            found.spectra += _spectra(intervals, matrices[chosen, MIDDLE_NODE], blocks)
        parts = [_Part(interval, not done) for interval, done in zip(intervals, blocks.done.tolist(), strict=True)]
        _sort(parts, blocks)
        yield from parts


def _at_nodes(batch: Sequence[Interval]) -> tuple[Array, Array]:
    """The matrices of intervals, and matrices like their errors, (intervals, J, 3 or 1, m, m) each.

    A large series is evaluated at all of its intervals together, small ones, with one or two of these each, side by
    side.
    """
    small = batch[0].series.size <= SMALL_ROWS
    groups: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for i, interval in enumerate(batch):
        series = interval.series
        groups[(len(series.coefficients), len(series.errors)) if small else (id(series),)].append(i)
    shape = SERIES_DEGREE + 1, *batch[0].series.coefficients.shape[1:]
    matrices, errors = np.empty((len(batch), *shape)), np.empty((len(batch), *shape))
    for numbers in groups.values():
        bounds = np.array([(batch[i].start, batch[i].end) for i in numbers])
        places = bounds[:, :1] + 0.5 * np.diff(bounds) * (1.0 + chebyshev.nodes(SERIES_DEGREE))
        every = [batch[i].series for i in (numbers if small else numbers[:1])]
        found = MatrixSeries.several_at(every, places.reshape(len(every), -1))
        matrices[numbers], errors[numbers] = (each.reshape(-1, *shape) for each in found)
    return matrices, errors


@dataclass(frozen=True)
class _Matrices:
    """Matrices of several blocks of one number of mu, with what bounds their errors: see `Block`.

    `owners` are the numbers of their intervals, `members` (blocks, m) the places of their mu among the columns.
    """

    owners: Indices
    members: Indices
    k: Numbers
    changes: Numbers
    noise: Array
    tails: Array

    def of(self, chosen: Booleans) -> _Matrices:
        """Those of some blocks."""
        if chosen.all():
            return self
        return _Matrices(*(getattr(self, each.name)[chosen] for each in fields(self)))

    @property
    def real(self) -> _Matrices:
        """The same as real matrices."""
        return replace(self, k=self.k.real, changes=self.changes.real)

    @property
    def rough(self) -> Booleans:
        """Which have series that leave out too much."""
        return _are_rough(self.k, self.tails)

    def __iter__(self) -> Iterator[tuple[int, Indices, Numbers, Numbers, Array, Array]]:
        owners = self.owners.tolist()
        return zip(owners, self.members, self.k, self.changes, self.noise, self.tails, strict=True)


def _sort(parts: Sequence[_Part], blocks: Blocks) -> None:
    """Put the blocks of intervals where they belong."""
    rough: list[_Matrices] = []
    for found, real in _by_size(parts, blocks):
        for i, _, k, changes, noise, tails in found.of(~real):
            start, end = parts[i].interval.start, parts[i].interval.end
            parts[i].blocks.append(ComplexBlock(start, end, k, np.abs(changes), noise, tails))
        those = found.of(real).real
        if not those.owners.size:
            continue
        shortest = np.array([part.interval.is_shortest for part in parts])[those.owners]
        if those.members.shape[1] == 1:
            rough.append(_singles(parts, those, shortest))
            continue
        if those.members.shape[1] > 2:
            open_ones = ~are_definite(those.k)
            those, shortest = those.of(open_ones), shortest[open_ones]
        again = those.rough & ~shortest
        rough.append(those.of(again))
        for i, _, k, changes, noise, tails in those.of(~again):
            if len(k[0, 0]) == 2:
                parts[i].pairs.append((k, changes, noise, tails))
            else:
                parts[i].larger += _halves_of_block(parts[i].interval, k, changes, noise + tails)
    entries = [entry for each in rough for entry in each]
    if entries:
        _refine(parts, blocks, entries)


def _by_size(parts: Sequence[_Part], blocks: Blocks) -> Iterator[tuple[_Matrices, Booleans]]:
    """The matrices of all blocks, by their numbers of mu, and which have real ones."""
    values, changes = blocks.forms.values, blocks.forms.changes
    x, y = blocks.forms.squares.swapaxes(0, 1)
    noise = np.stack([part.interval.series.noise for part in parts])
    for i, members in blocks.members():
        places = i[:, None, None], slice(None), slice(None), members[:, :, None], members[:, None, :]
        k, change = (each[places].transpose(0, 3, 4, 1, 2) for each in (values, changes))
        right, left = (np.sum(squares[i[:, None], members], axis=1) for squares in (x, y))
        scales = np.stack([np.sqrt(right * left), right, left], axis=1)[:, : noise.shape[1]]
        real = np.all(blocks.real[i[:, None], blocks.columns[i[:, None], members]], axis=1)
        yield _Matrices(i, members, k, change, noise[i] * scales, _tails(k)), np.asarray(real)


def _singles(parts: Sequence[_Part], those: _Matrices, shortest: Booleans) -> _Matrices:
    """Make blocks of one mu, but for those that are stable on their whole intervals; those that need finer series."""
    coefficients = chebyshev.transform(SERIES_DEGREE) @ those.k[..., 0, 0]
    functions = single_functions(coefficients, those.changes[..., 0, 0], those.noise + those.tails)
    loud = np.array([not (f.excludes_zero and g.excludes_zero and f(0.0) * g(0.0) <= 0.0) for f, g in functions])
    again = loud & is_coarse(those.changes, those.noise, those.tails) & those.rough & ~shortest
    kept = np.flatnonzero(loud & ~again)
    for n in kept.tolist():
        part = parts[int(those.owners[n])]
        matrices = those.k[n], those.changes[n], those.noise[n], those.tails[n]
        part.blocks.append(SingleBlock(part.interval.start, part.interval.end, *matrices, functions[n]))
    return those.of(again)


def _refine(
    parts: Sequence[_Part], blocks: Blocks, rough: Sequence[tuple[int, Indices, Numbers, Numbers, Array, Array]]
) -> None:
    """Give series of a higher degree to some blocks of intervals, whose halves are then looked at on their own."""
    by_owner: dict[int, list[tuple[int, Indices, Numbers, Numbers, Array, Array]]] = defaultdict(list)
    for entry in rough:
        by_owner[entry[0]].append(entry)
    numbers = np.array(sorted(by_owner))
    counts = [sum(entry[1].size for entry in by_owner[i]) for i in numbers.tolist()]
    columns = np.full((numbers.size, max(counts)), -1, dtype=np.int64)
    for n, i in enumerate(numbers.tolist()):
        columns[n, : counts[n]] = blocks.columns[i][np.concatenate([entry[1] for entry in by_owner[i]])]
    matrices = np.stack([parts[i].interval.series.at(parts[i].interval.nodes(FINE_DEGREE)) for i in numbers.tolist()])
    found, fine = blocks.finer(numbers, columns, matrices)
    for n, i in enumerate(numbers.tolist()):
        part, first = parts[i], 0
        part.too_long = not fine[n]
        for _, members, _, changes, noise, _ in by_owner[i]:
            inside = slice(first, first + members.size)
            first += members.size
            k = found[n][:, :, inside, inside].real
            tails = _tails(k[None])
            part.too_long = part.too_long or bool(_are_rough(k[None], tails)[0])
            if part.too_long:
                break
            part.larger += _halves_of_block(part.interval, k, changes, noise + tails[0])


def _tails(k: Numbers) -> Array:
    """Norms of what the series of the matrices of blocks leave out, (blocks, J, 3 or 1, m, m) -> (blocks, 3 or 1)."""
    last = chebyshev.transform(k.shape[1] - 1)[-chebyshev.TAIL_COEFFICIENTS :]
    left_out = np.sum(np.abs(chebyshev.combined(last, k)), axis=1)
    return np.asarray(np.sqrt(np.sum(left_out**2, axis=(2, 3))))


def _are_rough(k: Numbers, tails: Array) -> Booleans:
    return np.asarray(np.any(tails > BLOCK_ENTRY_RTOL * np.max(np.abs(k), axis=(1, 3, 4)), axis=1))


def _halves_of_block(interval: Interval, k: Array, change: Array, noise: Array) -> tuple[Interval, Interval]:
    """Both halves of an interval, with the matrices of one of its blocks alone."""
    coefficients = chebyshev.combined(chebyshev.transform(len(k) - 1), k[None])[0]
    series = MatrixSeries(interval.start, interval.end, coefficients, change, noise)
    return replace(interval, series=series).halves


def _finish_pairs(parts: Sequence[_Part]) -> None:
    """Make blocks of the pairs of all intervals at once, and mark the intervals that are too long for them."""
    owners = [part for part in parts if not part.too_long for _ in part.pairs]
    if not owners:
        return
    data = [pair for part in parts if not part.too_long for pair in part.pairs]
    pairs = Pairs(
        np.array([part.interval.start for part in owners]),
        np.array([part.interval.end for part in owners]),
        *(np.stack(arrays) for arrays in zip(*data, strict=True)),
    )
    for part, block in zip(owners, pairs.blocks(), strict=True):
        if block is None:
            part.too_long = True
        elif block.definite or not block.is_quiet:
            part.blocks.append(block)


def _spectra(batch: Sequence[Interval], matrices: Array, blocks: Blocks) -> Iterator[Spectrum]:
    """Spectra at the middles of intervals, from the matrices there."""
    signatures = signatures_of(blocks.mu, blocks.vectors, matrices)
    for i, interval in enumerate(batch):
        half = 0.5 * (interval.end - interval.start)
        yield Spectrum(interval.start + half, blocks.mu[i], blocks.rates[i].astype(complex) / half, signatures[i])


def are_definite(parts: Array) -> Booleans:
    """For which blocks P and Q are definite, of opposite signs, on all of the interval: their mu stay in (-1, 0)."""
    if parts.shape[2] == 1:
        return np.zeros(len(parts), dtype=bool)
    coefficients = chebyshev.combined(chebyshev.transform(SERIES_DEGREE), parts).swapaxes(0, 1)
    found, signs = np.ones(len(parts), dtype=bool), []
    for form in (coefficients[:, :, 1], coefficients[:, :, 2]):
        values, vectors = np.linalg.eigh(_symmetric(form[0]))
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = vectors / np.sqrt(np.abs(values))[:, None]
            rest = scale.swapaxes(1, 2) @ form[1:] @ scale
            bounded = np.sum(np.linalg.norm(rest, axis=(2, 3)), axis=0) < 1.0
        found &= bounded & (np.min(values, axis=1) * np.max(values, axis=1) > 0.0)
        signs.append(np.sign(values[:, 0]))
    return np.asarray(found & (signs[0] * signs[1] < 0.0))


def _symmetric(matrices: Array) -> Array:
    return np.asarray(0.5 * (matrices + matrices.swapaxes(-1, -2)))
