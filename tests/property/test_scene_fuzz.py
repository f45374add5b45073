"""Whatever a scene file holds, it is a Scene or one line that says why not; with its model, before it is computed."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from effort import examples, texts
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st
from scenes import toml

from casadi_skin.runs.binding import bind
from casadi_skin.runs.reading import parse_scene, read_scene
from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import Scene

QUICK = examples(200, database=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
MODEL = """
import casadi as ca
from casadi_skin import BoundaryValueProblem, OdeModel

x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
pendulum = OdeModel(
    "pendulum", ca.vertcat(x, y), ca.vertcat(y, -mu * ca.sin(x)), mu, nominal=(1.0,),
    reversal=(1, -1), hamiltonian=y**2 / 2 - mu * ca.cos(x),
)
q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
pair = OdeModel(
    "pair", q, ca.vertcat(-2 * q[0] + q[1] - mu * q[0]**3, q[0] - 2 * q[1] - mu * q[1]**3), mu, 2, v, nominal=(1.0,),
    reversal=(1, 1, -1, -1), half_period=(-1, -1, -1, -1),
)
problem = BoundaryValueProblem(pendulum, [pendulum.start(x), pendulum.end(x) - 1])
guess = lambda t: [t, 1.0]
"""
VALID: dict[str, Any] = {
    "title": "Softening end breather",
    "chain": {"sites": 24, "alpha": 1.0, "gamma": 0.25, "g": -1.0},
    "spectrum": {},
    "family": {"mode": [1, 2], "amplitude_max": 3.0, "at": [0.2, 1.0]},
    "stability": {"events": True},
    "dynamics": {"S": 0.2, "mode": 2, "periods": 5.0, "samples": 100, "method": "dop853", "tolerance": 1e-9,
                 "size": 0.005, "vector": [1.0] * 24},
    "accuracy": {"preset": "standard"},
    "method": {"transcription": "gauss", "corrector": "newton", "walker": "arclength", "flow": "cvodes"},
}  # fmt: skip
ORBIT: dict[str, Any] = {
    "model": {"file": "model.py", "name": "pendulum", "parameters": {"mu": 2.0}},
    "orbit": {"start": [1.0, 0.0], "period": 6.0, "select": {"x": 1.0}, "symmetric": True, "cycles": 1},
    "continuation": {"parameter": "mu", "to": 3.0, "at": [2.5], "max_points": 10, "max_step": 0.1},
    "stability": {},
    "accuracy": {"tolerance": 1e-6},
    "method": {"transcription": "radau", "degree": 4, "corrector": "newton", "intervals": 5, "flow": "cvodes"},
}
SOLUTION: dict[str, Any] = {
    "model": {"file": "model.py", "name": "problem"},
    "solution": {"guess": "guess"},
    "continuation": {"parameter": "mu", "to": 3.0},
}
FAMILY: dict[str, Any] = {
    "model": {"file": "model.py", "name": "pair", "parameters": {"mu": 2.0}},
    "spectrum": {},
    "family": {"mode": [1, "last"], "amplitude_max": 2.0, "at": [0.5, 1.0], "at_Omega": [1.2], "film": True},
    "stability": {"events": True, "vectors": True},
    "dynamics": {"S": 0.5, "mode": 2, "periods": 3.0, "size": 0.01, "vector": [1.0, 2.0, 3.0, 4.0]},
    "export": {"c": "all", "S": 1.0, "mode": 1},
    "accuracy": {"preset": "draft"},
    "method": {"transcription": "gauss", "degree": 4, "corrector": "newton", "walker": "arclength", "flow": "cvodes"},
}
CHAIN_ORBIT: dict[str, Any] = {
    "chain": {"sites": 2, "alpha": 1.0, "gamma": 0.2, "g": 1.0},
    "orbit": {"start": [0.1, 0.4, 0.0, 0.0], "period": 3.4, "select": {"y_2": 0.4}, "symmetric": True},
    "continuation": {"parameter": "gamma", "to": 0.5, "at": [0.3]},
    "stability": {},
    "dynamics": {"duration": 3.0, "size": 0.01, "site": 2},
    "method": {"transcription": "radau", "intervals": 5, "flow": "cvodes"},
}
WITH_MODEL = [ORBIT, SOLUTION, FAMILY, CHAIN_ORBIT]
KEYS = sorted({*VALID, "tolerance"}.union(*(table for table in VALID.values() if isinstance(table, dict))))
NAMES = "x", "y", "mu", "y_2", "gamma", "select", "hamiltonian", "pendulum", "pair", "problem", "guess", "ca"


def text_of(scene: dict[str, Any]) -> str:
    return "".join(f"{toml(name)} = {toml(value)}\n" for name, value in scene.items())


def check_refusal(fault: SceneError, source: str, longest: int) -> None:
    assert str(fault).startswith(source)
    assert str(fault).isprintable()  # so also one line
    assert len(str(fault)) < longest


def parse(text: str, source: str = "fuzz.toml") -> Scene | None:
    """The scene, or None where it is refused as it should be."""
    try:
        return parse_scene(text, source)
    except SceneError as fault:
        check_refusal(fault, f"{source}: ", 500)
        return None


def request_of(scene: dict[str, Any], folder: Path) -> Request | None:
    """The request, or None where it is refused as it should be."""
    try:
        parsed = parse(text_of(scene))
        return None if parsed is None else bind(parsed, folder / "fuzz.toml")
    except SceneError as fault:
        check_refusal(fault, "", 700)
        return None


names = st.sampled_from(KEYS) | texts(8)
numbers = (
    st.integers(-3, 40)
    | st.integers()
    | st.sampled_from([10**25, -(10**400), 10**400, 2**63, 2**64])
    | st.floats()
    | st.floats(1e-14, 4.0)
)
scalars = numbers | st.booleans() | names
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(names, inner, max_size=3),
    max_leaves=6,
)
known = st.sampled_from([*NAMES, "model.json", "first", "last"])


@st.composite
def mutated(draw: st.DrawFn, valid: list[dict[str, Any]], values: st.SearchStrategy[Any]) -> dict[str, Any]:
    """A valid scene with a few keys or tables replaced, removed, renamed or added."""
    tables = draw(st.sampled_from(valid))
    scene = {name: dict(value) if isinstance(value, dict) else value for name, value in tables.items()}
    for _ in range(draw(st.integers(1, 3))):
        table = scene
        name = draw(st.sampled_from(sorted(scene))) if scene else "model"
        if isinstance(scene.get(name), dict) and draw(st.booleans()):
            table = scene[name]
        place = draw(st.sampled_from(sorted(table)) if table else names)
        change = draw(st.sampled_from(["replace", "remove", "rename", "add"]))
        old = table.get(place, 0) if change == "add" else table.pop(place, 0)
        if change in ("replace", "add"):
            table[place if change == "replace" else draw(names)] = draw(values)
        elif change == "rename":
            table[draw(names)] = old
    return scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    (folder / "model.py").write_text(MODEL, encoding="utf-8")
    return folder


@pytest.mark.parametrize("valid", [VALID, *WITH_MODEL])
def test_the_scenes_to_mutate_are_valid(valid: dict[str, Any], folder: Path) -> None:
    request = request_of(valid, folder)
    assert request is not None
    assert request.scene.title == valid.get("title")


@QUICK
@given(texts(60) | st.text("[]{}=.,\"'#\n \\ntrue01e-chainsites", max_size=60))
@example("[")
@example("\r")
@example("title = '\ud800'")
@example("a = " + "[" * 3000)
def test_any_text(text: str) -> None:
    parse(text)


@QUICK
@given(st.dictionaries(names, values, max_size=4))
def test_any_tables(tables: dict[str, Any]) -> None:
    parse(text_of(tables))


@QUICK
@given(mutated([VALID, *WITH_MODEL], values | known))
@example(ORBIT | {"model": {"file": "model.py", "name": "guess"}})
@example(ORBIT | {"model": {"file": "\x00.py", "name": "guess"}})
@example(SOLUTION | {"solution": {"guess": "ca"}})
@example(FAMILY | {"model": {"file": "model.py", "name": "pendulum"}})
@example(FAMILY | {"method": {"tail": "full"}})
def test_mutated_scenes_with_their_models(folder: Path, tables: dict[str, Any]) -> None:
    request = request_of(tables, folder)
    if request is not None:
        asked = request.scene
        assert 1e-13 <= asked.accuracy.relative_tolerance <= 1e-2
        assert set(request.parameters) == ({"mu"} if asked.chain is None else {"alpha", "gamma", "g"})
        assert sum(table is not None for table in (asked.family, asked.orbit, asked.solution)) <= 1
        assert len(request.families) == len(asked.modes())
        if asked.chain is not None:
            assert all(1 <= mode <= asked.chain.sites or asked.chain.sites == math.inf for mode in asked.modes())


@QUICK
@given(
    st.sampled_from([name for name, value in VALID.items() if isinstance(value, dict)]),
    st.sampled_from(["again", "array", "deep", "long", "unicode", "empty", "date"]),
    st.integers(1, 2000),
)
def test_structure_that_no_scene_has(name: str, how: str, size: int) -> None:
    odd = {
        "again": f"[{name}]\n",
        "array": f"[[{name}]]\n",
        "deep": f"[{'.'.join([name] + ['a'] * size)}]\n",
        "long": f"{'x' * size} = '{'y' * size}'\n",
        "unicode": f'"{chr(0x3B1 + size % 500)}" = 1\n',
        "empty": f"{name} = []\n",
        "date": f"{name} = 1979-05-27T07:32:00Z\n",
    }[how]
    for text in (odd + text_of(VALID), text_of(VALID) + odd, odd):
        assert parse(text) is None


@QUICK
@given(st.lists(st.sampled_from([0.0, -0.0, 5e-324, 1e308, float("nan"), float("inf"), -1.0, 0.5]), max_size=4))
def test_lists_of_amplitudes(at: list[float]) -> None:
    scene = parse(text_of({"chain": VALID["chain"], "family": {"mode": 1, "amplitude_max": 1.0, "at": at}}))
    ascending = all(0 < a <= 1 for a in at) and all(a < b for a, b in pairwise(at))
    assert (scene is not None) == ascending


@QUICK
@given(st.binary(max_size=40))
def test_any_bytes_in_a_file(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.toml"
    path.write_bytes(data)
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    check_refusal(caught.value, f"{path}: ", 500)
