"""Scenes of any model: what is accepted, the one line that names each fault, and what a branch's columns say."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from casadi_skin.model.loading import ModelFileError, named, read_source, run_file
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.saved import save_model
from casadi_skin.results.quantities import Place, extremes
from casadi_skin.runs.binding import bind
from casadi_skin.runs.first_solution import cycle, first_solution
from casadi_skin.runs.reading import parse_scene, scene_schema
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
FAMILY = "[family]\nmode = {mode}\namplitude_max = 1.0\n"
ORBIT = "[orbit]\nstart = [2.0, 0.0]\nperiod = 6.6\n"
CHAIN_ORBIT = "[orbit]\nstart = [0.0, 0.5, 0.0, 0.0]\nperiod = 3.0\nselect = { y_2 = 0.5 }\nsymmetric = true\n"
SYMMETRIC = "[orbit]\nstart = [1.0, 0.0]\nperiod = 6.7\nselect = { x = 1.0 }\nsymmetric = true\n"


def scene_of(name: str, rest: str = "", parameters: str = "") -> str:
    given = f"parameters = {{ {parameters} }}\n" if parameters else ""
    return MODEL.format(name=name) + given + rest


def family_of(name: str, mode: str, rest: str = "", parameters: str = "") -> str:
    return scene_of(name, FAMILY.format(mode=mode) + rest, parameters)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "models.py").write_text(MODELS, encoding="utf-8")
    return tmp_path


def parsed(text: str) -> Scene:
    return parse_scene(text, "scene.toml")


def _read(text: str, folder: Path | None) -> None:
    scene = parsed(text)
    assert folder is not None
    bind(scene, folder / "scene.toml")


def fault_of(text: str, folder: Path | None = None) -> str:
    """The message of the fault, found with the model where a folder has it, checked to be one line."""
    with pytest.raises(SceneError) as caught:
        _read(text, folder)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 500
    return message.removeprefix("scene.toml: ").replace(f"{folder}/", "")


# Reading --------------------------------------------------------------------------------------------------


def test_a_scene_of_a_model_and_one_of_a_chain_are_told_apart() -> None:
    scene = parsed(scene_of("van_der_pol", ORBIT, "mu = 1"))
    assert scene.model.parameters == {"mu": 1.0}
    assert scene.orbit is not None
    assert scene.orbit.start == (2.0, 0.0)
    assert (scene.solution, scene.continuation, scene.stability) == (None, None, None)
    assert scene.accuracy.relative_tolerance == 1e-8
    chain = parsed("[chain]\nsites = 3\nalpha = 1\ngamma = 0\ng = 1\n")
    assert (chain.sites, scene.sites) == (3, None)
    assert (chain.model, scene.chain) == (None, None)
    assert not chain.same_request(scene)
    assert not scene.same_request(chain)
    assert scene.same_request(parsed('title = "another"\n' + scene_of("van_der_pol", ORBIT, "mu = 1.0")))
    named = '[method]\ntranscription = "gauss"\nflow = "collocation"\n'
    assert scene.same_request(parsed(scene_of("van_der_pol", ORBIT + named, "mu = 1")))
    assert not scene.same_request(parsed(scene_of("van_der_pol", ORBIT + named.replace("gauss", "radau"), "mu = 1")))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "[chain]: missing; accepted: a table with sites, alpha, gamma, g, a table [lattice] with cells and "),
        (
            "[orbit]\nstart = [1]\n",
            "[chain]: missing; accepted: a table with sites, alpha, gamma, g, a table [lattice]",
        ),
        ("[chain]\n[model]\n", "[chain]: given beside [model]; accepted: [chain], [lattice] or [model] in one scene"),
        (scene_of("a", "[family]\n"), "[family] mode: missing; accepted: a mode from 1 to sites (of a "),
        ("[modle]\n", "[modle]: unknown table; did you mean [model]? (accepted: [chain], "),
        ("[model]\n[orbt]\n", "[orbt]: unknown table; did you mean [orbit]? (accepted: [chain], [lattice], "),
        ("[model]\nfiles = 'a.py'\n", "[model] files: unknown key; did you mean 'file'? (accepted: file, name, "),
        ("[model]\n", "[model] file: missing; accepted: a Python file, or a .json file written by save_model"),
        ('[model]\nfile = "a.py"\n', "[model] name: missing; accepted: with a Python file the name of the model in it"),
        ('[model]\nfile = "a.txt"\n', '[model] file: given "a.txt"; accepted: a name that ends in .py or .json'),
        ('[model]\nfile = "a.json"\nname = "b"\n', '[model] name: given "b" with file = "a.json"; accepted: none: '),
        (scene_of("a", "", 'mu = "x"'), '[model] parameters: given {mu = "x"}; accepted: a table of finite numbers '),
        (scene_of("a", "", "mu = inf"), "[model] parameters: given {mu = inf}; accepted: a table of finite numbers "),
        (scene_of("a", "[orbit]\n"), "[orbit] start: missing; accepted: a list of finite numbers, one a state, or "),
        (
            scene_of("a", ORBIT + "transient = 3\n"),
            "[orbit]: given period and transient; accepted: period or transient",
        ),
        (scene_of("a", ORBIT + "period = -1\n").replace("period = 6.6\n", ""), "[orbit] period: given -1; accepted: "),
        (scene_of("a", ORBIT + "select = { x = 1, y = 2 }"), "[orbit] select: given {x = 1, y = 2}; accepted: "),
        (scene_of("a", SYMMETRIC + "section = { y = 0 }"), "[orbit] section: given with symmetric = true; accepted: "),
        (scene_of("a", ORBIT + "[solution]\nguess = [0]\n"), "[solution]: given beside [orbit]; accepted: [orbit] or "),
        (
            scene_of("a", "[stability]\n"),
            "[stability]: given without [family], [orbit] or [solution]; accepted: beside a ",
        ),
        (
            scene_of("a", "[continuation]\nparameter = 'b'\nto = 1\n"),
            "[continuation]: given without [family], [equilibrium], [orbit] or [solution]; accepted: beside a ",
        ),
        (
            scene_of("a", ORBIT + "[continuation]\nparameter = 'b'\nto = 3\nat = [2, 2]\n"),
            "[continuation] at: given 2.0 as item 2 again; accepted: each number once",
        ),
        (scene_of("a", ORBIT + "[method]\ntranscription = 'trigonometric'\n"), "[method] transcription: given "),
        (
            scene_of("a", ORBIT + "[method]\nflow = 'splitting'\n"),
            '[method] flow: given "splitting" without [family]; ',
        ),
        (scene_of("a", ORBIT + "[method]\nwalker = 'arclength'\n"), '[method] walker: given "arclength"; accepted: be'),
        (scene_of("a", ORBIT + "[method]\ntail = 'full'\n"), '[method] tail: given "full"; accepted: beside [family]'),
        (family_of("a", "1", ORBIT), "[orbit]: given beside [family]; accepted: [family] or [orbit] in one scene"),
        (family_of("a", "1", "[method]\nintervals = 5\n"), "[method] intervals: given 5; accepted: beside [orbit] or "),
        (family_of("a", "1", "[method]\nflow = 'collocation'\n"), '[method] flow: given "collocation" with [family]; '),
        (family_of("a", "[1, 1]"), "[family] mode: given 1 more than once; accepted: each mode once"),
        (family_of("a", "0"), "[family] mode: given 0; accepted: whole numbers from 1, first, last"),
        (
            family_of("a", "['first', 'last']", "[dynamics]\nS = 0.5\nperiods = 1\n"),
            '[dynamics] mode: missing; accepted: one of the modes of [family], ["first", "last"]',
        ),
        (
            scene_of("a", ORBIT + "[dynamics]\nS = 0.5\nperiods = 1\n"),
            "[dynamics] S: given 0.5; accepted: beside a [family]",
        ),
        (
            CHAIN + CHAIN_ORBIT.replace("symmetric = true", ""),
            "[orbit] symmetric: given false with [chain]; accepted: true: the orbits of a chain come in families",
        ),
        (
            CHAIN.replace("= 2", "= inf") + CHAIN_ORBIT,
            "[orbit]: given with sites = inf; accepted: with a whole number ",
        ),
        (
            CHAIN + "[solution]\nguess = [0]\n",
            "[solution]: given beside [chain]; accepted: beside [model], whose file ",
        ),
    ],
)
def test_faults_that_show_without_the_model(text: str, message: str) -> None:
    assert fault_of(text).startswith(message)


def test_the_schema_has_one_scene_of_a_chain_or_a_model() -> None:
    schema = json.loads(json.dumps(scene_schema()))
    assert schema["$ref"] == "#/$defs/Scene"
    assert schema["$defs"]["Scene"]["anyOf"] == [{"required": [name]} for name in ("chain", "lattice", "model")]
    assert not schema["$defs"]["OrbitTable"]["additionalProperties"]


def test_reading_a_scene_of_a_model_loads_no_numerics() -> None:
    code = (
        "import sys; from casadi_skin.runs.reading import parse_scene; "
        f"parse_scene({scene_of('a', ORBIT)!r}); "
        "assert not {'casadi', 'numpy', 'scipy'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# With the model -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            scene_of("van_der_po", ORBIT),
            "[model] models.py: defines no van_der_po; did you mean van_der_pol? accepted: ",
        ),
        (scene_of("number", ORBIT), "[model] models.py: number gives an int; accepted: an OdeModel or a Boundary"),
        (scene_of("with_argument", ORBIT), "[model] models.py: with_argument cannot be called with 0 arguments: "),
        (scene_of("fails", ORBIT), "[model] models.py, line 30: ZeroDivisionError: division by zero"),
        (scene_of("van_der_pol", ORBIT), "[model] parameters: given none for mu; accepted: "),
        (
            scene_of("van_der_pol", ORBIT, "mu_ = 1"),
            '[model] parameters: given "mu_"; did you mean "mu"? (accepted: mu)',
        ),
        (
            scene_of("makes", "[orbit]\nstart = [1]\nperiod = 1\n", "mu = 1"),
            "[orbit] start: given a list of 1; accepted",
        ),
        (
            scene_of("makes", "[orbit]\nstart = {z = 1}\nperiod = 1\n", "mu = 1"),
            '[orbit] start: given "z"; accepted: x, y',
        ),
        (scene_of("makes", "[orbit]\nstart = [1, 0]\n", "mu = 1"), "[orbit] period or transient: missing; accepted: "),
        (
            scene_of("makes", ORBIT + "cycles = 2\n", "mu = 1"),
            "[orbit] cycles: given 2 with van der Pol, which is not ",
        ),
        (
            scene_of("makes", ORBIT + "select = {x = 1}\n", "mu = 1"),
            "[orbit] select: given with van der Pol; accepted: ",
        ),
        (scene_of("makes", SYMMETRIC, "mu = 1"), "[orbit] symmetric: given true with van der Pol; accepted: "),
        (scene_of("makes", ORBIT + "section = {z = 1}\n", "mu = 1"), '[orbit] section: given "z"; accepted: x, y'),
        (scene_of("makes", "[solution]\nguess = [0, 0]\n", "mu = 1"), "[solution]: given with makes, an OdeModel; "),
        (
            scene_of("pendulum", ORBIT),
            "[orbit] select: missing; accepted: a table with one number: conservative orbits ",
        ),
        (
            scene_of("pendulum", SYMMETRIC.replace("{ x", "{ y")),
            '[orbit] select: given "y"; accepted: a quantity that ',
        ),
        (scene_of("pendulum", SYMMETRIC.replace("{ x", "{ h")), '[orbit] select: given "h"; '),
        (scene_of("forced", ORBIT, "mu = 1"), "[orbit] period: given with forced, which is forced; accepted: start, "),
        (scene_of("bounded", ORBIT), "[orbit]: given with bounded, a BoundaryValueProblem; accepted: [solution]"),
        (
            scene_of("bounded", "[solution]\nguess = [0]\n"),
            "[solution] guess: given a list of 1; accepted: 2 numbers: x, y",
        ),
        (scene_of("bounded", "[solution]\nguess = 'gues'\n"), '[solution] guess: given "gues"; did you mean "guess"?'),
        (
            scene_of("bounded", "[solution]\nguess = 'guess_of_three'\n"),
            "[solution] guess: given guess_of_three, which returns 3 numbers; accepted: 2: x, y",
        ),
        (
            scene_of("bounded", "[solution]\nguess = 'makes'\n"),
            "[solution] guess: models.py: makes cannot be called with 1 argument: too many positional arguments",
        ),
        (
            scene_of("best", "[solution]\nguess = [0, 0]\n[continuation]\nparameter = 'mu'\nto = 2\n"),
            "[continuation]: given with a problem that has an objective; accepted: a problem without",
        ),
        (
            scene_of("makes", ORBIT + "[continuation]\nparameter = 'mu_'\nto = 2\n", "mu = 1"),
            '[continuation] parameter: given "mu_"; did you mean "mu"? (accepted: mu)',
        ),
        (
            scene_of("makes", ORBIT + "[continuation]\nparameter = 'mu'\nto = 1\n", "mu = 1"),
            "[continuation] to: given 1.0, where the branch starts; accepted: another number",
        ),
        (
            scene_of("makes", ORBIT + "[continuation]\nparameter = 'mu'\nto = 3\nat = [2, 4]\n", "mu = 1"),
            "[continuation] at: given 4.0 as item 2; accepted: numbers from 1.0 to 3.0",
        ),
        (
            CHAIN + CHAIN_ORBIT + "[continuation]\nparameter = 'gama'\nto = 2\n",
            '[continuation] parameter: given "gama"; did you mean "gamma"? (accepted: alpha, gamma, g, select)',
        ),
        (
            CHAIN + CHAIN_ORBIT + "[continuation]\nparameter = 'gamma'\nto = 2\n",
            "[continuation] to: given 2.0 for gamma; accepted: numbers from -1 to 1",
        ),
        (
            CHAIN + CHAIN_ORBIT.replace("y_2", "y_3"),
            '[orbit] select: given "y_3"; did you mean "y_2"? (accepted: y_1, ',
        ),
        (
            family_of("irreversible", "1"),
            "[family]: given pair; accepted for families: a model with a declared reversal ",
        ),
        (family_of("pendulum", "1"), "[family]: given pendulum; accepted for families: a model of second order, with "),
        (
            family_of("equal", "1"),
            "[family] mode: modes 1, 2 of pair have the same frequency: no family belongs to one ",
        ),
        (family_of("pair", "3"), "[family] mode: given 3; accepted: 1..2, first, last"),
        (family_of("pair", "['last', 2]"), "[family] mode: given mode 2 more than once; accepted: each mode once"),
        (
            family_of("pair", "1", "[method]\ntail = 'full'\n"),
            "[method] tail: given 'full'; accepted: with a chain alone",
        ),
        (
            family_of("pair", "1", "[method]\ndegree = 4\n"),
            "[method] degree: given 4; accepted: with gauss or radau only",
        ),
        (family_of("pair", "1", "", "m = 1"), '[model] parameters: given "m"; did you mean "mu"? (accepted: mu)'),
        (
            family_of("pair", "1", "period_max = 6.2\n"),
            "[family] period_max: given 6.2; accepted: a finite number > 6.28318530718 (the period of linear mode 1)",
        ),
        (
            family_of("pair", "['first', 'last']", "[dynamics]\nS = 0.5\nperiods = 1\nmode = 3\n"),
            "[dynamics] mode: given 3; accepted: one of the modes of [family], [1, 2]",
        ),
        (
            family_of("pair", "1", "[dynamics]\nS = 0.5\nperiods = 1\nsize = 1\nsite = 3\n"),
            "[dynamics] site: given 3; accepted: whole numbers from 1 to 2 (q_0, q_1)",
        ),
        (
            family_of("pair", "1", "[dynamics]\nS = 0.5\nperiods = 1\nsize = 1\nvector = [1]\n"),
            "[dynamics] vector: given a list of 1; accepted: 2 displacements, or these and 2 velocities",
        ),
        (
            scene_of("makes", ORBIT + "[dynamics]\nperiods = 1\nsize = 1\nvector = [1]\n", "mu = 1"),
            "[dynamics] vector: given a list of 1; accepted: 2 numbers",
        ),
        (
            scene_of("makes", "[spectrum]\n", "mu = 1"),
            "[spectrum]: given van der Pol; accepted for families: a model of ",
        ),
        (scene_of("bounded", "[spectrum]\n"), "[spectrum]: given with bounded, a BoundaryValueProblem; accepted: "),
    ],
)
def test_faults_that_the_model_shows(text: str, message: str, folder: Path) -> None:
    assert fault_of(text, folder).startswith(message)


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


def test_a_transient_and_a_section_give_a_cycle_that_starts_at_the_section(folder: Path) -> None:
    text = "[orbit]\nstart = [2.0, 0.0]\ntransient = 40.0\nsection = { y = 0.0 }\n"
    request = bind(parsed(scene_of("makes", text, "mu = 1")), folder / "scene.toml")
    assert abs(cycle(request).evaluate(0.0)[1]) < 1e-3
    orbit = first_solution(request)
    assert abs(orbit.evaluate(0.0)[1]) < 1e-9
    assert orbit.parameters["period"] == pytest.approx(6.6632868593231, abs=1e-9)


def test_a_forced_orbit_is_that_of_the_linear_oscillator(folder: Path) -> None:
    text = "[orbit]\nstart = { x = 1.0 }\ntransient = 30.0\ncycles = 2\n"
    request = bind(parsed(scene_of("forced", text, "mu = 1.7")), folder / "scene.toml")
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
    request = bind(parsed(scene_of("pendulum", scene)), folder / "scene.toml")
    orbit = first_solution(request)
    assert orbit.parameters["period"] == pytest.approx(4 * ellipk(np.sin(0.5) ** 2), abs=1e-8)
    assert "select" in orbit.parameters
    low, high = extremes(orbit)
    np.testing.assert_allclose([*low, *high], [-1.0, -2 * np.sin(0.5), 1.0, 2 * np.sin(0.5)], atol=1e-7)


def test_a_saved_model_is_the_same_as_the_python_file(folder: Path) -> None:
    made = bind(parsed(scene_of("makes", ORBIT, "mu = 1")), folder / "scene.toml").model
    save_model(made, folder / "saved.json")
    text = '[model]\nfile = "saved.json"\nparameters = { mu = 1.0 }\n' + ORBIT
    request = bind(parsed(text), folder / "scene.toml")
    assert isinstance(request.model, OdeModel)
    np.testing.assert_array_equal(
        np.array(request.model.vector_field(0.0, [0.3, 0.4], 2.0)), np.array(made.vector_field(0.0, [0.3, 0.4], 2.0))
    )
    (folder / "saved.json").write_text("{}", encoding="utf-8")
    assert fault_of(text, folder).startswith("[model] saved.json: not a model saved by casadi_skin")


@pytest.mark.slow
def test_a_solution_from_a_guess_in_the_file(folder: Path) -> None:
    request = bind(parsed(scene_of("bounded", "[solution]\nguess = 'guess'\n")), folder / "scene.toml")
    solution = first_solution(request)
    point = Place(solution, 0)
    assert point.extremes[1][0] == pytest.approx(0.14053921440047, abs=1e-9)  # at the middle, by symmetry
    assert point.extremes[1][1] == pytest.approx(solution.evaluate(0.0)[1])  # of u' at the start
