"""What a killed run leaves: nothing of it is lost, nothing damaged is believed, and nothing stays behind."""

from __future__ import annotations

import gc
import os
import signal
import struct
import sys
from collections.abc import Callable, Iterator, Set
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import msgspec
import numpy as np
import pytest
from apart import ended, killed
from drawing import blank_pictures
from journals import journal_of
from scenes import chain, family, table

from casadi_skin.follow.point import PointSolver
from casadi_skin.results.branch_records import BranchRecord, CycleRecord, PointRecord, data_of, value_of
from casadi_skin.results.store import FORMAT, MARK, RECORD_HEADER, Journal, read_records
from casadi_skin.runs import first_solution
from casadi_skin.runs import run as writing
from casadi_skin.runs.program import main
from casadi_skin.runs.run import Run
from casadi_skin.zero.settings import ErrorEstimate

pytestmark = pytest.mark.usefixtures("blank", "interruptible")

FAMILY = chain(3) + family([1, 3], at=[0.2, 0.21, 0.5])
STABLE = FAMILY + "[stability]\n"
MODEL = """
import casadi as ca
from casadi_skin import OdeModel
from stiffness import MU
x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
van_der_pol = OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, MU * mu * (1 - x**2) * y - x), mu, nominal=(1.0,))
"""
CYCLES = (
    table("model", file="model.py", name="van_der_pol") + table("orbit", start=[2.0, 0.0], transient=40.0)
    + table("continuation", parameter="mu", to=2.0, at=[1.5]) + "[stability]\n" + table("accuracy", tolerance=1e-6)
)  # fmt: skip
CHAIN_ORBIT = (
    chain(3, gamma=0.1, g=1.0)
    + table("orbit", start=[0.2, -0.4, 0.5, 0.0, 0.0, 0.0], period=3.0, select={"y_3": 0.5}, symmetric=True)
    + table("continuation", parameter="gamma", to=0.4) + "[stability]\n"
)  # fmt: skip
KINDS = {
    "with stability": STABLE, "cycles of a model": CYCLES, "points alone": FAMILY, "orbits of a chain": CHAIN_ORBIT,
}  # fmt: skip
QUICK = [pytest.param(kind, marks=() if text in (STABLE, CYCLES) else pytest.mark.slow) for kind, text in KINDS.items()]
AGAIN = "; what follows it is dropped and computed again\n"
Resume = Callable[[bytes], tuple[Path, int]]


def read(path: Path) -> tuple[list[Any], int, str]:
    return read_records(path.read_bytes(), msgspec.msgpack.Decoder(BranchRecord))


def written(records: list[Any]) -> bytes:
    """A journal of records, with checksums that hold."""
    return journal_of(records)


def write_model(folder: Path, scene: str, stiffness: float = 1.0) -> Path:
    files = {"stiffness.py": f"MU = {stiffness}\n", "model.py": MODEL, "scene.toml": scene}
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    sys.modules.pop("stiffness", None)
    return folder / "scene.toml"


@pytest.fixture(scope="module", params=QUICK)
def scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A scene beside the results of its whole run, and beside the journal that the run had at its end."""
    folder = tmp_path_factory.mktemp("scene")
    path = write_model(folder, KINDS[request.param])
    with pytest.MonkeyPatch.context() as patch:
        blank_pictures(patch)
        patch.syspath_prepend(folder)
        assert main(["run", str(path), "--out", str(folder / "whole"), "--quiet"]) == 0
        patch.setattr(Run, "_write_results", lambda run: run.failures.append("its journal is kept"))
        assert main(["run", str(path), "--out", str(folder / "kept"), "--quiet"]) == 1
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.setenv("PYTHONPATH", f"{folder}:{os.environ.get('PYTHONPATH', '')}")
        yield path


@pytest.fixture
def records(scene: Path) -> list[Any]:
    """What the journal of the whole run holds."""
    found, _, fault = read(scene.parent / "kept" / "journal.msgpack")
    assert fault == ""
    return found


@pytest.fixture
def resume(scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Resume:
    """Resumes the scene from a journal: its directory, and the number of points whose errors were estimated."""
    out, solved = tmp_path / "out", list[str]()
    measured = PointSolver._measured

    def counted(*arguments: Any) -> Any:
        solved.append("")
        return measured(*arguments)

    def resume(journal: bytes) -> tuple[Path, int]:
        out.mkdir()
        (out / "scene.toml").write_bytes((scene.parent / "whole" / "scene.toml").read_bytes())
        (out / "journal.msgpack").write_bytes(journal)
        with monkeypatch.context() as patch:
            patch.setattr(PointSolver, "_measured", counted)
            assert main(["run", str(scene), "--out", str(out), "--resume"]) == 0
        return out, len(solved)

    return resume


def the_same(out: Path, whole: Path, beside: Set[str] = frozenset()) -> None:
    names = {path.name for path in whole.iterdir()}
    assert {path.name for path in out.iterdir()} - beside == names
    for name in names:
        if name.endswith((".csv", ".nc")):
            assert (out / name).read_bytes() == (whole / name).read_bytes(), name


# What is lost -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.0, 0.45, *(pytest.param(n, marks=pytest.mark.slow) for n in (0.7, 0.95))])
def test_a_killed_run_loses_nothing(
    part: float, scene: Path, records: list[Any], resume: Resume, capsys: pytest.CaptureFixture[str]
) -> None:
    """Wherever it was: points that the journal holds are not solved for again."""
    kept = records[: round(part * len(records))]
    out, solved = resume(written(kept))
    the_same(out, scene.parent / "whole")
    assert capsys.readouterr().err == ""
    if scene.read_text(encoding="utf-8") in (FAMILY, STABLE):  # there changes of mesh and the first orbit count as well
        points = [record for record in records if isinstance(record, PointRecord)]
        assert len(points) > 20
        left = sum(isinstance(record, PointRecord) for record in records[len(kept) :])
        assert left <= solved <= left + 1  # one needs a finer level


@pytest.mark.parametrize("count", [9, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 20))])
def test_a_run_that_is_killed_ends_as_if_it_had_not_been(
    count: int, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert killed(count, scene, out) == -signal.SIGKILL
    assert len(read(out / "journal.msgpack")[0]) == count
    assert main(["run", str(scene), "--out", str(out), "--resume", "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    the_same(out, scene.parent / "whole")


def test_an_orbit_is_not_simulated_again(
    scene: Path, records: list[Any], resume: Resume, monkeypatch: pytest.MonkeyPatch
) -> None:
    if scene.read_text(encoding="utf-8") in (FAMILY, STABLE):
        assert not any(isinstance(record, CycleRecord) for record in records)
        return
    monkeypatch.setattr(first_solution, "simulate", None)
    the_same(resume(written(records[:1]))[0], scene.parent / "whole")


@pytest.mark.slow
@pytest.mark.parametrize("flag", ["--resume", "--overwrite", ""])
def test_what_a_killed_run_leaves_beside_its_files_is_swept(flag: str, scene: Path, tmp_path: Path) -> None:
    out, mine = tmp_path / "out", ".mine.csv.abcd1234.csv"
    out.mkdir()
    if flag:
        assert ended(signal.SIGINT, 3, scene, tmp_path / "out") == 130
        (out / mine).write_text("mine", encoding="utf-8")
    for name in (".scene.toml.abcd1234.toml", ".family.csv.0a_b1c2d.csv", ".frequency.png.abcdefgh.png"):
        (out / name).write_text("half", encoding="utf-8")
    assert main(["run", str(scene), "--out", str(out), "--quiet", *([flag] if flag else [])]) == 0
    assert {path.name for path in out.glob(".*")} == ({mine} if flag else set())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["write_csv", "write_netcdf"])
def test_a_run_that_is_interrupted_while_it_writes_has_written_all_files(
    name: str, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, write, write_results, left = tmp_path / "out", getattr(writing, name), Run._write_results, list[int]()

    def begin(run: Run) -> None:
        left.append(signal.SIGINT)
        write_results(run)

    def interrupted(*arguments: Any) -> None:
        if left:
            os.kill(os.getpid(), left.pop())
        write(*arguments)

    monkeypatch.setattr(Run, "_write_results", begin)
    monkeypatch.setattr(writing, name, interrupted)
    assert main(["run", str(scene), "--out", str(out), "--quiet"]) == 130
    assert capsys.readouterr().err.count("\n") == 1
    the_same(out, scene.parent / "whole", {"journal.msgpack"})


# What is damaged ----------------------------------------------------------------------------------------------------


def test_every_flipped_bit_of_a_journal_is_noticed(scene: Path, records: list[Any]) -> None:
    data = (scene.parent / "kept" / "journal.msgpack").read_bytes()
    decoder = msgspec.msgpack.Decoder(BranchRecord)
    ends = [0]
    while ends[-1] < len(data):
        ends.append(ends[-1] + RECORD_HEADER.size + RECORD_HEADER.unpack_from(data, ends[-1])[2])
    for place in {*range(2 * RECORD_HEADER.size), *range(0, len(data), max(1, len(data) // 100)), len(data) - 1}:
        for bit in (0, 3, 7):
            damaged = bytearray(data)
            damaged[place] ^= 1 << bit
            found, whole, fault = read_records(bytes(damaged), decoder)
            before = sum(end <= place for end in ends[1:])
            assert (found, whole) == (records[:before], ends[before])
            assert fault.endswith(f"at byte {whole}")


def changed(record: PointRecord, name: str, value: Any) -> PointRecord:
    """The record of a point with another value by name."""
    return msgspec.structs.replace(record, point=[*record.point[:3], {**record.point[3], name: data_of(value)}])


def moved(record: PointRecord, name: str, by: float, fewer: int = 0) -> PointRecord:
    """The record of a point with an array that begins with another number, or is shorter."""
    values = value_of(record.point[3][name])
    values[0] += by
    return changed(record, name, values[: values.size - fewer])


def finer(record: PointRecord) -> PointRecord:
    return msgspec.structs.replace(record, point=["point", record.point[1] + 1, *record.point[2:]])


TAILS: dict[str, Callable[[bytes], bytes]] = {
    "cut off": lambda data: data[:-7],
    "a mark alone": lambda data: data + MARK,
    "zeros": lambda data: data[:-50] + bytes(4096),
    "zeros after it": lambda data: data + bytes(4096),
    "a bit": lambda data: data[:-20] + bytes([data[-20] ^ 4]) + data[-19:],
    "another format": lambda data: data + RECORD_HEADER.pack(MARK, FORMAT + 1, 0, 0, 0),
    "another version": lambda data: data + written([{"type": "point", "z": 1}]),
    "the format before": lambda data: data + struct.pack("<I", 13) + b"half a record",
}
FAULTS: dict[str, Callable[[PointRecord], PointRecord]] = {  # also where the checksum holds
    "an amplitude": lambda record: moved(record, "z", 1e-3),
    "not a number": lambda record: moved(record, "z", np.nan),
    "a tangent": lambda record: moved(record, "tangent", 0.5),
    "an infinite step": lambda record: changed(record, "step", np.inf),
    "an error": lambda record: changed(record, "error", ErrorEstimate(0.0, np.nan)),
    "a resolution": finer,
    "too few unknowns": lambda record: moved(record, "z", 0.0, fewer=1),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*TAILS, *FAULTS])
def test_what_is_damaged_or_solves_no_equations_is_dropped_in_one_line(
    kind: str, scene: Path, records: list[Any], resume: Resume, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = records[: len(records) // 2]
    if kind in FAULTS:
        place = max(i for i, record in enumerate(kept[:-2]) if isinstance(record, PointRecord))
        kept[place] = FAULTS[kind](kept[place])
    out, _ = resume(TAILS.get(kind, bytes)(written(kept)))
    told = capsys.readouterr().err
    assert told.startswith(f"casadi-skin: {out}/journal.msgpack: ")
    assert told.endswith(AGAIN)
    assert told.count("\n") == 1
    the_same(out, scene.parent / "whole")


@pytest.mark.slow
def test_points_of_a_model_that_has_changed_elsewhere_are_not_believed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The scene and the file of the model are as they were; what it imports is not."""
    monkeypatch.syspath_prepend(tmp_path)
    out, whole = tmp_path / "out", tmp_path / "whole"
    assert ended(signal.SIGINT, 7, write_model(tmp_path, CYCLES), out) == 130
    capsys.readouterr()
    scene = write_model(tmp_path, CYCLES, 1.25)
    assert main(["run", str(scene), "--out", str(out), "--resume"]) == 0
    told = capsys.readouterr().err
    assert "does not solve the equations" in told
    assert told.count("\n") == 1
    assert main(["run", str(scene), "--out", str(whole), "--quiet"]) == 0
    ends = [np.genfromtxt(d / "branch.csv", delimiter=",", names=True)["period"][-1] for d in (out, whole)]
    assert ends[0] == pytest.approx(ends[1], rel=1e-6)


def test_a_record_that_cannot_be_written_leaves_the_journal_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    path, decoder = tmp_path / "journal", msgspec.msgpack.Decoder(CycleRecord)
    record = CycleRecord("", data_of(np.zeros(100)), data_of(np.zeros((100, 1))), 0.0, 1.0)
    with Journal(path, decoder) as journal:
        journal.append(record)
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            with pytest.raises(OSError, match="No space"):
                journal.append(record)
        journal.append(record)
    with Journal(path, decoder) as journal:
        assert (journal.records, journal.fault) == ([record, record], "")


def test_a_journal_that_an_interruption_keeps_from_being_closed_closes_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Journal, "__exit__", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt), Journal(tmp_path / "journal", msgspec.msgpack.Decoder(CycleRecord)):
        pass
    gc.collect()  # the warning of a file that nobody closed fails this test
