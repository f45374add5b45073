"""Symmetries of the equations of motion, for chains and starts drawn at random."""

from __future__ import annotations

import numpy as np
from effort import examples
from hypothesis import given
from hypothesis import strategies as st

from casadi_skin import Chain, evolve
from casadi_skin.lattice.closed_forms import Array
from casadi_skin.model.methods import INTEGRATORS

QUICK = examples(25, database=None, derandomize=True)

sites = st.integers(1, 6)
gammas = st.floats(-0.8, 0.8)
couplings = st.floats(0.0, 2.0)  # hardening: nothing escapes
methods = st.sampled_from(tuple(INTEGRATORS))
seeds = st.integers(0, 2**32 - 1)


def start(seed: int, count: int) -> tuple[Array, Array]:
    generator = np.random.default_rng(seed)
    return 0.4 * generator.normal(size=count), 0.4 * generator.normal(size=count)


def spread(chain: Chain) -> float:
    """What an error at the far end can grow to on its way."""
    return float(1.0 / chain.rho.min())


@QUICK
@given(sites, gammas, couplings, methods, seeds)
def test_backwards_in_time(count: int, gamma: float, g: float, method: str, seed: int) -> None:
    chain, (y, v) = Chain(count, 1.0, gamma, g), start(seed, count)
    there = evolve(chain, y, v, [8.0], method, 1e-12)
    back = evolve(chain, there.displacements[0], -there.velocities[0], [8.0], method, 1e-12)
    np.testing.assert_allclose(back.displacements[0], y, rtol=0, atol=2e-8 * spread(chain))
    np.testing.assert_allclose(back.velocities[0], -v, rtol=0, atol=2e-8 * spread(chain))


@QUICK
@given(sites, gammas, couplings, methods, seeds)
def test_only_the_product_of_g_and_the_squared_size_matters(
    count: int, gamma: float, g: float, method: str, seed: int
) -> None:
    y, v = start(seed, count)
    chain = Chain(count, 1.0, gamma, g)
    small = evolve(chain, y, v, [1.0, 6.0], method, 1e-12)
    large = evolve(Chain(count, 1.0, gamma, g / 100), 10 * y, 10 * v, [1.0, 6.0], method, 1e-12)
    np.testing.assert_allclose(large.displacements, 10 * small.displacements, rtol=0, atol=1e-9 * spread(chain))


@QUICK
@given(sites, gammas, couplings, methods, seeds)
def test_the_energy_stays_and_the_start_is_returned(count: int, gamma: float, g: float, method: str, seed: int) -> None:
    y, v = start(seed, count)
    run = evolve(Chain(count, 1.0, gamma, g), y, v, [0.0, 3.0, 9.0], method, 1e-11)
    assert np.abs(run.energy_drift).max() < 1e-9
    np.testing.assert_allclose(run.displacements[0], y, rtol=1e-15)
    np.testing.assert_allclose(run.velocities[0], v, rtol=1e-15)
