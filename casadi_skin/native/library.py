"""Shared libraries of this package's own C sources: compiled once, kept in the user's cache, loaded with ctypes.

A library runs with the user's rights, so the folder has to be the user's own, closed to everybody else, and below
no folder in which others may put another one in its place. The name of a library has the sum of its source and of
the headers, its compiler, the flags and the processor; it is written under another name and renamed, so that no
process sees half of it.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import stat
import sys
import warnings
from functools import cache
from pathlib import Path

from casadi_skin.model.files import replacing
from casadi_skin.native.compiler import LIBRARY_FLAGS, CompilerError, compile_with, find_compiler

SWITCH = "CASADI_SKIN_KERNELS"  # 0 in this variable of the environment: numpy alone
SOURCES = Path(__file__).parent
STRICT = ("-std=c99", "-O3", "-ffp-contract=off")  # every operation is rounded, as numpy's are
OTHERS = stat.S_IRWXG | stat.S_IRWXO
PROCESSOR = Path("/proc/cpuinfo")
FEATURES = ("model name", "flags", "Features", "CPU part")  # of a processor, that its code may depend on


class KernelWarning(UserWarning):
    """A compiled kernel cannot be had although there is a compiler; numpy takes its place, with the same results."""


@cache
def library(name: str) -> ctypes.CDLL | None:
    """The library of the source `name`.c of this folder; None where numpy has to do: see `without`."""
    if without() is not None:
        return None
    try:
        return _loaded(SOURCES / f"{name}.c", find_compiler(), cache_folder())
    except (CompilerError, OSError) as error:
        warnings.warn(f"no compiled kernel, numpy takes its place: {error}", KernelWarning, stacklevel=2)
        return None


def without() -> str | None:
    """Why no kernel is compiled, in words; None where they are."""
    if os.environ.get(SWITCH) == "0":
        return f"{SWITCH}=0"
    try:
        find_compiler()
    except CompilerError as error:
        return str(error)
    return None


def cache_folder() -> Path:
    """The folder of compiled kernels, made where it is missing; raises OSError where it is not private."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or _caches_at_home()) / "casadi_skin"
    if not folder.is_absolute():
        raise OSError(f"{folder}: given a relative path as folder of caches; accepted: an absolute one")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & OTHERS:
        raise OSError(f"{folder}: given a folder that is a link, or not of this user alone; accepted: one of mode 0700")
    for parent in folder.resolve().parents:
        mode = parent.stat().st_mode
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            raise OSError(f"{folder}: given a folder below {parent}, where everybody may write; accepted: another one")
    return folder


def _caches_at_home() -> Path:
    try:
        return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")
    except RuntimeError as error:  # a user without an entry in the system's list, as in some containers
        raise OSError(f"no folder of caches: {error}") from None


def _loaded(source: Path, compiler: str, folder: Path) -> ctypes.CDLL:
    """The library of a source, compiled where the folder does not have it yet."""
    text = b"".join(path.read_bytes() for path in (source, *sorted(SOURCES.glob("*.h"))))
    processor = _processor()
    flags = (*STRICT, *LIBRARY_FLAGS, *(("-march=native",) if processor else ()))
    one = os.stat(compiler)
    build = (platform.machine(), processor, os.path.realpath(compiler), one.st_size, one.st_mtime_ns, flags)
    key = hashlib.sha256(text + repr(build).encode()).hexdigest()[:32]
    path = folder / f"{source.stem}-{key}.so"
    if not path.exists():
        with replacing(path) as temporary:
            compile_with(compiler, [str(source), "-o", str(temporary)], flags=flags)
    found = path.lstat()
    if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid():
        raise OSError(f"{path}: given a link, or a library of another user; accepted: one of this user")
    return ctypes.CDLL(str(path))


def _processor() -> str:
    """A text that differs between processors that do not run each other's code; empty where that is not known."""
    try:
        lines = PROCESSOR.read_text().split("\n\n")[0].splitlines()
    except OSError:
        return ""
    return "\n".join(line for line in lines if line.startswith(FEATURES))
