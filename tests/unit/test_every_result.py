"""Every class of results prints, draws, becomes tables, is saved and leads on from its file to the same bits.

What single ones say, draw and tabulate stands below, with what is refused.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import pkgutil
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
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
    evolve,
    export_fmu,
    find_equilibrium,
    find_orbit,
    fit_parameters,
    follow_family,
    import_co_simulation,
    optimise,
    pareto_front,
    read_result,
    search_orbit,
    simulate,
    smallest_kick,
)
from casadi_skin.dynamics.starts import spreading
from casadi_skin.lattice.linear import bands, lattice_modes
from casadi_skin.model.arguments import with_error
from casadi_skin.model.result import Result
from casadi_skin.results.solutions import SAMPLES

X, Y, Z, MU, NU = (ca.SX.sym(name) for name in ("x", "y", "z", "mu", "nu"))
HOPF = OdeModel(
    "Hopf", ca.vertcat(X, Y), ca.vertcat(MU * X - Y - X * (X**2 + Y**2), X + MU * Y - Y * (X**2 + Y**2)), MU
)
ADAPTX = OdeModel(
    "adaptx", ca.vertcat(X, Y, Z), ca.vertcat(Y, Z, -MU * Z - NU * Y - X + X**2), ca.vertcat(MU, NU), nominal=(2.0, 1.0)
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
def diagram() -> Any:
    """Equilibria with a Hopf point, and the cycles from there, whose period doubles."""
    return find_equilibrium(ADAPTX, [0.0, 0.0, 0.0]).follow("mu", 0.6).follow_all(depth=1)


def point_of(found: Any, kind: str) -> Any:
    return next(point for point in found.special_points if point.kind == kind)


@functools.cache
def endless_family() -> Any:
    return follow_family(Chain(np.inf, 1.0, 0.7, 1.0), "last", 0.5, stability=True, tolerance=1e-6)


def solution() -> Any:
    line = OdeModel("line", ca.vertcat(X, Y), ca.vertcat(Y, -MU * X), ca.vertcat(MU, NU))
    ends, values = [line.start(X), line.end(X) - 1], {"mu": 1.0, "nu": 1.0}
    return BoundaryValueProblem(line, ends, interval=(0.0, NU), parameters=values).solve([0.0, 1.0], tolerance=1e-4)


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


def design() -> Any:
    orbit = follow_family(Chain(2, 1.0, 0.25, -1.0), 1, 0.1).orbits[-1]
    return optimise("Omega", orbit, over=["gamma"], bounds={"gamma": (0.1, 0.3)})


def design_of_a_point() -> Any:
    point = rest().follow("mu", 0.1).special_points[0]
    return optimise("mu", point, over=["omega"], bounds={"omega": (0.9, 1.1)})


def search() -> Any:
    omega, t = ca.SX.sym("omega"), ca.SX.sym("t")
    field = ca.vertcat(Y, -X - X**3 - 0.2 * Y + 0.1 * ca.cos(omega * t))
    duffing = OdeModel(
        "Duffing", ca.vertcat(X, Y), field, omega, time=t, forcing_period=2 * ca.pi / omega, nominal=(1.0,)
    )
    stated: dict[str, Any] = {"free": ["omega"], "bounds": {"omega": (0.3, 2.0)}, "starts": 1}
    return search_orbit(duffing, guess=[0.0, 0.0], running=-(X**2), **stated)


def search_goes_on(found: Any) -> Any:
    return found.orbit.floquet().multipliers


def front() -> Any:
    orbit = follow_family(Chain(2, 1.0, 0.25, -1.0), 1, 0.1).orbits[-1]
    return pareto_front("Omega", "gamma", orbit, over=["gamma"], bounds={"gamma": (0.1, 0.3)}, points=3)


def orbit_of_a_map() -> Any:
    with TemporaryDirectory() as folder:
        path = export_fmu(cycle(), Path(folder, "hopf.fmu"))
        model = import_co_simulation(path, parameters=["mu"], step=0.1)
    return model.find_orbit()


MAKERS: dict[str, Callable[[], Any]] = {
    "Bands": lambda: bands(RING),
    "Branch": lambda: rest().follow("mu", 0.1),
    "Branch of a family": lambda: follow_family(Chain(2, 1.0, 0.25, -1.0), 1, 0.4, stability=True, events=False),
    "Branch of a lattice": lambda: follow_family(RING, "last", 0.3),
    "Branch of cycles": lambda: rest().follow("mu", 0.5).special_points[0].follow("mu", 0.3),
    "Branch of Hopf points": lambda: point_of(diagram(), "hopf").curve("nu", 2.0),
    "Branch of doublings": lambda: point_of(diagram(), "period doubling").curve("nu", 1.1, max_points=3),
    "Certificate": lambda: member().certify(),
    "Design": design,
    "Diagram": diagram,
    "FamilySeries": lambda: family().series(8),
    "Fit": lambda: fit_parameters([(cycle(), "x_max", 0.6, 0.01)], over=["mu"]),
    "EdgeCurve": lambda: softer().edge(1).curve("gamma", 0.26),
    "Equilibrium": rest,
    "Evolution": evolution,
    "Floquet": lambda: cycle().floquet(),
    "Floquet at an edge": lambda: endless().floquet(),
    "Floquet of a family": lambda: member().floquet(),
    "Gradient": lambda: cycle().gradient("period"),
    "LatticeModes": lambda: lattice_modes(RING),
    "MapOrbit": orbit_of_a_map,
    "Orbit": cycle,
    "ParetoFront": front,
    "ProvedStability": lambda: member().proved_stability,
    "ProvedStretch": lambda: family().certify(0.1, 0.2),
    "Design of a search": search,
    "SmallestKick": kick,
    "Solution": solution,
    "SpecialPoint": lambda: rest().follow("mu", 0.1).special_points[0],
    "Spectrum": lambda: rest().spectrum,
    "Spreading": lambda: spreading(evolution()),
    "StabilityDiagram": lambda: softer().stability_diagram,
    "StabilityDiagram of an endless chain": lambda: endless_family().localised_diagram,
    "TransientGrowth": lambda: member().transient_growth(8),
}
LEADING_ON: dict[str, Callable[[Any], Any]] = {  # computed from a result, as its bits
    "Branch": lambda branch: branch.special_points[0].follow("mu", 0.05, max_points=3).values,
    "Branch of a family": lambda branch: branch.at(S=0.3).floquet().multipliers,
    "Branch of a lattice": lambda branch: branch.orbits[-1].follow("g", 1.2, max_points=3).values,
    "Branch of cycles": lambda branch: branch.solutions[-1].follow("mu", 0.4, max_points=3).values,
    "Diagram": lambda found: point_of(found, "period doubling").curve("nu", 1.1, max_points=3)["mu"],
    "Equilibrium": lambda equilibrium: equilibrium.follow("mu", 0.1).values,
    "Orbit": lambda orbit: orbit.follow("mu", 0.3, max_points=3).values,
    "Design of a search": search_goes_on,
    "SmallestKick": lambda found: found.orbit.floquet().multipliers,
    "Solution": lambda found: found.follow("nu", 1.2, max_points=3).solutions[-1].point.z,
    "SpecialPoint": lambda point: point.follow("mu", 0.05, max_points=3).values,
    "StabilityDiagram of an endless chain": lambda diagram: np.array([change.S for change in diagram.all]),
    "StabilityDiagram": lambda diagram: diagram.max_abs_multiplier(diagram.coordinates(50)),
    "TransientGrowth": lambda growth: growth.of(growth.optimal),
}


QUICK = ("Bands", "Branch", "Equilibrium", "Evolution", "FamilySeries", "Floquet", "LatticeModes", "Orbit", "Spectrum")
SLOWER = [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in MAKERS]


@functools.cache
def made(name: str) -> Any:
    result = MAKERS[name]()
    assert type(result).__name__ == name.partition(" ")[0]
    return result


def axes() -> Any:
    return Figure().add_subplot()


@pytest.mark.slow
def test_every_class_is_here() -> None:
    for module in pkgutil.walk_packages(casadi_skin.__path__, "casadi_skin."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
    found, left = set(), [Result]
    while left:
        left += (below := left.pop().__subclasses__())
        found |= {kind.__name__ for kind in below if not inspect.isabstract(kind)}
    assert found == {name.partition(" ")[0] for name in MAKERS}


@pytest.mark.parametrize("name", SLOWER)
def test_a_result_conforms(name: str, tmp_path: Path) -> None:
    """Lines, a page with a picture, a drawing, tables, and a file from which the same bits lead on."""
    result = made(name)
    assert "\n" not in repr(result)
    assert len(repr(result)) < 300
    lines = str(result).splitlines()
    assert (1 if name == "SpecialPoint" else 2) <= len(lines) <= 10
    assert all(len(line) < 140 for line in lines)
    page = result._repr_html_()
    assert "<table><caption>" in page
    assert "data:image/png;base64," in page
    given = axes()
    assert result.plot(given) is given
    assert given.lines or given.collections or given.patches
    frame = result.to_dataframe()
    assert len(frame) > 0
    if name == "Diagram":
        with pytest.raises(ValueError, match="accepted: one branch"):
            result.to_xarray()
    else:
        dataset = result.to_xarray()
        assert dataset.attrs
        assert set(dataset.sizes.values()) != {0}
    path = result.save(tmp_path / "one.skin")
    read = read_result(path)
    assert type(read) is type(result)
    assert str(read) == str(result)
    assert read.save(tmp_path / "two.skin").read_bytes() == path.read_bytes()
    assert read.to_dataframe().equals(frame)
    if name in LEADING_ON:
        assert np.asarray(LEADING_ON[name](read)).tobytes() == np.asarray(LEADING_ON[name](result)).tobytes()


# What single results say, draw and tabulate ---------------------------------------------------------------------------


@functools.cache
def small_family(**options: Any) -> Any:
    return follow_family(Chain(2, 1.0, 0.25, 1.0), 1, 0.1, tolerance=1e-4, **options)


def test_print_tells_the_numbers() -> None:
    orbit = small_family(stability=True).orbits[-1]
    assert f"Omega       {with_error(orbit.Omega, orbit.Omega_error)}" in str(orbit)
    assert with_error(-1.23456789, 1.26e-4) == "-1.23457 +- 1.3e-04"
    assert with_error(1.23456789, 1e-17) == "1.23456789 +- 1.0e-17"
    assert with_error(0.5, 2.0) == "0.5 +- 2.0e+00"
    branch = str(made("Branch"))
    assert "hopf at 0" in branch or "hopf at -" in branch
    assert "Branch of equilibria of Hopf" in branch
    assert "-0.25+1i, -0.25-1i" in str(made("Spectrum"))
    assert "stable" in str(made("Floquet"))
    assert "not computed; stability=True" in str(small_family())
    assert not any("not computed" in str(result) for result in (small_family(stability=True), made("Branch")))


@pytest.mark.parametrize("branch", [small_family, lambda: made("Branch")])
def test_a_branch_is_iterated_over_its_solutions(branch: Callable[[], Any]) -> None:
    assert list(branch()) == list(branch().solutions)
    assert len(list(branch())) == len(branch()) > 1


def test_printing_computes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    family = follow_family(Chain(2, 1.0, 0.25, 1.0), 1, 0.05, stability=True, tolerance=1e-4)
    monkeypatch.setattr(type(family.space), "floquets", None)
    assert "changes of stability" not in f"{family}{family!r}"
    assert "diagram_of_changes" not in vars(family)


def test_results_are_drawn_as_asked() -> None:
    assert made("Branch").plot(axes(), y="x").get_ylabel() == "x"
    drawn = small_family().plot(axes(), x="Omega", y="period").lines[0].get_xydata()
    np.testing.assert_allclose(drawn[:, 0] * drawn[:, 1], 2 * np.pi)
    assert [line.get_label() for line in cycle().plot(axes(), states=["y"]).lines] == ["y"]


@pytest.mark.parametrize(
    ("make", "options", "words"),
    [
        (lambda: made("Branch"), {"y": "z"}, "did you mean|accepted: "),
        (cycle, {"states": ["z"]}, "accepted: x, y"),
        (cycle, {"states": "x"}, "accepted: a list of names"),
        (cycle, {"axes": 3}, "accepted: axes of matplotlib"),
        (cycle, {"sites": ["y_1"]}, "plot: given the option 'sites'; did you mean states. accepted: states"),
    ],
)
def test_what_cannot_be_drawn_is_refused(make: Callable[[], Any], options: dict[str, Any], words: str) -> None:
    with pytest.raises((ValueError, TypeError), match=words):
        make().plot(**({"axes": axes()} | options))


def test_tables_have_the_numbers() -> None:
    found, orbit = small_family(), cycle()
    assert found.to_dataframe()["Omega"].tolist() == found.Omega.tolist()
    assert found.to_xarray()["Omega"].values.tolist() == found.Omega.tolist()
    frame = orbit.to_dataframe()
    assert frame.columns.tolist() == ["t", "x", "y"]
    assert len(frame) == SAMPLES
    np.testing.assert_allclose(np.hypot(frame["x"], frame["y"]), 0.5, atol=1e-3)
    assert orbit.to_xarray()["x"].dims == ("t",)
    assert orbit.floquet().to_dataframe()["trivial"].tolist() == [True, False]
    assert rest().spectrum.to_dataframe()["real"].tolist() == [-0.25, -0.25]
    assert made("Branch").to_dataframe()["special"].tolist().count("hopf") == 1
    assert rest().to_dataframe()["stable"].tolist() == [True]


@pytest.mark.parametrize(("package", "verb"), [("pandas", "to_dataframe"), ("xarray", "to_xarray")])
def test_a_missing_extra_is_named(package: str, verb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def importing(name: str, *rest: Any, **more: Any) -> Any:
        if name == package:
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", importing)
    with pytest.raises(ImportError, match=rf"casadi-skin\[{package}\]"):
        getattr(small_family(), verb)()


@pytest.mark.slow
def test_nothing_that_draws_or_tabulates_is_imported_before_it_is_asked_for() -> None:
    code = (
        "import sys; from casadi_skin import *; "
        "print([m for m in ('matplotlib.pyplot', 'matplotlib.figure', 'pandas', 'xarray') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# What a result has: every name of its class is a value or no attribute, and times, states and shapes agree ------------


def member_by(**options: Any) -> Any:
    return follow_family(Chain(3, 1.0, 0.25, -1.0), 1, 0.2, tolerance=1e-9, **options).at(S=0.2)


def motion() -> Any:
    return simulate(HOPF, [0.1, 0.0], np.linspace(0.0, 60.0, 601), parameters={"mu": 0.25})


OTHERS: dict[str, Callable[[], Any]] = {
    "orbit of a family by collocation": lambda: member_by(transcription="gauss"),
    "orbit of a family by shooting": lambda: member_by(transcription="shooting"),
    "orbit of an infinite chain": lambda: endless_family().orbits[-1],
    "family": family,
    "cycles": lambda: cycle().follow("mu", 0.5),
    "solutions": lambda: solution().follow("mu", 2.0),
}


@pytest.mark.parametrize("name", [*SLOWER, *OTHERS])
def test_every_name_of_a_result_is_a_value_or_no_attribute(name: str) -> None:
    result = OTHERS[name]() if name in OTHERS else made(name)
    for attribute in (name for name in dir(type(result)) if not name.startswith("_")):
        if not hasattr(result, attribute):  # which itself raises what is no AttributeError
            with pytest.raises(AttributeError) as reason:
                getattr(result, attribute)
            assert "\n" not in str(reason.value)


def test_what_a_kind_of_result_has_not_is_named() -> None:
    for result, missing in (
        (rest(), ("t", "mesh", "states", "intervals", "objective")),
        (cycle(), ("S", "energy", "objective", "Omega_shift")),
        (member_by(), ("mesh", "intervals", "problem", "statement", "objective")),
        (solution(), ("stable", "objective", "status")),
    ):
        assert [name for name in missing if hasattr(result, name)] == []
    with pytest.raises(ValueError, match="energy: Hopf declares no hamiltonian"):
        _ = cycle().energy
    with pytest.raises(ValueError, match=r"mesh: the solution is not one of collocation; accepted: evaluate\(t\)"):
        _ = member_by().mesh


@pytest.mark.parametrize(
    ("options", "least", "intervals"),
    [({}, 4, False), ({"transcription": "gauss"}, 5, True), ({"transcription": "shooting"}, 2, False)],
)
def test_times_and_states_of_an_orbit_of_a_family(options: dict[str, Any], least: int, intervals: bool) -> None:
    """Within the quarter that was unknown, and on the orbit that odd cosines give."""
    orbit, exact = member_by(**options), member_by()
    assert orbit.t.size >= least
    assert np.all(np.diff(orbit.t) > 0.0)
    assert 0.0 <= orbit.t[0] < orbit.t[-1] <= 0.25 * orbit.period * (1 + 1e-14)
    assert orbit.states.shape == (orbit.t.size, 3)
    np.testing.assert_allclose(orbit.states, exact.evaluate(orbit.t), atol=1e-8)
    np.testing.assert_array_equal(orbit[orbit.space.state_names[1]], orbit.states[:, 1])
    assert hasattr(orbit, "mesh") == intervals
    if intervals:
        assert orbit.mesh.size == orbit.intervals + 1
        np.testing.assert_allclose(orbit.mesh[[0, -1]], [0.0, 0.25 * orbit.period], rtol=1e-14)
        assert np.isin(np.round(orbit.mesh, 12), np.round(orbit.t, 12)).all()


@pytest.mark.parametrize("make", [member, OTHERS["orbit of an infinite chain"], cycle, solution, motion])
def test_one_time_gives_one_state_and_several_a_row_each(make: Callable[[], Any]) -> None:
    result = make()
    several = result.evaluate([0.1, 0.4, 0.7])
    one = result.evaluate(0.4)
    assert one.shape == several.shape[1:]
    np.testing.assert_allclose(one, several[1], rtol=1e-14)
    assert result.evaluate(np.float64(0.4)).shape == one.shape
    assert result.evaluate([0.4]).shape == (1, *one.shape)


def test_an_equilibrium_and_a_simulated_cycle_have_the_same_shapes() -> None:
    guess = motion().last_cycle()
    for result in (rest(), guess):
        assert result.evaluate(0.5).shape == (2,)
        assert result.evaluate([0.5]).shape == (1, 2)
        assert result.evaluate([0.5, 1.0]).shape == (2, 2)
