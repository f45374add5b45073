"""Scenes of any model and orbits of chains: files, and numbers known independently."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drawing import blank_pictures
from outputs import EXAMPLES, read_rows
from scenes import Runs, chain, column, family, table, written
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from casadi_skin import Chain, follow_family
from casadi_skin.model.loading import run_file
from casadi_skin.runs.program import main

MODELS = """
import casadi as ca
from casadi_skin import OdeModel


def lattice(name, sites, onsite, bond, **declared):
    y, v, b = ca.SX.sym("y", sites), ca.SX.sym("v", sites), ca.SX.sym("b")
    d = ca.diff(ca.vertcat(0, y, 0)) if name == "fput" else ca.diff(y)
    potential = ca.sum1(onsite(y, b)) + ca.sum1(bond(d, b))
    return OdeModel(
        name, y, -ca.gradient(potential, y), b, 2, v, nominal=(1.0,), hamiltonian=ca.dot(v, v) / 2 + potential,
        reversal=(1,) * sites + (-1,) * sites, half_period=(-1,) * (2 * sites), **declared,
    )


pair = lattice("pair", 2, lambda y, b: y**2 / 2 + b * y**4 / 4, lambda d, b: d**2 / 20)
fput = lattice("fput", 5, lambda y, b: 0 * y, lambda d, b: d**2 / 2 + b * d**4 / 4)
x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
van_der_pol = OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu, nominal=(1.0,))
"""
PAIR = (
    "[spectrum]\n" + family(["first", "last"], at=[0.5], film=True) + table("stability", vectors=True)
    + table("dynamics", S=0.5, mode=2, periods=2, samples=21, size=0.1, vector=[1.0, 0.0, 0.0, 1.0])
    + table("export", c=["rhs"]) + table("accuracy", tolerance=1e-9)
)  # fmt: skip
CYCLE = table("orbit", start=[2.0, 0.0], transient=40.0, section={"y": 0.0}) + table("dynamics", periods=2, samples=9)
CHAIN_ORBIT = (
    chain(3, gamma=0.1, g=1.0)
    + table("orbit", start=[0.2, -0.4, 0.5, 0, 0, 0], period=3.0, select={"y_3": 0.5}, symmetric=True)
    + table("continuation", parameter="gamma", to=0.4, at=[0.25]) + "[stability]\n"
    + table("dynamics", duration=5.0, samples=6)
)  # fmt: skip


def pair_forces(y: np.ndarray) -> np.ndarray:
    """Forces of two Duffing oscillators y'' = -y - y^3 that a spring of stiffness 0.1 couples."""
    return np.asarray(-y - y**3 - 0.1 * (y - y[::-1]))


def chain_forces(y: np.ndarray, gamma: float) -> np.ndarray:
    """Forces of the chain with alpha = g = 1 (paper, Eq. 1)."""
    left, right = np.append(0.0, y[:-1]), np.append(y[1:], 0.0)
    return np.asarray((1.0 + gamma) * left - 2.0 * y + (1.0 - gamma) * right - y - y**3)


@pytest.fixture(scope="module")
def pair_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of a run with all that a scene of families asks for."""
    folder = tmp_path_factory.mktemp("pair")
    (folder / "scene.toml").write_text(written(folder, MODELS, "pair", PAIR), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        blank_pictures(patch)
        assert main(["run", str(folder / "scene.toml"), "--out", str(folder / "out"), "--quiet"]) == 0
    return folder / "out"


# Families of lattices of one's own --------------------------------------------------------------------------------


def test_families_of_a_lattice_of_ones_own(pair_run: Path) -> None:
    pictures = {"frequency", "profile", "spectrum", "dynamics", "multipliers_j1", "multipliers_j2"}
    assert {path.name for path in pair_run.iterdir()} == {
        *(f"{stem}.png" for stem in pictures), "film_j1.gif", "film_j2.gif",
        "family.csv", "events.csv", "further_events.csv", "tongues.csv", "passed_resonances.csv", "family.nc",
        "spectrum.csv", "dynamics.csv", "dynamics.nc", "export",
        "scene.toml", "scene_model.py",
    }  # fmt: skip
    table = read_rows(pair_run / "family.csv")
    assert {r["mode"] for r in table} == {"1", "2"}
    model = run_file(pair_run.parent / "model.py", MODELS)["pair"]
    for mode in (1, 2):
        mine = [r for r in table if r["mode"] == str(mode)]
        branch = follow_family(model, mode, 1.0, at=[0.5], stability=True, tolerance=1e-9)
        np.testing.assert_allclose([float(r["S"]) for r in mine], branch.S, rtol=1e-13)
        np.testing.assert_allclose([float(r["energy"]) for r in mine], branch.energy, rtol=1e-13)
        for row in mine:  # y = A cn in phase and out of phase, with the stiffness 1 and 1.2
            stiffness, square = (1.0, 1.2)[mode - 1], 0.5 * float(row["S"])
            rate = stiffness + square
            exact = 0.5 * np.pi * np.sqrt(rate) / ellipk(square / (2.0 * rate))
            assert float(row["Omega"]) == pytest.approx(exact, abs=2e-9)
            assert float(row["energy"]) == pytest.approx(stiffness * square + square**2 / 2.0, rel=1e-12)
    # Lame's equation of perturbations of y = -y': the stability of mode 2 changes at h = 1 + m, where A^2 = 2/15.
    (event,) = read_rows(pair_run / "events.csv")
    assert (event["mode"], event["kind"], event["stable_before"], event["stable_after"]) == ("2", "real", "1", "0")
    assert float(event["S"]) == pytest.approx(4.0 / 15.0, abs=1e-6)


def test_netcdf_and_spectrum_of_a_lattice_of_ones_own(pair_run: Path) -> None:
    xarray = pytest.importorskip("xarray")
    table = read_rows(pair_run / "family.csv")
    with xarray.open_dataset(pair_run / "family.nc", engine="scipy") as data:
        np.testing.assert_array_equal(data.Omega.values, [float(r["Omega"]) for r in table])
        y = data.profile.values
        assert (y**2).sum(axis=1) == pytest.approx(data.S.values, rel=1e-12)
        potential = (y**2 / 2 + y**4 / 4).sum(axis=1) + 0.05 * (y[:, 0] - y[:, 1]) ** 2
        np.testing.assert_allclose(data.energy.values, potential, rtol=1e-12)
        np.testing.assert_allclose(data.coefficients.values.sum(axis=1), y, atol=1e-14)
        (first, second), vectors = data.vectors_point.values, data.vectors.values
        assert [table[i]["mode"] for i in (first, second)] == ["1", "2"]
        assert vectors.shape == (2, 4, 4, 2)
        multipliers = data.multipliers.values[..., 0] + 1j * data.multipliers.values[..., 1]
        assert np.hypot(*np.moveaxis(data.multipliers.values, -1, 0)).max(axis=1) == pytest.approx(
            data.max_abs_multiplier.values, rel=1e-12
        )
        for place, vector in zip((first, second), vectors[..., 0] + 1j * vectors[..., 1], strict=True):
            growing = int(np.argmax(np.abs(multipliers[place])))
            period, start = 2 * np.pi / data.Omega.values[place], np.append(y[place], [0.0, 0.0])
            after = flow_of_pair(start + 1e-7 * vector[:, growing].real, period)
            before = flow_of_pair(start - 1e-7 * vector[:, growing].real, period)
            expected = (multipliers[place, growing] * vector[:, growing]).real
            np.testing.assert_allclose((after - before) / 2e-7, expected, atol=1e-5)
        assert data.attrs["model"] == "pair"
        assert "def lattice" in data.attrs["model_source"]
    frequencies = [float(r["omega"]) for r in read_rows(pair_run / "spectrum.csv")]
    np.testing.assert_allclose(frequencies, [1.0, np.sqrt(1.2)], rtol=1e-14)


def flow_of_pair(state: np.ndarray, period: float) -> np.ndarray:
    flow = solve_ivp(
        lambda t, s: [*s[2:], *pair_forces(s[:2])], (0.0, period), state, method="DOP853", rtol=1e-12, atol=1e-13
    )
    return np.asarray(flow.y[:, -1])


def test_time_evolution_of_a_perturbed_mode(pair_run: Path) -> None:
    path = pair_run / "dynamics.csv"
    assert list(read_rows(path)[0]) == ["t", "energy", "y_0", "y_1"]
    t, energy, *y = (column(path, name) for name in ("t", "energy", "y_0", "y_1"))
    amplitude, kick = 0.5, 0.1 / np.sqrt(2.0)  # S = 0.5 out of phase, and half of the kick in each component
    sign = np.sign(y[1][0])
    start = [-sign * amplitude + kick, sign * amplitude, 0.0, kick]
    np.testing.assert_allclose([y[0][0], y[1][0]], start[:2], atol=1e-9)
    np.testing.assert_allclose([y[0][-1], y[1][-1]], flow_of_pair(np.array(start), t[-1])[:2], atol=1e-7)
    assert np.ptp(energy) < 1e-9 * energy[0]


@pytest.mark.usefixtures("pictures")
def test_the_spectrum_of_a_lattice_of_ones_own(run: Runs) -> None:
    scene, exact = written(run.folder, MODELS, "fput", "[spectrum]\n"), 2.0 * np.sin(np.arange(1, 6) * np.pi / 12.0)
    printed = [float(line.split()[1]) for line in run(scene, command="spectrum").out.splitlines()[1:]]
    np.testing.assert_allclose(printed, exact, rtol=1e-13)
    run(scene)
    np.testing.assert_allclose(run.columns("spectrum", "omega")[0], exact, rtol=1e-14)
    assert "spectrum.png" in run.files


def test_the_plan_of_families_of_a_model(run: Runs) -> None:
    plan = run(EXAMPLES / "fput_modes.toml", "--measure", command="check").out
    for words in (
        "y_0, y_1, ..., v_23 (48 in all)", "time reversal, half-period symmetry, conserved quantity",
        "j = 1, 2, 24, to S = 2, points exactly at S = 1", "a quarter of the period", "the equations are Hamiltonian",
        "odd cosines", "variational system with the splitting flow", "for 3 families",
    ):  # fmt: skip
        assert words in plan


# Orbits -----------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("pictures")
def test_time_evolution_of_a_limit_cycle(run: Runs) -> None:
    assert "dynamics: cvodes in physical coordinates" in run(written(run.folder, MODELS, "van_der_pol", CYCLE)).out
    assert list(run.rows("dynamics")[0]) == ["t", "x", "y"]
    t, *states = run.columns("dynamics", "t", "x", "y")
    states = np.transpose(states)
    assert t[-1] == pytest.approx(2 * 6.6632868593231, abs=1e-8)  # Hairer, Norsett and Wanner 1993, exercise I.16.1
    np.testing.assert_allclose(states[4::4], states[[0, 0]], atol=1e-7)
    assert abs(states[0, 1]) < 1e-9
    flow = solve_ivp(
        lambda t, s: [s[1], (1 - s[0] ** 2) * s[1] - s[0]], (0.0, t[-1]), states[0], method="DOP853",
        t_eval=t, rtol=1e-12, atol=1e-12,
    )  # fmt: skip
    np.testing.assert_allclose(states, flow.y.T, atol=1e-7)


@pytest.mark.slow
@pytest.mark.usefixtures("pictures")
def test_an_orbit_of_a_chain_is_followed_in_its_nonreciprocity(run: Runs) -> None:
    run(CHAIN_ORBIT)
    table = run.rows("branch")
    assert [float(r["gamma"]) for r in table if r["requested"] == "1"] == [0.25]
    for row in (table[0], next(r for r in table if r["requested"] == "1"), table[-1]):
        chain = Chain(3, 1.0, float(row["gamma"]), 1.0)
        family = follow_family(chain, "last", 2.0, stability=True, events=False, tolerance=1e-9)
        orbit = family.at(period=float(row["period"]))
        assert abs(orbit.profile[2]) == pytest.approx(0.5, abs=1e-6)
        assert float(row["y_1_max"]) == pytest.approx(abs(orbit.profile[0]), abs=1e-6)
        assert float(row["max_abs_multiplier"]) == pytest.approx(orbit.floquet().max_abs_multiplier, abs=1e-5)
        assert bool(int(row["stable"])) == orbit.floquet().stable
    assert list(run.rows("dynamics")[0]) == ["t", "energy", "y_1", "y_2", "y_3"]
    energies, *motion = run.columns("dynamics", "energy", "y_1", "y_2", "y_3")
    assert np.ptp(energies) < 1e-9 * energies[0]
    last = [y[0] for y in motion]
    flow = solve_ivp(
        lambda t, s: [*s[3:], *chain_forces(s[:3], 0.4)], (0.0, 5.0), [*last, 0, 0, 0], rtol=1e-11, atol=1e-12
    )
    np.testing.assert_allclose([y[-1] for y in motion], flow.y[:3, -1], atol=1e-7)
    weights, y = (1.4 / 0.6) ** np.arange(2, -1, -1), np.array(last)  # of the gauge, as of its family; at rest
    energy = weights @ (1.5 * y**2 + y**4 / 4) - 0.6 * weights[:2] @ (y[:-1] * y[1:])
    np.testing.assert_allclose(energies, energy, rtol=1e-9)
    assert (run.out / "special_points.csv").read_text(encoding="utf-8") == "kind,gamma,error,period\n"
