"""A folder of results that others have prepared: what a run writes goes nowhere else, and what it reads is a file."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest
from scenes import Cli, chain, family

from casadi_skin.model.files import opened_in_place, replacing
from casadi_skin.results.store import Journal
from casadi_skin.runs.directory import RUN_FILES, DirectoryError, check_writable
from casadi_skin.runs.map_result import RECORD_DECODER

pytestmark = pytest.mark.usefixtures("blank")
SCENE = chain(1) + family(1, 0.01) + '[accuracy]\npreset = "draft"\n'
LOCK, JOURNAL, OTHER = ".casadi_skin.lock", "journal.msgpack", b"the words of another file"
IN_PLACE = (LOCK, f"{LOCK}_3", JOURNAL, "journal_1_of_2.msgpack")
Place = Callable[[Path, Path], None]
PLACES: dict[str, Place] = {
    "symbolic link": lambda path, other: path.symlink_to(other),
    "symbolic link to nothing": lambda path, other: path.symlink_to(other.with_name("nothing")),
    "symbolic link to a device": lambda path, other: path.symlink_to("/dev/zero"),
    "directory": lambda path, other: path.mkdir(),
    "no file": lambda path, other: os.mkfifo(path),
    "hard link": lambda path, other: path.hardlink_to(other),
}


@pytest.fixture
def other(tmp_path: Path) -> Path:
    path = tmp_path / "other"
    path.write_bytes(OTHER)
    return path


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", [LOCK, JOURNAL, "family.csv", "export"])
@pytest.mark.parametrize("flag", ["", "--resume", "--overwrite"])
def test_a_link_in_a_folder_of_results_is_refused_before_anything_is_written(
    name: str, flag: str, scene: Path, other: Path, tmp_path: Path, cli: Cli
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for kind in ("symbolic link", *(["hard link"] if name in IN_PLACE else [])):
        PLACES[kind](out / name, other)
        assert str(out / name) in cli("run", scene, "--out", out, *filter(None, [flag])).line
        assert other.read_bytes() == OTHER
        assert [path.name for path in out.iterdir()] == [name]
        (out / name).unlink()


@pytest.mark.parametrize("place", PLACES)
def test_what_stands_in_place_of_a_file_of_a_run_is_named_whatever_it_is(
    place: str, other: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    replaced = [name.replace("*", "1") for name in RUN_FILES[:: len(RUN_FILES) // 8]]
    for name in IN_PLACE if place == "hard link" else (*IN_PLACE, *replaced):
        out.mkdir()
        PLACES[place](out / name, other)
        with pytest.raises(DirectoryError, match=place.split(" to ")[0]) as told:
            check_writable(out)
        assert str(told.value).startswith(f"{out / name}: ")
        (out / name).rmdir() if place == "directory" else (out / name).unlink()
        out.rmdir()
    assert {path.name for path in tmp_path.iterdir()} == {"other"}


def test_a_link_that_comes_after_the_folder_was_looked_at_is_not_followed(other: Path, tmp_path: Path) -> None:
    for kind in ("symbolic link", "hard link", "symbolic link to nothing", "no file", "directory"):
        path = tmp_path / kind
        PLACES[kind](path, other)
        with pytest.raises(OSError, match=r"Too many levels|hard link|no file|directory"):
            opened_in_place(path)
        with pytest.raises(OSError, match=r"Too many levels|hard link|no file|directory"):
            Journal(path, RECORD_DECODER)
    assert other.read_bytes() == OTHER
    assert not (tmp_path / "nothing").exists()


def test_a_temporary_name_that_was_foreseen_is_not_used(
    other: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "_name_sequence", iter(["foreseen", "foreseen", "fresh"]))
    (tmp_path / ".family.csv.foreseen.csv").symlink_to(other)
    with replacing(tmp_path / "family.csv") as temporary:
        temporary.write_text("mine", encoding="utf-8")
    assert (tmp_path / "family.csv").read_text(encoding="utf-8") == "mine"
    assert other.read_bytes() == OTHER


def test_a_folder_that_is_a_link_and_links_of_other_names_are_the_users(
    scene: Path, other: Path, tmp_path: Path, cli: Cli
) -> None:
    """Results may be kept on another disk; what is replaced leaves the file of a hard link as it was."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    assert cli("run", scene, "--out", tmp_path / "out").status == 0
    table = tmp_path / "disk" / "family.csv"
    before = table.read_bytes()
    table.unlink()
    table.hardlink_to(other)
    (tmp_path / "disk" / "notes.txt").symlink_to(other)
    assert cli("run", scene, "--out", tmp_path / "out", "--overwrite").status == 0
    assert (table.read_bytes(), other.read_bytes()) == (before, OTHER)
    assert (tmp_path / "disk" / "notes.txt").is_symlink()
