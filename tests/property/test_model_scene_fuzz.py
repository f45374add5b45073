"""Whatever a scene of a model holds, it is a request or one line that says why not, before anything is computed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from test_scene_fuzz import QUICK, names, text_of, values

from casadi_skin.runs.model_request import ModelRequest, bind
from casadi_skin.scene import ModelScene, SceneError, parse_any_scene

MODEL = """
import casadi as ca
from casadi_skin import BoundaryValueProblem, OdeModel

x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
pendulum = OdeModel(
    "pendulum", ca.vertcat(x, y), ca.vertcat(y, -mu * ca.sin(x)), mu, nominal=(1.0,),
    reversal=(1, -1), hamiltonian=y**2 / 2 - mu * ca.cos(x),
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
KNOWN = st.sampled_from(["x", "y", "mu", "select", "hamiltonian", "pendulum", "problem", "guess", "ca", "model.json"])


@st.composite
def mutated(draw: st.DrawFn) -> dict[str, Any]:
    """A valid scene with a few keys or tables replaced, removed or added."""
    valid = draw(st.sampled_from([ORBIT, SOLUTION]))
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


def request_of(scene: dict[str, Any], folder: Path) -> ModelRequest | None:
    """The request, or None where it is refused as it should be."""
    try:
        found = parse_any_scene(text_of(scene), "fuzz.toml")
        return bind(found, folder / "fuzz.toml") if isinstance(found, ModelScene) else None
    except SceneError as fault:
        message = str(fault)
        assert message.isprintable()  # so also one line
        assert len(message) < 700
        return None


@pytest.mark.parametrize("valid", [ORBIT, SOLUTION])
def test_the_scenes_to_mutate_are_valid(valid: dict[str, Any], folder: Path) -> None:
    assert request_of(valid, folder) is not None


@QUICK
@given(mutated())
@example(ORBIT | {"model": {"file": "model.py", "name": "guess"}})
@example(ORBIT | {"model": {"file": "\x00.py", "name": "guess"}})
@example(SOLUTION | {"solution": {"guess": "ca"}})
def test_mutated_scenes(folder: Path, scene: dict[str, Any]) -> None:
    request = request_of(scene, folder)
    if request is not None:
        assert set(request.parameters) == {"mu"}
        assert (request.scene.orbit is None) or (request.scene.solution is None)
