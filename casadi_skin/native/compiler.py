"""The C compiler of the system: which one it is, and one call of it."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from casadi_skin.model.arguments import short_repr

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2")
LIBRARY_FLAGS = ("-fPIC", "-shared", "-fvisibility=hidden")


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


def compile_with(
    compiler: str, arguments: Sequence[str], folder: Path | None = None, flags: Sequence[str] = FLAGS
) -> None:
    """Run a compiler in a folder; raises CompilerError with its first complaint."""
    done = subprocess.run([compiler, *flags, *arguments], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines()
        raise CompilerError(f"compiler: {compiler} failed: {lines[0] if lines else f'exit status {done.returncode}'}")
