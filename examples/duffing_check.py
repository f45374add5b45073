"""One site is the Duffing oscillator: true and estimated error of the frequency against the tolerance asked for.

Run: python examples/duffing_check.py PICTURE.png
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, closed_forms, follow_family, style

TOLERANCES = 10.0 ** -np.arange(4, 14)
METHODS = ("trigonometric", "gauss")


class Errors(NamedTuple):
    """Relative errors of Omega, each of shape (tolerances,)."""

    true: np.ndarray
    estimated: np.ndarray


@style()
def main(picture: Path | str | None = None) -> dict[str, Errors]:
    """Errors at S = 2, g = -1, where Omega is 0.69 of the linear frequency, by transcription."""
    chain = Chain(sites=1, alpha=1.0, gamma=0.0, g=-1.0)
    exact = closed_forms.duffing_frequency(2.0 + chain.alpha, chain.g, amplitude=np.sqrt(2.0))
    errors = {}
    for method in METHODS:
        orbits = [
            follow_family(chain, 1, 2.0, tolerance=tolerance, transcription=method, corrector="newton").at(S=2.0)
            for tolerance in TOLERANCES
        ]
        true = [abs(orbit.Omega / exact - 1.0) for orbit in orbits]
        errors[method] = Errors(np.array(true), np.array([orbit.Omega_error / exact for orbit in orbits]))
    if picture is not None:
        draw(errors).savefig(picture, dpi=150)
    return errors


def draw(errors: dict[str, Errors]) -> Figure:
    """Errors on logarithmic axes; results below the diagonal keep what was asked."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes, epsilon = figure.subplots(), np.finfo(float).eps
    axes.plot(TOLERANCES, TOLERANCES, color="0.6", lw=1, label="what was asked for")
    for method, marker, colour in zip(METHODS, "os", ("black", "tab:blue"), strict=True):
        true, estimated = errors[method]
        axes.plot(TOLERANCES, np.maximum(true, epsilon), marker, color=colour, ms=6, label=f"{method}, true")
        axes.plot(TOLERANCES, np.maximum(estimated, epsilon), marker, color=colour, ms=9, mfc="none", ls="--", lw=0.7,
                  label=f"{method}, estimated")  # fmt: skip
    axes.axhline(epsilon, color="0.6", lw=0.8, ls=":", label="round-off (smaller errors are drawn here)")
    axes.set(xscale="log", yscale="log", xlabel="tolerance", ylabel=r"relative error of $\Omega$", ylim=(1e-16, 1e-3))
    axes.invert_xaxis()
    axes.legend(fontsize="small", loc="upper right")
    return figure


if __name__ == "__main__":
    for name, (right, guessed) in main(*sys.argv[1:2]).items():
        for row in zip(TOLERANCES, right, guessed, strict=True):
            print(f"{name:14s} tolerance {row[0]:.0e}: error {row[1]:.1e}, estimated {row[2]:.1e}")
