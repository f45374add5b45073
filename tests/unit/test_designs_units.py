"""Designs of random problems with closed forms: the optimum is found, and is the same in other units."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize, minimize_scalar

from casadi_skin import OdeModel, find_equilibrium, optimise
from casadi_skin.search.design_problem import DesignProblem
from casadi_skin.search.designs import Design


@dataclass(frozen=True)
class Problem:
    """x' = p + a x - x^3/c in units (x, p, a, c), whose folds are at p = -+ 2/3 a sqrt(a c/3).

    Least squares of a and c from a random place, with the upper fold times +-0.3, within random bounds.
    """

    seed: int

    @cached_property
    def draws(self) -> dict[str, Any]:
        generator = np.random.default_rng(self.seed)
        return {
            "place": generator.uniform(0.7, 1.6, 2), "weight": generator.uniform(0.3, 3.0, 2),
            "sign": generator.choice([-1.0, 1.0]), "limit": generator.uniform(0.3, 0.8),
            "kind": generator.choice(["free", "at least", "equal"]),
            "bounds": [(generator.uniform(0.3, 0.8), generator.uniform(1.2, 2.5)) for _ in range(2)],
            "units": 10.0 ** generator.uniform(-6.0, 6.0, 5),
        }  # fmt: skip

    def fold(self, a: Any, c: Any) -> Any:
        return 2 / 3 * a * (a * c / 3) ** 0.5

    def value(self, a: Any, c: Any, p: Any) -> Any:
        (x, y), (v, w) = self.draws["place"], self.draws["weight"]
        return v * (a - x) ** 2 + w * (c - y) ** 2 + self.draws["sign"] * 0.3 * p

    @property
    def limits(self) -> tuple[float | None, float | None] | None:
        limit = self.draws["limit"]
        return {"free": None, "at least": (limit, None), "equal": (limit, limit)}[self.draws["kind"]]

    def known(self) -> tuple[float, np.ndarray]:
        """The optimum of the closed form; on the limit a is known in closed form, too."""
        bounds, limit = np.array(self.draws["bounds"]), self.draws["limit"]
        tight = {"ftol": 1e-16, "gtol": 1e-10}
        free = [
            minimize(lambda u: self.value(*u, self.fold(*u)), start, bounds=bounds, options=tight)
            for start in np.random.default_rng(1).uniform(*bounds.T, (4, 2))
        ]  # fmt: skip
        best = min(free, key=lambda end: end.fun)
        if self.limits is None or (self.limits[1] is None and self.fold(*best.x) > limit):
            return float(best.fun), best.x
        low, high = np.clip(3 * (1.5 * limit) ** 2 / bounds[0, ::-1] ** 3, *bounds[1])  # c where a is on its bounds
        held = lambda c: np.array([(1.5 * limit) ** (2 / 3) * (3 / c) ** (1 / 3), c])  # noqa: E731
        cost = lambda c: self.value(*held(c), limit)  # noqa: E731
        end = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-12})
        c = min((low, high, end.x), key=cost)
        return float(cost(c)), held(c)

    def design(self, units: Any, most: float | None = None) -> Design:
        """The design in units of x, p, a, c and the objective; with a c that is to be at most this."""
        ux, up, ua, uc, uf = units
        x, p, a, c = (ca.SX.sym(name) for name in "xpac")
        X, P, A, C = x / ux, p / up, a / ua, c / uc
        model = OdeModel("cubic", x, ux * (P + A * X - X**3 / C), ca.vertcat(p, a, c))
        start = find_equilibrium(model, [-1.9 * ux], parameters={"p": -2.0 * up, "a": ua, "c": uc})
        folds = [one for one in start.follow("p", 2.0 * up).special_points if one.kind == "fold"]
        upper = max(folds, key=lambda one: one.parameters["p"])
        ranges = zip("ac", (ua, uc), self.draws["bounds"], strict=True)
        bounds: dict[str, Any] = {name: (low * unit, high * unit) for name, unit, (low, high) in ranges}
        held = [] if most is None else [("c", None, most * uc)]
        if self.limits is not None:
            held += [("p", *(None if value is None else value * up for value in self.limits))]
        return optimise(
            lambda one: uf * self.value(one.a / ua, one.c / uc, one.p / up), upper, over=["a", "c"], bounds=bounds,
            subject_to=held,
        )  # fmt: skip


@pytest.mark.parametrize("seed", range(60))
def test_the_optimum_is_that_of_the_closed_form_in_all_units(seed: int) -> None:
    problem = Problem(seed)
    units = problem.draws["units"]
    value, place = problem.known()
    one, other = problem.design(np.ones(5)), problem.design(units)
    for design, (_, _, ua, uc, uf) in ((one, np.ones(5)), (other, units)):
        assert design.found, design.reason
        assert [design["a"] / ua, design["c"] / uc] == pytest.approx(place, abs=1e-6)
        assert design.value / uf == pytest.approx(value, abs=1e-10)
    assert len(one.path) == pytest.approx(len(other.path), abs=3)


@pytest.mark.parametrize("seed", range(8))
def test_the_nearest_design_is_that_of_the_closed_form_in_all_units(seed: int) -> None:
    """The fold is to be beyond the largest that there is, and c in the lower half of its range: both are missed."""
    problem = Problem(seed)
    (left, a), (low, high) = problem.draws["bounds"]
    half, limit = (low + high) / 2, 1.1 * problem.fold(a, high)
    problem.draws.update(kind="at least", limit=limit)
    # Violations are measured by scaled gradients at the first design, a = c = 1, where the fold is at p.
    p = problem.fold(1.0, 1.0)
    height = max(1.5 * p * (a - left), 0.5 * p * (high - low))
    missed = lambda c: ((limit - problem.fold(a, c)) / height) ** 2 + (max(c - half, 0.0) / (high - low)) ** 2  # noqa: E731
    nearest = minimize_scalar(missed, bounds=(low, high), method="bounded", options={"xatol": 1e-10}).x
    for units in (np.ones(5), problem.draws["units"]):
        design = problem.design(units, half)
        assert not design.found
        assert "the constraints are not met" in design.reason
        assert [design["a"] / units[2], design["c"] / units[3]] == pytest.approx([a, nearest], abs=1e-6)
        assert len(design.path) < 100


@pytest.mark.parametrize("unit", [1.0, 1e6, 1e-6])
def test_a_parameter_that_is_zero_has_no_unit_of_its_own(unit: float) -> None:
    """Without bounds nothing but the derivatives tells how large p is to become."""
    u, p, q = (ca.SX.sym(name) for name in "upq")
    x, y = p / unit - 1, q - 2
    model = OdeModel("rest", u, x**2 + y**2 + x**4 + x * y / 2 - u, ca.vertcat(p, q))
    state = find_equilibrium(model, [3.5], parameters={"p": 0.0, "q": 1.0})
    design = optimise("u", state, over=["p", "q"])
    assert design.found
    assert [design["p"] / unit, design["q"]] == pytest.approx([1.0, 2.0], abs=1e-6)


@pytest.mark.parametrize("seed", range(16))
def test_the_error_of_a_value_covers_what_is_still_to_gain(seed: int) -> None:
    """Least values that are known, of functions whose second derivatives vanish there: SLSQP ends beside them."""
    random = np.random.default_rng(seed)
    unit, size = (float(10.0**power) for power in random.uniform(-6, 6, 2))
    x, p, q = (ca.SX.sym(name) for name in "xpq")
    model = OdeModel("line", x, p - x, ca.vertcat(p, q), nominal=unit * random.uniform(1, 3, 2))
    y, z = f"(x/{unit!r} - {float(random.uniform(-1, 1))!r})", f"(q/{unit!r} - 0.2)"
    quantity, over = (
        (f"abs({y})^{(3, 4, 6, 8)[seed // 4]}", ["p"]),
        (f"{y}^2 + {z}^4", ["p", "q"]),
        (f"{y}^4 + ({y} - {z})^2", ["p", "q"]),
        (f"{y}^4 + {y}^2*{z}^2 + {z}^4", ["p", "q"]),
    )[seed % 4]
    bounds = {"p": (-5.3 * unit, 4.1 * unit)} if seed % 8 < 4 else None
    design = optimise(f"{size!r}*({quantity})", find_equilibrium(model, [unit]), over=over, bounds=bounds)
    assert design.found, design.reason
    most = 1e4 if seed % 4 == 2 else 100.0  # a valley across both parameters
    assert design.value <= design.error <= most * design.value  # of the value 0


def test_the_error_of_a_value_covers_that_of_what_is_located_where_slopes_vanish() -> None:
    """(x - x0)^2 at x = x0, an equilibrium of error e: the value 0 is off by e^2, and |x - x0| by e."""
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    found = find_equilibrium(OdeModel("root", x, p - x**3, p, nominal=[2.0]), [1.2])
    (of,) = DesignProblem.of(lambda one: (one.x - found.state[0]) ** 2, found, ["p"], (), None, False).things
    off = of.errors[0][of.expressions.names.index("x")]
    assert off > 0.0
    for power in (1, 2):
        quantity = lambda one, power=power: ca.fabs(one.x - found.state[0]) ** power  # noqa: E731
        problem = DesignProblem.of(quantity, found, ["p"], (), None, False)
        assert problem.errors(problem.things)[0][0] == pytest.approx(off**power)
