"""Scenes: what is accepted, and for each fault the one line that names it."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
from refusals import refusals

from casadi_skin.runs.reading import parse_scene, read_scene, scene_schema
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import (
    PRESET_TOLERANCES,
    PRESETS,
    ChainTable,
    DynamicsTable,
    FamilyTable,
    MethodTable,
    Scene,
    SpectrumTable,
    StabilityTable,
)

CHAIN = "[chain]\nsites = 24\nalpha = 1.0\ngamma = 0.25\ng = -1.0\n"
FAMILY = "[family]\nmode = 1\namplitude_max = 3.0\n"
REFUSED = refusals(Path(__file__).with_name("refused_scenes.txt"), {"<chain>": CHAIN, "<family>": FAMILY})


def table(name: str, **keys: str) -> str:
    return f"[{name}]\n" + "".join(f"{key} = {value}\n" for key, value in keys.items())


def chain(**changes: str) -> str:
    return table("chain", **{"sites": "24", "alpha": "1.0", "gamma": "0.25", "g": "-1.0"} | changes)


def family(**changes: str) -> str:
    return table("family", **{"mode": "1", "amplitude_max": "3.0"} | changes)


def dynamics(**changes: str) -> str:
    return table("dynamics", **{"S": "0.2", "duration": "40"} | changes)


def fault_of(text: str) -> str:
    """The message of the fault, checked to be one line that begins with the source."""
    with pytest.raises(SceneError) as caught:
        parse_scene(text, "softening.toml")
    message = str(caught.value)
    assert message.startswith("softening.toml: ")
    assert message.isprintable()
    assert len(message) < 400
    assert caught.value.__cause__ is None
    return message.removeprefix("softening.toml: ")


# Accepted -------------------------------------------------------------------------------------------------


def test_a_chain_alone_asks_for_nothing_else() -> None:
    scene = parse_scene(CHAIN)
    assert scene.chain == ChainTable(sites=24, alpha=1.0, gamma=0.25, g=-1.0)
    assert scene == Scene(chain=scene.chain)
    assert scene.method == MethodTable(transcription=None, corrector="ipopt", walker=None, flow=None)


def test_the_scene_of_the_manual() -> None:
    scene = parse_scene(
        'title = "Softening end breather"\n' + CHAIN + "[spectrum]\n" + FAMILY + "at = [0.2, 1.0, 2.0, 3.0]\n"
        "[stability]\nevents = true\n"
        '[accuracy]\npreset = "reference"\n'
        '[method]\ntranscription = "gauss"\ncorrector = "newton"\nwalker = "arclength"\nflow = "cvodes"\n'
    )
    assert scene.title == "Softening end breather"
    assert scene.spectrum == SpectrumTable()
    assert scene.family == FamilyTable(mode=1, amplitude_max=3.0, at=(0.2, 1.0, 2.0, 3.0))
    assert scene.stability == StabilityTable(events=True)
    assert scene.accuracy.relative_tolerance == 1e-12
    assert scene.method == MethodTable("gauss", corrector="newton", walker="arclength", flow="cvodes")


@pytest.mark.parametrize(
    ("given", "modes"),
    [("1", (1,)), ("[3]", (3,)), ("[24, 1, 2]", (24, 1, 2)), ('["last", 2, "first"]', (24, 2, 1))],
    ids=["one", "list", "order", "names"],
)
def test_modes_are_a_tuple_in_the_order_given(given: str, modes: tuple[int, ...]) -> None:
    asked = parse_scene(CHAIN + family(mode=given)).family
    assert asked is not None
    assert asked.modes(24) == modes


def test_whole_numbers_serve_as_floats() -> None:
    scene = parse_scene(chain(alpha="3", gamma="0", g="-2") + family(amplitude_max="4", at="[1, 2]"))
    assert scene.chain == ChainTable(sites=24, alpha=3.0, gamma=0.0, g=-2.0)
    assert scene.family == FamilyTable(mode=1, amplitude_max=4.0, at=(1.0, 2.0))
    assert isinstance(scene.chain.alpha, float)
    assert isinstance(scene.family.at[0], float)


@pytest.mark.parametrize(
    "text",
    [
        chain(g="0.0"),
        chain(alpha="-5.0"),
        chain(gamma="-1"),
        chain(sites="1") + family(),
        chain(sites="10_000_000") + family(mode="10_000_000"),
        chain(gamma="1.0") + family(mode="1"),
        chain(gamma="-1.0", g="1.0") + family(mode="24"),
        chain(gamma="1.0", g="0.5") + family(mode="24"),
        chain(alpha="0.0", gamma="0.0", sites="10_000_000") + family(),
        CHAIN + family(at="[]"),
        CHAIN + family(at="[3.0]"),
        CHAIN + family(at_Omega="[0.9, 0.95]", at_period="[7, 6.5]", period_max="7", max_points="1"),
        CHAIN + "[accuracy]\ntolerance = 1e-13\n[method]\n",
        CHAIN + "[accuracy]\ntolerance = 1e-2\n",
        CHAIN + FAMILY + "[stability]\nevents = false\n",
        "title = ''\nchain = {sites = 2, alpha = 0, gamma = 0, g = 1}",
    ],
)
def test_accepted(text: str) -> None:
    parse_scene(text)


@pytest.mark.parametrize(
    ("table", "tolerance"),
    [("", 1e-8), ("tolerance = 1e-9", 1e-9), *((f'preset = "{name}"', PRESET_TOLERANCES[name]) for name in PRESETS)],
)
def test_tolerance_that_holds(table: str, tolerance: float) -> None:
    assert parse_scene(CHAIN + "[accuracy]\n" + table).accuracy.relative_tolerance == tolerance


def test_scenes_are_frozen_and_hashable() -> None:
    scene = parse_scene(CHAIN + family(mode="[1, 2]", at="[0.2]"))
    assert hash(scene) == hash(parse_scene(CHAIN + family(mode="[1, 2]", at="[0.2]")))
    with pytest.raises(AttributeError):
        scene.title = "other"  # type: ignore[misc]


def test_limits_of_time_that_are_none_are_refused() -> None:
    for given in ("'5'", "0", "-1.0", "inf", "nan", "true"):
        message = fault_of(f"time_limit = {given}\n" + CHAIN + FAMILY)
        assert message.startswith("time_limit: given ")
        assert message.endswith("; accepted: a number > 0 and <= 1e7")


def test_same_request_ignores_the_title_and_the_limit_of_time_alone() -> None:
    scene = parse_scene("title = 'a'\n" + CHAIN + FAMILY)
    assert scene.same_request(parse_scene("time_limit = 5\n" + CHAIN + FAMILY))
    assert scene.same_request(parse_scene("title = 'b'\n" + CHAIN + FAMILY))
    assert scene.same_request(parse_scene(CHAIN + FAMILY + "[method]\nflow = 'splitting'"))
    assert not scene.same_request(parse_scene(chain(g="-1.5") + FAMILY))
    assert not scene.same_request(parse_scene(CHAIN + FAMILY + "[stability]\n"))
    assert scene != parse_scene("title = 'b'\n" + CHAIN + FAMILY)


# Refused: names -------------------------------------------------------------------------------------------


def test_long_names_are_cut() -> None:
    for key in ("k" * 61, "k" * 10_000):
        shown = "k" * 57 + "..."
        assert fault_of(f"{key} = 1").startswith(f"{shown}: unknown key; ")
        assert fault_of(f"[{key}]").startswith(f"[{shown}]: unknown table; ")
        assert fault_of(f"[chain]\n{key} = 1").startswith(f"[chain] {shown}: unknown key; ")


SITES = "accepted: a whole number >= 1 and <= 10000000, or inf"


@pytest.mark.parametrize(("scene", "message"), REFUSED, ids=[message[:60] for _, message in REFUSED])
def test_refused_scenes(scene: str, message: str) -> None:
    assert fault_of(scene) == message


def test_numbers_without_end_are_cut() -> None:
    for given, shown in (("1" + "0" * 400, f"1{'0' * 56}..."), ("0x" + "f" * 4000, f"0x{'f' * 55}...")):
        assert fault_of(chain(sites=given)) == f"[chain] sites: given {shown}; {SITES}"


# Time evolution -------------------------------------------------------------------------------------------


def test_dynamics_values_and_defaults() -> None:
    asked = parse_scene(CHAIN + FAMILY + dynamics()).dynamics
    assert asked == DynamicsTable(S=0.2, duration=40.0, method="cvodes", tolerance=1e-11)
    for accepted in (dynamics(), dynamics(size="1", site="24"), dynamics(size="1", vector=str([0] * 23 + [1]))):
        parse_scene(chain(gamma="1.0") + FAMILY + accepted)  # at the exceptional point the edge alone is kicked


# Refused: what ties the chain and the family --------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.0, 0.25, -0.9])
def test_a_mode_must_oscillate(gamma: float) -> None:
    cosine = math.cos(3 * math.pi / 25)
    bound = -2 + 2 * math.sqrt(1 - gamma**2) * cosine
    oscillating = family(mode="3")
    parse_scene(chain(gamma=str(gamma), alpha=repr(bound + 1e-9)) + oscillating)
    message = fault_of(chain(gamma=str(gamma), alpha=repr(bound - 0.125)) + oscillating)
    assert message.startswith("[family] mode: given mode 3, which has omega^2 = -0.125 at alpha = ")
    assert "omega^2 > 0; for mode 3: alpha > " in message
    assert float(message.rpartition("> ")[2]) == pytest.approx(bound, rel=1e-10)


def test_only_the_modes_asked_for_must_oscillate() -> None:
    parse_scene(chain(alpha="-1.0") + family(mode="24"))
    assert "given mode 1, which" in fault_of(chain(alpha="-1.0") + family(mode="[24, 1]"))


# Refused: text and files ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (CHAIN + "a\n", ("not TOML: ", "(at line 6, column 2)")),
        (CHAIN + CHAIN, ("not TOML: ", "('chain',) twice", "(at line 6, column 7)")),
        ("title = 1\ntitle = 2", ("not TOML: Cannot overwrite a value",)),
        (f"['{'x' * 999}']\n['{'x' * 999}']", ("not TOML: ", "...", "(at line 2, column 1003)")),
        ("a = " + "[" * 5000, ("not TOML: nested too deeply",)),
        ("a = " + "1" * 5000, ("not TOML: ", "4300 digits")),
        ("title = '\ud800'\n" + CHAIN, ("not TOML: ", "surrogates")),
        ("chain" + ".a" * 900 + " = 1", ("[chain] a: unknown key",)),
        ("chain = {sites" + ".a" * 900 + " = 1, alpha = 1, gamma = 0, g = 1}", ("sites: given a table",)),
    ],
)
def test_text_that_is_no_scene(text: str, parts: tuple[str, ...]) -> None:
    message = fault_of(text)
    for part in parts:
        assert part in message


def file_fault(path: str | Path) -> str:
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    assert str(caught.value).isprintable()
    return str(caught.value)


def test_read_scene(tmp_path: Path) -> None:
    path = tmp_path / "soft.toml"
    path.write_text(CHAIN + FAMILY, encoding="utf-8")
    assert read_scene(path) == read_scene(str(path)) == parse_scene(CHAIN + FAMILY)
    path.write_bytes(b"\xef\xbb\xbf" + (CHAIN + FAMILY).replace("\n", "\r\n").encode())
    assert read_scene(path) == parse_scene(CHAIN + FAMILY)


def test_faults_in_a_file_name_it_as_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("soft.toml").write_text("chain = 3")
    assert file_fault("./soft.toml").startswith("./soft.toml: [chain]: given 3")
    Path("new\nline.toml").write_text("chain = 3")
    assert file_fault("new\nline.toml").startswith("new\\nline.toml: [chain]: given 3")


@pytest.mark.parametrize(
    ("path", "reason"),
    [("none.toml", "No such file"), (".", "directory"), ("", "directory"), ("a\0b", "null"), ("x" * 999, "long")],
)
def test_files_that_are_not_there(path: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    message = file_fault(path)
    assert message.startswith(f"{path or '.'}: cannot be read: ".replace("\0", "\\x00"))
    assert reason in message


def test_files_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "latin.toml"
    path.write_bytes("title = 'é'".encode("latin-1"))
    assert file_fault(path) == f"{path}: not UTF-8 at byte 9; accepted: TOML in UTF-8"

    def deny(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "read_bytes", deny)
    assert file_fault("a.toml") == "a.toml: cannot be read: Permission denied; accepted: a file in TOML"


# For editors and for a quick start ------------------------------------------------------------------------


def test_the_schema_says_what_the_messages_say() -> None:
    tables = json.loads(json.dumps(scene_schema()))["$defs"]
    assert tables["Scene"]["anyOf"] == [{"required": [name]} for name in ("chain", "lattice", "model")]
    assert not tables["FamilyTable"]["additionalProperties"]
    sites = tables["ChainTable"]["properties"]["sites"]
    whole, infinite = sites["anyOf"]
    assert (whole["minimum"], whole["maximum"], infinite["type"]) == (1, 10_000_000, "number")
    assert f"accepted: {sites['description']}" == SITES
    assert tables["MethodTable"]["properties"]["walker"]["enum"] == ["arclength", "series"]
    for table in tables.values():
        for key in table["properties"].values():
            assert "$ref" in str(key) or (key["title"] and key["description"])


def test_reading_a_scene_loads_no_numerics() -> None:
    code = "import sys, casadi_skin.runs.reading; print([m for m in ('casadi', 'numpy', 'scipy') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
