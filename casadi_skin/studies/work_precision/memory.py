"""The peak memory of one setting, in a process of its own (`python -m` with the name of this module)."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from math import nan
from pathlib import Path

from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.request import family_request
from casadi_skin.studies.work_precision.measured import Kind, Setting

MEGABYTE = 1e6
LONGEST = 3600.0  # seconds


def peak_memory() -> float:
    """Peak resident memory of this process so far in MB; nan where the system does not tell.

    From /proc where there is one: the peak that getrusage gives there counts the memory of the process that started
    this one.
    """
    status = Path("/proc/self/status")
    if status.exists():
        lines = dict(line.split(":", 1) for line in status.read_text(encoding="utf-8").splitlines() if ":" in line)
        if "VmHWM" in lines:
            return 1024.0 * int(lines["VmHWM"].split()[0]) / MEGABYTE
    try:
        import resource
    except ImportError:
        return nan
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEGABYTE


def memory_of(setting: Setting | None) -> float:
    """Peak memory in MB of a process that computes the setting once, or only imports what it takes; nan after an hour.

    Of a flow: the family with its multipliers, at the same tolerance. Raises ArithmeticError where the process fails.
    """
    request = None if setting is None else asdict(setting.request)
    stability = setting is not None and setting.kind is not Kind.ORBITS
    words = json.dumps({"request": request, "stability": stability})
    command = [sys.executable, "-m", __name__, words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=True)
    except subprocess.TimeoutExpired:
        return nan
    except subprocess.CalledProcessError as error:
        reason = (error.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise ArithmeticError(f"peak memory of {words} was not measured: {reason}") from error
    return float(done.stdout)


def main(words: str) -> None:
    """Compute what the words ask for, once, and print the peak memory in MB."""
    from casadi_skin.studies.work_precision.reference import walked

    asked = json.loads(words)
    if asked["request"] is not None:
        fields = asked["request"]
        fields |= {name: tuple(value) for name, value in fields.items() if isinstance(value, list)}
        fields["chain"] = Chain(**fields["chain"])
        walked(Family(family_request(**fields)), asked["stability"])
    print(peak_memory())


if __name__ == "__main__":
    main(sys.argv[1])
