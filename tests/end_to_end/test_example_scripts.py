"""The example scripts, each against a number computed independently or an exact identity; all draw their pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drawing import blank_pictures
from outputs import EXAMPLES, RunExample, load, read_rows
from scipy.integrate import solve_ivp

from casadi_skin import Orbit, distance_from_orbit, evolve
from casadi_skin.runs.program import main

PICTURES = Path(__file__).parents[2] / "docs" / "pictures"


def test_gradients(run_example: RunExample) -> None:
    """Against the derivatives of the closed form, and its spread over the draws."""
    hopf, gradient, places = run_example("gradients")
    module, h = load("gradients"), 1e-4
    for name, (by_sigma, by_beta) in {"sigma": (h, 0.0), "beta": (0.0, h)}.items():
        sides = (module.closed_form(10.0 + k * by_sigma, 8 / 3 + k * by_beta) for k in (1.0, -1.0))
        assert gradient[name] == pytest.approx((next(sides) - next(sides)) / (2.0 * h), rel=1e-6)
    assert hopf.parameters["r"] == pytest.approx(470 / 19, abs=1e-10)
    assert gradient.spread({"sigma": 0.5, "beta": 0.1}) == pytest.approx(np.std(places), rel=0.05)


def test_fit_of_a_neuron(run_example: RunExample) -> None:
    """The planted parameters within three deviations, of all together too."""
    module, fit = load("fit_neuron"), run_example("fit_neuron")
    assert fit.found
    off = np.array([(fit[name] - value) / fit.deviations[name] for name, value in module.planted.items()])
    assert np.max(np.abs(off)) < 3.0
    assert off @ np.linalg.solve(fit.correlation, off) < 14.2  # 99.7 per cent of chi square of three
    assert [point.kind for point in fit.located] == ["hopf", "hopf", "fold", "fold"]


def physical_flow(orbit: Orbit, perturbations: np.ndarray, time: float) -> np.ndarray:
    """Perturbations (2N, columns) after `time`: Eq. 1 and its linearisation, written out here, by Dormand-Prince."""
    chain = orbit.model
    N, columns = chain.sites, perturbations.shape[1]
    coupling = np.diag(np.full(N - 1, 1 + chain.gamma), -1) + np.diag(np.full(N - 1, 1 - chain.gamma), 1)
    matrix = coupling - (2 + chain.alpha) * np.eye(N)

    def field(_: float, x: np.ndarray) -> np.ndarray:
        y, v, z = x[:N], x[N : 2 * N], x[2 * N :].reshape(2 * N, columns)
        stiffness = matrix - np.diag(3 * chain.g * y**2)
        return np.concatenate([v, matrix @ y - chain.g * y**3, z[N:].ravel(), (stiffness @ z[:N]).ravel()])

    start = np.concatenate([orbit.profile, np.zeros(N), perturbations.ravel()])
    end = solve_ivp(field, (0.0, time), start, "DOP853", rtol=1e-11, atol=1e-14).y[:, -1]
    return end[2 * N :].reshape(2 * N, columns)


@pytest.mark.slow
def test_follow_one_family(run_example: RunExample) -> None:
    branch = run_example("follow_one_family")
    reference = {0.2: 1.036393147166972, 1.0: 1.018532435491958, 3.0: 0.765958900020734}  # independent codes
    for S, Omega in reference.items():
        assert abs(branch.at(S=S).Omega / Omega - 1) < 1e-9
    # dH/dS vanishes where real instability begins: central difference of the energy at the located change
    first, h = branch.changes[0], 0.002
    slope = (branch.at(S=first.S + h).energy - branch.at(S=first.S - h).energy) / (2 * h)
    elsewhere = (branch.at(S=0.3 + h).energy - branch.at(S=0.3 - h).energy) / (2 * h)
    assert first.kind == "real"
    assert abs(slope) < 1e-4 * abs(elsewhere)


def test_backbone_series(run_example: RunExample) -> None:
    branch, series = run_example("backbone_series")
    assert abs(series.radius - 0.962068) <= series.radius_error < 0.05  # of 120 orders
    inside = series.radius - 2 * series.radius_error > branch.S
    miss = np.abs(series.frequency(branch.S[inside]) - branch.Omega[inside])
    assert np.all(miss <= series.frequency_error(branch.S[inside]) + 1e-12)


@pytest.mark.slow
def test_stability_boundary(run_example: RunExample) -> None:
    found = run_example("stability_boundary", np.array([0.2, 0.3]))
    # Scans in steps of 1e-5 by another program; windows of 3e-4 and 2e-5 in S.
    np.testing.assert_allclose(found[:, 0, 0], [0.15880, 0.02295], atol=6e-6)
    assert np.all(found[:, 0, 1] < 1e-9)


@pytest.mark.slow
def test_floquet_vectors(run_example: RunExample) -> None:
    orbit, multipliers, vectors = run_example("floquet_vectors")
    assert abs(np.abs(multipliers).max() - 1.1712757348) < 1e-9  # independent code
    chosen = [2, 3, 10, 25, int(np.argmax(np.abs(multipliers)))]
    parts = np.hstack([vectors[:, chosen].real, vectors[:, chosen].imag])
    moved = physical_flow(orbit, parts, orbit.period)
    image = moved[:, : len(chosen)] + 1j * moved[:, len(chosen) :]
    np.testing.assert_allclose(image, vectors[:, chosen] * multipliers[chosen], rtol=0, atol=1e-6)


@pytest.mark.slow
def test_proved_orbits(run_example: RunExample) -> None:
    pytest.importorskip("flint")
    found = run_example("proved_orbits", chains=12)
    assert len(found) == 12
    assert np.all(found[:, 1] <= found[:, 0])  # every estimate is honest
    assert np.all((found[:, 2] > 0) & (found[:, 2] < 2e-15))


def test_kick_from_the_far_end(run_example: RunExample) -> None:
    example = load("kick_from_the_far_end")
    orbit, growth = run_example("kick_from_the_far_end")
    kicks = np.stack([example.unit_displacement(1), example.unit_displacement(24), growth.optimal], axis=1)
    k = int(np.argmax(growth.log10_bounded))
    norms = np.linalg.norm(physical_flow(orbit, kicks, growth.t[k]), axis=0)
    found = [growth.of(kick)[k] for kick in kicks.T]
    np.testing.assert_allclose(found, np.log10(norms), rtol=0, atol=1e-6)
    assert abs(found[2] - growth.log10_bounded[k]) < 1e-9
    assert found[0] > 2 > 0 > found[1]


@pytest.mark.slow
def test_smallest_kick(run_example: RunExample) -> None:
    kick = run_example("smallest_kick", starts=2)
    orbit, n = kick.orbit, kick.orbit.model.sites
    assert kick.best.strict
    assert abs(kick.norm / 6.52883e-4 - 1) < 1e-5
    # Dormand-Prince in physical coordinates: it escapes at the very end, the far end at the same norm does not.
    far_end = kick.far_end_kick * kick.norm / kick.far_end_norm
    for z, least, most in ((kick.best.kick, 0.49999, 0.50001), (far_end, 0.3, 0.45)):
        run = evolve(orbit.model, orbit.profile + z[:n], z[n:], np.linspace(0, 40, 801), "dop853", 1e-11, "physical")
        assert least < distance_from_orbit(orbit, run).max() < most
    # What linear growth makes of it, by the linearised equations written out above.
    seen = physical_flow(orbit, np.eye(2 * n), kick.linear_time) / np.repeat([1.0, orbit.Omega], n)[:, None]
    y = [orbit.evaluate(kick.linear_time + h) for h in (-1e-4, 0.0, 1e-4)]
    tangent = np.concatenate([y[2] - y[0], (y[2] - 2 * y[1] + y[0]) / (0.5e-4 * orbit.Omega)])
    tangent /= np.linalg.norm(tangent)
    gain = np.linalg.svd(seen - np.outer(tangent, tangent @ seen))[1][0]
    assert abs(kick.linear_norm * gain / (0.5 * np.sqrt(orbit.S)) - 1) < 1e-5


def test_thousand_sites(run_example: RunExample) -> None:
    example = load("thousand_sites")
    extended, breather = run_example("thousand_sites")
    # Harmonic balance of the last 120 sites with 5 harmonics and Newton's method in numpy: the rest is at rest.
    assert abs(breather.Omega / 2.227581383482702 - 1) < 1e-11
    # The tail in closed form, from site to site, down to 1e-180.
    tail, n = breather.coefficients(16)[0], slice(1, 950)
    ratio = -example.linear_tail(breather)[:-1] / example.linear_tail(breather)[1:]
    np.testing.assert_allclose((tail[:-1] / tail[1:])[n], ratio[n], rtol=1e-6)
    # The equations of motion at instants that are not nodes, relative to the terms at each site.
    for orbit in (extended, breather):
        assert residual(orbit) < 1e-6
    assert abs(extended.profile).min() < 1e-112


def residual(orbit: Orbit) -> float:
    """Largest residual of Eq. 1 relative to the largest term at the same site, from the Fourier coefficients alone."""
    chain, odd = orbit.model, 2 * np.arange(16) + 1
    cosine = np.cos(np.outer(np.array([0.1, 0.4, 0.9]), odd))
    c = orbit.coefficients(16)
    y, acceleration = cosine @ c, -(cosine * (odd * orbit.Omega) ** 2) @ c
    padded = np.pad(y, ((0, 0), (1, 1)))
    terms = np.stack(
        [acceleration, -(1 + chain.gamma) * padded[:, :-2], -(1 - chain.gamma) * padded[:, 2:],
         (2 + chain.alpha) * y, chain.g * y**3]
    )  # fmt: skip
    return float(np.max(np.abs(terms.sum(axis=0)).max(axis=0) / np.abs(terms).max(axis=(0, 1))))


@pytest.mark.slow
def test_duffing_check(run_example: RunExample) -> None:
    example = load("duffing_check")
    errors = run_example("duffing_check")
    mpmath = pytest.importorskip("mpmath")
    with mpmath.workdps(30):  # the closed form that the example compares with, S = 2, g = -1, omega^2 = 3
        exact = mpmath.pi * mpmath.sqrt(1) / (2 * mpmath.ellipk(mpmath.mpf(-1)))
    assert abs(example.closed_forms.duffing_frequency(3.0, -1.0, np.sqrt(2.0)) / float(exact) - 1) < 1e-15
    for true, estimated in errors.values():
        assert np.all(true <= np.maximum(example.TOLERANCES, 1e-15))
        assert np.all(true <= np.maximum(estimated, 1e-15))
    assert errors["trigonometric"].true[-1] < 1e-14


@pytest.mark.slow
def test_export_c(run_example: RunExample) -> None:
    numbers, in_c, in_python = run_example("export_c")
    assert abs(numbers["period"] / (2 * np.pi / 1.018532435491958) - 1) < 1e-13  # independent codes
    assert abs(numbers["largest_multiplier"] - 1.171275734790) < 1e-12
    assert np.abs(in_c[:, 1] - in_python).max() < 1e-9
    assert np.abs(in_c[:400, 1]).max() < 0.35 < 0.45 < np.abs(in_c[:, 1]).max()  # the kick arrives after four periods


@pytest.mark.slow
def test_chain_as_fmu(run_example: RunExample) -> None:
    differences = run_example("chain_as_fmu")
    assert differences["CoSimulation"] < 1e-11
    assert differences["ModelExchange"] < 1e-5


@pytest.mark.slow
def test_co_simulation(run_example: RunExample) -> None:
    """Multipliers and periods by scipy's integrator along the orbit, with the variational equations."""
    orbits = run_example("co_simulation")
    for orbit in (orbits[0], orbits[-1]):
        c = orbit.parameters["c"]

        def field(_: float, s: np.ndarray, c: float = c) -> np.ndarray:
            (x, y, z), M = s[:3], s[3:].reshape(3, 3)
            J = np.array([[0.0, -1.0, -1.0], [1.0, 0.2, 0.0], [z, 0.0, x - c]])
            return np.concatenate([[-y - z, x + 0.2 * y, 0.2 + z * (x - c)], (J @ M).ravel()])

        start = np.concatenate([orbit.state, np.eye(3).ravel()])
        end = solve_ivp(field, (0.0, orbit.period), start, "DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
        assert end[:3] == pytest.approx(orbit.state, abs=1e-7)
        eigenvalues = np.linalg.eigvals(end[3:].reshape(3, 3))
        assert np.min(np.abs(eigenvalues - orbit.multipliers[0])) <= orbit.multiplier_errors[0] < 1e-4
    assert [orbit.stable for orbit in orbits] == [orbit.parameters["c"] < 2.832445 for orbit in orbits]


@pytest.mark.slow
def test_foreign_fmu(run_example: RunExample) -> None:
    branch = run_example("foreign_fmu")
    assert branch.at(1.0).period == pytest.approx(6.66328685932313, abs=1e-8)

    def field(_: float, x: np.ndarray) -> list[float]:
        return [x[1], 4.0 * (1.0 - x[0] ** 2) * x[1] - x[0]]

    def turns(_: float, x: np.ndarray) -> float:
        return float(x[1])

    turns.direction = -1.0  # type: ignore[attr-defined]
    crossings = solve_ivp(field, (0.0, 80.0), [2.0, 0.0], "DOP853", rtol=1e-12, atol=1e-12, events=turns).t_events[0]
    assert branch.at(4.0).period == pytest.approx(crossings[-1] - crossings[-2], abs=1e-7)


DRAWN = [path for path in sorted(EXAMPLES.glob("*.py")) if "png" in path.read_text(encoding="utf-8").lower()]


@pytest.mark.parametrize("path", DRAWN, ids=lambda path: path.stem)
def test_the_picture_of_the_site_is_there_and_small(path: Path) -> None:
    assert (PICTURES / f"{path.stem}.png").stat().st_size < 150_000
    assert "from casadi_skin import" in path.read_text(encoding="utf-8")


@pytest.mark.slow
def test_overview(run_example: RunExample) -> None:
    softening, breather, branches, largest = run_example("overview", np.array([0.2, 0.3]))
    assert len(softening.changes) == 47  # as many as in scans in steps of 1e-5 by another program
    corner = breather.profile.reshape(10, 8)[5:, 4:]  # the one that bonds push to
    assert np.sum(corner**2) > 0.95 * breather.S
    branch_point, hopf, homoclinic = (point for branch in branches for point in branch.special_points)
    assert branch_point.parameters["r"] == pytest.approx(1.0)
    assert hopf.parameters["r"] == pytest.approx(470 / 19)  # closed form, sigma = 10, b = 8/3
    assert homoclinic.parameters["r"] == pytest.approx(13.92655741, abs=2e-6)  # published (Sparrow 1982: 13.926)
    first = np.array([0.01, *np.linspace(0.01, 1.0, 60)])[np.argmax(largest > 1.01, axis=0)]
    assert first[1] == pytest.approx(0.7, abs=0.1)  # where stability_boundary finds a growth of 0.01 at gamma = 0.3


@pytest.mark.slow
def test_sine_gordon_kink(run_example: RunExample) -> None:
    kink, families = run_example("sine_gordon_kink")
    assert kink.stable
    y = np.concatenate([kink.positions[:1], kink.positions, kink.positions[-1:]])
    balance = 0.4 * (0.98 * (y[2:] - y[1:-1]) - 1.02 * (y[1:-1] - y[:-2])) - np.sin(kink.positions)
    assert np.max(np.abs(balance)) < 1e-12
    assert (y[0], y[-1]) == pytest.approx((0.0, 2.0 * np.pi), abs=0.01)
    assert families[1].orbits[0].Omega < 1.0  # waves beside the kink have omega >= 1
    assert families[0].orbits[0].Omega < 0.7


@pytest.mark.slow
def test_isola(run_example: RunExample) -> None:
    crossings, sweep, isola = run_example("isola")
    # By hand: on an orbit in which both oscillators move alike, x'' + 1.3 x + 0.05 x^3 = 0, what the drive gives at its
    # best phase, F integral of x' cos(omega t + phase), equals 2 c times the integral of (1 - 2 x^2 + 0.6 x^4) x'^2.
    for crossing in crossings:
        a, period = np.sqrt(crossing.S / 2), 2 * np.pi / crossing.Omega
        times = np.linspace(0.0, period, 2001)
        x, v = solve_ivp(
            lambda t, z: [z[1], -1.3 * z[0] - 0.05 * z[0] ** 3], (0.0, period), [a, 0.0], "DOP853", times,
            rtol=1e-11, atol=1e-12,
        ).y  # fmt: skip
        assert x[-1] == pytest.approx(a, rel=1e-7)
        given = 0.0182 * abs(np.trapezoid(v * np.exp(1j * crossing.Omega * times), times))
        taken = 2 * 0.02 * np.trapezoid((1 - 2 * x**2 + 0.6 * x**4) * v**2, times)
        assert given == pytest.approx(taken, rel=1e-5)
    assert len(crossings) == 3
    assert [point.kind for point in sweep.special_points] == []
    frequencies = [orbit.parameters["omega"] for orbit in isola.orbits]
    assert [point.kind for point in isola.special_points] == ["fold", "fold"]  # a closed curve has two
    assert "closed on itself" in isola.reason
    assert min(frequencies) < crossings[1].Omega < crossings[2].Omega < max(frequencies) < 1.21


@pytest.mark.slow
def test_localised_changes(run_example: RunExample, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The script and the scene have the same four; the second is at the extremum of the energy."""
    branch = run_example("localised_changes")
    found = branch.localised_diagram
    expected = [0.10182823265077, 2.3316117706867, 2.8691016136668, 2.8693340820587]
    assert found.complete
    assert [change.S for change in found.all] == pytest.approx(expected, abs=1e-10)
    energy = np.interp([2.2, 2.3316, 2.5], branch.S, branch.energy)
    assert (energy[1] - energy[0]) * (energy[2] - energy[1]) < 0.0
    blank_pictures(monkeypatch)
    assert main(["run", str(EXAMPLES / "localised_changes.toml"), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    rows = [row for name in ("events", "further_events") for row in read_rows(tmp_path / "out" / f"{name}.csv")]
    assert sorted(float(row["S"]) for row in rows) == pytest.approx(expected, abs=1e-10)
