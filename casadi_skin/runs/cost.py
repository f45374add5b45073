"""The time and memory that an orbit or a solution needs, from sizes that are known before anything is built.

With n states, U = n columns unknowns at the ends and stages of the mesh's intervals, and Z non-zeros in the derivatives
of the right-hand side at all of them, the first solution needs about

    bytes = 1.2e8 + U (1.2e4 + 100 n) + 8e3 Z,    seconds = 0.7 + U (5e-5 + 1.3e-9 n^2) + 9e-6 Z

as measured on rings of 5 to 250 van der Pol oscillators (0.15 to 3.7 GB, 0.75 to 18 s of a processor), and on 25 and 50
of which each is coupled to all others (0.68 and 2.2 GB, 1.4 and 3.3 s): all within a tenth. With multipliers, rings of
25 and 100 need 1.5 times the bytes and up to 3.4 times the seconds; ten further points of a branch took four times as
long as the first. Finer meshes need more.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import SceneError
from casadi_skin.zero.butcher import TABLES
from casadi_skin.zero.orbit import DEFAULT_DEGREE, FIRST_INTERVALS

UNCERTAINTY = 2  # factor of the estimates, on the first mesh


class Cost(NamedTuple):
    """Unknowns of a boundary-value problem on its first mesh, the mesh in words, seconds of a processor, and bytes."""

    unknowns: int
    mesh: str
    seconds: float
    bytes: float


def cost_of(request: Request) -> Cost:
    """The cost of the first solution of an [orbit] or a [solution]."""
    method, model = request.scene.methods, request.ode
    intervals, degree = method.intervals or FIRST_INTERVALS, method.degree or DEFAULT_DEGREE
    columns = intervals * TABLES[str(method.transcription)](degree).ends.size + 1
    n, nonzeros = model.full_size, model.vector_field.jac_sparsity(0, 1).nnz() * columns
    unknowns = n * columns
    mesh = f"{intervals} {method.transcription} intervals of degree {degree} at the start"
    slower, larger = (1.0, 1.0) if request.scene.stability is None else (3.0, 1.45)
    seconds = 0.7 + slower * (unknowns * (5e-5 + 1.3e-9 * n**2) + 9e-6 * nonzeros)
    return Cost(unknowns, mesh, seconds, 1.2e8 + larger * (unknowns * (1.2e4 + 100.0 * n) + 8e3 * nonzeros))


def available_memory() -> float:
    """Bytes that a process can have without moving others to the disk; infinite where the system does not say."""
    with suppress(OSError, ValueError, IndexError):
        text = Path("/proc/meminfo").read_text(encoding="ascii")
        return 1024.0 * int(text.partition("MemAvailable:")[2].split()[0])
    with suppress(AttributeError, OSError, ValueError):  # AttributeError: on Windows there is no sysconf
        return float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return float("inf")


def check_memory(request: Request, path: Path) -> None:
    """Raises SceneError for an orbit or a solution that needs more memory than there is."""
    cost, there = cost_of(request), available_memory()
    if cost.bytes > there:
        need = f"{in_gigabytes(cost.bytes)} of memory (within a factor of {UNCERTAINTY}) for {cost.unknowns} unknowns"
        accepted = "fewer states or [method] intervals, or the option --beyond-memory"
        name = request.scene.given("orbit", "solution")[0]
        given = f"needs about {need}, of which {in_gigabytes(there)} are there"
        raise SceneError(f"{path}: [{name}]: {given}; accepted: {accepted}")


def in_gigabytes(number: float) -> str:
    """Bytes in two digits."""
    return f"{number / 1e9:.2g} GB"
