"""Files that a reader never sees half of, files that one process has, and folders that do not outlive this process."""

from __future__ import annotations

import errno
import os
import re
import shutil
import socket
import stat
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path

from casadi_skin.model.interrupts import ENDING, interrupts_deferred

LEFTOVER_NAME = re.compile(r"\.(?P<name>.+(?P<suffix>\.\w+))\.[a-z0-9_]{8}(?P=suffix)")  # as `replacing` names them

NOT_FOLLOWED = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)  # a link; a pipe is not waited for
BINARY = getattr(os, "O_BINARY", 0)
LOCKED_FROM, MOST_SHARING = 1 << 30, 1 << 15  # bytes that Windows locks, behind all that is written
WATCHER = """
import shutil, signal, sys
for number in sys.argv[2:]:
    signal.signal(int(number), signal.SIG_IGN)
sys.stdin.read()
shutil.rmtree(sys.argv[1], ignore_errors=True)
"""


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


if hasattr(os, "register_at_fork"):
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
            _locked.remove(descriptor)
            with suppress(OSError):  # the file goes with the last who has it
                _give_back(descriptor, path)


def _locked_descriptor(path: Path, shared: bool) -> int:
    while True:
        descriptor = opened_in_place(path)
        try:
            _lock(descriptor, shared)
            if _is_there(descriptor, path):
                os.truncate(descriptor, 0)
                os.lseek(descriptor, 0, os.SEEK_SET)
                os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
                _locked.add(descriptor)
                return descriptor
        finally:
            if descriptor not in _locked:
                os.close(descriptor)


def _lock(descriptor: int, shared: bool) -> None:
    """Lock a file; raises BlockingIOError where others have it.

    Windows locks bytes, for one process alone: who shares a file has one of them, who does not has all.
    """
    try:
        import fcntl
    except ImportError:
        import msvcrt

        for place in range(MOST_SHARING if shared else 1):
            os.lseek(descriptor, LOCKED_FROM + place, os.SEEK_SET)
            with suppress(OSError):
                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1 if shared else MOST_SHARING)  # type: ignore[attr-defined]
                return
        raise BlockingIOError from None
    fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)


def _give_back(descriptor: int, path: Path) -> None:
    """Unlock and close a file, and remove it where nobody else has it; raises OSError where one has."""
    try:
        import fcntl
    except ImportError:
        os.close(descriptor)
        path.unlink()  # Windows removes no file that another process has open
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if _is_there(descriptor, path):
            path.unlink()
    finally:
        os.close(descriptor)


def _is_there(descriptor: int, path: Path) -> bool:
    """Whether an open file is still there: who had it before may have removed it."""
    with suppress(OSError):
        return os.path.samestat(os.fstat(descriptor), path.stat())
    return False


class TemporaryFolder:
    """A new temporary folder that goes with this object, or when this process ends, however that comes about.

    A small Python waits at the end of a pipe that this process holds: it reads the pipe's end after SIGKILL as well.
    """

    def __init__(self, prefix: str) -> None:
        with interrupts_deferred():
            self.path = Path(tempfile.mkdtemp(prefix=prefix))
            command = [sys.executable, "-ISc", WATCHER, str(self.path), *(str(int(number)) for number in ENDING)]
            self._watcher = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                cwd=self.path.parent, start_new_session=True,
            )  # fmt: skip
            self._finalizer = weakref.finalize(self, _removed, self.path, self._watcher)

    def remove(self) -> None:
        """Remove it now."""
        self._finalizer()


def _removed(path: Path, watcher: subprocess.Popen[bytes]) -> None:
    shutil.rmtree(path, ignore_errors=True)
    assert watcher.stdin is not None
    watcher.stdin.close()
    watcher.wait()
