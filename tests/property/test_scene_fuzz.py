"""Whatever a scene file holds, it is a Scene or one line that says why not."""

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from effort import examples, texts
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st

from casadi_skin.runs.program import main
from casadi_skin.runs.reading import parse_scene, read_scene
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import Scene

QUICK = examples(200, database=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
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
PLACES = [(name, key) for name, table in VALID.items() if isinstance(table, dict) for key in [None, *table]]
KEYS = sorted({key for _, key in PLACES if key} | {name for name, _ in PLACES} | {"preset", "tolerance", "title"})


def toml(value: Any) -> str:
    """A value in TOML; tables inline, so that any value can stand at any place."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml(key)} = {toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value).lower()  # True, 3, 1e-08, nan


def text_of(scene: dict[str, Any]) -> str:
    return "".join(f"{toml(name)} = {toml(value)}\n" for name, value in scene.items())


def parse(text: str, source: str = "fuzz.toml") -> Scene | None:
    """The scene, or None where it is refused as it should be."""
    try:
        return parse_scene(text, source)
    except SceneError as fault:
        message = str(fault)
        assert message.startswith(f"{source}: ")
        assert message.isprintable()  # so also one line
        assert len(message) < 500
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


@st.composite
def mutated(draw: st.DrawFn) -> dict[str, Any]:
    """The valid scene with a few keys or tables replaced, removed, renamed or added."""
    scene = {name: dict(value) if isinstance(value, dict) else value for name, value in VALID.items()}
    for _ in range(draw(st.integers(1, 3))):
        name, key = draw(st.sampled_from(PLACES))
        table = scene if key is None or not isinstance(scene.get(name), dict) else scene[name]
        place = name if table is scene else key
        change = draw(st.sampled_from(["replace", "remove", "rename", "add"]))
        old = table.get(place, 0) if change == "add" else table.pop(place, 0)
        if change in ("replace", "add"):
            table[place if change == "replace" else draw(names)] = draw(values)
        elif change == "rename":
            table[draw(names)] = old
    return scene


def test_the_scene_to_mutate_is_valid() -> None:
    scene = parse(text_of(VALID))
    assert scene is not None
    assert scene.title == VALID["title"]


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
@given(mutated())
def test_mutated_scenes(tables: dict[str, Any]) -> None:
    scene = parse(text_of(tables))
    if scene is not None:
        assert set(tables) <= set(VALID)
        assert 1e-13 <= scene.accuracy.relative_tolerance <= 1e-2
        if scene.family is None:
            assert scene.stability is None
            assert scene.dynamics is None
        else:
            modes = scene.family.modes(scene.chain.sites)
            assert all(1 <= mode <= scene.chain.sites or scene.chain.sites == math.inf for mode in modes)


@QUICK
@given(st.sampled_from([place for place in PLACES if place[1]]), values)
def test_one_value_replaced(place: tuple[str, str], value: Any) -> None:
    name, key = place
    parse(text_of(VALID | {name: VALID[name] | {key: value}}))


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


@pytest.mark.parametrize("text", ["", "[chain]", "\x00", "[chain]\nsites = 3.5\nalpha = 1\ngamma = 0\ng = 1"])
def test_refusals_leave_with_status_2_and_one_line(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "fuzz.toml"
    path.write_text(text)
    for command in ("run", "check", "spectrum"):
        assert main([command, str(path)]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"casadi-skin: {path}: ")
        assert error.count("\n") == 1


@QUICK
@given(st.binary(max_size=40))
def test_any_bytes_in_a_file(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.toml"
    path.write_bytes(data)
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert str(caught.value).isprintable()
