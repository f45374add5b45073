"""Every class of results prints, draws, becomes tables, is saved and leads on from its file to the same bits."""

from __future__ import annotations

import functools
import inspect
import pkgutil
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from matplotlib.figure import Figure

import casadi_skin
from casadi_skin import (
    Bond,
    BoundaryValueProblem,
    Chain,
    Lattice,
    OdeModel,
    Site,
    find_equilibrium,
    find_orbit,
    follow_family,
    read_result,
    search_orbit,
    smallest_kick,
)
from casadi_skin.dynamics import evolve
from casadi_skin.dynamics.starts import spreading
from casadi_skin.lattice.linear import bands, lattice_modes
from casadi_skin.model.result import Result
from casadi_skin.optimise.search_orbit import pareto_front

pytestmark = pytest.mark.slow
X, Y, MU = (ca.SX.sym(name) for name in ("x", "y", "mu"))
HOPF = OdeModel(
    "Hopf", ca.vertcat(X, Y), ca.vertcat(MU * X - Y - X * (X**2 + Y**2), X + MU * Y - Y * (X**2 + Y**2)), MU
)
RING = Lattice(6, [Site("a", onsite="y + g*y^3")], [Bond("a", "a", (1,), "d")], "periodic", {"g": 1.0})
SITE = Chain(1, 1.0, 0.25, 1.0)


@functools.cache
def family() -> Any:
    return follow_family(Chain(4, 1.0, 0.25, -1.0), 1, 0.4, stability=True, tolerance=1e-9)


@functools.cache
def member() -> Any:
    return family().at(S=0.2)


@functools.cache
def cycle() -> Any:
    t = np.linspace(0, 2 * np.pi, 40)
    circle = (t, 0.5 * np.stack([np.cos(t), np.sin(t)]))
    return find_orbit(HOPF, circle, 6.0, parameters={"mu": 0.25}, tolerance=1e-4, corrector="newton")


@functools.cache
def rest() -> Any:
    return find_equilibrium(HOPF, [0.0, 0.0], parameters={"mu": -0.25})


@functools.cache
def endless_family() -> Any:
    return follow_family(Chain(np.inf, 1.0, 0.7, 1.0), "last", 0.5, stability=True, tolerance=1e-6)


def solution() -> Any:
    line = OdeModel("line", ca.vertcat(X, Y), ca.vertcat(Y, -MU * X), MU)
    problem = BoundaryValueProblem(line, [line.start(X), line.end(X) - 1], parameters={"mu": 1.0})
    return problem.solve([0.0, 1.0], tolerance=1e-4)


@functools.cache
def softer() -> Any:
    return follow_family(Chain(8, 1.0, 0.25, -1.0), 1, 1.0, stability=True, tolerance=1e-9)


def endless() -> Any:
    chain = Chain(float("inf"), 1.0, 0.7, -1.0)
    return follow_family(chain, "first", 2.0, at=[2.0], tolerance=1e-6, stability_sites=60, corrector="newton").at(2.0)


def evolution() -> Any:
    return evolve(RING, [0.1] + [0.0] * 5, None, np.linspace(0.0, 3.0, 7))


def kick() -> Any:
    orbit = follow_family(SITE, 1, 0.5, at=[0.5], tolerance=1e-10, corrector="newton").at(S=0.5)
    return smallest_kick(orbit, 1.2 * orbit.period, distance=0.3, starts=1)


def search() -> Any:
    stated: dict[str, Any] = {"free": ["gamma"], "bounds": {"gamma": (0.1, 0.3)}, "starts": 1}
    return search_orbit(Chain(2, 1.0, 0.25, -1.0), mode=1, S=0.1, objective="Omega", **stated)


def front() -> Any:
    stated: dict[str, Any] = {"free": ["gamma"], "bounds": {"gamma": (0.1, 0.3)}, "starts": 1}
    return pareto_front(Chain(2, 1.0, 0.25, -1.0), "Omega", "gamma", points=3, mode=1, S=0.1, **stated)


MAKERS: dict[str, Callable[[], Any]] = {
    "Bands": lambda: bands(RING),
    "Branch": lambda: rest().follow("mu", 0.1),
    "Certificate": lambda: member().certify(),
    "Diagram": lambda: rest().follow("mu", 0.1).follow_all(depth=1),
    "EdgeCurve": lambda: softer().edge(1).curve("gamma", 0.26),
    "Equilibrium": rest,
    "Evolution": evolution,
    "FullPeriodFloquet": lambda: cycle().floquet(),
    "LatticeModes": lambda: lattice_modes(RING),
    "LocalisedDiagram": lambda: endless_family().localised_diagram,
    "LocalisedFloquet": lambda: endless().floquet(),
    "Orbit": cycle,
    "ParetoFront": front,
    "ProvedStability": lambda: member().proved_stability,
    "ProvedStretch": lambda: family().certify(0.1, 0.2),
    "ReversibleFloquet": lambda: member().floquet(),
    "SearchResult": search,
    "SmallestKick": kick,
    "Solution": solution,
    "SpecialPoint": lambda: rest().follow("mu", 0.1).special_points[0],
    "Spectrum": lambda: rest().spectrum,
    "Spreading": lambda: spreading(evolution()),
    "StabilityDiagram": lambda: softer().stability_diagram,
    "TransientGrowth": lambda: member().transient_growth(8),
}
LEADING_ON: dict[str, Callable[[Any], Any]] = {  # computed from a result, as its bits
    "Branch": lambda branch: branch.special_points[0].follow("mu", 0.05, max_points=3).values,
    "Diagram": lambda diagram: diagram.branches[0].solutions[-1].follow("mu", -0.1, max_points=3).values,
    "Equilibrium": lambda equilibrium: equilibrium.follow("mu", 0.1).values,
    "Orbit": lambda orbit: orbit.follow("mu", 0.3, max_points=3).values,
    "LocalisedDiagram": lambda diagram: np.array([change.S for change in diagram.all]),
    "SmallestKick": lambda found: found.orbit.floquet().multipliers,
    "Solution": lambda found: found.follow("mu", 1.2, max_points=3).solutions[-1].point.z,
    "SpecialPoint": lambda point: point.follow("mu", 0.05, max_points=3).values,
    "StabilityDiagram": lambda diagram: diagram.max_abs_multiplier(diagram.coordinates(50)),
    "TransientGrowth": lambda growth: growth.of(growth.optimal),
}


@functools.cache
def made(name: str) -> Any:
    result = MAKERS[name]()
    assert type(result).__name__ == name
    return result


def test_every_class_is_here() -> None:
    for module in pkgutil.walk_packages(casadi_skin.__path__, "casadi_skin."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
    found, left = set(), [Result]
    while left:
        left += (below := left.pop().__subclasses__())
        found |= {kind.__name__ for kind in below if not inspect.isabstract(kind)}
    assert found == set(MAKERS)


@pytest.mark.parametrize("name", MAKERS)
def test_a_result_is_shown(name: str) -> None:
    result = made(name)
    assert "\n" not in repr(result)
    assert len(repr(result)) < 300
    lines = str(result).splitlines()
    assert (1 if name == "SpecialPoint" else 2) <= len(lines) <= 10
    assert all(len(line) < 140 for line in lines)
    page = result._repr_html_()
    assert "<table><caption>" in page
    assert "data:image/png;base64," in page
    given = Figure().add_subplot()
    assert result.plot(given) is given
    assert given.lines or given.collections or given.patches


@pytest.mark.parametrize("name", MAKERS)
def test_a_result_becomes_tables(name: str) -> None:
    result = made(name)
    frame = result.to_dataframe()
    assert len(frame) > 0
    if name == "Diagram":
        with pytest.raises(ValueError, match="accepted: one branch"):
            result.to_xarray()
        return
    dataset = result.to_xarray()
    assert dataset.attrs
    assert set(dataset.sizes.values()) != {0}


@pytest.mark.parametrize("name", MAKERS)
def test_a_result_comes_back_from_its_file(name: str, tmp_path: Path) -> None:
    result = made(name)
    path = result.save(tmp_path / "one.skin")
    read = read_result(path)
    assert type(read) is type(result)
    assert str(read) == str(result)
    assert read.save(tmp_path / "two.skin").read_bytes() == path.read_bytes()
    assert read.to_dataframe().equals(result.to_dataframe())
    if name in LEADING_ON:
        assert np.asarray(LEADING_ON[name](read)).tobytes() == np.asarray(LEADING_ON[name](result)).tobytes()
