"""A chain, a model or an orbit as a directory of C99 with a header, an example program and a build description."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Mapping
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType

from casadi_skin._version import __version__
from casadi_skin.export.c_text import MOST_ENTRIES, Part, comment, plain
from casadi_skin.export.codegen import LIBM_HEADERS, CSource, c_source, check_parts
from casadi_skin.export.equations import (
    flow_part,
    jacobian_part,
    model_part,
    outputs_part,
    rhs_part,
    variational_part,
)
from casadi_skin.export.example_program import main_text
from casadi_skin.export.exported_model import ExportedModel, Source, chosen_parts, exported_model
from casadi_skin.export.orbit_equations import IPOPT_HEADER, ipopt_part, newton_part, orbit_part, residual_part
from casadi_skin.export.readme import cmake_text, readme_text
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.interrupts import interrupts_deferred

MAKERS: Mapping[str, Callable[[ExportedModel], Part]] = MappingProxyType({
    "rhs": rhs_part,
    "jacobian": jacobian_part,
    "variational": variational_part,
    "outputs": outputs_part,
    "flow": flow_part,
    "residual": residual_part,
    "newton": newton_part,
    "orbit": orbit_part,
    "ipopt": ipopt_part,
})  # fmt: skip
HARMONICS = 12


def export_c(
    source: Source,
    directory: str | Path,
    what: Collection[str] | None = None,
    *,
    name: str | None = None,
    harmonics: int = HARMONICS,
) -> Path:
    """Write a chain, a model, or an orbit of either as C99; all is dimensionless.

    Arguments:
        source: A Chain, an OdeModel, or an orbit of `follow_family` or `find_orbit`.
        directory: A new or empty directory.
        what: The parts: rhs, jacobian, variational, outputs, flow, residual, newton, orbit, ipopt; by default all that
            the source has and that need libm only.
        name: The prefix of all C names and files, by default that of the model or "chain".
        harmonics: Those of the collocation equations of a chain without an orbit.

    Returns:
        The path of the directory.

    Raises:
        TypeError: An argument is of a wrong type.
        ValueError: An argument is not accepted; as CodegenError, CasADi cannot write the equations as C. Nothing is
            written then.
    """
    exported = exported_model(source, name, harmonics)
    chosen = chosen_parts(exported, what)
    target = _free(directory)
    check_parts(exported.model.vector_field)  # before its derivatives, which it may not have
    texts = export_texts(exported, chosen)
    _write(texts, target)
    return target


def export_texts(exported: ExportedModel, chosen: Collection[str]) -> dict[str, str]:
    """The files of an export by their names."""
    parts = {"model": model_part(exported), **{what: MAKERS[what](exported) for what in chosen}}
    name, every = exported.name, list(parts.values())
    plainly = [part for what, part in parts.items() if what != "ipopt"]
    generated = c_source(f"{name}_generated", [f for part in plainly for f in part.functions])
    templates = [stem for part in every for stem in part.files]
    texts = {
        f"{name}.h": _header(exported, every),
        f"{name}.c": _definitions(plainly, generated),
        **({f"{name}_generated.c": generated.text} if generated.functions else {}),
        **{f"{name}_{stem}.c": _template(stem) for stem in templates},
        "main.c": main_text(exported, chosen),
    }
    if "ipopt" in parts:
        own = c_source(f"{name}_ipopt_generated", parts["ipopt"].functions, LIBM_HEADERS | {IPOPT_HEADER})
        texts |= {f"{name}_ipopt.c": _definitions([parts["ipopt"]], own), f"{own.name}.c": own.text}
    sources = [file for file in texts if file.endswith(".c")]
    texts |= {
        "CMakeLists.txt": cmake_text(name, sources),
        "README.md": readme_text(exported, parts, sources),
        "license.txt": files("casadi_skin.fmu").joinpath("sources", "license.txt").read_text(encoding="utf-8"),
    }
    return {file: text.replace("@p", name).replace("@P", name.upper()) for file, text in texts.items()}


def _header(exported: ExportedModel, parts: list[Part]) -> str:
    guard = f"{exported.name.upper()}_H"
    about = (
        f"{plain(exported.model.name)}: C99 written by casadi_skin {__version__}; see license.txt. The model is "
        "dimensionless. Arrays are the caller's; matrices are stored by columns, indices count from 0, and fit into an "
        "int. Each function has an array `work` of its own length, is free of other memory, and may be called from "
        "several threads with different arrays."
    )
    lines = [comment(about), f"#ifndef {guard}\n#define {guard}\n", "#include <stddef.h>\n", CPLUSPLUS_OPEN]
    for part in parts:
        for size in part.sizes:
            if size.value > MOST_ENTRIES:
                words = f"{size.value} {size.words}; accepted: up to {MOST_ENTRIES}, which an int of C holds"
                raise ValueError(f"{exported.name}: {size.suffix}: {words}")
        lines.append(f"{comment(part.title + '.')}\n")
        if part.sizes:
            entries = [f"    @P_{size.suffix} = {size.value}, {comment(size.words)}" for size in part.sizes]
            last = entries.pop().replace(", /*", " /*", 1)
            lines.append("\n".join(["enum {", *entries, last, "};\n"]))
        lines += [f"{declaration}\n" for declaration in part.declarations]
    return "\n".join([*lines, CPLUSPLUS_CLOSE, f"#endif /* {guard} */\n"])


CPLUSPLUS_OPEN = '#ifdef __cplusplus\nextern "C" {\n#endif\n'
CPLUSPLUS_CLOSE = "#ifdef __cplusplus\n}\n#endif\n"


def _definitions(parts: list[Part], generated: CSource) -> str:
    prototypes = [f"{function.prototype};" for function in generated.functions]
    about = comment("Tables, and plain functions around the generated ones.")
    texts = [definition for part in parts for definition in part.definitions]
    return "\n\n".join([f'{about}\n\n#include "@p.h"', "#include <math.h>", *prototypes, *texts]) + "\n"


def _template(stem: str) -> str:
    return files("casadi_skin.export").joinpath("c", f"{stem}.c").read_text(encoding="utf-8")


# The directory --------------------------------------------------------------------------------------------------------


def _free(directory: str | Path) -> Path:
    """The directory, which does not exist or is empty; raises ValueError, TypeError where it cannot be used."""
    if not isinstance(directory, str | Path) or not str(directory):
        raise TypeError(f"directory: given {short_repr(directory)}; accepted: a path")
    target = Path(directory)
    accepted = "accepted: an empty or new directory"
    if not target.is_dir() and (target.exists() or target.is_symlink()):
        raise ValueError(f"{target}: is not a directory; {accepted}")
    held = sorted(path.name for path in target.iterdir()) if target.exists() else []
    if held:
        raise ValueError(f"{target}: holds {held[0]}{' and more' if len(held) > 1 else ''}; {accepted}")
    parent = target.absolute()
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise ValueError(f"{target}: cannot be written (in {parent}); accepted: a directory that can be")
    return target


def _write(texts: Mapping[str, str], target: Path) -> None:
    """All files, moved to where they belong when they are complete.

    An empty directory is filled, not replaced: it may be a link, or that in which the program runs.
    """
    target, there = target.absolute(), target.exists()
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(dir=target if there else target.parent, prefix=f".{target.name}."))
    try:
        for file, text in texts.items():
            (temporary / file).write_text(text, encoding="utf-8", newline="\n")
        with interrupts_deferred():
            if there:
                for file in texts:
                    (temporary / file).rename(target / file)
            else:
                umask = os.umask(0)
                os.umask(umask)
                temporary.chmod(0o777 & ~umask)  # mkdtemp makes directories that only their owner can read
                temporary.rename(target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
