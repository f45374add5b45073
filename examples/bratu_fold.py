"""Bratu's problem u'' + lambda exp(u) = 0, u(0) = u(1) = 0: two solutions below a fold, none above it.

Run: python examples/bratu_fold.py PICTURE.png
"""

import sys
from pathlib import Path

import casadi as ca
from matplotlib.figure import Figure

from casadi_skin import BoundaryValueProblem, OdeModel, style

u, v, lam = (ca.SX.sym(name) for name in ("u", "v", "lambda"))
bratu = OdeModel("Bratu", ca.vertcat(u, v), ca.vertcat(v, -lam * ca.exp(u)), lam)
problem = BoundaryValueProblem(bratu, [bratu.start(u), bratu.end(u)], parameters={"lambda": 0.2})


@style()
def main(picture: Path | str | None = None):
    """The branch through the fold, with both solutions at lambda = 1."""
    branch = problem.solve([0.0, 0.0]).follow("lambda", 4.0, at=[1.0])
    if picture is not None:
        draw(branch).savefig(picture, dpi=150)
    return branch


def draw(branch) -> Figure:
    """The largest u against lambda, and both solutions at lambda = 1."""
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot(branch.values, [s["u"].max() for s in branch.solutions], "k-", marker=".", ms=4)
    fold = branch.folds[0]
    left.plot(fold["lambda"], fold["u"].max(), "o", color="tab:red", mfc="none", ms=9, label="fold")
    left.set(xlabel=r"$\lambda$", ylabel=r"largest $u$", ylim=(0, None))
    left.legend(loc="center right")
    for which, look in enumerate(("k-", "k--")):
        solution = branch.at(1.0, which)
        right.plot(solution.t, solution["u"], look, label=("lower", "upper")[which])
    right.set(xlabel="x", ylabel=r"$u$ at $\lambda = 1$")
    right.legend(loc="center")
    return figure


if __name__ == "__main__":
    for fold in main(*sys.argv[1:2]).folds:
        print(f"fold at lambda = {fold['lambda']:.10f}")
