"""Whatever is given from Python, a chain and a request of a family are made or refused naming the argument."""

from typing import Any

import casadi as ca
import pytest
from effort import examples, texts
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from casadi_skin import Chain, OdeModel, follow_family
from casadi_skin.zero.family import family_request

QUICK = examples(250, database=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
CHAIN: dict[str, Any] = {"sites": 6, "alpha": 1.0, "gamma": 0.25, "g": 1.0}
REQUEST: dict[str, Any] = {
    "model": Chain(**CHAIN), "mode": 1, "amplitude_max": 1.0, "at": (0.5,), "tolerance": 1e-8,
    "transcription": "trigonometric", "corrector": "newton", "flow": "splitting", "symmetry": None, "walker": None,
    "degree": None, "at_Omega": (), "at_period": (), "period_max": None, "max_points": 10, "tail": None,
    "parameters": None,
}  # fmt: skip
Q, V, C = (ca.SX.sym(name) for name in "qvc")
SPRING = OdeModel("spring", Q, -Q - C * Q**3, C, 2, V, reversal=(1, -1), half_period=(-1, -1))
NUMBERS = st.integers(-3, 40) | st.floats() | st.sampled_from([10**400, -(10**400), 1e308, 5e-324, -0.0])
SCALARS = NUMBERS | st.none() | st.booleans() | texts(8) | st.binary(max_size=4) | st.complex_numbers()
VALUES = SCALARS | st.lists(SCALARS, max_size=3) | st.lists(SCALARS, max_size=3).map(tuple) | st.just({}) | st.just(st)


def refused(name: str, make: Any, given_values: dict[str, Any]) -> None:
    try:
        make(**given_values)
    except (ValueError, TypeError) as error:
        message = str(error)
        assert name in message
        assert len(message) < 500
        assert "\n" not in message


@QUICK
@given(st.sampled_from(sorted(CHAIN)), VALUES)
def test_any_argument_of_a_chain(name: str, value: Any) -> None:
    refused(name, Chain, CHAIN | {name: value})


@QUICK
@given(st.sampled_from(sorted(REQUEST)), VALUES)
def test_any_argument_of_a_family(name: str, value: Any) -> None:
    refused(name, family_request, REQUEST | {name: value})


@QUICK
@given(st.sampled_from(sorted(REQUEST)), VALUES | st.dictionaries(st.sampled_from(["c", "d"]), SCALARS, max_size=2))
def test_any_argument_of_a_family_of_a_model(name: str, value: Any) -> None:
    refused(name, family_request, REQUEST | {"model": SPRING, "parameters": {"c": 2.0}, name: value})


@pytest.mark.parametrize("name", ["at", "at_Omega", "at_period", "amplitude_max", "period_max", "tolerance"])
@pytest.mark.parametrize("value", ["1", float("nan"), 10**400, 1j, ["x"]])
def test_words_are_no_numbers(name: str, value: Any) -> None:
    with pytest.raises((ValueError, TypeError), match=rf"^{name}: given .*; accepted: "):
        follow_family(**{"model": Chain(**CHAIN), "mode": 1, "amplitude_max": 1.0, "corrector": "newton", name: value})
