"""Every change of stability along a branch, for certain: the whole way from transition matrices to tongues."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from casadi_skin.stability.assembly import edges_of, groups_of, place_at, tongues_of
from casadi_skin.stability.crossings import Crossings, find_crossings
from casadi_skin.stability.interpolation import BranchSampler, Interpolated, interpolate
from casadi_skin.stability.rotation import TWO_PI, Tracks, follow_angles
from casadi_skin.stability.tongues import Passage, StabilityDiagram, Unresolved

INTERPOLATION = 1e-11  # tolerance, relative to the largest entries
POWERS = {0.25: 2, 0.5: 1}  # of lambda(M) that give multipliers, by the fraction of the period of transition matrices


def find_changes(
    branch: BranchSampler, modes: Mapping[int, float] | None = None, tolerance: float = INTERPOLATION
) -> StabilityDiagram:
    """Find every change of stability along a branch of periodic orbits of a reversible model.

    Arguments:
        branch: what gives transition matrices at any coordinate along it.
        modes: frequencies of the linear modes, by number, at its start of zero amplitude, but for that mode which it
            begins as; tongues are named by them.
        tolerance: of the interpolation of the matrices along the branch, relative to their largest entries.

    Returns:
        Changes of stability and tongues, with what is not decided and what is not known.
    """
    power = POWERS[branch.fraction]
    known = interpolate(branch, tolerance)
    found = find_crossings([piece.matrices for piece in known.pieces])
    groups = groups_of(found.segments, _unknown(known, found))
    tracks = None if modes is None else _tracks(known, found, modes, branch.fraction)
    tongues = tongues_of(groups, known.pieces, power, tracks)
    decided = [i for i, tongue in enumerate(tongues) if tongue.decided]
    edges = edges_of([groups[i] for i in decided], [tongues[i] for i in decided], known.pieces, power)
    return StabilityDiagram(
        changes=edges.changes,
        further=edges.further,
        tongues=tuple(tongues[i] for i in decided),
        undecided=tuple(tongue for tongue in tongues if not tongue.decided),
        windows=edges.windows,
        passages=tuple(
            Passage(place_at(known.pieces, coordinate), mu, distance)
            for coordinate, mu, distance in sorted(found.passages)
        ),
        unresolved=tuple(_unresolved(known, found)),
        symplectic=branch.symplectic,
        power=power,
        samples=known.samples,
        pieces=known.pieces,
    )


def _unknown(known: Interpolated, found: Crossings) -> set[float]:
    """Coordinates where what is known of the branch, or of its multipliers, ends."""
    starts = {piece.matrices.start for piece in known.pieces}
    ends = {piece.matrices.end for piece in known.pieces}
    return (starts ^ ends) | {coordinate for gap in found.gaps for coordinate in (gap.start, gap.end)}


def _tracks(known: Interpolated, found: Crossings, modes: Mapping[int, float], fraction: float) -> Tracks | None:
    """Rotation angles of the linear modes along the branch."""
    if not known.pieces:
        return None
    start = place_at(known.pieces, known.pieces[0].matrices.start)
    return follow_angles(found.spectra, modes, start.coordinate, 2.0 * TWO_PI * fraction / start.Omega)


def _unresolved(known: Interpolated, found: Crossings) -> Sequence[Unresolved]:
    """Stretches that are not known, with the amplitudes next to them."""
    gaps = sorted([*known.gaps, *found.gaps], key=lambda gap: gap.start)
    rows = []
    for gap in gaps:
        nan = float("nan")
        S = [place_at(known.pieces, at).S if known.pieces else nan for at in (gap.start, gap.end)]
        rows.append(Unresolved(S[0], S[1], gap.start, gap.end, gap.reason))
    return rows
