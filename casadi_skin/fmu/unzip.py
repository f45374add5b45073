"""Somebody's archive, checked before anything of it is written; from Python's own library alone.

Nothing in an archive is trusted: names that leave the folder, in any of the places that a ZIP file has for names,
links, encryption, methods of compression that ZIP bombs are made with, and sizes are refused. Both / and \\ are taken
as what stands between folders, whichever system an archive comes from or is read on.
"""

from __future__ import annotations

import shutil
import stat
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path, PurePosixPath

MOST_UNPACKED_BYTES = 1 << 30  # bytes of all files together, unpacked
ALWAYS_ALLOWED_BYTES = 1 << 26  # bytes that any archive may unpack to
MOST_COMPRESSION_RATIO = 50  # of all files unpacked to the archive, beyond that
MOST_FILES = 20_000
LONGEST_DIRECTORY = 1 << 22  # bytes of the list of files
COMPRESSION_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # those of the FMI standard
DAMAGED_ARCHIVE_ERRORS = (
    zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError, ValueError,
)  # fmt: skip


class Archive:
    """The files of an archive by the names under which they are written, checked; `repeated` are in it more than once.

    Raises ValueError, in one line, for other files, and for damaged and hostile ones.
    """

    def __init__(self, path: Path, kind: str = "an FMU") -> None:
        self.path = path
        try:
            _check_directory(path)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of strange names, which are checked here
                self._zip = zipfile.ZipFile(path)
        except DAMAGED_ARCHIVE_ERRORS as error:
            raise ValueError(f"{path}: cannot be read as {kind}: {error}") from error
        try:
            self._members, self.repeated = _checked(path, self._zip)
        except BaseException:
            self._zip.close()
            raise

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all files, with / between folders."""
        return tuple(self._members)

    def write(self, folder: Path, wanted: Callable[[str], bool]) -> None:
        """Write the files whose names are wanted; raises ValueError, naming the first that is damaged or repeated."""
        for name, member in self._members.items():
            if not wanted(name):
                continue
            if name in self.repeated:
                raise ValueError(f"{self.path}: refused: {name!r} is in it more than once; accepted: once")
            target = folder / name
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                with self._zip.open(member) as source, target.open("xb") as copy:
                    shutil.copyfileobj(source, copy)  # zipfile reads no more than the size that was checked
            except DAMAGED_ARCHIVE_ERRORS as error:
                raise ValueError(f"{self.path}: damaged: {name!r}: {error}") from error

    def close(self) -> None:
        """Close the file."""
        self._zip.close()


def _check_directory(path: Path) -> None:
    """Raises BadZipFile where the list of files is too long to be read; zipfile reads all of it."""
    if not path.is_file():  # a pipe or a device may never end
        raise zipfile.BadZipFile("no such file")
    with path.open("rb") as file:
        end = zipfile._EndRecData(file)  # type: ignore[attr-defined]
    if end is not None and end[5] > LONGEST_DIRECTORY:  # the size of the central directory
        raise zipfile.BadZipFile(f"its list of files has {end[5]} bytes; accepted: up to {LONGEST_DIRECTORY}")


def _checked(path: Path, archive: zipfile.ZipFile) -> tuple[dict[str, zipfile.ZipInfo], frozenset[str]]:
    """All files but folders by name, and those that are there more than once.

    Raises ValueError naming the first that must not be unpacked.
    """
    members = archive.infolist()
    if len(members) > MOST_FILES:
        raise ValueError(f"{path}: {len(members)} files inside; accepted: up to {MOST_FILES}")
    size = sum(member.file_size for member in members)
    most = min(MOST_UNPACKED_BYTES, max(ALWAYS_ALLOWED_BYTES, MOST_COMPRESSION_RATIO * path.stat().st_size))
    if size > most:
        raise ValueError(f"{path}: {size} bytes when unpacked; accepted: up to {most}")
    found: dict[str, zipfile.ZipInfo] = {}
    repeated = set()
    for member in members:
        for name in (member.orig_filename, member.filename):  # extra field 0x7075 gives a file another name
            if not _stays(name.replace("\\", "/")):
                raise ValueError(f"{path}: refused: the file {name!r} would leave the folder it is unpacked in")
        shown = member.filename.replace("\\", "/")  # which tools of Windows write between folders
        name = PurePosixPath(shown).as_posix()
        if stat.S_ISLNK(member.external_attr >> 16):
            raise ValueError(f"{path}: refused: {name!r} is a link")
        if member.flag_bits & 1:
            raise ValueError(f"{path}: refused: {name!r} is encrypted")
        if member.compress_type not in COMPRESSION_METHODS:
            raise ValueError(f"{path}: refused: {name!r} is compressed by method {member.compress_type}, not deflate")
        if name in found:
            repeated.add(name)
        if not shown.endswith("/"):
            found[name] = member
    return found, frozenset(repeated)


def _stays(name: str) -> bool:
    parts = PurePosixPath(name).parts
    return bool(parts) and not name.startswith("/") and ".." not in parts and not any(c in name for c in ":\0")
