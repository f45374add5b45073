"""Narrow resonances that a family was led past are named, by the law of inertia."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from casadi_skin import Chain, follow_family
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.lattice.tail_problem import CoreWithTailProblem
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.passed_resonances import _counted, _positive_eigenvalues, passed_resonances
from casadi_skin.orbits.request import family_request


def test_positive_eigenvalues_of_a_band_are_those_of_the_matrix() -> None:
    generator = np.random.default_rng(1)
    for _ in range(20):
        matrix = generator.normal(size=(23, 23))
        matrix = np.triu(np.tril(matrix + matrix.T, 4), -4)
        assert _positive_eigenvalues(csr_matrix(matrix), 4) == np.count_nonzero(np.linalg.eigvalsh(matrix) > 0.0)


def test_a_family_outside_the_band_passes_none() -> None:
    assert follow_family(Chain(6, 1.0, 0.25, -1.0), mode=1, amplitude_max=1.0).passed_resonances == ()


@pytest.mark.parametrize(
    ("sites", "gamma", "g", "us"),
    [(120, 0.4, 1.0, (0.5, 0.75, 1.2, 2.0, 4.5)), (70, 0.7, -1.0, (0.6, 0.3, -0.8, -1.4, -2.5, -4.0))],
)
def test_eigenvalues_with_an_eliminated_tail_are_counted_as_those_of_all_sites(
    sites: int, gamma: float, g: float, us: tuple[float, ...]
) -> None:
    """At states that are no orbits too, some of them among the modes of the tail, up to one number for all."""
    chain, mode = Chain(sites, 1.0, gamma, g), "last" if g > 0 else "first"
    tailed, whole = (Family(family_request(chain, mode, 2.0, tail=tail)) for tail in ("eliminated", "full"))
    problem, full, z = tailed.levels.problem(6), whole.levels.problem(6), tailed.start.z
    assert isinstance(problem, CoreWithTailProblem)
    assert isinstance(tailed.coordinates, CoreWithTail)
    counts = []
    for u in us:
        for parameter in (0.0, 3.0 * g, -50.0 * g):
            z = tailed.start.problem.prolong(tailed.start.z, problem)
            z[problem.states :] = u, parameter
            point = replace(tailed.start, problem=problem, z=z, tangent=np.ones(problem.size))
            states = tailed.coordinates.on_all_sites(problem, z)
            every = replace(point, problem=full, z=states, tangent=np.ones(full.size))
            both = _counted(tailed.levels, point), _counted(whole.levels, every)
            counts.append([0 if one is None else one.positive for one in both])
    assert len({one for one, _ in counts}) > 3
    assert len({other - one for one, other in counts}) == 1


def test_a_family_through_the_threshold_of_an_infinite_chain_passes_none() -> None:
    branch = follow_family(Chain(math.inf, 1.0, 0.9, 1.0), "last", 1.0, tolerance=1e-5)  # type: ignore[arg-type]
    assert branch.passed_resonances == ()


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
