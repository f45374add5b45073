"""FMUs of chains and models: valid, as accurate as their solvers, with exact derivatives, one beside another."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
import zipfile
from importlib import resources
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.model_description import read_build_description
from fmpy.validation import validate_fmu
from fmu_running import Array, Running, running
from lxml import etree
from scipy.integrate import solve_ivp

from casadi_skin import Chain, OdeModel, evolve, find_orbit, follow_family
from casadi_skin.export import codegen as compilers
from casadi_skin.fmu.archive import export_fmu
from casadi_skin.fmu.initial_value_problem import chain_with_outputs

CHAIN = Chain(sites=5, alpha=0.8, gamma=0.3, g=1.0)
START = (0.4, -0.2, 0.3, 0.1, 0.6)
KINDS = ("ModelExchange", "CoSimulation")
VERSIONS = ("3.0", "2.0")
KNOWNS = [*(f"{x}_{n}" for x in "yv" for n in range(1, 6)), "alpha", "gamma", "g"]
UNKNOWNS = [*(f"der({x}_{n})" for x in "yv" for n in range(1, 6)), "energy", "S"]


def forced_duffing() -> OdeModel:
    """x'' + d x' + x + x^3 = F cos(w t), of first order, in scalar expressions; with one output."""
    x, p, t = ca.SX.sym("x", 2), ca.vertcat(*map(ca.SX.sym, "dFw")), ca.SX.sym("t")
    d, F, w = ca.vertsplit(p)
    rhs = ca.vertcat(x[1], -d * x[1] - x[0] - x[0] ** 3 + F * ca.cos(w * t))
    power = {"power": F * ca.cos(w * t) * x[1]}
    return OdeModel(
        "forced Duffing", x, rhs, p, time=t, forcing_period=2 * ca.pi / w, outputs=power, nominal=(0.1, 0.3, 1.2),
        state_labels=("x", "x'"),
    )  # fmt: skip


@pytest.fixture(scope="module", params=VERSIONS)
def chain_fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp(f"fmi{request.param[0]}")
    return export_fmu(CHAIN, folder / "chain.fmu", request.param, start=START, stop_time=20.0)


@pytest.fixture
def folder(chain_fmu: Path) -> Path:
    return chain_fmu.parent / "unpacked"


# Files ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", VERSIONS)
def test_fmpy_finds_no_fault(fmi: str, tmp_path: Path) -> None:
    x = ca.MX.sym("x", 2)
    without_parameters = OdeModel("oscillator", x, ca.vertcat(x[1], -ca.sin(x[0])))
    for what in (Chain(1, 1.0, 0.0, 1.0), Chain(3, 1.0, -0.4, 0.0), forced_duffing(), without_parameters):
        path = export_fmu(what, tmp_path / "model.fmu", fmi, binary=False)
        assert validate_fmu(str(path)) == []


def test_fmpy_finds_no_fault_in_the_whole_chain_and_its_other_files(chain_fmu: Path) -> None:
    assert validate_fmu(str(chain_fmu)) == []
    with zipfile.ZipFile(chain_fmu) as archive:
        names = archive.namelist()
        icon = "model.png" if "model.png" in names else "terminalsAndIcons/icon.png"
        assert archive.read(icon).startswith(b"\x89PNG")
        assert b"arXiv:2512.17483" in archive.read("documentation/index.html")
        etree.fromstring(archive.read("documentation/index.html"), etree.HTMLParser())
        if "sources/buildDescription.xml" in names:
            assert read_build_description(str(chain_fmu), validate=True)[0].sourceFileSets[0].language == "C99"
            schema = Path(fmpy.__file__).parent / "schema/fmi3/fmi3TerminalsAndIcons.xsd"
            terminals = etree.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
            etree.XMLSchema(etree.parse(str(schema))).assertValid(terminals)


@pytest.mark.parametrize(
    "name",
    [
        "need",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("van der Pol (forced)", "Größe", "a__b", "int")),
        pytest.param("x" * 300, marks=pytest.mark.slow),
    ],
)
def test_any_name_gives_an_fmu(name: str, tmp_path: Path) -> None:
    """The interface has functions need_derivatives and need_outputs of its own; CasADi takes no two underscores."""
    x, k = ca.SX.sym("x", 2), ca.SX.sym("double")
    path = export_fmu(OdeModel(name, x, ca.vertcat(x[1], -k * x[0]), k, nominal=(1.0,)), tmp_path / "named.fmu")
    assert validate_fmu(str(path)) == []
    assert fmpy.read_model_description(str(path)).modelName == name


@pytest.mark.parametrize("gamma", [-1.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_chain_of_one_way_has_no_energy(gamma: float, tmp_path: Path) -> None:
    path = export_fmu(Chain(4, 1.0, gamma, 1.0), tmp_path / "chain.fmu", S=0.5)
    assert validate_fmu(str(path)) == []
    result = fmpy.simulate_fmu(str(path))
    assert result.dtype.names == ("time", *(f"{x}_{n}" for x in "yv" for n in range(1, 5)), "S")
    assert np.all(np.isfinite(result["S"]))
    with zipfile.ZipFile(path) as archive:
        assert b"energy" not in archive.read("documentation/index.html")


def test_license_inside_is_that_of_the_project() -> None:
    inside = resources.files("casadi_skin.fmu").joinpath("sources", "license.txt").read_text(encoding="utf-8")
    assert inside == (Path(__file__).parents[2] / "LICENSE").read_text(encoding="utf-8")


def test_the_same_model_gives_the_same_file(tmp_path: Path) -> None:
    one, two = (export_fmu(CHAIN, tmp_path / f"{name}.fmu", binary=False).read_bytes() for name in "ab")
    assert one == two
    other = export_fmu(CHAIN, tmp_path / "c.fmu", binary=False, S=0.02).read_bytes()
    assert other != one


def test_dependencies_are_those_of_the_equations(chain_fmu: Path) -> None:
    description = fmpy.read_model_description(str(chain_fmu))
    found = {u.variable.name: {v.name for v in u.dependencies} for u in description.derivatives + description.outputs}
    parameters = {"alpha", "gamma", "g"} if description.fmiVersion == "3.0" else set()
    assert found["der(y_2)"] == {"v_2"}
    assert found["der(v_1)"] == {"y_1", "y_2"} | parameters
    assert found["der(v_3)"] == {"y_2", "y_3", "y_4"} | parameters
    assert found["S"] == {f"y_{n}" for n in range(1, 6)}
    assert found["y_4"] == {"y_4"}
    initial = {u.variable.name: {v.name for v in u.dependencies} for u in description.initialUnknowns}
    assert initial["der(v_3)"] == {"y_2", "y_3", "y_4", "alpha", "gamma", "g"}


def test_chain_in_vectors_is_the_chain() -> None:
    generator = np.random.default_rng(0)
    for sites, gamma in ((1, 0.3), (2, -0.4), (6, 0.5), (6, -0.5), (6, 0.0)):
        chain = Chain(sites, 0.7, gamma, 1.3)
        model, expected, gauge = chain_with_outputs(chain), chain.tunable_model(), chain.gauge_model()
        x, p = generator.normal(size=2 * sites), np.array([0.7, gamma, 1.3])
        np.testing.assert_allclose(model.vector_field(0, x, p), expected.vector_field(0, x, p), atol=1e-14)
        hamiltonian = ca.Function("H", [gauge.state, gauge.velocity, gauge.parameters], [gauge.hamiltonian])
        energy = float(hamiltonian(x[:sites] / chain.rho, x[sites:] / chain.rho, 1.3))
        assert float(model.function("E", model.outputs["energy"])(0, x, p)) == pytest.approx(energy, rel=1e-13)


# Simulations ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_simulations_agree_with_our_own_evolution(chain_fmu: Path, kind: str) -> None:
    result = fmpy.simulate_fmu(str(chain_fmu), fmi_type=kind, output_interval=0.5, relative_tolerance=1e-9)
    truth = evolve(CHAIN, START, None, result["time"], method="dop853", tolerance=1e-13)
    found = np.array([result[f"y_{n}"] for n in range(1, 6)]).T
    tolerance = 2e-6 if kind == "ModelExchange" else 1e-8  # CVode in fmpy; ours, ten times what one step may do wrong
    assert len(result) == 41
    np.testing.assert_allclose(found, truth.displacements, rtol=0, atol=tolerance)
    np.testing.assert_allclose(result["energy"], truth.energy, rtol=20 * tolerance)
    np.testing.assert_allclose(result["S"], np.sum(found**2, axis=1), rtol=1e-13)


def test_tolerance_of_the_experiment_is_that_of_the_solver(chain_fmu: Path, folder: Path) -> None:
    truth = evolve(CHAIN, START, None, [20.0], method="dop853", tolerance=1e-13).displacements[-1]
    errors = []
    for tolerance in (1e-4, 1e-7, 1e-10):
        with running(chain_fmu, folder, "CoSimulation") as fmu:
            fmu.initialise(tolerance)
            fmu.step(0.0, 20.0)
            errors.append(np.abs(fmu.get(*(f"y_{n}" for n in range(1, 6))) - truth).max())
    assert errors[0] < 1e-2
    assert errors[1] < 1e-5
    assert errors[2] < 1e-8
    assert errors[0] > 100 * errors[1] > 1e4 * errors[2]


def test_forced_model_knows_its_time(tmp_path: Path) -> None:
    path = export_fmu(forced_duffing(), tmp_path / "duffing.fmu", start=(0.2, 0.0), tolerance=1e-11)
    description = fmpy.read_model_description(str(path))
    assert float(description.defaultExperiment.stopTime) == pytest.approx(10 * 2 * np.pi / 1.2)
    assert "time" in {v.name for v in description.derivatives[1].dependencies}

    def field(t: float, x: Array) -> list[float]:
        return [x[1], -0.1 * x[1] - x[0] - x[0] ** 3 + 0.3 * np.cos(1.2 * t)]

    truth = solve_ivp(field, (2.0, 9.0), [0.2, 0.0], method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    with running(path, tmp_path / "unpacked", "CoSimulation") as fmu:
        fmu.initialise(start_time=2.0)
        for k in range(7):
            fmu.step(2.0 + k, 1.0)
        np.testing.assert_allclose(fmu.get("x", "x'"), truth, atol=1e-9)
        assert fmu.get("time")[0] == 9.0
        assert fmu.get("power")[0] == pytest.approx(0.3 * np.cos(1.2 * 9.0) * truth[1], abs=1e-9)
        derivative = fmu.directional(["der(x')"], ["time"], np.ones(1))
        assert derivative[0] == pytest.approx(-1.2 * 0.3 * np.sin(1.2 * 9.0), rel=1e-13)


def test_orbit_closes_after_its_period(tmp_path: Path) -> None:
    orbit = follow_family(Chain(4, 1.0, 0.25, 1.0), mode=4, amplitude_max=0.5, at=[0.5], tolerance=1e-11).at(S=0.5)
    path = export_fmu(orbit, tmp_path / "orbit.fmu", tolerance=1e-12)
    assert float(fmpy.read_model_description(str(path)).defaultExperiment.stopTime) == 10 * orbit.period
    names = [f"y_{n}" for n in range(1, 5)]
    with running(path, tmp_path / "unpacked", "CoSimulation") as fmu:
        fmu.initialise()
        np.testing.assert_array_equal(fmu.get(*names), orbit.profile)
        assert fmu.get("S")[0] == pytest.approx(0.5, rel=1e-14)
        assert fmu.get("energy")[0] == pytest.approx(orbit.energy, rel=1e-9)
        fmu.step(0.0, orbit.period)
        np.testing.assert_allclose(fmu.get(*names), orbit.profile, atol=1e-9)


def test_orbit_of_any_model_closes_after_its_period(tmp_path: Path) -> None:
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    model = OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu)
    cycle = find_orbit(model, lambda t: [2 * np.cos(t), -2 * np.sin(t)], 6.6, parameters={"mu": 1.0}, tolerance=1e-10)
    path = export_fmu(cycle, tmp_path / "cycle.fmu", tolerance=1e-12)
    assert validate_fmu(str(path)) == []
    assert float(fmpy.read_model_description(str(path)).defaultExperiment.stopTime) == 10 * cycle.period
    with running(path, tmp_path / "unpacked", "CoSimulation") as fmu:
        fmu.initialise()
        np.testing.assert_array_equal(fmu.get("x", "y"), cycle.evaluate(0.0))
        assert fmu.get("mu")[0] == 1.0
        fmu.step(0.0, cycle.period)
        np.testing.assert_allclose(fmu.get("x", "y"), cycle.evaluate(0.0), atol=1e-8)


def test_linear_mode_is_the_start_of_a_chain(tmp_path: Path) -> None:
    path = export_fmu(CHAIN, tmp_path / "mode.fmu", mode="last", S=0.25, binary=False)
    starts = {v.name: v.start for v in fmpy.read_model_description(str(path)).modelVariables}
    y = np.array([float(starts[f"y_{n}"]) for n in range(1, 6)])
    expected = CHAIN.right_eigenvector(5)
    np.testing.assert_allclose(y / y[-1], expected / expected[-1], rtol=1e-13)
    assert np.sum(y**2) == pytest.approx(0.25, rel=1e-14)
    assert y[np.argmax(np.abs(y))] > 0
    assert all(float(starts[f"v_{n}"]) == 0.0 for n in range(1, 6))


# Derivatives ----------------------------------------------------------------------------------------------------------


def symbolic(x: Array, p: Array) -> Array:
    """Jacobian of derivatives and outputs by states and parameters, from the other writing of the chain."""
    model = CHAIN.tunable_model()
    outputs = chain_with_outputs(CHAIN)
    rhs = ca.Function("J", [model.full_state, model.parameters], [
        ca.jacobian(model.full_rhs, model.full_state), ca.jacobian(model.full_rhs, model.parameters)
    ])(x, p)  # fmt: skip
    expressions = ca.vertcat(*outputs.outputs.values())
    rest = ca.Function("J", [outputs.state, outputs.parameters], [
        ca.jacobian(expressions, outputs.state), ca.jacobian(expressions, outputs.parameters)
    ])(x, p)  # fmt: skip
    return np.array(ca.vertcat(ca.horzcat(*rhs), ca.horzcat(*rest)))


def test_directional_derivatives_are_exact_in_any_order_of_calls(chain_fmu: Path, folder: Path) -> None:
    generator = np.random.default_rng(3)
    with running(chain_fmu, folder) as fmu:
        fmu.initialise()
        for _ in range(30):
            x, p = generator.normal(size=10), np.array([0.9, generator.uniform(-0.5, 0.5), -1.1])
            fmu.set(alpha=p[0], gamma=p[1], g=p[2])
            fmu.place(x)
            jacobian = symbolic(x, p)
            for _ in range(3):  # some unknowns, some knowns, in some order: nothing of the call before is left
                rows = generator.permutation(len(UNKNOWNS))[: generator.integers(1, 12)]
                columns = generator.permutation(len(KNOWNS))[: generator.integers(1, 13)]
                seed = generator.normal(size=len(columns))
                found = fmu.directional([UNKNOWNS[i] for i in rows], [KNOWNS[j] for j in columns], seed)
                expected = jacobian[np.ix_(rows, columns)] @ seed
                np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(jacobian[rows]).max())


@pytest.mark.parametrize("chain_fmu", ["3.0"], indirect=True)
def test_adjoint_derivatives_are_the_transpose(chain_fmu: Path, tmp_path: Path) -> None:
    jacobian = symbolic(np.array([*START, 0, 0, 0, 0, 0]), np.array([0.8, 0.3, 1.0]))
    with running(chain_fmu, tmp_path / "unpacked") as fmu:
        fmu.initialise()
        references = [[fmu.reference[n] for n in names] for names in (UNKNOWNS, KNOWNS)]
        for row in range(len(UNKNOWNS)):
            found = fmu.fmu.getAdjointDerivative(*references, list(np.eye(len(UNKNOWNS))[row]), len(KNOWNS))
            np.testing.assert_allclose(found, jacobian[row], rtol=0, atol=1e-12)
        own = fmu.fmu.getAdjointDerivative(
            [fmu.reference["y_2"]], references[1], [2.0], len(KNOWNS)
        )  # an output that is a state
        np.testing.assert_array_equal(own, 2.0 * np.eye(len(KNOWNS))[1])


# Instances, states, modes ---------------------------------------------------------------------------------------------


def test_two_instances_do_not_disturb_each_other(chain_fmu: Path, folder: Path) -> None:
    def alone(g: float) -> Array:
        with running(chain_fmu, folder, "CoSimulation") as fmu:
            fmu.set(g=g)
            fmu.initialise()
            return np.array([advance(fmu, k) for k in range(6)])

    def advance(fmu: Running, k: int) -> Array:
        fmu.step(0.5 * k, 0.5)
        return fmu.get("y_1", "y_5", "energy")

    with running(chain_fmu, folder, "CoSimulation") as one, running(chain_fmu, folder, "CoSimulation") as two:
        one.set(g=0.5)
        two.set(g=-0.5)
        one.initialise()
        two.initialise()
        both = np.array([[advance(one, k), advance(two, k)] for k in range(6)])
    np.testing.assert_array_equal(both[:, 0], alone(0.5))
    np.testing.assert_array_equal(both[:, 1], alone(-0.5))
    assert not np.array_equal(both[:, 0], both[:, 1])


def test_state_is_saved_and_resumed_exactly(chain_fmu: Path, folder: Path) -> None:
    names = [f"{x}_{n}" for x in "yv" for n in range(1, 6)]
    with running(chain_fmu, folder, "CoSimulation") as fmu:
        fmu.initialise()
        fmu.step(0.0, 1.3)
        kept = fmu.state()
        data = fmu.serialised(kept)
        fmu.step(1.3, 2.0)
        expected = fmu.get(*names)
        fmu.restore(kept)
        fmu.step(1.3, 2.0)
        np.testing.assert_array_equal(fmu.get(*names), expected)
        fmu.free_state(kept)
        with running(chain_fmu, folder, "CoSimulation") as other:
            other.restore(other.deserialised(data))
            other.step(1.3, 2.0)
            np.testing.assert_array_equal(other.get(*names), expected)
        with pytest.raises(FMICallException):
            fmu.deserialised(b"\0" * len(data))
        assert "the bytes are no state of this model" in fmu.messages[-1]


def test_parameters_are_tuned_between_communication_steps(chain_fmu: Path, folder: Path) -> None:
    first = evolve(CHAIN, START, None, [3.0], method="dop853", tolerance=1e-13)
    softer = dataclasses.replace(CHAIN, g=-0.5, gamma=0.1)
    last = evolve(softer, first.displacements[0], first.velocities[0], [4.0], method="dop853", tolerance=1e-13)
    with running(chain_fmu, folder, "CoSimulation") as fmu:
        fmu.initialise(1e-11)
        fmu.step(0.0, 3.0)
        fmu.set(g=-0.5, gamma=0.1)
        fmu.step(3.0, 4.0)
        np.testing.assert_allclose(fmu.get(*(f"y_{n}" for n in range(1, 6))), last.displacements[0], atol=1e-9)
        assert fmu.get("energy")[0] == pytest.approx(last.energy[0], rel=1e-9)


def test_what_a_mode_forbids_is_an_error_that_reset_ends(chain_fmu: Path, folder: Path) -> None:
    with running(chain_fmu, folder) as fmu:
        with pytest.raises(FMICallException, match="error"):
            fmu.fmu.enterContinuousTimeMode()
        assert "not allowed in Instantiated" in fmu.messages[-1]
        with pytest.raises(FMICallException):
            fmu.initialise()
        fmu.fmu.reset()
        fmu.initialise()
        fmu.fmu.enterContinuousTimeMode()
        with pytest.raises(FMICallException):  # a tunable parameter changes at events only
            fmu.set(alpha=2.0)
        assert "cannot be set in Continuous-Time Mode" in fmu.messages[-1]
    with running(chain_fmu, folder, "CoSimulation") as fmu:
        fmu.initialise()
        with pytest.raises(FMICallException):
            fmu.step(1.0, 1.0)
        assert "from time 1, while the model is at 0" in fmu.messages[-1]
    with running(chain_fmu, folder, "CoSimulation") as fmu:
        fmu.initialise()
        with pytest.raises(FMICallException):
            fmu.set(y_1=0.0)
        assert "cannot be set in Step Mode" in fmu.messages[-1]


def test_values_out_of_range_are_discarded_and_nothing_is_set(chain_fmu: Path, folder: Path) -> None:
    with running(chain_fmu, folder, "CoSimulation") as fmu:
        fmu.initialise()
        for wrong in ({"alpha": 2.0, "gamma": 1.5}, {"g": float("nan")}):
            with pytest.raises(FMICallException, match="discard"):
                fmu.set(**wrong)
        np.testing.assert_array_equal(fmu.get("alpha", "gamma", "g"), [0.8, 0.3, 1.0])
        fmu.set(gamma=-1.0)
        with pytest.raises(FMICallException, match="discard"):  # the energy is infinite there
            fmu.get("energy")
        assert np.isfinite(fmu.get("S")[0])


def test_solution_that_runs_away_is_discarded_and_the_state_kept(chain_fmu: Path, folder: Path) -> None:
    with running(chain_fmu, folder, "CoSimulation") as fmu:
        fmu.set(g=-1.0, y_5=3.0)
        fmu.initialise()
        fmu.step(0.0, 0.1)
        before = fmu.get("time", "y_5", "v_5")
        with pytest.raises(FMICallException, match="discard"):
            fmu.step(0.1, 10.0)
        assert "cannot be followed beyond time 0." in fmu.messages[-1]
        np.testing.assert_array_equal(fmu.get("time", "y_5", "v_5"), before)
        fmu.step(0.1, 0.1)
        assert fmu.get("time")[0] == 0.2


def test_coefficients_of_the_solver_meet_the_conditions_of_order_eight() -> None:
    header = resources.files("casadi_skin.fmu").joinpath("sources", "dop853.h").read_text(encoding="utf-8")

    def table(name: str) -> Array:
        return np.array([float(word) for word in header.split(f" {name}[")[1].split("{")[1].split("}")[0].split(",")])

    c, b, rows = table("NODES"), table("WEIGHTS"), table("STAGE_WEIGHTS")
    A = np.zeros((12, 12))
    A[np.tril_indices(12, -1)] = rows
    np.testing.assert_allclose(A.sum(axis=1), c, atol=2e-15)
    for k in range(8):  # trees with one node above the root, and two of each order with another level
        assert b @ c**k == pytest.approx(1 / (k + 1), abs=2e-15)
    for k in range(1, 7):
        assert b @ A @ c**k == pytest.approx(1 / ((k + 1) * (k + 2)), abs=2e-14)
        assert (b * c ** (6 - k)) @ A @ c**k == pytest.approx(1 / ((k + 1) * 8), abs=2e-14)
    assert b @ A @ A @ c**5 == pytest.approx(1 / (6 * 7 * 8), abs=2e-14)
    for name in ("ERROR_5", "ERROR_3"):
        assert abs(table(name).sum()) < 2e-15


# The sources ----------------------------------------------------------------------------------------------------------

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("model", ["chain", "duffing"])
def test_sources_compile_without_a_warning(chain_fmu: Path, tmp_path: Path, compiler: str, model: str) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    path = chain_fmu
    if model == "duffing":
        two = "fmi2" in str(chain_fmu.parent)
        path = export_fmu(forced_duffing(), tmp_path / "duffing.fmu", "2.0" if two else "3.0", binary=False)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    for source in sorted((tmp_path / "sources").glob("*.c")):
        command = [compiler, *STRICT, "-c", f"-isystem{compilers.fmi_headers()}", str(source), "-o", "/dev/null"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def test_library_exports_the_interface_alone(chain_fmu: Path, folder: Path) -> None:
    fmpy.extract(str(chain_fmu), unzipdir=str(folder))
    library = next(folder.glob("binaries/*/chain.so"))
    listed = subprocess.run(["nm", "-D", "--defined-only", str(library)], capture_output=True, text=True, check=True)
    names = [line.split()[-1] for line in listed.stdout.splitlines()]
    assert len(names) > 40
    assert all(name.startswith("fmi") for name in names)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["chain", "duffing"])
def test_driver_in_c_runs_clean_under_sanitizers(tmp_path: Path, model: str) -> None:
    what = CHAIN if model == "chain" else forced_duffing()
    path = export_fmu(what, tmp_path / "model.fmu", start=START if model == "chain" else (0.3, 0.1), binary=False)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    sources = [str(s) for s in (tmp_path / "sources").glob("*.c")] + [str(Path(__file__).parent / "fmu_driver.c")]
    flags = ["-std=c99", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    program = tmp_path / "driver"
    includes = [f"-I{compilers.fmi_headers()}", f"-I{tmp_path / 'sources'}"]
    subprocess.run(["gcc", *flags, *includes, *sources, "-o", str(program), "-lm"], check=True)
    done = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "6 messages\n"


@pytest.mark.slow
def test_sources_alone_are_compiled_by_another_tool(tmp_path: Path) -> None:
    from fmpy.build import build_platform_binary

    path = export_fmu(CHAIN, tmp_path / "chain.fmu", start=START, binary=False, stop_time=5.0)
    assert fmpy.supported_platforms(str(path)) == ["c-code"]
    folder = tmp_path / "unpacked"
    fmpy.extract(str(path), unzipdir=str(folder))
    (tmp_path / "build").mkdir()
    build_platform_binary(folder, tmp_path / "build", generator="Unix Makefiles")
    result = fmpy.simulate_fmu(str(folder), fmi_type="CoSimulation", output_interval=1.0)
    truth = evolve(CHAIN, START, None, result["time"], method="dop853", tolerance=1e-13)
    np.testing.assert_allclose(result["y_3"], truth.displacements[:, 2], atol=1e-8)


@pytest.mark.slow
def test_two_hundred_sites_are_exported_in_seconds(tmp_path: Path) -> None:
    import time

    begun = time.perf_counter()
    path = export_fmu(Chain(200, 1.0, 0.25, 1.0), tmp_path / "chain.fmu", mode="last", S=1.0, tolerance=1e-10)
    assert time.perf_counter() - begun < 15.0
    assert path.stat().st_size < 300_000
    result = fmpy.simulate_fmu(str(path), fmi_type="CoSimulation", stop_time=5.0, output_interval=1.0)
    start = Chain(200, 1.0, 0.25, 1.0).right_eigenvector(200)
    start *= np.sign(start[np.argmax(np.abs(start))]) / np.linalg.norm(start)
    truth = evolve(Chain(200, 1.0, 0.25, 1.0), start, None, result["time"], tolerance=1e-12)
    np.testing.assert_allclose(result["y_200"], truth.displacements[:, -1], atol=1e-8)


# Refusals -------------------------------------------------------------------------------------------------------------


def test_what_cannot_be_exported_is_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "chain.fmu"
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    cases = [
        ((CHAIN, path, "1.0"), {}, "fmi: given '1.0'; .*accepted: 2.0, 3.0"),
        ((CHAIN, tmp_path / "chain.zip"), {}, "accepted: a name that ends in .fmu"),
        (
            (CHAIN, tmp_path / "none" / "chain.fmu"),
            {},
            "in no directory; accepted: a file in a directory that is there",
        ),
        ((Chain(float("inf"), 1.0, 0.2, 1.0), path), {}, "sites: given inf; accepted: a finite chain"),
        ((CHAIN, path), {"mode": 6}, "mode: given 6"),
        ((CHAIN, path), {"S": -1.0}, "S: given -1.0"),
        ((CHAIN, path), {"start": [1.0, 2.0]}, "start: given 2 values; accepted: 5 or 10"),
        ((CHAIN, path), {"stop_time": 0.0}, "stop_time: given 0.0"),
        ((CHAIN, path), {"tolerance": 1.0}, "tolerance: given 1.0"),
        ((OdeModel("line", x, p * x, p), path), {}, "line: no nominal values of p"),
        ((OdeModel("line", x, -x, outputs={"der(x)": x}), path), {}, r"line: several variables named der(x\)"),
    ]
    for arguments, keywords, words in cases:
        with pytest.raises(ValueError, match=words.replace("(", r"\(")) as refused:
            export_fmu(*arguments, **keywords)
        assert "\n" not in str(refused.value)
    with pytest.raises(TypeError, match="source: given 3; accepted: a Chain, an OdeModel or an orbit"):
        export_fmu(3, path)
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(ValueError, match=r"compiler: 'no-such-compiler' not found; accepted: .*CC=.* or binary=False"):
        export_fmu(CHAIN, path)
    monkeypatch.setitem(sys.modules, "fmpy", None)
    monkeypatch.delenv("CC")
    with pytest.raises(ValueError, match=r"fmpy is not installed; accepted: pip install 'casadi-skin\[fmu\]'"):
        export_fmu(CHAIN, path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("given", [{"mode": 1}, {"S": 1.0}])
def test_mode_and_S_are_of_chains(given: dict[str, float], tmp_path: Path) -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match=f"{next(iter(given))}: given .*; accepted: with a Chain"):
        export_fmu(OdeModel("decay", x, -x), tmp_path / "m.fmu", **given)
    assert not list(tmp_path.iterdir())
