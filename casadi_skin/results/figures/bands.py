"""The bands of a lattice's cell, with the modes of the lattice beside them, and the spectrum of the ring."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import Bands, bands, brillouin_zone, lattice_modes, winding_numbers
from casadi_skin.results.figures import style
from casadi_skin.zero.model_coordinates import linear_spectrum

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RING_POINTS = 401
RING_LABELS: dict[str, Any] = {"xlabel": r"Re $\omega^2$ (dots: of a ring)", "ylabel": r"Im $\omega^2$"}


def draw_bands(axes: Axes, found: Bands) -> None:
    """Frequencies against the wave number, of two dimensions round the Brillouin zone."""
    along = found.wave_numbers[:, 0] / np.pi
    if found.wave_numbers.shape[1] == 2:
        along = np.linspace(0.0, 3.0, len(along))
        axes.set_xticks(range(4), [r"$\Gamma$", "X", "M", r"$\Gamma$"])
    axes.plot(along, np.sqrt(np.maximum(found.squares.real, 0.0)), color="black")
    axes.set_ylabel(r"linear frequency $\omega$")


@style.drawn
def band_figure(lattice: Lattice, parameters: Mapping[str, float] | None = None) -> Figure:
    """Bands against the wave number, modes of the lattice by participation ratio, and omega^2 of a ring.

    Arguments:
        lattice: a lattice whose cells are all alike.
        parameters: values of parameters that are not the declared ones.

    Returns:
        The figure.

    Raises:
        ValueError: the cells differ.
    """
    of_cell, ring = bands(lattice, parameters), bands(lattice, parameters, RING_POINTS, open_ends=False)
    modes = lattice_modes(lattice, parameters)
    figure = style.blank(7.2, 3.2)
    panels = figure.subplot_mosaic("abc")
    draw_bands(panels["a"], of_cell)
    lean = rf", $|\beta| = {', '.join(f'{beta:.4g}' for beta in of_cell.beta)}$"
    panels["a"].set_xlabel(r"wave number $k/\pi$" + lean * any(beta != 1.0 for beta in of_cell.beta))
    panels["b"].plot(modes.participation, modes.frequencies.real, "o", ms=3, mfc="white", color="black")
    panels["b"].set_xlabel("participation ratio (sites)")
    panels["b"].sharey(panels["a"])
    panels["c"].plot(ring.squares.real, ring.squares.imag, ".", ms=1.5, color="0.45")
    panels["c"].plot(modes.squares.real, modes.squares.imag, "o", ms=3, mfc="white", color="black")
    panels["c"].set(**RING_LABELS)
    figure.suptitle(style.title(lattice, parameters))
    return style.finished(figure, (), 1)


# The skin effect of a lattice: its modes in the loops of the ring's spectrum, and the generalised Brillouin zone ------

SKIN_RING_POINTS = 1001


@style.drawn
def skin_figure(lattice: Lattice, parameters: Mapping[str, float] | None = None) -> Figure:
    """omega^2 of the ring and of the modes by their winding numbers, and the factors beta of the modes' waves.

    Arguments:
        lattice: a lattice in one dimension whose cells are all alike.
        parameters: values of parameters that are not the declared ones.

    Returns:
        The figure.

    Raises:
        ValueError: the lattice has two dimensions, or cells that differ.
    """
    ring = bands(lattice, parameters, SKIN_RING_POINTS, open_ends=False)
    squares = lattice_modes(lattice, parameters).squares
    windings = winding_numbers(lattice, squares, parameters)
    zone = brillouin_zone(lattice, squares, parameters).ravel()
    figure = style.blank(6.6, 3.2)
    panels = figure.subplot_mosaic("ab")
    panels["a"].plot(ring.squares.real, ring.squares.imag, ".", ms=1.0, color="0.6")
    markers, look = {0.0: "x", 1.0: "o", -1.0: "s"}, dict[str, Any](mfc="white", color="black")
    for value in np.unique(windings[np.isfinite(windings)]).tolist():
        chosen, label = squares[windings == value], f"{value:+.0f}" if value else "0"
        panels["a"].plot(chosen.real, chosen.imag, markers.get(value, "^"), ms=3.5, label=label, **look)
    on_ring = squares[np.isnan(windings)]
    if on_ring.size:
        panels["a"].plot(on_ring.real, on_ring.imag, "|", ms=5, color="black", label="none: on the ring's")
    panels["a"].legend(title="winding number", loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    panels["a"].set(**RING_LABELS)
    circle = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 201))
    panels["b"].plot(circle.real, circle.imag, color="0.6", lw=0.8, ls=style.LINE_DASHES[1])
    panels["b"].plot(zone.real, zone.imag, "o", ms=3, mfc="white", color="black")
    panels["b"].set(aspect="equal", xlabel=r"Re $\beta$ (dashed: $|\beta| = 1$)", ylabel=r"Im $\beta$")
    figure.suptitle(style.title(lattice, parameters))
    return style.finished(figure, (), 1)


# The linear spectrum and its two end modes (paper, Fig. 2a) -----------------------------------------------------------


@style.drawn
def spectrum_figure(model: Any, parameters: Mapping[str, float] | None = None) -> Figure:
    """Linear frequencies against j, the cutoffs of an infinite lattice, and the modes 1 and N (paper, Fig. 2a).

    Modes that do not oscillate (omega_j^2 <= 0) are left out. Modes have norm 1; of a long lattice the positions that
    move.

    Arguments:
        model: a `Chain` of finite length, or an `OdeModel` of second order with an equilibrium at 0.
        parameters: values of the parameters of an `OdeModel`, where they are not its nominal ones.

    Returns:
        The figure.

    Raises:
        ValueError: the model has no linear modes.
    """
    spectrum = linear_spectrum(model, parameters)
    N = spectrum.squares.size
    if N == 0:
        raise ValueError("sites: given an infinite chain; accepted for its spectrum: a whole number >= 1")
    j, n = np.arange(1, N + 1), style.position_label(model)
    frequencies = np.sqrt(np.where(spectrum.squares > 0, spectrum.squares, np.nan))
    figure = style.blank(6.8, 3.6)
    panels = figure.subplot_mosaic("aab;aac" if N > 1 else "aab")
    marker = "o" if N <= style.MARKED_SITES else ""
    panels["a"].plot(j, frequencies, marker=marker, ms=4, lw=0.8, color="black", mfc="white", zorder=3)
    sides = (("min", 0.97, 3, "right", "bottom"), ("max", 0.03, -3, "left", "top"))
    for square, (name, x, up, ha, va) in zip(spectrum.cutoffs or (), sides, strict=False):
        if square > 0:
            omega, across = float(np.sqrt(square)), panels["a"].get_yaxis_transform()
            panels["a"].axhline(omega, color="0.45", lw=0.9, ls="--")
            words = rf"$\omega_\mathrm{{{name}}} = {omega:.4g}$"
            panels["a"].annotate(words, (x, omega), (0, up), across, "offset points", ha=ha, va=va)
    style.number_sites(panels["a"], 1, N, "mode $j$")
    panels["a"].set_ylabel(r"linear frequency $\omega_j$")
    for letter, mode in zip("bc", (N, 1)[-len(panels) + 1 :], strict=False):
        u = spectrum.mode(mode)
        panels[letter].axhline(0.0, color="0.45", lw=0.5)
        panels[letter].plot(j, u, marker=marker, ms=2.5, lw=0.8, color="black")
        panels[letter].set_ylabel(rf"$u_{{{mode},n}}$")
        style.number_sites(panels[letter], *style.moving(u[None]), n if mode == 1 else "")
    figure.suptitle(style.title(model, parameters))
    return style.finished(figure, (), 1)
