"""The binary of an FMU for this platform: its C sources, the headers of the standard, and a C compiler."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path

from casadi_skin.models.fmu_archive import FMPY_MISSING

FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
COMPILERS = ("cc", "gcc", "clang")


def headers() -> Path:
    """Folder with the header files of the FMI standard, which fmpy ships; raises ValueError where it is missing."""
    found = find_spec("fmpy")
    if found is None or found.origin is None:
        raise ValueError(FMPY_MISSING)
    return Path(found.origin).parent / "c-code"


def compiler() -> str:
    """The C compiler: $CC, or the first of cc, gcc, clang; raises ValueError where there is none."""
    named = os.environ.get("CC")
    for name in [named] if named else COMPILERS:
        path = shutil.which(name)
        if path is not None:
            return path
    missing = named or ", ".join(COMPILERS)
    raise ValueError(f"compiler: {missing} not found; accepted: CC=path/to/compiler, or binary=False (sources alone)")


def compile_library(folder: Path, files: Iterable[str], target: Path, flags: Sequence[str] = ()) -> Path:
    """Compile C files of a folder into one shared library; raises ValueError with the compiler's first complaint."""
    command = [compiler(), *FLAGS, *flags, f"-I{headers()}", f"-I{folder}", *(str(folder / name) for name in files)]
    target.parent.mkdir(parents=True, exist_ok=True)
    done = subprocess.run([*command, "-o", str(target), "-lm"], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines() or ["?"]
        raise ValueError(f"compiler: {command[0]} failed: {lines[0]}")
    return target
