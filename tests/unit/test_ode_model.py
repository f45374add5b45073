"""The general door to models: what it keeps, what it refuses, and which wrong declarations it finds."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from casadi_skin import OdeModel, read_model

Make = Callable[..., OdeModel]


def pendulums(**changes: Any) -> OdeModel:
    """Two coupled pendulums of second order: odd, reversible, conservative."""
    q, v, p = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p", 2)
    spring = p[1] * (q[0] - q[1])
    declared = {
        "name": "pendulums", "state": q, "rhs": -p[0] * ca.sin(q) - ca.vertcat(spring, -spring), "parameters": p,
        "order": 2, "velocity": v, "reversal": (1, 1, -1, -1), "half_period": (-1, -1, -1, -1),
        "normalisation": ca.dot(q, q) - 1,
        "hamiltonian": ca.dot(v, v) / 2 - p[0] * ca.sum1(ca.cos(q)) + p[1] * (q[0] - q[1]) ** 2 / 2,
    }  # fmt: skip
    return OdeModel(**(declared | changes))


def predator(**changes: Any) -> OdeModel:
    """Lotka and Volterra in logarithms, of first order: conservative, reversible by no choice of signs."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    rhs, energy = p * ca.vertcat(1 - ca.exp(x[1]), ca.exp(x[0]) - 1), ca.exp(x[0]) - x[0] + ca.exp(x[1]) - x[1]
    declared = {"name": "predator", "state": x, "rhs": rhs, "parameters": p, "hamiltonian": energy}
    return OdeModel(**(declared | changes))


def van_der_pol(**changes: Any) -> OdeModel:
    """Van der Pol of first order: odd, neither reversible nor conservative."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    rhs = ca.vertcat(x[1], p * (1 - x[0] ** 2) * x[1] - x[0])
    return OdeModel(
        **({"name": "van der Pol", "state": x, "rhs": rhs, "parameters": p, "half_period": (-1, -1)} | changes)
    )


def forced(**changes: Any) -> OdeModel:
    """A forced pendulum whose forcing's period is a parameter's."""
    q, v, w, a, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "a", "t"))
    declared = {
        "name": "forced", "state": ca.vertcat(q, v), "rhs": ca.vertcat(v, -ca.sin(q) - 0.1 * v + a * ca.cos(w * t)),
        "parameters": ca.vertcat(w, a), "time": t, "forcing_period": 2 * ca.pi / w, "nominal": (2.0, 0.1),
        "outputs": {"energy": v**2 / 2 - ca.cos(q), "power": a * v * ca.cos(w * t)},
    }  # fmt: skip
    return OdeModel(**(declared | changes))  # type: ignore[arg-type]


# What it keeps ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", [lambda model: model, OdeModel.first_order])
def test_either_form_has_the_same_flow_and_the_same_declarations(form: Callable[[OdeModel], OdeModel]) -> None:
    model = form(pendulums())
    assert (model.full_size, model.reversal, model.half_period) == (4, (1, 1, -1, -1), (-1, -1, -1, -1))
    assert (model.size, model.velocity is None) == ((2, False) if model.order == 2 else (4, True))
    x = [0.3, -1.1, 0.7, 0.9]
    found = model.function("f", model.full_state, model.full_rhs, model.normalisation, model.hamiltonian)
    state, rate, normalisation, energy = (np.array(value).ravel() for value in found(0.0, x, [2.0, 0.5]))
    assert state.tolist() == x
    np.testing.assert_allclose(rate, [0.7, 0.9, -2 * np.sin(0.3) - 0.7, 2 * np.sin(1.1) + 0.7], rtol=1e-15)
    assert normalisation[0] == pytest.approx(0.09 + 1.21 - 1)
    assert energy[0] == pytest.approx(0.65 - 2 * (np.cos(0.3) + np.cos(1.1)) + 0.25 * 1.4**2)
    model.check_symmetries()
    assert model.first_order().first_order().order == 1


def test_rhs_and_jacobian_agree_with_derivatives_taken_by_hand() -> None:
    function, q, p = pendulums().rhs_and_jacobian(), np.array([0.4, -0.9]), np.array([1.7, 0.6])
    value, by_state, by_parameter = (np.array(ca.DM(r)) for r in function(q, p))
    stretch, slopes = q[0] - q[1], -p[0] * np.cos(q) - p[1]
    np.testing.assert_allclose(value.ravel(), -p[0] * np.sin(q) - p[1] * stretch * np.array([1, -1]), rtol=1e-15)
    np.testing.assert_allclose(by_state, [[slopes[0], p[1]], [p[1], slopes[1]]], rtol=1e-15)
    np.testing.assert_allclose(by_parameter, [[-np.sin(q[0]), -stretch], [-np.sin(q[1]), stretch]], rtol=1e-15)
    x, p = ca.SX.sym("x", 5), ca.SX.sym("p", 2)
    function = OdeModel("decoupled", x, -(x**3) + ca.vertcat(p[0], 0, 0, 0, 0), p).rhs_and_jacobian()
    assert (function.nnz_out("df_dstate"), function.nnz_out("df_dp")) == (5, 10)  # sparse, dense


def test_components_are_called_as_their_symbols_or_labels() -> None:
    assert (forced().state_names, forced().parameter_names) == (("q", "v"), ("omega", "a"))
    assert pendulums().state_names == ("q_0", "q_1", "v_0", "v_1")
    assert forced(state_labels=("angle", "rate")).state_names == ("angle", "rate")
    assert forced(parameter_labels=("w", "force")).parameter_names == ("w", "force")
    x = ca.SX.sym("x")
    model = OdeModel("decay", x, -x)
    assert model.parameter_names == ()
    assert float(model.vector_field(0.0, 2.0, [])) == -2.0


def test_outputs_are_functions_of_time_state_and_parameters() -> None:
    model = forced()
    power = model.function("power", model.outputs["power"])
    assert float(power(0.5, [0.1, 3.0], [2.0, 0.7])) == pytest.approx(0.7 * 3.0 * np.cos(1.0))
    assert (model.forced, pendulums().forced) == (True, False)


def test_the_first_order_form_keeps_names_forcing_outputs_and_nominal_values() -> None:
    q, v, k, t = (ca.SX.sym(name) for name in "qvkt")
    model = OdeModel(
        "driven", q, -k * q + ca.sin(t), k, 2, v, time=t, forcing_period=2 * np.pi, outputs={"work": q * ca.sin(t)},
        nominal=(4.0,), state_labels=("place", "speed"), parameter_labels=("stiffness",),
    )  # fmt: skip
    first = model.first_order()
    assert (first.state_names, first.parameter_names) == (("place", "speed"), ("stiffness",))
    assert (first.nominal, first.forcing_period, list(first.outputs)) == ((4.0,), 2 * np.pi, ["work"])
    np.testing.assert_array_equal(first.vector_field(1.0, [0.5, 0.2], 4.0), model.vector_field(1.0, [0.5, 0.2], 4.0))


def test_the_ends_of_an_interval_have_their_own_symbols() -> None:
    model = forced()
    q = model.state[0]
    assert (str(model.start(q)), str(model.end(2 * q))) == ("q(start)", "(2.*q(end))")
    assert not ca.depends_on(model.start(q), q)


def test_mx_models_number_their_components() -> None:
    x, p = ca.MX.sym("x", 3), ca.MX.sym("p", 2)
    model = OdeModel("matrix", x, ca.vertcat(x[1] * p[0], -ca.sin(x[0]), p[1] - x[2]), p)
    assert (model.state_names, model.parameter_names) == (("x_0", "x_1", "x_2"), ("p_0", "p_1"))
    np.testing.assert_allclose(np.array(model.vector_field(0.0, [0.0, 2.0, 3.0], [1.0, 2.0])).ravel(), [2.0, 0.0, -1.0])
    assert OdeModel("alone", ca.MX.sym("x"), ca.MX(1.0)).state_names == ("x",)


@dataclass(frozen=True, eq=False, kw_only=True)
class Labelled(OdeModel):
    """A model with more to say than other processes need."""

    label: str


def test_a_subclass_is_pickled_as_the_model_that_it_is() -> None:
    again = pickle.loads(pickle.dumps(Labelled(name="line", state=(x := ca.SX.sym("x")), rhs=-2 * x, label="no more")))
    assert type(again) is OdeModel
    assert float(again.vector_field(0.0, 3.0, [])) == -6.0


def test_a_model_is_pickled_where_nothing_else_was_imported() -> None:
    program = (
        "import pickle, casadi as ca; from casadi_skin import OdeModel; x = ca.SX.sym('x'); "
        "print(pickle.loads(pickle.dumps(OdeModel('line', x, -2 * x))).vector_field(0.0, 3.0, []))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["-6"]


# What it refuses --------------------------------------------------------------------------------------------

SIGNS = [(), (1, 1), (1, 1, -1), (1, 1, -1, -1, 1), (1, 1, -1, 0), (1, 1, -1, 2), (0.5,) * 4]
OF_SECOND_ORDER = "a velocity symbol belongs to a model of second order"
NOT_A_SYMMETRY = "the declared {} is not a symmetry"
STRANGER = ca.SX.sym("stranger")
X, V = ca.MX.sym("x", 2), ca.MX.sym("v", 2)
REFUSED: list[tuple[Make, dict[str, Any], str]] = [
    *((pendulums, {"order": order}, f"order: given {order}; accepted: 1 or 2") for order in (0, 3, -1)),
    *((predator, {"rhs": ca.SX.zeros(*shape)}, f"rhs: given shape {shape}; accepted: (2, 1)")
      for shape in ((1, 1), (3, 1), (1, 2))),
    (pendulums, {"velocity": None}, OF_SECOND_ORDER),
    (predator, {"velocity": ca.SX.sym("v", 2)}, OF_SECOND_ORDER),
    *((pendulums, {label: signs}, f"{label} needs 4 signs, each +1 or -1")
      for label in ("reversal", "half_period") for signs in SIGNS),
    *((pendulums, {"velocity": ca.SX.sym("v", *shape), "hamiltonian": None}, "velocity: given shape")
      for shape in ((1, 1), (3, 1), (1, 2))),
    *((predator, {field: STRANGER}, f"{field}: depends on stranger, not declared")
      for field in ("normalisation", "hamiltonian")),
    (predator, {"rhs": ca.vertcat(STRANGER, 0)}, "rhs: depends on stranger, not declared"),
    (forced, {"nominal": (1.0,)}, "nominal needs 2 values, given 1"),
    (forced, {"state_labels": ("a",)}, "state_labels needs 2 names, given 1"),
    (forced, {"parameter_labels": ("a", "b", "c")}, "parameter_labels needs 2 names, given 3"),
    (forced, {"output_scale": (1.0,)}, "output_scale needs 2 factors, given 1"),
    (forced, {"outputs": {"both": ca.SX.zeros(2)}}, "outputs with several components"),
    (forced, {"outputs": {"q": ca.SX(0)}}, "q named more than once among states, parameters and outputs"),
    (forced, {"outputs": {"strange": ca.SX.sym("w")}}, "output strange: depends on w, not declared; accepted: "),
    (forced, {"forcing_period": None}, "time without forcing_period; accepted: the forcing's period"),
    (forced, {"forcing_period": ca.SX.sym("T")}, "forcing_period depends on T; accepted: parameters"),
    (forced, {"time": None}, "not declared"),
    (forced, {"hamiltonian": ca.SX(1)}, "a hamiltonian in a model that is forced"),
    (pendulums, {"state": X, "rhs": -X, "velocity": V, "parameters": None, "normalisation": None, "hamiltonian": None},
     "of second order in MX; accepted: SX, or a model of first order"),
    (predator, {"state": ca.vertcat(X, V), "rhs": ca.vertcat(V, -X), "parameters": None, "hamiltonian": None},
     "with expressions among them; accepted: symbols"),
    (predator, {"state": STRANGER + 1, "rhs": -STRANGER, "hamiltonian": None}, "with expressions among them; accepted"),
    *((make, {"reversal": signs}, NOT_A_SYMMETRY.format("reversal"))
      for make, signs in ((pendulums, (1, 1, 1, 1)), (pendulums, (1, -1, -1, 1)), (van_der_pol, (1, -1)),
                          (predator, (1, -1)), (predator, (-1, 1)), (forced, (1, -1)))),
    *((make, {"half_period": signs}, NOT_A_SYMMETRY.format("half_period"))
      for make, signs in ((pendulums, (-1, 1, -1, 1)), (pendulums, (1, 1, -1, -1)), (van_der_pol, (1, -1)),
                          (predator, (-1, -1)), (forced, (1, -1)))),
]  # fmt: skip


@pytest.mark.parametrize(("make", "changes", "words"), REFUSED)
def test_declarations_that_do_not_fit_are_refused_in_one_line(make: Make, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=f"^{make().name}: ") as error:
        make(**changes)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_second_order_right_hand_side_that_depends_on_velocity_is_refused() -> None:
    q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p")
    with pytest.raises(ValueError, match="depends on velocity; write first order"):
        OdeModel("damped", q, -q - p * v, p, 2, v)
    OdeModel("undamped", q, -q - p * q, p, 2, v)


@pytest.mark.parametrize("second", ["x", "p"])
def test_two_names_of_one_model_are_different(second: str) -> None:
    """Two states, two parameters, or a state and a parameter of one name: results by name would show one of them."""
    x, y, p, q = (ca.SX.sym(name) for name in ("x", second, "p", "x" if second == "p" else "p"))
    with pytest.raises(ValueError, match=r"^twins: p, x named more than once among states, parameters and outputs; "):
        OdeModel("twins", ca.vertcat(x, y), ca.vertcat(-p * x, -q * y), ca.vertcat(p, q))


# Which wrong declarations it finds --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "changes"),
    [
        *((make, {}) for make in (pendulums, predator, van_der_pol, forced)),
        (pendulums, {"reversal": (-1, -1, 1, 1)}),  # composed with the odd symmetry a reversal is one too
        *((van_der_pol, {"half_period": signs}) for signs in (None, (1, 1))),
        (forced, {"half_period": (-1, -1)}),  # half a period later the forcing has the other sign
    ],
)
def test_declarations_that_hold_pass(make: Make, changes: dict[str, Any]) -> None:
    make(**changes).check_symmetries(trials=9)


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0])
def test_a_small_term_that_breaks_a_declaration_is_found(size: float) -> None:
    model = pendulums(hamiltonian=None)
    first = model.first_order()
    even, damped = model.rhs + size * model.state**2, first.rhs - size * ca.vertcat(0, 0, first.state[2:])
    for broken, label in (
        (replace(model, rhs=even, checked=False), "half_period"),
        (replace(first, rhs=damped, checked=False), "reversal"),
    ):
        with pytest.raises(ValueError, match=label):
            broken.check_symmetries()
        replace(broken, **{label: None}).check_symmetries()
    model = pendulums()
    with pytest.raises(ValueError, match="declared hamiltonian is not conserved"):
        replace(model, hamiltonian=model.hamiltonian + size * model.state[0] * model.state[1])


def test_an_energy_that_only_ever_falls_or_has_the_wrong_sign_is_found() -> None:
    x, model = ca.SX.sym("x", 2), predator()
    with pytest.raises(ValueError, match="hamiltonian is not conserved"):
        OdeModel("damped", x, ca.vertcat(x[1], -x[0] - 1e-3 * x[1]), hamiltonian=ca.dot(x, x) / 2)
    wrong = ca.exp(model.state[0]) - model.state[0] - ca.exp(model.state[1]) + model.state[1]
    with pytest.raises(ValueError, match="predator: the declared hamiltonian is not conserved"):
        replace(model, hamiltonian=wrong)


def test_a_wrong_declaration_is_found_where_parameters_must_be_positive() -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 3)
    rhs = ca.vertcat(x[1], -ca.sum1(ca.sqrt(p)) * x[0] + x[0] ** 2)  # even: no half-period symmetry
    with pytest.raises(ValueError, match="half_period"):
        OdeModel("square roots", x, rhs, p, half_period=(-1, -1))
    with pytest.raises(ValueError, match="not finite at a random point"):
        OdeModel("nowhere", x[0], ca.log(-(x[0] ** 2)), half_period=(-1,))


def test_the_half_period_symmetry_of_a_forced_model_shifts_the_forcing() -> None:
    """With cos^2 in place of cos the forcing has the same sign half a period later."""
    model = forced()
    even = model.rhs + ca.vertcat(0, ca.cos(model.parameters[0] * model.time) ** 2)
    with pytest.raises(ValueError, match="declared half_period is not a symmetry"):
        replace(model, rhs=even, half_period=(-1, -1))


def test_symmetries_are_checked_when_declared_unless_told_otherwise() -> None:
    with pytest.raises(ValueError, match="the declared half_period is not a symmetry"):
        predator(half_period=(-1, -1), checked=False).check_symmetries()


# Files ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "Input data was truncated"),
        ("{", "Input data was truncated"),
        ("[]", "Expected `object`, got `array`; accepted: a file of format"),
        ('{"format": "casadi_skin model 0"}', "format 'casadi_skin model 0'; accepted: a file of format"),
        ('{"format": "casadi_skin model 2"}', "Object missing required field `sha256`"),
        ("[" * 100_000, ""),
    ],
)
def test_other_files_are_refused_in_one_line(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=f"not a model saved by casadi_skin: .*{words}") as error:
        read_model(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_what_is_no_file_of_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "picture.png").write_bytes(bytes(range(256)))
    os.mkfifo(tmp_path / "pipe.json")  # it would never end
    (tmp_path / "long.json").touch()
    os.truncate(tmp_path / "long.json", 1 << 30)
    for name, words in (
        ("nothing.json", "cannot be read: No such file"),
        ("picture.png", "not UTF-8 at byte 128"),
        ("pipe.json", "no regular file; accepted: a text file"),
        ("long.json", "longer than 33554432 bytes"),
    ):
        with pytest.raises(ValueError, match=rf"{name}: {words}"):
            read_model(tmp_path / name)
