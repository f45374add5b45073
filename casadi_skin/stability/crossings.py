"""Where mu can leave [-1, 0] along a series of matrices: intervals are halved until every block has one or two mu.

No place of an instability is looked for by sampling: an interval is done when its matrices come apart in blocks that
cannot meet, and on blocks of one or two mu the edges of instabilities are zeros of polynomials, all of which are found.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.stability import chebyshev
from casadi_skin.stability.blocks import Blocks, blocks_of, comes_apart
from casadi_skin.stability.decoupling import DEGREE, MIDDLE, Indices
from casadi_skin.stability.interpolation import FAILURES, Gap, MatrixSeries, in_words
from casadi_skin.stability.pairs import PairBlock, Pairs
from casadi_skin.stability.rotation import Spectrum
from casadi_skin.stability.small_blocks import Block, ComplexBlock, Segment, SingleBlock
from casadi_skin.stability.zeros import Function

SHORTEST = 1e-9  # of the series that an interval belongs to: a shorter one is given up
ENTRIES = 200_000  # of matrices that are taken apart at a time: what stays in the cache of a core
SHORT = 1e-3  # of the series: an interval shorter than that whose linear algebra fails is given up
OVERHEAD = 3e4  # of an eigenvalue problem of any size, in units of m^3: measured, about a millisecond
BATCH_WORK = 2e7  # work on intervals that are looked at together, from small coordinates on
ACCURATE = 1e-9  # of a block's entries: what its series may leave out
FINE = 2 * DEGREE  # degree of the series of a block that needs more than the others of its interval
MOST = 4096  # intervals of a series to begin with


@dataclass(frozen=True)
class Interval:
    """A part of the interval of a series."""

    series: MatrixSeries
    start: float
    end: float

    @property
    def halves(self) -> tuple[Interval, Interval]:
        """Both halves."""
        middle = 0.5 * (self.start + self.end)
        return Interval(self.series, self.start, middle), Interval(self.series, middle, self.end)

    @property
    def places(self) -> Array:
        """Coordinates of the nodes, shape (DEGREE + 1,)."""
        return self.nodes(DEGREE)

    def nodes(self, degree: int) -> Array:
        """Coordinates of the nodes of any degree."""
        return self.start + 0.5 * (self.end - self.start) * (1.0 + chebyshev.nodes(degree))

    @property
    def is_shortest(self) -> bool:
        """Whether it is given up rather than halved."""
        return self.end - self.start <= SHORTEST * (self.series.end - self.series.start)


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
        return float(sum(count * (size**3 + OVERHEAD) for size, count in self.intervals.items()))


def find_crossings(
    series: MatrixSeries, found: Crossings, work: float = np.inf, progress: Callable[[float], None] | None = None
) -> None:
    """Every instability along a series of matrices.

    Arguments:
        series: matrices on an interval.
        found: gets unstable segments with their edges; gaps where they are not found.
        work: `found.work` from which on nothing more is looked at; what remains are gaps.
        progress: called with the coordinate up to which everything is looked at.
    """
    if not series.size:
        return
    waiting = _first(series, found)
    while waiting:
        if found.work >= work:
            found.gaps += [Gap(interval.start, interval.end, NOT_LOOKED_AT) for interval in waiting]
            break
        sums = np.cumsum([float(interval.series.size) ** 3 for interval in waiting])
        count = int(np.searchsorted(sums, BATCH_WORK)) + 1
        halves = _generation(waiting[:count], found, series.size)
        waiting = sorted([*halves, *waiting[count:]], key=lambda interval: interval.start)
        if progress is not None:
            progress(waiting[0].start if waiting else series.end)


def _first(series: MatrixSeries, found: Crossings) -> list[Interval]:
    """The intervals to begin with; the whole series is a gap where its linear algebra fails."""
    try:
        return first_intervals(series)
    except FAILURES as error:
        found.gaps.append(Gap(series.start, series.end, in_words(error)))
        return []


def first_intervals(series: MatrixSeries) -> list[Interval]:
    """Equal intervals so short that, at the middle of the series, few mu can meet on each."""
    middle, half, parts = 0.5 * (series.start + series.end), 0.5 * (series.end - series.start), 1
    while parts < MOST and series.size > 2:
        places = middle + half / parts * chebyshev.nodes(DEGREE)
        if comes_apart(series.at(places)[:, 0]):
            break
        parts *= 2
    stops = np.linspace(series.start, series.end, parts + 1).tolist()
    return [Interval(series, a, b) for a, b in pairwise(stops)]


@dataclass
class _Part:
    """An interval and what comes out of it: blocks of one mu or off the real axis, pairs, and larger blocks."""

    interval: Interval
    too_long: bool
    blocks: list[Block] = field(default_factory=list)
    pairs: list[tuple[Array, Array, Array, Array]] = field(default_factory=list)
    larger: list[Interval] = field(default_factory=list)


def _generation(intervals: Sequence[Interval], found: Crossings, whole: int) -> list[Interval]:
    """Look at intervals; returns their halves, or those of blocks in them, that are still to be looked at."""
    parts = [part for batch in _batches(intervals) for part in _looked_at(batch, found, whole)]
    _finish_pairs(parts)
    Function.find_zeros([f for part in parts if not part.too_long for block in part.blocks for f in block.functions])
    waiting: list[Interval] = []
    for part in parts:
        if part.too_long and part.interval.is_shortest:
            reason = "more than two multipliers meet in one place, as far as errors show"
            found.gaps.append(Gap(part.interval.start, part.interval.end, reason))
        elif part.too_long or (not part.interval.is_shortest and any(block.is_blurred for block in part.blocks)):
            waiting += part.interval.halves
        else:
            waiting += part.larger
            for block in part.blocks:
                found.segments += block.segments
                if isinstance(block, PairBlock) and block.definite:
                    found.passages += block.meetings_without_instability()
    return waiting


def _batches(intervals: Sequence[Interval]) -> Iterator[list[Interval]]:
    """Intervals of one size each, as many as are best taken together."""
    by_size: dict[int, list[Interval]] = defaultdict(list)
    for interval in intervals:
        by_size[interval.series.size].append(interval)
    for size, group in by_size.items():
        most = max(1, ENTRIES // (size * size * (DEGREE + 1)))
        yield from (group[first : first + most] for first in range(0, len(group), most))


def _looked_at(batch: Sequence[Interval], found: Crossings, whole: int) -> list[_Part]:
    """Blocks of intervals of one size; those whose linear algebra fails are too long, or gaps where they are short."""
    try:
        return list(_take_apart(batch, found, whole))
    except FAILURES as error:
        if len(batch) > 1:
            return [part for interval in batch for part in _looked_at([interval], found, whole)]
        (interval,) = batch
        if interval.end - interval.start > SHORT * (interval.series.end - interval.series.start):
            return [_Part(interval, True)]
        found.gaps.append(Gap(interval.start, interval.end, in_words(error)))
        return []


def _take_apart(batch: Sequence[Interval], found: Crossings, whole: int) -> Iterator[_Part]:
    """Blocks of intervals of one size."""
    size = batch[0].series.size
    found.intervals[size] = found.intervals.get(size, 0) + len(batch)
    matrices = np.stack([interval.series.at(interval.places) for interval in batch])
    for chosen, blocks in blocks_of(matrices):
        intervals = [batch[k] for k in chosen.tolist()]
        if size == whole:
            found.spectra += _spectra(intervals, matrices[chosen], blocks)
        errors = np.stack([interval.series.errors_at(interval.places) for interval in intervals])
        parts, changes = blocks.parts(matrices[chosen]), blocks.parts(errors)
        x, y = np.linalg.norm(blocks.right, axis=2), np.linalg.norm(blocks.left, axis=3)
        lengths = np.max(x, axis=1), np.max(y, axis=1)
        for i, interval in enumerate(intervals):
            part = _Part(interval, not blocks.done[i])
            if blocks.done[i]:
                _sort(part, blocks, i, parts[i], changes[i], (lengths[0][i], lengths[1][i]))
            yield part


def _sort(part: _Part, blocks: Blocks, i: int, parts: Array, changes: Array, lengths: tuple[Array, Array]) -> None:
    """Put the blocks of an interval where they belong."""
    interval, columns = part.interval, blocks.columns[i]
    labels = np.where(columns >= 0, blocks.labels[i][columns], -1)
    rough = []
    for label in np.unique(labels[labels >= 0]).tolist():
        members = np.flatnonzero(labels == label)
        k = parts[:, :, members[:, None], members]
        change = changes[:, :, members[:, None], members]
        tails = _tails(k)
        x, y = (float(np.linalg.norm(length[members])) for length in lengths)
        noise = interval.series.noise * np.array([x * y, x * x, y * y])[: interval.series.noise.size]
        if not blocks.real[i, columns[members]].all():
            part.blocks.append(ComplexBlock(interval.start, interval.end, k, np.abs(change), noise, tails))
            continue
        k, change = k.real, change.real
        if members.size == 1:
            block = SingleBlock(interval.start, interval.end, k, change, noise, tails)
            if block.is_quiet:
                continue
            if block.is_coarse and _is_rough(k, tails) and not interval.is_shortest:
                rough.append((members, change, noise))
            else:
                part.blocks.append(block)
        elif members.size > 2 and is_definite(k):
            pass
        elif _is_rough(k, tails) and not interval.is_shortest:
            rough.append((members, change, noise))
        elif members.size == 2:
            part.pairs.append((k, change, noise, tails))
        else:
            part.larger += _halves_of_block(interval, k, change, noise + tails)
    if rough:
        _refine(part, blocks, i, rough)


def _refine(part: _Part, blocks: Blocks, i: int, rough: Sequence[tuple[Indices, Array, Array]]) -> None:
    """Give series of a higher degree to some blocks of an interval, whose halves are then looked at on their own."""
    interval = part.interval
    members = np.concatenate([each for each, *_ in rough])
    found = blocks.finer(i, blocks.columns[i][members], interval.series.at(interval.nodes(FINE)))
    first = 0
    for each, change, noise in rough:
        inside = slice(first, first + each.size)
        first += each.size
        if found is not None:
            k = found[0][:, :, inside, inside].real
            tails = _tails(k)
        if found is None or _is_rough(k, tails):
            part.too_long = True
            return
        part.larger += _halves_of_block(interval, k, change, noise + tails)


def _tails(k: Array) -> Array:
    """Norms of what the series of the matrices of a block leave out, (J, 3 or 1, c, c) -> (3 or 1,)."""
    coefficients = np.tensordot(chebyshev.transform(len(k) - 1), k, 1)
    return np.asarray(np.sqrt(np.sum(chebyshev.tail(coefficients) ** 2, axis=(1, 2))))


def _is_rough(k: Array, tails: Array) -> bool:
    return bool(np.any(tails > ACCURATE * np.max(np.abs(k), axis=(0, 2, 3))))


def _halves_of_block(interval: Interval, k: Array, change: Array, noise: Array) -> tuple[Interval, Interval]:
    """Both halves of an interval, with the matrices of one of its blocks alone."""
    coefficients = np.tensordot(chebyshev.transform(len(k) - 1), k, 1)
    series = MatrixSeries(interval.start, interval.end, coefficients, change, noise)
    return Interval(series, interval.start, interval.end).halves


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
    """Spectra at the middles of intervals."""
    forms = np.zeros(blocks.mu.shape)
    if matrices.shape[2] == 3:
        forms = np.sum(blocks.vectors * (matrices[:, MIDDLE, 1] @ blocks.vectors), axis=1).real
    mu = blocks.mu
    on_circle = (mu.imag == 0.0) & (mu.real > -1.0) & (mu.real < 0.0)
    signatures = np.where(on_circle, -np.sign(forms), 0.0).astype(np.int64)
    for i, interval in enumerate(batch):
        half = 0.5 * (interval.end - interval.start)
        yield Spectrum(interval.start + half, mu[i], blocks.rates[i].astype(complex) / half, signatures[i])


def is_definite(parts: Array) -> bool:
    """Whether P and Q are definite, of opposite signs, on all of a block's interval: then its mu stay in (-1, 0)."""
    if parts.shape[1] == 1:
        return False
    coefficients = np.tensordot(chebyshev.transform(DEGREE), parts, 1)
    signs = []
    for form in (coefficients[:, 1], coefficients[:, 2]):
        values, vectors = np.linalg.eigh(0.5 * (form[0] + form[0].T))
        if np.min(values) * np.max(values) <= 0.0:
            return False
        scale = vectors / np.sqrt(np.abs(values))
        rest = scale.T @ form[1:] @ scale
        if np.sum(np.linalg.norm(rest, axis=(1, 2))) >= 1.0:
            return False
        signs.append(np.sign(values[0]))
    return bool(signs[0] * signs[1] < 0.0)
