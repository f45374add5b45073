"""Scenes: what is accepted, and for each fault the one line that names it."""

import json
import math
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from casadi_skin.runs.reading import parse_scene, read_scene, scene_schema
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import (
    PRESET_TOLERANCES,
    PRESETS,
    AccuracyTable,
    ChainTable,
    DynamicsTable,
    FamilyTable,
    MethodTable,
    SpectrumTable,
    StabilityTable,
)

CHAIN = "[chain]\nsites = 24\nalpha = 1.0\ngamma = 0.25\ng = -1.0\n"
FAMILY = "[family]\nmode = 1\namplitude_max = 3.0\n"
NAMES = (
    *(
        "chain",
        "lattice",
        "model",
        "spectrum",
        "family",
        "equilibrium",
        "orbit",
        "solution",
        "continuation",
        "stability",
        "dynamics",
    ),
    *("search", "export", "figures", "map", "accuracy", "method"),
)
TABLES = f"accepted: {', '.join(f'[{name}]' for name in NAMES)}, title, time_limit"


def chain(**changes: str) -> str:
    keys = {"sites": "24", "alpha": "1.0", "gamma": "0.25", "g": "-1.0"} | changes
    return "[chain]\n" + "".join(f"{key} = {value}\n" for key, value in keys.items())


def family(**changes: str) -> str:
    keys = {"mode": "1", "amplitude_max": "3.0"} | changes
    return "[family]\n" + "".join(f"{key} = {value}\n" for key, value in keys.items())


def dynamics(**changes: str) -> str:
    keys = {"S": "0.2", "duration": "40"} | changes
    return "[dynamics]\n" + "".join(f"{key} = {value}\n" for key, value in keys.items() if value)


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
    assert (scene.title, scene.spectrum, scene.family, scene.stability) == (None, None, None, None)
    assert scene.dynamics is None
    assert scene.accuracy.relative_tolerance == 1e-8
    assert (scene.model, scene.orbit, scene.solution, scene.continuation) == (None, None, None, None)
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
    [
        ("", 1e-8),
        ('preset = "draft"', 1e-4),
        ('preset = "standard"', 1e-8),
        ('preset = "reference"', 1e-12),
        ("tolerance = 1e-9", 1e-9),
    ],
)
def test_tolerance_that_holds(table: str, tolerance: float) -> None:
    assert parse_scene(CHAIN + "[accuracy]\n" + table).accuracy.relative_tolerance == tolerance


def test_every_preset_has_a_tolerance() -> None:
    assert tuple(PRESET_TOLERANCES) == PRESETS


def test_scenes_are_frozen_and_hashable() -> None:
    scene = parse_scene(CHAIN + family(mode="[1, 2]", at="[0.2]"))
    assert hash(scene) == hash(parse_scene(CHAIN + family(mode="[1, 2]", at="[0.2]")))
    with pytest.raises(AttributeError):
        scene.title = "other"  # type: ignore[misc]


@pytest.mark.parametrize("given", ["'5'", "0", "-1.0", "inf", "nan", "true"])
def test_limits_of_time_that_are_none_are_refused(given: str) -> None:
    with pytest.raises(SceneError, match=r"time_limit: given .*; accepted: a number > 0 and <= 1e7$"):
        parse_scene(f"time_limit = {given}\n" + CHAIN + FAMILY)


def test_same_request_ignores_the_title_and_the_limit_of_time_alone() -> None:
    scene = parse_scene("title = 'a'\n" + CHAIN + FAMILY)
    assert scene.same_request(parse_scene("time_limit = 5\n" + CHAIN + FAMILY))
    assert scene.same_request(parse_scene("title = 'b'\n" + CHAIN + FAMILY))
    assert scene.same_request(parse_scene(CHAIN + FAMILY + "[method]\nflow = 'splitting'"))
    assert not scene.same_request(parse_scene(chain(g="-1.5") + FAMILY))
    assert not scene.same_request(parse_scene(CHAIN + FAMILY + "[stability]\n"))
    assert scene != parse_scene("title = 'b'\n" + CHAIN + FAMILY)


# Refused: names -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[chian]\nsites = 3", f"[chian]: unknown table; did you mean [chain]? ({TABLES})"),
        ("[[chian]]", f"[chian]: unknown table; did you mean [chain]? ({TABLES})"),
        ("[CHAIN]", f"[CHAIN]: unknown table; did you mean [chain]? ({TABLES})"),
        (CHAIN + "[zzz]", f"[zzz]: unknown table; {TABLES}"),
        ("zzz = 1\n" + CHAIN, f"zzz: unknown key; {TABLES}"),
        ("titel = 'x'\n" + CHAIN, f"titel: unknown key; did you mean title? ({TABLES})"),
        (
            "[chain]\nsitse = 3",
            "[chain] sitse: unknown key; did you mean 'sites'? (accepted: sites, alpha, gamma, g)",
        ),
        (CHAIN + "zzz = 3", "[chain] zzz: unknown key; accepted: sites, alpha, gamma, g"),
        (CHAIN + "[spectrum]\nmodes = 3", "[spectrum] modes: unknown key; accepted: no keys"),
        (
            CHAIN + family(amplitude="2.0"),
            "[family] amplitude: unknown key; did you mean 'amplitude_max'? (accepted: mode, amplitude_max, at, "
            "at_Omega, at_period, period_max, max_points, film)",
        ),
        (CHAIN + '"a\\n\\u2028b" = 1', "[chain] a\\n\\u2028b: unknown key; accepted: sites, alpha, gamma, g"),
        (
            "",
            "[chain]: missing; accepted: a table with sites, alpha, gamma, g, "
            "a table [lattice] with cells and site, or a table [model] with file",
        ),
        ("[chain]\nsites = 3\nalpha = 1\ng = 1", "[chain] gamma: missing; accepted: a number >= -1 and <= 1"),
        (CHAIN + "[family]\nmode = 1", "[family] amplitude_max: missing; accepted: a finite number > 0"),
        ("chain = 3", "[chain]: given 3 (a whole number); accepted: one table [chain]"),
        ("family = []\n" + CHAIN, "[family]: given [] (an array); accepted: one table [family]"),
        ("[[chain]]\nsites = 3", "[chain]: given an array of tables; accepted: one table [chain]"),
        (CHAIN + "[title]", "title: given a table; accepted: a string"),
        ("title = 3\n" + CHAIN, "title: given 3 (a whole number); accepted: a string"),
    ],
)
def test_names_and_places(text: str, message: str) -> None:
    assert fault_of(text) == message


@pytest.mark.parametrize(("key", "shown"), [("k" * 61, "k" * 57 + "..."), ("k" * 10_000, "k" * 57 + "...")])
def test_long_names_are_cut(key: str, shown: str) -> None:
    assert fault_of(f"{key} = 1").startswith(f"{shown}: unknown key; ")
    assert fault_of(f"[{key}]").startswith(f"[{shown}]: unknown table; ")
    assert fault_of(f"[chain]\n{key} = 1").startswith(f"[chain] {shown}: unknown key; ")


# Refused: types and bounds --------------------------------------------------------------------------------

SITES = "accepted: a whole number >= 1 and <= 10000000, or inf"
FINITE = "accepted: a finite number"
MODES = 'accepted: a mode from 1 to sites (of a model: positions), "first" or "last", or a list of such modes'
AT = "accepted: a list of numbers > 0, ascending up to amplitude_max"
POINTS = "accepted: a whole number >= 1 and <= 1000000 (left out: 2000)"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sites": '"24"'}, f'[chain] sites: given "24" (a string); {SITES}'),
        ({"sites": "24.0"}, f"[chain] sites: given 24.0; {SITES}"),
        ({"sites": "true"}, f"[chain] sites: given true (a boolean); {SITES}"),
        ({"sites": "[24]"}, f"[chain] sites: given [24] (an array); {SITES}"),
        ({"sites": "{n = 24}"}, f"[chain] sites: given a table; {SITES}"),
        ({"sites": "[{n = 24}]"}, f"[chain] sites: given an array of tables; {SITES}"),
        ({"sites": "2024-02-29"}, f"[chain] sites: given 2024-02-29 (a date or time); {SITES}"),
        ({"sites": "nan"}, f"[chain] sites: given nan; {SITES}"),
        ({"sites": "0"}, f"[chain] sites: given 0; {SITES}"),
        ({"sites": "-3"}, f"[chain] sites: given -3; {SITES}"),
        ({"sites": "10_000_001"}, f"[chain] sites: given 10000001; {SITES}"),
        ({"sites": "1" + "0" * 400}, f"[chain] sites: given 1{'0' * 56}...; {SITES}"),
        ({"sites": "0x" + "f" * 4000}, f"[chain] sites: given 0x{'f' * 55}...; {SITES}"),
        ({"alpha": "nan"}, f"[chain] alpha: given nan; {FINITE}"),
        ({"alpha": "-inf"}, f"[chain] alpha: given -inf; {FINITE}"),
        ({"alpha": "1e999"}, f"[chain] alpha: given inf; {FINITE}"),
        ({"alpha": "1" + "0" * 400}, f"[chain] alpha: given 1{'0' * 56}...; {FINITE}"),
        ({"alpha": "false"}, f"[chain] alpha: given false (a boolean); {FINITE}"),
        ({"alpha": '"' + "x" * 99 + '"'}, f'[chain] alpha: given "{"x" * 56}... (a string); {FINITE}'),
        ({"alpha": '"a\\nb\\u2028"'}, f'[chain] alpha: given "a\\nb\\u2028" (a string); {FINITE}'),
        ({"g": "inf"}, f"[chain] g: given inf; {FINITE}"),
        ({"gamma": "1.5"}, "[chain] gamma: given 1.5; accepted: a number >= -1 and <= 1"),
        ({"gamma": "-2"}, "[chain] gamma: given -2; accepted: a number >= -1 and <= 1"),
        ({"gamma": "nan"}, "[chain] gamma: given nan; accepted: a number >= -1 and <= 1"),
        (
            {"gamma": "[[1, [2, [3, [4]]]]]"},
            "[chain] gamma: given [[1, [2, [...]]]] (an array); accepted: a number >= -1 and <= 1",
        ),
    ],
)
def test_chain_values(changes: dict[str, str], message: str) -> None:
    assert fault_of(chain(**changes)) == message


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"amplitude_max": "-1.0"}, "[family] amplitude_max: given -1.0; accepted: a finite number > 0"),
        ({"amplitude_max": "0"}, "[family] amplitude_max: given 0; accepted: a finite number > 0"),
        ({"amplitude_max": "inf"}, "[family] amplitude_max: given inf; accepted: a finite number > 0"),
        ({"amplitude_max": "nan"}, "[family] amplitude_max: given nan; accepted: a finite number > 0"),
        ({"mode": "1.0"}, f"[family] mode: given 1.0 (a float); {MODES}"),
        ({"mode": "true"}, f"[family] mode: given true (a boolean); {MODES}"),
        ({"mode": "'all'"}, f'[family] mode: given "all"; {MODES}'),
        ({"mode": "[1, '2']"}, f'[family] mode: given "2" as item 2; {MODES}'),
        ({"mode": "[1, 2.0]"}, f"[family] mode: given 2.0 (a float) as item 2; {MODES}"),
        ({"mode": "[]"}, f"[family] mode: given []; {MODES}"),
        ({"mode": "0"}, "[family] mode: given 0; accepted: whole numbers from 1 to 24 (sites), first, last"),
        ({"mode": "25"}, "[family] mode: given 25; accepted: whole numbers from 1 to 24 (sites), first, last"),
        ({"mode": "[1, -1]"}, "[family] mode: given -1; accepted: whole numbers from 1 to 24 (sites), first, last"),
        ({"mode": "[2, 1, 2]"}, "[family] mode: given 2 more than once; accepted: each mode once"),
        ({"mode": "[" + "9" * 400 + "]"}, f"[family] mode: given {'9' * 57}...; {MODES}"),
        ({"at": "0.2"}, f"[family] at: given 0.2 (a float); {AT}"),
        ({"at": "[0.2, true]"}, f"[family] at: given true (a boolean) as item 2; {AT}"),
        ({"at": "[0.0]"}, f"[family] at: given 0.0 as item 1; {AT}"),
        ({"at": "[0.2, nan]"}, f"[family] at: given nan as item 2; {AT}"),
        ({"at": "[0.2, inf]"}, f"[family] at: given inf as item 2; {AT}"),
        ({"at": "[" + "9" * 400 + "]"}, f"[family] at: given {'9' * 57}...; {AT}"),
        ({"at": "[0.2, 3.1]"}, "[family] at: given 3.1 as item 2; accepted: numbers <= amplitude_max = 3.0"),
        (
            {"at": "[0.2, 0.2]"},
            "[family] at: given 0.2 as item 2 after 0.2; accepted: numbers in strictly ascending order",
        ),
        ({"at_Omega": "0.5"}, "[family] at_Omega: given 0.5 (a float); accepted: a list of numbers > 0, each once"),
        ({"at_Omega": "[-0.5]"}, "[family] at_Omega: given -0.5 as item 1; accepted: a list of numbers > 0, each once"),
        ({"at_Omega": "[0.9, 0.5, 0.9]"}, "[family] at_Omega: given 0.9 as item 3 again; accepted: each number once"),
        (
            {"at_Omega": "[0.9, 0.5]", "period_max": "10"},
            "[family] at_Omega: given 0.5 as item 2; accepted: numbers >= 2 pi/period_max = 0.628318530718",
        ),
        (
            {"at_period": "[8.0, nan]"},
            "[family] at_period: given nan as item 2; accepted: a list of numbers > 0, each once, up to period_max",
        ),
        ({"at_period": "[7, 7.0]"}, "[family] at_period: given 7.0 as item 2 again; accepted: each number once"),
        (
            {"at_period": "[8, 12]", "period_max": "10"},
            "[family] at_period: given 12.0 as item 2; accepted: numbers <= period_max = 10.0",
        ),
        (
            {"period_max": "6"},
            "[family] period_max: given 6.0; accepted: a finite number > 6.04942085495 (the period of linear mode 1)",
        ),
        (
            {"period_max": "inf"},
            "[family] period_max: given inf; accepted: a finite number > 0, above the period of the linear mode "
            "(left out: no end)",
        ),
        ({"max_points": "0"}, f"[family] max_points: given 0; {POINTS}"),
        ({"max_points": "1e3"}, f"[family] max_points: given 1000.0 (a float); {POINTS}"),
        ({"max_points": "1_000_001"}, f"[family] max_points: given 1000001; {POINTS}"),
    ],
)
def test_family_values(changes: dict[str, str], message: str) -> None:
    assert fault_of(CHAIN + family(**changes)) == message


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (
            FAMILY + "[stability]\nevents = 1",
            "[stability] events: given 1 (a whole number); accepted: true or false",
        ),
        (
            "[stability]",
            "[stability]: given without [family], [orbit] or [solution]; accepted: beside a [family], an [orbit] or a "
            "[solution], or with "
            '"hopf" in [continuation] switch, whose stability it asks for',
        ),
        (
            '[accuracy]\npreset = "standart"',
            '[accuracy] preset: given "standart"; did you mean "standard"? '
            '(accepted: "draft", "standard", "reference")',
        ),
        (
            '[accuracy]\npreset = "best"',
            '[accuracy] preset: given "best"; accepted: "draft", "standard", "reference"',
        ),
        (
            "[accuracy]\npreset = 1e-8",
            '[accuracy] preset: given 1e-08 (a float); accepted: "draft", "standard", "reference"',
        ),
        (
            '[accuracy]\npreset = "draft"\ntolerance = 1e-9',
            '[accuracy]: given preset = "draft" and tolerance = 1e-09; '
            "accepted: preset or tolerance, one of them or neither",
        ),
        (
            "[accuracy]\ntolerance = 9e-14",
            "[accuracy] tolerance: given 9e-14; accepted: a number >= 1e-13 and <= 1e-2",
        ),
        (
            "[accuracy]\ntolerance = 0.1",
            "[accuracy] tolerance: given 0.1; accepted: a number >= 1e-13 and <= 1e-2",
        ),
        (
            "[accuracy]\ntolerance = nan",
            "[accuracy] tolerance: given nan; accepted: a number >= 1e-13 and <= 1e-2",
        ),
        (
            '[method]\nflow = "cvode"',
            '[method] flow: given "cvode"; did you mean "cvodes"? (accepted: "splitting", "cvodes" for '
            'families (left out: splitting); "collocation", "cvodes" for orbits (left out: collocation))',
        ),
        (
            '[method]\ncorrector = "Ipopt"',
            '[method] corrector: given "Ipopt"; did you mean "ipopt"? (accepted: "ipopt", "newton")',
        ),
        (
            '[method]\ntranscription = "x"',
            '[method] transcription: given "x"; accepted: "trigonometric", "gauss", "radau", "shooting" (left out: '
            "trigonometric for families whose model is odd and reversible, else gauss)",
        ),
        (
            '[method]\ntranscription = "radau"\ndegree = 13',
            "[method] degree: given 13; accepted: a whole number >= 1 (families: 2) and <= 12, with one of gauss, "
            "radau (left out: families 5 to 12 by the tolerance, others 6)",
        ),
        (
            FAMILY + '[method]\ntranscription = "gauss"\ndegree = 1',
            "[method] degree: given 1; accepted: with a [family] a whole number >= 2 and <= 12",
        ),
        (
            FAMILY + "[method]\ndegree = 4",
            '[method] degree: given 4 with transcription = "trigonometric"; '
            'accepted: with transcription = "gauss" or "radau" only',
        ),
    ],
)
def test_stability_accuracy_and_method_values(tables: str, message: str) -> None:
    assert fault_of(CHAIN + tables) == message


# Refused: time evolution ----------------------------------------------------------------------------------


def test_dynamics_values_and_defaults() -> None:
    asked = parse_scene(CHAIN + FAMILY + dynamics()).dynamics
    assert asked == DynamicsTable(S=0.2, duration=40.0, method="cvodes", tolerance=1e-11)
    kick = {"size": "0.005", "vector": str([1.0] * 48)}
    several = {"mode": "3", "duration": "", "periods": "7", "samples": "100", "method": "'symplectic'"}
    asked = parse_scene(CHAIN + family(mode="[1, 3]") + dynamics(**several, **kick)).dynamics
    assert asked is not None
    assert (asked.mode, asked.periods, asked.samples, asked.vector) == (3, 7.0, 100, (1.0,) * 48)


MODE = "accepted: one of the modes of [family]"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"S": ""}, "[dynamics] S: missing; accepted: a finite number > 0, up to amplitude_max"),
        ({"S": "3.5"}, "[dynamics] S: given 3.5; accepted: a number <= amplitude_max = 3.0"),
        ({"S": "nan"}, "[dynamics] S: given nan; accepted: a finite number > 0, up to amplitude_max"),
        ({"mode": "3"}, f"[dynamics] mode: given 3; {MODE}, [1, 2]"),
        ({"mode": ""}, f"[dynamics] mode: missing; {MODE}, [1, 2]"),
        (
            {"mode": "[1]"},
            f"[dynamics] mode: given [1] (an array); {MODE}, required where these are "
            "several; without [family] and [orbit] a linear mode from 1",
        ),
        (
            {"duration": ""},
            "[dynamics]: given neither duration nor periods; accepted: duration or periods, one of them",
        ),
        ({"periods": "2"}, "[dynamics]: given duration and periods; accepted: duration or periods, one of them"),
        ({"duration": "-1"}, "[dynamics] duration: given -1; accepted: a finite number > 0"),
        ({"duration": "inf"}, "[dynamics] duration: given inf; accepted: a finite number > 0"),
        (
            {"samples": "1"},
            "[dynamics] samples: given 1; accepted: a whole number >= 2 and <= 1000000 "
            "(left out: 20 a period, 401 to 4001 in all)",
        ),
        (
            {"method": "'dop85'"},
            '[dynamics] method: given "dop85"; did you mean "dop853"? (accepted: "cvodes", "dop853", "symplectic")',
        ),
        ({"tolerance": "1e-14"}, "[dynamics] tolerance: given 1e-14; accepted: a number >= 1e-13 and <= 1e-2"),
        ({"site": "1"}, "[dynamics] size: missing; accepted: beside site a finite number > 0"),
        ({"size": "0.005"}, "[dynamics] size: given 0.005; accepted: beside one of site, vector, seed"),
        (
            {"size": "0.0", "site": "1"},
            "[dynamics] size: given 0.0; accepted: a finite number > 0, with one of site, vector, seed "
            "(without an orbit also mode)",
        ),
        ({"size": "1", "site": "25"}, "[dynamics] site: given 25; accepted: whole numbers from 1 to 24 (sites)"),
        (
            {"size": "1", "site": "1", "seed": "1"},
            "[dynamics]: given site and seed; accepted: site, vector or seed, one of them or none",
        ),
        (
            {"size": "1", "vector": "[1.0]"},
            "[dynamics] vector: given a list of 1; accepted: 24 displacements, or these and 24 velocities",
        ),
        ({"size": "1", "vector": str([0] * 24)}, "[dynamics] vector: given zeros; accepted: a vector with a direction"),
        ({"size": "1", "seed": "-1"}, "[dynamics] seed: given -1; accepted: a whole number >= 0 and < 2^63"),
        (
            {"period": "2"},
            "[dynamics] period: unknown key; did you mean 'periods'? (accepted: S, mode, moving, duration, periods, "
            "samples, method, tolerance, size, site, vector, seed)",
        ),
    ],
)
def test_wrong_dynamics(changes: dict[str, str], message: str) -> None:
    assert fault_of(CHAIN + family(mode="[1, 2]") + dynamics(**({"mode": "1"} | changes))) == message


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "[dynamics] S: given 0.2; accepted: beside a [family] or an [orbit]"),
        ({"S": "", "mode": ""}, "[dynamics]: given without [family] and [orbit], with none of mode, site, vector, "
         "seed; accepted: one of mode, site, vector, seed, with size and duration, from which motion starts"),
        ({"S": "", "site": "2"}, "[dynamics]: given without [family] and [orbit], with mode and site; accepted: "
         "one of mode, site, vector, seed, with size and duration, from which motion starts"),
        ({"S": "", "size": ""}, "[dynamics] size: missing; accepted: beside mode a finite number > 0"),
        ({"S": "", "duration": ""}, "[dynamics] duration: missing; accepted: beside mode a finite number > 0"),
        ({"S": "", "duration": "", "periods": "2"}, "[dynamics] periods: given 2.0; accepted: beside a [family] or an "
         "[orbit]"),
    ],
)  # fmt: skip
def test_dynamics_without_an_orbit_needs_a_start(given: dict[str, str], message: str) -> None:
    assert fault_of(CHAIN + dynamics(**({"mode": "1", "size": "0.1"} | given))) == message


def test_an_orbit_starts_without_velocities() -> None:
    message = "[dynamics] moving: given true; accepted: without [family] and [orbit], which start at phase zero"
    assert fault_of(CHAIN + FAMILY + dynamics(moving="true")) == message


@pytest.mark.parametrize("kick", [{"site": "23"}, {"seed": "1"}, {"vector": str([0] * 22 + [1] * 2)}])
def test_at_the_exceptional_point_the_edge_alone_is_kicked(kick: dict[str, str]) -> None:
    one_way = chain(gamma="1.0")
    for accepted in (dynamics(), dynamics(size="1", site="24"), dynamics(size="1", vector=str([0] * 23 + [1]))):
        parse_scene(one_way + FAMILY + accepted)
    message = fault_of(one_way + FAMILY + dynamics(size="1", **kick))
    assert message.startswith(f"[dynamics] {next(iter(kick))}: given with gamma = 1.0; accepted: site 24 alone (at ")


def test_dynamics_of_a_chain_whose_far_end_underflows() -> None:
    message = fault_of(chain(sites="1000", gamma="-0.7") + FAMILY + dynamics())
    assert message.endswith("whose far end is below the smallest double; accepted: (sites - 1) artanh|gamma| <= 700")


def test_a_walker_that_does_not_go_with_the_transcription_is_refused() -> None:
    message = fault_of(CHAIN + '[method]\nwalker = "series"\ntranscription = "gauss"')
    assert message.startswith('[method] walker: given "series" with transcription = "gauss"; accepted: "arclength"')


# Refused: what ties the chain and the family --------------------------------------------------------------


@pytest.mark.parametrize("g", ["0", "0.0", "-0.0"])
def test_a_family_needs_a_nonlinearity(g: str) -> None:
    message = fault_of(chain(g=g) + FAMILY)
    assert message.startswith(f"[chain] g: given {float(g)!r}; accepted: ")
    assert "the family would be the linear mode at every amplitude" in message


@pytest.mark.parametrize(
    ("gamma", "g", "mode", "only"),
    [
        ("1.0", "1.0", "1", 24),
        ("-1.0", "1.0", "[24, 2]", 24),
        ("1.0", "-1.0", "24", 1),
        ("-1", "-1.0", "2", 1),
    ],
)
def test_at_the_exceptional_point_one_family_remains(gamma: str, g: str, mode: str, only: int) -> None:
    message = fault_of(chain(gamma=gamma, g=g) + family(mode=mode))
    given = mode.strip("[]").split(", ")[-1]
    assert message.startswith(f"[family] mode: given mode {given} with gamma = {float(gamma)!r}; ")
    assert f"accepted: mode {only} (at |gamma| = 1 all frequencies meet" in message
    assert "only mode N (g > 0) or mode 1 (g < 0), in which the edge site alone moves" in message


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


def test_a_mode_with_omega_zero_is_refused() -> None:
    assert "omega^2 = 0 at alpha = -2.0" in fault_of(chain(gamma="1", alpha="-2.0") + FAMILY)


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
    [
        ("none.toml", "No such file"),
        (".", "directory"),
        ("", "directory"),
        ("a\0b", "null"),
        ("x" * 999, "long"),
    ],
)
def test_files_that_are_not_there(path: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    message = file_fault(path)
    assert message.startswith(f"{path or '.'}: cannot be read: ".replace("\0", "\\x00"))
    assert reason in message


def test_a_file_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def deny(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "read_bytes", deny)
    assert file_fault("a.toml") == "a.toml: cannot be read: Permission denied; accepted: a file in TOML"


def test_a_file_that_is_not_utf8(tmp_path: Path) -> None:
    path = tmp_path / "latin.toml"
    path.write_bytes("title = 'é'".encode("latin-1"))
    assert file_fault(path) == f"{path}: not UTF-8 at byte 9; accepted: TOML in UTF-8"


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


def test_tables_can_be_made_in_python() -> None:
    assert AccuracyTable(tolerance=1e-9).relative_tolerance == 1e-9
    assert msgspec.structs.asdict(MethodTable())["walker"] is None


def test_reading_a_scene_loads_no_numerics() -> None:
    code = "import sys, casadi_skin.runs.reading; print([m for m in ('casadi', 'numpy', 'scipy') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"
