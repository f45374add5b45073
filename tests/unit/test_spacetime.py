"""Space-time pictures: what is where, what the colours say, and what long runs show."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from casadi_skin import Chain, Evolution, distance_from_orbit, evolve, follow_family, simulate_orbit
from casadi_skin.results.figures.evolutions import COLOUR_MAP, spacetime_figure

pytestmark = pytest.mark.usefixtures("pictures")

CHAIN = Chain(6, 1.0, 0.3, 1.0)


def evolution(end: float = 20.0, samples: int = 201, start: int = 6) -> Evolution:
    y = np.zeros(6)
    y[start - 1] = 0.4
    return evolve(CHAIN, y, None, np.linspace(0.0, end, samples), "dop853", 1e-8)


def mesh(figure: Figure) -> QuadMesh:
    """The space-time image: the one with the colour map."""
    (image,) = [c for axes in figure.axes for c in axes.collections if isinstance(c, QuadMesh) and c.colorbar]
    return image


def labels(figure: Figure) -> set[str]:
    return {text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel()) if text}


def test_cells_stand_at_their_times_and_sites_and_colours_are_centred() -> None:
    run = evolution()
    image = mesh(spacetime_figure(run))
    values = np.asarray(image.get_array())
    np.testing.assert_array_equal(values, run.displacements.T)
    corners = image.get_coordinates()
    assert np.all(corners[0, :-1, 0] <= run.t)
    assert np.all(run.t <= corners[0, 1:, 0])
    np.testing.assert_array_equal(corners[:, 0, 1], np.arange(7) + 0.5)
    assert image.norm.vmax == -image.norm.vmin == np.abs(run.displacements).max()  # type: ignore[operator]


def test_lightness_rises_with_displacement() -> None:
    rgb = mpl.colormaps[COLOUR_MAP](np.linspace(0, 1, 256))[:, :3]
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)  # IEC 61966-2-1
    lightness = np.cbrt(linear @ [0.2126, 0.7152, 0.0722])
    assert np.all(np.diff(lightness) > 0)
    middle = rgb[127:129].mean(axis=0)
    assert np.ptp(middle) < 0.05  # zero is grey


def test_axes_and_panels_are_labelled() -> None:
    plain = labels(spacetime_figure(evolution()))
    assert plain == {"time $t$", "site $n$", "displacement $y_n(t)$"}
    full = spacetime_figure(evolution(), "mode", profile=True, energy=True, kicked_site=2)
    assert labels(full) == plain | {"$y_n(0)$", r"$\Delta H\,/\,H$"}
    assert "mode; $N = 6$" in full.get_suptitle()
    marks = [line for axes in full.axes for line in axes.lines if line.get_marker() == ">"]
    assert [float(line.get_ydata()[0]) for line in marks] == [2.0]  # type: ignore[index]


def test_coarse_samples_are_owned_up_to() -> None:
    assert "time $t$ (samples 2 apart: oscillations are not resolved)" in labels(spacetime_figure(evolution(40.0, 21)))


def test_long_runs_show_the_extent_of_the_oscillation_and_the_mean_energy() -> None:
    run = evolution(1200.0, 8001)
    figure = spacetime_figure(run, energy=True)
    image = mesh(figure)
    values = np.asarray(image.get_array())
    assert values.shape == (6, 200)
    assert image.norm.vmin == 0.0
    first = run.t < 6.0  # a window is 1200/200 long
    np.testing.assert_allclose(values[:, 0], np.abs(run.displacements[first]).max(axis=0))
    assert "largest $|y_n|$ in windows of 6" in labels(figure)
    lines = [np.asarray(line.get_ydata()) for axes in figure.axes for line in axes.lines]
    (mean,) = [y for y in lines if y.size == 200]
    assert mean[0] == pytest.approx(run.energy_drift[first].mean(), rel=1e-9)


def test_an_escape_saturates_at_the_top_of_the_well() -> None:
    run = evolve(Chain(1, 1.0, 0.0, -1.0), [2.5], None, np.linspace(0.0, 0.85, 50))
    image = mesh(spacetime_figure(run))
    assert image.norm.vmax == pytest.approx(np.sqrt(3.0))
    assert image.colorbar.extend == "both"


def test_a_perturbed_orbit_has_its_own_scale_and_its_distance_below() -> None:
    orbit = follow_family(Chain(4, 1.0, 0.25, -1.0), 1, 0.1, tolerance=1e-4).orbits[-1]
    run = simulate_orbit(orbit, np.linspace(0.0, 30.0, 101), 1e-2, site=4)
    figure = spacetime_figure(run, energy=True, orbit=orbit)
    assert mesh(figure).get_clim()[1] == pytest.approx(np.abs(orbit.profile).max())
    below = figure.axes[-1]
    assert below.get_ylabel() == "distance"
    np.testing.assert_allclose(below.lines[0].get_ydata(), distance_from_orbit(orbit, run))
