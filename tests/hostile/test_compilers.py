"""Libraries of kernels that are damaged, and compilers that hang, or complain in another encoding."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from kernels import needs_kernels, numpy_alone
from outputs import module_at

from casadi_skin import native
from casadi_skin.export import codegen
from casadi_skin.export.codegen import CompilerError, build_c

CLONE = Path(__file__).parents[2]
OF_NO_USE = "numpy; the library is cut off, of other sources or of another system"
LOADED = """
import sys
from pathlib import Path
from casadi_skin import native
native.LIBRARY = Path(sys.argv[1])
whole = native.LIBRARY.read_bytes()
for part in range(16):
    native.LIBRARY.write_bytes(whole[: len(whole) * part // 16])
    native.kernels.cache_clear()
    assert native.kernels_in_words() == sys.argv[2], part
"""


@needs_kernels
def test_a_library_that_is_cut_off_anywhere_is_left_alone(tmp_path: Path) -> None:
    """To load it would end the process by SIGBUS: it is tried in another one."""
    cut = shutil.copy(native.LIBRARY, tmp_path / "kernels.library")
    subprocess.run([sys.executable, "-c", LOADED, str(cut), OF_NO_USE], check=True)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")
@pytest.mark.parametrize("digest", ["0", f"{native.digest_of_sources()}"])
def test_a_library_without_its_functions_is_left_alone(digest: str, tmp_path: Path) -> None:
    source, library = tmp_path / "other.c", tmp_path / "kernels.library"
    source.write_text(f"int sources(void) {{ return {digest}; }}\nint numbers_together(void) {{ return 2; }}\n")
    subprocess.run(["cc", "-shared", "-fPIC", str(source), "-o", str(library)], check=True)
    with numpy_alone(library):
        assert native.kernels_in_words() == OF_NO_USE


def compiler(folder: Path, program: str) -> str:
    path = folder / "cc"
    path.write_text(f"#!/bin/sh\n{program}\n")
    path.chmod(0o755)
    (folder / "main.c").write_text("int main(void) { return 0; }")
    return str(path)


def test_a_complaint_in_another_encoding_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cc = compiler(tmp_path, r"printf 'error: \351\377 no\nsecond\n' >&2; exit 1")
    with pytest.raises(CompilerError, match=r"^compiler: \S+ failed: error: .. no$"):
        build_c(tmp_path, cc)
    monkeypatch.setenv("CC", cc)
    build = module_at(CLONE / "hatch_build.py")
    with pytest.raises(build.BuildError, match=r"^\S+: error: .. no$"):
        build.compile_kernels(tmp_path / "kernels.library")
    assert not (tmp_path / "kernels.library").exists()


def test_a_compiler_that_is_no_program_is_one_line(tmp_path: Path) -> None:
    cc = Path(compiler(tmp_path, ""))
    cc.write_bytes(b"\x7fELF of another machine")
    with pytest.raises(CompilerError, match=r"^compiler: \S+ cannot be run: Exec format error$"):
        build_c(tmp_path, str(cc))


def test_a_compiler_that_hangs_is_given_up_with_what_it_has_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cc = compiler(tmp_path, f"sleep 60 & echo $! > {tmp_path}/pid; wait")
    monkeypatch.setattr(codegen, "SECONDS", 0.2)
    with pytest.raises(CompilerError, match=r"^compiler: \S+ takes more than 0\.2 s$"):
        build_c(tmp_path, cc)
    wait_for_the_end(int((tmp_path / "pid").read_text()))


UNALIGNED = "-Wa,-muse-unaligned-vector-move"


@pytest.mark.parametrize(
    ("macros", "flags", "without"),
    [
        ("_WIN32 __x86_64__", {"-static-libgcc", "-mavx2", UNALIGNED}, {"-fPIC", "-lm"}),
        ("_WIN32 __x86_64__ __clang__", {"-static-libgcc", "-mavx512f"}, {"-fPIC", "-lm", UNALIGNED}),
        ("__aarch64__ __clang__", {"-fPIC", "-lm"}, {"-static-libgcc", "-mavx2"}),
    ],
)
def test_kernels_are_compiled_for_the_system_of_the_compiler(
    macros: str, flags: set[str], without: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = tmp_path / "arguments"
    program = f"""for name in {macros}; do echo "#define $name 1"; done
echo "$@" >> {told}
for last; do [ "$made" = -o ] && touch "$last"; made=$last; done"""
    monkeypatch.setenv("CC", compiler(tmp_path, program))
    module_at(CLONE / "hatch_build.py").compile_kernels(tmp_path / "kernels.library")
    given = set(told.read_text().split())
    assert flags <= given
    assert not without & given
    assert (tmp_path / "kernels.library").exists()


def test_a_build_of_kernels_that_hangs_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", compiler(tmp_path, "exec sleep 60"))
    build = module_at(CLONE / "hatch_build.py")
    monkeypatch.setattr(build, "SECONDS", 0.2)
    with pytest.raises(build.BuildError, match=r"timed out after 0\.2 seconds$"):
        build.compile_kernels(tmp_path / "kernels.library")


def wait_for_the_end(process: int) -> None:
    until = time.monotonic() + 20.0
    while is_there(process):
        assert time.monotonic() < until
        time.sleep(0.02)


def is_there(process: int) -> bool:
    """Whether a process, of which another may be the parent, has not ended."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    state = subprocess.run(["ps", "-o", "state=", "-p", str(process)], capture_output=True, text=True, check=False)
    return state.stdout.strip() not in {"", "Z"}
