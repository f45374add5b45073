"""Internal resonances that a family was led past: neighbouring orbits between which an eigenvalue has changed sign.

Along a smooth family the Jacobian by the orbit, at fixed frequency and amplitude, has as many positive eigenvalues
throughout, and one more or less after each turn of the frequency (Sylvester's law of inertia; Keller 1977 for signs of
determinants alone, in which two changes cancel). Where the number changes otherwise, branches cross, or a corner was
passed that is narrower than was resolved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from casadi_skin.bvp.cosines import cosine_matrix, second_derivative_matrix
from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.trigonometric import TrigonometricProblem
from casadi_skin.continuation.points import Point
from casadi_skin.solvers.levels import Levels

SYMMETRIC = 1e-9  # of the largest entry: difference of a symmetric Jacobian from its transpose
NEAR = 3  # stretches between a turn of the frequency and the change of the number that belongs to it, at most
BEYOND = 1.1  # times the highest frequency: harmonics above it have no resonance


@dataclass(frozen=True)
class PassedResonance:
    """A stretch of a family between two neighbouring orbits on which it may have gone round a resonance.

    Attributes:
        S: amplitudes of both orbits.
        Omega: their frequencies.
        changes: by how many the number of positive eigenvalues differs.
        meetings: pairs of a harmonic of Omega and a mode, by ascending frequency about the orbit, that meet there.
    """

    S: tuple[float, float]
    Omega: tuple[float, float]
    changes: int
    meetings: tuple[tuple[int, int], ...]

    def __str__(self) -> str:
        met = ", ".join(f"{harmonic} Omega with mode {mode}" for harmonic, mode in self.meetings)
        named = f" ({met})" if met else ""
        between = f"between S = {self.S[0]:.10g} and {self.S[1]:.10g}"
        return f"branches cross, or a narrow resonance is passed over, {between}{named}"


def passed_resonances(
    levels: Levels, points: Sequence[Point], S: Sequence[float]
) -> tuple[PassedResonance, ...] | None:
    """Stretches between neighbouring points that may pass a resonance; None where the Jacobian is not symmetric.

    Arguments:
        levels: of resolution, of the family.
        points: of it in order.
        S: their amplitudes.
    """
    known = [_counted(levels, point) for point in points]
    if None in known:
        return None
    found = []
    for place in _unexplained([one for one in known if one is not None]):
        before, after = known[place], known[place + 1]
        assert before is not None
        assert after is not None
        met = tuple(sorted(_meetings(before.by_harmonic, after.by_harmonic)))
        Omega = points[place].Omega, points[place + 1].Omega
        changes = abs(before.positive - after.positive)
        found.append(PassedResonance((S[place], S[place + 1]), Omega, changes, met))
    return tuple(found)


def _unexplained(known: Sequence[_Counted]) -> list[int]:
    """Places before stretches on which the number changes otherwise than by turns of the frequency.

    Where the orbit has a shorter period the frequency turns by symmetry, and the number stays. A turn and its change
    may lie on neighbouring stretches: orbits next to a turn are known to their errors alone.
    """
    changes = [abs(one.positive - other.positive) for one, other in pairwise(known)]
    turns = [int(one.direction != other.direction) for one, other in pairwise(known)]
    open_turns = {place for place, turn in enumerate(turns) if turn > changes[place]}
    found = []
    for place, count in enumerate(changes):
        near = next((turn for turn in sorted(open_turns) if abs(turn - place) <= NEAR), None)
        if count == 1 and not turns[place] and near is not None:
            open_turns.remove(near)
        elif count > turns[place]:
            found.append(place)
    return found


@dataclass(frozen=True)
class _Counted:
    """Positive eigenvalues at a point, the sign of the rate of Omega, and the eigenvalues of each harmonic alone.

    The number may be one up to a constant, and harmonics are left out, where sites are eliminated.
    """

    positive: int
    direction: float
    by_harmonic: Array


def _counted(levels: Levels, point: Point) -> _Counted | None:
    """Those of a point, on a level with all harmonics that may meet a mode; None where there is no such count."""
    problem, z = point.problem, point.z
    if not isinstance(problem, TrigonometricProblem):
        return None
    core, own = problem.by_itself(z)
    highest = BEYOND * float(np.sqrt(np.max(np.sum(np.abs(_forces(core, own)), axis=1))))
    enough = [r for r in levels.resolutions if r >= problem.resolution and 2 * r - 1 > highest]
    if not enough:
        return None
    finer = levels.problem(enough[0])
    assert isinstance(finer, TrigonometricProblem)
    z = problem.prolong(z, finer)
    core, own = finer.by_itself(z)
    matrix: Any = _jacobian(core, own)
    if abs(matrix - matrix.T).max() > SYMMETRIC * abs(matrix).max():
        return None
    block, there, beyond = finer.eliminated(z)
    if block.size:
        matrix = matrix.tolil()
        matrix[there, there] += block
        matrix = matrix.tocsr()
    # u in the place of Omega rises with it, or falls, also where Omega itself stands still
    direction = float(np.sign(point.tangent[problem.Omega_index]))
    positive = beyond + _positive_eigenvalues(matrix, core.half_bandwidth or core.states)
    return _Counted(positive, direction, np.zeros((0, 1)) if block.size else _by_harmonic(finer, z))


def _jacobian(problem: TrigonometricProblem, z: Array) -> csr_matrix:
    """Derivative of the equations by the node values at fixed frequency and parameter."""
    rows, columns = problem.pattern
    whole = csr_matrix((problem.evaluate(z)[1], (rows, columns)), shape=(problem.size - 1, problem.size))
    return whole[: problem.states, : problem.states]


def _positive_eigenvalues(matrix: csr_matrix, width: int) -> int:
    """Number of positive eigenvalues of a symmetric band matrix, from its Schur complements block by block."""
    positive, complement = 0, np.zeros((0, 0))
    for start in range(0, matrix.shape[0], width):
        here, before = slice(start, start + width), slice(max(start - width, 0), start)
        beside = matrix[here, before].toarray()
        block = matrix[here, here].toarray()
        if start:
            block -= beside @ np.linalg.solve(complement, beside.T)
        complement = 0.5 * (block + block.T)
        positive += int(np.count_nonzero(np.linalg.eigvalsh(complement) > 0.0))
    return positive


def _forces(problem: TrigonometricProblem, z: Array) -> Array:
    """Derivatives of restoring forces over Omega^2 by positions, shape (sites, sites, nodes)."""
    H, N = problem.resolution, problem.states // problem.resolution
    rows, columns = problem.pattern
    entries = problem.evaluate(z)[1]
    found = np.zeros((N, N, H))
    at_node = (rows < problem.states) & (columns < problem.states) & (rows % H == columns % H)
    row, column = rows[at_node], columns[at_node]
    np.add.at(found, (row // H, column // H, row % H), entries[at_node])
    every = np.arange(N)
    found[every, every] -= np.diag(second_derivative_matrix(H))
    return found


def _by_harmonic(problem: TrigonometricProblem, z: Array) -> Array:
    """Eigenvalues of the Jacobian of each harmonic alone, shape (harmonics, sites), descending."""
    H = problem.resolution
    shares = (2.0 / H) * cosine_matrix(H) ** 2
    alone = np.einsum("nmi,ik->knm", _forces(problem, z), shares)
    alone -= (2.0 * np.arange(H)[:, None, None] + 1.0) ** 2 * np.eye(alone.shape[1])
    return np.asarray(np.linalg.eigvalsh(alone)[:, ::-1])


def _meetings(before: Array, after: Array) -> set[tuple[int, int]]:
    """Pairs of a harmonic and a mode whose eigenvalue by itself changes sign; the mode's own harmonic is none."""
    shared = min(len(before), len(after))
    harmonics, places = np.nonzero((before[:shared] > 0.0) != (after[:shared] > 0.0))
    return {(2 * int(k) + 1, before.shape[1] - int(place)) for k, place in zip(harmonics, places, strict=True)}
