"""The time and memory that a scene needs, from sizes that are known before anything is built.

With n states, U = n columns unknowns at the ends and stages of the mesh's intervals, and Z non-zeros in the derivatives
of the right-hand side at all of them, the first solution needs about

    bytes = 1.2e8 + U (1.2e4 + 100 n) + 8e3 Z,    seconds = 0.7 + U (5e-5 + 1.3e-9 n^2) + 9e-6 Z

as measured on rings of 5 to 250 van der Pol oscillators (0.15 to 3.7 GB, 0.75 to 18 s of a processor), and on 25 and 50
of which each is coupled to all others (0.68 and 2.2 GB, 1.4 and 3.3 s): all within a tenth. With multipliers, rings of
25 and 100 need 1.5 times the bytes and up to 3.4 times the seconds; ten further points of a branch took four times as
long as the first. Finer meshes need more.

A family of a lattice of n sites whose forces reach b sites further in their order needs, on 4 odd cosines,

    bytes = 1.25e8 + 5.2e4 n + 2.3e3 n b, and 320 n^2 with multipliers,

as measured on chains of 24 to 1000 sites (with multipliers to 700) and planes of 64 to 2304, and a process of a design
on n sites 1.4e8 + 4e5 n + 1.05e3 n^2, on chains of 24 to 600: all within a sixth, from 0.12 to 0.76 GB.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np

from casadi_skin.model.methods import EVERY_SITE, PAYS_FROM
from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import SceneError
from casadi_skin.zero.butcher import TABLES
from casadi_skin.zero.orbit import DEFAULT_DEGREE, FIRST_INTERVALS

LOADED_BYTES = 1.2e8  # of this process, which it has already
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


def bytes_of(request: Request) -> float:
    """Bytes that a process needs for what a scene asks; 0 where that is little, or not estimated."""
    scene = request.scene
    if scene.given("orbit", "solution") or (scene.family is not None and scene.methods.transcription in TABLES):
        return cost_of(request).bytes
    if scene.design is not None and not scene.design.of:
        return 1.4e8 + 1e5 * request.equations.size
    if scene.family is None or (scene.lattice is not None and scene.lattice.long):
        return 0.0
    if scene.chain is not None:
        n, reach = request.model.sites, 1
        if n < PAYS_FROM or request.families[0].coordinates.description != EVERY_SITE:
            return 0.0
    else:
        model = request.equations
        rows, columns = ca.jacobian_sparsity(model.rhs, model.state).get_triplet()
        n, reach = model.size, int(np.max(np.abs(np.subtract(rows, columns)), initial=1))
    return float(1.25e8 + 5.2e4 * n + 2.3e3 * n * reach + 320.0 * n**2 * (scene.stability is not None))


OWN_GROUPS, GROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")  # of processes, whose memory Linux may limit
GROUP_FILES = {"": ("memory.max", "memory.current"), "memory": ("memory.limit_in_bytes", "memory.usage_in_bytes")}


def available_memory() -> float:
    """Bytes that a process can have without moving others to the disk; infinite where the system does not say.

    Those that are free, that groups of processes leave (of a container, or a batch system), and `ulimit -v`.
    """
    return min((*_free(), *_left_by_groups(), *_left_by_ulimit()), default=float("inf"))


def _free() -> Iterator[float]:
    try:
        text = Path("/proc/meminfo").read_text(encoding="ascii")
        yield 1024.0 * int(text.partition("MemAvailable:")[2].split()[0])
    except (OSError, ValueError, IndexError):
        with suppress(AttributeError, OSError, ValueError):  # AttributeError: on Windows there is no sysconf
            yield float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))


def _left_by_groups() -> Iterator[float]:
    with suppress(OSError):
        for line in OWN_GROUPS.read_text(encoding="utf-8").splitlines():
            _, kind, place = line.split(":", 2)
            if kind not in GROUP_FILES:
                continue
            own = GROUPS / kind / place.lstrip("/")
            for group in (own, *own.parents)[: len(Path(place).parts)]:
                with suppress(OSError, ValueError):  # ValueError: it has no limit; OSError: it is not to be seen
                    limit, used = (int((group / name).read_text(encoding="ascii")) for name in GROUP_FILES[kind])
                    stated = (group / "memory.stat").read_text(encoding="ascii")
                    cached = stated.partition("inactive_file ")[2].split()  # which the system gives back
                    yield float(limit - used + int(cached[0]) if cached else limit - used)


def _left_by_ulimit() -> Iterator[float]:
    with suppress(ImportError, OSError, ValueError, IndexError):  # ImportError: on Windows
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        if limit != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
            yield float(limit - pages * resource.getpagesize())


def check_memory(request: Request, path: Path, processes: int = 1) -> None:
    """Raises SceneError for a scene that needs more memory than there is, in so many processes."""
    need, there = bytes_of(request) * processes, available_memory()
    if need - LOADED_BYTES > max(there, 0.0):
        (name, *_) = request.scene.given("orbit", "solution", "family", "design")
        given = f"needs about {in_gigabytes(need)} of memory (within a factor of {UNCERTAINTY})"
        where = f" in {processes} processes" if processes > 1 else ""
        accepted = "fewer states, sites, [method] intervals or workers, or the option --beyond-memory"
        words = f"{given}{where}, of which {in_gigabytes(max(there, 0.0))} are there"
        raise SceneError(f"{path}: [{name}]: {words}; accepted: {accepted}")


def memory_in_words(request: Request) -> str:
    """The bytes that a scene needs, and what is there of them."""
    there = available_memory()
    of = f" of the {in_gigabytes(there)} there" if math.isfinite(there) else ""
    return in_gigabytes(bytes_of(request)) + of


def in_gigabytes(number: float) -> str:
    """Bytes in two digits."""
    return f"{number / 1e9:.2g} GB"
