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
from casadi_skin.export.codegen import (
    LIBM_HEADERS,
    MOST_ENTRIES,
    Part,
    c_source,
    check_parts,
    comment,
    plain,
    prototype,
)
from casadi_skin.export.exported_model import (
    EXPORTED_PARTS,
    ExportedModel,
    Source,
    chosen_parts,
    exported_model,
    flow_part,
    jacobian_part,
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
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.model.result import in_turn

# The example program of an export: results of its parts, printed with all digits --------------------------------------

SPLITTING_STEPS = 96  # of the splitting in a quarter of the period: 1e-13 or better on the orbits tried
STEPS_A_HARMONIC = 8  # of the extrapolation in the period of a model's orbit
CHAIN_S = 0.2  # amplitude of the orbit that the program of a chain alone computes


def main_text(exported: ExportedModel, parts: Collection[str]) -> str:
    """The text of main.c; `@p` and `@P` stand for the prefixes."""
    statics: list[str] = []
    if exported.chain is None:
        blocks = [MODEL_ORBIT] if "orbit" in parts else []
        if "flow" in parts:
            velocities = "start + @P_ORBIT_STATES" if exported.model.order == 2 else "0"
            blocks.append(MAIN_RETURN_TEXT.replace("@velocities", velocities) if "orbit" in parts else MAIN_FLOW_TEXT)
    else:
        blocks = [MAIN_ORBIT_TEXT] if "orbit" in parts else []
        if "newton" in parts:
            mode = int(exported.chain.sites) if exported.chain.g > 0 else 1  # the one that turns into an end breather
            from_mode = FROM_LINEAR_MODE.replace("@mode", str(mode)).replace("@S", f"{CHAIN_S:g}")
            blocks.append(FROM_ORBIT if "orbit" in parts else from_mode)
            statics.append(NEWTON_STATICS)
        if blocks and "flow" in parts:  # there is an orbit to follow the flow along
            blocks.append(MAIN_MULTIPLIERS_TEXT.replace("@start", FROM_NEWTON if "newton" in parts else FROM_DATA))
            statics.append(FLOW_STATICS)
    blocks = blocks or ([MAIN_RHS_TEXT] if "rhs" in parts else ['    printf("states %d\\n", @P_STATES);\n'])
    body = "\n".join(blocks).replace("@nominal", NOMINAL_VALUES_TEXT if exported.parameters else "")
    for name, number in (("@steps", SPLITTING_STEPS), ("@harmonic_steps", STEPS_A_HARMONIC)):
        body = body.replace(name, str(number))
    blank = BLANK_LINE if statics else ""
    return f"{MAIN_HEAD_TEXT}{''.join(statics)}{blank}int main(void)\n{{\n{body}    return 0;\n}}\n"


BLANK_LINE = "\n"
MAIN_HEAD_TEXT = """/* What this export computes, with all digits; see README.md for the numbers to expect. */

#include <math.h>
#include <stdio.h>

#include "@p.h"

"""
NEWTON_STATICS = "static double z[@P_UNKNOWNS], newton_work[@P_NEWTON_WORK];\n"
FLOW_STATICS = """static double x[@P_FLOW_STATES], Phi[@P_FLOW_STATES * @P_FLOW_STATES], flow_work[@P_FLOW_WORK];
static double mu_real[@P_SITES], mu_imaginary[@P_SITES], multipliers_work[@P_MULTIPLIERS_WORK];
"""
MAIN_ORBIT_TEXT = """    {
        static double y[@P_SITES], velocity[@P_SITES];
        double S = 0.0;
        int n;

        @p_orbit(@p_orbit_period, y, velocity);
        for (n = 0; n < @P_SITES; n++) S += y[n] * y[n];
        printf("orbit_period %.17g\\norbit_S %.17g\\n", @p_orbit_period, S);
    }
"""
FROM_ORBIT = """    @p_newton_report report;
    int i;

    /* The orbit, wrong by a thousandth, put right by Newton's method at its kappa. */
    for (i = 0; i < @P_UNKNOWNS; i++) z[i] = @p_orbit_z[i] * (1.0 + 1e-3 * sin(i + 1.0));
    if (@p_newton(z, @P_PARAMETER, @p_orbit_kappa, 1e-13, 20, &report, newton_work)) {
        fprintf(stderr, "newton: %s\\n", @p_newton_words(report.status));
        return 1;
    }
    printf("period %.17g\\niterations %d\\n", 2.0 * acos(-1.0) / z[@P_OMEGA], report.iterations);
"""
FROM_LINEAR_MODE = """    @p_newton_report report;
    int k, failed = @p_linear_mode(@mode, z);

    if (failed) fprintf(stderr, "linear mode @mode does not oscillate\\n");

    /* From the linear mode to S = @S in steps of S. */
    for (k = 1; k <= 4 && !failed; k++) {
        failed = @p_newton(z, @P_PARAMETER, @p_g * @S * k / 4, 1e-13, 20, &report, newton_work);
        if (failed) fprintf(stderr, "newton: %s\\n", @p_newton_words(report.status));
    }
    if (failed) return 1;
    printf("period %.17g\\n", 2.0 * acos(-1.0) / z[@P_OMEGA]);
"""
FROM_NEWTON = """
        @p_positions(z, x); /* at rest at t = 0: the velocities are zeros */
        quarter = 0.5 * acos(-1.0) / z[@P_OMEGA];
        kappa = z[@P_PARAMETER];"""
FROM_DATA = """        int n;

        @p_orbit(0.0, x, 0); /* at rest at t = 0: the velocities are zeros */
        for (n = 0; n < @P_SITES; n++) x[n] /= sqrt(@p_orbit_S) * @p_rho[n];
        quarter = 0.25 * @p_orbit_period;
        kappa = @p_orbit_kappa;"""
MAIN_MULTIPLIERS_TEXT = """    {
        double largest, trivial, quarter, kappa;
@start
        @p_flow(0.0, quarter, @steps, x, Phi, &kappa, flow_work);
        if (@p_multipliers(Phi, 1e-10, mu_real, mu_imaginary, &largest, &trivial, multipliers_work)) {
            fprintf(stderr, "multipliers: the QR iteration did not converge\\n");
            return 1;
        }
        printf("largest_multiplier %.17g\\ntrivial_deviation %.3g\\n", largest, trivial);
    }
"""
MODEL_ORBIT = """    printf("orbit_period %.17g\\n", @p_orbit_period);
"""
MAIN_RETURN_TEXT = """    {
        static double x[@P_STATES], start[@P_STATES], Phi[@P_STATES * @P_STATES], work[@P_FLOW_WORK];
        double p[@P_PARAMETERS + 1] = {0.0}, trace = 0.0, off = 0.0;
        int i;

@nominal        @p_orbit(0.0, start, @velocities);
        for (i = 0; i < @P_STATES; i++) x[i] = start[i];
        @p_flow(0.0, @p_orbit_period, @harmonic_steps * (@P_HARMONICS + 8), x, Phi, p, work);
        for (i = 0; i < @P_STATES; i++) {
            off = fmax(off, fabs(x[i] - start[i]));
            trace += Phi[i * (@P_STATES + 1)];
        }
        printf("return_error %.3g\\ntrace %.17g\\n", off, trace);
    }
"""
MAIN_FLOW_TEXT = """    {
        static double x[@P_FLOW_STATES], Phi[@P_FLOW_STATES * @P_FLOW_STATES], work[@P_FLOW_WORK];
        double p[@P_FLOW_PARAMETERS + 1] = {0.0}, trace = 0.0;
        int i;

@nominal        for (i = 0; i < @P_FLOW_STATES; i++) x[i] = 0.1 / (i + 1);
        @p_flow(0.0, 1.0, 100, x, Phi, p, work);
        for (i = 0; i < @P_FLOW_STATES; i++) {
            trace += Phi[i * (@P_FLOW_STATES + 1)];
            printf("%s %.17g\\n", @p_state_names[i], x[i]);
        }
        printf("trace %.17g\\n", trace);
    }
"""
MAIN_RHS_TEXT = """    {
        static double x[@P_STATES], dxdt[@P_STATES], work[@P_RHS_WORK];
        double p[@P_PARAMETERS + 1] = {0.0};
        int i;

@nominal        for (i = 0; i < @P_STATES; i++) x[i] = 0.1 / (i + 1);
        @p_rhs(0.0, x, p, dxdt, work);
        for (i = 0; i < @P_STATES; i++) printf("%s %.17g\\n", @p_state_names[i], dxdt[i]);
    }
"""
NOMINAL_VALUES_TEXT = "        for (i = 0; i < @P_PARAMETERS; i++) p[i] = @p_nominal[i];\n"


# README.md and CMakeLists.txt of an export ----------------------------------------------------------------------------

COMPILER_FLAGS = "-std=c99 -O2"


def cmake_text(name: str, sources: Collection[str]) -> str:
    """A static library of all that needs libm only, the example program, and Ipopt's part on request."""
    library = "\n".join(f"  {file}" for file in sources if file != "main.c" and "_ipopt" not in file)
    ipopt = [file for file in sources if "_ipopt" in file]
    text = f"""cmake_minimum_required(VERSION 3.10)
project({name}_export C)
set(CMAKE_C_STANDARD 99)
set(CMAKE_C_STANDARD_REQUIRED ON)
set(CMAKE_C_EXTENSIONS OFF)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()

add_library({name}_c STATIC
{library})
target_include_directories({name}_c PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
if(NOT MSVC)
  target_link_libraries({name}_c PUBLIC m)
endif()

add_executable({name}_main main.c)
target_link_libraries({name}_main {name}_c)
"""
    if ipopt:
        text += f"""
option(WITH_IPOPT "Build the part that needs libipopt" OFF)
if(WITH_IPOPT)
  add_library({name}_with_ipopt STATIC {" ".join(ipopt)})
  target_link_libraries({name}_with_ipopt {name}_c ipopt)
endif()
"""
    return text


def readme_text(exported: ExportedModel, parts: Mapping[str, Part], sources: Collection[str]) -> str:
    """Contents of the directory, how to build it, and the expected numbers."""
    name = exported.name
    plain_sources = " ".join(file for file in sources if "_ipopt" not in file)
    rows = "\n".join(f"| `{what}` | {EXPORTED_PARTS[what]} |" for what in parts if what in EXPORTED_PARTS)
    text = f"""# {plain(exported.model.name)} in C

Written by casadi_skin {__version__} (license.txt). It is C99 and
needs nothing but libm{" (Ipopt's part needs libipopt)" if "ipopt" in parts else ""}.
The model is dimensionless. `{name}.h` declares every function and gives sizes and orders; `main.c` is an example.

| part | what it is |
| --- | --- |
{rows}

## Build

```sh
cc {COMPILER_FLAGS} {plain_sources} -lm -o {name}_main
./{name}_main
```

or, with CMake, `cmake -S . -B build && cmake --build build && ./build/{name}_main`.
Without warnings by gcc 12 and clang 14 with `-Wall -Wextra -Wpedantic -Wconversion -Wshadow -Wdouble-promotion
-Wstrict-prototypes -Wno-unused-parameter`; no complex numbers of C, which some compilers lack.
"""
    if "ipopt" in parts:
        needed = " ".join(file for file in sources if file in (f"{name}.c", f"{name}_generated.c") or "_ipopt" in file)
        text += f"""
Ipopt's part needs Ipopt's headers (`coin-or/IpStdCInterface.h`) and library:

```sh
cc {COMPILER_FLAGS} YOUR_PROGRAM.c {needed} -lipopt -lm
```
"""
    return text + _expected(exported, parts)


def _expected(exported: ExportedModel, parts: Mapping[str, Part]) -> str:
    """The numbers of the example program as Python has them."""
    orbit = exported.orbit
    if orbit is None or "orbit" not in parts:
        if "newton" in parts:
            return f"\nThe program follows an edge mode to S = {CHAIN_S:g} and prints its period.\n"
        return ""
    name, error = "period" if "newton" in parts else "orbit_period", orbit.period * orbit.Omega_error / orbit.Omega
    lines = [f"{name} {orbit.period:.17g} (estimated error {error:.1g})"]
    floquet = floquet_of(orbit) if "flow" in parts else ""
    if not isinstance(floquet, str) and exported.chain is None:
        lines.append(f"trace {float(floquet.multipliers.sum().real):.17g} (the sum of the multipliers)")
    elif not isinstance(floquet, str):
        words = f"(estimated error {floquet.error:.1g})"
        lines.append(f"largest_multiplier {floquet.max_abs_multiplier:.17g} {words}")
    table = "\n".join(lines)
    return f"\n## Numbers to expect\n\nComputed in Python when this was written:\n\n```\n{table}\n```\n"


PART_MAKERS: Mapping[str, Callable[[ExportedModel], Part]] = MappingProxyType({
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
START_HARMONICS = 12


@in_turn
def export_c(
    source: Source,
    directory: str | Path,
    what: Collection[str] | None = None,
    *,
    name: str | None = None,
    harmonics: int = START_HARMONICS,
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
    parts = {"model": model_part(exported), **{what: PART_MAKERS[what](exported) for what in chosen}}
    name, every = exported.name, list(parts.values())
    plainly = [part for what, part in parts.items() if what != "ipopt"]
    generated = [function for part in plainly for function in part.functions]
    templates = [stem for part in every for stem in part.files]
    texts = {
        f"{name}.h": _header(exported, every),
        f"{name}.c": _definitions(plainly),
        **({f"{name}_generated.c": c_source(f"{name}_generated", generated)} if generated else {}),
        **{f"{name}_{stem}.c": _template(stem) for stem in templates},
        "main.c": main_text(exported, chosen),
    }
    if "ipopt" in parts:
        own = f"{name}_ipopt_generated"
        text = c_source(own, parts["ipopt"].functions, LIBM_HEADERS | {IPOPT_HEADER})
        texts |= {f"{name}_ipopt.c": _definitions([parts["ipopt"]]), f"{own}.c": text}
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


def _definitions(parts: list[Part]) -> str:
    prototypes = [f"{prototype(function)};" for part in parts for function in part.functions]
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
