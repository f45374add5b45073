"""Journals that were edited, with checksums that hold: what is no result of the scene is named in one line."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import casadi as ca
import msgspec
import numpy as np
import pytest
from drawing import blank_pictures
from journals import journal_of
from maps import TINY, Now, files, write
from scenes import Cli, chain, family

from casadi_skin import OdeModel, read_map
from casadi_skin.results.branch_records import (
    BranchRecord,
    CutRecord,
    CycleRecord,
    EndRecord,
    PointRecord,
    StabilityRecord,
    data_of,
)
from casadi_skin.results.store import RECORD_HEADER, SavedResult, framed, read_records
from casadi_skin.runs import further
from casadi_skin.runs.directory import DirectoryError
from casadi_skin.runs.first_solution import known_cycle
from casadi_skin.runs.map_cell import Result, Row
from casadi_skin.runs.map_grid import Task
from casadi_skin.runs.map_result import MapHead, MapRecord, TaskRecord
from casadi_skin.runs.program import main
from casadi_skin.runs.run import Run
from casadi_skin.zero.settings import End

pytestmark = pytest.mark.usefixtures("blank")
SCENE = chain(2) + family(1, at=[0.5]) + '[stability]\n[accuracy]\npreset = "draft"\n'
Records = list[Any]
put = msgspec.structs.replace


def records_in(path: Path, kind: Any) -> Records:
    found, _, fault = read_records(path.read_bytes(), msgspec.msgpack.Decoder(kind))
    assert fault == ""
    return found


def written(path: Path, records: Records) -> None:
    path.write_bytes(journal_of(records))


# Branches -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene, the results of its run in `out`, and in `kept` what is there before they are written."""
    folder = tmp_path_factory.mktemp("branch")
    (folder / "scene.toml").write_text(SCENE, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        blank_pictures(patch)
        assert main(["run", str(folder / "scene.toml"), "--out", str(folder / "out"), "--quiet"]) == 0
        patch.setattr(Run, "_write_results", lambda run: run.failures.append("its journal is kept"))
        assert main(["run", str(folder / "scene.toml"), "--out", str(folder / "kept"), "--quiet"]) == 1
    return folder


def renumbered(records: Records) -> Records:
    return [put(record, number=k) for k, record in enumerate(records)]


def without(records: Records, first: int, last: int) -> Records:
    return [*records[:first], *records[last:]]


def with_multipliers(record: StabilityRecord) -> StabilityRecord:
    """The record of stability with an array of another length."""
    return with_floquet(record, multipliers=["array", "<c16", [1], b"\0" * 16])


def with_floquet(record: StabilityRecord, **changes: Any) -> StabilityRecord:
    return put(record, floquet=[*record.floquet[:2], {**record.floquet[2], **changes}])


EDITED: dict[str, Callable[[Records], Records]] = {
    "eight records dropped": lambda all_of: without(all_of, 6, 14),
    "a point dropped": lambda all_of: [r for r in all_of if r is not [p for p in all_of if points(p)][5]],
    "the last points dropped, and the end renumbered": lambda all_of: renumbered(without(all_of, 10, len(all_of) - 1)),
    "two exchanged": lambda all_of: [*all_of[:4], all_of[5], all_of[4], *all_of[6:]],
    "in reverse": lambda all_of: all_of[::-1],
    "one twice": lambda all_of: [*all_of[:5], all_of[4], *all_of[5:]],
    "the end first": lambda all_of: [all_of[-1], *all_of[:-1]],
    "an end in the middle": lambda all_of: [*all_of[:7], EndRecord("1", 7, End.REACHED, ""), *all_of[7:]],
    "records cut off, and the end kept": lambda all_of: [*all_of[:-1], CutRecord("1", 9), all_of[-1]],
    "records cut off from behind": lambda all_of: [*all_of[:-1], CutRecord("1", -9), all_of[-1]],
    "stability first": lambda all_of: renumbered(sorted(all_of, key=points)),
    "a number of text": lambda all_of: [*all_of[:5], msgspec.to_builtins(all_of[5]) | {"number": "5"}, *all_of[6:]],
    "one largest multiplier": lambda all_of: [
        with_floquet(r, max_abs_multiplier=1.5) if r is stabilities(all_of)[5] else r
        for r in all_of
    ],
    "every largest multiplier": lambda all_of: [
        with_floquet(r, max_abs_multiplier=1.5) if isinstance(r, StabilityRecord) else r for r in all_of
    ],
    "multipliers of another number": lambda all_of: [
        with_multipliers(r) if r is stabilities(all_of)[3] else r for r in all_of
    ],
}  # fmt: skip
QUICK = ("eight records dropped", "the last points dropped, and the end renumbered")


def stabilities(records: Records) -> Records:
    return [record for record in records if isinstance(record, StabilityRecord)]


def points(record: BranchRecord) -> bool:
    return isinstance(record, PointRecord)


@pytest.mark.parametrize("edit", [pytest.param(e, marks=() if e in QUICK else pytest.mark.slow) for e in EDITED])
def test_a_run_whose_journal_was_edited_names_the_record_and_ends_as_if_it_had_not_been(
    edit: str, whole: Path, tmp_path: Path, cli: Cli
) -> None:
    out = tmp_path / "out"
    shutil.copytree(whole / "kept", out)
    written(out / "journal.msgpack", EDITED[edit](records_in(out / "journal.msgpack", BranchRecord)))
    done = cli("run", whole / "scene.toml", "--out", out, "--resume", "--quiet")
    assert done.status == 0
    for name in ("family.csv", "family.nc", "events.csv"):
        assert (out / name).read_bytes() == (whole / "out" / name).read_bytes()
    shutil.rmtree(out)
    shutil.copytree(whole / "kept", out)
    written(out / "journal.msgpack", EDITED[edit](records_in(out / "journal.msgpack", BranchRecord)))
    told = cli("run", whole / "scene.toml", "--out", out, "--resume").err
    assert told.startswith(f"casadi-skin: {out / 'journal.msgpack'}: ")
    assert "record" in told
    assert told.count("\n") == 1


def apart(data: bytes) -> list[tuple[int, bytes]]:
    """The checksum before each record of a journal, and what follows its header."""
    found, place = list[tuple[int, bytes]](), 0
    while place < len(data):
        _, _, length, before, _ = RECORD_HEADER.unpack_from(data, place)
        end = place + RECORD_HEADER.size + length
        found, place = [*found, (before, data[place + RECORD_HEADER.size : end])], end
    return found


def test_records_that_were_dropped_are_missed_where_the_others_are_numbered_anew(
    whole: Path, tmp_path: Path, cli: Cli
) -> None:
    """Who edits single records, and makes their own checksums anew, leaves a gap in the chain of checksums."""
    out = tmp_path / "out"
    shutil.copytree(whole / "kept", out)
    journal = out / "journal.msgpack"
    before = [before for before, _ in without(apart(journal.read_bytes()), 6, 14)]
    kept = renumbered(without(records_in(journal, BranchRecord), 6, 14))
    journal.write_bytes(b"".join(framed(msgspec.msgpack.encode(r), b) for r, b in zip(kept, before, strict=True)))
    done = cli("run", whole / "scene.toml", "--out", out, "--resume")
    assert (done.status, done.err.count("\n")) == (0, 1)
    assert done.err.startswith(f"casadi-skin: {journal}: a record that is not the one before the next at byte ")
    assert (out / "family.csv").read_bytes() == (whole / "out" / "family.csv").read_bytes()


# What else a journal has ---------------------------------------------------------------------------------------------


def test_a_simulation_that_is_none_is_made_again() -> None:
    x = ca.SX.sym("x", 2)
    model = OdeModel("circle", x, ca.vertcat(x[1], -x[0]))
    t, states = np.linspace(0.0, 7.0, 50), np.zeros((50, 2))
    holds = CycleRecord("", data_of(t), data_of(states), 0.5, 6.2)
    assert known_cycle([holds], model, {}) is not None
    for changes in (
        {"t": data_of(t[::-1])}, {"t": "now"}, {"states": data_of(states[1:])}, {"states": data_of(states * math.nan)},
        {"period": math.nan}, {"period": -6.2}, {"period": 700.0}, {"start": -9.0}, {"t": data_of(t[:0])},
    ):  # fmt: skip
        assert known_cycle([put(holds, **changes)], model, {}) is None


def test_a_curve_that_is_none_is_followed_again() -> None:
    for result in (
        None,
        3,
        ["object", "EdgeCurve", {}],
        ["object", "EdgeCurve", {"parameter": "g", "points": ["tuple"]}],
    ):
        assert further._known(SavedResult("casadi_skin result 4", "", [], result), Mock(parameters={"S": 1.0})) is None


# Maps ---------------------------------------------------------------------------------------------------------------


def engine() -> Now:
    """Computes the cells of a map by a formula."""

    def computed(task: Task, attempt: int) -> Result:
        values = [{"Omega": 1.0 + 0.01 * cell, "residual": 1e-12, "end": "reached"} for cell in task.cells]
        return Result(tuple(Row(value, state=(1.0,), period=0.5) for value in values), seconds=0.1)

    return Now(computed)


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("map")
    assert engine().map(folder, TINY).complete
    return folder


def with_value(record: TaskRecord, name: str, value: Any) -> TaskRecord:
    row = record.rows[-1]
    return put(record, rows=(*record.rows[:-1], put(row, values={**row.values, name: value})))


CELLS: dict[str, Callable[[TaskRecord], TaskRecord]] = {  # that are read as if they were missing
    "not a number": lambda task: with_value(task, "Omega", math.nan),
    "infinite": lambda task: with_value(task, "residual", math.inf),
    "a text": lambda task: with_value(task, "Omega", "99"),
    "a number for a text": lambda task: with_value(task, "end", 3),
    "too few rows": lambda task: put(task, rows=task.rows[:1]),
    "rows of a failure": lambda task: put(task, kind="failed"),
    "a kind of its own": lambda task: put(task, kind="fine", rows=()),
    "cells that are not there": lambda task: put(task, cells=(99, 100)),
    "cells from behind": lambda task: put(task, cells=(-1, -2)),
    "a cell twice": lambda task: put(task, cells=(task.cells[0],) * 2),
    "cells of two families": lambda task: put(task, cells=(0, 1)),
    "no cells": lambda task: put(task, cells=(), rows=()),
    "a ninth attempt": lambda task: put(task, attempt=9),
    "a neighbour that is not there": lambda task: put(task, neighbour=99),
    "a time that is none": lambda task: put(task, seconds=math.nan),
}


def edited(mapped: Path, folder: Path, edit: Callable[[TaskRecord], TaskRecord]) -> Path:
    """The journal of a copy of the map in which the record of one task is edited."""
    shutil.copytree(mapped / "out", folder / "out")
    journal = folder / "out" / "journal.msgpack"
    records = records_in(journal, MapRecord)
    place = [k for k, record in enumerate(records) if isinstance(record, TaskRecord)][2]
    records[place] = edit(records[place])
    written(journal, records)
    return journal


@pytest.mark.parametrize("edit", CELLS)
def test_cells_of_a_map_that_no_task_gives_are_named_and_computed_again(
    edit: str, mapped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    journal = edited(mapped, tmp_path, CELLS[edit])
    found = read_map(journal.parent)
    assert (found.complete, len(found.known)) == (False, found.grid.size - 2)
    told = capsys.readouterr().err
    assert told.startswith(f"casadi-skin: {journal}: ")
    assert told.endswith("are not believed, and computed again by --resume\n")
    assert told.count("\n") == 1
    again = engine()
    assert again.map(tmp_path, TINY, resume=True).complete
    assert len(again.tasks) == 2  # one stands out most
    assert files(journal.parent) == files(mapped / "out")


@pytest.mark.parametrize("value", [99.0, 1.5, -1.0])
def test_a_number_of_a_map_that_stands_out_is_computed_again_before_it_is_believed(
    value: float, mapped: Path, tmp_path: Path
) -> None:
    journal = edited(mapped, tmp_path, lambda task: with_value(task, "Omega", value))
    before = journal.read_bytes()
    with pytest.raises(DirectoryError, match=rf"gamma = .*: Omega = {value!r}, computed again 1\."):
        engine().map(tmp_path, TINY, resume=True)
    assert journal.read_bytes() == before


def test_a_cell_of_a_map_that_was_edited_within_its_range_is_computed_again(mapped: Path, tmp_path: Path) -> None:
    shutil.copytree(mapped / "out", tmp_path / "out")
    journal = tmp_path / "out" / "journal.msgpack"
    parts = apart(journal.read_bytes())
    records = records_in(journal, MapRecord)
    place = [k for k, record in enumerate(records) if isinstance(record, TaskRecord)][2]
    edited = with_value(records[place], "Omega", 1.025)
    parts[place] = (parts[place][0], msgspec.msgpack.encode(edited))
    journal.write_bytes(b"".join(framed(payload, before) for before, payload in parts))
    assert engine().map(tmp_path, TINY, resume=True).complete
    assert files(journal.parent) == files(mapped / "out")


def test_a_map_that_was_not_edited_holds_where_cells_end_in_words_or_fail(tmp_path: Path) -> None:
    for result in (Result(kind="failed", reason="no"), Result((Row({"end": "missed"}, "early"),) * 2)):
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        Now(lambda task, attempt, result=result: result).map(tmp_path, TINY)  # type: ignore[misc]
        assert Now().map(tmp_path, TINY, resume=True).complete


def test_a_head_or_a_journal_of_another_scene_is_refused_by_its_name(mapped: Path, tmp_path: Path) -> None:
    journal = edited(mapped, tmp_path, lambda task: task)
    records = records_in(journal, MapRecord)
    for others in (records[1:], [MapHead(b"another"), *records[1:]]):
        written(journal, others)
        with pytest.raises(DirectoryError, match=f"{journal}: is the journal of another scene"):
            engine().map(tmp_path, TINY, resume=True)


@pytest.mark.slow
def test_a_map_that_workers_compute_again_is_compared_with_its_journal(tmp_path: Path, cli: Cli) -> None:
    words = ("map", write(tmp_path, TINY), "--out", tmp_path / "whole", "--no-pictures")
    assert cli(*words).status == 0
    (tmp_path / "mine").mkdir()
    shutil.move(tmp_path / "whole", tmp_path / "mine" / "out")
    edited(tmp_path / "mine", tmp_path / "edited", lambda task: with_value(task, "Omega", 99.0))
    line = cli(*words[:3], tmp_path / "edited" / "out", *words[4:], "--resume").line
    assert "Omega = 99.0, computed again 1." in line
    done = cli(*words[:3], tmp_path / "mine" / "out", *words[4:], "--resume")
    assert (done.status, done.err) == (0, "")
