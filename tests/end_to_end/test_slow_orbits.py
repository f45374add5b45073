"""One softening site to thirty times its linear period, against elliptic functions; families that wander."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from outputs import read_rows

from casadi_skin import Chain, Orbit, follow_family
from casadi_skin.runs.program import main
from casadi_skin.zero.settings import End

ROOT = Path(__file__).parents[2]
METHODS = ("trigonometric", "gauss", "radau")
SLOWER = (2.0, 5.0, 10.0, 20.0, 30.0)  # times the linear period
DIGITS = 60  # omega^2 - |g| S is 1e-28 at thirty times the period, and 1 - m with it


@cache
def exact_gap(omega_squared: float, Omega: float) -> mp.mpf:
    """omega^2 - S at a frequency for g = -1, to many digits, by bisection on its logarithm.

    The orbit is sqrt(S) cd(p t | m), p^2 = omega^2 - S/2, m = S/(2 p^2), 1 - m = gap/p^2: Omega = pi p/(2 K(m)).
    """
    with mp.workdps(DIGITS):
        square, wanted = mp.mpf(omega_squared), mp.mpf(Omega)

        def frequency(gap: mp.mpf) -> mp.mpf:
            p = mp.sqrt((square + gap) / 2)
            return mp.pi * p / (2 * mp.ellipk(1 - gap / p**2))

        low, high = mp.mpf(-200), mp.log(square)
        for _ in range(230):
            middle = (low + high) / 2
            low, high = (low, middle) if frequency(mp.exp(middle)) > wanted else (middle, high)
        return mp.exp(low)


@cache
def exact_displacements(omega_squared: float, Omega: float, phases: tuple[float, ...]) -> list[mp.mpf]:
    with mp.workdps(DIGITS):
        gap = exact_gap(omega_squared, Omega)
        S, p = omega_squared - gap, mp.sqrt((omega_squared + gap) / 2)
        times = [p * mp.mpf(phase) / mp.mpf(Omega) for phase in phases]
        return [mp.sqrt(S) * mp.ellipfun("cd", time, m=1 - gap / p**2) for time in times]


def errors(orbit: Orbit, omega_squared: float) -> tuple[float, float]:
    """Errors of S and of the profile, relative to its largest displacement, at the orbit's own Omega."""
    phases = np.linspace(0.0, 0.5 * np.pi, 23)
    with mp.workdps(DIGITS):
        S = omega_squared - exact_gap(omega_squared, orbit.Omega)
        found = orbit.evaluate(phases / orbit.Omega)[:, 0]
        exact = exact_displacements(omega_squared, orbit.Omega, tuple(phases.tolist()))
        largest = max(abs(mp.mpf(float(a)) - b) for a, b in zip(found, exact, strict=True))
        return float(abs(mp.mpf(orbit.S) - S)), float(largest / mp.sqrt(S))


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-4, 1e-8, 1e-12])
@pytest.mark.parametrize("methods", ["trigonometric, series", *(f"{m}, arclength" for m in METHODS)])
def test_a_softening_site_is_within_its_estimated_errors_of_elliptic_functions(methods: str, tolerance: float) -> None:
    transcription, walker = methods.split(", ")
    period = 2 * np.pi / np.sqrt(3.0)
    wanted = [slower * period for slower in SLOWER]
    branch = follow_family(
        Chain(1, 1.0, 0.0, -1.0), 1, 4.0, at_period=wanted, period_max=wanted[-1], tolerance=tolerance,
        transcription=transcription, walker=walker, corrector="newton",
    )  # fmt: skip
    assert branch.complete, branch.reason
    asked = [orbit for orbit in branch.orbits if orbit.point.requested]
    assert [orbit.period for orbit in asked] == wanted
    for orbit in asked:
        of_S, of_profile = errors(orbit, 3.0)
        assert of_S <= orbit.S_error + 4e-16 * orbit.S
        assert of_profile <= orbit.profile_error
        assert orbit.at_round_off or max(orbit.S_error / orbit.S, orbit.profile_error) <= tolerance
        assert orbit.Omega_error <= (1 + 1e-12) * orbit.point.problem.round_off * orbit.Omega


@pytest.mark.parametrize(
    ("longest", "asked", "beyond"),
    [(8, (0.9, 0.3), "0.1"), pytest.param(31, (0.9, 0.3, 1 / 7.3, 0.033), "0.03", marks=pytest.mark.slow)],
)
def test_between_the_points_asked_for_any_period_can_be_had(
    longest: int, asked: tuple[float, ...], beyond: str
) -> None:
    chain = Chain(1, -1.0, 0.0, -1.0)
    branch = follow_family(chain, 1, 2.0, period_max=longest * 2 * np.pi, corrector="newton")
    for Omega in asked:
        orbit = branch.at(Omega=Omega)
        assert orbit.Omega == Omega
        of_S, of_profile = errors(orbit, 1.0)
        assert of_S <= orbit.S_error + 4e-16
        assert of_profile <= orbit.profile_error <= 1e-8
        assert orbit.energy == pytest.approx(0.5 * orbit.S - 0.25 * orbit.S**2, rel=1e-14)
        assert orbit.Omega_shift == pytest.approx(Omega - 1.0, rel=1e-8)
    with pytest.raises(ValueError, match=rf"at: given Omega = {beyond}, .* passes Omega 0 times"):
        branch.at(Omega=float(beyond))


@pytest.mark.slow
def test_the_example_of_a_slow_softening_site(tmp_path: Path) -> None:
    scene = ROOT / "examples" / "slow_softening_site.toml"
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    table = [row for row in read_rows(tmp_path / "out" / "family.csv") if row["requested"] == "1"]
    assert [float(row["Omega"]) for row in table[:4]] == [0.5, 0.2, 0.1, 0.05]
    assert float(table[4]["period"]) == 188.49555921538757
    assert len(table) == 5
    pinned = [0.90546411882038, 0.99987996963172, 0.99999999819909]  # from elliptic functions to 60 digits
    np.testing.assert_allclose([float(row["S"]) for row in table[:3]], pinned, rtol=2e-8)
    for row in table:
        S = 1 - exact_gap(1.0, float(row["Omega"]))
        assert abs(mp.mpf(float(row["S"])) - S) <= float(row["S_error"])
        assert float(row["S_error"]) <= 1e-8


LIMITS = {(end, method): method == "trigonometric" and end != 3.0 + 1e-13 for end in (3.0, 3.5, 3.0 + 1e-13)
          for method in METHODS}  # fmt: skip


@pytest.mark.usefixtures("harmonics")
@pytest.mark.parametrize(
    ("end", "method"), [pytest.param(*case, marks=() if quick else pytest.mark.slow) for case, quick in LIMITS.items()]
)
def test_an_amplitude_at_or_beyond_the_limit_is_refused_with_the_reason(end: float, method: str) -> None:
    """S = omega^2/|g| = 3 has no orbit, and no value of S near it tells one orbit from another."""
    branch = follow_family(Chain(1, 1.0, 0.0, -1.0), 1, end, transcription=method, corrector="newton")
    assert not branch.complete
    assert "times the linear one and grows without bound" in branch.reason
    assert ("does not exist at S = 3.5" in branch.reason) == (end == 3.5)
    assert ("too near its limit" in branch.reason) == (end != 3.5)
    if end == 3.5:  # the meshes resolve every period, odd cosines do not
        assert branch.end is (End.RESOLUTION if method == "trigonometric" else End.LIMIT)


@pytest.mark.usefixtures("pictures")
def test_a_family_that_wanders_ends_with_what_to_try(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """3 Omega meets the linear frequencies soon: resonance after resonance, each with folds, while the period grows."""
    chain = "[chain]\nsites = 5\nalpha = 0.71\ngamma = 0.3\ng = -1.0\n"
    family = "[family]\nmode = 1\namplitude_max = 6.0\nmax_points = 120\n"
    scene = tmp_path / "wandering.toml"
    scene.write_text(chain + family + '[method]\ncorrector = "newton"\n', encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--quiet"]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "the limit on the number of points was reached (S = " in told
    assert "3 Omega" in told
    assert "try amplitude_max up to" in told
    assert "max_points above 120" in told
    assert len(read_rows(tmp_path / "out" / "family.csv")) == 120
