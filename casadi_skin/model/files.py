"""Files that a reader never sees half of, files that one process has, and folders that do not outlive this process."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import shutil
import signal
import socket
import stat
import subprocess
import tempfile
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path

from casadi_skin.model.interrupts import ENDING

LEFTOVER_NAME = re.compile(r"\.(?P<name>.+(?P<suffix>\.\w+))\.[a-z0-9_]{8}(?P=suffix)")  # as `replacing` names them

NOT_FOLLOWED = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # a link; a pipe is not waited for
BINARY = getattr(os, "O_BINARY", 0)


def other_file(path: Path, in_place: bool = False) -> str:
    """Why what stands at a path is none of our files, in words; empty where it is one, or nothing stands there.

    A file that is written in place has no other name: what is written would be in the other file too.
    """
    try:
        return _fault(path.lstat(), in_place)
    except FileNotFoundError:
        return ""


def _fault(state: os.stat_result, in_place: bool) -> str:
    if stat.S_ISLNK(state.st_mode):
        return "is a symbolic link"
    if not stat.S_ISREG(state.st_mode):
        return "is a directory" if stat.S_ISDIR(state.st_mode) else "is no file"
    return "is a hard link, the same file as another one" if in_place and state.st_nlink > 1 else ""


def opened_in_place(path: Path) -> int:
    """Descriptor of a file to be written in place, made where there is none; raises OSError where it is a link."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | NOT_FOLLOWED | BINARY, 0o666)
    fault = _fault(os.fstat(descriptor), in_place=True)
    if fault:
        os.close(descriptor)
        raise OSError(errno.EMLINK, fault, str(path))
    return descriptor


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


_locked = set[int]()  # descriptors of files that this process has locked


def _unlock_forked() -> None:
    """A forked process does not keep files locked."""
    while _locked:
        os.close(_locked.pop())


os.register_at_fork(after_in_child=_unlock_forked)


@contextmanager
def locked(path: Path, shared: bool) -> Iterator[None]:
    """Have a file alone, or with others that share it: its process in words, made here, which goes with the last one.

    Raises BlockingIOError where others have it, and OSError where the disk has no locks.
    """
    descriptor = _locked_descriptor(path, shared)
    try:
        yield
    finally:
        if descriptor in _locked:
            with suppress(OSError):  # the file goes with the last who has it
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if _is_there(descriptor, path):
                    path.unlink()
            _locked.remove(descriptor)
            os.close(descriptor)


def _locked_descriptor(path: Path, shared: bool) -> int:
    while True:
        descriptor = opened_in_place(path)
        try:
            fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
            if _is_there(descriptor, path):
                os.truncate(descriptor, 0)
                os.pwrite(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
                _locked.add(descriptor)
                return descriptor
        finally:
            if descriptor not in _locked:
                os.close(descriptor)


def _is_there(descriptor: int, path: Path) -> bool:
    """Whether an open file is still there: who had it before may have removed it."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(descriptor), path.stat())
    return False


class TemporaryFolder:
    """A new temporary folder that goes with this object, or when this process ends, however that comes about.

    A shell waits at the end of a pipe that this process holds: it reads the pipe's end after SIGKILL as well.
    """

    def __init__(self, prefix: str) -> None:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)  # the shell inherits it
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
