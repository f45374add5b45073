"""Compiling an export: the only thing that needs a compiler."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from casadi_skin.arguments import shown

FLAGS = ("-std=c99", "-O2")


class CompilerError(RuntimeError):
    """A C compiler that is not there, or that refused a source."""


def build_c(directory: str | Path, compiler: str = "cc") -> Path:
    """Compile the example program of an export into its directory, and return the path of the program.

    Raises ValueError for a directory that is no export, CompilerError where the compiler is missing or fails.
    """
    folder = Path(directory)
    sources = sorted(path.name for path in folder.glob("*.c") if "_ipopt" not in path.stem)
    if "main.c" not in sources:
        raise ValueError(f"directory: given {shown(str(directory))}; accepted: one that export_c wrote")
    found = shutil.which(compiler)
    if found is None:
        raise CompilerError(
            f"compiler: given {shown(compiler)}, which is not there; accepted: a C99 compiler such as gcc"
        )
    command = [found, *FLAGS, *sources, "-lm", "-o", "main"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        first = next((line for line in done.stderr.splitlines() if "error" in line), f"exit status {done.returncode}")
        raise CompilerError(f"{compiler}: {first.strip()}")
    return folder / "main"
