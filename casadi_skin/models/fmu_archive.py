"""Somebody's FMU as a file: checked before anything of it is written, and unpacked as far as it is needed.

Nothing in an archive is trusted: names that leave the folder, links, sizes and entities of XML are refused.
"""

from __future__ import annotations

import platform
import shutil
import stat
import sys
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from tempfile import mkdtemp
from typing import Any
from xml.parsers.expat import ParserCreate

FMPY_MISSING = "fmpy is not installed; accepted: pip install 'casadi-skin[fmu]'"
LARGEST = 1 << 30  # bytes of all files together, unpacked
LARGEST_DESCRIPTION = 1 << 27
CHUNK = 256  # bytes
MOST_FILES = 20_000
_ENDINGS = {"linux": "so", "darwin": "dylib"}
_DAMAGED = (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, RuntimeError, ValueError)


def system_name() -> str:
    """ "linux" or "darwin"; raises ValueError elsewhere, where no FMU is compiled or run by casadi_skin."""
    system = "linux" if sys.platform.startswith("linux") else sys.platform
    if system not in _ENDINGS:
        raise ValueError(f"platform: {sys.platform}; accepted: {', '.join(_ENDINGS)}")
    return system


def platform_folder(fmi: str) -> str:
    """Name of this platform's folder under binaries in an FMU of FMI 2.0 or 3.0; raises ValueError as `system_name`."""
    system = system_name()
    if fmi.startswith("2"):
        return f"{system}64"
    machine = {"AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    return f"{machine}-{system}"


def library_ending() -> str:
    """Ending of shared libraries on this platform, without a dot; raises ValueError as `system_name`."""
    return _ENDINGS[system_name()]


@dataclass(frozen=True, eq=False)
class Unpacked:
    """An FMU's folder, the library in it for this platform, and what fmpy read in its modelDescription.xml."""

    path: Path
    folder: Path
    library: Path
    description: Any


def unpack(path: str | Path) -> Unpacked:
    """Unpack an FMU for Model Exchange, without its sources, into a new temporary folder, which the caller removes.

    Raises ValueError, in one line, for what is no FMU, is damaged or hostile, has no Model Exchange, or no binary for
    this platform, and where fmpy is missing; nothing is left behind then.
    """
    path = Path(path)
    try:
        archive = zipfile.ZipFile(path)
    except _DAMAGED as error:
        raise ValueError(f"{path}: cannot be read as an FMU: {error}") from error
    folder = Path(mkdtemp(prefix="casadi_skin_fmu_"))
    try:
        with archive:
            members = _checked_members(path, archive)
            _write(path, archive, [m for m in members if m.filename == "modelDescription.xml"], folder)
            description = _description(path, folder)
            wanted = (f"binaries/{platform_folder(description.fmiVersion)}/", "resources/")
            library = _library(path, description, members, folder)
            _write(path, archive, [m for m in members if m.filename.startswith(wanted)], folder)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return Unpacked(path, folder, library, description)


def _checked_members(path: Path, archive: zipfile.ZipFile) -> list[zipfile.ZipInfo]:
    """All files of the archive; raises ValueError naming the first that must not be unpacked."""
    members = archive.infolist()
    if len(members) > MOST_FILES:
        raise ValueError(f"{path}: {len(members)} files inside; accepted: up to {MOST_FILES}")
    size = sum(member.file_size for member in members)
    if size > LARGEST:
        raise ValueError(f"{path}: {size} bytes when unpacked; accepted: up to {LARGEST}")
    for member in members:
        name = member.orig_filename
        parts = PurePosixPath(name).parts
        if not parts or name.startswith("/") or ".." in parts or "\\" in name or ":" in name or "\0" in name:
            raise ValueError(f"{path}: refused: the file {name!r} would leave the folder it is unpacked in")
        if stat.S_ISLNK(member.external_attr >> 16):
            raise ValueError(f"{path}: refused: {name!r} is a link")
        if member.flag_bits & 1:
            raise ValueError(f"{path}: refused: {name!r} is encrypted")
    names = [member.filename for member in members]
    if len(set(names)) < len(names):
        raise ValueError(f"{path}: refused: a file is in it twice")
    if "modelDescription.xml" not in names:
        raise ValueError(f"{path}: no modelDescription.xml inside; accepted: an FMU")
    return [member for member in members if not member.is_dir()]


def _write(path: Path, archive: zipfile.ZipFile, members: list[zipfile.ZipInfo], folder: Path) -> None:
    for member in members:
        target = folder / member.filename
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(member) as source, target.open("wb") as copy:
                shutil.copyfileobj(source, copy)  # zipfile reads no more than the size that was checked
        except _DAMAGED as error:
            raise ValueError(f"{path}: damaged: {member.filename!r}: {error}") from error


def _description(path: Path, folder: Path) -> Any:
    """What fmpy reads in modelDescription.xml of an FMU of FMI 2.0 or 3.0 with Model Exchange."""
    try:
        from fmpy import read_model_description
    except ImportError as error:
        raise ValueError(FMPY_MISSING) from error
    text = (folder / "modelDescription.xml").read_bytes()
    if len(text) > LARGEST_DESCRIPTION:
        raise ValueError(f"{path}: refused: modelDescription.xml is too long")
    try:
        if _declares_entities(text):
            raise ValueError("refused, it declares entities")
        description = read_model_description(folder, validate=False)
    except Exception as error:  # fmpy raises whatever its parser meets
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"{path}: modelDescription.xml cannot be read: {reason or type(error).__name__}") from error
    if not str(description.fmiVersion).startswith(("2.", "3.")):
        raise ValueError(f"{path}: FMI {description.fmiVersion}; accepted: 2.0, 3.0")
    if description.modelExchange is None:
        raise ValueError(f"{path}: no Model Exchange, Co-Simulation alone; accepted: an FMU with Model Exchange")
    return description


def _declares_entities(text: bytes) -> bool:
    """Whether XML, in any encoding, has a document type; read no further than to its first element."""
    found: list[bool] = []
    parser = ParserCreate()
    parser.StartDoctypeDeclHandler = lambda *declaration: found.append(True)
    parser.StartElementHandler = lambda *element: found.append(False)
    for start in range(0, len(text), CHUNK):
        parser.Parse(text[start : start + CHUNK])
        if found:
            return found[0]
    return False


def _library(path: Path, description: Any, members: list[zipfile.ZipInfo], folder: Path) -> Path:
    """Where the library for this platform will be."""
    here = platform_folder(description.fmiVersion)
    name = f"binaries/{here}/{description.modelExchange.modelIdentifier}.{library_ending()}"
    if name not in {member.filename for member in members}:
        there = {PurePosixPath(m.filename).parts[1] for m in members if m.filename.startswith("binaries/")}
        found = f"binaries for {', '.join(sorted(there))}" if there else "sources alone"
        raise ValueError(f"{path}: no binary for {here}; it has {found}")
    return folder / name
