"""Conductances of a neuron from the currents at which it begins to fire, falls silent, and the reverse.

The equations are those of Morris and Lecar (1981). What was measured is planted: four currents with a standard
deviation of 0.1 of a neuron whose parameters are known here, and not to the fit.

Run: python examples/fit_neuron.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import OdeModel, find_equilibrium, fit_parameters, style

V, w, current, g_Ca, g_K, phi = (ca.SX.sym(name) for name in ("V", "w", "I", "g_Ca", "g_K", "phi"))
opened, rest = (1 + ca.tanh((V + 1.2) / 18)) / 2, (1 + ca.tanh((V - 2) / 30)) / 2
currents = g_Ca * opened * (V - 120) + g_K * w * (V + 84) + 2 * (V + 60)
rates = ca.vertcat((current - currents) / 20, phi * ca.cosh((V - 2) / 60) * (rest - w))
model = OdeModel("neuron", ca.vertcat(V, w), rates, ca.vertcat(current, g_Ca, g_K, phi))

guess = {"g_Ca": 4.4, "g_K": 8.0, "phi": 0.04}
planted = {"g_Ca": 4.1, "g_K": 7.4, "phi": 0.044}
deviation = 0.1


def diagram(parameters):
    """Rest and both branches of firing, with the two Hopf points and the two folds at which firing is born."""
    start = find_equilibrium(model, [-50.0, 0.01], parameters={"I": 60.0, **parameters})
    resting = start.follow("I", 250.0)
    hopf = [point for point in resting.special_points if point.kind == "hopf"]
    firing = [point.follow("I", to, stability=True) for point, to in zip(hopf, (150.0, 150.0), strict=True)]
    folds = [next(p for p in cycles.special_points if p.kind == "fold") for cycles in firing]
    return resting, firing, [*hopf, *folds]


@style()
def main(picture: Path | str | None = None):
    """The fit to four currents that are drawn about the planted ones."""
    start, there = diagram(guess), diagram(planted)
    noise = np.random.default_rng(1).normal(0.0, deviation, 4)
    places = np.array([point.parameters["I"] for point in there[2]]) + noise
    fit = fit_parameters([(p, at, deviation) for p, at in zip(start[2], places, strict=True)], over=list(guess))
    if picture is not None:
        draw(fit, places, start, diagram(fit.values)).savefig(picture, dpi=150)
    return fit


def draw(fit, places, start, end) -> Figure:
    """The diagrams at the guess and at the fit, and the conductances with ellipses of one and two deviations."""
    figure = Figure(figsize=(7.4, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for (resting, firing, _), color, label in ((start, "0.75", "guess"), (end, "black", "fit")):
        left.plot(resting["I"], [one["V"] for one in resting.orbits], color=color, lw=1, label=label)
        for cycles in firing:
            left.plot(cycles["I"], [one.states[:, 0].max() for one in cycles.orbits], color=color, lw=1)
    for place in places:
        left.axvspan(place - deviation, place + deviation, color="tab:red", alpha=0.5, lw=0)
    left.plot([], [], color="tab:red", alpha=0.5, lw=4, label="measured")
    left.set(xlabel="current $I$", ylabel="potential $V$, of firing its largest", xlim=(75, 230))
    left.legend()
    turn, values = np.linspace(0, 2 * np.pi, 101), np.array(list(fit.values.values()))[:2]
    spread = np.diag(list(fit.deviations.values())[:2])
    axes = np.linalg.cholesky(spread @ fit.correlation[:2, :2] @ spread) @ [np.cos(turn), np.sin(turn)]
    for size, line in ((1, "k-"), (2, "k:")):
        right.plot(*(values[:, None] + size * axes), line, lw=1)
    right.plot(*values, "ko", ms=4, label="fit")
    right.plot(planted["g_Ca"], planted["g_K"], "x", color="tab:red", label="planted")
    right.set(xlabel="$g_{Ca}$", ylabel="$g_K$")
    right.legend()
    return figure


if __name__ == "__main__":
    print(main(*sys.argv[1:2]))
