"""Scenes: what is accepted, and for each fault the one line that names it."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest
from refusals import refusals
from scenes import chain, family, table

from casadi_skin.runs.reading import parse_scene, read_scene, scene_schema
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import (
    PRESET_TOLERANCES,
    ChainTable,
    DynamicsTable,
    FamilyTable,
    MethodTable,
    Scene,
    SpectrumTable,
    StabilityTable,
)

CHAIN, FAMILY = chain(24), family(1, 3.0)
REFUSED = refusals(Path(__file__).with_name("refused_scenes.txt"), {"<chain>": CHAIN, "<family>": FAMILY})
SITES = "accepted: a whole number >= 1 and <= 10000000, or inf"


def fault_of(text: str) -> str:
    """The message of the fault, checked to be one line that begins with the source."""
    with pytest.raises(SceneError) as caught:
        parse_scene(text, "softening.toml")
    message = str(caught.value)
    assert message.startswith("softening.toml: ")
    assert message.isprintable()
    assert len(message) < 500
    assert caught.value.__cause__ is None
    return message.removeprefix("softening.toml: ")


# Accepted -------------------------------------------------------------------------------------------------


def test_a_chain_alone_asks_for_nothing_else_and_a_scene_is_frozen() -> None:
    scene = parse_scene(CHAIN)
    assert scene == Scene(chain=ChainTable(sites=24, alpha=1.0, gamma=0.25, g=-1.0))
    assert scene.method == MethodTable(transcription=None, corrector="ipopt", walker=None, flow=None)
    assert hash(scene) == hash(parse_scene(CHAIN))
    with pytest.raises(AttributeError):
        scene.title = "other"  # type: ignore[misc]


def test_the_scene_of_the_manual() -> None:
    method = {"transcription": "gauss", "corrector": "newton", "walker": "arclength", "flow": "cvodes"}
    scene = parse_scene(
        f'title = "Softening end breather"\n{CHAIN}[spectrum]\n{FAMILY}at = [0.2, 1, 2.0, 3.0]\n'
        + '[stability]\nevents = true\n[accuracy]\npreset = "reference"\n'
        + table("method", **method)
    )
    assert scene.title == "Softening end breather"
    assert scene.spectrum == SpectrumTable()
    assert scene.family == FamilyTable(mode=1, amplitude_max=3.0, at=(0.2, 1.0, 2.0, 3.0))
    assert isinstance(scene.family.at[1], float)  # whole numbers serve as floats
    assert scene.stability == StabilityTable(events=True)
    assert scene.accuracy.relative_tolerance == 1e-12
    assert scene.method == MethodTable(**method)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given", "modes"), [(1, (1,)), ([3], (3,)), ([24, 1, 2], (24, 1, 2)), (["last", 2, "first"], (24, 2, 1))]
)
def test_modes_are_a_tuple_in_the_order_given(given: object, modes: tuple[int, ...]) -> None:
    assert parse_scene(CHAIN + family(given)).modes() == modes


@pytest.mark.parametrize(
    "text",
    [
        chain(24, g=0.0),
        chain(24, alpha=-5.0),
        chain(24, gamma=-1),
        chain(1) + FAMILY,
        chain(10_000_000) + family(10_000_000, 3.0),
        chain(24, gamma=1.0) + FAMILY,
        chain(24, gamma=-1.0, g=1.0) + family(24, 3.0),
        chain(24, gamma=1.0, g=0.5) + family(24, 3.0),
        chain(10_000_000, 0.0, 0.0) + FAMILY,
        chain(24, -1.0) + family(24),  # only the modes asked for must oscillate
        CHAIN + family(1, 3.0, at=[]),
        CHAIN + family(1, 3.0, at=[3.0]),
        CHAIN + family(1, 3.0, at_Omega=[0.9, 0.95], at_period=[7, 6.5], period_max=7, max_points=1),
        CHAIN + "[accuracy]\ntolerance = 1e-13\n[method]\n",
        CHAIN + "[accuracy]\ntolerance = 1e-2\n",
        CHAIN + FAMILY + "[stability]\nevents = false\n",
        chain(24, gamma=1.0) + FAMILY + table("dynamics", S=0.2, duration=40, size=1, site=24),  # the edge alone
        chain(24, gamma=1.0) + FAMILY + table("dynamics", S=0.2, duration=40, size=1, vector=[0] * 23 + [1]),
        "title = ''\nchain = {sites = 2, alpha = 0, gamma = 0, g = 1}",
    ],
)
def test_accepted(text: str) -> None:
    parse_scene(text)


@pytest.mark.parametrize(
    ("table", "tolerance"),
    [
        ("", 1e-8),
        ("tolerance = 1e-9", 1e-9),
        *((f'preset = "{name}"', value) for name, value in PRESET_TOLERANCES.items()),
    ],
)
def test_tolerance_that_holds(table: str, tolerance: float) -> None:
    assert parse_scene(CHAIN + "[accuracy]\n" + table).accuracy.relative_tolerance == tolerance


def test_dynamics_values_and_defaults() -> None:
    asked = parse_scene(CHAIN + FAMILY + table("dynamics", S=0.2, duration=40)).dynamics
    assert asked == DynamicsTable(S=0.2, duration=40.0, method="cvodes", tolerance=1e-11)


def test_same_request_ignores_the_title_and_the_limit_of_time_alone() -> None:
    scene = parse_scene("title = 'a'\n" + CHAIN + FAMILY)
    for before, after in (("time_limit = 5\n", ""), ("title = 'b'\n", ""), ("", "[method]\nflow = 'splitting'")):
        assert scene.same_request(parse_scene(before + CHAIN + FAMILY + after))
    assert not scene.same_request(parse_scene(chain(24, g=-1.5) + FAMILY))
    assert not scene.same_request(parse_scene(CHAIN + FAMILY + "[stability]\n"))
    assert scene != parse_scene("title = 'b'\n" + CHAIN + FAMILY)


# Refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("scene", "message"), REFUSED, ids=[message[:60] for _, message in REFUSED])
def test_refused_scenes(scene: str, message: str) -> None:
    assert fault_of(scene) == message


def test_long_names_and_numbers_are_cut() -> None:
    for key in ("k" * 61, "k" * 10_000):
        shown = "k" * 57 + "..."
        assert fault_of(f"{key} = 1").startswith(f"{shown}: unknown key; ")
        assert fault_of(f"[{key}]").startswith(f"[{shown}]: unknown table; ")
        assert fault_of(f"[chain]\n{key} = 1").startswith(f"[chain] {shown}: unknown key; ")
    many = fault_of(CHAIN + "".join(f"{'x' * 50}{i} = 1\n" for i in range(40)))
    assert many.endswith(" more")
    for given, shown in (("1" + "0" * 400, f"1{'0' * 56}..."), ("0x" + "f" * 4000, f"0x{'f' * 55}...")):
        assert fault_of(CHAIN.replace("24", given)) == f"[chain] sites: given {shown}; {SITES}"


@pytest.mark.parametrize("given", ["'5'", "0", "-1.0", "inf", "nan", "true"])
def test_limits_of_time_that_are_none_are_refused(given: str) -> None:
    message = fault_of(f"time_limit = {given}\n" + CHAIN + FAMILY)
    assert message.startswith("time_limit: given ")
    assert message.endswith("; accepted: a number > 0 and <= 1e7")


@pytest.mark.parametrize("gamma", [0.0, 0.25, -0.9])
def test_a_mode_must_oscillate(gamma: float) -> None:
    bound = -2 + 2 * math.sqrt(1 - gamma**2) * math.cos(3 * math.pi / 25)
    parse_scene(chain(24, bound + 1e-9, gamma) + family(3))
    message = fault_of(chain(24, bound - 0.125, gamma) + family([24, 3]))
    assert message.startswith("[family] mode: given mode 3, which has omega^2 = -0.125 at alpha = ")
    assert "omega^2 > 0; for mode 3: alpha > " in message
    assert float(message.rpartition("> ")[2]) == pytest.approx(bound, rel=1e-10)


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


# Files ----------------------------------------------------------------------------------------------------


def test_files_as_editors_write_them_and_faults_name_them_as_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path("soft.toml")
    for data in ((CHAIN + FAMILY).encode(), b"\xef\xbb\xbf" + (CHAIN + FAMILY).replace("\n", "\r\n").encode()):
        path.write_bytes(data)
        assert read_scene(path) == read_scene("soft.toml") == parse_scene(CHAIN + FAMILY)
    for name in ("./soft.toml", "new\nline.toml"):
        Path(name).write_text("chain = 3")
        with pytest.raises(SceneError) as caught:
            read_scene(name)
        assert str(caught.value).startswith(name.replace("\n", "\\n") + ": [chain]: given 3")


def deny(self: Path, _: str) -> bytes:
    raise PermissionError(13, "Permission denied", str(self))


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        *(("none.toml", "No such file"), (".", "directory"), ("", "directory"), ("a\0b", "null"), ("x" * 999, "long")),
        *(("latin.toml", "not UTF-8 at byte 9; accepted: TOML in UTF-8"), ("denied.toml", "Permission denied; accep")),
    ],
)
def test_files_that_cannot_be_read(path: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("latin.toml").write_bytes("title = 'é'".encode("latin-1"))
    if path == "denied.toml":
        monkeypatch.setattr(Path, "open", deny)
    with pytest.raises(SceneError) as caught:
        read_scene(path)
    message = str(caught.value)
    assert message.isprintable()
    assert message.startswith(f"{path or '.'}: ".replace("\0", "\\x00"))
    assert reason in message


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
    for each in tables.values():
        for key in each["properties"].values():
            assert "$ref" in str(key) or (key["title"] and key["description"])


def test_reading_a_scene_loads_no_numerics() -> None:
    code = "import sys, casadi_skin.runs.reading; print([m for m in ('casadi', 'numpy', 'scipy') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
