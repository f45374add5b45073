"""The special points of a branch of equilibria account for the number of unstable eigenvalues along it."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import branch_of, has_points, symbols
from kernels import needs_kernels

from casadi_skin import Branch, OdeModel, find_equilibrium
from casadi_skin.follow import rest_events


def bump(place: float, shape: str, moves: bool = False) -> OdeModel:
    """A pair that is unstable for |p - place| < 0.001 alone, by a bell 0.001 wide; the state `moves` by it, or not."""
    x, y, z, p = symbols("x y z p")
    s = (p - place) / 1e-3
    bell, edge = (ca.exp(-(s**2)), np.exp(-1.0)) if shape == "gaussian" else (1 / (1 + s**2), 0.5)
    growth = (z if moves else bell) - edge
    r2 = x**2 + y**2
    rhs = ca.vertcat(growth * x - 2 * y - x * r2, 2 * x + growth * y - y * r2, (bell if moves else 0) - z)
    return OdeModel("bump", ca.vertcat(x, y, z), rhs, p)


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("shape", ["gaussian", "lorentzian"])
def test_both_hopf_points_of_a_narrow_bump_are_found_at_any_place(shape: str) -> None:
    """Closed form: place -+ 0.001; between points of the branch nothing else shows them."""
    for place in np.random.default_rng(7).uniform(0.02, 0.98, 3):
        branch = find_equilibrium(bump(place, shape), [0.0, 0.0, 0.0], parameters={"p": 0.0}).follow("p", 1.0)
        has_points(branch, [("hopf", place - 1e-3), ("hopf", place + 1e-3)], 1e-9)


@needs_kernels
def test_equilibria_along_a_branch_and_sides_of_eigenvalues_are_those_of_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    rates = lambda x, y, z, p: [p * x - 2 * y - x * z, 2 * x + p * y - y**3, ca.sin(3 * p) + x - 5 * z]  # noqa: E731
    branch = branch_of("x y z", rates, [0.0, 0.0, 0.0], 1.5, p=-1.5)
    walked, sides = [one.point for one in branch.solutions if one.point.walked], set[tuple[bool, bool]]()
    for ends in pairwise(walked):
        compiled = rest_events.Places.of(branch.space, *ends)
        with monkeypatch.context() as patch:
            patch.setitem(vars(branch.space.problem), "along", None)
            plain = rest_events.Places.of(branch.space, *ends)
        assert compiled.settled.all()
        np.testing.assert_array_equal(compiled.settled, plain.settled)
        np.testing.assert_allclose(compiled.unknowns, plain.unknowns, rtol=0, atol=1e-13)
        np.testing.assert_allclose(compiled.entries, plain.entries, rtol=0, atol=1e-7)
        for factor in 10.0 ** np.linspace(-1.0, 4.0, 26):  # at the largest no eigenvalue is far enough away
            monkeypatch.setattr(rest_events, "SURE_CHANGE_FACTOR", factor)
            with monkeypatch.context() as patch:
                own = compiled.clear(branch.space)
                patch.setitem(vars(branch.space.problem), "along", None)
                assert plain.clear(branch.space) == own
            sides.add((factor < 1.0, own))
    assert len(sides) == 4  # a pair crosses the axis, and far from there each keeps its side


def test_where_the_state_has_the_bump_both_are_found_or_the_stretch_is_named() -> None:
    for place in np.random.default_rng(8).uniform(0.02, 0.98, 3):
        model = bump(place, "gaussian", moves=True)
        branch = find_equilibrium(model, [0.0, 0.0, 0.0], parameters={"p": 0.0}).follow("p", 1.0)
        assert {point.kind for point in branch.special_points} <= {"hopf"}
        gaps = [gap for gap in branch.unresolved if gap.start <= place + 1e-3 and gap.end >= place - 1e-3]
        assert gaps or [point.kind for point in branch.special_points] == ["hopf", "hopf"]


def test_a_stretch_that_special_points_do_not_account_for_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the search finds nothing, the stretch on which the number of unstable eigenvalues differs is there."""
    monkeypatch.setattr(rest_events._Search, "found", lambda *_: ())
    rates = lambda x, y, p: [p * x - y - x * (x**2 + y**2), x + p * y - y * (x**2 + y**2)]  # noqa: E731
    branch = branch_of("x y", rates, [0.0, 0.0], 1.2, p=-1.0)
    assert branch.special_points == ()
    (stretch,) = branch.unresolved
    assert stretch.start <= 0.0 <= stretch.end
    assert stretch.end - stretch.start < 0.05
    assert stretch.reason == "the number of unstable eigenvalues goes from 0 to 2, and no special point accounts for it"
    assert "unresolved: 1 stretch;" in repr(branch)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_pairs_that_come_and_go_at_random_are_all_listed(seed: int) -> None:
    """Growth rates by random cosines of several frequencies against their roots on 20,000 values."""
    random = np.random.default_rng(seed)
    p = ca.SX.sym("p")
    x = ca.SX.sym("x", 4)
    values, rows, roots = np.linspace(0.0, 1.0, 20_001), [], []
    for k in range(2):
        frequencies, phases, heights = random.uniform(5.0, 120.0, 4), random.uniform(0.0, 6.3, 4), random.normal(size=4)
        growth = sum(h * ca.cos(f * p + a) for f, a, h in zip(frequencies, phases, heights, strict=True))
        u, v = x[2 * k], x[2 * k + 1]
        rows += [growth * u - (3 + k) * v - u * (u**2 + v**2), (3 + k) * u + growth * v - v * (u**2 + v**2)]
        exact = np.sum(heights * np.cos(frequencies * values[:, None] + phases), axis=1)
        roots += list(values[1:][exact[1:] * exact[:-1] < 0.0])
    model = OdeModel("cosines", x, ca.vertcat(*rows), p)
    branch = find_equilibrium(model, np.zeros(4), parameters={"p": 0.0}).follow("p", 1.0)
    has_points(branch, [("hopf", root) for root in np.sort(roots)], 5.1e-5)


def test_stretches_that_are_clear_hide_no_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where eigenvalues stay on their sides by far nothing is sought: the search finds the same without that."""

    def lorenz() -> Branch:
        rates = lambda x, y, z, r: [10 * (y - x), r * x - y - x * z, x * y - 8 * z / 3]  # noqa: E731
        return branch_of("x y z", rates, [7.0, 7.0, 19.0], 28.0, r=20.0)

    found, searched = lorenz(), list[object]()
    monkeypatch.setattr(rest_events.Places, "clear", lambda *places: searched.append(places))
    again = lorenz()
    assert len(searched) > 30
    assert [(one.kind, one.parameters["r"]) for one in found.special_points] == [
        (one.kind, one.parameters["r"]) for one in again.special_points
    ]
    np.testing.assert_array_equal(found.values, again.values)
