"""The C compiler: only building needs one."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from casadi_skin.arguments import short_repr

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2")


class CompilerError(ValueError):
    """A C compiler that is not there, or that refused a source."""


def find_compiler(name: str | None = None) -> str:
    """Path of the C compiler: the one named, else $CC, else the first of cc, gcc, clang; raises CompilerError."""
    named = name or os.environ.get("CC")
    for candidate in (named,) if named else COMPILERS:
        path = shutil.which(candidate)
        if path is not None:
            return path
    missing = short_repr(named) if named else ", ".join(COMPILERS)
    raise CompilerError(f"compiler: {missing} not found; accepted: a C99 compiler such as gcc, or CC=path/to/compiler")


def compile_with(compiler: str, arguments: Sequence[str], folder: Path | None = None) -> None:
    """Run a compiler in a folder; raises CompilerError with its first complaint."""
    done = subprocess.run([compiler, *FLAGS, *arguments], cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines() if "error" in line] or done.stderr.splitlines()
        raise CompilerError(f"compiler: {compiler} failed: {lines[0] if lines else f'exit status {done.returncode}'}")
