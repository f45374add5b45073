"""A nonuniform chain that meets a target curve: an end breather whose frequency does not depend on its amplitude.

Run: python examples/design_uneven_chain.py PICTURE.png
"""

import sys
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

from casadi_skin import Chain, Design, follow_family, optimise, style

CHAIN = Chain(sites=24, alpha=1.0, gamma=0.25, g=1.0)
AMPLITUDES, TARGET = (0.2, 0.4, 0.6, 0.8, 1.0), 2.2


def off_target(*orbits: Any) -> ca.SX:
    """Omega(S) - target at every S."""
    return ca.vertcat(*(orbit.Omega - TARGET for orbit in orbits))


@style()
def main(picture: Path | str | None = None) -> Design:
    """The smoothest on-site stiffness alpha_n, between 0.7 and 1.3, with Omega(S) on target at five S."""
    branch = follow_family(CHAIN, "last", AMPLITUDES[-1], at=AMPLITUDES)
    result = optimise(
        "a.roughness",
        of=[branch.at(S=S) for S in AMPLITUDES],
        over=["alpha_n"],
        bounds={"alpha_n": (0.7, 1.3)},
        subject_to=[off_target],
    )
    if picture is not None:
        draw(result).savefig(picture, dpi=150)
    return result


def draw(result: Design) -> Figure:
    """Stiffness along the chain, and Omega(S) beside that of the uniform chain."""
    figure = Figure(figsize=(7.2, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(np.arange(1, 25), result["alpha_n"], "ko-", ms=4, lw=0.8)
    left.axhline(1.0, color="0.6", lw=0.8, ls="--")
    left.set(xlabel="site $n$", ylabel=r"stiffness $\alpha_n$", ylim=(0.65, 1.35))
    branch = follow_family(CHAIN, "last", 1.1, at=np.linspace(0.1, 1.1, 21))
    right.plot(branch.S, branch.Omega, "k--", lw=1, label=r"uniform, $\alpha = 1$")
    right.plot(AMPLITUDES, [orbit.Omega for orbit in result.located], "ko", mfc="none", label="found")
    right.axhline(TARGET, color="tab:red", lw=0.8, label="target")
    right.set(xlabel=r"total amplitude $S$", ylabel=r"frequency $\Omega$", xlim=(0.0, 1.1))
    right.legend(loc="center right")
    return figure


if __name__ == "__main__":
    found = main(*sys.argv[1:2])
    print(f"{found.reason}: roughness {found.value:.6f}")
    print(np.array2string(found["alpha_n"], precision=5))
