"""Compiles casadi_skin/native/*.c into one library when the package is built; without a compiler numpy does the work.

`python hatch_build.py` does it in a clone, as `pip install -e .` does. The compiler is $CC, else cc, gcc or clang. The
library calls nothing of Python: one serves all versions of it.
"""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import zlib
from pathlib import Path
from typing import Any

try:
    from hatchling.builders.hooks.plugin.interface import BuildHookInterface
except ImportError:  # of a script that compiles in a clone
    BuildHookInterface = object

NATIVE = Path(__file__).parent / "casadi_skin" / "native"
# Every operation is rounded, as numpy's are: none are fused.
FLAGS = ("-std=c11", "-O3", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden")
SECONDS = 600  # that a call of the compiler may take: it takes two


class BuildError(Exception):
    """There is no compiler, or it fails; numpy does the work then."""


def compile_kernels(target: Path) -> None:
    """Compile all kernels into one library; raises BuildError."""
    named = shlex.split(os.environ.get("CC", ""))
    compiler = named or [name for name in ("cc", "gcc", "clang") if shutil.which(name)][:1]
    if not compiler or sys.platform == "win32":
        raise BuildError("no C compiler")
    sources = [str(path) for path in sorted(NATIVE.glob("*.c"))]
    digest = zlib.crc32(b"".join(path.read_bytes() for path in sorted(NATIVE.glob("*.[ch]")))) & 0x7FFFFFFF
    flags = [*FLAGS, f"-DSOURCES={digest}"]  # native/__init__.py loads no library of other sources
    # Beside the target, which is replaced in one step: no process sees half of a library.
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        objects = []
        if platform.machine() in ("x86_64", "AMD64"):
            for instructions in ("avx2", "avx512f"):
                Path(folder, instructions).mkdir()
                _run([*compiler, *flags, f"-m{instructions}", "-c", *sources], f"{folder}/{instructions}")
            objects = sorted(str(path) for path in Path(folder).glob("*/*.o"))
        _run([*compiler, *flags, "-shared", *sources, *objects, "-o", "kernels.library", "-lm"], folder)
        Path(folder, "kernels.library").replace(target)


def _run(command: list[str], folder: str) -> None:
    try:
        subprocess.run(command, cwd=folder, check=True, capture_output=True, errors="replace", timeout=SECONDS)
    except (OSError, subprocess.SubprocessError) as error:
        said = str(getattr(error, "stderr", None) or error).strip()
        raise BuildError(f"{command[0]}: {said.splitlines()[0] if said else error}") from error


class KernelsHook(BuildHookInterface):  # type: ignore[misc, valid-type]
    """Puts the library into wheels, and beside its sources where the package is installed to be edited."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        self._folder = tempfile.TemporaryDirectory()
        target = (NATIVE if version == "editable" else Path(self._folder.name)) / "kernels.library"
        try:
            compile_kernels(target)
        except BuildError as error:
            target.unlink(missing_ok=True)  # of older sources
            self.app.display_warning(f"casadi_skin without compiled kernels, numpy does their work: {error}")
            return
        if version != "editable":
            build_data["force_include"][str(target)] = "casadi_skin/native/kernels.library"
        system = sysconfig.get_platform().replace("universal2", platform.machine()).translate(str.maketrans("-.", "__"))
        build_data["pure_python"], build_data["tag"] = False, f"py3-none-{system}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        self._folder.cleanup()


if __name__ == "__main__":
    try:
        compile_kernels(NATIVE / "kernels.library")
    except BuildError as problem:
        sys.exit(f"no kernels: {problem}")
