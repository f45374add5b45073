"""An FMU's binary in a process of its own first: where it ends that process, or never answers, it is refused.

This finds faults, and keeps nobody out: the binary runs with all that the user may do, there and afterwards here, and
may behave otherwise the second time, at another state, or after a while.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from casadi_skin.fmu.fmu_archive import Unpacked, read_description
from casadi_skin.fmu.fmu_model import made
from casadi_skin.fmu.fmu_variables import FmuChoices

ANSWERED = 86  # the exit status of a process in which the binary came back, with values or an error
_PROGRAM = "from casadi_skin.fmu.fmu_trial import main; main()"
_answered: set[tuple[str, str]] = set()  # archives and arguments that were tried in this process


def check_answer(unpacked: Unpacked, choices: FmuChoices, inputs: Mapping[str, float], time_limit: float) -> None:
    """Raises ValueError where the model cannot be made of an FMU and evaluated once within a time, in seconds."""
    wanted = {"asked": asdict(choices), "inputs": dict(inputs)}
    key = unpacked.digest, json.dumps(wanted)
    if key in _answered:
        return
    places = {"path": str(unpacked.path), "folder": str(unpacked.folder), "library": str(unpacked.library)}
    words = json.dumps({**places, **wanted, "time_limit": time_limit})
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p or str(Path.cwd()) for p in sys.path)}
    with subprocess.Popen(
        [sys.executable, "-P", "-c", _PROGRAM, words], env=environment, stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    ) as process:  # fmt: skip
        try:
            status = process.wait(time_limit)
        except subprocess.TimeoutExpired:
            accepted = "accepted: one that does, or a longer time_limit"
            raise ValueError(
                f"{unpacked.path}: its binary does not answer within {time_limit:g} s; {accepted}"
            ) from None
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    if status != ANSWERED:
        how = signal.Signals(-status).name if status < 0 else f"exit status {status}"
        accepted = "accepted: one that comes back"
        raise ValueError(f"{unpacked.path}: its binary ends the process that calls it ({how}); {accepted}")
    _answered.add(key)


def main() -> None:
    """The process: makes the model as `import_fmu` does, evaluates it once, and ends with `ANSWERED`."""
    given = json.loads(sys.argv[1])
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, given["time_limit"] + 1.0)  # should nobody be left to end it
    threading.Thread(target=_end_with_parent, daemon=True).start()
    folder, path = Path(given["folder"]), Path(given["path"])
    try:
        unpacked = Unpacked(path, folder, Path(given["library"]), read_description(path, folder), lambda: None)
        names: Any = {name: tuple(v) if isinstance(v, list) else v for name, v in given["asked"].items()}
        choices = FmuChoices(**names)
        model = made(unpacked, choices, given["inputs"])
        model.function("once", model.rhs, *model.outputs.values())(0.0, model.start_state, model.nominal or ())
    except Exception:  # the same is raised, and reported, where the FMU is read
        pass
    os._exit(ANSWERED)


def _end_with_parent() -> None:
    sys.stdin.buffer.read()
    os._exit(1)
