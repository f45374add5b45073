"""Where mu can leave [-1, 0] along a series of matrices: intervals are cut until every block has one or two mu.

No place of an instability is looked for by sampling: an interval is done when its matrices come apart in blocks that
cannot meet, and on blocks of one or two mu the edges of instabilities are zeros of polynomials, all of which are found.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from casadi_skin.model.arguments import in_words
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.blocks import (
    MIDDLE_NODE,
    Blocks,
    Booleans,
    Matrices,
    blocks_of,
)
from casadi_skin.stability.tongues.chebyshev import SERIES_DEGREE
from casadi_skin.stability.tongues.diagram import signatures_of
from casadi_skin.stability.tongues.interpolation import (
    FAILURE_ERRORS,
    Gap,
    MatrixSeries,
    Search,
)
from casadi_skin.stability.tongues.pairs import Block, complex_blocks, find_segments, real_blocks
from casadi_skin.stability.tongues.rotation import Spectrum
from casadi_skin.zero.problem import Array

SHORTEST_INTERVAL = 1e-9  # of the piece of branch that an interval is a part of: a shorter one is given up
ENTRIES_AT_A_TIME = 200_000  # of matrices that are taken apart at a time: what stays in the cache of a core
SHORT_INTERVAL = 1e-3  # of the piece: an interval shorter than that whose linear algebra fails is given up
BATCH_WORK = 2e7  # work on intervals that are looked at together, from small coordinates on
FIRST_INTERVALS = 4  # of a series: edges found on the whole of it have a hundred times the error
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

    def parts(self, count: int) -> list[Interval]:
        """Equal parts."""
        stops = np.linspace(self.start, self.end, count + 1).tolist()
        return [replace(self, start=a, end=b) for a, b in pairwise(stops)]

    def nodes(self, degree: int) -> Array:
        """Coordinates of the nodes of any degree."""
        return self.start + 0.5 * (self.end - self.start) * (1.0 + chebyshev.nodes(degree))

    @property
    def is_shortest(self) -> bool:
        """Whether it is given up rather than cut."""
        return self.end - self.start <= SHORTEST_INTERVAL * self.whole

    def parts_of_block(self, k: Array, errors: Array, noise: Array) -> list[Interval]:
        """Parts with the matrices of one of its blocks alone, (J, 3 or 1, m, m)."""
        coefficients = chebyshev.combined(chebyshev.transform(len(k) - 1), k[None])[0]
        return replace(self, series=MatrixSeries(self.start, self.end, coefficients, errors, noise)).parts(2)


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
        parts = _generation(waiting[:count], found, whole, known)
        waiting = sorted([*parts, *waiting[count:]], key=lambda interval: interval.start)
    find_segments(known)
    for block in known:
        found.segments += block.segments or ()
        if block.definite:
            found.passages += block.meetings_without_instability()


def first_intervals(series: MatrixSeries) -> list[Interval]:
    """The intervals to begin with."""
    whole = Interval(series, series.start, series.end, series.end - series.start)
    return whole.parts(1 if series.size > LARGE_SERIES_ROWS else FIRST_INTERVALS)


@dataclass
class _Part:
    """An interval and what comes out of it: blocks of one or two mu, parts of larger ones, and the rest.

    It is number `place` of those that `apart` are the blocks of.
    """

    interval: Interval
    apart: Blocks
    place: int
    too_long: bool
    blocks: list[Block] = field(default_factory=list)
    larger: list[Interval] = field(default_factory=list)


def _generation(intervals: Sequence[Interval], found: Search, whole: int, known: list[Block]) -> list[Interval]:
    """Look at intervals; returns their parts, or those of blocks in them, that are still to be looked at.

    The blocks of the others are added to those that are `known`. Where linear algebra fails intervals are looked at
    fewer at a time, and a single one is cut, or is a gap where it is short.
    """
    try:
        parts = _take_apart(intervals, found, whole)
    except FAILURE_ERRORS as error:
        if len(intervals) > 1:
            half = len(intervals) // 2
            parts_of = [_generation(some, found, whole, known) for some in (intervals[:half], intervals[half:])]
            return [*parts_of[0], *parts_of[1]]
        (interval,) = intervals
        if interval.end - interval.start > SHORT_INTERVAL * interval.whole:
            return interval.parts(2)
        found.gaps.append(Gap(interval.start, interval.end, in_words(error)))
        return []
    longer = [part for part in parts if not part.too_long and not part.interval.is_shortest]
    find_segments([block for part in longer for block in part.blocks if block.is_coarse])
    waiting: list[Interval] = []
    for part in parts:
        if part.too_long and part.interval.is_shortest:
            found.gaps.append(Gap(part.interval.start, part.interval.end, MANY_MEET_WORDS))
        elif part.too_long or any(block.is_blurred for block in part.blocks):
            waiting += part.interval.parts(int(part.apart.parts[part.place]))
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


def _take_apart(intervals: Sequence[Interval], found: Search, whole: int) -> list[_Part]:
    """Blocks of intervals: those of one number of mu together, whatever matrices they come from."""
    parts, bundles = list[_Part](), defaultdict[tuple[int, bool], list[Matrices]](list)
    for batch in _batches(intervals):
        size, (matrices, errors) = batch[0].series.size, _at_nodes(batch)
        found.intervals[size] = found.intervals.get(size, 0) + len(batch)
        for chosen, blocks in blocks_of(matrices, errors):
            those, first = [batch[k] for k in chosen.tolist()], len(parts)
            bounds = np.array([(interval.start, interval.end) for interval in those])
            if size == whole:
                signatures = signatures_of(blocks.mu, blocks.vectors, matrices[chosen, MIDDLE_NODE])
                half = 0.5 * (bounds[:, 1:] - bounds[:, :1])
                rows = (bounds[:, 0] + half[:, 0]).tolist(), blocks.mu, blocks.rates.astype(complex) / half, signatures
                found.spectra += [Spectrum(*row) for row in zip(*rows, strict=True)]
            done = blocks.done.tolist()
            parts += [_Part(each, blocks, i, not done[i]) for i, each in enumerate(those)]
            for of_size in blocks.matrices(bounds, np.stack([interval.series.noise for interval in those]), first):
                for is_real in np.unique(of_size.is_real).tolist():
                    some = of_size.take(of_size.is_real == is_real)
                    bundles[some.members.shape[1], is_real].append(some)
    for bundle in bundles.values():
        _sort(parts, Matrices.joined(bundle))
    return parts


def _at_nodes(batch: Sequence[Interval]) -> tuple[Array, Array]:
    """The matrices of intervals, and matrices like their errors, (intervals, J, 3 or 1, m, m) each."""
    of_series: dict[int, list[int]] = defaultdict(list)
    for i, interval in enumerate(batch):
        of_series[id(interval.series)].append(i)
    shape = len(batch), SERIES_DEGREE + 1, *batch[0].series.coefficients.shape[1:]
    matrices, errors = np.empty(shape), np.empty(shape)
    for numbers in of_series.values():
        series, places = batch[numbers[0]].series, np.stack([batch[i].nodes(SERIES_DEGREE) for i in numbers])
        matrices[numbers], errors[numbers] = series.at(places), series.errors_at(places)
    return matrices, errors


def _sort(parts: Sequence[_Part], those: Matrices) -> None:
    """Put blocks of one number of mu, all real or none, where they belong."""
    owners, blocks = [parts[i] for i in those.owners.tolist()], list[Block | None]()
    if not those.is_real.all():
        for part, block in zip(owners, complex_blocks(those), strict=True):
            part.blocks.append(block)
        return
    again = those.rough & ~np.array([part.interval.is_shortest for part in owners], dtype=bool)
    if those.members.shape[1] > 2:
        rest = ~are_definite(those.parts)
    else:
        blocks, quiet, too_long = real_blocks(those)
        again, rest = again & ~quiet & those.coarse, ~quiet
    for n, part in enumerate(owners):
        if again[n] and rest[n]:
            part.too_long = True
        elif not blocks and rest[n]:
            noise = those.noise[n] + those.tails[n]
            part.larger += part.interval.parts_of_block(those.parts[n], those.errors[n], noise)
        elif blocks:
            part.too_long = part.too_long or bool(too_long[n])
            part.blocks += [block for block in blocks[n : n + 1] if block is not None]


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
