"""A kicked breather as an FMU of FMI 3.0: simulated by fmpy, by Co-Simulation and by Model Exchange, and beside Python.

Needs a C compiler and `pip install 'casadi-skin[fmu]'`. Run: python examples/chain_as_fmu.py PICTURE.png
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import numpy as np
from fmpy.validation import validate_fmu
from matplotlib.figure import Figure

from casadi_skin import Chain, export_fmu, follow_family, perturbed, simulate_orbit, style

SITES, KICK, PERIODS = 24, 0.01, 6


@style()
def main(picture: Path | str | None = None) -> dict[str, float]:
    """Largest differences of the edge's displacement from Python's, by the FMU's solver and by fmpy's."""
    chain = Chain(SITES, alpha=1.0, gamma=0.25, g=-1.0)
    orbit = follow_family(chain, mode=1, amplitude_max=1.0, at=(1.0,), tolerance=1e-12).at(S=1.0)
    start = np.concatenate(perturbed(orbit, KICK, site=1))
    with TemporaryDirectory() as folder:
        path = export_fmu(orbit, Path(folder) / "breather.fmu", start=start, stop_time=PERIODS * orbit.period)
        print(f"faults that fmpy finds: {validate_fmu(str(path))}")
        results = {
            kind: fmpy.simulate_fmu(
                str(path), fmi_type=kind, output_interval=orbit.period / 100, relative_tolerance=1e-10
            )
            for kind in ("CoSimulation", "ModelExchange")
        }
    edge = f"y_{SITES}"
    time = results["CoSimulation"]["time"]
    known = simulate_orbit(orbit, time, KICK, site=1, tolerance=1e-12).displacements[:, -1]
    differences = {kind: np.abs(result[edge] - known) for kind, result in results.items()}
    if picture is not None:
        draw(time / orbit.period, results["CoSimulation"], known, differences).savefig(picture, dpi=130)
    return {kind: float(difference.max()) for kind, difference in differences.items()}


def draw(periods: np.ndarray, result: np.ndarray, known: np.ndarray, differences: dict[str, np.ndarray]) -> Figure:
    """The displacement of the edge site above, differences from Python below."""
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    motion, difference = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    motion.plot(periods, result[f"y_{SITES}"], "k-", lw=1, label="FMU, Co-Simulation")
    motion.plot(periods[::10], known[::10], "o", color="tab:red", ms=3.5, mfc="none", label="Python, CVODES")
    motion.set(ylabel=f"$y_{{{SITES}}}$", ylim=(-0.52, 0.7))
    motion.legend(fontsize="small", loc="upper center", ncols=2)
    for (kind, values), look in zip(differences.items(), ("-", "--"), strict=True):
        difference.semilogy(periods[1:], values[1:], look, color="0.2", lw=0.8, label=kind)
    difference.set(xlabel="time in periods of the breather", ylabel="difference", xlim=(0, PERIODS))
    difference.legend(fontsize="small", loc="lower right", ncols=2)
    return figure


if __name__ == "__main__":
    for name, value in main(*sys.argv[1:2]).items():
        print(f"{name}: within {value:.1e} of Python")
