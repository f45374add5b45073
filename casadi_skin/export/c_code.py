"""A chain, a model or an orbit as a directory of C99 with a header, an example program and a build description."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Mapping
from importlib.resources import files
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import cast

import numpy as np

from casadi_skin._version import __version__
from casadi_skin.export.codegen import (
    DECLARATIONS,
    EXPORT_TEMPLATES,
    LIBM_HEADERS,
    MOST_ENTRIES,
    Part,
    c_source,
    check_parts,
    comment,
    pieces,
    plain,
    prototype,
    with_words,
)
from casadi_skin.export.exported_model import (
    EXPORTED_PARTS,
    ExportedModel,
    Source,
    chosen_parts,
    exported_model,
    flow_part,
    model_part,
    outputs_part,
    rhs_part,
    variational_part,
)
from casadi_skin.export.orbit_equations import (
    IPOPT_HEADER,
    floquet_of,
    ipopt_part,
    newton_part,
    orbit_part,
    residual_part,
)
from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import file_path
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.model.result import in_turn, renamed

# The example program of an export: results of its parts, printed with all digits --------------------------------------

SPLITTING_STEPS = 96  # of the splitting in a quarter of the period: 1e-13 or better on the orbits tried
STEPS_A_HARMONIC = 8  # of the extrapolation in the period of a model's orbit
SHOWN_RATES = 5  # entries of a right-hand side that the program of a model without an orbit prints, or a few more
CHAIN_S = 0.2  # amplitude of the orbit that the program of a chain alone computes


def main_text(exported: ExportedModel, parts: Collection[str]) -> str:
    """The text of main.c; `@p` and `@P` stand for the prefixes."""
    piece, statics = pieces(EXPORT_TEMPLATES, "main.c"), list[str]()
    if exported.chain is None:
        blocks = [piece["orbit of a model"]] if "orbit" in parts else []
        if "flow" in parts:
            velocities = "start + @P_ORBIT_STATES" if exported.model.order == 2 else "0"
            blocks.append(piece["return" if "orbit" in parts else "flow"].replace("@velocities", velocities))
    else:
        blocks = [piece["orbit of a chain"]] if "orbit" in parts else []
        if "newton" in parts:
            words = {"mode": end_mode(exported.chain), "S": f"{CHAIN_S:g}"}
            from_mode = with_words(piece["newton from a linear mode"], **words)
            blocks.append(piece["newton from the orbit"] if "orbit" in parts else from_mode)
            statics.append(piece["newton arrays"])
        if blocks and "flow" in parts:  # there is an orbit to follow the flow along
            start = piece["start from newton" if "newton" in parts else "start from the orbit"]
            blocks.append(with_words(piece["multipliers"], start=start))
            statics.append(piece["flow arrays"])
    if "orbit" not in parts:
        blocks.insert(0, piece["right-hand side" if "rhs" in parts else "sizes"])
    nominal = piece["nominal values"] if exported.parameters else ""
    body = with_words(
        "\n".join(blocks), nominal=nominal, steps=SPLITTING_STEPS, harmonic_steps=STEPS_A_HARMONIC, shown=SHOWN_RATES
    )
    blank = "\n" if statics else ""
    return f"{piece['head']}{''.join(statics)}{blank}int main(void)\n{{\n{body}    return 0;\n}}\n"


def end_mode(chain: Chain) -> int:
    """The linear mode that turns into a breather at an end."""
    return int(chain.sites) if chain.g > 0 else 1


def orbit_of_program(exported: ExportedModel, parts: Collection[str]) -> Orbit | None:
    """The orbit that the example program has or computes, None where there is none."""
    if "orbit" in parts or "newton" not in parts:
        return exported.orbit if "orbit" in parts else None
    assert exported.chain is not None
    try:
        branch = follow_family(exported.chain, end_mode(exported.chain), CHAIN_S, at=(CHAIN_S,), tolerance=1e-12)
        return cast(Orbit, branch.at(S=CHAIN_S))
    except (ValueError, ArithmeticError):  # the mode does not oscillate, or its family ends before
        return None


# README.md and CMakeLists.txt of an export ----------------------------------------------------------------------------

COMPILER_FLAGS = "-std=c99 -O2"


def cmake_text(sources: Collection[str]) -> str:
    """A static library of all that needs libm only, the example program, and Ipopt's part on request."""
    piece, ipopt = pieces(EXPORT_TEMPLATES, "CMakeLists.txt"), [file for file in sources if "_ipopt" in file]
    library = "\n".join(f"  {file}" for file in sources if file != "main.c" and "_ipopt" not in file)
    text = with_words(piece["library and program"], library=library)
    return text + with_words(piece["ipopt"], ipopt=" ".join(ipopt)) if ipopt else text


def readme_text(exported: ExportedModel, parts: Mapping[str, Part], sources: Collection[str]) -> str:
    """Contents of the directory, how to build it, and the expected numbers."""
    name, piece = exported.name, pieces(EXPORT_TEMPLATES, "README.md")
    text = with_words(
        piece["contents and build"], title=plain(exported.model.name), version=__version__, flags=COMPILER_FLAGS,
        ipopt=" (Ipopt's part needs libipopt)" if "ipopt" in parts else "",
        rows="\n".join(f"| `{what}` | {EXPORTED_PARTS[what]} |" for what in parts if what in EXPORTED_PARTS),
        sources=" ".join(file for file in sources if "_ipopt" not in file),
    )  # fmt: skip
    if "ipopt" in parts:
        needed = [file for file in sources if file in (f"{name}.c", f"{name}_generated.c") or "_ipopt" in file]
        text += with_words(piece["ipopt"], flags=COMPILER_FLAGS, needed=" ".join(needed))
    return text + _expected(exported, parts)


def _expected(exported: ExportedModel, parts: Mapping[str, Part]) -> str:
    """The numbers of the example program as Python has them."""
    lines, model, orbit = list[str](), exported.model, orbit_of_program(exported, parts)
    if "rhs" in parts and "orbit" not in parts:
        x = 0.1 / np.arange(1.0, model.full_size + 1)
        rates = model.vector_field(0.0, x, exported.parameters or np.zeros(model.parameters.numel())).full()[:, 0]
        lines += [f"rhs_{i} {rates[i]:.17g}" for i in range(0, rates.size, 1 + rates.size // SHOWN_RATES)]
    if orbit is not None:
        name, error = "period" if "newton" in parts else "orbit_period", orbit.period * orbit.Omega_error / orbit.Omega
        lines.append(f"{name} {orbit.period:.17g} (estimated error {error:.1g})")
    floquet = floquet_of(orbit) if orbit is not None and "flow" in parts else ""
    if not isinstance(floquet, str) and exported.chain is None:
        lines.append(f"trace {float(floquet.multipliers.sum().real):.17g} (the sum of the multipliers)")
    elif not isinstance(floquet, str):
        words = f"(estimated error {floquet.error:.1g})"
        lines.append(f"largest_multiplier {floquet.max_abs_multiplier:.17g} {words}")
    if not lines:
        return ""
    table = "\n".join(lines)
    return f"\n## Numbers to expect\n\nComputed in Python when this was written:\n\n```\n{table}\n```\n"


PART_MAKERS: Mapping[str, Callable[[ExportedModel], Part]] = MappingProxyType({
    "rhs": rhs_part,
    "jacobian": attrgetter("jacobian"),
    "variational": variational_part,
    "outputs": outputs_part,
    "flow": flow_part,
    "residual": residual_part,
    "newton": newton_part,
    "orbit": orbit_part,
    "ipopt": ipopt_part,
})  # fmt: skip
START_HARMONICS = 12


@renamed(directory="path")
@in_turn
def export_c(
    source: Source,
    path: str | Path,
    what: Collection[str] | None = None,
    *,
    name: str | None = None,
    harmonics: int = START_HARMONICS,
) -> Path:
    """Write a chain, a model, or an orbit of either as C99; all is dimensionless.

    Arguments:
        source: A Chain, an OdeModel, or an orbit of `follow_family` or `find_orbit`.
        path: A new or empty directory.
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
    target = _free(path)
    check_parts(exported.model.vector_field)  # before its derivatives, which it may not have
    texts = export_texts(exported, chosen)
    _write(texts, target)
    return target


def export_texts(exported: ExportedModel, chosen: Collection[str]) -> dict[str, str]:
    """The files of an export by their names."""
    parts = {"model": model_part(exported), **{what: PART_MAKERS[what](exported) for what in chosen}}
    name, every = exported.name, list(parts.values())
    plainly = [part for what, part in parts.items() if what != "ipopt"]
    generated = [function for part in plainly for function in part.functions]
    templates = [f"{stem}.c" for part in every for stem in part.files]
    texts = {
        f"{name}.h": _header(exported, every),
        f"{name}.c": _definitions(plainly),
        **({f"{name}_generated.c": c_source(f"{name}_generated", generated)} if generated else {}),
        **{f"{name}_{file}": (EXPORT_TEMPLATES / file).read_text(encoding="utf-8") for file in templates},
        "main.c": main_text(exported, chosen),
    }
    if "ipopt" in parts:
        own = f"{name}_ipopt_generated"
        text = c_source(own, parts["ipopt"].functions, LIBM_HEADERS | {IPOPT_HEADER})
        texts |= {f"{name}_ipopt.c": _definitions([parts["ipopt"]]), f"{own}.c": text}
    sources = [file for file in texts if file.endswith(".c")]
    texts |= {
        "CMakeLists.txt": cmake_text(sources),
        "README.md": readme_text(exported, parts, sources),
        "license.txt": files("casadi_skin.fmu").joinpath("sources", "license.txt").read_text(encoding="utf-8"),
    }
    return {
        file: text.replace("*restrict ", "*@P_RESTRICT ").replace("@p", name).replace("@P", name.upper())
        for file, text in texts.items()
    }


def _header(exported: ExportedModel, parts: list[Part]) -> str:
    guard = f"{exported.name.upper()}_H"
    about = (
        f"{plain(exported.model.name)}: C99 written by casadi_skin {__version__}; see license.txt. The model is "
        "dimensionless. Arrays are the caller's; matrices are stored by columns, indices count from 0, and fit into an "
        "int. Arrays of one call do not overlap. Each function has an array `work` of its own length, is free of other "
        "memory, and may be called from several threads with different arrays."
    )
    lines = [comment(about), f"#ifndef {guard}\n#define {guard}\n", DECLARATIONS["begin"]]
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
        lines += [f"{text.rstrip()}\n" for text in (*part.declarations, *(DECLARATIONS[stem] for stem in part.files))]
    return "\n".join([*lines, DECLARATIONS["end"], f"#endif /* {guard} */\n"])


def _definitions(parts: list[Part]) -> str:
    prototypes = [f"{prototype(function)};" for part in parts for function in part.functions]
    about = comment("Tables, and plain functions around the generated ones.")
    texts = [definition for part in parts for definition in part.definitions]
    return "\n\n".join([f'{about}\n\n#include "@p.h"', "#include <math.h>", *prototypes, *texts]) + "\n"


# The directory --------------------------------------------------------------------------------------------------------


def _free(path: str | Path) -> Path:
    """The directory, which does not exist or is empty; raises ValueError, TypeError where it cannot be used."""
    target = file_path("path", path)
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
                    (temporary / file).replace(target / file)
            else:
                umask = os.umask(0)
                os.umask(umask)
                temporary.chmod(0o777 & ~umask)  # mkdtemp makes directories that only their owner can read
                temporary.rename(target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
