"""Example programs and binaries of FMUs, built from exports by the C compiler."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

from casadi_skin.fmu.fmu_archive import FMPY_MISSING
from casadi_skin.model.arguments import short_repr
from casadi_skin.native.compiler import LIBRARY_FLAGS, CompilerError, compile_with, find_compiler


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
    compile_with(find_compiler(compiler), [*sources, "-lm", "-o", "main"], folder)
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
    compile_with(compiler, arguments)
    return target
