"""Whatever a scene file holds, it is a Scene or one line that says why not; with its model, before it is computed."""

import math
import tomllib
from itertools import pairwise
from typing import Any

import pytest
from effort import examples, texts
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st
from outputs import EXAMPLES
from scenes import toml

from casadi_skin.runs.binding import bind
from casadi_skin.runs.reading import parse_scene, read_scene
from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import Scene

QUICK = examples(200, database=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
SCENES = {
    name: tomllib.loads((EXAMPLES / f"{name}.toml").read_text(encoding="utf-8"))
    for name in ("softening_end_breather", "fput_modes", "duffing_resonance", "van_der_pol", "heated_slab",
                 "prey_and_predators", "design_hardest_breather")
}  # fmt: skip
ORBIT, SOLUTION, FAMILY = SCENES["van_der_pol"], SCENES["heated_slab"], SCENES["fput_modes"]
CHAIN = SCENES["softening_end_breather"]
TABLES = [table for scene in SCENES.values() for table in scene.values() if isinstance(table, dict)]
KEYS = sorted({key for scene in SCENES.values() for key in scene}.union(*TABLES, {"preset", "tolerance", "certify"}))
NAMES = "x", "y", "mu", "lambda", "gamma", "select", "hamiltonian", "van_der_pol", "problem", "guess", "ca"


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


def request_of(scene: dict[str, Any]) -> Request | None:
    """The request, or None where it is refused as it should be."""
    try:
        parsed = parse(text_of(scene))
        return None if parsed is None else bind(parsed, EXAMPLES / "fuzz.toml")
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
values = st.recursive(
    numbers | st.booleans() | names | st.sampled_from([*NAMES, "model.json", "first", "last"]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(names, inner, max_size=3),
    max_leaves=6,
)


@st.composite
def mutated(draw: st.DrawFn) -> dict[str, Any]:
    """The scene of an example with a few keys or tables replaced, removed, renamed or added."""
    tables = SCENES[draw(st.sampled_from(sorted(SCENES)))]
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


@pytest.mark.parametrize("name", SCENES)
def test_the_scenes_to_mutate_are_valid(name: str) -> None:
    assert request_of(SCENES[name]) is not None


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
@example(ORBIT | {"model": {"file": "models/van_der_pol.py", "name": "ca"}})
@example(ORBIT | {"model": {"file": "\x00.py", "name": "guess"}})
@example(SOLUTION | {"solution": {"guess": "ca"}})
@example(FAMILY | {"model": ORBIT["model"]})
@example(FAMILY | {"method": {"tail": "full"}})
def test_mutated_scenes_with_their_models(tables: dict[str, Any]) -> None:
    request = request_of(tables)
    if request is not None:
        asked = request.scene
        assert 1e-13 <= asked.accuracy.relative_tolerance <= 1e-2
        assert asked.chain is None or set(request.parameters) == {"alpha", "gamma", "g"}
        assert sum(table is not None for table in (asked.family, asked.orbit, asked.solution)) <= 1
        assert len(request.families) == len(asked.modes())
        if asked.chain is not None:
            assert all(1 <= mode <= asked.chain.sites or asked.chain.sites == math.inf for mode in asked.modes())


@QUICK
@given(
    st.sampled_from([name for name, value in CHAIN.items() if isinstance(value, dict)]),
    st.sampled_from(["[{0}]\n", "[[{0}]]\n", "[{0}{1}]\n", "{2} = '{2}'\n", '"{3}" = 1\n', "{0} = []\n",
                     "{0} = 1979-05-27T07:32:00Z\n"]),
    st.integers(1, 2000),
)  # fmt: skip
def test_structure_that_no_scene_has(name: str, form: str, size: int) -> None:
    odd = form.format(name, ".a" * size, "x" * size, chr(0x3B1 + size % 500))
    for text in (odd + text_of(CHAIN), text_of(CHAIN) + odd, odd):
        assert parse(text) is None


@QUICK
@given(st.lists(st.sampled_from([0.0, -0.0, 5e-324, 1e308, float("nan"), float("inf"), -1.0, 0.5]), max_size=4))
def test_lists_of_amplitudes(at: list[float]) -> None:
    scene = parse(text_of({"chain": CHAIN["chain"], "family": {"mode": 1, "amplitude_max": 1.0, "at": at}}))
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
