"""A breather in C: the chain kicked at its far end, integrated by a C program of one's own, beside Python.

Run: python examples/export_c.py PICTURE.png
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, build_c, export_c, follow_family, simulate_orbit, style

SITES, KICK, PERIODS = 24, 0.01, 6
PROGRAM = r"""
#include <stdio.h>
#include "chain.h"

int main(void) /* the classical Runge-Kutta method, 2000 steps a period, 100 lines of output a period */
{
    static double x[CHAIN_STATES], y[CHAIN_STATES], sum[CHAIN_STATES], f[CHAIN_STATES], work[CHAIN_RHS_WORK];
    const double h = chain_orbit_period / 2000, next[4] = {0.5, 0.5, 1.0, 0.0}, weight[4] = {1, 2, 2, 1};
    int step, stage, i;

    chain_orbit(0.0, x, x + CHAIN_SITES);
    x[0] += 0.01;
    for (step = 0; step <= 12000; step++) {
        if (step % 20 == 0) printf("%.17g %.17g\n", step * h, x[CHAIN_SITES - 1]);
        for (i = 0; i < CHAIN_STATES; i++) sum[i] = 0.0, y[i] = x[i];
        for (stage = 0; stage < 4; stage++) {
            chain_rhs(0.0, y, chain_nominal, f, work);
            for (i = 0; i < CHAIN_STATES; i++) sum[i] += weight[stage] * f[i], y[i] = x[i] + next[stage] * h * f[i];
        }
        for (i = 0; i < CHAIN_STATES; i++) x[i] += h / 6 * sum[i];
    }
    return 0;
}
"""


@style()
def main(picture: Path | str | None = None) -> tuple[dict[str, float], np.ndarray, np.ndarray]:
    """What the export's own program prints; times and the edge's displacement from C; the same from Python."""
    chain = Chain(SITES, alpha=1.0, gamma=0.25, g=-1.0)
    orbit = follow_family(chain, mode=1, amplitude_max=1.0, at=(1.0,), tolerance=1e-12).at(S=1.0)
    with tempfile.TemporaryDirectory() as folder:
        directory = export_c(orbit, Path(folder) / "breather")
        printed = subprocess.run([build_c(directory)], capture_output=True, text=True, check=True).stdout
        (directory / "main.c").write_text(PROGRAM)
        in_c = np.loadtxt(subprocess.run([build_c(directory)], capture_output=True, check=True).stdout.split(b"\n"))
    in_python = simulate_orbit(orbit, in_c[:, 0], KICK, site=1, tolerance=1e-12).displacements[:, -1]
    if picture is not None:
        draw(in_c[:, 0] / orbit.period, in_c[:, 1], in_python).savefig(picture, dpi=130)
    return {name: float(value) for name, value in map(str.split, printed.splitlines())}, in_c, in_python


def draw(periods: np.ndarray, in_c: np.ndarray, in_python: np.ndarray) -> Figure:
    """The displacement of the edge site above, the difference of the two programs below."""
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    motion, difference = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    motion.plot(periods, in_c, "k-", lw=1, label="C, Runge-Kutta of order 4")
    motion.plot(periods[::10], in_python[::10], "o", color="tab:red", ms=3.5, mfc="none", label="Python, CVODES")
    motion.set(ylabel=f"$y_{{{SITES}}}$", ylim=(-0.52, 0.7))
    motion.legend(fontsize="small", loc="upper center", ncols=2)
    difference.semilogy(periods, np.abs(in_c - in_python), "-", color="0.3", lw=0.8)
    difference.set(xlabel="time in periods of the breather", ylabel="difference", xlim=(0, PERIODS))
    return figure


if __name__ == "__main__":
    numbers, _, _ = main(*sys.argv[1:2])
    print("\n".join(f"{name}: {value:.15g}" for name, value in numbers.items()))
