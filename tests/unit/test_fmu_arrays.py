"""FMUs with arrays and inputs as models; how often they are initialised; archives that name a file twice."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from foreign_fmus import state_space
from kernels import numpy_alone

from casadi_skin import import_fmu
from casadi_skin.fmu.description import FmuWarning
from casadi_skin.fmu.fmu_component import Component

STATE = np.array([0.3, -0.7])


@pytest.fixture(scope="module")
def arrays(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return state_space(tmp_path_factory.mktemp("arrays"))


def test_arrays_are_taken_number_by_number(arrays: Path) -> None:
    model = import_fmu(arrays, parameters=["A[2,1]", "B[1,2]"], inputs={"u[2]": 0.5}, states=["x[2]", "x[1]"])
    assert model.state_names == ("x[2]", "x[1]")
    assert (model.nominal, model.start_state) == ((-1.0, 0.0), (0.0, 1.0))
    A, B = np.array([[0.0, 1.0], [-2.0, 0.0]]), np.array([[1.0, 3.0], [0.0, 1.0]])
    derivatives = [ca.jacobian(model.rhs, symbol) for symbol in (model.state, model.parameters)]
    rates, by_states, by_parameters = model.function("f", model.rhs, *derivatives)(0.0, STATE[::-1], [-2.0, 3.0])
    np.testing.assert_allclose(np.array(rates).ravel(), (A @ STATE + B @ [0.0, 0.5])[::-1], atol=1e-15)
    np.testing.assert_allclose(by_states, A[::-1, ::-1], atol=1e-11)
    np.testing.assert_allclose(by_parameters, [[STATE[0], 0.0], [0.0, 0.5]], atol=1e-11)


@pytest.mark.parametrize("way", [nullcontext, numpy_alone])
def test_inputs_take_signals(arrays: Path, way: Callable[[], AbstractContextManager[None]]) -> None:
    with way():
        inputs_take_signals(arrays)


def inputs_take_signals(arrays: Path) -> None:
    model = import_fmu(arrays, inputs={"u[1]": lambda t: ca.cos(2.0 * t), "u[2]": -1.0}, forcing_period=np.pi)
    at = np.array(model.vector_field(0.4, STATE, [])).ravel()
    np.testing.assert_allclose(at, [STATE[1] + np.cos(0.8), -STATE[0] - 1.0], atol=1e-15)
    by_time = model.function("f", ca.jacobian(model.rhs, model.time))(0.4, STATE, [])
    np.testing.assert_allclose(np.array(by_time).ravel(), [-2.0 * np.sin(0.8), 0.0], atol=1e-10)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"inputs": {"u": 1.0}}, r"inputs: 'u' is an array; accepted: its entries, such as u\[1\]"),
        ({"inputs": {"v": 1.0}}, r"inputs: given 'v'; accepted: u\[1\], u\[2\]"),
        ({"inputs": {"u[1]": ca.cos}}, r"inputs, u\[1\]: given a function of time; accepted: with forcing_period="),
        (
            {"inputs": {"u[1]": ca.cos}, "forcing_period": 1.0},
            r"inputs, u\[1\]: given a signal that has not the period 1; accepted: one that has",
        ),
        (
            {"inputs": {"u[1]": 1.0}, "parameters": ["u[1]"]},
            r"inputs: given 'u\[1\]', which is among parameters; accepted: one of them",
        ),
    ],
)
def test_inputs_that_are_refused(arrays: Path, arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=f"^{words}$"):
        import_fmu(arrays, **arguments)


def test_an_instance_for_each_shifted_value(arrays: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A[2,1] is fixed: differences at many nodes initialise the FMU six times, not six times a node."""
    model, started, restart = import_fmu(arrays, parameters=["A[2,1]"]), [0], Component.restart

    def counted(component: Component, held: Any) -> None:
        started[0] += 1
        restart(component, held)

    monkeypatch.setattr(Component, "restart", counted)
    nodes, values = 40, ca.DM([[0.1 * k, 1.0] for k in range(40)]).T
    jacobian = model.function("J", ca.jacobian(model.rhs, model.parameters)).map(nodes)
    found = np.array(jacobian(0.0, values, -3.0))
    np.testing.assert_allclose(found[1], np.array(values)[0], atol=1e-11)
    assert started[0] == 7
    model.vector_field.map(nodes)(0.0, values, -3.0)
    assert started[0] == 7


@pytest.mark.slow
def test_files_named_twice_that_are_not_unpacked_are_accepted_with_a_word(arrays: Path, tmp_path: Path) -> None:
    path = shutil.copy(arrays, tmp_path / "twice.fmu")
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("documentation/index.html", "two")
    with pytest.warns(FmuWarning, match="in it more than once, and not unpacked: documentation/index.html"):
        assert import_fmu(path).state_names == ("x[1]", "x[2]")
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("modelDescription.xml", "<x/>")
    with pytest.raises(ValueError, match=r"'modelDescription.xml' is in it more than once; accepted: once"):
        import_fmu(path)
