"""A Roessler attractor's first cycle inside an FMU for Co-Simulation: its orbit is found where it no longer attracts.

Needs a C compiler and `pip install 'casadi-skin[fmu]'`. Run: python examples/co_simulation.py PICTURE.png
"""

import itertools
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as ca
import numpy as np

from casadi_skin import MapOrbit, OdeModel, export_fmu, import_co_simulation, style


def black_box(folder: Path) -> Path:
    """x' = -y - z, y' = x + y/5, z' = 1/5 + z (x - c) in a program with a solver inside."""
    x, y, z, c = (ca.SX.sym(name) for name in "xyzc")
    rates = ca.vertcat(-y - z, x + 0.2 * y, 0.2 + z * (x - c))
    model = OdeModel("roessler", ca.vertcat(x, y, z), rates, c, nominal=(2.4,))
    return export_fmu(model, folder / "roessler.fmu", start=[0.0, -4.0, 0.1], tolerance=1e-5)


@style()
def main(picture: Path | None = None) -> list[MapOrbit]:
    with TemporaryDirectory() as folder:
        model = import_co_simulation(black_box(Path(folder)), parameters=["c"], step=0.1)
    orbit, orbits = model.find_orbit(section=lambda state: state[0], transient=150.0), []
    for c in np.linspace(2.4, 4.0, 17):
        orbit = model.find_orbit(orbit, section=lambda state: state[0], parameters={"c": c})
        orbits.append(orbit)
    print(orbits[0])
    before, after = next((a, b) for a, b in itertools.pairwise(orbits) if a.stable and not b.stable)
    print(f"its period doubles between c = {before.parameters['c']:.2f} and {after.parameters['c']:.2f}")
    if picture is not None:
        draw(orbits, picture)
    return orbits


def draw(orbits: list[MapOrbit], path: Path) -> None:
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(7.2, 3.2), layout="constrained")
    for orbit, look in ((orbits[0], "-"), (orbits[-1], "--")):
        words = "stable" if orbit.stable else "unstable"
        left.plot(
            orbit.states[:, 0], orbit.states[:, 1], look, color="k", label=f"c = {orbit.parameters['c']:g}, {words}"
        )
    left.set(xlabel="x", ylabel="y", ylim=(-9.0, 9.0))
    left.legend(frameon=False, loc="upper left")
    c, multipliers = [orbit.parameters["c"] for orbit in orbits], [orbit.multipliers[0].real for orbit in orbits]
    right.errorbar(c, multipliers, [orbit.multiplier_errors[0] for orbit in orbits], fmt=".-k")
    right.axhline(-1.0, color="0.7", lw=0.8, zorder=0)
    right.set(xlabel="c", ylabel="largest multiplier")
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
