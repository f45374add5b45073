"""Errors that no command expects are one line and exit status 1; those that it can expect name their place."""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import casadi as ca
import msgspec
import pytest
from apart import killing
from scenes import Cli, Runs, chain, family, lattice

from casadi_skin import Chain, OdeModel, follow_family, search_orbit
from casadi_skin.follow.branch import Branch
from casadi_skin.results.saving import saved
from casadi_skin.results.store import framed

EXAMPLES = Path(__file__).parents[2] / "examples"

# The last handler -----------------------------------------------------------------------------------------------------

PROGRAM = """
import sys
from casadi_skin import __main__
from casadi_skin.runs import program
def act(error):
    raise error
def caused():
    try:
        1 / 0
    except ZeroDivisionError as error:
        raise RuntimeError("elsewhere") from error
{act}
__main__.program()
"""
HINT = "; CASADI_SKIN_TRACEBACK=FILE keeps its traceback"


def last_words(act: str, **environment: str) -> tuple[int, str]:
    command = [sys.executable, "-c", PROGRAM.format(act=act)]
    done = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert done.stdout == ""
    return done.returncode, done.stderr


@pytest.mark.parametrize(
    ("act", "words"),
    [
        ("program.main = lambda: act(KeyError('a\\nb'))", f"unexpected error: KeyError: 'a\\nb'{HINT}"),
        ("program.main = lambda: act(ValueError('x\\n' * 500))", f"unexpected error: ValueError: {'x ' * 144}{HINT}"),
        ("program.main = lambda: act(MemoryError())", f"unexpected error: MemoryError{HINT}"),
        ("program.main = caused", f"unexpected error: ZeroDivisionError: division by zero{HINT}"),
        ("sys.modules['casadi_skin.runs.program'] = None", "unexpected error: ModuleNotFoundError: import of"),
    ],
)
def test_an_unexpected_error_is_one_line(act: str, words: str) -> None:
    status, told = last_words(act)
    assert status == 1
    assert told.startswith(f"casadi-skin: {words}")
    assert told.endswith(f"{HINT}\n")
    assert told.count("\n") == 1


def test_its_traceback_goes_to_the_file_that_is_asked_for(tmp_path: Path, cli: Cli) -> None:
    file, act = tmp_path / "traceback", "program.main = lambda: act(KeyError('a'))"
    told = "casadi-skin: unexpected error: KeyError: 'a'; its traceback"
    assert last_words(act, CASADI_SKIN_TRACEBACK=str(file)) == (1, f"{told} is in {file}\n")
    assert file.read_text().startswith("Traceback (most recent call last):\n")
    assert last_words(act, CASADI_SKIN_TRACEBACK=str(tmp_path)) == (1, f"{told}: {tmp_path}: Is a directory\n")
    assert "CASADI_SKIN_TRACEBACK=FILE" in cli("--help").out


def test_an_interruption_before_a_command_begins_is_no_traceback() -> None:
    assert last_words("program.main = lambda: act(KeyboardInterrupt())") == (130, "casadi-skin: interrupted\n")


@pytest.mark.skipif(sys.platform != "linux", reason="limits of the address space are of Linux")
@pytest.mark.parametrize("megabytes", [30, pytest.param(20, marks=pytest.mark.slow)])
def test_an_import_without_memory_is_one_line(megabytes: int, tmp_path: Path) -> None:
    words = "run", EXAMPLES / "fput_modes.toml", "--quiet", "--out", tmp_path
    command = [sys.executable, "-m", "casadi_skin", *map(str, words)]
    limit = (megabytes * 1_000_000,) * 2
    done = subprocess.run(
        command, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, limit), capture_output=True, text=True,
        check=False, timeout=60,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, "")
    assert re.match("casadi-skin: unexpected error: (MemoryError;|ImportError: .*failed to map segment)", done.stderr)
    assert done.stderr.count("\n") == 1


# Errors that are expected ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("first", "last"), [("-" + "9" * 308, "9" * 308), ("9" * 308, "-" + "9" * 308)])
def test_the_ends_of_a_range_that_floats_reach_may_be_too_far_apart(first: str, last: str, run: Runs) -> None:
    scene = chain(4) + family(1, amplitude_max=0.3) + f"[map]\ng = {{ from = {first}, to = {last}, points = 3 }}\n"
    told = run(scene, command="check", status=2).err
    assert "[map] g, to: given " in told
    assert told.count("\n") == 1


@pytest.mark.parametrize("digits", [400, 5000])
def test_an_end_of_many_digits_is_refused(digits: int, run: Runs) -> None:
    scene = chain(4) + family(1, amplitude_max=0.3) + f"[map]\ng = {{ from = 0.1, to = {'9' * digits}, points = 3 }}\n"
    assert run(scene, command="check", status=2).err.count("\n") == 1


def test_a_lattice_of_first_order_has_no_linear_frequencies(cli: Cli, tmp_path: Path) -> None:
    for more in ((), ("--out", tmp_path / "out")):
        assert "[lattice]: given lattice; accepted" in cli("spectrum", EXAMPLES / "driven_chain.toml", *more).line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("gamma", [1.0, -1.0])
def test_an_infinite_chain_whose_edge_site_moves_alone_is_refused(gamma: float, run: Runs) -> None:
    scene = chain(4, gamma=gamma).replace("sites = 4", "sites = inf") + family("first", amplitude_max=0.3)
    told = run(scene, command="check", status=2).err
    assert "[chain] sites: given an infinite chain; accepted: with |gamma| = 1 a finite one" in told


LATTICE = lattice(16, "0", gain=[1e308, 1e308]) + "[spectrum]\n"


@pytest.mark.usefixtures("blank")
def test_a_lattice_whose_stiffness_is_not_finite_is_one_line(run: Runs) -> None:
    told = run(LATTICE, command="check", status=2).err
    assert "cannot be planned: array must not contain infs or NaNs" in told
    assert told.count("\n") == 1
    assert "[spectrum]: " in (told := run(LATTICE, status=1).err)
    assert told.count("\n") == 1


@pytest.fixture(scope="module")
def branch() -> Branch:
    return follow_family(Chain(2, 1.0, 0.25, -1.0), 1, 0.1, stability=True, tolerance=1e-4)


def with_field(data: Any, name: str, value: Any) -> bool:
    """Put a value into the first field of a name in data; whether there is one."""
    if isinstance(data, dict) and name in data:
        data[name] = value
        return True
    held = data.values() if isinstance(data, dict) else data if isinstance(data, list) else ()
    return any(with_field(item, name, value) for item in held)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("space", 1e308), ("solutions", [1]), ("point", True), ("at_round_off", None), ("tangent", None),
        ("error", 2.5),
        ("mu", 10**6), ("mu_error", "x"), ("trivial", 2.5), ("multipliers", "x"), ("exact", -1), ("z", []),
    ],
)  # fmt: skip
def test_a_saved_branch_with_a_wrong_field_is_refused(
    name: str, value: Any, branch: Branch, tmp_path: Path, cli: Cli
) -> None:
    """Its checksum is right."""
    data = msgspec.msgpack.decode(msgspec.msgpack.encode(saved(branch)))
    assert with_field(data, name, value)
    path = tmp_path / "branch.skin"
    path.write_bytes(framed(msgspec.msgpack.encode(data)))
    assert f"{path}: " in cli("explore", path).line
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
@pytest.mark.parametrize("times", [1, 2])
def test_a_search_goes_on_where_a_worker_is_killed(times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A start whose worker is killed is run again; killed twice, it is named."""
    q, v, omega, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "t"))
    field = ca.vertcat(v, -q - q**3 - 0.2 * v + 0.1 * ca.cos(omega * t))
    duffing = OdeModel(
        "Duffing", ca.vertcat(q, v), field, omega, time=t, forcing_period=2 * ca.pi / omega, nominal=(1.0,)
    )
    killed = killing(monkeypatch, times)
    result = search_orbit(duffing, guess=[0.0, 0.0], free=["omega"], bounds={"omega": (0.3, 2.0)}, running=-(q**2),
                          starts=3, workers=2)  # fmt: skip
    assert (result.found, len(killed)) == (True, times)
    lost = [words for words in result.starts if "its worker ended by signal 9" in words]
    assert len(lost) == (times == 2)
