"""Narrow resonances that a family was led past are named, by the law of inertia."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csc_matrix

from casadi_skin import Chain, follow_family
from casadi_skin.follow.corners import PassedResonance, _counted, passed_resonances, positive_eigenvalues
from casadi_skin.follow.family import Family
from casadi_skin.runs.program import main
from casadi_skin.zero.family import family_request


def test_positive_eigenvalues_of_bands_are_those_of_the_matrices() -> None:
    generator = np.random.default_rng(1)
    for matrix in (np.triu(np.tril(m + m.T, 4), -4) for m in generator.normal(size=(20, 23, 23))):
        assert positive_eigenvalues(csc_matrix(matrix)) == np.count_nonzero(np.linalg.eigvalsh(matrix) > 0.0)


def test_a_family_outside_the_band_passes_none() -> None:
    assert follow_family(Chain(6, 1.0, 0.25, -1.0), mode=1, amplitude_max=1.0).passed_resonances == ()


@pytest.mark.parametrize(
    ("sites", "gamma", "g", "us"),
    [(120, 0.4, 1.0, (-0.5, -0.75, -1.2, -2.0, -4.5)), (70, 0.7, -1.0, (0.6, 0.3, -0.8, -1.4, -2.5, -4.0))],
)
def test_eigenvalues_with_an_eliminated_tail_are_counted_as_those_of_all_sites(
    sites: int, gamma: float, g: float, us: tuple[float, ...]
) -> None:
    """At states that are no orbits too, some of them among the modes of the tail, up to one number for all."""
    chain, mode = Chain(sites, 1.0, gamma, g), "last" if g > 0 else "first"
    tailed, whole = (Family(family_request(chain, mode, 2.0, tail=tail)) for tail in ("eliminated", "full"))
    problem, full, z = tailed.levels.problem(6), whole.levels.problem(6), tailed.start.z
    counts = []
    for u in us:
        for parameter in (0.0, 3.0 * g, -50.0 * g):
            z = tailed.start.problem.prolong(tailed.start.z, problem)
            z[problem.states :] = u, parameter
            point = replace(tailed.start, problem=problem, z=z, tangent=np.ones(problem.size))
            states = tailed.coordinates.on_all_sites(problem, z)
            every = replace(point, problem=full, z=states, tangent=np.ones(full.size))
            both = _counted(tailed.levels, [point]), _counted(whole.levels, [every])
            counts.append([0 if one is None else one[0].positive for one in both])
    assert len({one for one, _ in counts}) > 3
    assert len({other - one for one, other in counts}) == 1


def test_a_family_through_the_threshold_of_an_infinite_chain_passes_none() -> None:
    branch = follow_family(Chain(math.inf, 1.0, 0.9, 1.0), "last", 1.0, tolerance=1e-5)  # type: ignore[arg-type]
    assert branch.passed_resonances == ()


def test_it_is_not_sought_where_orbits_have_no_odd_cosines() -> None:
    branch = follow_family(Chain(3, 1.0, 0.25, -1.0), mode=1, amplitude_max=0.1, tolerance=1e-5, transcription="gauss")
    assert branch.passed_resonances is None


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-7, 1e-9])
def test_places_at_which_branches_cross_are_not_named(tolerance: float) -> None:
    """Their excursions cross families of a third of the period, and the number of eigenvalues changes by that alone."""
    for chain, S in ((Chain(6, 0.25, -0.091, -1.0), 0.587), (Chain(10, 0.083, 0.251, -1.0), 0.462)):
        assert follow_family(chain, 1, S, tolerance=tolerance).passed_resonances == ()


@pytest.mark.slow
def test_an_excursion_left_out_is_named_by_harmonic_and_mode() -> None:
    """7 Omega meets mode 23: folds at S = 0.015447 and 0.011112, between which the family makes its excursion."""
    branch = follow_family(Chain(24, 1e-8, 0.25, 1.0), mode=1, amplitude_max=0.02, tolerance=1e-9)
    solver, points = branch.space.point_solver, [orbit.point for orbit in branch.orbits]
    S_of = lambda point: branch.space.value("S", point)  # noqa: E731
    assert passed_resonances(solver, points, S_of) == ()
    turns = np.flatnonzero(np.diff(branch.S) < 0.0)
    first = int(np.argmax(branch.S > 0.0152))
    last = turns[-1] + 1 + int(np.argmax(branch.S[turns[-1] + 1 :] > 0.016))
    kept = points[:first] + points[last:]
    (found,) = passed_resonances(solver, kept, S_of) or ()
    assert found.meetings == ((7, 23),)
    assert found.S[0] < 0.0154471 < found.S[1]
    assert "7 Omega with mode 23" in str(found)


def test_a_run_names_resonances_that_were_passed_over(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = tmp_path / "scene.toml"
    words = "[chain]\nsites = 3\nalpha = 1.0\ngamma = 0.25\ng = -1.0\n[family]\nmode = 1\namplitude_max = 0.1\n"
    scene.write_text(f"{words}[stability]\n[figures]\nformats = []\n", encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "none")]) == 0
    assert "passed over" not in capsys.readouterr().out
    header = "mode,S_before,S_after,Omega_before,Omega_after,changes,meetings"
    assert (tmp_path / "none/passed_resonances.csv").read_text(encoding="utf-8").splitlines() == [header]
    one = PassedResonance((0.25, 0.5), (1.5, 1.25), 1, ((7, 23), (3, 2)))
    monkeypatch.setattr("casadi_skin.follow.branch.passed_resonances", lambda *_: (one,))
    assert main(["run", str(scene), "--out", str(tmp_path / "one")]) == 0
    line = (
        "mode 1: a narrow resonance is passed over between S = 0.25 and 0.5 (7 Omega with mode 23, 3 Omega with mode 2)"
    )
    assert line in capsys.readouterr().out.splitlines()
    row = '1,0.25,0.5,1.5,1.25,1,"7 Omega with mode 23, 3 Omega with mode 2"'
    assert (tmp_path / "one/passed_resonances.csv").read_text(encoding="utf-8").splitlines() == [header, row]
