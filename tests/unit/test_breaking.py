"""Orbits that leave a family of the chain where a real tongue opens or closes: Dormand-Prince closes them again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from casadi_skin import Bond, Branch, Chain, Lattice, Orbit, Site, follow_family
from casadi_skin.points import edges as at_edges
from casadi_skin.runs.program import main
from casadi_skin.stability.tongues.diagram import StabilityEdge

pytestmark = pytest.mark.slow

CHAIN = Chain(sites=3, alpha=1.0, gamma=0.25, g=-1.0)


def flown(orbit: Orbit) -> np.ndarray:
    """The state after a period by the chain's equations, written out here."""
    coupling = np.diag([1.25, 1.25], -1) + np.diag([0.75, 0.75], 1) - 3.0 * np.eye(3)

    def field(_: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[3:], coupling @ x[:3] + x[:3] ** 3])

    start = orbit.evaluate(0.0)
    return np.asarray(solve_ivp(field, (0.0, orbit.period), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1])


def test_orbits_of_less_symmetry_leave_at_the_edges_of_a_real_tongue() -> None:
    family = follow_family(CHAIN, 1, 2.6, stability=True)
    points = family.special_points
    diagram = family.stability_diagram
    edges = [edge for edge in (*diagram.changes, *diagram.further) if edge.kind == "real"]
    real = [edge for edge in edges if edge.mu == 0.0]  # at mu = -1 the energy has an extremum
    assert sorted(point.parameters["S"] for point in points) == pytest.approx(sorted(edge.S for edge in real))
    opens, closes = points
    assert opens.lost == ("half-period symmetry", "reversal")
    assert closes.lost == ("half-period symmetry",)
    assert repr(closes).endswith("loses its half-period symmetry>")
    for point in points:
        S = point.parameters["S"]
        branch = point.follow("S", 1.1 * S, stability=True, max_points=6)
        assert branch.orbits[0].period == pytest.approx(family.at(S=S).period, rel=1e-8)
        last = branch.orbits[-1]
        y = last.evaluate(last.period * np.arange(16) / 16)[:, :3]
        assert flown(last) == pytest.approx(last.evaluate(0.0), abs=1e-6)
        assert np.max(np.abs(y[8:] + y[:8])) > 1e-2  # no longer odd
        mirrored = np.max(np.abs(y[1:] - y[:0:-1]))
        assert (mirrored > 1e-2) == (point is opens)
        if point is opens:  # but odd about its quarter: y(T/2 - t) = -y(t)
            assert np.min([np.max(np.abs(np.roll(y[::-1], k, axis=0) + y)) for k in range(16)]) < 0.2 * mirrored
        assert np.sum(y[0] ** 2) == pytest.approx(last["S"], rel=1e-8)
        known = np.sort(np.abs(last.floquet("cvodes").others))
        assert np.sort(np.abs(last.floquet().others)) == pytest.approx(known, rel=1e-4, abs=1e-4)


def test_an_extremum_of_the_energy_is_no_branch_point() -> None:
    """On the first family of 24 sites real instability begins there, at mu = -1, and no other branch leaves."""
    chain = Chain(sites=24, alpha=1.0, gamma=0.25, g=-1.0)
    family = follow_family(chain, 1, 0.5, stability=True)
    assert [edge.mu for edge in family.changes if edge.kind == "real"] == [-1.0]
    assert family.special_points == ()


def test_a_family_that_crosses_one_of_a_third_of_its_period_has_one_branch_point_there() -> None:
    """Mode 1 of five sites turns into mode 5 run through three times: tongues touch there, one point that had been two.

    Its frequency, and those of the branch that crosses, are those of mode 5 as followed from rest.
    """
    chain = Chain(sites=5, alpha=0.5, gamma=0.2, g=-1.0)
    family = follow_family(chain, 1, 2.0, stability=True, tolerance=1e-10)
    (point,) = (p for p in family.special_points if p.kind == "branch point" and p.mu == -1.0 and not p.lost)
    S, orbit = point.parameters["S"], point.solution
    known = follow_family(chain, 5, 1.1, tolerance=1e-10)
    other = known.at(S=S)
    assert abs(3.0 * orbit.Omega - other.Omega) <= 3.0 * orbit.Omega_error + other.Omega_error < 1e-8
    y = orbit.evaluate(orbit.period * np.arange(12) / 12)
    assert np.max(np.abs(np.roll(y, 4, axis=0) - y)) < 1e-6
    for to in (0.9, 1.05):
        crossing = point.follow("S", to)
        assert crossing.complete
        assert 3.0 * crossing.orbits[-1].Omega == pytest.approx(known.at(S=to).Omega, rel=1e-10)


def test_every_change_of_the_highest_mode_of_a_ring_is_a_special_point() -> None:
    """FPUT-beta on 8 sites: equal multipliers cross at once, where Hill's equation of a wave has the trace 2."""
    ring = Lattice([8], [Site("a", onsite="0*y")], [Bond("a", "a", [1], "d + d^3")], "periodic")
    family = follow_family(ring, 8, 3.0, stability=True)
    found = [point.parameters["S"] for point in family.special_points]
    assert found == pytest.approx([_where_a_wave_grows(k, *near) for k, near in ((3, (0.2, 0.3)), (2, (2.5, 2.9)))])
    assert found[0] == pytest.approx(0.250360, abs=1e-6)


def _where_a_wave_grows(k: int, *near: float) -> float:
    """S = 8 a^2 at which waves of number k on the highest mode of 8 sites begin to grow."""

    def excess(S: float) -> float:
        def field(_: float, x: np.ndarray) -> list[float]:
            rate = 4.0 * np.sin(np.pi * k / 8) ** 2 * (1.0 + 12.0 * x[0] ** 2)
            return [x[1], -4.0 * x[0] - 16.0 * x[0] ** 3, x[3], -rate * x[2], x[5], -rate * x[4]]

        def at_rest(_: float, x: np.ndarray) -> float:
            return float(x[1])

        at_rest.terminal, at_rest.direction = True, 1.0  # type: ignore[attr-defined]  # y is lowest after half of it
        start = [np.sqrt(S / 8), 0.0, 1.0, 0.0, 0.0, 1.0]
        x = solve_ivp(field, (0.0, 10.0), start, "DOP853", rtol=1e-12, atol=1e-13, events=at_rest).y[:, -1]
        return float(abs(x[2] + x[5]) - 2.0)

    return float(brentq(excess, *near, xtol=1e-10))


def test_an_edge_without_an_orbit_is_named_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first of two branch points has none on either side: it is not among the special points, and not forgotten."""
    passing, first = at_edges._passing, list[float]()

    def refusing(family: Branch, edge: StabilityEdge, S: float, near: float) -> Orbit:
        if edge.mu == 0.0:
            first.append(edge.place.coordinate)
        if first and edge.place.coordinate == first[0]:
            raise ArithmeticError("no level is fine enough")
        return passing(family, edge, S, near)

    monkeypatch.setattr(at_edges, "_passing", refusing)
    family = follow_family(CHAIN, 1, 2.6, stability=True)
    assert len(family.special_points) == 1
    (missing,) = family.not_located
    assert missing.S_start == missing.S_end < family.special_points[0].parameters["S"]
    assert missing.reason.endswith("nor on both sides of it: no level is fine enough")
    assert f"edge of a tongue at S = {missing.S_start:.8g}" in str(family)
    first.clear()
    scene = tmp_path / "scene.toml"
    tables = (
        "[chain]\nsites = 3\nalpha = 1.0\ngamma = 0.25\ng = -1.0\n",
        "[family]\nmode = 1\namplitude_max = 2.6\n[stability]\n[figures]\nformats = []\n",
        '[continuation]\nparameter = "S"\nto = 2.7\nmax_points = 2\nswitch = ["branch point"]\n',
    )
    scene.write_text("".join(tables), encoding="utf-8")
    main(["run", str(scene), "--out", str(tmp_path / "out")])
    assert "mode 1: not located: edge of a tongue at S = " in capsys.readouterr().out
