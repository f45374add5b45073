"""A map as one file: an archive of its scene, its journals and its boundary, read as its directory is."""

from __future__ import annotations

import zipfile
from fnmatch import fnmatch
from pathlib import Path

from casadi_skin.fmu.unzip import Archive
from casadi_skin.model.arguments import file_path
from casadi_skin.model.files import TemporaryFolder, replacing
from casadi_skin.runs.directory import SCENE
from casadi_skin.runs.map_lines import BOUNDARY
from casadi_skin.runs.map_store import JOURNALS

PARTS = (SCENE, JOURNALS, BOUNDARY)
EPOCH = (1980, 1, 1, 0, 0, 0)  # so that the bytes depend on the map alone


def save_map(directory: Path, path: str | Path) -> Path:
    """Write the map of a directory to one file, from which `read_map` reads it; see `Map.save`."""
    target = file_path("path", path)
    if target.is_dir() or not target.parent.is_dir():
        raise ValueError(f"path: given {target}; accepted: the path of a file, in a directory that is there")
    parts = sorted(p for p in directory.iterdir() if _is_part(p.name))
    with replacing(target) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for part in parts:
            entry = zipfile.ZipInfo(part.name, EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, part.read_bytes())
    return target


def unpacked(path: Path) -> TemporaryFolder:
    """The parts of a map in one file, in a folder that goes with the object; raises ValueError for other files."""
    archive = Archive(path, "a map in one file")
    try:
        folder = TemporaryFolder("casadi_skin_map_")
        try:
            archive.write(folder.path, _is_part)
        except BaseException:
            folder.remove()
            raise
    finally:
        archive.close()
    return folder


def _is_part(name: str) -> bool:
    return any(fnmatch(name, part) for part in PARTS) and "/" not in name
