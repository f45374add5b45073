"""Functions that call an FMU at many places: the same numbers as place by place, in few calls of its binary."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from foreign_fmus import Change, casadi_van_der_pol, changed
from kernels import numpy_alone
from numpy.typing import NDArray

from casadi_skin import OdeModel, find_orbit, import_fmu
from casadi_skin.fmu.archive import export_fmu
from casadi_skin.fmu.fmu_component import Component
from casadi_skin.fmu.model import FmuModel
from casadi_skin.native.programs import CallingBuffers, Calls

Array = NDArray[np.float64]
PLACES = 300  # more than one call of the kernel takes


@pytest.fixture(scope="module")
def van_der_pol(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return casadi_van_der_pol(tmp_path_factory.mktemp("van_der_pol"))


@pytest.fixture(scope="module")
def forced(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Mathieu's equation with a force."""
    x, t, p = ca.SX.sym("x", 2), ca.SX.sym("t"), ca.SX.sym("p", 2)
    rhs = ca.vertcat(x[1], -(1.0 + p[0] * ca.cos(t)) * x[0] - 0.1 * x[1] + p[1])
    labels, nominal = ("a", "b"), (0.3, 0.1)
    model = OdeModel("forced", x, rhs, p, time=t, forcing_period=2.0 * np.pi, parameter_labels=labels, nominal=nominal)
    return export_fmu(model, tmp_path_factory.mktemp("forced") / "forced.fmu")


def without_derivatives(path: Path, target: Path) -> Path:
    def silent(text: bytes) -> bytes:
        for word in (b"Derivatives", b"Derivative"):
            text = text.replace(word + b'="true"', word + b'="false"')
        return text.replace(b'variability="tunable"', b'variability="fixed"')

    change: Change = silent
    return changed(path, target, {"modelDescription.xml": change})


def symbols(model: FmuModel) -> list[ca.MX]:
    return [ca.MX.sym("t"), ca.MX.sym("x", 2), ca.MX.sym("p", model.parameters.numel())]


def with_jacobians(model: FmuModel) -> ca.Function:
    """(t, x, p) -> something of the field with its Jacobians, as problems have it."""
    t, x, p = symbols(model)
    field = 2.0 * p[0] * model.field_at(t, x, p)
    return ca.Function("f", [t, x, p], [field, *(ca.jacobian(field, a) for a in (t, x, p))])


def places(model: FmuModel) -> tuple[Array, Array, Array]:
    generator = np.random.default_rng(0)
    return np.linspace(0.0, 6.0, PLACES)[:, None], generator.normal(size=(PLACES, 2)), np.array(model.nominal)


def one_by_one(function: ca.Function, t: Array, x: Array, p: Array) -> list[Array]:
    found = [[np.array(result.nonzeros()) for result in function(*at, p)] for at in zip(t, x, strict=True)]
    return [np.concatenate(each) for each in zip(*found, strict=True)]


@pytest.mark.parametrize("way", [nullcontext, numpy_alone])
@pytest.mark.parametrize("own", [True, False], ids=["directional", "differences"])
@pytest.mark.parametrize("kind", ["van_der_pol", "forced"])
def test_numbers_are_those_place_by_place(
    kind: str, own: bool, way: Any, request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("casadi_skin.fmu.function.MOST_NUMBERS", 1000)  # some places at once
    path: Path = request.getfixturevalue(kind)
    path = path if own else without_derivatives(path, tmp_path / "silent.fmu")
    options: dict[str, Any] = {"parameters": ["a", "b"], "forcing_period": 2.0 * np.pi} if kind == "forced" else {}
    with way():
        model = import_fmu(path, **({"parameters": ["mu"]} | options))
        assert (model.derivatives == "directional") == own
        function, at = with_jacobians(model), places(model)
        calls = Calls.of(function, model.programs)
        assert calls is not None
        found = CallingBuffers(calls, PLACES)(*at)
        exact = own and kind != "forced"
        for ours, theirs in zip(found, one_by_one(function, *at), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=0.0 if exact else 1e-10)
        assert model.noise < 1e-10


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[int, int]]]:
    """First and last points of all calls of the binary, while it is watched."""
    seen, compute = list[tuple[int, int]](), Component.compute

    def watched(component: Component, at: Any, first: int, last: int) -> None:
        seen.append((first, last))
        compute(component, at, first, last)

    monkeypatch.setattr(Component, "compute", watched)
    return seen


def test_all_places_are_in_few_calls(van_der_pol: Path, tmp_path: Path, computed: list[tuple[int, int]]) -> None:
    """256 points each: values and Jacobian at 300 places; or these, where they are moved 12 times, and 6 instances."""
    for path, most in ((van_der_pol, 2 + 2), (without_derivatives(van_der_pol, tmp_path / "silent.fmu"), 2 + 15 + 13)):
        model = import_fmu(path, parameters=["mu"])
        calls = Calls.of(with_jacobians(model), model.programs)
        assert calls is not None
        computed.clear()
        CallingBuffers(calls, PLACES)(*places(model))
        assert 0 < len(computed) <= most


def test_orbits_and_branches_take_their_meshes_in_few_calls(van_der_pol: Path, computed: list[tuple[int, int]]) -> None:
    model = import_fmu(van_der_pol, parameters=["mu"])
    computed.clear()
    orbit = find_orbit(model, lambda t: [2.0 * np.cos(t), -2.0 * np.sin(t)], 6.6, parameters={"mu": 1.0})
    assert orbit.follow("mu", 1.5).stable.all()
    sizes = np.array([last - first for first, last in computed])
    assert np.median(sizes) > 20


def test_derivatives_that_nobody_asks_for_are_not_computed(van_der_pol: Path, tmp_path: Path) -> None:
    """At a fixed parameter no instance of the FMU gets another one."""
    model = import_fmu(without_derivatives(van_der_pol, tmp_path / "silent.fmu"), parameters=["mu"])
    t, x, p = symbols(model)
    field = model.field_at(t, x, p)
    calls = Calls.of(ca.Function("f", [t, x, p], [field, ca.jacobian(field, x)]), model.programs)
    assert calls is not None
    assert [call.wanted for call in calls.calls] == [[True], [False, True, False]]
    CallingBuffers(calls, PLACES)(*places(model))
    assert len(model.instance._components) == 1


def test_a_call_of_what_another_call_gave(van_der_pol: Path) -> None:
    """Euler's method twice, and the same call in two results is one."""
    model = import_fmu(van_der_pol, parameters=["mu"])
    t, x, p = symbols(model)
    first = x + 0.1 * model.field_at(t, x, p)
    second = first + 0.1 * model.field_at(t, first, p)
    function, at = ca.Function("f", [t, x, p], [first, second]), places(model)
    calls = Calls.of(function, model.programs)
    assert calls is not None
    assert len(calls.calls) == 2
    for ours, theirs in zip(CallingBuffers(calls, PLACES)(*at), one_by_one(function, *at), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_other_functions_are_not_taken(van_der_pol: Path) -> None:
    """One in expressions, one that calls a program that is not among those, and one without scalar operations."""
    model = import_fmu(van_der_pol, parameters=["mu"])
    t, x, p = symbols(model)
    field = model.field_at(t, x, p)
    assert Calls.of(ca.Function("f", [x], [2.0 * x]), model.programs) is None
    assert Calls.of(ca.Function("f", [t, x, p], [field]), model.programs[1:]) is None
    table = ca.interpolant("table", "bspline", [[0.0, 0.5, 1.0, 1.5, 2.0]], [0.0, 1.0, 4.0, 9.0, 16.0])
    assert Calls.of(ca.Function("f", [t, x, p], [field * table(p)]), model.programs) is None
