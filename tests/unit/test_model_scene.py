"""Scenes of any model: what is accepted, the one line that names each fault, and what a branch's columns say."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from refusals import refusals

from casadi_skin.model.loading import ModelFileError, named, read_source, run_file
from casadi_skin.results.quantities import Place, extremes
from casadi_skin.runs.binding import bind
from casadi_skin.runs.first_solution import cycle, first_solution
from casadi_skin.runs.reading import parse_scene
from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import Scene

MODEL = '[model]\nfile = "models.py"\nname = "{name}"\n'
MODELS = """
import casadi as ca
from casadi_skin import BoundaryValueProblem, OdeModel

x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
van_der_pol = OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu)
pendulum = OdeModel(
    "pendulum", ca.vertcat(x, y), ca.vertcat(y, -mu * ca.sin(x)), mu, nominal=(1.0,),
    reversal=(1, -1), half_period=(-1, -1), hamiltonian=y**2 / 2 - mu * ca.cos(x),
)
t = ca.SX.sym("t")
forced = OdeModel(
    "forced", ca.vertcat(x, y), ca.vertcat(y, -x - 0.5 * y + ca.cos(mu * t)), mu, time=t,
    forcing_period=2 * ca.pi / mu,
)
bratu = OdeModel("Bratu", ca.vertcat(x, y), ca.vertcat(y, -mu * ca.exp(x)), mu)
bounded = BoundaryValueProblem(bratu, [bratu.start(x), bratu.end(x)], parameters={"mu": 1.0})
best = BoundaryValueProblem(
    bratu, [bratu.start(x), bratu.end(x)], parameters={"mu": 1.0}, free=["mu"], objective=(mu - 1) ** 2
)
number = 3

def makes():
    return van_der_pol

def with_argument(a):
    return van_der_pol

def fails():
    return 1 / 0

def guess(t):
    return [t * (1 - t), 1 - 2 * t]

def guess_of_three(t):
    return [t, t, t]

q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)

def pair(coupling=0.1, reversal=(1, 1, -1, -1)):
    potential = ca.sumsqr(q) / 2 + coupling * (q[0] - q[1]) ** 2 / 2 + mu * ca.sum1(q**4) / 4
    return OdeModel(
        "pair", q, -ca.gradient(potential, q), mu, 2, v, nominal=(1.0,), reversal=reversal, half_period=(-1,) * 4,
        hamiltonian=ca.sumsqr(v) / 2 + potential,
    )

def equal():
    return pair(0.0)

def irreversible():
    return pair(reversal=None)
"""
CHAIN = "[chain]\nsites = 2\nalpha = 1.0\ngamma = 0.25\ng = 1.0\n"
ORBIT = "[orbit]\nstart = [2.0, 0.0]\nperiod = 6.6\n"
CHAIN_ORBIT = "[orbit]\nstart = [0.0, 0.5, 0.0, 0.0]\nperiod = 3.0\nselect = { y_2 = 0.5 }\nsymmetric = true\n"
SYMMETRIC = "[orbit]\nstart = [1.0, 0.0]\nperiod = 6.7\nselect = { x = 1.0 }\nsymmetric = true\n"


TABLES = {"<orbit>": ORBIT, "<chain>": CHAIN, "<symmetric>": SYMMETRIC, "<chain orbit>": CHAIN_ORBIT}
KNOWN = re.findall(r"^(?:def )?(\w+)", f"{MODELS}van_der_po", re.MULTILINE)  # and one that is misspelt
TABLES |= {f"<model {name}>": MODEL.format(name=name) for name in KNOWN}
REFUSED = refusals(Path(__file__).with_name("refused_models.txt"), TABLES)


def scene_of(name: str, rest: str = "", parameters: str = "") -> str:
    given = f"parameters = {{ {parameters} }}\n" if parameters else ""
    return MODEL.format(name=name) + given + rest


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "models.py").write_text(MODELS, encoding="utf-8")
    return tmp_path


def parsed(text: str) -> Scene:
    return parse_scene(text, "scene.toml")


def bound(text: str, folder: Path) -> Request:
    return bind(parsed(text), folder / "scene.toml")


def fault_of(text: str, folder: Path) -> str:
    """The message of the fault, found in the scene or with the model, checked to be one line."""
    with pytest.raises(SceneError) as caught:
        bound(text, folder)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 500
    return message.removeprefix("scene.toml: ").replace(f"{folder}/", "")


# Reading --------------------------------------------------------------------------------------------------


def test_a_scene_of_a_model_and_one_of_a_chain_are_told_apart() -> None:
    scene = parsed(scene_of("van_der_pol", ORBIT, "mu = 1"))
    assert scene.model.parameters == {"mu": 1.0}
    assert scene.orbit.start == (2.0, 0.0)
    assert scene.given("solution", "continuation", "stability", "chain") == []
    assert not parsed("[chain]\nsites = 3\nalpha = 1\ngamma = 0\ng = 1\n").same_request(scene)
    assert scene.same_request(parsed('title = "another"\n' + scene_of("van_der_pol", ORBIT, "mu = 1.0")))
    named = '[method]\ntranscription = "gauss"\nflow = "collocation"\n'
    for method, same in ((named, True), (named.replace("gauss", "radau"), False)):
        assert scene.same_request(parsed(scene_of("van_der_pol", ORBIT + method, "mu = 1"))) is same


# With the model -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scene", "message"), REFUSED, ids=[message[:60] for _, message in REFUSED])
def test_refused_scenes_of_models(scene: str, message: str, folder: Path) -> None:
    assert fault_of(scene, folder) == message


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("def f(:\n", "user.py, line 1: SyntaxError: invalid syntax"),
        ("x = 1\nraise ValueError('two\\nlines')\n", "user.py, line 2: ValueError: two lines"),
        ("import sys\nsys.exit()\n", "user.py, line 2: SystemExit"),
        ("import not_there_at_all\n", "user.py, line 1: ModuleNotFoundError: No module named 'not_there_at_all'"),
        ("def f():\n    return f()\nf()\n", "user.py, line 2: RecursionError: maximum recursion depth exceeded"),
    ],
)
def test_what_a_python_file_raises_is_told_in_a_line(source: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ModelFileError) as caught:
        run_file(tmp_path / "user.py", source)
    assert str(caught.value).removeprefix(f"{tmp_path}/").startswith(message)
    assert "\n" not in str(caught.value)


def test_a_python_file_imports_what_is_beside_it_and_leaves_the_path_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "constants_beside.py").write_text("MU = 2.5\n", encoding="utf-8")
    before = list(sys.path)
    names = run_file(tmp_path / "user.py", "from constants_beside import MU\n")
    assert names["MU"] == 2.5
    assert sys.path == before
    assert named(tmp_path / "user.py", names, "MU", (float,)) == 2.5


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "latin.py").write_bytes(b"\xff")
    for name in ("missing.py", "latin.py", "."):
        with pytest.raises(ModelFileError, match="accepted: a"):
            read_source(tmp_path / name)


# First orbits and solutions -------------------------------------------------------------------------------


def test_a_forced_orbit_is_that_of_the_linear_oscillator(folder: Path) -> None:
    text = "[orbit]\nstart = { x = 1.0 }\ntransient = 30.0\ncycles = 2\n"
    request = bound(scene_of("forced", text, "mu = 1.7"), folder)
    guess = cycle(request)
    assert guess.period == pytest.approx(2 * 2 * np.pi / 1.7)
    assert guess.start == pytest.approx(5 * guess.period)  # the first multiple at 30 or after it
    orbit = first_solution(request)
    t = np.linspace(0.0, 7.0, 50)
    exact = (np.exp(1.7j * t) / (1 - 1.7**2 + 0.5j * 1.7)).real
    np.testing.assert_allclose(orbit.evaluate(t)[:, 0], exact, atol=1e-8)
    np.testing.assert_allclose(extremes(orbit)[1][0], 1 / abs(1 - 1.7**2 + 0.5j * 1.7), atol=1e-8)


@pytest.mark.parametrize("select", ["select = { x = 1.0 }\nsymmetric = true", "select = { hamiltonian = HERE }"])
def test_the_pendulum_has_the_period_of_the_elliptic_integral(select: str, folder: Path) -> None:
    from scipy.special import ellipk

    energy = f"{-np.cos(1.0):.17g}"
    text = "[orbit]\nstart = [1.0, 0.0]\nperiod = 6.7\n" + select.replace("HERE", energy) + "\n"
    scene = text + "[continuation]\nparameter = 'select'\nto = 1.2\n[stability]\n"
    request = bound(scene_of("pendulum", scene), folder)
    orbit = first_solution(request)
    assert orbit.parameters["period"] == pytest.approx(4 * ellipk(np.sin(0.5) ** 2), abs=1e-8)
    assert "select" in orbit.parameters
    low, high = extremes(orbit)
    np.testing.assert_allclose([*low, *high], [-1.0, -2 * np.sin(0.5), 1.0, 2 * np.sin(0.5)], atol=1e-7)


def test_a_cycle_after_a_transient_begins_at_the_section(folder: Path) -> None:
    """Period and amplitude at mu = 1 are those of Andersen and Geer 1982; from the transient's end none is found."""
    text = "[orbit]\nstart = [2.0, 0.0]\ntransient = 200.0\nsection = { y = 0.0 }\n"
    orbit = first_solution(bound(scene_of("makes", text, "mu = 1.0"), folder))
    assert orbit.parameters["period"] == pytest.approx(6.6632868593231, abs=1e-9)
    np.testing.assert_allclose(np.abs(orbit.evaluate(0.0)), [2.0086198608748, 0.0], atol=1e-8)


@pytest.mark.slow
def test_a_solution_from_a_guess_in_the_file(folder: Path) -> None:
    request = bound(scene_of("bounded", "[solution]\nguess = 'guess'\n"), folder)
    solution = first_solution(request)
    point = Place(solution, 0)
    assert point.extremes[1][0] == pytest.approx(0.14053921440047, abs=1e-9)  # at the middle, by symmetry
    assert point.extremes[1][1] == pytest.approx(solution.evaluate(0.0)[1])  # of u' at the start
