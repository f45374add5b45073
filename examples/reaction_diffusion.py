"""The Brusselator on an interval, 500 cells and 1,000 states: where the uniform state starts to oscillate.

Run: python examples/reaction_diffusion.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import OdeModel, find_equilibrium, style

A, B, D = 2.0, 5.45, (0.008, 0.004)  # u' = D1 u''/L^2 + A - (B + 1) u + u^2 v, v' = D2 v''/L^2 + B u - u^2 v


def brusselator(cells: int) -> OdeModel:
    """Second differences on `cells` points inside (0, 1), where u = A and v = B/A at both ends."""
    x, L = ca.SX.sym("x", 2 * cells), ca.SX.sym("L")
    u, v = x[:cells], x[cells:]
    around = ca.vertcat(A, u, A), ca.vertcat(B / A, v, B / A)
    spread = [d / L**2 * (w[2:] - 2 * w[1:-1] + w[:-2]) * (cells + 1) ** 2 for d, w in zip(D, around, strict=True)]
    rates = ca.vertcat(A - (B + 1) * u + u**2 * v, B * u - u**2 * v)
    return OdeModel("Brusselator", x, ca.vertcat(*spread) + rates, L)


@style()
def main(picture: Path | str | None = None, cells: int = 500):
    """The uniform state from L = 0.3 to 1.7, with the lengths at which its first three modes start to oscillate."""
    uniform = np.repeat([A, B / A], cells)
    branch = find_equilibrium(brusselator(cells), uniform, parameters={"L": 0.3}).follow("L", 1.7)
    if picture is not None:
        draw(branch).savefig(picture, dpi=150)
    return branch


def draw(branch) -> Figure:
    """The number of unstable eigenvalues against L, and the critical modes at the Hopf points."""
    figure = Figure(figsize=(6.4, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.step(branch.values, [solution.unstable for solution in branch.solutions], "k-", where="mid")
    left.set(xlabel="L", ylabel="unstable eigenvalues")
    for point in branch.special_points:
        left.axvline(point.parameters["L"], color="tab:red", lw=0.8)
        u = point.vector[: point.vector.size // 2]
        mode = np.real(u * np.abs(u).max() / u[np.argmax(np.abs(u))]) / np.abs(u).max()
        right.plot(np.arange(1, u.size + 1) / (u.size + 1), mode, label=f"L = {point.parameters['L']:.4f}")
    right.set(xlabel="place", ylabel="u of the critical mode")
    right.legend(
        loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize="x-small", handlelength=1.0, frameon=False
    )
    return figure


if __name__ == "__main__":
    for point in main(*sys.argv[1:2]).special_points:
        L, omega = point.parameters["L"], point.frequency
        print(f"{point.kind} at L = {L:.10f}, frequency {omega:.8f}, coefficient {point.coefficient:.4g}")
