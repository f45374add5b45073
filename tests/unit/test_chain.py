"""The nonreciprocal chain against the paper's equations and matrices (arXiv:2512.17483), typed out independently."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

from casadi_skin.models.chain import Chain

EPS = float(np.finfo(float).eps)
Array = NDArray[np.float64]


def numbers(value: Any) -> Array:
    """A CasADi result as a dense array, a column as a vector."""
    array = np.array(ca.DM(value))
    return array.ravel() if array.shape[1] == 1 else array


def physical_rhs(chain: Chain, y: Array, g: float) -> Array:
    model = chain.physical_model()
    return numbers(ca.Function("f", [model.state, model.parameters], [model.rhs])(y, g))


def gauge_rhs(chain: Chain, q: Array, kappa: float) -> Array:
    model = chain.gauge_model()
    return numbers(ca.Function("f", [model.state, model.parameters], [model.rhs])(q, kappa))


def paper_rhs(y: Array, alpha: float, gamma: float, g: float) -> Array:
    """The paper's first equation, site by site, y_0 = y_{N+1} = 0."""
    a_plus, a_minus = 1 - gamma, 1 + gamma
    padded = [0.0, *y, 0.0]
    return np.array(
        [
            a_minus * padded[n - 1] - 2 * padded[n] + a_plus * padded[n + 1] - alpha * padded[n] - g * padded[n] ** 3
            for n in range(1, len(y) + 1)
        ]
    )  # fmt: skip


# Parameters -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sites", [0, -3, 2.5, True, False])
def test_a_number_of_sites_that_is_not_a_positive_whole_number_is_refused(sites: Any) -> None:
    with pytest.raises(ValueError, match=f"sites: given {sites!r}; accepted: a whole number >= 1"):
        Chain(sites, 1.0, 0.25, 1.0)


@pytest.mark.xfail(strict=True, reason="int() speaks first, and a whole float is kept as a float")
@pytest.mark.parametrize("sites", [float("nan"), float("inf"), 3.0, None])
def test_a_number_of_sites_that_no_chain_can_be_built_with_is_refused_by_name(sites: Any) -> None:
    with pytest.raises(ValueError, match="sites: given"):
        Chain(sites, 1.0, 0.25, 1.0)


def test_a_numpy_integer_is_a_number_of_sites() -> None:
    assert Chain(np.int64(3), 1.0, 0.25, 1.0).gauge_model().full_size == 6


@pytest.mark.parametrize("name", ["alpha", "gamma", "g"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_parameter_that_is_not_finite_is_refused_by_name(name: str, value: float) -> None:
    parameters = {"sites": 3, "alpha": 1.0, "gamma": 0.25, "g": 1.0, name: value}
    with pytest.raises(ValueError, match=f"{name}: given {value!r}; accepted: a finite number"):
        Chain(**parameters)


@pytest.mark.parametrize("gamma", [1.0000001, -1.0000001, 2.0])
def test_a_nonreciprocity_beyond_one_is_refused(gamma: float) -> None:
    with pytest.raises(ValueError, match=f"gamma: given {gamma!r}; accepted: -1 <= gamma <= 1"):
        Chain(3, 1.0, gamma, 1.0)


@pytest.mark.parametrize("mode", [0, 5, -1])
def test_a_mode_that_is_not_there_is_refused(mode: int) -> None:
    with pytest.raises(ValueError, match=f"mode: given {mode}; accepted: 1..4"):
        Chain(4, 1.0, 0.25, 1.0).linear_frequency(mode)


@pytest.mark.xfail(strict=True, reason="only the range is checked; the frequency uses 1.5 and the sine int(1.5)")
def test_a_mode_between_two_modes_is_refused() -> None:
    with pytest.raises(ValueError, match="mode: given 1.5"):
        Chain(4, 1.0, 0.25, 1.0).linear_frequency(1.5)  # type: ignore[arg-type]


@pytest.mark.parametrize(("mode", "bound"), [(1, "-0.4"), (2, "-2"), (3, "-3.6")])
def test_a_mode_that_does_not_oscillate_is_refused_with_the_bound_on_alpha(mode: int, bound: str) -> None:
    """Three sites, s = 0.8 sqrt(2): 2 + alpha must exceed 1.6, 0 and -1.6 in turn."""
    gamma = float(np.sqrt(1 - 1.28 / 2 * 2)) if False else 0.0
    chain = Chain(3, -5.0, gamma, 1.0)
    limit = -2 + 2 * np.cos(mode * np.pi / 4)
    with pytest.raises(ValueError, match=rf"mode {mode} does not oscillate.*alpha > {limit:g}$"):
        chain.linear_frequency(mode)
    assert bound


def test_a_chain_is_immutable_and_compares_by_its_parameters() -> None:
    chain = Chain(3, 1.0, 0.25, -1.0)
    with pytest.raises(FrozenInstanceError):
        chain.gamma = 0.5  # type: ignore[misc]
    assert chain.rho.shape == (3,)  # cached values take no part in the comparison
    assert chain == Chain(3, 1.0, 0.25, -1.0)
    assert chain != Chain(3, 1.0, 0.25, 1.0)
    assert hash(chain) == hash(Chain(3, 1.0, 0.25, -1.0))
