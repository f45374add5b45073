"""Narrow resonances that a family was led past are named, by the law of inertia."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from casadi_skin import Chain, follow_family
from casadi_skin.orbits.passed_resonances import _positive_eigenvalues, passed_resonances


def test_positive_eigenvalues_of_a_band_are_those_of_the_matrix() -> None:
    generator = np.random.default_rng(1)
    for _ in range(20):
        matrix = generator.normal(size=(23, 23))
        matrix = np.triu(np.tril(matrix + matrix.T, 4), -4)
        assert _positive_eigenvalues(csr_matrix(matrix), 4) == np.count_nonzero(np.linalg.eigvalsh(matrix) > 0.0)


def test_a_family_outside_the_band_passes_none() -> None:
    assert follow_family(Chain(6, 1.0, 0.25, -1.0), mode=1, amplitude_max=1.0).passed_resonances == ()


def test_it_is_not_sought_where_orbits_have_no_odd_cosines() -> None:
    branch = follow_family(Chain(3, 1.0, 0.25, -1.0), mode=1, amplitude_max=0.1, tolerance=1e-5, transcription="gauss")
    assert branch.passed_resonances is None


@pytest.mark.slow
def test_an_excursion_left_out_is_named_by_harmonic_and_mode() -> None:
    """7 Omega meets mode 23: folds at S = 0.015447 and 0.011112, between which the family makes its excursion."""
    branch = follow_family(Chain(24, 1e-8, 0.25, 1.0), mode=1, amplitude_max=0.02, tolerance=1e-9)
    levels, points = branch.space.point_solver.levels, [orbit.point for orbit in branch.orbits]
    assert passed_resonances(levels, points, branch.S.tolist()) == ()
    turns = np.flatnonzero(np.diff(branch.S) < 0.0)
    first = int(np.argmax(branch.S > 0.0152))
    last = turns[-1] + 1 + int(np.argmax(branch.S[turns[-1] + 1 :] > 0.016))
    kept = points[:first] + points[last:]
    S = [*branch.S[:first], *branch.S[last:]]
    (found,) = passed_resonances(levels, kept, S) or ()
    assert found.meetings == ((7, 23),)
    assert found.S[0] < 0.0154471 < found.S[1]
    assert "7 Omega with mode 23" in str(found)
