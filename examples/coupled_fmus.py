"""Two chains as FMUs with forces as inputs, joined by a spring in co-simulation, against the coupled chains as one.

Each chain runs with its own solver; at every communication point the spring between the last site of the one and the
first of the other is stretched as the outputs tell, and its force in the middle of the next step, which positions and
velocities predict, is the input of both. The error is that of the coupling: a quarter for half the step.

Needs a C compiler and `pip install 'casadi-skin[fmu]'`. Run: python examples/coupled_fmus.py PICTURE.png
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from fmpy import extract, read_model_description
from fmpy.fmi3 import FMU3Slave
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from casadi_skin import Chain, export_fmu, style

Array = NDArray[np.float64]
SITES, END, SPRING = 6, 30.0, 0.4
LEFT, RIGHT = Chain(SITES, alpha=1.0, gamma=0.25, g=-1.0), Chain(SITES, alpha=1.2, gamma=-0.25, g=1.0)


class Part:
    """A running FMU whose variables are set and read by name."""

    def __init__(self, path: Path, folder: Path) -> None:
        description = read_model_description(str(path))
        self._references = {v.name: v.valueReference for v in description.modelVariables}
        self._fmu = FMU3Slave(
            guid=description.instantiationToken,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=extract(str(path), str(folder)),
        )
        self._fmu.instantiate()
        self._fmu.enterInitializationMode(tolerance=1e-11)
        self._fmu.exitInitializationMode()

    def read(self, *names: str) -> Array:
        return np.array(self._fmu.getFloat64([self._references[name] for name in names]))

    def step(self, time: float, size: float, name: str, force: float) -> None:
        self._fmu.setFloat64([self._references[name]], [force])
        self._fmu.doStep(currentCommunicationPoint=time, communicationStepSize=size)

    def close(self) -> None:
        self._fmu.terminate()
        self._fmu.freeInstance()


def cosimulated(paths: tuple[Path, Path], folder: Path, steps: int) -> Array:
    """Displacements of all sites at the communication points, shape (steps + 1, 2 SITES)."""
    left, right = (Part(path, folder / f"{path.stem}{steps}") for path in paths)
    size, found = END / steps, []
    names = [f"y_{n}" for n in range(1, SITES + 1)]
    for k in range(steps + 1):
        found.append(np.concatenate([left.read(*names), right.read(*names)]))
        if k < steps:
            (y, v), (z, w) = left.read(f"y_{SITES}", f"v_{SITES}"), right.read("y_1", "v_1")
            force = SPRING * (z - y + 0.5 * size * (w - v))
            left.step(k * size, size, f"f_{SITES}", force)
            right.step(k * size, size, "f_1", -force)
    left.close()
    right.close()
    return np.array(found)


def as_one(start: Array, steps: int) -> Array:
    """The coupled chains as one system of equations, by Dormand and Prince's method of order 8."""
    count = 2 * SITES
    matrix, cubic = np.zeros((count, count)), np.zeros(count)
    for chain, first in ((LEFT, 0), (RIGHT, SITES)):
        rows = slice(first, first + SITES)
        below, above = np.eye(SITES, k=-1), np.eye(SITES, k=1)
        own = (1 + chain.gamma) * below + (1 - chain.gamma) * above - (2 + chain.alpha) * np.eye(SITES)
        matrix[rows, rows], cubic[rows] = own, chain.g
    ends = [SITES - 1, SITES]
    matrix[np.ix_(ends, ends)] += SPRING * np.array([[-1.0, 1.0], [1.0, -1.0]])

    def field(_: float, x: Array) -> Array:
        return np.concatenate([x[count:], matrix @ x[:count] - cubic * x[:count] ** 3])

    t = np.linspace(0.0, END, steps + 1)
    full = np.concatenate([start, np.zeros(count)])
    return solve_ivp(field, (0.0, END), full, "DOP853", t, rtol=1e-12, atol=1e-14).y[:count].T


@style()
def main(picture: Path | str | None = None, counts: tuple[int, ...] = (300, 600, 1200, 2400)) -> dict[int, float]:
    """Largest difference from the coupled chains integrated as one, by the number of communication steps."""
    errors = {}
    with TemporaryDirectory() as name:
        folder = Path(name)
        left = export_fmu(LEFT, folder / "left.fmu", mode=1, S=0.3, inputs=[f"f_{SITES}"])
        right = export_fmu(RIGHT, folder / "right.fmu", start=np.zeros(SITES), inputs=["f_1"])
        for steps in counts:
            found = cosimulated((left, right), folder, steps)
            truth = as_one(found[0], steps)
            errors[steps] = float(np.abs(found - truth).max())
    if picture is not None:
        draw(np.linspace(0.0, END, steps + 1), found, truth, errors).savefig(picture, dpi=130)
    return errors


def draw(t: Array, found: Array, truth: Array, errors: dict[int, float]) -> Figure:
    """The ends that the spring joins, and the error against the step."""
    figure = Figure(figsize=(7.2, 3.1), layout="constrained")
    motion, error = figure.subplots(1, 2, width_ratios=(2, 1))
    for site, look in ((SITES - 1, "-"), (SITES, "--")):
        motion.plot(t, found[:, site], "k" + look, lw=1, label=f"co-simulation, site {site + 1} of {2 * SITES}")
        motion.plot(t[:: len(t) // 60], truth[:: len(t) // 60, site], "o", color="tab:red", ms=3, mfc="none")
    motion.set(xlabel="time", ylabel="displacement (circles: as one)", ylim=(-0.22, 0.31))
    motion.legend(fontsize="small", loc="upper right")
    sizes = END / np.array(list(errors))
    error.loglog(sizes, list(errors.values()), "ok-", ms=4, lw=1)
    error.loglog(sizes, list(errors.values())[-1] * (sizes / sizes[-1]) ** 2, ":", color="0.5", label="order 2")
    error.set(xlabel="communication step", ylabel="largest difference")
    error.set_xticks(sizes, [f"{size:g}" for size in sizes])
    error.minorticks_off()
    error.legend(fontsize="small")
    return figure


if __name__ == "__main__":
    for count, value in main(*sys.argv[1:2]).items():
        print(f"{count} communication steps: largest difference from the coupled chains as one {value:.2e}")
