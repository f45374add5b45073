"""Localised multipliers of an orbit at the edge of a long linear tail, from a variational problem that is cut.

Vectors that decay into the tail are felt by a cut as exp(-2 kappa n), n sites from the edge: their multipliers are
those of the infinite medium up to that. All others of the cut problem are waves that fill it. They stand for the
continuous spectrum, and where they leave the circle they are finite-size instabilities: weak, different for every
number of sites, and without a limit (Marin and Aubry 1998).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.stability.multipliers import eigenvalue_errors, flow_part_of, orbit_part_of, power_of, round_off_of
from casadi_skin.stability.reduction import ComplexArray, Eigensystems, Reflections, eigensystems, half_cosines
from casadi_skin.stability.result import ContinuousSpectrum, ReversibleFloquet
from casadi_skin.stability.stepping import Transition
from casadi_skin.zero.problem import Array

CORNER_CELLS = (
    4  # cells at the cut, from which B^T C differs from that of a longer chain: farther in by less than their size
)
ERROR_SAFETY = 2.0
WAVE_CHANGE = 1e-3  # what the cut may change of a mu that belongs to a wave: measured 0.03 to 0.5, falling as 1/sites


@dataclass(frozen=True, eq=False, repr=False)
class LocalisedFloquet(ReversibleFloquet):
    """Stability of an orbit at the edge of a long linear tail: its localised multipliers, and the continuous spectrum.

    `mu`, and the multipliers, are those of localised vectors alone; `mu_error` holds what the cut makes.

    Attributes:
        continuous: the multipliers of waves in closed form.
        sites: number of sites of the cut variational problem.
        finite_size: mu of this problem off the circle that are not localised: they depend on the number of sites, and
            say nothing about an infinite tail.
        unresolved: mu of this problem off the circle that decay into the tail, but not by as much as the tolerance
            asks for: more sites decide.
        counted: number of localised multipliers outside the circle of an infinite tail, by Hill's determinant, which
            nothing cuts: it decides `stable`, and how many are unstable. None where they cannot be counted; then the
            cut problem decides.
    """

    continuous: ContinuousSpectrum
    sites: int
    finite_size: ComplexArray
    unresolved: ComplexArray
    counted: int | None = None

    @property
    def stable(self) -> bool:
        return super().stable if self.counted is None else self.counted == 0

    @property
    def listed(self) -> int:
        """Number of multipliers outside the circle in the list of the cut problem."""
        return super().unstable_real + super().unstable_complex

    @property
    def unstable_real(self) -> int:
        """Number of real multipliers outside the unit circle: nearest to the list's, as complex ones come in twos."""
        real = super().unstable_real
        return real if self.counted is None else min(real + (self.counted - real) % 2, self.counted)

    @property
    def unstable_complex(self) -> int:
        """Number of the other multipliers outside the unit circle; a complex pair counts two."""
        return super().unstable_complex if self.counted is None else self.counted - self.unstable_real

    @property
    def finite_size_modulus(self) -> float:
        """Largest modulus of a multiplier of `finite_size`; 1 without any."""
        return self.of_finite_size.max_abs_multiplier

    @property
    def of_finite_size(self) -> ReversibleFloquet:
        """The multipliers of `finite_size`, beside the trivial pair."""
        return ReversibleFloquet(self.finite_size, np.zeros(self.finite_size.size), 0.0, self.power)


def localised_floquet(
    transition: Transition,
    accelerations: tuple[Array, Array],
    tolerance: float,
    bands: tuple[tuple[float, float], ...],
    Omega: float,
    cut_first: bool,
    cell: int = 1,
) -> LocalisedFloquet:
    """Localised multipliers of a symplectic transition matrix of a cut variational problem.

    Arguments:
        transition: over a quarter or half of the period, of n sites at the edge.
        accelerations: q'' at phase zero of the orbit and of the better one that shows its error, each (n,).
        tolerance: largest change of a localised mu by the cut, relative to max(1, |mu|).
        bands: lowest and highest frequency of each band of the tail.
        Omega: frequency of the orbit.
        cut_first: whether the cut is at the first site; else it is at the last.
        cell: sites of a cell of the tail.

    Returns:
        The multipliers, with errors of flow, orbit, rounding and cut.
    """
    power = power_of(transition)
    trivial = -1.0 if power == 2 else 0.0
    matrix = transition.matrix[None]
    K, n = half_cosines(matrix), matrix.shape[1] // 2
    reflections = [Reflections.of(a[None]) for a in accelerations]
    similar = reflections[0].similar(K)
    similar[:, 0, 0] -= trivial
    deviation = float(np.max(np.abs(similar[0, 0])))
    bound = deviation <= tolerance  # else the velocity of the flow fills the tail: the cut problem has no such vector
    reduced = similar[:, 1:, 1:] if bound else K
    systems = eigensystems(reduced)
    parts = [
        flow_part_of([transition], matrix, reflections[0] if bound else None),
        orbit_part_of([transition], reflections[0] if bound else None, reflections[1] if bound else None),
    ]
    norms = np.array([sum(np.linalg.norm(part) for part in parts)])
    errors = eigenvalue_errors(systems, parts, norms, round_off_of([transition], matrix))[0][0]
    if bound:
        errors = errors + _by_deviation(systems, similar[0], trivial)
    corner = slice(0, CORNER_CELLS * cell) if cut_first else slice(-CORNER_CELLS * cell, n)
    cut = _by_cut(systems, reflections[0].u[0] if bound else None, corner)
    mu, local = systems.values[0], cut <= tolerance * np.maximum(1.0, np.abs(systems.values[0]))
    if not bound:  # the velocity of the flow may decay enough to be localised all the same
        local &= np.abs(mu - trivial) > errors + cut
    off = ~ReversibleFloquet(mu, errors, deviation, power).is_inside & ~local
    continuous = ContinuousSpectrum(Omega, bands, power)
    return LocalisedFloquet(
        mu[local], (errors + cut)[local], deviation if bound else 0.0, power,
        continuous, n, mu[off & (cut > WAVE_CHANGE)], mu[off & (cut <= WAVE_CHANGE)],
    )  # fmt: skip


def _by_deviation(systems: Eigensystems, similar: Array, trivial: float) -> Array:
    """The shift of each mu by the rest of the trivial direction's row, by way of the trivial one."""
    along = np.abs(systems.left[0] @ similar[1:, 0]) * np.abs(similar[0, 1:] @ systems.right[0])
    distance = np.maximum(np.abs(systems.values[0] - trivial), np.finfo(float).eps)
    return np.asarray(np.minimum(along / distance, np.sqrt(along)))


def _by_cut(systems: Eigensystems, u: Array | None, corner: slice) -> Array:
    """The shift of each mu by the sites beyond the cut: its right vector there times its left one."""
    right, left = systems.right[0], systems.left[0]
    if u is not None:
        right = np.vstack([np.zeros(right.shape[1]), right]) - 2.0 * np.outer(u, u[1:] @ right)
        left = np.column_stack([np.zeros(left.shape[0]), left]) - 2.0 * np.outer(left @ u[1:], u)
    sizes = np.linalg.norm(right[corner], axis=0) * np.linalg.norm(left[:, corner], axis=1)
    return np.asarray(ERROR_SAFETY * np.maximum(1.0, np.abs(systems.values[0])) * sizes)
