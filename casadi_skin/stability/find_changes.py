"""Every change of stability along a branch, for certain: the whole way from transition matrices to tongues."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from casadi_skin.stability.assembly import edges_of, groups_of, tongue_of
from casadi_skin.stability.crossings import find_crossings
from casadi_skin.stability.interpolation import BranchSampler, Gap, Interpolated, interpolate
from casadi_skin.stability.rotation import TWO_PI, follow_angles
from casadi_skin.stability.tongues import Passage, StabilityDiagram, Unresolved, piece_at, place_on

INTERPOLATION = 1e-11  # tolerance, relative to the largest entries


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
    power = {0.25: 2, 0.5: 1}[branch.fraction]
    known = interpolate(branch, tolerance)
    found = find_crossings([piece.matrices for piece in known.pieces])
    ends = {a for piece in known.pieces for a in (piece.matrices.start, piece.matrices.end)}
    inner = {piece.matrices.start for piece in known.pieces} & {piece.matrices.end for piece in known.pieces}
    lost = {a for gap in found.gaps for a in (gap.start, gap.end)}
    groups = groups_of(found.segments, (ends - inner) | lost)
    tracks = None
    if modes is not None and known.pieces:
        first = known.pieces[0]
        start = first.matrices.start
        duration = 2.0 * TWO_PI * branch.fraction / float(first.Omega(np.array([start]))[0])
        tracks = follow_angles(found.spectra, modes, start, duration)
    tongues = [tongue_of(group, known.pieces, power, tracks) for group in groups]
    decided = [i for i, tongue in enumerate(tongues) if tongue.decided]
    changes, further, windows = edges_of([groups[i] for i in decided], [tongues[i] for i in decided], known)
    return StabilityDiagram(
        changes=tuple(changes),
        further=tuple(further),
        tongues=tuple(tongues[i] for i in decided),
        undecided=tuple(tongue for tongue in tongues if not tongue.decided),
        windows=tuple(windows),
        passages=tuple(
            Passage(place_on(piece_at(known.pieces, at), at, 0.0), mu, distance)
            for at, mu, distance in sorted(found.passages)
        ),
        unresolved=tuple(_unresolved(known, gap) for gap in sorted([*known.gaps, *found.gaps], key=lambda g: g.start)),
        symplectic=branch.symplectic,
        power=power,
        samples=known.samples,
        pieces=known.pieces,
    )


def _unresolved(known: Interpolated, gap: Gap) -> Unresolved:
    """A gap with the amplitudes next to it, as far as these are known."""
    S = []
    for at in (gap.start, gap.end):
        S.append(float(known.pieces and piece_at(known.pieces, at).S(np.array([at]))[0] or np.nan))
    return Unresolved(S[0], S[1], gap.start, gap.end, gap.reason)
