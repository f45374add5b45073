"""One program by itself in a process: `python one_program.py NAME CALLS FOLDER` follows the family CALLS times.

Prints the seconds of the processor that loading, building and each call took. CALLS = 0 only loads and builds, so that
differences of counted instructions belong to one call.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from importlib import import_module
from itertools import pairwise
from pathlib import Path

from family_case import Family, FamilyCase, processor_seconds

CASE = FamilyCase()


def this(multipliers: bool, folder: Path) -> Callable[[], Family]:
    """The default of this package but for Newton's method in place of Ipopt, at 1e-8."""
    keywords = {"corrector": "newton", "walker": "series"}
    follow: Callable[[], Family] = import_module("our_family").our_family(CASE, 1e-8, keywords, multipliers)
    return follow


def default(multipliers: bool, folder: Path) -> Callable[[], Family]:
    """The default of this package: Ipopt has the last word."""
    keywords = {"corrector": "ipopt", "walker": "series"}
    follow: Callable[[], Family] = import_module("our_family").our_family(CASE, 1e-8, keywords, multipliers)
    return follow


def auto(formulation: str, settings: str, folder: Path) -> Callable[[], Family]:
    """AUTO with its settings of least time, or for as many points as this package has; compiles and links."""
    module = import_module("auto_family")
    of = import_module("auto_equations").Formulation[formulation]
    program = module.AutoProgram(folder, CASE, of)
    return lambda: program.follow(getattr(module, settings)[of])


def by_solve_bvp(multipliers: bool, folder: Path) -> Callable[[], Family]:
    """scipy's solve_bvp, its longest steps."""
    module = import_module("solve_bvp_family")
    walk = module.BvpWalk(CASE, module.BEST["S, longest steps"])
    return lambda: walk.family(multipliers)


def by_jaxcont(folder: Path) -> Callable[[], Family]:
    """JaxCont on odd cosines."""
    follow: Callable[[], Family] = import_module("jaxcont_family").JaxContWalk(CASE).family
    return follow


PROGRAMS: dict[str, Callable[[Path], Callable[[], Family]]] = {
    "this, Newton": lambda folder: this(False, folder),
    "this, Newton, multipliers": lambda folder: this(True, folder),
    "this, Ipopt (default)": lambda folder: default(False, folder),
    "this, Ipopt (default), multipliers": lambda folder: default(True, folder),
    "AUTO-07p, quarter, few points": lambda folder: auto("QUARTER", "BEST", folder),
    "AUTO-07p, quarter, many points": lambda folder: auto("QUARTER", "MANY_POINTS", folder),
    "AUTO-07p, reduced, multipliers, few points": lambda folder: auto("REDUCED", "BEST", folder),
    "AUTO-07p, reduced, multipliers, many points": lambda folder: auto("REDUCED", "MANY_POINTS", folder),
    "AUTO-07p, period, multipliers, few points": lambda folder: auto("PERIOD", "BEST", folder),
    "AUTO-07p, period, multipliers, many points": lambda folder: auto("PERIOD", "MANY_POINTS", folder),
    "solve_bvp": lambda folder: by_solve_bvp(False, folder),
    "solve_bvp, multipliers": lambda folder: by_solve_bvp(True, folder),
    "JaxCont": by_jaxcont,
}


def main(name: str, calls: int, folder: Path) -> None:
    """Print the seconds of building, loading included, and of each call, as JSON."""
    follow = PROGRAMS[name](folder)
    seconds = [processor_seconds()]
    for _ in range(calls):
        follow()
        seconds.append(processor_seconds())
    print(json.dumps([seconds[0], *(after - before for before, after in pairwise(seconds))]))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]))
