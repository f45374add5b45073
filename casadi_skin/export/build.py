"""Building the example program of an export of C code."""

from __future__ import annotations

from pathlib import Path

from casadi_skin.arguments import short_repr
from casadi_skin.export.compiler import compile_with, find_compiler


def build_c(directory: str | Path, compiler: str | None = None) -> Path:
    """Compile the example program of an export into its directory, and return the path of the program.

    Raises ValueError for a directory that is no export, CompilerError where the compiler is missing or fails.
    """
    folder = Path(directory)
    sources = sorted(path.name for path in folder.glob("*.c") if "_ipopt" not in path.stem)
    if "main.c" not in sources:
        raise ValueError(f"directory: given {short_repr(str(directory))}; accepted: one that export_c wrote")
    compile_with(find_compiler(compiler), [*sources, "-lm", "-o", "main"], folder)
    return folder / "main"
