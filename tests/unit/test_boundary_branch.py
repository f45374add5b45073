"""Continuation of boundary-value problems: folds, values asked for, ends, and what is told on the way."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from small_models import bratu, van_der_pol

from casadi_skin import BoundaryValueProblem, Branch, Orbit, find_orbit
from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.follow import BranchRun, following_space
from casadi_skin.follow.solution import Solution
from casadi_skin.model.ode import OdeModel
from casadi_skin.results.branch_records import BranchRecord, known_of, point_record, stability_record
from casadi_skin.zero.settings import End, Point


def buckling() -> BoundaryValueProblem:
    """Euler's rod with a small imperfection: phi'' + P sin(phi) = 0, phi'(0) = d, phi'(1) = 0."""
    phi, m, P, d = (ca.SX.sym(name) for name in ("phi", "m", "P", "d"))
    model = OdeModel("rod", ca.vertcat(phi, m), ca.vertcat(m, -P * ca.sin(phi)), ca.vertcat(P, d), nominal=(1.0, 0.0))
    return BoundaryValueProblem(model, [model.start(m) - d, model.end(phi)], parameters={"d": -0.1})


@pytest.fixture(scope="module")
def cubic() -> Solution:
    """x' = 0 with (x^3 - 3 x - a)(start) = 0: an S with folds at a = 2 and a = -2."""
    x, a = ca.SX.sym("x"), ca.SX.sym("a")
    model = OdeModel("cubic", x, ca.SX(0.0), a)
    s = model.start(x)
    return BoundaryValueProblem(model, [s**3 - 3 * s - a], parameters={"a": -4.0}).solve([-2.2], tolerance=1e-10)


@pytest.fixture(scope="module")
def branch(cubic: Solution) -> Branch:
    """All of the S."""
    return cubic.follow("a", 4.0, at=[0.0, 1.0])


def test_an_s_is_followed_round_both_folds(branch: Branch) -> None:
    assert branch.complete
    assert branch.reason == "reached the end asked for"
    np.testing.assert_allclose([f.parameters["a"] for f in branch.folds], [2.0, -2.0], atol=1e-9)
    np.testing.assert_allclose([f.states[0, 0] for f in branch.folds], [-1.0, 1.0], atol=1e-4)
    three = [branch.at(0.0, which).states[0, 0] for which in range(3)]
    np.testing.assert_allclose(three, [-np.sqrt(3), 0.0, np.sqrt(3)], atol=1e-9)
    assert [branch.at(1.0, k).parameters["a"] for k in range(3)] == [1.0] * 3
    assert branch.missed == ()
    assert len(branch) == len(branch.values) == len(branch.solutions)
    assert branch.values[-1] == pytest.approx(4.0, rel=1e-12)


def test_values_that_were_not_asked_for_are_solved_when_they_are(branch: Branch) -> None:
    """Roots of x^3 - 3 x = a beside a point of the branch, between its points, and next to its folds."""
    beside = branch.solutions[3].parameters["a"]
    for a in (-3.3, beside, beside * (1 + 1e-15), beside * (1 + 1e-11), 0.37, -0.37, 1.9999, -1.9999, 3.9):
        roots = [x.real for x in np.roots([1, 0, -3, -a]) if abs(x.imag) < 1e-12]
        found = [branch.at(a, which) for which in range(len(roots))]
        np.testing.assert_allclose(sorted(s.states[0, 0] for s in found), sorted(roots), atol=1e-9)
        assert [s.parameters["a"] for s in found] == [a] * len(roots)
        with pytest.raises(ValueError, match=f"passes a {len(roots)} times"):
            branch.at(a, len(roots))


def test_a_branch_ends_where_it_is_told_to(cubic: Solution) -> None:
    seen: list[float] = []
    branch = cubic.follow("a", 4.0, until=lambda s: s.states[0, 0] > 0.5, progress=lambda s: seen.append(s["a"]))  # type: ignore[arg-type]
    assert branch.complete
    assert branch.solutions[-1].states[0, 0] > 0.5
    assert seen == list(branch.values)


def test_branches_follow_branches_towards_smaller_values_and_back(cubic: Solution) -> None:
    x = cubic.follow("a", -5.0, at=[-4.5]).at(-4.5).states[0, 0]
    assert abs(x**3 - 3 * x + 4.5) < 1e-9
    middle = cubic.follow("a", -3.0).solutions[-1]
    assert middle.follow("a", 4.0).solutions[-1].states[0, 0] == pytest.approx(2.195823345445647, abs=1e-9)  # x^3-3x=4


def test_an_imperfect_rod_bends_where_the_perfect_one_buckles() -> None:
    """Beyond P = pi^2/4 = 2.467; P = K(sin^2(a/2))^2 at the amplitude a of the perfect rod (Euler 1744)."""
    from scipy.special import ellipk

    bent = buckling().solve([0.05, 0.0]).follow("P", 4.0).solutions[-1]
    perfect = bent.follow("d", 0.0).solutions[-1]
    assert abs(perfect["d"]) < 1e-12  # type: ignore[arg-type]
    amplitude = abs(perfect.states[0, 0])
    assert amplitude > 1.0
    assert abs(ellipk(np.sin(amplitude / 2) ** 2) ** 2 / 4.0 - 1) < 1e-7


def test_errors_hold_along_the_branch() -> None:
    """u'' = -k u, u(0) = 0, u(1) = 1: sin(sqrt(k) x)/sin(sqrt(k)), at every point of the walk."""
    u, v, k = (ca.SX.sym(name) for name in ("u", "v", "k"))
    model = OdeModel("string", ca.vertcat(u, v), ca.vertcat(v, -k * u), k)
    first = BoundaryValueProblem(model, [model.start(u), model.end(u) - 1], parameters={"k": 1.0}).solve([0.0, 1.0])
    x = np.linspace(0.0, 1.0, 101)
    branch = first.follow("k", 9.0)
    for solution in branch.solutions:
        root = np.sqrt(solution.parameters["k"])
        exact = np.sin(root * x) / np.sin(root)
        error = np.abs(solution.evaluate(x)[:, 0] - exact).max() / np.abs(exact).max()
        assert error <= max(solution.error, 1e-13)
        assert solution.error <= 1e-8


def limit_cycle() -> Orbit:
    """The limit cycle of van der Pol's oscillator at mu = 1."""
    guess = lambda t: [2 * np.cos(t), -2 * np.sin(t)]  # noqa: E731
    return find_orbit(van_der_pol(), guess, 6.6, parameters={"mu": 1.0}, tolerance=1e-8, corrector="newton")


@pytest.mark.slow
@pytest.mark.parametrize(
    "beside", [1e-3, 1e-12, *(pytest.param(n, marks=pytest.mark.slow) for n in (1e-6, 1e-8, 1e-10))]
)
def test_values_next_to_a_fold_are_found_on_both_sides_of_it(beside: float, cubic: Solution) -> None:
    """Against the roots of x^3 - 3 x = a, which lie at a distance of sqrt(beside/3) from the fold at x = -1."""
    branch = cubic.follow("a", 4.0, at=[2.0 - beside])
    assert branch.complete
    found = [s for s in branch.solutions if s.point.requested]
    assert [s.parameters["a"] for s in found] == [2.0 - beside] * 3
    off = np.array([s.states[0, 0] + 1.0 for s in found[:2]])
    np.testing.assert_allclose(off, np.array([-1.0, 1.0]) * np.sqrt(beside / 3.0), rtol=1e-2)
    values = branch.values
    turn = next(i for i, s in enumerate(branch.solutions) if s.point.located and not s.point.requested)
    assert values[turn] == pytest.approx(2.0, abs=1e-9)
    assert np.all(np.diff(values[: turn + 1]) > 0)
    beyond = cubic.follow("a", 4.0, at=[2.0 + 1e-6])
    assert sum(s.point.requested for s in beyond.solutions) == 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", [pytest.param("solutions", marks=pytest.mark.slow), "orbits"])
def test_a_branch_read_from_its_journal_goes_on_as_if_not_broken_off(kind: str, cubic: Solution) -> None:
    """Folds, values asked for and multipliers among it."""
    first, name, to, at = (cubic, "a", 4.0, [0.0]) if kind == "solutions" else (limit_cycle(), "mu", 1.6, [1.3])
    stability = kind == "orbits"

    def space() -> BoundarySpace:
        return following_space(first, name, to, at=at, max_points=500, max_step=0.2)

    records: list[BranchRecord] = []

    def keep(point: Point, _: object) -> None:
        records.append(point_record("b", len(records), point))

    following = BranchRun(space(), stability, keep=keep)
    for result in following:
        if stability and isinstance(result, Orbit):
            records.append(stability_record("b", len(records), result))
    whole = following.solutions
    for part in range(1, 12):
        kept = part * len(records) // 12
        known = known_of(records[:kept], "b", space(), stability)
        assert (known.fault, known.kept) == ("", kept)
        again = BranchRun(space(), stability, solutions=known.solutions, waiting=known.waiting)
        assert len(list(again)) == len(whole) - len(known.solutions)
        branch = again.branch()
        assert branch.complete
        np.testing.assert_array_equal(branch.values, following.branch().values)
        assert len(branch.folds) == len(following.branch().folds) == (2 if kind == "solutions" else 0)
        asked = [solution.parameters[name] for solution in branch.solutions if solution.point.requested]
        assert asked == at * (3 if kind == "solutions" else 1)
        if stability:
            np.testing.assert_array_equal(branch.max_abs_multiplier, following.branch().max_abs_multiplier)


@pytest.mark.slow
def test_a_branch_whose_parameter_comes_to_a_limit_ends_with_it() -> None:
    """Bratu's larger solution grows without bound as p goes to 0: u = 2 log(cosh(theta / 4)) in the middle."""
    branch = bratu(1.0).solve([0.0, 0.0]).follow("lam", 4.0, back_to=0.0)
    assert branch.end is End.STILL
    assert "lam comes to 0 +- " in branch.reason
    assert "more than" not in branch.reason
    last = next(solution for solution in branch.solutions[::-1] if solution.parameters["lam"] > 1e-11)
    middle = float(np.ravel(last.evaluate(0.5))[0])
    theta = 4.0 * np.arccosh(np.exp(0.5 * middle))
    assert theta**2 / (2.0 * np.cosh(theta / 4.0) ** 2) == pytest.approx(last.parameters["lam"], rel=1e-4)
