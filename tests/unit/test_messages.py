"""Messages that name what is wrong: each seen by a user in Python, and where a scene can say it on the command line."""

import casadi as ca
import numpy as np
import pytest
from scenes import written

from casadi_skin import BoundaryValueProblem, OdeModel, find_equilibrium, find_orbit, simulate
from casadi_skin.follow.space import BoundaryError

x, v = ca.SX.sym("x"), ca.SX.sym("v")


def model(name, *rates, **options):
    return OdeModel(name, ca.vertcat(x, v), ca.vertcat(*rates), **options)


def van_der_pol():
    return model("vdp", v, (1 - x**2) * v - x)


def one_line(message):
    assert "\n" not in message
    return message


def refusal(run, file, scene):
    """Standard error of a scene of a model in a file, before which nothing is written."""
    imports = "import casadi as ca\nfrom casadi_skin import *\n"
    message = one_line(run(written(run.folder, imports + file, "own", scene), "--quiet", status=2).err.rstrip("\n"))
    assert not run.out.exists()
    return message


# What is conserved ----------------------------------------------------------------------------------------------------

w = [ca.SX.sym(f"w{k}") for k in range(3)]
q1, q2, p1, p2 = (ca.SX.sym(name) for name in ("q1", "q2", "p1", "p2"))
CONSERVATIVE = {
    "pendulum": (model("pendulum", v, -ca.sin(x)), [1.0, 0.0]),
    "Lotka and Volterra": (model("lotka", x * (1 - v), v * (x - 1)), [1.5, 1.0]),
    "Euler's top": (
        OdeModel("top", ca.vertcat(*w), ca.vertcat(-w[1] * w[2], 2 * w[2] * w[0], -w[0] * w[1])),
        [1, 0.3, 0.2],
    ),
}


@pytest.mark.parametrize("name", CONSERVATIVE)
def test_undeclared_conserved_quantities_are_asked_for(name):
    system, start = CONSERVATIVE[name]
    cycle = simulate(system, start, np.linspace(0.0, 40.0, 2001)).last_cycle()
    with pytest.raises(BoundaryError, match=r"the model seems to conserve something; accepted: .* hamiltonian= or"):
        find_orbit(system, cycle)


def test_what_is_conserved_beside_the_energy_is_asked_for():
    """Two equal uncoupled oscillators with a hamiltonian, whose difference of energies is conserved as well."""
    state, rates = ca.vertcat(q1, q2, p1, p2), ca.vertcat(p1, p2, -q1 - q1**3, -q2 - q2**3)
    energy = (p1**2 + p2**2 + q1**2 + q2**2) / 2 + (q1**4 + q2**4) / 4
    system = OdeModel("two", state, rates, hamiltonian=energy)
    cycle = simulate(system, [0.5, 0.5, 0.0, 0.0], np.linspace(0.0, 40.0, 2001)).last_cycle()
    with pytest.raises(BoundaryError, match="the model seems to conserve more than is declared"):
        find_orbit(system, cycle, select=q1 - 0.5)


def test_scene_of_a_conservative_model_says_so(run):
    file = (
        "import casadi as ca\nfrom casadi_skin import *\n"
        'x, v = ca.SX.sym("x"), ca.SX.sym("v")\nown = OdeModel("p", ca.vertcat(x, v), ca.vertcat(v, -ca.sin(x)))\n'
    )
    scene = written(run.folder, file, "own", "[orbit]\nstart = [1.0, 0.0]\ntransient = 40.0\n")
    message = run(scene, "--quiet", status=1).err
    assert "the model seems to conserve something; accepted: what is conserved declared, as hamiltonian=" in message


# Periods --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", [2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ["cycle", "function", "arrays"])
def test_part_of_a_period_is_named_with_the_time_after_which_the_motion_comes_back(part, kind):
    system = van_der_pol()
    cycle = simulate(system, [2.0, 0.0], np.linspace(0.0, 60.0, 3001)).last_cycle()
    length = cycle.period / part
    times = np.linspace(0.0, length, 201)
    guess = {"cycle": cycle, "function": lambda t: cycle.evaluate([np.mod(t, cycle.period)])[0],
             "arrays": (times, cycle.evaluate(times))}[kind]  # fmt: skip
    words = rf"the motion comes back after {cycle.period:.2f}\d*, {part} times the given period"
    with pytest.raises(BoundaryError, match=words) as refused:
        find_orbit(system, guess, length)
    if kind == "cycle":  # which leads to a point on the cycle; others may lead to 0, an equilibrium indeed
        assert "this is an equilibrium" not in one_line(str(refused.value))


# Arguments ------------------------------------------------------------------------------------------------------------

PROBLEM = """x, v = ca.SX.sym("x"), ca.SX.sym("v")
pendulum = OdeModel("pendulum", ca.vertcat(x, v), ca.vertcat(v, -ca.sin(x)))
ends = lambda start, end, p: [start[0], end[0] - 1]
own = BoundaryValueProblem(pendulum, ends, {arguments})
"""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("(0.0, 2.0)", "integrals: given (0.0, 2.0), two numbers; accepted: expressions in t, x and"),
        ("(), (0.0, 2.0), interval=(0, 1)", "interval: given twice, (0.0, 2.0) as argument 4 and (0, 1) by name"),
        ("[x], integrals=[x - 1]", "integrals: given twice, [SX(x)] as argument 3 and [SX((x-1))] by name; accepted"),
        ("(), (0, 1), {}, (), 5", "given 5 as positional argument 7; accepted: model, conditions, integrals, interval"),
    ],
)  # fmt: skip
def test_arguments_in_the_wrong_place_are_named(arguments, words, run):
    names = {"ca": ca, "OdeModel": OdeModel, "BoundaryValueProblem": BoundaryValueProblem}
    with pytest.raises(TypeError) as refused:
        exec(PROBLEM.format(arguments=arguments), names)  # as a user's file is run
    assert one_line(str(refused.value)).startswith(words)
    assert words in refusal(run, PROBLEM.format(arguments=arguments), "[solution]\nguess = [0, 1]\n")


# Not finite -----------------------------------------------------------------------------------------------------------


def test_what_is_not_finite_at_the_guess_is_named_with_the_state():
    divided = model("divided", v, -v / x - x)
    problem = BoundaryValueProblem(divided, lambda start, end, p: [start[1], end[0] - 1])
    with pytest.raises(
        BoundaryError, match=r"not finite at the equation of v at t = .*, where x = 0, v = 0 at the guess"
    ):
        problem.solve([0.0, 0.0])
    with pytest.raises(ArithmeticError, match="not finite at the equation of v, where x = 0, v = 0 at the guess"):
        find_equilibrium(divided, [0.0, 0.0])
    rooted = model("rooted", v, -ca.sqrt(x) - v)
    with pytest.raises(BoundaryError, match=r"a derivative is not finite at the equation of v at t = .*, where x = 0"):
        BoundaryValueProblem(rooted, lambda start, end, p: [start[1], end[0]]).solve([0.0, 0.0])


# Functions of the user ------------------------------------------------------------------------------------------------


def broken(t):
    raise KeyError("no such row")


class Table:
    period, evaluate = 6.6, staticmethod(broken)


@pytest.mark.parametrize(
    ("guess", "words"),
    [
        (broken, "guess: the function fails: KeyError: 'no such row'"),
        ({"x": np.cos, "v": broken}, "guess: the function for v fails: KeyError: 'no such row'"),
        (Table(), "fails: KeyError: 'no such row'"),
    ],
)
def test_error_of_a_guess_is_named_and_chained(guess, words):
    problem = BoundaryValueProblem(van_der_pol(), lambda start, end, p: [start[0], end[0] - 1])
    for solve in (problem.solve, lambda found: find_orbit(van_der_pol(), found, 6.6)):
        with pytest.raises(ValueError, match=words) as refused:
            solve(guess)
        assert isinstance(refused.value.__cause__, KeyError)
        one_line(str(refused.value))


def test_error_of_the_guess_of_a_scene_is_named_before_anything_is_written(run):
    file = PROBLEM.format(arguments="()") + 'def guess(t):\n    raise KeyError("no such row")\n'
    assert "KeyError: 'no such row'" in refusal(run, file, '[solution]\nguess = "guess"\n')
