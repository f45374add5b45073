"""Colpitts' oscillator as a circuit: node voltages and currents, with equations that have no derivatives.

Run: python examples/colpitts.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import OdeModel, find_equilibrium, simulate, style

# Units: C1 = C2 = L = 1 and the thermal voltage; the current that biases the transistor is varied.
supply, top, collector, emitter, coil, battery, bias, R = (
    ca.SX.sym(name) for name in ("supply", "top", "collector", "emitter", "coil", "battery", "bias", "R")
)
transistor = 1e-3 * ca.exp(-emitter)  # collector current, the base is at 0
circuit = OdeModel(
    "Colpitts",
    [supply, top, collector, emitter, coil, battery],
    [
        battery + (supply - top) / R,  # currents at the battery
        (supply - top) / R - coil,  # between resistor and coil
        coil - transistor,  # at the collector: C1 (collector - emitter)' = ...
        transistor - bias,  # at the emitter: C2 emitter' + C1 (emitter - collector)' = ...
        top - collector,  # along the coil: L coil' = ...
        supply - 5.0,  # the battery's voltage
    ],
    [bias, R],
    mass=[
        [0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0],
        [0, 0, 1, -1, 0, 0],
        [0, 0, -1, 2, 0, 0],
        [0, 0, 0, 0, 1, 0],
        [0, 0, 0, 0, 0, 0],
    ],
    nominal=(1.5, 2**0.5 / 1.4),
)


@style()
def main(picture: Path | str | None = None):
    """Rest, cycles, the cycles that double twice, and the motion after that."""
    rest = find_equilibrium(circuit, {"supply": 5.0, "top": 3.5, "collector": -4.0, "emitter": -7.3, "coil": 1.5})
    branches = [rest.follow("bias", 6.0)]
    for kind in ("hopf", "period doubling", "period doubling"):
        point = next(p for p in branches[-1].special_points if p.kind == kind)
        branches.append(point.follow("bias", 6.0, stability=True))
    chaos = simulate(circuit, {"collector": 5.0, "emitter": -7.0}, np.linspace(0, 400, 20001), parameters={"bias": 5.5})
    if picture is not None:
        draw(branches, chaos).savefig(picture, dpi=120)
    return branches, chaos


def draw(branches, chaos) -> Figure:
    """The largest emitter voltage against the bias current, and the motion at one value."""
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for branch in branches:
        branch.plot(left, y="emitter")
    right.plot(*chaos.states[14000:, 2:4].T, lw=0.4)
    right.set(xlabel="collector", ylabel="emitter", title="motion at bias = 5.5")
    return figure


if __name__ == "__main__":
    found, _ = main(*sys.argv[1:2])
    for branch in found:
        print(*branch.special_points, sep="\n")
