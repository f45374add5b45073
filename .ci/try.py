"""An installed wheel must have compiled kernels, find the family of the README and Lorenz's Hopf point."""

import subprocess
import sys

import casadi as ca

from casadi_skin import Chain, OdeModel, find_equilibrium, follow_family


def main() -> None:
    version = subprocess.check_output([sys.executable, "-m", "casadi_skin", "--version"], text=True).strip()
    print(version)
    if "kernels: compiled" not in version:
        raise SystemExit("without compiled kernels")
    branch = follow_family(Chain(sites=24, alpha=1.0, gamma=0.25, g=-1.0), mode=1, amplitude_max=3.0, stability=True)
    changes, frequency = len(branch.changes), branch.at(S=0.2).Omega
    x, y, z, r = (ca.SX.sym(name) for name in "xyzr")
    lorenz = OdeModel("Lorenz", [x, y, z], [10 * (y - x), r * x - y - x * z, x * y - 8 / 3 * z], r)
    rest = find_equilibrium(lorenz, [0, 0, 0], parameters={"r": 0.0}).follow("r", 30.0)
    hopf = rest.special_points[0].follow("r", 30.0, side=-1).special_points[0]
    print(
        f"{changes} changes of stability, Omega = {frequency:.12g} at S = 0.2, Hopf point at r = {hopf.parameters['r']}"
    )
    if changes != 47 or abs(frequency - 1.0363931471) > 1e-9 or abs(hopf.parameters["r"] - 470 / 19) > 1e-9:
        raise SystemExit("expected: 47, 1.0363931471, 470/19")


if __name__ == "__main__":
    main()
