"""AUTO-07p's demos here: their special points beside those of AUTO, each with its error and the time that it took.

AUTO's numbers are what it prints when the scripts in its folder `demos` are run (commit 44cc1c4, its own constants),
to the six digits that it shows.

Run: python examples/auto_demos.py, which prints a table, or with names of demos after it.
"""

import sys
import time
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin import BoundaryValueProblem, OdeModel, find_equilibrium, find_orbit, simulate


@dataclass(frozen=True)
class Row:
    """One number of a demo: what it is, AUTO's value, the value here with its estimated error."""

    what: str
    auto: float
    value: float
    error: float


def model(name, states, rates, **parameters):
    """A model from functions of its symbols, with the usual values of its parameters."""
    x, p = [ca.SX.sym(s) for s in states.split()], [ca.SX.sym(k) for k in parameters]
    rhs = ca.vertcat(*rates(*x, *p))
    return OdeModel(name, ca.vertcat(*x), rhs, ca.vertcat(*p), nominal=tuple(parameters.values()))


def beside(points, *known):
    """Rows of the special points of the kinds and near the values that AUTO found."""
    for kind, auto in known:
        near = min((p for p in points if p.kind == kind), key=lambda p: abs(p.parameters[p.parameter] - auto))
        yield Row(f"{kind}, {near.parameter}", auto, near.parameters[near.parameter], near.error)


# Equilibria and cycles ------------------------------------------------------------------------------------------------


def ab():
    """A to B: its last family, with p2 = 18, p3 = 3; the folds are at x = 1/3 and 2/3."""

    def rates(x, y, p1, p2, p3):
        return -x + p1 * (1 - x) * ca.exp(y), -y + p1 * p2 * (1 - x) * ca.exp(y) - p3 * y

    branch = find_equilibrium(model("ab", "x y", rates, p1=0.0, p2=18.0, p3=3.0), [0, 0]).follow("p1", 0.3)
    return beside(
        branch.special_points, ("hopf", 0.111153), ("fold", 0.111565), ("fold", 0.0995741), ("hopf", 0.183833)
    )


def abc():
    """A to B to C, and the cycles born at its second Hopf point, with their fold."""

    def rates(x, y, z, d, s):
        e = ca.exp(z)
        return -x + d * (1 - x) * e, -y + d * e * (1 - x - s * y), -2.55 * z + 8 * d * e * (1 - x + s * y)

    start = find_equilibrium(model("abc", "x y z", rates, d=0.1, s=0.04), [0, 0, 0])
    points = start.follow("d", 0.4).special_points
    yield from beside(points, ("hopf", 0.204185), ("hopf", 0.229836), ("hopf", 0.259957), ("hopf", 0.346208))
    second = [p for p in points if p.kind == "hopf"][1]
    yield from beside(second.follow("d", 0.27).special_points, ("fold", 0.224962))


def cusp():
    """mu + lambda x - x^3, its fold in mu and the cusp on the curve of folds."""

    def rates(x, mu, lam):
        return (mu + lam * x - x**3,)

    branch = find_equilibrium(model("cusp", "x", rates, mu=0.0, lam=1.0), [0.0]).follow("mu", 2.0)
    (fold,) = branch.special_points
    yield from beside([fold], ("fold", 0.3849))
    (tip,) = fold.curve("lam", -1.0).special_points
    yield Row("cusp, lam", 3.02839e-08, tip.parameters["lam"], tip.error)


def lrz():
    """Lorenz: the pitchfork and the Hopf points."""

    def rates(x, y, z, rho):
        return 10 * (y - x), rho * x - y - x * z, x * y - 8 * z / 3

    points = find_equilibrium(model("lrz", "x y z", rates, rho=0.5), [0, 0, 0]).follow("rho", 2.0).special_points
    yield from beside(points, ("branch point", 1.0))
    yield from beside(points[0].follow("rho", 30.0).special_points, ("hopf", 24.7368))


def pp2():
    """Fish and sharks, with fishing."""

    def rates(fish, sharks, quota):
        return 3 * fish * (1 - fish) - fish * sharks - quota * (1 - ca.exp(-5 * fish)), -sharks + 3 * fish * sharks

    zero = find_equilibrium(model("pp2", "fish sharks", rates, quota=0.0), [0, 0]).follow("quota", 0.7)
    yield from beside(zero.special_points, ("branch point", 0.6))
    fish = zero.special_points[0].follow("quota", 0.9).special_points
    yield from beside(fish, ("branch point", 0.821904), ("fold", 0.832929))
    crossing = next(p for p in fish if p.kind == "branch point")
    yield from beside(crossing.follow("quota", 0.5).special_points, ("hopf", 0.671594))


def pp3():
    """Three species."""

    def rates(x, y, z, p):
        eaten = -0.25 * y + 4 * x * y - 3 * y * z - p * (1 - ca.exp(-5 * y))
        return x * (1 - x) - 4 * x * y, eaten, -0.5 * z + 3 * y * z

    first = find_equilibrium(model("pp3", "x y z", rates, p=0.0), [1, 0, 0]).follow("p", 1.0)
    yield from beside(first.special_points, ("branch point", 0.75))
    second = first.special_points[0].follow("p", 0.05, side=1).special_points
    yield from beside(second, ("hopf", 0.4596), ("branch point", 0.31934), ("hopf", 0.106415))
    third = next(p for p in second if p.kind == "branch point").follow("p", 0.05).special_points
    yield from beside(third, ("hopf", 0.229357))


def enz():
    """Two compartments of an enzyme: folds, and where the compartments part."""

    def rates(s1, s2, s0):
        def rate(s):
            return 100 * s / (1 + s + s**2)

        return s0 - s1 + s2 - s1 - rate(s1), s0 - s2 + s1 - s2 - rate(s2)

    branch = find_equilibrium(model("enz", "s1 s2", rates, s0=0.0), [0, 0]).follow("s0", 40.0)
    known = ("fold", 34.3569), ("branch point", 34.2229), ("branch point", 22.1816), ("fold", 18.8871)
    return beside(branch.special_points, *known)


def chu():
    """Chua's circuit: a Hopf point, and the period doubling of the cycles born there."""

    def rates(x, y, z, alpha):
        def smooth(u):
            return 2 * u * ca.atan(10 * u) / np.pi

        h = 2 / 7 * x + 0.5 * (-1 / 7 - 2 / 7) * (smooth(x + 1) - smooth(x - 1))
        return alpha * (y - h), x - y + z, -14.3 * y

    start = find_equilibrium(model("chu", "x y z", rates, alpha=5.0), [1.5, 0, -1.5])
    (hopf,) = start.follow("alpha", 8.0).special_points
    yield from beside([hopf], ("hopf", 6.80443))
    yield from beside(hopf.follow("alpha", 8.3, stability=True).special_points, ("period doubling", 8.196))


def plp():
    """Plasma and prey: Hopf points, and the folds of the cycles born at them."""

    def rates(s, a, rho):
        r = s * a / (1 + s + 0.1 * s**2)
        return 110 - s - rho * r, 0.2 * (500 - a) - rho * r

    start = find_equilibrium(model("plp", "s a", rates, rho=2.021628), [45.55974, 177.7987])
    points = start.follow("rho", 6.0).special_points
    yield from beside(points, ("hopf", 3.49995), ("hopf", 4.65046))
    first, second = (p for p in points if p.kind == "hopf")
    yield from beside(first.follow("rho", 2.0).special_points, ("fold", 2.75969))
    yield from beside(second.follow("rho", 5.5).special_points, ("fold", 5.00784))


# Orbits ---------------------------------------------------------------------------------------------------------------


def lor():
    """Lorenz at large r: two period doublings, the second on the doubled branch."""

    def rates(x, y, z, r):
        return 10 * (y - x), r * x - y - x * z, x * y - 8 * z / 3

    lorenz = model("lor", "x y z", rates, r=235.0)
    cycle = simulate(lorenz, [10, 10, 235], np.linspace(0.0, 40.0, 40001)).last_cycle()
    (first,) = find_orbit(lorenz, cycle).follow("r", 226.0, stability=True).special_points
    yield from beside([first], ("period doubling", 229.407))
    yield Row("its period", 0.480867, first.solution.period, first.solution.period_error)
    (second,) = first.follow("r", 217.0, stability=True).special_points
    yield from beside([second], ("period doubling", 218.21))


def tor():
    """An electronic circuit: Hopf point, fold of cycles and loss of symmetry, then a torus and a period doubling."""

    def rates(x, y, z, nu):
        cubic = 0.933578 * (y - x) ** 3
        return (-(0.5 + nu) * x + 0.5 * y - 0.328578 * x**3 + cubic) / 0.6, 0.5 * x + 0.1 * y - z - cubic, y

    points = find_equilibrium(model("tor", "x y z", rates, nu=-0.9), [0, 0, 0]).follow("nu", -0.55).special_points
    yield from beside(points, ("hopf", -0.589337))
    cycles = points[0].follow("nu", -0.6, stability=True).special_points
    yield from beside(cycles, ("fold", -0.584335), ("branch point", -0.587029))
    parts = next(p for p in cycles if p.kind == "branch point").follow("nu", -0.63, stability=True)
    yield from beside(parts.special_points, ("torus", -0.59165), ("period doubling", -0.614955))


def pen():
    """Two coupled pendula that turn together, until they part at a period doubling."""

    def rates(a, b, u, v, current):
        pull = 0.175 * (b - a)
        return u, v, -0.1 * u - ca.sin(a) + current + pull, -0.1 * v - ca.sin(b) + current - pull

    together = find_orbit(
        model("pen", "a b u v", rates, current=0.4), lambda t: [4 * t, 4 * t, 4, 4], 1.574,
        rotations={"a": 1, "b": 1},
    )  # fmt: skip
    return beside(together.follow("current", 0.15, stability=True).special_points, ("period doubling", 0.179163))


def frc():
    """FitzHugh and Nagumo's equations, forced by an oscillator: the response, and that to slower forcing."""

    def rates(v, w, x, y, r, beta):
        cubic, square = v * (v - 0.5) * (1 - v), x**2 + y**2
        return (cubic - w) / 0.005, v - w - 0.5 - r * x, x + beta * y - x * square, -beta * x + y - y * square

    def largest(orbit, what, state, auto):
        values = orbit.evaluate(np.linspace(0.0, orbit.period, 4001))[:, state]
        return Row(f"largest {what}", auto, values.max(), orbit.error * np.abs(values).max() + 1e-6 * np.ptp(values))

    rest = find_orbit(
        model("frc", "v w x y", rates, r=0.0, beta=100.0), lambda t: [0.5, 0, np.sin(100 * t), np.cos(100 * t)],
        np.pi / 50,
    )  # fmt: skip
    forced = rest.follow("r", 0.2).orbits[-1]
    yield largest(forced, "v, r = 0.2", 0, 0.503634)
    yield largest(forced, "w, r = 0.2", 1, 2.03251e-3)
    yield largest(forced.follow("beta", 24.6098).orbits[-1], "v, beta = 24.6098", 0, 0.531119)


def pla():
    """Plant's nerve cell: equilibria, and one of the long cycles born at the second Hopf point."""

    def rates(V, xT, xK, yI, c, gI):
        s = 127 / 105 * V - (12 * 30 - 115 * 75) / 105
        am, ah, an = (50 - s) / 10 / (ca.exp((50 - s) / 10) - 1), 0.07 * ca.exp((25 - s) / 20), (55 - s) / 100
        bm, bh, bn = 4 * ca.exp((25 - s) / 18), 1 / (ca.exp((55 - s) / 10) + 1), 0.125 * ca.exp((45 - s) / 80)
        an = an / (ca.exp((55 - s) / 10) - 1)
        inwards = (gI * (am / (am + bm)) ** 3 * yI + 0.01 * xT) * (30 - V)
        outwards = (0.3 * xK**4 + 0.03 * c / (0.5 + c)) * (-75 - V) + 0.003 * (-40 - V)
        slow = (1 / (ca.exp(0.15 * (-50 - V)) + 1) - xT) / 235, 3e-4 * (0.0085 * xT * (140 - V) - c)
        gates = (an - (an + bn) * xK) / 12.5, (ah - (ah + bh) * yI) / 12.5
        return inwards + outwards, slow[0], *gates, slow[1]

    guess = [-2.329601, 0.9992162, 0.7373314, 0.006135948, 1.208853]
    points = find_equilibrium(model("pla", "V xT xK yI c", rates, gI=50.0), guess).follow("gI", -120.0).special_points
    yield from beside(points, ("hopf", 15.2265), ("fold", 2.58654), ("fold", 47.4501), ("hopf", -103.779))
    cycle = points[-1].follow("gI", 1.25).orbits[-1]
    yield Row("period, gI = 1.25", 9811.78, cycle.period, cycle.period_error)


# Boundary-value problems ----------------------------------------------------------------------------------------------


def second_order(name, force, conditions, integrals=(), start=0.0):
    """u'' = force(u, x, p) on [0, 1]."""
    u, v, p, x = (ca.SX.sym(s) for s in ("u", "v", "p", "x"))
    timed = ca.depends_on(ca.SX(force(u, x, p)), x)
    extra = {"time": x, "forcing_period": 1.0} if timed else {}
    stated = OdeModel(name, ca.vertcat(u, v), ca.vertcat(v, force(u, x, p)), p, **extra)
    return BoundaryValueProblem(stated, conditions(stated, u, v), [e(u) for e in integrals], parameters={"p": start})


def held(stated, u, v):
    """Zero at both ends."""
    return [stated.start(u), stated.end(u)]


def bvp():
    """u'' = -(p pi)^2 u + u^2, whose branch of zeros others leave at whole numbers."""
    problem = second_order("bvp", lambda u, x, p: -((p * np.pi) ** 2) * u + u**2, held, start=0.5)
    zero = problem.solve([0, 0]).follow("p", 5.5)
    return beside(zero.special_points, *(("branch point", float(k)) for k in range(1, 6)))


def lin():
    """The same without u^2: a linear eigenvalue problem."""
    zero = second_order("lin", lambda u, x, p: -((p * np.pi) ** 2) * u, held, start=0.5).solve([0, 0]).follow("p", 4.5)
    return beside(zero.special_points, *(("branch point", a) for a in (1.0, 2.0, 3.00002, 4.00023)))


def exp():
    """Bratu's problem."""
    branch = second_order("exp", lambda u, x, p: -p * ca.exp(u), held).solve([0, 0]).follow("p", 4.0, max_points=30)
    return beside(branch.special_points, ("fold", 3.51383))


def integral():
    """Bratu's equation with u(0) = u(1) and a mean that vanishes."""
    problem = second_order(
        "int", lambda u, x, p: -p * ca.exp(u), lambda m, u, v: [m.start(u) - m.end(u)], [lambda u: u]
    )
    branch = problem.solve([0, 0]).follow("p", 15.0, max_points=40)
    return beside(branch.special_points, ("fold", 11.9238))


def non():
    """u'' = -p exp(x^3 u), which depends on x."""
    branch = (
        second_order("non", lambda u, x, p: -p * ca.exp(x**3 * u), held).solve([0, 0]).follow("p", 20.0, max_points=30)
    )
    return beside(branch.special_points, ("fold", 14.0745))


def nag():
    """Nagumo's front between the saddles 0 and 1, along their eigenvectors at both ends: its speed c."""
    u, v, a, c = (ca.SX.sym(s) for s in "uvac")
    front = OdeModel("nag", ca.vertcat(u, v), 100 * ca.vertcat(v, c * v - u * (1 - u) * (u - a)), ca.vertcat(a, c))
    leaves, comes = c / 2 + ca.sqrt(c**2 / 4 + a), c / 2 - ca.sqrt(c**2 / 4 + 1 - a)
    ends = [front.start(v) - leaves * front.start(u), front.end(v) - comes * (front.end(u) - 1)]
    problem = BoundaryValueProblem(front, ends, [u - 0.5], free=["c"], parameters={"a": 0.5, "c": 0.0})

    def guess(t):
        e = 1 / (1 + np.exp(-100 * (t - 0.5) / np.sqrt(2)))
        return [e, e * (1 - e) / np.sqrt(2)]

    start = problem.solve(guess)
    for a, auto in ((0.25, 0.353553), (0.75, -0.353553)):
        last = start.follow("a", a).solutions[-1]
        yield Row(f"c, a = {a}", auto, last.parameters["c"], last.error)


DEMOS = {
    "ab": ab, "abc": abc, "cusp": cusp, "lrz": lrz, "pp2": pp2, "pp3": pp3, "enz": enz, "chu": chu, "plp": plp,
    "lor": lor, "tor": tor, "pen": pen, "bvp": bvp, "lin": lin, "exp": exp, "int": integral, "non": non,
    "frc": frc, "pla": pla, "nag": nag,
}  # fmt: skip


def main(*names):
    """Rows and seconds of demos, all unless named."""
    found = {}
    for name in names or DEMOS:
        start = time.perf_counter()
        rows = list(DEMOS[name]())
        found[name] = rows, time.perf_counter() - start
    return found


if __name__ == "__main__":
    print("| demo | what | AUTO | here | its error | s |\n| --- | --- | --- | --- | --- | --- |")
    for name, (rows, seconds) in main(*sys.argv[1:]).items():
        for k, row in enumerate(rows):
            first = (f"`{name}`", f"{seconds:.1f}") if k == 0 else ("", "")
            print(f"| {first[0]} | {row.what} | {row.auto:g} | {row.value:.12g} | {row.error:.0e} | {first[1]} |")
