"""The general door to models: what it keeps, what it refuses, and which wrong declarations it finds."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import FrozenInstanceError, dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from casadi_skin.model.ode import OdeModel
from casadi_skin.model.saved import read_model, save_model

Make = Callable[..., OdeModel]


def pendulums(**changes: Any) -> OdeModel:
    """Two coupled pendulums of second order: odd, reversible, conservative."""
    q, v, p = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p", 2)
    spring = p[1] * (q[0] - q[1])
    declared = {
        "name": "pendulums",
        "state": q,
        "rhs": -p[0] * ca.sin(q) - ca.vertcat(spring, -spring),
        "parameters": p,
        "order": 2,
        "velocity": v,
        "reversal": (1, 1, -1, -1),
        "half_period": (-1, -1, -1, -1),
        "normalisation": ca.dot(q, q) - 1,
        "hamiltonian": ca.dot(v, v) / 2 - p[0] * ca.sum1(ca.cos(q)) + p[1] * (q[0] - q[1]) ** 2 / 2,
    }
    return OdeModel(**(declared | changes))


def predator(**changes: Any) -> OdeModel:
    """Lotka and Volterra in logarithms, of first order: conservative, reversible by no choice of signs."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    declared = {
        "name": "predator",
        "state": x,
        "rhs": p * ca.vertcat(1 - ca.exp(x[1]), ca.exp(x[0]) - 1),
        "parameters": p,
        "hamiltonian": ca.exp(x[0]) - x[0] + ca.exp(x[1]) - x[1],
    }
    return OdeModel(**(declared | changes))


def van_der_pol(**changes: Any) -> OdeModel:
    """Van der Pol of first order: odd, neither reversible nor conservative."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    declared = {
        "name": "van der Pol",
        "state": x,
        "rhs": ca.vertcat(x[1], p * (1 - x[0] ** 2) * x[1] - x[0]),
        "parameters": p,
        "half_period": (-1, -1),
    }
    return OdeModel(**(declared | changes))


# What it keeps ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("make", "size", "full_size"), [(pendulums, 2, 4), (predator, 2, 2)])
def test_full_size_counts_velocities_where_there_are_any(make: Make, size: int, full_size: int) -> None:
    model = make()
    assert (model.size, model.full_size) == (size, full_size)
    assert model.full_state.shape == model.full_rhs.shape == (full_size, 1)


def test_full_state_is_positions_then_velocities_and_full_rhs_their_rates() -> None:
    model = pendulums()
    evaluate = ca.Function("f", [model.state, model.velocity, model.parameters], [model.full_state, model.full_rhs])
    state, rate = (np.array(value).ravel() for value in evaluate([0.3, -1.1], [0.7, 0.9], [2.0, 0.5]))
    assert state.tolist() == [0.3, -1.1, 0.7, 0.9]
    expected = [0.7, 0.9, -2 * np.sin(0.3) - 0.5 * 1.4, -2 * np.sin(-1.1) + 0.5 * 1.4]
    np.testing.assert_allclose(rate, expected, rtol=1e-15)


def test_rhs_and_jacobian_agree_with_derivatives_taken_by_hand() -> None:
    function = pendulums().rhs_and_jacobian()
    q, p = np.array([0.4, -0.9]), np.array([1.7, 0.6])
    value, by_state, by_parameter = (np.array(ca.DM(r)) for r in function(q, p))
    stretch = q[0] - q[1]
    np.testing.assert_allclose(
        value.ravel(),
        [-p[0] * np.sin(q[0]) - p[1] * stretch, -p[0] * np.sin(q[1]) + p[1] * stretch],
        rtol=1e-15,
    )
    np.testing.assert_allclose(
        by_state, [[-p[0] * np.cos(q[0]) - p[1], p[1]], [p[1], -p[0] * np.cos(q[1]) - p[1]]], rtol=1e-15
    )
    np.testing.assert_allclose(by_parameter, [[-np.sin(q[0]), -stretch], [-np.sin(q[1]), stretch]], rtol=1e-15)
    assert function.name_in() == ["state", "p"]
    assert function.name_out() == ["f", "df_dstate", "df_dp"]


def test_the_state_jacobian_is_sparse_and_the_parameter_jacobian_dense() -> None:
    x, p = ca.SX.sym("x", 5), ca.SX.sym("p", 2)
    function = OdeModel("decoupled", x, -(x**3) + ca.vertcat(p[0], 0, 0, 0, 0), p).rhs_and_jacobian()
    assert function.nnz_out("df_dstate") == 5
    assert function.nnz_out("df_dp") == 10


def test_first_order_form_has_the_same_flow_and_the_same_declarations() -> None:
    model = pendulums()
    first = model.first_order()
    assert (first.order, first.velocity, first.size, first.full_size) == (1, None, 4, 4)
    assert first.name == model.name
    assert first.reversal == (1, 1, -1, -1)
    assert first.half_period == (-1, -1, -1, -1)
    evaluate = ca.Function("f", [first.state, first.parameters], [first.rhs, first.normalisation, first.hamiltonian])
    point = [0.3, -1.1, 0.7, 0.9]
    rate, normalisation, energy = (np.array(value).ravel() for value in evaluate(point, [2.0, 0.5]))
    expected = [0.7, 0.9, -2 * np.sin(0.3) - 0.5 * 1.4, -2 * np.sin(-1.1) + 0.5 * 1.4]
    np.testing.assert_allclose(rate, expected, rtol=1e-15)
    assert normalisation[0] == pytest.approx(0.09 + 1.21 - 1)
    assert energy[0] == pytest.approx(0.65 - 2 * (np.cos(0.3) + np.cos(1.1)) + 0.25 * 1.4**2)
    first.check_symmetries()


def test_a_model_of_first_order_is_its_own_first_order_form() -> None:
    model = predator()
    assert model.first_order() is model


def test_a_model_cannot_be_changed_after_it_was_checked() -> None:
    with pytest.raises(FrozenInstanceError):
        pendulums().order = 1  # type: ignore[misc]


# What it refuses --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [0, 3, -1])
def test_other_orders_than_one_and_two_are_refused(order: int) -> None:
    with pytest.raises(ValueError, match=f"pendulums: order: given {order}; accepted: 1 or 2"):
        pendulums(order=order)


@pytest.mark.parametrize("length", [1, 3])
def test_a_right_hand_side_of_another_length_is_refused(length: int) -> None:
    with pytest.raises(ValueError, match=rf"rhs: given shape \({length}, 1\); accepted: \(2, 1\)"):
        predator(rhs=ca.SX.zeros(length))


def test_a_right_hand_side_that_lies_down_is_refused() -> None:
    with pytest.raises(ValueError, match=r"rhs: given shape \(1, 2\); accepted: \(2, 1\)"):
        predator(rhs=ca.SX.zeros(1, 2))


def test_second_order_without_a_velocity_is_refused() -> None:
    with pytest.raises(ValueError, match="a velocity symbol belongs to a model of second order"):
        pendulums(velocity=None)


def test_first_order_with_a_velocity_is_refused() -> None:
    with pytest.raises(ValueError, match="a velocity symbol belongs to a model of second order"):
        predator(velocity=ca.SX.sym("v", 2))


def test_a_second_order_right_hand_side_that_depends_on_velocity_is_refused() -> None:
    q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p")
    with pytest.raises(ValueError, match="depends on velocity; write first order"):
        OdeModel("damped", q, -q - p * v, p, 2, v)
    OdeModel("undamped", q, -q - p * q, p, 2, v)


@pytest.mark.parametrize("label", ["reversal", "half_period"])
@pytest.mark.parametrize("signs", [(), (1, 1), (1, 1, -1), (1, 1, -1, -1, 1), (1, 1, -1, 0), (1, 1, -1, 2), (0.5,) * 4])
def test_signs_that_do_not_fit_the_full_state_are_refused(label: str, signs: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=f"pendulums: {label} needs 4 signs, each \\+1 or -1"):
        pendulums(**{label: signs})


@pytest.mark.parametrize("shape", [(1, 1), (3, 1), (1, 2)])
def test_a_velocity_of_another_shape_than_the_state_is_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="velocity"):
        pendulums(velocity=ca.SX.sym("v", *shape), hamiltonian=None)


@pytest.mark.parametrize("field", ["rhs", "normalisation", "hamiltonian"])
def test_an_expression_in_an_undeclared_symbol_is_refused(field: str) -> None:
    model = predator(normalisation=ca.SX(0))
    with pytest.raises(ValueError, match="stranger"):
        replace(model, **{field: getattr(model, field) + ca.SX.sym("stranger")})


# Which wrong declarations it finds --------------------------------------------------------------------------


@pytest.mark.parametrize("make", [pendulums, predator, van_der_pol])
def test_declarations_that_hold_pass(make: Make) -> None:
    make().check_symmetries()


def test_a_model_that_declares_nothing_passes() -> None:
    van_der_pol(half_period=None).check_symmetries(trials=2)


@pytest.mark.parametrize(
    ("make", "signs"),
    [
        (pendulums, (1, 1, 1, 1)),
        (pendulums, (1, -1, -1, 1)),
        (van_der_pol, (1, -1)),
        (predator, (1, -1)),
        (predator, (-1, 1)),
    ],
)
def test_a_reversal_that_does_not_hold_is_named(make: Make, signs: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="declared reversal is not a symmetry"):
        make(reversal=signs).check_symmetries()


@pytest.mark.parametrize(
    ("make", "signs"),
    [(pendulums, (-1, 1, -1, 1)), (pendulums, (1, 1, -1, -1)), (van_der_pol, (1, -1)), (predator, (-1, -1))],
)
def test_a_half_period_symmetry_that_does_not_hold_is_named(make: Make, signs: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="declared half_period is not a symmetry"):
        make(half_period=signs).check_symmetries()


def test_an_odd_reversal_of_the_pendulums_passes() -> None:
    """Reversal composed with the odd symmetry is a reversal too."""
    pendulums(reversal=(-1, -1, 1, 1)).check_symmetries()


def test_the_trivial_half_period_symmetry_passes() -> None:
    van_der_pol(half_period=(1, 1)).check_symmetries()


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0])
def test_a_small_term_that_breaks_the_half_period_symmetry_is_found(size: float) -> None:
    model = pendulums(hamiltonian=None)
    broken = replace(model, rhs=model.rhs + size * model.state**2, checked=False)
    with pytest.raises(ValueError, match="half_period"):
        broken.check_symmetries()
    replace(broken, half_period=None).check_symmetries()


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0])
def test_a_small_damping_that_breaks_the_reversal_is_found(size: float) -> None:
    model = pendulums(hamiltonian=None).first_order()
    broken = replace(model, rhs=model.rhs - size * ca.vertcat(0, 0, model.state[2:]), checked=False)
    with pytest.raises(ValueError, match="reversal"):
        broken.check_symmetries()
    replace(broken, reversal=None).check_symmetries()


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0])
def test_a_quantity_that_is_not_conserved_is_found(size: float) -> None:
    model = pendulums()
    with pytest.raises(ValueError, match="declared hamiltonian is not conserved"):
        replace(model, hamiltonian=model.hamiltonian + size * model.state[0] * model.state[1]).check_symmetries()


def test_an_energy_that_only_ever_falls_is_found() -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    damped = ca.vertcat(x[1], -x[0] - 1e-3 * x[1])
    with pytest.raises(ValueError, match="hamiltonian is not conserved"):
        OdeModel("damped", x, damped, p, hamiltonian=ca.dot(x, x) / 2).check_symmetries()


def test_a_hamiltonian_of_the_wrong_sign_is_found() -> None:
    model = predator()
    wrong = ca.exp(model.state[0]) - model.state[0] - ca.exp(model.state[1]) + model.state[1]
    with pytest.raises(ValueError, match="predator: the declared hamiltonian is not conserved"):
        replace(model, hamiltonian=wrong).check_symmetries()


def test_a_wrong_declaration_is_found_where_parameters_must_be_positive() -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 3)
    rhs = ca.vertcat(x[1], -ca.sum1(ca.sqrt(p)) * x[0] + x[0] ** 2)  # even: no half-period symmetry
    with pytest.raises(ValueError, match="half_period"):
        OdeModel("square roots", x, rhs, p, half_period=(-1, -1)).check_symmetries()


# Names, forcing, outputs, nominal values ----------------------------------------------------------------------------


def forced(**changes: Any) -> OdeModel:
    """A forced pendulum whose forcing's period is a parameter's."""
    q, v, w, a, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "a", "t"))
    declared = {
        "name": "forced",
        "state": ca.vertcat(q, v),
        "rhs": ca.vertcat(v, -ca.sin(q) - 0.1 * v + a * ca.cos(w * t)),
        "parameters": ca.vertcat(w, a),
        "time": t,
        "forcing_period": 2 * ca.pi / w,
        "outputs": {"energy": v**2 / 2 - ca.cos(q), "power": a * v * ca.cos(w * t)},
        "nominal": (2.0, 0.1),
    }
    return OdeModel(**(declared | changes))  # type: ignore[arg-type]


def test_components_are_called_as_their_symbols_or_labels() -> None:
    assert forced().state_names == ("q", "v")
    assert forced().parameter_names == ("omega", "a")
    assert pendulums().state_names == ("q_0", "q_1", "v_0", "v_1")
    assert forced(state_labels=("angle", "rate")).state_names == ("angle", "rate")
    assert forced(parameter_labels=("w", "force")).parameter_names == ("w", "force")


def test_a_model_without_parameters_has_none() -> None:
    x = ca.SX.sym("x")
    model = OdeModel("decay", x, -x)
    assert model.parameter_names == ()
    assert float(model.vector_field(0.0, 2.0, [])) == -2.0


def test_outputs_are_functions_of_time_state_and_parameters() -> None:
    model = forced()
    power = model.function("power", model.outputs["power"])
    assert float(power(0.5, [0.1, 3.0], [2.0, 0.7])) == pytest.approx(0.7 * 3.0 * np.cos(1.0))
    assert model.forced
    assert not pendulums().forced


def test_the_first_order_form_keeps_names_forcing_outputs_and_nominal_values() -> None:
    q, v, k, t = (ca.SX.sym(name) for name in "qvkt")
    model = OdeModel(
        "driven", q, -k * q + ca.sin(t), k, 2, v, time=t, forcing_period=2 * np.pi, outputs={"work": q * ca.sin(t)},
        nominal=(4.0,), state_labels=("place", "speed"), parameter_labels=("stiffness",),
    )  # fmt: skip
    first = model.first_order()
    assert first.state_names == ("place", "speed")
    assert first.parameter_names == ("stiffness",)
    assert (first.nominal, first.forcing_period, list(first.outputs)) == ((4.0,), 2 * np.pi, ["work"])
    np.testing.assert_array_equal(first.vector_field(1.0, [0.5, 0.2], 4.0), model.vector_field(1.0, [0.5, 0.2], 4.0))


def test_the_ends_of_an_interval_have_their_own_symbols() -> None:
    model = forced()
    q = model.state[0]
    assert str(model.start(q)) == "q(start)"
    assert str(model.end(2 * q)) == "(2.*q(end))"
    assert model.ends is model.ends
    assert not ca.depends_on(model.start(q), q)


@pytest.mark.parametrize("second", ["x", "p"])
def test_two_names_of_one_model_are_different(second: str) -> None:
    """Two states, two parameters, or a state and a parameter of one name: results by name would show one of them."""
    x, y, p, q = (ca.SX.sym(name) for name in ("x", second, "p", "x" if second == "p" else "p"))
    words = r"^twins: p, x named more than once among states, parameters and outputs; "
    with pytest.raises(ValueError, match=words) as error:
        OdeModel("twins", ca.vertcat(x, y), ca.vertcat(-p * x, -q * y), ca.vertcat(p, q))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"nominal": (1.0,)}, "forced: nominal needs 2 values, given 1"),
        ({"state_labels": ("a",)}, "forced: state_labels needs 2 names, given 1"),
        ({"parameter_labels": ("a", "b", "c")}, "forced: parameter_labels needs 2 names, given 3"),
        ({"outputs": {"both": ca.SX.zeros(2)}}, "forced: outputs with several components"),
        ({"outputs": {"q": ca.SX(0)}}, "forced: q named more than once among states, parameters and outputs"),
        (
            {"outputs": {"strange": ca.SX.sym("w")}},
            "forced: output strange: depends on w, not declared; accepted: ",
        ),
        ({"forcing_period": None}, "forced: time without forcing_period; accepted: the forcing's period"),
        ({"forcing_period": ca.SX.sym("T")}, "forced: forcing_period depends on T; accepted: parameters"),
        ({"time": None}, "not declared"),
        ({"hamiltonian": ca.SX(1)}, "forced: a hamiltonian in a model that is forced"),
        ({"half_period": (1, -1)}, "forced: the declared half_period is not a symmetry"),
        ({"reversal": (1, -1)}, "forced: the declared reversal is not a symmetry"),
        ({"output_scale": (1.0,)}, "forced: output_scale needs 2 factors, given 1"),
    ],
)
def test_declarations_that_do_not_fit_are_refused_in_one_line(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=r"^forced: ") as error:
        forced(**changes)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_state_that_is_an_expression_is_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="with expressions among them; accepted: symbols"):
        OdeModel("shifted", x + 1, -x)


def test_the_half_period_symmetry_of_a_forced_model_shifts_the_forcing() -> None:
    """cos changes its sign half a period later, so that the odd pendulum has odd orbits; with cos^2 it has not."""
    assert forced(half_period=(-1, -1)).half_period == (-1, -1)
    model = forced()
    even = model.rhs + ca.vertcat(0, ca.cos(model.parameters[0] * model.time) ** 2)
    with pytest.raises(ValueError, match="declared half_period is not a symmetry"):
        replace(model, rhs=even, half_period=(-1, -1))


def test_symmetries_are_checked_when_declared_unless_told_otherwise() -> None:
    with pytest.raises(ValueError, match="the declared half_period is not a symmetry"):
        predator(half_period=(-1, -1))
    with pytest.raises(ValueError, match="the declared half_period is not a symmetry"):
        predator(half_period=(-1, -1), checked=False).check_symmetries()


def test_a_model_that_is_never_finite_is_told() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="not finite at a random point"):
        OdeModel("nowhere", x, ca.log(-(x**2)), half_period=(-1,))


# Files ---------------------------------------------------------------------------------------------------------------


def mx_model() -> OdeModel:
    x, p = ca.MX.sym("x", 3), ca.MX.sym("p", 2)
    rhs = ca.vertcat(x[1] * p[0], -ca.sin(x[0]), p[1] - x[2])
    return OdeModel("matrix", x, rhs, p, nominal=(1.0, 2.0), outputs={"sum": ca.sum1(x)})


@pytest.mark.parametrize("make", [pendulums, predator, van_der_pol, forced, mx_model])
def test_what_is_read_is_what_was_saved(make: Make, tmp_path: Path) -> None:
    model = make()
    again = read_model(save_model(model, tmp_path / "model.json"))
    for label in ("name", "order", "size", "state_names", "parameter_names", "reversal", "half_period", "nominal"):
        assert getattr(again, label) == getattr(model, label)
    assert (again.forced, list(again.outputs)) == (model.forced, list(model.outputs))
    generator = np.random.default_rng(1)
    point = (0.3, generator.normal(size=model.full_size), 1 + generator.random(model.parameters.numel()))
    results = [
        [m.full_rhs, *m.outputs.values(), *([] if m.hamiltonian is None else [m.hamiltonian])] for m in (model, again)
    ]
    ours, theirs = (m.function("f", *r)(*point) for m, r in zip((model, again), results, strict=True))
    for one, other in zip(*(r if isinstance(r, tuple) else (r,) for r in (ours, theirs)), strict=True):
        np.testing.assert_array_equal(one, other)
    if model.forced:
        periods = [ca.Function("T", [m.parameters], [m.forcing_period])(point[2]) for m in (model, again)]
        assert periods[0] == periods[1]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not a model saved by casadi_skin: Input data was truncated"),
        ("{", "not a model saved by casadi_skin: Input data was truncated"),
        ("[]", "not a model saved by casadi_skin: Expected `object`, got `array`; accepted: a file of format"),
        ('{"format": "casadi_skin model 0"}', "format 'casadi_skin model 0'; accepted: a file of format"),
        (
            '{"format": "casadi_skin model 1", "equations": ""}',
            "format 'casadi_skin model 1'; accepted: a file of format",
        ),
        ('{"format": "casadi_skin model 2"}', "Object missing required field `sha256`"),
        ("[" * 100_000, "not a model saved by casadi_skin"),
    ],
)
def test_other_files_are_refused_in_one_line(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=words) as error:
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
        ("pipe.json", "no file; accepted: a text file"),
        ("long.json", "longer than 33554432 bytes"),
    ):
        with pytest.raises(ValueError, match=rf"{name}: {words}"):
            read_model(tmp_path / name)


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


# MX -----------------------------------------------------------------------------------------------------------------


def test_mx_models_number_their_components() -> None:
    model = mx_model()
    assert model.state_names == ("x_0", "x_1", "x_2")
    assert model.parameter_names == ("p_0", "p_1")
    np.testing.assert_allclose(np.array(model.vector_field(0.0, [0.0, 2.0, 3.0], [1.0, 2.0])).ravel(), [2.0, 0.0, -1.0])
    x = ca.MX.sym("x")
    assert OdeModel("alone", x, -x).state_names == ("x",)


def test_mx_models_of_second_order_or_of_several_symbols_are_refused() -> None:
    x, v = ca.MX.sym("x", 2), ca.MX.sym("v", 2)
    with pytest.raises(ValueError, match="of second order in MX; accepted: SX, or a model of first order"):
        OdeModel("second", x, -x, order=2, velocity=v)
    with pytest.raises(ValueError, match="with expressions among them; accepted: symbols"):
        OdeModel("several", ca.vertcat(x, v), ca.vertcat(v, -x))
