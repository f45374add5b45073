"""What tests of generated C share: compilers with the flags that it must bear, and calls of what they make."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-Wpedantic", "-Wstrict-prototypes", "-Wconversion", "-Wshadow",
          "-Wdouble-promotion"]  # fmt: skip
SANITIZED = ["-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
COMPILERS = [name for name in ("gcc", "clang", "clang-14") if shutil.which(name)]
POINTER = ctypes.POINTER(ctypes.c_double)


def sanitizers(compiler: str) -> list[str]:
    """Flags of the sanitizers, none where the compiler has come without them."""
    command = [compiler, *SANITIZED, "-x", "c", "-", "-o", os.devnull]
    done = subprocess.run(command, input="int main(void) { return 0; }", text=True, capture_output=True, check=False)
    return SANITIZED if done.returncode == 0 else []


def compiled(directory: Path, compiler: str = "gcc", *flags: str) -> Path:
    """The example program, every file with all warnings."""
    objects = []
    for source in sorted(directory.glob("*.c")):
        if "_ipopt" in source.name:
            continue
        target = directory / f"{source.stem}.o"
        subprocess.run([compiler, *STRICT, *flags, "-c", str(source), "-o", str(target)], check=True)
        objects.append(str(target))
    program = directory / "program"
    subprocess.run([compiler, *flags, *objects, "-lm", "-o", str(program)], check=True)
    return program


def printed(program: Path, *command: str) -> dict[str, float]:
    """The numbers that a program prints, by their names; it must end well and write no error."""
    done = subprocess.run([*command, str(program)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return {name: float(value) for name, value in (line.split() for line in done.stdout.splitlines())}


class Library:
    """The functions and constants of an export, called from Python; arrays go in and out as numpy's."""

    def __init__(self, directory: Path, name: str) -> None:
        sources = [str(path) for path in directory.glob("*.c") if path.name != "main.c" and "_ipopt" not in path.name]
        path, compiler = directory / f"lib{name}.so", os.environ.get("CC", "gcc")
        subprocess.run([compiler, "-std=c99", "-O2", "-shared", "-fPIC", *sources, "-lm", "-o", str(path)], check=True)
        self._library, self._name = ctypes.CDLL(str(path)), name
        header = (directory / f"{name}.h").read_text()
        self._constants = {key: int(value) for key, value in re.findall(rf"{name.upper()}_(\w+) = (\d+)", header)}
        self._arrays = dict(re.findall(rf"extern const (?:int|double) {name}_(\w+)\[(\d+)\]", header))

    def __getitem__(self, constant: str) -> int:
        return self._constants[constant]

    def work(self, constant: str) -> Array:
        return np.full(self[constant], np.nan)

    def integers(self, array: str) -> NDArray[np.int32]:
        kind = ctypes.c_int * int(self._arrays[array])
        return np.array(kind.in_dll(self._library, f"{self._name}_{array}"), dtype=np.int32)

    def doubles(self, array: str) -> Array:
        kind = ctypes.c_double * int(self._arrays[array])
        return np.array(kind.in_dll(self._library, f"{self._name}_{array}"))

    def call(self, function: str, *arguments: Any) -> int:
        """Floats go as doubles, ints as ints, arrays as pointers, None as a null pointer."""
        given = [
            a.ctypes.data_as(POINTER) if isinstance(a, np.ndarray)
            else ctypes.c_double(a) if isinstance(a, float)
            else None if a is None
            else a
            for a in arguments
        ]  # fmt: skip
        result: int = getattr(self._library, f"{self._name}_{function}")(*given)
        return result

    def sparse(self, pattern: str, values: Array, rows: int) -> Array:
        """A full matrix from its non-zeros."""
        starts, row = self.integers(f"{pattern}_colptr"), self.integers(f"{pattern}_row")
        matrix = np.zeros((rows, starts.size - 1))
        matrix[row, np.repeat(np.arange(starts.size - 1), np.diff(starts))] = values
        return matrix
