"""Long and steep chains: no overflow, no NaN, and profiles in logarithms far below the smallest double."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from marks import slow
from numpy.typing import NDArray
from scipy.io import netcdf_file

from casadi_skin import Chain, Orbit, follow_family
from casadi_skin.lattice.chain_coordinates import _continued
from casadi_skin.lattice.closed_forms import frequency_slope
from casadi_skin.results.dataset import NETCDF_FILL_VALUE, dataset_of, write_csv, write_netcdf
from casadi_skin.results.figures.families import profile_figure
from casadi_skin.results.figures.style import save

Array = NDArray[np.float64]


def breather(sites: int, gamma: float, g: float, **options: str) -> Orbit:
    mode = sites if g > 0 else 1
    return follow_family(Chain(sites, 1.0, gamma, g), mode, 1.0, corrector="newton", **options).orbits[-1]  # type: ignore[arg-type]


def far_to_near(orbit: Orbit, values: Array) -> Array:
    return values if orbit.model.gamma >= 0 else values[::-1]


def tail(orbit: Orbit) -> Array:
    """log10 of the fundamental of the linear tail but for a constant, from the far end on, by 2 s cosh(kappa)."""
    chain, n = orbit.model, np.arange(1, orbit.model.sites + 1)
    kappa = np.arccosh(abs(orbit.Omega**2 - 2.0 - chain.alpha) / (2.0 * chain.coupling))
    growth = kappa * n + np.log1p(-np.exp(-2.0 * kappa * n))
    return np.asarray((far_to_near(orbit, chain.log_rho) + growth) / np.log(10.0))


@pytest.mark.parametrize(
    ("sites", "gamma", "g", "options", "smallest"),
    [
        (200, 0.99, 1.0, {}, -372.4237),
        slow(200, 1.0 - 1e-9, 1.0, {}, -1765.4168),
        slow(200, -0.99, -1.0, {}, -374.3432),
        slow(200, -0.99, 1.0, {"walker": "arclength"}, -372.4237),
        slow(1000, 0.25, 1.0, {}, -181.6282),
        slow(1000, 0.25, 1.0, {"walker": "arclength"}, -181.6282),
        slow(1000, 0.99, 1.0, {}, -1869.5259),
        slow(3000, 0.7, 1.0, {}, -1219.3243),
    ],
)
def test_tails_are_right_down_to_the_far_end(
    sites: int, gamma: float, g: float, options: dict[str, str], smallest: float
) -> None:
    orbit = breather(sites, gamma, g, **options)
    logs = far_to_near(orbit, orbit.log10_profile)
    last = 3 * sites // 4
    np.testing.assert_allclose(np.diff(logs)[:last], np.diff(tail(orbit))[:last], atol=1e-10)
    assert abs(logs[0] - smallest) < 1e-3
    sign = far_to_near(orbit, orbit.profile_sign)[:last]
    assert np.all(sign[1:] * sign[:-1] == (-1.0 if g > 0 else 1.0))


def test_logarithms_are_those_of_the_profile_where_it_is_accurate() -> None:
    for mode in (1, 12, 24):
        orbit = follow_family(Chain(24, 1.0, 0.25, -1.0), mode, 0.5, corrector="newton").orbits[-1]
        np.testing.assert_allclose(orbit.profile_sign * 10.0**orbit.log10_profile, orbit.profile, rtol=1e-12)


def test_closed_form_of_the_tail_in_and_beside_the_band() -> None:
    # Recursion from the fixed end, harmonic by harmonic, with Omega = 1.5: 1 in the band, 3 above it.
    alpha, coupling, Omega, sites = 1.0, 0.9, 1.5, 12
    waves = np.zeros((2, sites + 2))
    waves[:, 1] = 1.0
    for k, wave in zip((1, 3), waves, strict=True):
        for d in range(1, sites + 1):
            wave[d + 1] = (2.0 + alpha - (k * Omega) ** 2) / coupling * wave[d] - wave[d - 1]
    waves *= np.array([[0.3], [0.1]]) / waves[:, -1:]
    logs, signs = _continued(waves[:, -1], Omega, alpha, coupling, sites)
    np.testing.assert_allclose(signs * np.exp(logs), waves.sum(axis=0)[1:-1], rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize(("sites", "gamma"), [(24, 0.99), slow(200, 0.7), slow(200, -0.25)])
def test_shift_at_the_smallest_amplitude(sites: int, gamma: float) -> None:
    for mode in (1, sites):
        chain = Chain(sites, 1.0, gamma, 1.0)
        for walker in ("series", "arclength"):
            branch = follow_family(chain, mode, 1.0, at=(1e-14,), corrector="newton", walker=walker)
            slope = frequency_slope(sites, 1.0, gamma, 1.0, mode)
            found = next(orbit for orbit in branch.orbits if orbit.S == 1e-14)
            assert abs(found.Omega_shift / (1e-14 * slope) - 1.0) < 1e-9


@pytest.mark.usefixtures("pictures")
def test_files_and_pictures_of_a_steep_chain(tmp_path: Path) -> None:
    branch = follow_family(Chain(200, 1.0, 1.0 - 1e-9, 1.0), 200, 1.0, at=(0.5,), corrector="newton", tolerance=1e-4)
    write_netcdf(tmp_path / "family.nc", dataset_of([branch]))
    with netcdf_file(tmp_path / "family.nc", mmap=False) as file:
        assert file.variables["log10_profile"][-1].min() < -1000.0
        assert set(np.unique(file.variables["profile_sign"][:])) == {-1, 1}
    figure = profile_figure([branch])
    assert figure.axes[1].get_ylim()[0] < -1000.0
    assert save(figure, tmp_path / "profile")


def test_sites_at_rest_are_empty(tmp_path: Path) -> None:
    branch = follow_family(Chain(3, 1.0, 1.0, 1.0), 3, 0.5, corrector="newton")
    write_netcdf(tmp_path / "family.nc", dataset_of([branch]))
    with netcdf_file(tmp_path / "family.nc", mmap=False) as file:
        logs = file.variables["log10_profile"]
        assert np.all(logs[:, :2] == NETCDF_FILL_VALUE)
        assert logs._FillValue == NETCDF_FILL_VALUE
        np.testing.assert_allclose(10.0 ** logs[:, 2], np.sqrt(branch.S), rtol=1e-12)
        assert np.all(file.variables["profile_sign"][:, :2] == 0)


def test_tables_refuse_what_is_not_finite(tmp_path: Path) -> None:
    rows = [{"mode": 1, "point": k, "S": 0.1, "Omega": value} for k, value in enumerate((1.0, np.nan))]
    with pytest.raises(ArithmeticError, match=r"^Omega: nan in row 2 \(mode 1, point 1, S 0.1\); it is not written$"):
        write_csv(tmp_path / "family.csv", ("mode", "point", "S", "Omega"), rows)
    assert not (tmp_path / "family.csv").exists()


@pytest.mark.parametrize("alpha", [1e6, *(slow(soft) for soft in (0.0, 1e-8))])
def test_soft_and_stiff_sites(alpha: float) -> None:
    for mode in (1, 24):
        branch = follow_family(Chain(24, alpha, 0.25, 1.0), mode, 0.5, at=(1e-14,), corrector="newton")
        assert branch.complete
        slope = frequency_slope(24, alpha, 0.25, 1.0, mode)
        found = next(orbit for orbit in branch.orbits if orbit.S == 1e-14)
        assert abs(found.Omega_shift / (1e-14 * slope) - 1.0) < 1e-8


def test_stiffnesses_without_a_family_are_refused_with_their_bound() -> None:
    with pytest.raises(
        ValueError, match=r"^mode: given mode 1, which has omega\^2 = -0\.\d+ at alpha = -0\.2; .*: alpha > -0\.0"
    ):
        follow_family(Chain(24, -0.2, 0.25, 1.0), 1, 0.5)
    with pytest.raises(ValueError, match=r"^alpha: given 1000000000000\.0; accepted: for families up to 3\.87e\+10 \("):
        follow_family(Chain(24, 1e12, 0.25, 1.0), 1, 0.5)


def test_the_largest_residual_is_named_by_its_place() -> None:
    branch = follow_family(Chain(3, 1.0, 0.3, 1.0), 1, 0.1, corrector="newton")
    problem, z = branch.orbits[-1].point.problem, branch.orbits[-1].point.z.copy()
    z[4] *= 2.0
    words = problem.describe_largest_residual(z)
    assert words.startswith("largest residual ")
    assert "at site 2, node " in words
