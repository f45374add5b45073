"""Results print as a few lines, are tables with a picture in notebooks, draw themselves and become tables."""

from __future__ import annotations

import builtins
import subprocess
import sys
from typing import Any

import casadi as ca
import numpy as np
import pytest
from matplotlib.figure import Figure

from casadi_skin import BoundaryValueProblem, Chain, OdeModel, find_equilibrium, find_orbit, follow_family, simulate
from casadi_skin.results.solutions import SAMPLES

X, Y, MU = (ca.SX.sym(name) for name in ("x", "y", "mu"))
HOPF = OdeModel(
    "Hopf", ca.vertcat(X, Y), ca.vertcat(MU * X - Y - X * (X**2 + Y**2), X + MU * Y - Y * (X**2 + Y**2)), MU
)
LINE = OdeModel("line", ca.vertcat(X, Y), ca.vertcat(Y, -MU * X), MU)


def axes() -> Any:
    return Figure().add_subplot()


@pytest.fixture(scope="module")
def shown() -> dict[str, Any]:
    """One result of each kind."""
    family = follow_family(Chain(2, 1.0, 0.25, 1.0), 1, 0.1, stability=True, tolerance=1e-4, at=[0.05])
    t = np.linspace(0, 2 * np.pi, 40)
    circle = (t, 0.5 * np.stack([np.cos(t), np.sin(t)]))
    orbit = find_orbit(HOPF, circle, 6.0, parameters={"mu": 0.25}, tolerance=1e-4, corrector="newton")
    rest = find_equilibrium(HOPF, [0.0, 0.0], parameters={"mu": -0.25})
    problem = BoundaryValueProblem(LINE, [LINE.start(X), LINE.end(X) - 1], parameters={"mu": 1.0})
    return {
        "family": family, "mode": family.orbits[-1], "orbit": orbit, "floquet": orbit.floquet(), "equilibrium": rest,
        "branch": rest.follow("mu", 0.1), "spectrum": rest.spectrum, "problem": problem,
        "solution": problem.solve([0.0, 1.0], tolerance=1e-4),
        "evolution": simulate(HOPF, [0.1, 0.0], np.linspace(0, 9, 50), parameters={"mu": 0.25}),
        "special": rest.follow("mu", 0.1).special_points[0], "diagram": family.stability_diagram,
    }  # fmt: skip


RESULTS = ("family", "mode", "orbit", "floquet", "equilibrium", "branch", "spectrum", "solution", "evolution")


def test_everything_prints_as_a_few_lines(shown: dict[str, Any]) -> None:
    for name, thing in shown.items():
        assert "\n" not in repr(thing), name
        assert len(repr(thing)) < 200, name
        assert str(thing).count("\n") < 10, name
        assert all(len(line) < 140 for line in str(thing).splitlines()), name


def test_print_tells_the_numbers(shown: dict[str, Any]) -> None:
    assert f"Omega       {shown['mode'].Omega:.12g} +- " in str(shown["mode"])
    assert "hopf at 0" in str(shown["branch"]) or "hopf at -" in str(shown["branch"])
    assert "Branch of equilibria of Hopf" in str(shown["branch"])
    assert "-0.25+1i, -0.25-1i" in str(shown["spectrum"])
    assert "stable" in str(shown["floquet"])
    plain = follow_family(Chain(2, 1.0, 0.25, 1.0), 1, 0.05, tolerance=1e-4)
    assert "not computed; stability=True" in str(plain)
    assert not any("not computed" in str(shown[name]) for name in ("family", "branch"))


def test_a_branch_is_iterated_over_its_solutions(shown: dict[str, Any]) -> None:
    for name in ("family", "branch"):
        assert list(shown[name]) == list(shown[name].solutions)
        assert len(list(shown[name])) == len(shown[name]) > 1


def test_printing_computes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    family = follow_family(Chain(2, 1.0, 0.25, 1.0), 1, 0.05, stability=True, tolerance=1e-4)
    monkeypatch.setattr(type(family.space), "floquets", None)
    assert "changes of stability" not in f"{family}{family!r}"
    assert "stability_diagram" not in vars(family)


@pytest.mark.slow
def test_notebooks_show_a_table_with_a_picture(shown: dict[str, Any]) -> None:
    for name in RESULTS:
        page = shown[name]._repr_html_()
        assert "<table><caption>" in page, name
        assert "data:image/png;base64," in page, name


def test_results_draw_into_axes_that_are_given(shown: dict[str, Any]) -> None:
    for name in RESULTS:
        given = axes()
        assert shown[name].plot(given) is given
        assert given.lines, name
    given = shown["branch"].plot(axes(), y="x")
    assert given.get_ylabel() == "x"
    drawn = shown["family"].plot(axes(), x="Omega", y="period").lines[0].get_xydata()
    np.testing.assert_allclose(drawn[:, 0] * drawn[:, 1], 2 * np.pi)
    assert [line.get_label() for line in shown["orbit"].plot(axes(), states=["y"]).lines] == ["y"]


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("branch", {"y": "z"}, "did you mean|accepted: "),
        ("orbit", {"states": ["z"]}, "accepted: x, y"),
        ("orbit", {"states": "x"}, "accepted: a list of names"),
        ("family", {"axes": 3}, "accepted: axes of matplotlib"),
        ("orbit", {"sites": ["y_1"]}, "plot: given the option 'sites'; did you mean states. accepted: states"),
    ],
)
def test_what_cannot_be_drawn_is_refused(name: str, options: dict[str, Any], words: str, shown: dict[str, Any]) -> None:
    with pytest.raises((ValueError, TypeError), match=words):
        shown[name].plot(**({"axes": axes()} | options))


@pytest.mark.slow
def test_results_become_tables(shown: dict[str, Any]) -> None:
    family, orbit = shown["family"], shown["orbit"]
    assert family.to_dataframe()["Omega"].tolist() == family.Omega.tolist()
    assert family.to_xarray()["Omega"].values.tolist() == family.Omega.tolist()
    frame = orbit.to_dataframe()
    assert frame.columns.tolist() == ["t", "x", "y"]
    assert len(frame) == SAMPLES
    np.testing.assert_allclose(np.hypot(frame["x"], frame["y"]), 0.5, atol=1e-3)
    assert orbit.to_xarray()["x"].dims == ("t",)
    assert shown["floquet"].to_dataframe()["trivial"].tolist() == [True, False]
    assert shown["spectrum"].to_dataframe()["real"].tolist() == [-0.25, -0.25]
    assert shown["branch"].to_dataframe()["special"].tolist().count("hopf") == 1
    assert shown["equilibrium"].to_dataframe()["stable"].tolist() == [True]


@pytest.mark.parametrize(("package", "verb"), [("pandas", "to_dataframe"), ("xarray", "to_xarray")])
def test_a_missing_extra_is_named(
    package: str, verb: str, shown: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def importing(name: str, *rest: Any, **more: Any) -> Any:
        if name == package:
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", importing)
    with pytest.raises(ImportError, match=rf"casadi-skin\[{package}\]"):
        getattr(shown["family"], verb)()


@pytest.mark.slow
def test_nothing_that_draws_or_tabulates_is_imported_before_it_is_asked_for() -> None:
    code = (
        "import sys; from casadi_skin import *; "
        "print([m for m in ('matplotlib.pyplot', 'matplotlib.figure', 'pandas', 'xarray') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
