"""Where mu can leave [-1, 0] along a series of matrices: intervals are halved until every block has one or two mu.

No place of an instability is looked for by sampling: an interval is done when its matrices come apart in blocks that
cannot meet, and on blocks of one or two mu the edges of instabilities are zeros of polynomials, all of which are found.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.blocks import (
    MIDDLE_NODE,
    Blocks,
    Booleans,
    Matrices,
    are_rough,
    blocks_of,
    tails_of,
)
from casadi_skin.stability.tongues.chebyshev import SERIES_DEGREE
from casadi_skin.stability.tongues.diagram import signatures_of
from casadi_skin.stability.tongues.interpolation import FAILURE_ERRORS, Gap, MatrixSeries, Search, in_words
from casadi_skin.stability.tongues.pairs import FINE_DEGREE, Block, complex_blocks, find_segments, real_blocks
from casadi_skin.stability.tongues.rotation import Spectrum
from casadi_skin.zero.problem import Array, Indices

SHORTEST_INTERVAL = 1e-9  # of the piece of branch that an interval is a part of: a shorter one is given up
ENTRIES_AT_A_TIME = 200_000  # of matrices that are taken apart at a time: what stays in the cache of a core
SHORT_INTERVAL = 1e-3  # of the piece: an interval shorter than that whose linear algebra fails is given up
BATCH_WORK = 2e7  # work on intervals that are looked at together, from small coordinates on
FIRST_INTERVALS = 4  # of a series: on fewer few come apart
LARGE_SERIES_ROWS = 16  # of matrices whose whole series is tried first: four intervals cost more than one in vain
NOT_LOOKED_AT = "not looked at: the limit of work is reached"
MANY_MEET_WORDS = "more than two multipliers meet in one place, as far as errors show"


@dataclass(frozen=True)
class Interval:
    """A part of the interval of a series; `whole` is the length of the piece of branch that it is a part of."""

    series: MatrixSeries
    start: float
    end: float
    whole: float

    @property
    def halves(self) -> Sequence[Interval]:
        """Both halves; of the whole of a large series the equal intervals that others begin with."""
        if self.series.size > LARGE_SERIES_ROWS and self.end - self.start == self.whole:
            return _equal_parts(self.series, FIRST_INTERVALS)
        middle = 0.5 * (self.start + self.end)
        return replace(self, end=middle), replace(self, start=middle)

    def nodes(self, degree: int) -> Array:
        """Coordinates of the nodes of any degree."""
        return self.start + 0.5 * (self.end - self.start) * (1.0 + chebyshev.nodes(degree))

    @property
    def is_shortest(self) -> bool:
        """Whether it is given up rather than halved."""
        return self.end - self.start <= SHORTEST_INTERVAL * self.whole

    def halves_of_block(self, k: Array, errors: Array, noise: Array) -> Sequence[Interval]:
        """The halves, with the matrices of one of its blocks alone, (J, 3 or 1, m, m)."""
        coefficients = chebyshev.combined(chebyshev.transform(len(k) - 1), k[None])[0]
        return replace(self, series=MatrixSeries(self.start, self.end, coefficients, errors, noise)).halves


def find_crossings(
    series: Sequence[MatrixSeries], found: Search, work: float = np.inf, whole: int | None = None
) -> None:
    """Every instability along series of matrices.

    Arguments:
        series: matrices on intervals, from small coordinates on.
        found: gets unstable segments with their edges; gaps where they are not found.
        work: `found.work` from which on nothing more is looked at; what remains are gaps.
        whole: number of rows of series that have every mu, whose spectra are kept; that of the first by default.
    """
    whole = series[0].size if whole is None else whole
    waiting = [interval for each in series if each.size for interval in first_intervals(each)]
    known: list[Block] = []
    while waiting:
        if found.work >= work:
            found.gaps += [Gap(interval.start, interval.end, NOT_LOOKED_AT) for interval in waiting]
            break
        sums = np.cumsum([float(interval.series.size) ** 3 for interval in waiting])
        count = int(np.searchsorted(sums, BATCH_WORK)) + 1
        halves = _generation(waiting[:count], found, whole, known)
        waiting = sorted([*halves, *waiting[count:]], key=lambda interval: interval.start)
    find_segments(known)
    for block in known:
        found.segments += block.segments or ()
        if block.definite:
            found.passages += block.meetings_without_instability()


def first_intervals(series: MatrixSeries) -> list[Interval]:
    """The equal intervals to begin with."""
    return _equal_parts(series, 1 if series.size > LARGE_SERIES_ROWS else FIRST_INTERVALS)


def _equal_parts(series: MatrixSeries, count: int) -> list[Interval]:
    stops = np.linspace(series.start, series.end, count + 1).tolist()
    return [Interval(series, a, b, series.end - series.start) for a, b in pairwise(stops)]


@dataclass
class _Part:
    """An interval and what comes out of it: blocks of one or two mu, halves of larger ones, and the rest.

    `rough` are blocks whose series need more nodes: their columns, matrices like errors, and bounds on their norms.
    """

    interval: Interval
    too_long: bool
    blocks: list[Block] = field(default_factory=list)
    larger: list[Interval] = field(default_factory=list)
    rough: list[tuple[Indices, Array, Array]] = field(default_factory=list)


def _generation(intervals: Sequence[Interval], found: Search, whole: int, known: list[Block]) -> list[Interval]:
    """Look at intervals; returns their halves, or those of blocks in them, that are still to be looked at.

    The blocks of the others are added to those that are `known`.
    """
    parts = [part for batch in _batches(intervals) for part in _looked_at(batch, found, whole)]
    longer = [part for part in parts if not part.too_long and not part.interval.is_shortest]
    find_segments([block for part in longer for block in part.blocks if block.is_coarse])
    waiting: list[Interval] = []
    for part in parts:
        if part.too_long and part.interval.is_shortest:
            found.gaps.append(Gap(part.interval.start, part.interval.end, MANY_MEET_WORDS))
        elif part.too_long or any(block.is_blurred for block in part.blocks):
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


def _looked_at(batch: Sequence[Interval], found: Search, whole: int) -> list[_Part]:
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


def _take_apart(batch: Sequence[Interval], found: Search, whole: int) -> Iterator[_Part]:
    """Blocks of intervals of one size."""
    size = batch[0].series.size
    found.intervals[size] = found.intervals.get(size, 0) + len(batch)
    matrices, errors = _at_nodes(batch)
    for chosen, blocks in blocks_of(matrices, errors):
        parts = [_Part(batch[k], not done) for k, done in zip(chosen.tolist(), blocks.done.tolist(), strict=True)]
        bounds = np.array([(part.interval.start, part.interval.end) for part in parts])
        if size == whole:
            signatures = signatures_of(blocks.mu, blocks.vectors, matrices[chosen, MIDDLE_NODE])
            half = 0.5 * (bounds[:, 1:] - bounds[:, :1])
            rows = (bounds[:, 0] + half[:, 0]).tolist(), blocks.mu, blocks.rates.astype(complex) / half, signatures
            found.spectra += [Spectrum(*row) for row in zip(*rows, strict=True)]
        shortest = np.array([part.interval.is_shortest for part in parts])
        for those in blocks.matrices(bounds, np.stack([part.interval.series.noise for part in parts])):
            _sort(parts, those, shortest)
        for i, part in enumerate(parts):
            if part.rough:
                _refine(part, blocks, i)
        yield from parts


def _at_nodes(batch: Sequence[Interval]) -> tuple[Array, Array]:
    """The matrices of intervals, and matrices like their errors, (intervals, J, 3 or 1, m, m) each."""
    groups: dict[int, list[int]] = defaultdict(list)
    for i, interval in enumerate(batch):
        groups[id(interval.series)].append(i)
    shape = SERIES_DEGREE + 1, *batch[0].series.coefficients.shape[1:]
    matrices, errors = np.empty((len(batch), *shape)), np.empty((len(batch), *shape))
    for numbers in groups.values():
        series, places = batch[numbers[0]].series, np.concatenate([batch[i].nodes(SERIES_DEGREE) for i in numbers])
        matrices[numbers], errors[numbers] = (
            each.reshape(-1, *shape) for each in (series.at(places), series.errors_at(places))
        )
    return matrices, errors


def _sort(parts: Sequence[_Part], found: Matrices, shortest: Booleans) -> None:
    """Put the blocks of one number of mu of intervals where they belong."""
    if not found.is_real.all():
        those = found.take(~found.is_real)
        for i, block in zip(those.owners.tolist(), complex_blocks(those), strict=True):
            parts[i].blocks.append(block)
    if not found.is_real.any():
        return
    those = found.take(found.is_real)
    again, blocks = those.rough & ~shortest[those.owners], list[Block | None]()
    if those.members.shape[1] > 2:
        rest = ~are_definite(those.parts)
    else:
        blocks, quiet, too_long = real_blocks(those)
        again, rest = again & ~quiet & those.coarse, ~quiet
    for n, i in enumerate(those.owners.tolist()):
        if again[n] and rest[n]:
            parts[i].rough.append((those.members[n], those.errors[n], those.noise[n]))
        elif not blocks and rest[n]:
            noise = those.noise[n] + those.tails[n]
            parts[i].larger += parts[i].interval.halves_of_block(those.parts[n], those.errors[n], noise)
        elif blocks:
            parts[i].too_long = parts[i].too_long or bool(too_long[n])
            parts[i].blocks += [block for block in blocks[n : n + 1] if block is not None]


def _refine(part: _Part, blocks: Blocks, i: int) -> None:
    """Give series of a higher degree to some blocks of an interval, whose halves are then looked at on their own."""
    fine = part.interval.series.at(part.interval.nodes(FINE_DEGREE))
    found, first = blocks.finer(i, np.concatenate([members for members, _, _ in part.rough]), fine), 0
    for members, errors, noise in part.rough:
        inside = slice(first, first + members.size)
        first += members.size
        k = None if found is None else found[:, :, inside, inside].real
        if k is None or are_rough(k[None], tails := tails_of(k[None]))[0]:
            part.too_long = True
            return
        part.larger += part.interval.halves_of_block(k, errors, noise + tails[0])


def are_definite(parts: Array) -> Booleans:
    """For which blocks P and Q are definite, of opposite signs, on all of the interval: their mu stay in (-1, 0)."""
    if parts.shape[2] == 1:
        return np.zeros(len(parts), dtype=bool)
    coefficients = chebyshev.combined(chebyshev.transform(SERIES_DEGREE), parts).swapaxes(0, 1)
    found, signs = np.ones(len(parts), dtype=bool), []
    for form in (coefficients[:, :, 1], coefficients[:, :, 2]):
        values, vectors = np.linalg.eigh(0.5 * (form[0] + form[0].swapaxes(-1, -2)))
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = vectors / np.sqrt(np.abs(values))[:, None]
            rest = scale.swapaxes(1, 2) @ form[1:] @ scale
            bounded = np.sum(np.linalg.norm(rest, axis=(2, 3)), axis=0) < 1.0
        found &= bounded & (np.min(values, axis=1) * np.max(values, axis=1) > 0.0)
        signs.append(np.sign(values[:, 0]))
    return np.asarray(found & (signs[0] * signs[1] < 0.0))
