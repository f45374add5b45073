"""Compiles casadi_skin/native/*.c into one library when the package is built; without a compiler numpy does the work.

`python hatch_build.py` does it in a clone, as `pip install -e .` does. The compiler is $CC, else cc, gcc or clang. The
library calls nothing of Python: one serves all versions of it. The README for an index of packages is made here, too.
"""

from __future__ import annotations

import os
import platform
import re
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
    from hatchling.metadata.plugin.interface import MetadataHookInterface
except ImportError:  # of a script that compiles in a clone
    BuildHookInterface = MetadataHookInterface = object

NATIVE = Path(__file__).parent / "casadi_skin" / "native"
# Every operation is rounded, as numpy's are: none are fused.
FLAGS = ("-std=c11", "-O3", "-ffp-contract=off", "-fvisibility=hidden")
SECONDS = 600  # that a call of the compiler may take: it takes two


class BuildError(Exception):
    """There is no compiler, or it fails; numpy does the work then."""


def compile_kernels(target: Path) -> None:
    """Compile all kernels into one library; raises BuildError."""
    named = shlex.split(os.environ.get("CC", ""))
    compiler = named or [name for name in ("cc", "gcc", "clang") if shutil.which(name)][:1]
    if not compiler:
        raise BuildError("no C compiler")
    sources = [str(path) for path in sorted(NATIVE.glob("*.c"))]
    digest = zlib.crc32(b"".join(path.read_bytes() for path in sorted(NATIVE.glob("*.[ch]")))) & 0x7FFFFFFF
    flags = [*FLAGS, f"-DSOURCES={digest}"]  # native/__init__.py loads no library of other sources
    # Beside the target, which is replaced in one step: no process sees half of a library.
    with tempfile.TemporaryDirectory(dir=target.parent) as folder:
        objects = list[str]()
        macros = _run([*compiler, *flags, "-dM", "-E", sources[0]], folder)  # of the system that it compiles for
        windows = "#define _WIN32 " in macros
        if not windows:
            flags.append("-fPIC")
        elif "#define __clang__ " not in macros:  # gcc takes the stack there for aligned as AVX needs it: it is not
            flags.append("-Wa,-muse-unaligned-vector-move")
        if "__x86_64__" in macros:
            for instructions in ("avx2", "avx512f"):
                for source in sources:
                    objects.append(f"{Path(source).stem}_{instructions}.o")
                    _run([*compiler, *flags, f"-m{instructions}", "-c", source, "-o", objects[-1]], folder)
        linked = ["-shared", *sources, *objects, "-o", "kernels.library", "-static-libgcc" if windows else "-lm"]
        _run([*compiler, *flags, *linked], folder)
        Path(folder, "kernels.library").replace(target)


def _run(command: list[str], folder: str) -> str:
    """What the command prints."""
    try:
        return subprocess.run(
            command, cwd=folder, check=True, capture_output=True, errors="replace", timeout=SECONDS
        ).stdout
    except (OSError, subprocess.SubprocessError) as error:
        said = str(getattr(error, "stderr", None) or error).strip()
        raise BuildError(f"{command[0]}: {said.splitlines()[0] if said else error}") from error


def _system() -> str:
    """The system in the name of a wheel; Python for both processors of macOS compiles for the one that it runs on."""
    name = sysconfig.get_platform()
    if name.endswith("universal2"):
        arm = platform.machine() == "arm64"
        name = "macosx-11.0-arm64" if arm else name.replace("universal2", "x86_64")  # older ones know no arm64
    return re.sub(r"[-.]", "_", name)


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
        build_data["pure_python"], build_data["tag"] = False, f"py3-none-{_system()}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        self._folder.cleanup()


class ReadmeHook(MetadataHookInterface):  # type: ignore[misc, valid-type]
    """The README for an index of packages, where links into the repository are to have its address."""

    def update(self, metadata: dict[str, Any]) -> None:
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        address, tag = metadata["urls"]["Source"], f"v{metadata['version']}"
        text = re.sub(r"\]\((?=[\w/]+\.png\))", f"]({address}/raw/{tag}/", text)
        text = re.sub(r"\]\((?!https?://|#)", f"]({address}/blob/{tag}/", text)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


if __name__ == "__main__":
    try:
        compile_kernels(NATIVE / "kernels.library")
    except BuildError as problem:
        sys.exit(f"no kernels: {problem}")
