"""The Duffing oscillator against its energy integral at 40 digits and against direct integration."""

from __future__ import annotations

from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from casadi_skin.lattice.closed_forms import duffing_displacement, duffing_frequency

ORBITS = [
    (3.0, 0.0, 2.0),  # harmonic
    (3.0, 1.0, 1e-3),
    (3.0, 1.0, 0.5),
    (3.0, 1.0, np.sqrt(3.0)),
    (2.0, 5.0, 20.0),  # nearly pure cubic
    (3.0, -1.0, 0.4),
    (3.0, -1.0, 1.6),
    (1.0, -1.0, 0.999),  # near the separatrix
    (1.0, -0.25, 1.9),
    (-1.0, 1.0, 1.5),  # a double well, outside the figure of eight
    (0.0, 1.0, 0.7),  # no linear stiffness at all
]


def frequency_from_the_energy_integral(omega_squared: float, g: float, amplitude: float) -> mp.mpf:
    """2 pi over T = 4 int_0^a dy/sqrt(2(E - V(y))), y = a sin(phi) to remove the end singularity."""
    with mp.workdps(40):
        w2, cubic = mp.mpf(omega_squared), mp.mpf(g) * mp.mpf(amplitude) ** 2
        quarter = mp.quad(
            lambda phi: 1 / mp.sqrt(w2 + cubic * (1 + mp.sin(phi) ** 2) / 2),
            [0, mp.pi / 4, mp.pi / 2],
        )
        return mp.pi / (2 * quarter)


def integrate(omega_squared: float, g: float, amplitude: float, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacement by Dormand and Prince's eighth-order method."""
    solution = solve_ivp(
        lambda _, x: [x[1], -omega_squared * x[0] - g * x[0] ** 3],
        (0.0, t[-1]),
        [amplitude, 0.0],
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
        t_eval=t,
    )
    assert solution.success
    return np.asarray(solution.y[0])


@pytest.mark.parametrize(("omega_squared", "g", "amplitude"), ORBITS)
def test_frequency_agrees_with_the_energy_integral(omega_squared: float, g: float, amplitude: float) -> None:
    exact = frequency_from_the_energy_integral(omega_squared, g, amplitude)
    found = duffing_frequency(omega_squared, g, amplitude)
    # Near the separatrix omega^2 + g a^2 is the small difference of two numbers known to one rounding.
    tolerance = 5e-15 if (omega_squared, amplitude) == (1.0, 0.999) else 5e-16
    assert abs(mp.mpf(found) / exact - 1) < tolerance


@pytest.mark.parametrize(("omega_squared", "g", "amplitude"), ORBITS)
def test_displacement_agrees_with_direct_integration(omega_squared: float, g: float, amplitude: float) -> None:
    period = float(2 * mp.pi / frequency_from_the_energy_integral(omega_squared, g, amplitude))
    # Near the separatrix the integration itself loses four digits at each passage of the saddle.
    near_separatrix = 0 < omega_squared < -1.1 * g * amplitude**2
    t = np.linspace(0.0, (0.5 if near_separatrix else 3) * period, 61)
    found = duffing_displacement(omega_squared, g, amplitude, t)
    np.testing.assert_allclose(found, integrate(omega_squared, g, amplitude, t), rtol=0, atol=3e-10 * amplitude)


@pytest.mark.parametrize(("omega_squared", "g", "amplitude"), ORBITS)
def test_displacement_is_a_brake_orbit_with_the_symmetries_of_a_quarter_period(
    omega_squared: float, g: float, amplitude: float
) -> None:
    period = float(2 * mp.pi / frequency_from_the_energy_integral(omega_squared, g, amplitude))
    y = duffing_displacement(omega_squared, g, amplitude, period * np.array([0.0, 0.25, 0.5, 0.75, 1.0]))
    np.testing.assert_allclose(y, amplitude * np.array([1.0, 0.0, -1.0, 0.0, 1.0]), atol=1e-13 * amplitude)


@pytest.mark.parametrize("g", [0.5, -0.5])
def test_the_sign_of_the_amplitude_is_the_sign_of_the_displacement(g: float) -> None:
    t = np.linspace(0.0, 5.0, 11)
    np.testing.assert_array_equal(duffing_displacement(2.0, g, -0.8, t), -duffing_displacement(2.0, g, 0.8, t))
    assert duffing_displacement(2.0, g, -0.8, 0.0) == -0.8
    assert duffing_frequency(2.0, g, -0.8) == duffing_frequency(2.0, g, 0.8)


@pytest.mark.parametrize("sign", [1, -1])
def test_only_the_product_of_the_cubic_coefficient_and_the_squared_amplitude_matters(sign: int) -> None:
    t = np.linspace(0.0, 7.0, 15)
    assert duffing_frequency(3.0, sign * 0.25, 2.0) == duffing_frequency(3.0, sign * 1.0, 1.0)
    np.testing.assert_array_equal(
        duffing_displacement(3.0, sign * 0.25, 2.0, t), 2.0 * duffing_displacement(3.0, sign * 1.0, 1.0, t)
    )


@pytest.mark.parametrize("g", [1e-14, 0.0, -1e-14])
def test_a_vanishing_cubic_term_leaves_the_cosine(g: float) -> None:
    t = np.linspace(0.0, 10.0, 41)
    np.testing.assert_allclose(duffing_displacement(4.0, g, 1.5, t), 1.5 * np.cos(2.0 * t), atol=1e-13)


@pytest.mark.parametrize("g", [1.0, -1.0])
def test_displacement_has_the_shape_of_the_times(g: float) -> None:
    assert np.shape(duffing_displacement(3.0, g, 0.5, 1.0)) == ()
    assert duffing_displacement(3.0, g, 0.5, [0.0, 1.0, 2.0]).shape == (3,)
    assert duffing_displacement(3.0, g, 0.5, np.zeros((2, 4))).shape == (2, 4)


@pytest.mark.parametrize("amplitude", [2.0, -2.0, 2.5])
def test_amplitudes_at_and_beyond_the_separatrix_are_refused_with_the_bound(amplitude: float) -> None:
    with pytest.raises(ValueError, match=r"must stay below 4$"):
        duffing_frequency(2.0, -0.5, amplitude)
    with pytest.raises(ValueError, match=r"must stay below 4$"):
        duffing_displacement(2.0, -0.5, amplitude, [0.0, 1.0])


def test_the_frequency_of_a_soft_oscillator_falls_to_zero_at_the_separatrix() -> None:
    gaps = [1e-2, 1e-6, 1e-10, 1e-14]
    found = [duffing_frequency(1.0, -1.0, float(np.sqrt(1.0 - gap))) for gap in gaps]
    # K(m) grows like the logarithm of the gap: slowly, and without a jump.
    assert all(a > b > 0 for a, b in pairwise(found))
    assert found[-1] < 0.2


@pytest.mark.parametrize("amplitude", [1.2, 1.41, 1.0, 0.5])
def test_orbits_that_do_not_swing_through_zero_are_refused(amplitude: float) -> None:
    with pytest.raises(ValueError, match="must exceed 2"):
        duffing_frequency(-1.0, 1.0, amplitude)


def test_a_linear_oscillator_without_stiffness_is_refused() -> None:
    with pytest.raises(ValueError, match="no orbit"):
        duffing_frequency(-1.0, 0.0, 1.0)
