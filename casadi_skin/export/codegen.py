"""CasADi functions as C99 sources: valid names, nothing that CasADi cannot write, compile times linear in their size.

CasADi writes a function that it has no C for with an `#error` inside, and calls of external programs as calls of
symbols that are not there: both are refused here, by name. It writes scalar expressions as one long block with a test
of a pointer at each access, which takes optimising compilers a time that grows with the square of its length: long
blocks are cut into parts.

Example programs and binaries of FMUs, built from exports by the C compiler of the system.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import shutil
import subprocess
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from textwrap import wrap

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.fmu.description import fmpy_package
from casadi_skin.model.arguments import file_path, short_repr
from casadi_skin.model.interrupts import end_group
from casadi_skin.model.result import renamed

LIBM_HEADERS = frozenset({"math.h", "string.h", "stdio.h"})
EXTERNAL_CLASS_NAME = "External"  # CasADi's class name of a function in a library that is loaded when it is called
LONGEST_BLOCK = 300  # statements: shorter parts compile no faster
C_FUNCTION_ARGUMENTS = "(const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem)"
ALL_USED = "  (void)arg, (void)res, (void)iw, (void)w, (void)mem;"  # no compiler warns of those that are not
C_KEYWORDS = frozenset(
    ("auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern",
     "float", "for", "goto", "if", "inline", "int", "long", "main", "register", "restrict", "return", "short",
     "signed", "sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile",
     "while", "null", "jac", "hess")
)  # fmt: skip
SYSTEM_HEADERS = frozenset(  # of the system: a NAME.h beside the sources would take their place
    ("assert", "complex", "ctype", "errno", "features", "fenv", "float", "inttypes", "iso646", "limits", "locale",
     "math", "setjmp", "signal", "stdarg", "stdbool", "stddef", "stdint", "stdio", "stdlib", "string", "tgmath",
     "time", "wchar", "wctype")
)  # fmt: skip


class CodegenError(ValueError):
    """A function that cannot be written as C, named in one line."""


def prototype(function: ca.Function) -> str:
    """The declaration in C of a function in a source, without a semicolon.

    It is called with mem = 0 and returns 0. `arg[i]` and `res[i]` point to the non-zeros of argument and result i, by
    columns; arg, res, iw and w hold as many entries as its sz_arg(), sz_res(), sz_iw() and sz_w().
    """
    return f"int {function.name()}(const double **arg, double **res, long long int *iw, double *w, int mem)"


def c_name(words: str) -> str:
    """A C identifier made of `words` (letters, digits, single underscores) that is no keyword and no system header.

    Letters that are not ASCII are written as their numbers, as u3b1, so that names stay different.
    """
    stem = plain_name(words.lower()) or "model"
    return stem if stem[0].isalpha() and stem not in C_KEYWORDS | SYSTEM_HEADERS else f"m_{stem}"


def plain_name(words: str) -> str:
    """Words as ASCII letters, digits and single underscores; other letters by their numbers."""
    plain = "".join(c if c.isascii() or not c.isalnum() else f"_u{ord(c):x}_" for c in words)
    return re.sub(r"[\W_]+", "_", plain, flags=re.ASCII).strip("_")


def c_source(name: str, functions: Sequence[ca.Function], headers: Collection[str] = LIBM_HEADERS) -> str:
    """The functions, each under its own name, as one C99 source for a file NAME.c.

    Symbols beside the functions begin with NAME. `headers` are the system headers that the source may need.
    Raises CodegenError naming the function, and the part of it, that cannot be written as C.
    """
    if c_name(name) != name.lower() or not re.fullmatch(r"\w+", name):
        raise CodegenError(f"name: given {name!r}; accepted: a C identifier such as {c_name(name)}")
    for function in functions:
        check_parts(function)
    generator = ca.CodeGenerator(f"{name}.c", {"with_export": False, "avoid_stack": True, "verbose": False})
    with contextlib.redirect_stderr(io.StringIO()):  # CasADi warns of expressions that are refused below
        for function in functions:
            generator.add(function)
        text = generator.dump()
    refused = re.search(r"#error (.*)", text)
    if refused:
        names = ", ".join(function.name() for function in functions)
        raise CodegenError(f"{names}: CasADi has no C for a part of it: {refused[1].strip()}")
    for header in re.findall(r"#include <(.+?)>", text):
        if header not in headers:
            raise CodegenError(f"{name}: needs {header}; accepted: functions that need libm only")
    text = _in_short_blocks(text).replace(f"{C_FUNCTION_ARGUMENTS} {{\n", f"{C_FUNCTION_ARGUMENTS} {{\n{ALL_USED}\n")
    return text.replace("(int mem) {\n", "(int mem) {\n  (void)mem;\n")


def check_parts(function: ca.Function) -> None:
    """Raises CodegenError for a part that is no C: generated on its own, so that it can be named."""
    for part in (function, *function.find_functions()):
        kind = part.class_name()
        if kind == EXTERNAL_CLASS_NAME:
            raise CodegenError(f"{function.name()}: calls {part.name()} of an external library, which has no C source")
        if kind in ("SXFunction", "MXFunction"):  # described by their own parts and operations
            continue
        with contextlib.redirect_stderr(io.StringIO()):
            single = ca.CodeGenerator("part.c", {"with_export": False})
            single.add(part)
            text = single.dump()
        if re.search(rf"#error .*{re.escape(kind)}", text):
            raise CodegenError(f"{function.name()}: its part {part.name()} ({kind}) cannot be written as C by CasADi")


# Long blocks ---------------------------------------------------------------------------------------------------------


# A work value, or a result where that is wanted, gets one number.
_ASSIGNMENT = r"  (?:w\[\d+\]=|if \(res\[\d+\]!=0\) res\[\d+\]\[\d+\]=)[^{}\n]*;\n"
_LONG_BLOCK = re.compile(
    rf"^static int (\w+){re.escape(C_FUNCTION_ARGUMENTS)} {{\n((?:{_ASSIGNMENT}){{{LONGEST_BLOCK},}})  return 0;\n}}$",
    re.MULTILINE,
)


def _in_short_blocks(text: str) -> str:
    """The source with every long function of assignments alone cut into parts of LONGEST_BLOCK statements."""
    return _LONG_BLOCK.sub(lambda found: _parts(found[1], found[2].splitlines()), text)


def _parts(name: str, body: list[str]) -> str:
    """The function in parts that are called one after the other.

    The table of parts is volatile: a compiler would put functions that are called once together again.
    """
    lines, count = list[str](), math.ceil(len(body) / LONGEST_BLOCK)
    for i in range(count):
        part = body[i * LONGEST_BLOCK : (i + 1) * LONGEST_BLOCK]
        lines += [f"static void {name}_part{i}{C_FUNCTION_ARGUMENTS} {{", *part, "}", ""]
    table = ", ".join(f"{name}_part{i}" for i in range(count))
    lines += [
        f"static int {name}{C_FUNCTION_ARGUMENTS} {{",
        f"  static void (*const volatile parts[]){C_FUNCTION_ARGUMENTS} = {{{table}}};",
        "  casadi_int i;",
        f"  for (i = 0; i < {count}; i++) parts[i](arg, res, iw, w, mem);",
        "  return 0;",
        "}",
    ]
    return "\n".join(lines)


# Texts of exports in files: whole files, and pieces of one -----------------------------------------------------------

EXPORT_TEMPLATES = files("casadi_skin.export") / "c"


def pieces(folder: Traversable, name: str) -> dict[str, str]:
    """The pieces of a file by their names: each begins below a line `@@ name`."""
    _, *found = re.split(r"^@@ (.+)\n", (folder / name).read_text(encoding="utf-8"), flags=re.MULTILINE)
    return dict(zip(found[::2], found[1::2], strict=True))


def with_words(text: str, **words: object) -> str:
    """A text with words in the place of `@name` each; other names stay as they are."""
    return re.sub(r"@(\w+)", lambda found: str(words.get(found[1], found[0])), text)


DECLARATIONS = pieces(EXPORT_TEMPLATES, "declarations.h")  # of the header, by names of functions and of C files


# Pieces of C text: arrays, strings, comments, plain functions around generated ones, and the parts of an export -------

C_LINE_WIDTH = 120
MOST_ENTRIES = 2**31 - 1  # sizes and indices are ints of C
BY_COLUMNS, BY_ROWS = ("colptr", "row"), ("rowptr", "column")


def plain(words: str) -> str:
    """Words of a user that may stand in a comment or a string of C: printable ASCII that ends neither.

    Other characters are written as their numbers, as (U+03B1), so that names stay different.
    """
    shown = "".join(char if " " <= char <= "~" else f"(U+{ord(char):04X})" for char in words)
    return shown.replace("\\", "/").replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").replace("@", "(at)")


def string(words: str) -> str:
    """A C string: the words in UTF-8, in octal where they are not ASCII."""
    inside = words.replace("\\", "/").replace('"', '\\"').replace("??", "? ?").replace("@", "\\100")
    return '"' + "".join(c if " " <= c <= "~" else "".join(f"\\{b:03o}" for b in c.encode()) for c in inside) + '"'


def comment(words: str) -> str:
    """A block comment, wrapped; `words` are our own but for what went through `plain`."""
    lines = wrap(words, C_LINE_WIDTH - 6)
    return "/* " + "\n * ".join(lines) + " */"


def filled(values: Iterable[str]) -> str:
    """Words in lines, with commas between."""
    return "\n".join(wrap(", ".join(values), C_LINE_WIDTH, initial_indent="    ", subsequent_indent="    ",
                          break_long_words=False, break_on_hyphens=False))  # fmt: skip


def doubles(name: str, values: ArrayLike) -> str:
    """Definition of an array of doubles with 17 significant digits; raises ValueError for one that is not finite."""
    array = np.asarray(values, dtype=float).ravel()
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name}: holds a number that is not finite; accepted: finite numbers")
    entries = [f"{value:.17g}" for value in array.tolist()] or ["0.0"]
    return f"const double {name}[{len(entries)}] = {{\n{filled(entries)}}};"


def integers(name: str, values: Sequence[int]) -> str:
    """Definition of an array of ints."""
    entries = [str(value) for value in values] or ["0"]
    return f"const int {name}[{len(entries)}] = {{\n{filled(entries)}}};"


def strings(name: str, values: Sequence[str]) -> str:
    """Definition of an array of strings."""
    entries = [string(value) for value in values] or ['""']
    lines, line = list[str](), "   "
    for entry in entries:  # strings are not cut
        if len(line) + len(entry) + 2 > C_LINE_WIDTH and line.strip():
            lines, line = [*lines, line], "   "
        line += f" {entry},"
    body = "\n".join([*lines, line])
    return f"const char *const {name}[{len(entries)}] = {{\n{body}\n}};"


def pattern(name: str, sparsity: ca.Sparsity, names: tuple[str, str] = BY_COLUMNS) -> tuple[str, str]:
    """Definitions and declarations of the pattern of a sparse matrix by columns (of its transpose by rows), from 0."""
    indices = dict(zip(names, (sparsity.colind(), sparsity.row()), strict=True))
    definitions = "\n\n".join(integers(f"{name}_{kind}", values) for kind, values in indices.items())
    lengths = {kind: max(1, len(values)) for kind, values in indices.items()}
    return definitions, "\n".join(f"extern const int {name}_{kind}[{length}];" for kind, length in lengths.items())


@dataclass(frozen=True)
class Call:
    """A plain C function around a generated one: its own name, arguments and results."""

    name: str
    function: ca.Function
    arguments: tuple[str, ...]
    results: tuple[str, ...]

    @property
    def prototype(self) -> str:
        """Its declaration without the comment and the semicolon."""
        return DECLARATIONS[self.name].rpartition("*/\n")[2].rstrip(";\n")

    @property
    def work(self) -> int:
        """Doubles that its work array needs."""
        return max(1, int(self.function.sz_w()))

    def text(self) -> str:
        """Its definition."""
        f = self.function
        lines = [
            f"{self.prototype}\n{{",
            f"    const double *arg[{max(1, f.sz_arg())}];",
            f"    double *res[{max(1, f.sz_res())}];",
            f"    long long int iw[{max(1, f.sz_iw())}];\n",
            *(f"    arg[{i}] = {given};" for i, given in enumerate(self.arguments)),
            *(f"    res[{i}] = {wanted};" for i, wanted in enumerate(self.results)),
            f"    return {f.name()}(arg, res, iw, work, 0);\n}}",
        ]
        return "\n".join(lines)


@dataclass(frozen=True)
class Size:
    """A constant of the header: NAME_`suffix`, and its meaning in words."""

    suffix: str
    value: int
    words: str


@dataclass(frozen=True)
class Part:
    """A part of an export: constants, declarations, definitions, generated functions and names of C files.

    In texts `@p` stands for the prefix of functions and arrays, `@P` for that of constants.
    """

    title: str
    sizes: tuple[Size, ...] = ()
    declarations: tuple[str, ...] = ()
    definitions: tuple[str, ...] = ()
    functions: tuple[ca.Function, ...] = ()
    files: tuple[str, ...] = ()

    def plus(
        self,
        definition: str = "",
        declaration: str = "",
        sizes: tuple[Size, ...] = (),
        functions: tuple[ca.Function, ...] = (),
        files: tuple[str, ...] = (),
    ) -> Part:
        """The part with more: a definition, a declaration, entries of its other fields."""
        declarations = (*self.declarations, *([declaration] if declaration else []))
        definitions = (*self.definitions, *([definition] if definition else []))
        rest = ((*self.functions, *functions), (*self.files, *files))
        return Part(self.title, (*self.sizes, *sizes), declarations, definitions, *rest)


def constants(prefix: str, values: Mapping[str, tuple[float, str]]) -> tuple[str, str]:
    """Definitions and declarations of doubles by name, each with its meaning."""
    definitions = "\n".join(f"const double {prefix}_{name} = {value:.17g};" for name, (value, _) in values.items())
    declarations = (f"extern const double {prefix}_{name}; {comment(words)}" for name, (_, words) in values.items())
    return definitions, "\n".join(declarations)


def arrays(prefix: str, values: Mapping[str, ArrayLike], words: str) -> tuple[str, str]:
    """Definitions and declarations of arrays of doubles by name, with one comment."""
    definitions = "\n\n".join(doubles(f"{prefix}_{name}", array) for name, array in values.items())
    declarations = [f"extern const double {prefix}_{name}[{max(1, np.size(array))}];" for name, array in values.items()]
    return definitions, "\n".join([comment(words), *declarations])


# Example programs and binaries of FMUs, built from exports by the C compiler of the system ----------------------------

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2")
LIBRARY_FLAGS = ("-fPIC", "-shared", "-fvisibility=hidden")
SECONDS = 600  # that a compiler may take: 1000 sites take a few


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


def _compile(compiler: str, arguments: Sequence[str], folder: Path | None = None) -> None:
    """Run a compiler in a folder; raises CompilerError with its first complaint."""
    command = [compiler, *FLAGS, *arguments]
    try:
        process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, errors="replace", process_group=0
        )
    except OSError as error:
        raise CompilerError(f"compiler: {compiler} cannot be run: {error.strerror}") from None
    with process:
        try:
            said = process.communicate(timeout=SECONDS)[1].splitlines()
        except BaseException as error:  # it is late, or interrupted: with it ends what it has started
            end_group(process)
            if not isinstance(error, subprocess.TimeoutExpired):
                raise
            raise CompilerError(f"compiler: {compiler} takes more than {SECONDS} s") from None
    if process.returncode:
        lines = [line.strip() for line in said if "error" in line] or said
        raise CompilerError(
            f"compiler: {compiler} failed: {lines[0] if lines else f'exit status {process.returncode}'}"
        )


@renamed(directory="path")
def build_c(path: str | Path, compiler: str | None = None) -> Path:
    """Compile the example program of an export of C code into its directory.

    Arguments:
        path: The directory that `export_c` wrote.
        compiler: Name or path of a C99 compiler; by default $CC, else cc, gcc or clang.

    Returns:
        The path of the program.

    Raises:
        ValueError: The directory is no export; as CompilerError, the compiler is missing or fails.
    """
    folder = file_path("path", path)
    if compiler is not None:
        file_path("compiler", compiler)
    sources = sorted(path.name for path in folder.glob("*.c") if "_ipopt" not in path.stem)
    if "main.c" not in sources:
        raise ValueError(f"path: given {short_repr(str(path))}; accepted: one that export_c wrote")
    program = "main.exe" if os.name == "nt" else "main"
    _compile(find_compiler(compiler), [*sources, "-lm", "-o", program], folder)
    return folder / program


# FMUs ---------------------------------------------------------------------------------------------------------------


def fmi_headers() -> Path:
    """Folder with the header files of the FMI standard, which fmpy ships; raises ValueError where it is missing."""
    return Path(fmpy_package().__file__).parent / "c-code"


def build_library(folder: Path, files: Iterable[str], target: Path) -> Path:
    """Compile C files of a folder into one shared library; raises CompilerError."""
    try:
        compiler = find_compiler()
    except CompilerError as error:
        raise CompilerError(f"{error}, or binary=False (sources alone)") from error
    sources = [str(folder / name) for name in files]
    arguments = [*LIBRARY_FLAGS, f"-I{fmi_headers()}", f"-I{folder}", *sources, "-o", str(target), "-lm"]
    _compile(compiler, arguments)
    return target
