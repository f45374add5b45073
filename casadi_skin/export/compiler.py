"""Example programs and binaries of FMUs, built from exports by the C compiler of the system."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path

from casadi_skin.fmu.fmu_archive import FMPY_MISSING
from casadi_skin.model.arguments import short_repr

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2")
LIBRARY_FLAGS = ("-fPIC", "-shared", "-fvisibility=hidden")
SECONDS = 600  # that a compiler may take: 1000 sites take a few


class CompilerError(ValueError):
    """A C compiler is missing, or refuses a source."""


def find_compiler(name: str | None = None) -> str:
    """Path of the C compiler: the one named, else $CC, else the first of cc, gcc, clang; raises CompilerError."""
    named = name or os.environ.get("CC")
    for candidate in (named,) if named else COMPILERS:
        path = shutil.which(candidate)
        if path is not None:
            return path
    missing = short_repr(named) if named else ", ".join(COMPILERS)
    raise CompilerError(f"compiler: {missing} not found; accepted: a C99 compiler such as gcc, or CC=path/to/compiler")


def _compile(compiler: str, arguments: Sequence[str], folder: Path | None = None) -> None:
    """Run a compiler in a folder; raises CompilerError with its first complaint."""
    command = [compiler, *FLAGS, *arguments]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=SECONDS)
    except subprocess.TimeoutExpired:
        raise CompilerError(f"compiler: {compiler} takes more than {SECONDS} s") from None
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines()
        raise CompilerError(f"compiler: {compiler} failed: {lines[0] if lines else f'exit status {done.returncode}'}")


def build_c(directory: str | Path, compiler: str | None = None) -> Path:
    """Compile the example program of an export of C code into its directory.

    Arguments:
        directory: The directory that `export_c` wrote.
        compiler: Name or path of a C99 compiler; by default $CC, else cc, gcc or clang.

    Returns:
        The path of the program.

    Raises:
        ValueError: The directory is no export; as CompilerError, the compiler is missing or fails.
    """
    folder = Path(directory)
    sources = sorted(path.name for path in folder.glob("*.c") if "_ipopt" not in path.stem)
    if "main.c" not in sources:
        raise ValueError(f"directory: given {short_repr(str(directory))}; accepted: one that export_c wrote")
    _compile(find_compiler(compiler), [*sources, "-lm", "-o", "main"], folder)
    return folder / "main"


# FMUs ---------------------------------------------------------------------------------------------------------------


def fmi_headers() -> Path:
    """Folder with the header files of the FMI standard, which fmpy ships; raises ValueError where it is missing."""
    found = find_spec("fmpy")
    if found is None or found.origin is None:
        raise ValueError(FMPY_MISSING)
    return Path(found.origin).parent / "c-code"


def build_library(folder: Path, files: Iterable[str], target: Path) -> Path:
    """Compile C files of a folder into one shared library; raises CompilerError."""
    try:
        compiler = find_compiler()
    except CompilerError as error:
        raise CompilerError(f"{error}, or binary=False (sources alone)") from error
    sources = [str(folder / name) for name in files]
    arguments = [*LIBRARY_FLAGS, f"-I{fmi_headers()}", f"-I{folder}", *sources, "-o", str(target), "-lm"]
    _compile(compiler, arguments)
    return target
