"""Results of FMUs in files: read with the model of the same FMU, whose binary reading does not run by itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from foreign_fmus import casadi_van_der_pol, changed

from casadi_skin import (
    BoundaryValueProblem,
    OdeModel,
    export_fmu,
    find_equilibrium,
    find_orbit,
    import_fmu,
    read_result,
    simulate,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return casadi_van_der_pol(tmp_path_factory.mktemp("fmu"))


def opened(path: Path, **choices: Any) -> Any:
    return import_fmu(path, parameters=["mu"], **choices)


def same(one: Any, two: Any) -> None:
    """Whether two branches of more than one solution have the same bits."""
    assert one.reason == two.reason
    assert len(one) == len(two) > 1
    for a, b in zip(one.solutions, two.solutions, strict=True):
        assert a.point.z.tobytes() == b.point.z.tobytes()
        assert (a.point.error, a.parameters) == (b.point.error, b.parameters)


def without_derivatives(path: Path, target: Path) -> Path:
    def change(content: bytes) -> bytes:
        found = content.replace(b'providesDirectionalDerivatives="true"', b"")
        assert found != content
        return found

    return changed(path, target, {"modelDescription.xml": change})


@pytest.mark.parametrize("differences", [False, True])
def test_results_of_an_fmu_go_on_from_a_file(fmu: Path, differences: bool, tmp_path: Path) -> None:
    path = without_derivatives(fmu, tmp_path / "plain.fmu") if differences else fmu
    model = opened(path)
    assert model.derivatives == ("differences" if differences else "directional")
    t = np.linspace(0.0, 6.4, 40)
    cycle = (t, np.stack([2.0 * np.cos(t), -2.0 * np.sin(t)]))
    orbit = find_orbit(model, cycle, 6.4, parameters={"mu": 0.5}, tolerance=1e-5)
    problem = BoundaryValueProblem(
        model, [model.start(model.state[0]) - 1.0, model.end(model.state[0])], parameters={"mu": 0.1}
    )
    for result in (orbit, problem.solve([0.0, 0.0], tolerance=1e-5)):
        read = read_result(result.save(tmp_path / "one.skin"), model=opened(path))
        assert read.save(tmp_path / "two.skin").read_bytes() == (tmp_path / "one.skin").read_bytes()
        same(result.follow("mu", 0.8, max_points=4), read.follow("mu", 0.8, max_points=4))
    read = read_result(orbit.save(tmp_path / "one.skin"), model=opened(path))
    assert read.floquet().multipliers.tobytes() == orbit.floquet().multipliers.tobytes()


def test_a_branch_of_an_fmu_leads_on_from_a_file(fmu: Path, tmp_path: Path) -> None:
    branch = find_equilibrium(opened(fmu), [0.0, 0.0], parameters={"mu": -0.5}).follow("mu", 0.5)
    read = read_result(branch.save(tmp_path / "branch.skin"), model=opened(fmu))
    same(branch, read)
    (hopf,) = branch.special_points
    cycles = hopf.follow("mu", 0.1, max_points=4)
    same(cycles, read.special_points[0].follow("mu", 0.1, max_points=4))
    same(cycles, read_result(cycles.save(tmp_path / "cycles.skin"), model=opened(fmu)))
    evolution = simulate(opened(fmu), [1.0, 0.0], [0.0, 1.0], parameters={"mu": 0.5})
    again = read_result(evolution.save(tmp_path / "evolution.skin"), model=opened(fmu))
    assert again.states.tobytes() == evolution.states.tobytes()


def test_another_model_is_refused_in_a_line(fmu: Path, tmp_path: Path) -> None:
    rest = find_equilibrium(opened(fmu), [0.0, 0.0], parameters={"mu": -0.5})
    path = rest.save(tmp_path / "rest.skin")
    x, mu = ca.SX.sym("x", 2), ca.SX.sym("mu")
    plain = OdeModel("vdp", x, ca.vertcat(x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]), mu, nominal=(1.0,))
    other = export_fmu(plain, tmp_path / "other.fmu")
    packed = changed(fmu, tmp_path / "packed.fmu", {"modelDescription.xml": lambda content: content + b"\n"})
    token = "its model is the FMU 'vdp' with token '"
    for model, words in (
        (None, rf"{token}.*', and reading runs no binary; accepted: read_result\(path, model=import_fmu\(\.\.\.\)\)"),
        (plain, rf"model: given OdeModel.*; accepted: a model of import_fmu, as {token}"),
        (import_fmu(other), r"model: given one with (name|token) "),
        (opened(packed), r"model: given one with hash "),
        (opened(fmu, states=["v", "x"]), r"model: given one with states \['v', 'x'\]; accepted: states \['x', 'v'\]"),
        (import_fmu(fmu), r"model: given one with parameters \[\]; accepted: parameters \['mu'\]"),
    ):
        with pytest.raises(ValueError, match=rf"^{path}: {words}") as error:
            read_result(path, model=model)
        assert "\n" not in str(error.value)
        assert "not a result" not in str(error.value)
    own = find_equilibrium(plain, [0.0, 0.0], parameters={"mu": -0.5}).save(tmp_path / "own.skin")
    with pytest.raises(ValueError, match=r"model: given .*; accepted: none, the model is in the file"):
        read_result(own, model=opened(fmu))


def test_signals_of_inputs_are_part_of_the_model(tmp_path: Path) -> None:
    x, v, u = (ca.SX.sym(name) for name in ("x", "v", "u"))
    model = OdeModel("driven", ca.vertcat(x, v), ca.vertcat(v, -x - 0.2 * v + u), u, nominal=(0.0,))
    path = export_fmu(model, tmp_path / "driven.fmu", inputs=["u"])
    period = 4.0

    def forced(size: float) -> Any:
        return import_fmu(path, inputs={"u": lambda t: size * ca.cos(2 * ca.pi * t / period)}, forcing_period=period)

    orbit = find_orbit(forced(1.0), [0.0, 0.0], tolerance=1e-6)
    saved = orbit.save(tmp_path / "orbit.skin")
    assert read_result(saved, model=forced(1.0)).evaluate(0.3).tobytes() == orbit.evaluate(0.3).tobytes()
    with pytest.raises(ValueError, match="model: given one with signals "):
        read_result(saved, model=forced(0.5))
