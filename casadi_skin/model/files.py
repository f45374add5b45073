"""Files that a reader never sees half of, and folders that do not outlive this process."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import tempfile
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path

LEFTOVER_NAME = re.compile(r"\.(?P<name>.+(?P<suffix>\.\w+))\.[a-z0-9_]{8}(?P=suffix)")  # as `replacing` names them


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place when the block ends without an exception."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        _flush(temporary)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)  # mkstemp makes files that only their owner can read
        temporary.replace(path)
    finally:
        with suppress(OSError):  # a folder that is gone; the exception of the block counts
            temporary.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    """Wait until a file is on the disk: a disk that is full may be noticed only then."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def leftovers(directory: Path, names: Iterable[str]) -> list[Path]:
    """Temporary files that `replacing` left in a directory where it was killed, of files that match any of `names`."""
    found = []
    for path in directory.glob(".*"):
        held = LEFTOVER_NAME.fullmatch(path.name)
        if held and any(fnmatch(held["name"], name) for name in names) and path.is_file() and not path.is_symlink():
            found.append(path)
    return found


class TemporaryFolder:
    """A new temporary folder that goes with this object, or when this process ends, however that comes about.

    A shell waits at the end of a pipe that this process holds: it reads the pipe's end after SIGKILL as well.
    """

    def __init__(self, prefix: str) -> None:
        held = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
        before = signal.pthread_sigmask(signal.SIG_BLOCK, held)  # the shell inherits it
        try:
            self.path = Path(tempfile.mkdtemp(prefix=prefix))
            command = ["/bin/sh", "-c", 'read -r _; exec rm -rf -- "$0"', str(self.path)]
            with open(os.devnull, "wb") as nothing:
                self._watcher = subprocess.Popen(
                    command, stdin=subprocess.PIPE, stdout=nothing, stderr=nothing, cwd="/", start_new_session=True
                )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self._finalizer = weakref.finalize(self, _removed, self.path, self._watcher)

    def remove(self) -> None:
        """Remove it now."""
        self._finalizer()


def _removed(path: Path, watcher: subprocess.Popen[bytes]) -> None:
    shutil.rmtree(path, ignore_errors=True)
    assert watcher.stdin is not None
    watcher.stdin.close()
    watcher.wait()
