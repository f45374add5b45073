"""The directory of a run: refused when it holds anything, unless the run is to be resumed or overwritten."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from enum import Enum
from fnmatch import fnmatch
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING

from casadi_skin.model.files import leftovers, locked, other_file, replacing
from casadi_skin.model.methods import FORMATS
from casadi_skin.runs.output import InputError
from casadi_skin.runs.reading import parse_scene
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import TABLES, Scene

if TYPE_CHECKING:
    from casadi_skin.runs.request import Request

SCENE_FILE = "scene.toml"
JOURNAL_FILE = "journal.msgpack"
LOCK_PREFIX = ".casadi_skin.lock"  # first letters of the files by which processes keep each other out
SCENE_MODEL = "scene_model"  # stem of the copy of a model's file
WRITTEN_FILES = (
    "family.csv", "family.nc", "events.csv", "further_events.csv", "tongues.csv", "passed_resonances.csv",
    "spectrum.csv", "bands.csv", "dynamics.csv", "dynamics.nc", "spreading.csv", "energies.csv", "edges.csv",
    "design.csv", "design_path.csv", "design.nc", "series.csv", "series.nc", "gradient.csv",
    "branch.csv", "branch.nc", "special_points.csv", "cycles_*.csv", "cycles_*.nc", "other_*.csv", "other_*.nc",
    "curve_*.csv", "curve_*.nc", "map.csv", "map.nc", "boundary.csv", "explore.html", "journal_*_of_*.msgpack",
    f"{SCENE_MODEL}.py", f"{SCENE_MODEL}.json", SCENE_FILE, JOURNAL_FILE,
)  # fmt: skip
MADE_BY_RUN = "# The scene of a run of casadi-skin, whose results are beside this file."  # first line of its copy
EXPORT_FOLDER = "export"  # the folder of generated C
EXPORTED_FILES = ("{0}.h", "{0}.c", "{0}_*.c", "main.c", "README.md", "CMakeLists.txt", "license.txt")  # of a model
HEADER_AUTHOR = b"casadi_skin"  # in the comment that a header of ours begins with
ACCEPTED_EXPORT = "accepted: a folder of generated C alone"
PICTURE_STEMS = (
    "frequency", "profile", "spectrum", "bands", "plane_j*", "multipliers_j*", "dynamics", "design", "branch", "orbit",
    "curves", "portrait", "map_*", "skin", "spreading", "edges", "series_j*",
)  # fmt: skip
RUN_FILES = (*WRITTEN_FILES, "film_j*.gif", *(f"{stem}.{kind}" for stem in PICTURE_STEMS for kind in FORMATS), "*.fmu")


class DirectoryError(InputError):
    """A directory that a run cannot use, in one line."""


class Existing(Enum):
    """Treatment of a directory that is not empty."""

    REFUSE = "refuse"
    RESUME = "resume"
    OVERWRITE = "overwrite"
    SHARE = "share"  # with processes that begin at the same time, and compute other shares of the same map


def prepare(directory: Path, request: Request, scene_text: str, existing: Existing) -> bool:
    """Make `directory` ready for a run of a request; False where a resumed run has nothing left to do.

    Raises DirectoryError where the directory may not be used; nothing is written then.
    """
    check_writable(directory)
    shared = existing is Existing.SHARE
    if shared or existing is Existing.RESUME:
        _check_same_source(directory, request)
    left = leftovers(directory, RUN_FILES) if directory.is_dir() and not shared else []
    accepted = "an empty or new directory, --resume or --overwrite"
    held = _check_free(directory, existing is not Existing.REFUSE, accepted, left)
    if shared:
        held = [name for name in held if not name.startswith(".")]  # others write theirs
        if held and not (directory / SCENE_FILE).exists():
            words = "accepted: an empty or new directory, or that of the map"
            raise DirectoryError(f"{directory}: holds {held[0]}; {words}")
    if held and existing is not Existing.OVERWRITE:
        _check_same(directory, request.scene)
    written = any((directory / name).exists() for name in ("family.nc", "design.csv", "branch.nc", "dynamics.nc"))
    if written and existing is Existing.RESUME and not (directory / JOURNAL_FILE).exists():
        _check_complete(directory)
        return False
    if held and existing is Existing.OVERWRITE:
        _remove_results(directory, RUN_FILES[:-1])
    for path in left:
        path.unlink(missing_ok=True)
    make_directory(directory)
    if not (held and shared):
        _write_scene(directory, request, scene_text)
    return True


def _check_complete(directory: Path) -> None:
    """Raises DirectoryError where a file of numbers of a complete run is damaged: its journal is gone."""
    from casadi_skin.results.dataset import check_whole

    for path in sorted(p for name in WRITTEN_FILES if name.endswith((".nc", ".csv")) for p in directory.glob(name)):
        try:
            check_whole(path)
        except ValueError as error:
            raise DirectoryError(f"{error}; --overwrite computes it anew") from error


def renew(directory: Path, request: Request, scene_text: str) -> None:
    """Make the directory of a run that was removed; its journal is empty."""
    directory.mkdir(parents=True)
    _write_scene(directory, request, scene_text)
    (directory / JOURNAL_FILE).touch()


def _write_scene(directory: Path, request: Request, scene_text: str) -> None:
    """Write the copies of the scene, and of the file of its model."""
    texts = {directory / SCENE_FILE: f"{MADE_BY_RUN}\n{scene_text}"}
    if request.path is not None:
        texts[directory / f"{SCENE_MODEL}{request.path.suffix}"] = request.source
    for path, text in texts.items():
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="")  # line ends as they are given


def make_directory(directory: Path) -> None:
    """Make a directory with those above it; raises DirectoryError where that cannot be."""
    new = [path for path in (directory, *directory.parents) if not path.exists()]
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        for path in new[1:]:  # none of the new folders is left
            with suppress(OSError):
                path.rmdir()
        raise DirectoryError(f"{directory}: cannot be made: {error.strerror}; accepted: another path") from error


def _remove_results(directory: Path, names: Sequence[str]) -> None:
    """Remove the files of a run; raises DirectoryError, before any is removed, where a directory is not of a run."""
    if not _of_a_run(directory):
        held = min(path.name for path in directory.iterdir() if not path.name.startswith(LOCK_PREFIX))
        words = f"--overwrite replaces the results of a run, with its {SCENE_FILE}; accepted: an empty or new directory"
        raise DirectoryError(f"{directory}: holds {held} and no run made it; {words}")
    old = [path for name in names for path in directory.glob(name)]
    _remove_export(directory / EXPORT_FOLDER)
    for path in old:
        path.unlink()


def _of_a_run(directory: Path) -> bool:
    """Whether a run made the directory: its copy of the scene begins with a line that scenes of users do not have."""
    scene = directory / SCENE_FILE
    return scene.is_file() and scene.read_bytes().startswith(MADE_BY_RUN.encode())


def _remove_export(folder: Path) -> None:
    """Remove the C code of a run before; raises DirectoryError for a folder of that name with anything else in it."""
    if not folder.exists():
        return
    stems = [path.stem for path in folder.glob("*.h") if path.is_file() and HEADER_AUTHOR in path.read_bytes()[:400]]
    own = {path for name in EXPORTED_FILES for stem in stems[:1] for path in folder.glob(name.format(escape(stem)))}
    if others := sorted(path.name for path in folder.iterdir() if path not in own):
        raise DirectoryError(f"{folder}: holds {others[0]}, which no run wrote; {ACCEPTED_EXPORT}")
    for path in own:
        path.unlink()
    folder.rmdir()


def prepare_study(directory: Path, overwrite: bool) -> None:
    """Make `directory` ready for the results of a study, which replace those of the same name.

    Raises DirectoryError where the directory may not be used; nothing is written then.
    """
    check_writable(directory)
    _check_free(directory, overwrite, "an empty or new directory, or --overwrite")
    make_directory(directory)


def _check_free(directory: Path, may_hold: bool, accepted: str, left: Sequence[Path] = ()) -> list[str]:
    """What a directory holds beside `left`; raises DirectoryError where it may hold nothing."""
    paths = [path for path in directory.iterdir() if path not in left] if directory.exists() else []
    held = sorted(path.name for path in paths if not path.name.startswith(LOCK_PREFIX))
    if held and not may_hold:
        more = " and more" if len(held) > 1 else ""
        raise DirectoryError(f"{directory}: holds {held[0]}{more}; accepted: {accepted}")
    return held


def check_writable(directory: Path) -> None:
    """Raises DirectoryError for a path that is not a directory, where nothing can be written, or with others' files.

    A file of a run is no link: what would be written into another file, or read from it, is not the run's.
    """
    try:
        exists = directory.exists()
    except (OSError, ValueError) as error:  # a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise DirectoryError(f"{directory}: {reason}; accepted: an empty or new directory") from error
    if exists and not directory.is_dir():
        raise DirectoryError(f"{directory}: is not a directory; accepted: an empty or new directory")
    parent = next(path for path in (directory, *directory.parents) if path.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise DirectoryError(f"{directory}: cannot be written (in {parent}); accepted: a directory that can be")
    for path in sorted(directory.iterdir()) if exists else ():
        in_place = path.name.startswith(LOCK_PREFIX) or fnmatch(path.name, "journal*.msgpack")
        fault = other_file(path, in_place) if in_place or any(fnmatch(path.name, name) for name in RUN_FILES) else ""
        if path.name == EXPORT_FOLDER and not stat.S_ISDIR(path.lstat().st_mode):
            fault = "is no folder that a run made"
        if fault:
            raise DirectoryError(f"{path}: {fault}; accepted: a regular file that a run wrote, or none")


def _check_same_source(directory: Path, request: Request) -> None:
    """Raises DirectoryError where the directory is a run of a model file that has been changed since."""
    path = request.path
    if path is None:
        return
    held = directory / f"{SCENE_MODEL}{path.suffix}"
    if held.exists() and held.read_text(encoding="utf-8") != request.source:
        words = f"was begun with another {path.name} (see {held.name}); accepted: the same, or --overwrite"
        raise DirectoryError(f"{directory}: {words}")


def _check_same(directory: Path, scene: Scene) -> None:
    """Raises DirectoryError where the directory is not a run of this scene."""
    path = directory / SCENE_FILE
    if not _of_a_run(directory):
        raise DirectoryError(f"{directory}: holds no {SCENE_FILE} of a run to resume; accepted: the directory of a run")
    try:
        before = parse_scene(path.read_text(encoding="utf-8"), str(path))
    except (SceneError, UnicodeDecodeError) as error:
        raise DirectoryError(f"{directory}: its {SCENE_FILE} cannot be read: {error}") from error
    if not scene.same_request(before):
        changed = ", ".join(f"[{name}]" for name in TABLES if getattr(scene, name) != getattr(before, name))
        words = f"was begun with another scene ({changed} differs); accepted: the same scene"
        raise DirectoryError(f"{directory}: {words} but for its title and time_limit, or --overwrite")


# Directories in use: one process computes in a directory, or several that share a map ---------------------------------


@contextmanager
def in_use(directory: Path, report: Callable[[str], None], shared: bool = False, part: str = "") -> Iterator[None]:
    """Keep other processes out of a directory, which is made where it is not there.

    Arguments:
        directory: it.
        report: takes a line where the disk has no locks, and nothing is kept out.
        shared: whether others may have it at the same time that share it too.
        part: the part of a shared directory that one process alone may have.

    Raises:
        DirectoryError: the directory cannot be used, or another process computes in it.
    """
    check_writable(directory)
    new = not directory.exists()
    make_directory(directory)
    path = directory / (f"{LOCK_PREFIX}_{part}" if part else LOCK_PREFIX)
    try:
        with ExitStack() as held:
            try:
                held.enter_context(locked(path, shared))
            except BlockingIOError:
                holder = ""
                with suppress(OSError):
                    holder = path.read_text(encoding="utf-8", errors="replace")
                words = "computes in it; accepted: another directory, or this one when that process has ended"
                raise DirectoryError(f"{directory}: {holder or 'another process'} {words}") from None
            except OSError as error:
                report(f"{directory}: cannot be locked ({error.strerror}): nothing else may compute in it meanwhile")
            yield
    finally:
        if new:
            with suppress(OSError):  # it holds something, or is gone
                directory.rmdir()
