"""Whatever a scene of a model holds, it is a request or one line that says why not, before anything is computed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from test_scene_fuzz import QUICK, names, text_of, values

from casadi_skin.runs.binding import bind
from casadi_skin.runs.reading import parse_scene
from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import SceneError

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
ORBIT: dict[str, Any] = {
    "title": "Pendulum",
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
NAMES = "x", "y", "mu", "y_2", "gamma", "select", "hamiltonian", "pendulum", "pair", "problem", "guess", "ca"
KNOWN = st.sampled_from([*NAMES, "model.json", "first", "last"])
VALID = [ORBIT, SOLUTION, FAMILY, CHAIN_ORBIT]


@st.composite
def mutated(draw: st.DrawFn) -> dict[str, Any]:
    """A valid scene with a few keys or tables replaced, removed or added."""
    valid = draw(st.sampled_from(VALID))
    scene = {name: dict(value) if isinstance(value, dict) else value for name, value in valid.items()}
    for _ in range(draw(st.integers(1, 3))):
        table = scene
        name = draw(st.sampled_from(sorted(scene))) if scene else "model"
        if isinstance(scene.get(name), dict) and draw(st.booleans()):
            table = scene[name]
        place = draw(st.sampled_from(sorted(table)) if table else names)
        change = draw(st.sampled_from(["replace", "remove", "add"]))
        if change == "remove":
            table.pop(place, None)
        else:
            table[place if change == "replace" else draw(names)] = draw(values | KNOWN)
    return scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    (folder / "model.py").write_text(MODEL, encoding="utf-8")
    return folder


def request_of(scene: dict[str, Any], folder: Path) -> Request | None:
    """The request, or None where it is refused as it should be."""
    try:
        return bind(parse_scene(text_of(scene), "fuzz.toml"), folder / "fuzz.toml")
    except SceneError as fault:
        message = str(fault)
        assert message.isprintable()  # so also one line
        assert len(message) < 700
        return None


@pytest.mark.parametrize("valid", VALID)
def test_the_scenes_to_mutate_are_valid(valid: dict[str, Any], folder: Path) -> None:
    assert request_of(valid, folder) is not None


@QUICK
@given(mutated())
@example(ORBIT | {"model": {"file": "model.py", "name": "guess"}})
@example(ORBIT | {"model": {"file": "\x00.py", "name": "guess"}})
@example(SOLUTION | {"solution": {"guess": "ca"}})
@example(FAMILY | {"model": {"file": "model.py", "name": "pendulum"}})
@example(FAMILY | {"method": {"tail": "full"}})
def test_mutated_scenes(folder: Path, scene: dict[str, Any]) -> None:
    request = request_of(scene, folder)
    if request is not None:
        asked = request.scene
        assert set(request.parameters) == ({"mu"} if asked.chain is None else {"alpha", "gamma", "g"})
        assert sum(table is not None for table in (asked.family, asked.orbit, asked.solution)) <= 1
        assert (len(request.families) > 0) == (asked.family is not None)
