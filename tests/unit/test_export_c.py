"""Generated C against Python and against numbers computed by other means; refusals; what compilers make of it."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import casadi as ca
import numpy as np
import pytest
from c_programs import COMPILERS, SANITIZED, STRICT, Library, compiled, printed, sanitizers
from marks import slow
from scipy.integrate import solve_ivp

from casadi_skin import Chain, OdeModel, Orbit, export_c, find_orbit, follow_family
from casadi_skin.export.codegen import CodegenError, CompilerError, build_c, c_name, c_source
from casadi_skin.export.exported_model import EXPORTED_PARTS
from casadi_skin.runs.scene import C_PARTS

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not there (CI has it)")
SOFT = Chain(24, 1.0, 0.25, -1.0)


@pytest.fixture(scope="module")
def orbit() -> Orbit:
    return follow_family(SOFT, mode=1, amplitude_max=1.0, at=(1.0,), tolerance=1e-12).at(S=1.0)


@pytest.fixture(scope="module")
def exported(orbit: Orbit, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_c(orbit, tmp_path_factory.mktemp("c") / "orbit")


@pytest.fixture(scope="module")
def library(exported: Path, tmp_path_factory: pytest.TempPathFactory) -> Library:
    copy = tmp_path_factory.mktemp("library")
    shutil.copytree(exported, copy, dirs_exist_ok=True)
    return Library(copy, "chain")


def forced_oscillator(**changes: Any) -> OdeModel:
    """A forced Duffing oscillator with two outputs, of first order, named as no C name may be."""
    x, p, t = ca.SX.sym("x", 2), ca.vertcat(ca.SX.sym("delta"), ca.SX.sym("double")), ca.SX.sym("t")
    field = ca.vertcat(x[1], -p[0] * x[1] - x[0] - x[0] ** 3 + p[1] * ca.cos(1.3 * t))
    declared: dict[str, Any] = {
        "time": t, "forcing_period": 2 * np.pi / 1.3, "outputs": {"energy": x[1] ** 2 / 2, "int": x[0] * p[1] + t},
        "nominal": (0.2, 0.5),
    }  # fmt: skip
    return OdeModel('while "*/ 1 Duffing\\', x, field, p, **(declared | changes))


# The equations of motion ---------------------------------------------------------------------------------------------


def physical_field(y: np.ndarray, v: np.ndarray, chain: Chain) -> np.ndarray:
    """Eq. 1, written out."""
    padded = np.pad(y, 1)
    force = (1 + chain.gamma) * padded[:-2] + (1 - chain.gamma) * padded[2:] - (2 + chain.alpha) * y - chain.g * y**3
    return np.concatenate([v, force])


def test_rhs_jacobian_and_variational_of_the_chain(library: Library) -> None:
    generator = np.random.default_rng(1)
    x, n = generator.normal(size=48), 48
    p, rhs = np.array([0.7, -0.4, 1.3]), np.zeros(48)
    other = Chain(24, *p)
    library.call("rhs", 0.0, x, p, rhs, library.work("RHS_WORK"))
    np.testing.assert_allclose(rhs, physical_field(x[:24], x[24:], other), rtol=0, atol=1e-13)
    again, nonzeros, dfdp = np.zeros(n), np.zeros(library["JACOBIAN_NONZEROS"]), np.zeros(3 * n)
    library.call("jacobian", 0.0, x, p, again, nonzeros, dfdp, library.work("JACOBIAN_WORK"))
    np.testing.assert_array_equal(again, rhs)
    J = library.sparse("jacobian", nonzeros, n)
    h, unit = 1e-6, np.eye(n)
    columns = [
        (physical_field(*np.split(x + h * e, 2), other) - physical_field(*np.split(x - h * e, 2), other)) / (2 * h)
        for e in unit
    ]
    np.testing.assert_allclose(J, np.transpose(columns), atol=1e-7)
    by_gamma = (physical_field(x[:24], x[24:], Chain(24, 0.7, -0.4 + h, 1.3)) - rhs) / h
    np.testing.assert_allclose(dfdp.reshape(3, n)[1], by_gamma, atol=1e-6)
    V, product = generator.normal(size=(3, n)), np.zeros((3, n))
    library.call("variational", 0.0, x, p, 3, V, again, product, library.work("VARIATIONAL_WORK"))
    np.testing.assert_allclose(product, V @ J.T, atol=1e-13)
    alone = np.zeros_like(nonzeros)  # results that are not wanted are null pointers
    library.call("jacobian", 0.0, x, p, None, alone, None, library.work("JACOBIAN_WORK"))
    np.testing.assert_array_equal(alone, nonzeros)


def test_flow_of_the_chain_is_symplectic_and_that_of_the_physical_equations(library: Library) -> None:
    """Against Dormand and Prince in physical coordinates, with columns of its transition matrix by differences."""
    q = np.random.default_rng(2).normal(size=24) * 0.3
    S, duration, rho = 0.8, 1.7, SOFT.rho
    x, Phi = np.concatenate([q, np.zeros(24)]), np.zeros((48, 48))
    assert library.call("flow", 0.0, duration, 0, x, Phi, np.array([-S]), library.work("FLOW_WORK")) == 1
    assert library.call("flow", 0.0, duration, 120, x, Phi, np.array([-S]), library.work("FLOW_WORK")) == 0
    Phi = Phi.T  # by columns

    def end(positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
        start = np.concatenate([np.sqrt(S) * rho * positions, np.sqrt(S) * rho * velocities])
        field = lambda _, s: physical_field(s[:24], s[24:], SOFT)  # noqa: E731
        return solve_ivp(field, (0, duration), start, "DOP853", rtol=1e-12, atol=1e-15).y[:, -1]

    scale = np.sqrt(S) * np.tile(rho, 2)
    np.testing.assert_allclose(scale * x, end(q, np.zeros(24)), atol=1e-10)
    h, unit = 1e-5, np.eye(24)[20]
    column = (end(q + h * unit, np.zeros(24)) - end(q - h * unit, np.zeros(24))) / (2 * h) / scale
    np.testing.assert_allclose(Phi[20:, 20][:28], column[20:], atol=1e-6)
    J = np.block([[np.zeros((24, 24)), np.eye(24)], [-np.eye(24), np.zeros((24, 24))]])
    np.testing.assert_allclose(Phi.T @ J @ Phi, J, atol=1e-12)


def test_multipliers_against_lapack(library: Library) -> None:
    """Of random matrices: B^T C has real and complex eigenvalues, and lambda follows from the quadratic equation."""
    for seed in range(5):
        Phi = np.random.default_rng(seed).normal(size=(48, 48))
        real, imaginary, largest, trivial = np.zeros(24), np.zeros(24), np.zeros(1), np.zeros(1)
        work = library.work("MULTIPLIERS_WORK")
        assert library.call("multipliers", Phi, 1e-10, real, imaginary, largest, trivial, work) == 0
        matrix = Phi.T
        mu = np.linalg.eigvals(matrix[:24, 24:].T @ matrix[24:, :24])
        found = real + 1j * imaginary
        assert np.abs(found[:, None] - mu).min(axis=0).max() < 1e-11 * np.abs(mu).max()
        assert np.abs(found[:, None] - mu).min(axis=1).max() < 1e-11 * np.abs(mu).max()
        rest = np.delete(mu, np.argmin(np.abs(mu + 1)))
        lambdas = np.abs(np.concatenate([np.roots([1, -2 - 4 * m, 1]) for m in rest])) ** 2
        np.testing.assert_allclose(largest[0], lambdas.max(), rtol=1e-10)
        np.testing.assert_allclose(trivial[0], np.abs(mu + 1).min(), rtol=1e-9)


def test_general_models_of_first_order(tmp_path: Path) -> None:
    model = forced_oscillator()
    assert printed(compiled(export_c(model, tmp_path / "c")))
    c = Library(tmp_path / "c", next((tmp_path / "c").glob("*while_1_duffing.h")).stem)
    p, x, y = np.array([0.2, 0.5]), np.array([0.3, -0.1]), np.zeros(2)
    c.call("outputs", 2.0, x, p, y, c.work("OUTPUTS_WORK"))
    np.testing.assert_allclose(y, [0.005, 0.15 + 2.0], rtol=1e-15)

    def field(t: float, z: np.ndarray) -> np.ndarray:
        J = np.array([[0.0, 1.0], [-1 - 3 * z[0] ** 2, -0.2]])
        f = [z[1], -0.2 * z[1] - z[0] - z[0] ** 3 + 0.5 * np.cos(1.3 * t)]
        return np.concatenate([f, (J @ z[2:].reshape(2, 2)).ravel()])

    end = solve_ivp(field, (0.4, 3.4), [*x, 1, 0, 0, 1], "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    Phi = np.zeros((2, 2))
    c.call("flow", 0.4, 3.0, 60, x, Phi, p, c.work("FLOW_WORK"))
    np.testing.assert_allclose(np.concatenate([x, Phi.T.ravel()]), end, rtol=0, atol=2e-11)
    errors = []
    for steps in (5, 10):
        moved = np.array([0.3, -0.1])
        c.call("flow", 0.4, 3.0, steps, moved, None, p, c.work("FLOW_WORK"))
        errors.append(np.abs(moved - end[:2]).max())
    assert 7 < np.log2(errors[0] / errors[1]) < 10  # order 8


def test_models_of_second_order_and_in_mx(tmp_path: Path) -> None:
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    forced = OdeModel("parametric", q, -(1 + ca.cos(t) / 5) * q, order=2, velocity=v, time=t, forcing_period=2 * np.pi)
    export_c(forced, tmp_path / "second")
    c, x, Phi = Library(tmp_path / "second", "parametric"), np.array([1.0, 0.0]), np.zeros((2, 2))
    c.call("flow", 0.3, 2.0, 40, x, Phi, np.zeros(1), c.work("FLOW_WORK"))
    mathieu = lambda s, z: [z[1], -(1 + np.cos(s) / 5) * z[0]]  # noqa: E731
    end = solve_ivp(mathieu, (0.3, 2.3), [1, 0], "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    np.testing.assert_allclose(x, end, atol=1e-11)
    np.testing.assert_allclose(Phi[0], x, atol=1e-14)
    assert abs(np.linalg.det(Phi) - 1) < 1e-13
    z, p = ca.MX.sym("z", 3), ca.MX.sym("p", 2)
    matrix = ca.DM([[0, 1, 0], [-1, 0, 2], [0, 0, -3]])
    field = matrix @ z + ca.vertcat(p[0], 0, p[1] * z[0] * z[1])
    linear = OdeModel("linear", z, field, p, state_labels=("a", "b", "c"))
    export_c(linear, tmp_path / "mx")
    assert printed(compiled(tmp_path / "mx", "gcc", *SANITIZED)).keys() == {
        "a",
        "b",
        "c",
        "trace",
        "rhs_0",
        "rhs_1",
        "rhs_2",
    }
    c, f = Library(tmp_path / "mx", "linear"), np.zeros(3)
    c.call("rhs", 0.0, np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.25]), f, c.work("RHS_WORK"))
    np.testing.assert_allclose(f, [2.5, 5.0, -8.5])


# Orbits --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_program_prints_the_numbers_of_python(exported: Path, orbit: Orbit, tmp_path: Path) -> None:
    shutil.copytree(exported, tmp_path, dirs_exist_ok=True)
    found = printed(compiled(tmp_path, "gcc", "-O2"))
    reference = 2 * np.pi / 1.018532435491958  # independent codes
    assert abs(found["period"] / reference - 1) < 1e-14
    assert abs(found["period"] / orbit.period - 1) < 1e-12
    assert found["iterations"] <= 5
    assert abs(found["largest_multiplier"] - orbit.floquet().max_abs_multiplier) < 1e-12
    assert abs(found["largest_multiplier"] - 1.171275734790) < 1e-12  # independent codes
    assert found["trivial_deviation"] < 1e-12
    assert abs(found["orbit_S"] - 1) < 1e-14


def test_the_orbit_as_data(library: Library, orbit: Orbit) -> None:
    y, v = np.zeros(24), np.zeros(24)
    for t in (0.0, 1.234, -7.0, 0.25 * orbit.period, 1e3):
        library.call("orbit", t, y, v)
        np.testing.assert_allclose(y, orbit.evaluate(t), rtol=0, atol=5e-13)
        before, after = orbit.evaluate([t - 1e-5, t + 1e-5])
        np.testing.assert_allclose(v, (after - before) / 2e-5, rtol=0, atol=1e-8)
    multipliers = library.doubles("orbit_multipliers_real") + 1j * library.doubles("orbit_multipliers_imaginary")
    np.testing.assert_array_equal(multipliers, orbit.floquet().multipliers)


def test_an_orbit_without_multipliers(orbit: Orbit, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of chains that are too long for them: the rest is written all the same."""
    too_long = ValueError("sites: given 6000; accepted: up to 5000")
    monkeypatch.setattr(Orbit, "floquet", Mock(side_effect=too_long))
    directory = export_c(orbit, tmp_path / "c")
    assert "multipliers are not here: sites: given 6000; accepted: up to 5000" in (directory / "chain.h").read_text()
    assert "largest_multiplier 1" not in (directory / "README.md").read_text()


def test_residual_and_newton(library: Library, orbit: Orbit) -> None:
    problem, z = orbit.point.problem, orbit.point.z * 1.01
    R, nonzeros = np.zeros(library["EQUATIONS"]), np.zeros(library["RESIDUAL_NONZEROS"])
    library.call("residual", z, R, nonzeros, library.work("RESIDUAL_WORK"))
    for mine, python in zip((R, nonzeros), problem.evaluate(z), strict=True):
        np.testing.assert_allclose(mine, python, rtol=0, atol=1e-13)
    guess, report = orbit.point.z * 1.01, ctypes.create_string_buffer(64)
    options = library["OMEGA"], float(orbit.Omega), 1e-13, 20, ctypes.byref(report), library.work("NEWTON_WORK")
    assert library.call("newton", guess, *options) == 0
    np.testing.assert_allclose(guess, orbit.point.z, rtol=0, atol=1e-11)


def test_newton_tells_what_is_wrong_and_keeps_the_guess(library: Library, orbit: Orbit) -> None:
    report, work = ctypes.create_string_buffer(64), library.work("NEWTON_WORK")
    kappa = library["PARAMETER"]
    rest = np.zeros(library["UNKNOWNS"])
    rest[library["OMEGA"]] = 1.0
    cases = [
        (1, orbit.point.z * 1.01, 1), (4, -orbit.point.z, 20), (3, orbit.point.z * 40.0, 20),
        (4, np.full(library["UNKNOWNS"], np.nan), 20), (2, rest, 20),
    ]  # fmt: skip
    for wanted, guess, most in cases:
        z = guess.copy()
        assert library.call("newton", z, kappa, -1.0, 1e-13, most, ctypes.byref(report), work) == wanted
        np.testing.assert_array_equal(z, guess)


def expected(directory: Path) -> dict[str, float]:
    """The numbers that the README.md of an export has from Python."""
    table = (directory / "README.md").read_text().partition("## Numbers to expect")[2].split("```")[1]
    return {line.split()[0]: float(line.split()[1]) for line in table.strip().splitlines()}


def test_programs_without_an_orbit_print_the_numbers_of_their_readme(tmp_path: Path) -> None:
    """Of a chain that has no orbit, whose mode does not oscillate: its right-hand side alone."""
    for name, model in {"forced": forced_oscillator(), "chain": Chain(9, -3.0, 0.25, -1.0)}.items():
        directory = export_c(model, tmp_path / name, ["rhs"], name=name)
        found = printed(compiled(directory))
        assert expected(directory) == pytest.approx(found, rel=1e-15)
        assert len(found) > 1
    wanted = {"rhs_0": 0.05, "rhs_1": -0.2 * 0.05 - 0.1 - 0.1**3 + 0.5}
    assert expected(tmp_path / "forced") == pytest.approx(wanted, rel=1e-14)
    still = export_c(Chain(9, -3.0, 0.25, -1.0), tmp_path / "still")
    assert set(expected(still)) == {"rhs_0", "rhs_4", "rhs_8", "rhs_12", "rhs_16"}


@pytest.mark.parametrize(
    ("sites", "gamma", "g", "flags"),
    [
        (4, 0.25, 1.0, ["-O0"]),
        slow(2, -0.5, -1.0, SANITIZED),
        slow(4, 0.25, 1.0, SANITIZED),
        slow(1, 0.0, 1.0, ["-O2"]),
        slow(24, 0.25, 1.0, ["-O2"]),
    ],
)
def test_chains_from_their_linear_modes(sites: int, gamma: float, g: float, flags: list[str], tmp_path: Path) -> None:
    """The program follows an edge mode to S = 0.2; the band of one and two sites is the whole matrix."""
    chain = Chain(sites, 1.0, gamma, g)
    export_c(chain, tmp_path / "c")
    found = printed(compiled(tmp_path / "c", "gcc", *flags))
    for name, value in expected(tmp_path / "c").items():
        assert found[name] == pytest.approx(value, rel=1e-13, abs=1e-15), name
    mode = sites if g > 0 else 1
    orbit = follow_family(chain, mode=mode, amplitude_max=0.2, at=(0.2,), tolerance=1e-12).at(S=0.2)
    assert abs(found["period"] / orbit.period - 1) < 1e-13
    assert abs(found["largest_multiplier"] - orbit.floquet().max_abs_multiplier) < 1e-11


@pytest.mark.parametrize(
    ("transcription", "flags"), [("gauss", ["-O0"]), slow("gauss", SANITIZED), slow("shooting", SANITIZED)]
)
def test_orbits_of_other_transcriptions_have_their_flow_but_no_equations(
    transcription: str, flags: list[str], tmp_path: Path
) -> None:
    chain = Chain(5, 1.0, 0.25, -1.0)
    orbit = follow_family(chain, 1, 0.6, at=(0.6,), tolerance=1e-9, transcription=transcription).at(S=0.6)
    found = printed(compiled(export_c(orbit, tmp_path / "c"), "gcc", *flags))
    assert abs(found["orbit_period"] / orbit.period - 1) < 1e-14
    assert found["trivial_deviation"] < 1e-7
    assert abs(found["largest_multiplier"] - orbit.floquet().max_abs_multiplier) < 1e-7
    with pytest.raises(ValueError, match="are not in odd cosines; with transcription trigonometric it can"):
        export_c(orbit, tmp_path / "n", ["newton"])


def test_an_orbit_whose_tail_was_eliminated(tmp_path: Path) -> None:
    chain = Chain(150, 1.0, 0.25, 1.0)
    orbit = follow_family(chain, "last", 1.0, at=(1.0,), tolerance=1e-9, tail="eliminated").at(S=1.0)
    with pytest.raises(ValueError, match='the linear tail of its chain was eliminated; with tail="full"'):
        export_c(orbit, tmp_path / "n", ["newton"])
    c, y = Library(export_c(orbit, tmp_path / "c", ["orbit"]), "chain"), np.zeros(150)
    c.call("orbit", 0.4, y, None)
    np.testing.assert_allclose(y, orbit.evaluate(0.4), atol=1e-13)


def agree(directory: Path, orbit: Orbit, name: str, *flags: str) -> Library:
    """The exported orbit, after its program and its series are compared with Python."""
    found = printed(compiled(directory, "gcc", *flags))
    assert found["orbit_period"] == pytest.approx(orbit.period, rel=1e-14)
    assert found["return_error"] < 1e-8
    assert found["trace"] == pytest.approx(orbit.floquet().multipliers.sum().real, abs=1e-6)
    c, n = Library(directory, name), np.ravel(orbit.evaluate(0.0)).size
    for t in (0.0, 0.7, -7.0):
        y, v = np.zeros(n), np.zeros(n)
        c.call("orbit", t, y, v)
        np.testing.assert_allclose(y, orbit.evaluate(t), atol=1e-9)
        before, after = orbit.evaluate([t - 1e-5, t + 1e-5])
        np.testing.assert_allclose(v, (after - before) / 2e-5, atol=1e-7)
    return c


@pytest.mark.slow
def test_an_orbit_of_any_model(tmp_path: Path) -> None:
    """Van der Pol's cycle as a Fourier series, and its return and the trace of its monodromy matrix in C."""
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    model = OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu, nominal=(0.1,))
    cycle = find_orbit(model, lambda t: [2 * np.cos(t), -2 * np.sin(t)], 6.6, parameters={"mu": 1.0}, tolerance=1e-10)
    directory = export_c(cycle, tmp_path / "c")
    assert "orbit_period 6.66328685" in (directory / "README.md").read_text()
    assert cycle.period == pytest.approx(6.663286859323, abs=1e-9)
    c = agree(directory, cycle, "van_der_pol", *SANITIZED)
    assert c.doubles("nominal") == [1.0]  # the orbit's, not the model's
    np.testing.assert_array_equal(c.doubles("orbit_multipliers_real"), cycle.floquet().multipliers.real)
    with pytest.raises(ValueError, match="are written for chains and their orbits; accepted: rhs"):
        export_c(cycle, tmp_path / "n", ["newton"])


def test_an_orbit_of_a_family_of_any_model(tmp_path: Path) -> None:
    """Positions alone are the orbit's data; the program takes the velocities from their series."""
    q, v, k = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("k")
    force = ca.vertcat(-(1 + k) * q[0] + k * q[1] - q[0] ** 3, -(1 + k) * q[1] + k * q[0])
    signs: dict[str, Any] = {"reversal": (1, 1, -1, -1), "half_period": (-1,) * 4}
    model = OdeModel("pair", q, force, k, order=2, velocity=v, nominal=(0.3,), **signs)
    orbit = follow_family(model, 1, 0.5, at=(0.5,), tolerance=1e-10).at(S=0.5)
    agree(export_c(orbit, tmp_path / "c"), orbit, "pair", "-O0")


def test_an_orbit_of_a_forced_model(tmp_path: Path) -> None:
    orbit = find_orbit(forced_oscillator(), lambda t: [np.cos(1.3 * t), -np.sin(1.3 * t)], tolerance=1e-10)
    assert orbit.period == pytest.approx(2 * np.pi / 1.3, rel=1e-14)
    agree(export_c(orbit, tmp_path / "c", name="forced"), orbit, "forced", "-O0")


# Compilers -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS)
def test_no_compiler_warns_and_sanitizers_find_nothing(compiler: str, exported: Path, tmp_path: Path) -> None:
    shutil.copytree(exported, tmp_path, dirs_exist_ok=True)
    found = printed(compiled(tmp_path, compiler, *sanitizers(compiler)))
    assert abs(found["largest_multiplier"] - 1.171275734790) < 1e-12


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not there")
def test_valgrind_finds_nothing(exported: Path, tmp_path: Path) -> None:
    shutil.copytree(exported, tmp_path, dirs_exist_ok=True)
    program = compiled(tmp_path, "gcc", "-O1", "-g")
    assert printed(program, "valgrind", "-q", "--error-exitcode=9", "--leak-check=full")["iterations"] <= 5


def test_arrays_of_a_call_do_not_overlap_and_headers_are_those_of_cplusplus_too(exported: Path) -> None:
    header = (exported / "chain.h").read_text()
    declared = " ".join(re.findall(r"^(?:int|void) [^;]+;", header, re.MULTILINE))
    assert declared.count("double *") == declared.count("double *CHAIN_RESTRICT ") > 30
    command = ["g++", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only", "-x", "c++", "chain.h"]
    subprocess.run(command, check=True, cwd=exported)


@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS)
def test_code_does_not_grow_and_a_thousand_sites_compile_in_seconds(compiler: str, tmp_path: Path) -> None:
    """Processor time, on any machine of these years; blocks that are not cut take minutes."""
    code = {}
    for sites in (100, 1000):
        export_c(Chain(sites, 1.0, 0.25, -1.0), tmp_path / str(sites), ["rhs", "jacobian"])
        source = tmp_path / str(sites) / "chain.c"
        code[sites] = source.read_text().partition("int chain_rhs(")[2].partition("const int ")[0]
    assert len(code[1000]) < 1.02 * len(code[100]) < 10_000  # but for the digits of the bounds
    before = os.times().children_user
    subprocess.run([compiler, "-std=c99", "-O2", "-c", str(source), "-o", str(tmp_path / "o.o")], check=True)
    assert os.times().children_user - before < 5


def test_long_blocks_in_parts_compute_the_same(tmp_path: Path) -> None:
    """A function with long blocks, called with null pointers for an argument and a result, and inside a map."""
    x, y = ca.SX.sym("x", 200), ca.SX.sym("y", 2)
    inner = ca.Function("inner", [x, y], [ca.sin(x) * y[0] + ca.cumsum(x), x**3 - y[1]])
    X = ca.MX.sym("x", 200)
    twice = inner.map(2)(ca.horzcat(X, 2 * X), ca.DM([[1, 0], [0, 1]]))
    outer = ca.Function("outer", [X], [inner(X, ca.DM(2, 1))[0], *twice])
    source = c_source("lengthy", [outer])
    assert "_part1(" in source
    (tmp_path / "lengthy.c").write_text(source)
    flags = [*STRICT, *SANITIZED[:2], "-shared", "-fPIC"]
    command = ["gcc", *flags, "-o", "lengthy.so", "lengthy.c", "-lm"]
    subprocess.run(command, check=True, cwd=tmp_path)
    compiled_function = ca.external("outer", str(tmp_path / "lengthy.so"))
    at = np.linspace(-1, 2, 200)
    for mine, casadi in zip(compiled_function(at), outer(at), strict=True):
        np.testing.assert_allclose(np.array(mine), np.array(casadi), rtol=1e-15, atol=1e-15)


# Refusals ------------------------------------------------------------------------------------------------------------


def test_names() -> None:
    wanted = {
        "Duffing": "duffing", "int": "m_int", "9 lives": "m_9_lives", "": "model", "Müller*/": "m_ufc_ller",
        "ω": "u3c9", "α": "u3b1", "a__b": "a_b", "Math": "m_math", "stddef": "m_stddef",
    }  # fmt: skip
    assert {words: c_name(words) for words in wanted} == wanted


def test_parts_have_the_same_names_in_scenes_and_in_python() -> None:
    assert set(C_PARTS) == set(EXPORTED_PARTS) - {"outputs"}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"what": ["rsh"]}, "what: given 'rsh'; did you mean rhs?"),
        ({"what": ["quux"]}, "what: given 'quux'; accepted: rhs, jacobian"),
        ({"what": []}, "what: given an empty list"),
        ({"what": ["orbit"]}, "cannot be exported: a chain alone is no orbit; of an orbit, such as branch.at.S=0.2"),
        ({"what": ["outputs"]}, "the model names no outputs"),
        ({"what": [3]}, "what: given 3"),
        ({"what": "rhs"}, "what: given 'rhs'; accepted: a list"),
        ({"source": 3}, "source: given 3; accepted: a Chain, an OdeModel or an orbit"),
        ({"source": Chain(np.inf, 1.0, 0.25, 1.0)}, "sites: given inf"),  # type: ignore[arg-type]
        ({"source": forced_oscillator(), "what": ["newton"]}, "collocation equations are written"),
        ({"source": Chain(4, 1.0, 1.0, 1.0), "what": ["flow"]}, "the gauge holds the edge site alone"),
        ({"name": "My Chain"}, "name: given 'My Chain'; accepted: .* my_chain"),
        ({"name": "a" * 61}, "name: given 'aaa.*; accepted: up to 60 lower-case letters"),
        ({"name": 5}, "name: given 5; accepted: a string"),
        ({"harmonics": 1}, "harmonics: given 1"),
        ({"path": ""}, "path: given ''; accepted: a path in one line"),
    ],
)
def test_arguments_that_are_refused(changes: dict[str, Any], told: str, tmp_path: Path) -> None:
    with pytest.raises((ValueError, TypeError), match=told) as refusal:
        export_c(**({"source": SOFT, "path": tmp_path / "c"} | changes))
    assert "\n" not in str(refusal.value)
    assert not list(tmp_path.iterdir())


def test_directories_that_are_refused(tmp_path: Path) -> None:
    (tmp_path / "held").mkdir()
    (tmp_path / "held" / "mine.txt").write_text("mine")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"held: holds mine.txt; accepted: an empty or new directory"):
        export_c(SOFT, tmp_path / "held")
    with pytest.raises(ValueError, match="is not a directory"):
        export_c(SOFT, tmp_path / "held" / "mine.txt")
    (tmp_path / "nowhere").symlink_to(tmp_path / "not there")
    with pytest.raises(ValueError, match="is not a directory"):
        export_c(SOFT, tmp_path / "nowhere")
    assert export_c(SOFT, tmp_path / "empty", ["rhs"]) == tmp_path / "empty"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "held", "nowhere"]


def test_an_empty_directory_is_filled_where_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The one in which the program runs, and one behind a link; an interruption leaves nothing in it."""
    for name in ("here", "behind"):
        (tmp_path / name).mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "behind")
    monkeypatch.chdir(tmp_path / "here")
    with monkeypatch.context() as patch:
        patch.setattr("pathlib.Path.write_text", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            export_c(SOFT, ".", ["rhs"])
    assert list(Path.cwd().iterdir()) == []
    export_c(SOFT, ".", ["rhs"])
    export_c(SOFT, tmp_path / "link", ["rhs"])
    names = {"CMakeLists.txt", "README.md", "chain.c", "chain.h", "license.txt", "main.c"}
    assert {path.name for path in Path.cwd().iterdir()} == names
    assert {path.name for path in (tmp_path / "behind").iterdir()} == names
    assert (tmp_path / "link").is_symlink()


def test_what_is_no_c_is_refused_by_name(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    x, X = ca.SX.sym("x"), ca.MX.sym("x")
    cvodes = ca.integrator("motion", "cvodes", {"x": x, "ode": -x}, 0.0, 1.0)
    inside = OdeModel("integrated", X, cvodes(x0=X)["xf"])
    with pytest.raises(CodegenError, match=r"its part motion \(CvodesInterface\) cannot be written as C"):
        export_c(inside, tmp_path / "c", ["rhs"])
    solved = ca.Function("solved", [X], [ca.solve(ca.blockcat([[X, 1], [2, X]]), ca.DM([1, 2]), "csparse")])
    with pytest.raises(CodegenError, match="solved: CasADi has no C for a part of it: CsparseInterface"):
        c_source("name", [solved])
    (tmp_path / "f.c").write_text(c_source("f", [ca.Function("twice", [x], [2 * x])]))
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", "f.so", "f.c"], check=True, cwd=tmp_path)
    external = ca.external("twice", str(tmp_path / "f.so"))
    with pytest.raises(CodegenError, match="calls twice of an external library"):
        export_c(OdeModel("outside", X, external(X)), tmp_path / "c")
    ipopt = ca.nlpsol("least", "ipopt", {"x": x, "f": (x - 1) ** 2})
    with pytest.raises(CodegenError, match=r"needs coin-or/IpStdCInterface.h"):
        c_source("name", [ipopt])
    with pytest.raises(CodegenError, match="name: given '9'"):
        c_source("9", [ca.Function("twice", [x], [2 * x])])
    assert not (tmp_path / "c").exists()
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_building_needs_a_compiler_and_an_export(tmp_path: Path) -> None:
    export_c(Chain(2, 1.0, 0.25, -1.0), tmp_path / "c")
    with pytest.raises(CompilerError, match="compiler: 'no-such-cc' not found; accepted: a C99 compiler"):
        build_c(tmp_path / "c", "no-such-cc")
    with pytest.raises(ValueError, match="accepted: one that export_c wrote"):
        build_c(tmp_path)
    assert printed(build_c(tmp_path / "c"))["largest_multiplier"] == pytest.approx(1.0, abs=1e-9)
    (tmp_path / "c" / "main.c").write_text("int main(void) { return nothing; }\n")
    with pytest.raises(CompilerError, match=r"compiler: .*cc failed: main.c:1:.*error.*nothing"):
        build_c(tmp_path / "c")


@pytest.mark.slow
def test_the_part_of_ipopt_compiles_with_its_headers(tmp_path: Path) -> None:
    """CasADi's wheels bring headers and library of Ipopt with them."""
    folder = Path(ca.__file__).parent
    library = next(iter(sorted(folder.glob("libipopt.so*"))), None)
    if not (folder / "include" / "coin-or" / "IpStdCInterface.h").exists() or library is None:
        pytest.skip("no headers or library of Ipopt")
    chain = Chain(3, 1.0, 0.25, -1.0)
    directory = export_c(chain, tmp_path / "c", ["newton", "ipopt"], harmonics=6)
    assert "-lipopt" in (directory / "README.md").read_text()
    sources = [path.name for path in directory.glob("*.c") if path.name != "main.c"]
    (directory / "main.c").write_text(IPOPT_MAIN)
    linked = [str(library), "-lm", f"-Wl,-rpath,{folder}", "-o", "program"]
    command = ["gcc", "-std=c99", "-O1", f"-I{folder / 'include'}", "main.c", *sources, *linked]
    subprocess.run(command, cwd=directory, check=True)
    found = printed(directory / "program")
    orbit = follow_family(chain, mode=1, amplitude_max=0.01, at=(0.01,), tolerance=1e-12).at(S=0.01)
    assert abs(found["Omega"] / orbit.Omega - 1) < 1e-11
    assert found["residual"] < 1e-11


IPOPT_MAIN = """#include <math.h>
#include <stdio.h>
#include "chain.h"
int main(void)
{
    static double guess[CHAIN_UNKNOWNS], z[CHAIN_UNKNOWNS], R[CHAIN_UNKNOWNS], work[CHAIN_IPOPT_WORK];
    double largest = 0.0;
    int i, failed = chain_linear_mode(1, guess) || chain_ipopt(guess, -0.01, z, R, work);
    for (i = 0; i < CHAIN_EQUATIONS; i++) largest = fmax(largest, fabs(R[i]));
    printf("Omega %.17g\\nresidual %.17g\\n", z[CHAIN_OMEGA], largest);
    return failed;
}
"""
