"""The Duffing oscillator against its energy integral at 40 digits and against direct integration."""

from __future__ import annotations

from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
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
        quarter = mp.quad(lambda phi: 1 / mp.sqrt(w2 + cubic * (1 + mp.sin(phi) ** 2) / 2), [0, mp.pi / 4, mp.pi / 2])
        return mp.pi / (2 * quarter)


@pytest.mark.parametrize(("omega_squared", "g", "amplitude"), ORBITS)
def test_orbits_agree_with_the_energy_integral_and_with_direct_integration(
    omega_squared: float, g: float, amplitude: float
) -> None:
    exact = frequency_from_the_energy_integral(omega_squared, g, amplitude)
    # Near the separatrix omega^2 + g a^2 is the small difference of two numbers known to one rounding.
    tolerance = 5e-15 if (omega_squared, amplitude) == (1.0, 0.999) else 5e-16
    assert abs(mp.mpf(duffing_frequency(omega_squared, g, amplitude)) / exact - 1) < tolerance
    period = float(2 * mp.pi / exact)
    quarters = duffing_displacement(omega_squared, g, amplitude, period * np.array([0.0, 0.25, 0.5, 0.75, 1.0]))
    np.testing.assert_allclose(quarters, amplitude * np.array([1, 0, -1, 0, 1]), atol=1e-13 * amplitude)
    # Near the separatrix the integration itself loses four digits at each passage of the saddle.
    near_separatrix = 0 < omega_squared < -1.1 * g * amplitude**2
    t = np.linspace(0.0, (0.5 if near_separatrix else 3) * period, 61)
    integrated = solve_ivp(
        lambda _, x: [x[1], -omega_squared * x[0] - g * x[0] ** 3], (0.0, t[-1]), [amplitude, 0.0],
        method="DOP853", rtol=1e-12, atol=1e-14, t_eval=t,
    )  # fmt: skip
    found = duffing_displacement(omega_squared, g, amplitude, t)
    np.testing.assert_allclose(found, integrated.y[0], rtol=0, atol=3e-10 * amplitude)


@pytest.mark.parametrize("g", [0.5, -0.5])
def test_signs_shapes_and_scales(g: float) -> None:
    """The sign of the amplitude is that of the displacement; only g a^2 matters; shapes are those of the times."""
    t = np.linspace(0.0, 5.0, 12).reshape(3, 4)
    y = duffing_displacement(2.0, g, 0.8, t)
    np.testing.assert_array_equal(duffing_displacement(2.0, g, -0.8, t), -y)
    np.testing.assert_array_equal(duffing_displacement(2.0, 4.0 * g, 0.4, t), 0.5 * y)
    assert y.shape == (3, 4)
    assert np.shape(duffing_displacement(2.0, g, 0.8, 1.0)) == ()
    assert duffing_frequency(2.0, g, -0.8) == duffing_frequency(2.0, g, 0.8) == duffing_frequency(2.0, 4.0 * g, 0.4)


@pytest.mark.parametrize("g", [1e-14, 0.0, -1e-14])
def test_a_vanishing_cubic_term_leaves_the_cosine(g: float) -> None:
    t = np.linspace(0.0, 10.0, 41)
    np.testing.assert_allclose(duffing_displacement(4.0, g, 1.5, t), 1.5 * np.cos(2.0 * t), atol=1e-13)


def test_the_frequency_of_a_soft_oscillator_falls_to_zero_at_the_separatrix() -> None:
    gaps = [1e-2, 1e-6, 1e-10, 1e-14]
    found = [duffing_frequency(1.0, -1.0, float(np.sqrt(1.0 - gap))) for gap in gaps]
    # K(m) grows like the logarithm of the gap: slowly, and without a jump.
    assert all(a > b > 0 for a, b in pairwise(found))
    assert found[-1] < 0.2


@pytest.mark.parametrize(
    ("omega_squared", "g", "amplitudes", "words"),
    [
        (2.0, -0.5, (2.0, -2.0, 2.5), "must stay below 4$"),
        (-1.0, 1.0, (1.41, 0.5), "must exceed 2"),
        (-1.0, 0.0, (1.0,), "no orbit"),
    ],
)
def test_amplitudes_without_an_oscillation_about_zero_are_refused_with_the_bound(
    omega_squared: float, g: float, amplitudes: tuple[float, ...], words: str
) -> None:
    for amplitude in amplitudes:
        with pytest.raises(ValueError, match=words):
            duffing_frequency(omega_squared, g, amplitude)
        with pytest.raises(ValueError, match=words):
            duffing_displacement(omega_squared, g, amplitude, [0.0, 1.0])
