"""The binary of an FMU for this platform: its C sources, the headers of the standard, and a C compiler."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.util import find_spec
from pathlib import Path

from casadi_skin.export.compiler import CompilerError, compile_with, find_compiler
from casadi_skin.models.fmu_archive import FMPY_MISSING

FLAGS = ("-fPIC", "-shared", "-fvisibility=hidden")


def headers() -> Path:
    """Folder with the header files of the FMI standard, which fmpy ships; raises ValueError where it is missing."""
    found = find_spec("fmpy")
    if found is None or found.origin is None:
        raise ValueError(FMPY_MISSING)
    return Path(found.origin).parent / "c-code"


def compiler() -> str:
    """The C compiler; raises CompilerError where there is none."""
    try:
        return find_compiler()
    except CompilerError as error:
        raise CompilerError(f"{error}, or binary=False (sources alone)") from error


def compile_library(folder: Path, files: Iterable[str], target: Path, flags: Sequence[str] = ()) -> Path:
    """Compile C files of a folder into one shared library; raises CompilerError with the compiler's first complaint."""
    sources = [str(folder / name) for name in files]
    target.parent.mkdir(parents=True, exist_ok=True)
    compile_with(compiler(), [*FLAGS, *flags, f"-I{headers()}", f"-I{folder}", *sources, "-o", str(target), "-lm"])
    return target
