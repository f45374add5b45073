"""README.md and CMakeLists.txt of an export."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from casadi_skin._version import __version__
from casadi_skin.export.c_text import Part, plain
from casadi_skin.export.example_program import CHAIN_S
from casadi_skin.export.exported_model import PARTS, ExportedModel
from casadi_skin.export.orbit_equations import floquet_of

FLAGS = "-std=c99 -O2"


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
    rows = "\n".join(f"| `{what}` | {PARTS[what]} |" for what in parts if what in PARTS)
    text = f"""# {plain(exported.model.name)} in C

Written by casadi_skin {__version__} (license.txt). It is C99 and
needs nothing but libm{" (Ipopt's part needs libipopt)" if "ipopt" in parts else ""}.
The model is dimensionless. `{name}.h` declares every function and gives sizes and orders; `main.c` is an example.

| part | what it is |
| --- | --- |
{rows}

## Build

```sh
cc {FLAGS} {plain_sources} -lm -o {name}_main
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
cc {FLAGS} YOUR_PROGRAM.c {needed} -lipopt -lm
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
