"""Scenes of equilibria: their tables, files and pictures; what is refused, in one line."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from casadi_skin import OdeModel, find_orbit, simulate
from casadi_skin.runs.program import main

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"

MODEL = """
import casadi as ca
from casadi_skin import OdeModel, BoundaryValueProblem
x, y, p, t = (ca.SX.sym(n) for n in "xypt")
crossing = OdeModel("crossing", x, x * (1 - p**2 - x), p, nominal=(-2.0,))
cubic = OdeModel("cubic", ca.vertcat(x, y), ca.vertcat(p + x - x**3, -y), p, nominal=(-1.0,))
v = (p - y**2) * y - x + p
rayleigh = OdeModel("rayleigh", ca.vertcat(x, y), ca.vertcat(y, v), p, nominal=(0.75,))
twins = OdeModel("twins", ca.vertcat(x, y), ca.vertcat(p * x - x**3, p * y - y**3), p)
forced = OdeModel("forced", x, ca.cos(t) - x, time=t, forcing_period=6.28)
"""


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write(tmp_path: Path, name: str, rest: str) -> Path:
    (tmp_path / "model.py").write_text(MODEL, encoding="utf-8")
    scene = tmp_path / "scene.toml"
    scene.write_text(f'[model]\nfile = "model.py"\nname = "{name}"\n{rest}', encoding="utf-8")
    return scene


@pytest.mark.usefixtures("blank")
def test_values_of_states_are_special_points_of_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On the branch x^3 - x = p of the cubic."""
    branch = '[equilibrium]\nstart = { x = -1.3 }\n[continuation]\nparameter = "p"\nto = 1.0\nmonitors = '
    scene = write(tmp_path, "cubic", branch + "{ x = 0.5 }\n")
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    (point,) = (one for one in rows(tmp_path / "out" / "special_points.csv") if one["kind"] == "x = 0.5")
    assert float(point["p"]) == pytest.approx(0.5**3 - 0.5, abs=1e-9)
    assert "x = 0.5" in rows(tmp_path / "out" / "branch.csv")[0]
    assert main(["check", str(write(tmp_path, "cubic", branch + "{ z = 0.5 }\n"))]) == 2
    assert '[continuation] monitors: given "z"; accepted: x, y' in capsys.readouterr().err


@pytest.mark.slow
def test_the_example_of_carbon_monoxide(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Values published in MatCont's manual for the catalytic oscillator, to the digits printed there."""
    out = tmp_path / "out"
    assert main(["run", str(EXAMPLES / "carbon_monoxide.toml"), "--out", str(out)]) == 0
    points = rows(out / "special_points.csv")
    on_branch = [(p["kind"], round(float(p["q2"]), 5)) for p in points if p["branch"] == "branch"]
    assert on_branch == [("hopf", 1.05156), ("fold", 1.04205), ("fold", 1.05220), ("hopf", 1.04099)]
    assert {p["kind"] for p in points if p["branch"] != "branch"} == {"cusp", "generalized hopf"}
    assert all(0.0 < float(p["error"]) < 1e-10 for p in points)
    for name in ("branch.csv", "branch.nc", "branch.png", "curves.png", "curve_1.csv", "curve_2.nc"):
        assert (out / name).exists(), name
    assert not (out / "curve_3.csv").exists()  # the second fold is on the curve of the first one
    folds = rows(out / "curve_2.csv")
    assert list(folds[0])[3:5] == ["k", "q2"]
    printed = capsys.readouterr().out
    assert "curve" in printed
    assert "subcrit" in printed


@pytest.mark.slow
def test_the_example_of_prey_and_predators(tmp_path: Path) -> None:
    """Closed forms: predators enter at K = 1; the balance is lost at K = 3, at x = 1 and with frequency 1/sqrt(3)."""
    out = tmp_path / "out"
    assert main(["run", str(EXAMPLES / "prey_and_predators.toml"), "--out", str(out), "--quiet"]) == 0
    enter, lost = rows(out / "special_points.csv")
    assert (enter["branch"], enter["kind"], lost["branch"], lost["kind"]) == (
        "branch",
        "branch point",
        "other_1",
        "hopf",
    )
    assert abs(float(enter["K"]) - 1.0) < 1e-12
    assert abs(float(lost["K"]) - 3.0) < 1e-12
    assert abs(float(lost["frequency"]) - 3.0**-0.5) < 1e-12
    assert lost["criticality"] == "supercritical"
    assert (out / "portrait.png").exists()
    cycles = rows(out / "cycles_1_1.csv")
    assert float(cycles[0]["period"]) == pytest.approx(2.0 * np.pi * 3.0**0.5, rel=1e-10)
    assert float(cycles[-1]["K"]) == 5.0
    assert {row["stable"] for row in cycles} == {"1"}
    other = rows(out / "other_1.csv")
    np.testing.assert_allclose([float(row["x"]) for row in other], 1.0, rtol=1e-10)
    assert [row["special"] for row in other].count("hopf") == 1


@pytest.mark.slow
def test_an_interrupted_diagram_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from casadi_skin.runs.progress import Progress

    scene, whole, part = EXAMPLES / "prey_and_predators.toml", tmp_path / "whole", tmp_path / "part"
    assert main(["run", str(scene), "--out", str(whole), "--quiet"]) == 0
    seen = iter(range(25))

    def interrupt(self: Progress, solution: object, points: int) -> None:
        if next(seen, None) is None:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Progress, "solution", interrupt)
        assert main(["run", str(scene), "--out", str(part), "--quiet"]) == 130
    assert main(["run", str(scene), "--out", str(part), "--quiet", "--resume"]) == 0
    for name in ("branch.csv", "other_1.csv", "cycles_1_1.csv", "special_points.csv"):
        one, other = rows(whole / name), rows(part / name)
        assert len(one) == len(other), name
        for before, after in zip(one, other, strict=True):
            for key, value in before.items():
                try:
                    assert float(after[key]) == pytest.approx(float(value), rel=1e-6, abs=1e-6), (name, key)
                except ValueError:
                    assert after[key] == value


@pytest.mark.slow
def test_a_whole_diagram_has_both_halves_of_what_crosses(tmp_path: Path) -> None:
    """x' = x (1 - p^2 - x): x = 1 - p^2 crosses x = 0 at p = -1 and at p = 1."""
    rest = '[continuation]\nparameter = "p"\nto = 2.0\ndepth = 1\n'
    rest = f"parameters = {{ p = -2.0 }}\n[equilibrium]\nstart = [0]\n{rest}"
    scene, out = write(tmp_path, "crossing", rest), tmp_path / "out"
    assert main(["run", str(scene), "--out", str(out), "--quiet"]) == 0
    points = rows(out / "special_points.csv")
    assert {(point["kind"], round(float(point["p"]), 12)) for point in points} == {
        ("branch point", -1.0), ("branch point", 1.0),
    }  # fmt: skip
    for name, end in (("other_1", 2.0), ("other_1b", -2.0)):
        other = rows(out / f"{name}.csv")
        assert float(other[-1]["p"]) == end
        assert all(abs(float(row["x"]) - 1.0 + float(row["p"]) ** 2) < 1e-10 for row in other)
    assert not list(out.glob("other_2*"))
    scene.write_text(scene.read_text(encoding="utf-8") + "limit = 2\n", encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "limited"), "--quiet"]) == 1


@pytest.mark.slow
def test_the_equilibria_to_which_cycles_shrink_leave_an_orbit(tmp_path: Path) -> None:
    """Cycles about x = p, born at p = 0: the equilibria go on to -1 with stable focus, and without one cycle more."""
    start = '[orbit]\nstart = [1.9, 0.0]\nperiod = 6.28\n[figures]\nformats = []\n[continuation]\nparameter = "p"\n'
    scene, out = write(tmp_path, "rayleigh", f'{start}to = -1.0\nswitch = ["hopf"]\n'), tmp_path / "out"
    assert main(["run", str(scene), "--out", str(out), "--quiet"]) == 1  # the cycles end before -1
    assert [(p["branch"], p["kind"]) for p in rows(out / "special_points.csv")] == [
        ("branch", "hopf"),
        ("other_1", "hopf"),
    ]
    at_rest = rows(out / "other_1.csv")
    assert {(row["stable"], row["y"]) for row in at_rest[1:]} == {("1", "0")}
    assert [float(row["p"]) for row in at_rest[:: len(at_rest) - 1]] == [0.0, -1.0]
    assert all(abs(float(row["x"]) - float(row["p"])) < 1e-12 for row in at_rest)
    assert sorted(path.name for path in out.glob("*_1*.csv")) == ["other_1.csv"]


def test_what_is_not_resolved_is_in_every_answer_of_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two branch points at once: the table, standard error and the exit status name the stretch, again on resuming."""
    scene = write(
        tmp_path, "twins", "[model.parameters]\np = -1.0\n[equilibrium]\nstart = [0.0, 0.0]\n"
        '[continuation]\nparameter = "p"\nto = 1.0\n',
    )  # fmt: skip
    arguments = ["run", str(scene), "--out", str(tmp_path / "out")]
    for more in ([], ["--resume"]):
        assert main([*arguments, *more]) == 1
        (words,) = capsys.readouterr().err.splitlines()[-1:]
        assert "[continuation]: not resolved: branch point at p = " in words
        points = rows(tmp_path / "out" / "special_points.csv")
        assert [point["kind"] for point in points] == ["branch point", "unresolved"]
        assert abs(float(points[1]["p"])) <= 2.0 * float(points[1]["error"]) < 1e-5


def test_a_single_equilibrium_has_one_row(tmp_path: Path) -> None:
    scene, out = write(tmp_path, "cubic", "[equilibrium]\nstart = [-1.2, 0.1]\n"), tmp_path / "out"
    assert main(["run", str(scene), "--out", str(out), "--quiet"]) == 0
    (row,) = rows(out / "branch.csv")
    assert abs(-1.0 + float(row["x"]) - float(row["x"]) ** 3) < 1e-12
    assert row["stable"] == "1"


def test_check_tells_the_plan(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(EXAMPLES / "prey_and_predators.toml")]) == 0
    printed = capsys.readouterr().out
    assert "near x = 0.5, y = 0" in printed
    assert "branches at every branch point and hopf" in printed


@pytest.mark.parametrize(
    ("name", "rest", "words"),
    [
        ("forced", "[equilibrium]\nstart = [0]\n", "[equilibrium]: given with forced, which is forced"),
        ("cubic", "[equilibrium]\nstart = [0]\n", "[equilibrium] start: given a list of 1; accepted: 2 numbers: x, y"),
        ("cubic", "[equilibrium]\nstart = { z = 1 }\n", "[equilibrium] start: "),
        ("cubic", "[equilibrium]\n", "[equilibrium] start: missing"),
        ("cubic", "[equilibrium]\nstart=[0,0]\n[orbit]\nstart=[0,0]\n", "[orbit]: given beside [equilibrium]"),
        ("cubic", "[equilibrium]\nstart=[0,0]\n[stability]\n", "[stability]: given without [family], [orbit] or "),
        ("cubic", "[equilibrium]\nstart=[0,0]\n[method]\ndegree = 3\n", "[method]: given beside [equilibrium]"),
        (
            "cubic", '[equilibrium]\nstart=[0,0]\n[continuation]\nparameter="p"\nto=1\nswitch=["fold"]\n',
            '[continuation] switch: given "fold" as item 1; accepted: a list of "hopf", "branch point", "period ',
        ),
        (
            "cubic", '[equilibrium]\nstart=[0,0]\n[continuation]\nparameter="p"\nto=1\ncurve={parameter="q",to=1}\n',
            "[continuation] curve: ",
        ),
        (
            "cubic", '[equilibrium]\nstart=[0,0]\n[continuation]\nparameter="p"\nto=1\ncurve={parameter="p",to=1}\n',
            '[continuation] curve: given parameter = "p" again; accepted: another parameter',
        ),
        (
            "cubic", '[orbit]\nstart=[0,0]\nperiod=1\n[continuation]\nparameter="p"\nto=1\nswitch=["branch point"]\n',
            '[continuation] switch: given "branch point" without [stability]; accepted: with [stability]',
        ),
        (
            "cubic", '[orbit]\nstart=[0,0]\nperiod=1\n[continuation]\nparameter="p"\nto=1\ndepth=2\n',
            "[continuation] depth: given 2 beside [orbit] without [stability]; accepted: with [stability]",
        ),
        (
            "cubic", '[equilibrium]\nstart=[0,0]\n[continuation]\nparameter="p"\nto=1\nswitch=["period doubling"]\n',
            '[continuation] switch: given "period doubling" without [stability]; accepted: with [stability]',
        ),
    ],
)  # fmt: skip
def test_what_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, rest: str, words: str) -> None:
    scene, out = write(tmp_path, name, rest), tmp_path / "out"
    assert main(["run", str(scene), "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert len(error.strip().splitlines()) == 1
    assert not out.exists()


def test_what_is_not_found_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rest = "parameters = { p = 0.0 }\n[equilibrium]\nstart = [0.0, 0.0]\ntransient = 0.5\n"
    scene = write(tmp_path, "cubic", rest.replace("[0.0, 0.0]", "[0.1, 1.0]"))
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--quiet"]) == 1
    assert "does not settle" in capsys.readouterr().err


@pytest.mark.slow
def test_the_lines_of_the_page_give_the_numbers_that_it_tells() -> None:
    text = (ROOT / "docs" / "equilibria.md").read_text(encoding="utf-8")
    block = text.split("```python\n")[1].split("```")[0]
    names: dict[str, Any] = {}
    exec(compile(block, "equilibria.md", "exec"), names)
    fold, hopf, curve = (names[name] for name in ("fold", "hopf", "curve"))
    assert repr(fold).startswith("<fold at p = 0.105738978272 +- ")
    assert repr(hopf).startswith("<hopf at p = 0.13090004482 +- ")
    assert hopf.frequency == pytest.approx(4.0077747, abs=5e-8)
    assert hopf.coefficient == pytest.approx(-0.3889545, abs=5e-8)
    assert curve.special_points[-1].kind == "cusp"
    x = 0.5 * (1.0 - np.sqrt(1.0 - 12.0 / 14.0))
    assert abs(fold.parameters["p"] - x * np.exp(-14.0 * x / 3.0) / (1.0 - x)) < 1e-16


@pytest.mark.slow
def test_the_example_of_roessler_follows_its_period_doublings(tmp_path: Path) -> None:
    """On the curve the multiplier is -1, by CVODES and not by collocation."""
    out = tmp_path / "out"
    assert main(["run", str(EXAMPLES / "roessler.toml"), "--out", str(out)]) == 0
    (doubling,) = rows(out / "special_points.csv")
    assert (doubling["kind"], doubling["criticality"]) == ("period doubling", "supercritical")
    assert float(doubling["c"]) == pytest.approx(2.832445, abs=1e-6)
    curve = rows(out / "curve_1.csv")
    assert (float(curve[0]["a"]), float(curve[-1]["a"])) == (0.2, 0.22)
    assert (out / "curves.png").exists()
    x, y, z, c = (ca.SX.sym(name) for name in "xyzc")
    a, at = float(curve[-1]["a"]), float(curve[-1]["c"])
    model = OdeModel("Roessler", ca.vertcat(x, y, z), ca.vertcat(-y - z, x + a * y, 0.2 + z * (x - c)), c)
    cycle = simulate(model, [3.0, 0.0, 0.0], np.linspace(0.0, 200.0, 4001), parameters={"c": at - 0.2}).last_cycle()
    orbit = find_orbit(model, cycle, parameters={"c": at - 0.2}).follow("c", at).orbits[-1]
    assert np.min(np.abs(orbit.floquet(by="cvodes").multipliers + 1.0)) < 1e-5


def test_a_requested_value_that_is_a_special_point_is_one_in_the_tables(tmp_path: Path) -> None:
    """x (1 - p^2 - x) = 0 branches at p = -1 and 1, where the run ends: both are requested, and none is missing."""
    more = '[equilibrium]\nstart = [0.0]\n[continuation]\nparameter = "p"\nto = 1.0\nat = [-1.0, 0.5]\n'
    out = tmp_path / "out"
    assert main(["run", str(write(tmp_path, "crossing", more)), "--out", str(out), "--quiet"]) == 0
    assert [(row["kind"], float(row["p"])) for row in rows(out / "special_points.csv")] == [
        ("branch point", -1.0),
        ("branch point", 1.0),
    ]
    branch = rows(out / "branch.csv")
    assert [float(row["p"]) for row in branch if row["special"]] == [-1.0, 1.0]
    assert [row["special"] for row in branch if float(row["p"]) == -1.0] == ["branch point"]
    assert float(branch[-1]["p"]) == 1.0
