"""Every change of stability along a branch, for certain: the whole way from transition matrices to tongues.

The account of a family: multipliers outside the unit circle at its orbits are each beside the tongue that it is in.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from casadi_skin.stability.multipliers import POWERS_BY_FRACTION
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues.assembly import SAME_MU, Group, edges_of, groups_of, place_at, tongues_of
from casadi_skin.stability.tongues.crossings import NOT_LOOKED_AT, find_crossings
from casadi_skin.stability.tongues.diagram import Passage, StabilityDiagram
from casadi_skin.stability.tongues.interpolation import (
    FIRST_LENGTH,
    BranchSampler,
    Gap,
    MatrixSeries,
    Search,
    interpolate,
    joined,
    without_copies,
)
from casadi_skin.stability.tongues.pairs import evaluate
from casadi_skin.stability.tongues.rotation import TWO_PI, Tracks, follow_angles
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.problem import Array

INTERPOLATION_TOLERANCE = 1e-11  # tolerance, relative to the largest entries
WORK_LIMIT = 2e9  # see `Search.work`: a minute or two
SAMPLE_WORK = 0.1  # an orbit with its transition matrix, in such problems
EXPECTED_INTERVALS = 16  # of a piece of the branch, as expected
PIECES_WORK = 1e7  # m^3 over the intervals of pieces that are looked at together
WORK_SHARE = 0.05  # of the work that is left, at most, for such pieces
ONE_PLACE = 1e-9  # of the branch: meetings without instability that are no farther apart are one
CLEARLY_OUTSIDE_ERRORS = 4.0  # errors of a mu that it is outside by, to be in the account
LEAST_DISTANCE = 1e-9  # of such a distance: rounding of two mu that nearly meet
SAME_PLACE = 1e-13  # of a coordinate: rounding of sums
NEAR_TONGUE_DISTANCE = 1e-3  # distance of a mu at an orbit from that of its tongue there, beside ten errors
UNBALANCED_WORDS = (
    "the account does not balance: multipliers outside the unit circle at an orbit are not those of its tongues"
)


@dataclass(frozen=True)
class Entry:
    """All mu at an orbit, with their errors, and the coordinate of the orbit along the branch."""

    coordinate: float
    mu: ComplexArray
    errors: Array


def find_changes(
    branch: BranchSampler,
    modes: Mapping[int, float] | None = None,
    tolerance: float = INTERPOLATION_TOLERANCE,
    work: float = WORK_LIMIT,
    short: bool = False,
    entries: Sequence[Entry] = (),
) -> StabilityDiagram:
    """Find every change of stability along a branch of periodic orbits of a reversible model.

    Arguments:
        branch: the source of transition matrices at any coordinate along it.
        modes: frequencies of the linear modes, by number, at its start of zero amplitude, but for that mode which it
            begins as; tongues are named by them.
        tolerance: of the interpolation of the matrices along the branch, relative to their largest entries.
        work: limit of `Search.work`, the sum of m^3 and more over the problems of m multipliers; the rest of the
            branch is then unresolved. The default is a minute or two.
        short: whether one piece of the lowest degree is tried on each section of the branch first.
        entries: all mu at orbits of the branch, in order: where those outside are not those of tongues is unresolved.

    Returns:
        Changes of stability and tongues, with undecided and unresolved places.
    """
    power, found = POWERS_BY_FRACTION[branch.fraction], _search(branch, tolerance, work, short)
    pieces = found.pieces
    ends = {piece.matrices.start for piece in pieces} ^ {piece.matrices.end for piece in pieces}
    unknown = ends | {coordinate for gap in found.gaps for coordinate in (gap.start, gap.end)}
    groups, disagreements = groups_of(found.segments, unknown)
    found.gaps += disagreements
    found.gaps += unbalanced(entries, groups, found.gaps)
    tracks = None if modes is None else _tracks(found, modes, branch.fraction)
    tongues = tongues_of(groups, pieces, power, tracks)
    decided = [i for i, tongue in enumerate(tongues) if tongue.decided]
    edges, windows = edges_of([groups[i] for i in decided], [tongues[i] for i in decided], pieces, power)
    return StabilityDiagram(
        all=tuple(edges),
        unresolved=tuple(_unresolved(branch, found)),
        samples=found.samples,
        tongues=tuple(tongues[i] for i in decided),
        undecided=tuple(tongue for tongue in tongues if not tongue.decided),
        windows=tuple(windows),
        passages=tuple(_passages(found)),
        symplectic=branch.symplectic,
        power=power,
        pieces=tuple(pieces),
    )


def _search(branch: BranchSampler, tolerance: float, work: float, short: bool) -> Search:
    """Pieces of the branch one after the other, and the events on them, as far as the work allows."""
    found, waiting, end = Search(), list[MatrixSeries](), branch.sections[-1][1] if branch.sections else 0.0
    for piece in interpolate(branch, tolerance, found, 1.0 if short else FIRST_LENGTH):
        waiting += without_copies(piece.matrices)
        cube = float(piece.matrices.size) ** 3
        left, is_last = work - SAMPLE_WORK * found.samples * cube, piece.matrices.end >= end
        if is_last or EXPECTED_INTERVALS * len(waiting) * cube >= min(PIECES_WORK, WORK_SHARE * (left - found.work)):
            find_crossings(waiting, found, left, piece.matrices.size)
            waiting = []
            if found.work >= left and not is_last:
                found.gaps.append(Gap(piece.matrices.end, end, NOT_LOOKED_AT))
                break
    if waiting:  # the rest of the branch is a gap
        find_crossings(waiting, found, left, piece.matrices.size)
    found.spectra.sort(key=lambda spectrum: spectrum.coordinate)
    return found


def _passages(found: Search) -> Iterator[Passage]:
    """Meetings without instability in order, those that two intervals see at their common end once."""
    last, near = (-np.inf, 0.0), 0.0
    for coordinate, mu, distance in sorted(found.passages):
        near = near or ONE_PLACE * (found.pieces[-1].matrices.end - found.pieces[0].matrices.start)
        if coordinate - last[0] > near or abs(mu - last[1]) > SAME_MU:
            yield Passage(place_at(found.pieces, coordinate), mu, distance)
        last = coordinate, mu


def _tracks(found: Search, modes: Mapping[int, float], fraction: float) -> Tracks | None:
    """Rotation angles of the linear modes along the branch."""
    if not found.pieces:
        return None
    start = place_at(found.pieces, found.pieces[0].matrices.start)
    return follow_angles(found.spectra, modes, start.coordinate, 2.0 * TWO_PI * fraction / start.Omega)


def _unresolved(branch: BranchSampler, found: Search) -> Iterator[Unresolved]:
    """Stretches that are not known, with the amplitudes at their ends, from the pieces where these hold them."""
    rest = [gap for gap in found.gaps if gap.reason == NOT_LOOKED_AT]
    if rest:  # as one, though in between some blocks may have been looked at
        rest = [Gap(min(gap.start for gap in rest), max(gap.end for gap in rest), NOT_LOOKED_AT)]
    others = [gap for gap in found.gaps if gap.reason != NOT_LOOKED_AT]

    def amplitude(at: float) -> float:
        if any(piece.matrices.start <= at <= piece.matrices.end for piece in found.pieces):
            return place_at(found.pieces, at).S
        return branch.amplitude(at)

    for gap in sorted([*joined(others), *rest], key=lambda gap: gap.start):
        yield Unresolved(amplitude(gap.start), amplitude(gap.end), gap.reason, coordinates=(gap.start, gap.end))


# The account of multipliers outside the unit circle at orbits ---------------------------------------------------------


def unbalanced(entries: Sequence[Entry], groups: Sequence[Group], gaps: Sequence[Gap]) -> list[Gap]:
    """Stretches around orbits whose unstable mu are not those of the groups of segments there.

    Each reaches from the last orbit before to the next one behind at which the account balances. Orbits in `gaps` are
    in no account, and neither are mu that are outside by no more than errors.
    """
    segments = [segment for group in groups for segment in group.segments]
    starts, ends = (np.array([getattr(segment, name) for segment in segments]) for name in ("start", "end"))
    found: list[Gap] = []
    balanced = True
    last = entries[0].coordinate if entries else 0.0
    entries = [entry for entry in entries if not any(gap.start <= entry.coordinate <= gap.end for gap in gaps)]
    at = np.array([[entry.coordinate] for entry in entries]).reshape(-1, 1)
    slack = SAME_PLACE * np.abs(at)
    which, those = np.nonzero((starts <= at + slack) & (at - slack <= ends))
    unstable: list[list[ComplexArray]] = [[] for _ in entries]
    if those.size:  # of all orbits together: that is cheaper
        mu, _ = evaluate([segments[i].block for i in those.tolist()], at[which])
        for k, i, values in zip(which.tolist(), those.tolist(), mu[:, 0], strict=True):
            unstable[k].append(segments[i].unstable(values))
    for entry, each in zip(entries, unstable, strict=True):
        fits = _fits(entry, np.concatenate([np.empty(0, complex), *each]))
        if not fits and balanced:
            found.append(Gap(last, entry.coordinate, UNBALANCED_WORDS))
        elif not balanced:
            found[-1] = Gap(found[-1].start, entry.coordinate, UNBALANCED_WORDS)
        balanced, last = fits, entry.coordinate
    return found


def _fits(entry: Entry, unstable: ComplexArray) -> bool:
    """Whether all mu that are clearly outside at an orbit are near one of a tongue, and the other way round."""
    if entry.mu.size == 0:
        return True
    own, theirs = (mu.real + 1j * np.abs(mu.imag) for mu in (entry.mu, unstable))
    far = _outside(own) > CLEARLY_OUTSIDE_ERRORS * entry.errors + LEAST_DISTANCE
    if np.any(far) and unstable.size == 0:
        return False
    apart = np.abs(own[:, None] - theirs)
    if np.any(np.min(apart[far], axis=1, initial=np.inf) > NEAR_TONGUE_DISTANCE + 10.0 * entry.errors[far]):
        return False
    nearest = np.argmin(apart, axis=0)
    clear = _outside(theirs) > CLEARLY_OUTSIDE_ERRORS * entry.errors[nearest] + LEAST_DISTANCE
    return bool(np.all(_outside(own[nearest[clear]]) > 0.0))


def _outside(mu: ComplexArray) -> Array:
    """Distances from [-1, 0]; 0 inside."""
    return np.asarray(np.abs(mu - np.clip(mu.real, -1.0, 0.0)))
