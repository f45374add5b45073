"""FMUs with inputs: forces on sites and parameters that change at any time; sizes of states as the motion has them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from numpy.typing import NDArray
from outputs import load
from scipy.integrate import solve_ivp

from casadi_skin import Bond, Chain, Lattice, OdeModel, Site, export_fmu, import_fmu

Array = NDArray[np.float64]
CHAIN = Chain(sites=4, alpha=0.8, gamma=0.3, g=1.0)
INPUTS = ["f_1", "f_4", "gamma"]


@pytest.fixture(scope="module", params=["3.0", pytest.param("2.0", marks=pytest.mark.slow)])
def driven(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("driven") / "driven.fmu"
    return export_fmu(CHAIN, path, request.param, mode=2, S=0.5, inputs=INPUTS)


def forced(t: float, x: Array, forces: Array, gamma: float) -> Array:
    """x' of the chain with a force on each site, written out."""
    y = x[:4]
    below, above = np.append(0.0, y[:-1]), np.append(y[1:], 0.0)
    return np.concatenate([x[4:], (1 + gamma) * below + (1 - gamma) * above - 2.8 * y - y**3 + forces])


def test_forces_and_parameters_are_inputs_with_derivatives(driven: Path) -> None:
    assert validate_fmu(str(driven)) == []
    kinds = {v.name: (v.causality, v.variability) for v in fmpy.read_model_description(str(driven)).modelVariables}
    assert all(kinds[name] == ("input", "continuous") for name in INPUTS)
    assert all(kinds[f"{x}_{n}"] == ("output", "continuous") for x in "yv" for n in range(1, 5))
    assert kinds["alpha"] == ("parameter", "tunable")
    model = import_fmu(driven, parameters=["alpha", *INPUTS])
    assert (model.derivatives, model.parameter_derivatives) == ("directional", "directional")
    x, p = np.random.default_rng(0).normal(size=8), np.array([0.8, 0.5, -0.7, 0.2])
    known = forced(0.0, x, np.array([0.5, 0.0, 0.0, -0.7]), 0.2)
    rates, jacobian = model.function("f", model.rhs, ca.jacobian(model.rhs, model.parameters))(0.0, x, p)
    np.testing.assert_allclose(np.array(rates).ravel(), known, atol=1e-14)
    below, above = np.append(0.0, x[:3]), np.append(x[1:4], 0.0)
    by_gamma = np.append(np.zeros(4), below - above)
    np.testing.assert_allclose(jacobian, np.array([-np.append(np.zeros(4), x[:4]), *np.eye(8)[[4, 7]], by_gamma]).T)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
def test_inputs_change_while_it_runs(driven: Path, kind: str) -> None:
    """A force on the last site: a ramp in Co-Simulation, held in each step, so that it comes half a step late."""
    t = np.linspace(0.0, 3.0, 301)
    ramp, constant = (0.4, 0.0) if kind == "CoSimulation" else (0.0, 0.4)  # fmpy's CVODE steps beyond what it is told
    values = {"f_1": 0.0 * t, "f_4": ramp * t + constant, "gamma": 0.3 + 0.0 * t}
    signal = np.array(list(zip(t, *values.values(), strict=True)), dtype=[(n, float) for n in ("time", *values)])
    result = fmpy.simulate_fmu(str(driven), fmi_type=kind, stop_time=3.0, output_interval=0.01, input=signal,
                               relative_tolerance=1e-9)  # fmt: skip
    start = np.array([result[f"{x}_{n}"][0] for x in "yv" for n in range(1, 5)])

    def field(time: float, x: Array) -> Array:
        return forced(time, x, np.array([0.0, 0.0, 0.0, ramp * (time - 0.005) + constant]), 0.3)

    truth = solve_ivp(field, (0.0, 3.0), start, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    found = [result[f"{x}_{n}"][-1] for x in "yv" for n in range(1, 5)]
    np.testing.assert_allclose(found, truth, atol=1e-5)


@pytest.mark.slow
def test_a_force_on_a_heavy_site_of_a_lattice(tmp_path: Path) -> None:
    sites = [Site("a", onsite="k*y", mass="heavy", damping="0.1"), Site("b", onsite="y")]
    bonds = [Bond("a", "b", (0,)), Bond("b", "a", (1,))]
    lattice = Lattice(2, sites, bonds, parameters={"k": 1.0, "heavy": 2.0})
    model = import_fmu(export_fmu(lattice, tmp_path / "l.fmu", inputs=["f_a_2", "k"]), parameters=["f_a_2", "heavy"])
    place = model.state_names.index("v_a_2")
    rates = np.array(model.vector_field(0.0, np.zeros(8), [1.0, 4.0])).ravel()
    np.testing.assert_array_equal(rates, 0.25 * np.eye(8)[place])


def test_inputs_that_are_refused(tmp_path: Path) -> None:
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    first = OdeModel("first", x, -p * x, p, nominal=(1.0,))
    for what, inputs, words in (
        (CHAIN, ["f_5"], "inputs: given 'f_5'; accepted: f_4, alpha, gamma, g, f_1, f_2, f_3"),
        (CHAIN, ["f_1", "f_1"], "inputs: given 'f_1' twice; accepted: each name once"),
        (first, ["f_x"], "inputs: given 'f_x'; accepted: p"),
    ):
        with pytest.raises(ValueError, match=f"^{words}$"):
            export_fmu(what, tmp_path / "x.fmu", inputs=inputs)
    with pytest.raises(TypeError, match=r"^inputs: given 'f_1'; accepted: a list of names$"):
        export_fmu(CHAIN, tmp_path / "x.fmu", inputs="f_1")
    assert list(tmp_path.iterdir()) == []


def nominals(path: Path) -> dict[str, float]:
    return {v.name: float(v.nominal) for v in fmpy.read_model_description(str(path)).modelVariables if v.nominal}


def test_sizes_of_states_are_those_of_the_motion(tmp_path: Path) -> None:
    """A mode of 200 sites is of size 1e-23 at one end: an absolute size of one for all would leave it no digits."""
    chain = Chain(200, 1.0, 0.25, 1.0)
    found = nominals(export_fmu(chain, tmp_path / "long.fmu", mode=200, S=0.5, binary=False))
    shape = np.array([found[f"y_{n}"] for n in range(1, 201)])
    start = np.abs(chain.right_eigenvector(200))
    start *= np.sqrt(0.5) / np.linalg.norm(start)
    assert shape[0] < 1e-20
    assert np.all(shape >= start * (1 - 1e-12))
    assert np.all(shape <= 300 * start)  # a sine is below its envelope
    assert found["v_7"] == pytest.approx(chain.linear_frequency(200) * found["y_7"])
    assert set(nominals(export_fmu(chain, tmp_path / "rest.fmu", start=np.zeros(200), binary=False))) == set(found)


@pytest.mark.parametrize(
    ("jump", "words"),
    [
        (lambda x: ca.sign(x), r"der\(x_1\) has sign"),
        (lambda x: ca.if_else(x > 0, -x, -2 * x), r"der\(x_1\) has if_else"),
        (lambda x: ca.fmod(x, 1), r"der\(x_1\) has fmod"),
        (lambda x: -ca.floor(x), r"der\(x_1\) has floor"),
    ],
)
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_what_jumps_is_refused_by_name(kind: Any, jump: Any, words: str, tmp_path: Path) -> None:
    x, p = kind.sym("x", 2), kind.sym("p")
    model = OdeModel("jumps", x, ca.vertcat(x[1], jump(x[0])), p, nominal=(1.0,))
    with pytest.raises(
        ValueError, match=f"^jumps: {words} in it, where it jumps, and FMUs are exported without events"
    ):
        export_fmu(model, tmp_path / "jumps.fmu", binary=False)
    held = OdeModel("held", x, ca.vertcat(x[1], -jump(p) * x[0]), p, nominal=(1.0,))
    export_fmu(held, tmp_path / "held.fmu", binary=False)  # a parameter is the same between events
    with pytest.raises(ValueError, match="where it jumps"):
        export_fmu(held, tmp_path / "input.fmu", binary=False, inputs=["p"])


@pytest.mark.slow
def test_two_chains_joined_in_cosimulation(tmp_path: Path) -> None:
    errors = load("coupled_fmus").main(tmp_path / "picture.png", (300, 600))
    assert errors[300] / errors[600] == pytest.approx(4.0, rel=0.05)  # of the coupling's order
    assert errors[600] < 5e-5
