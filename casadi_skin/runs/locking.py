"""Directories in use: one process computes in a directory, or several that share a map.

The lock is the kernel's, on a hidden file: it ends with its process, however that comes about.
"""

from __future__ import annotations

import fcntl
import os
import socket
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from casadi_skin.runs.directory import LOCK, DirectoryError, check_writable, make_directory

ACCEPTED = "accepted: another directory, or this one when that process has ended"


class _Held:
    """An open file that is locked; a forked process does not keep it locked."""

    def __init__(self, path: Path, shared: bool) -> None:
        self.path = path
        self.descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(self.descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BaseException:
            self.close()
            raise
        _held.add(self)

    def close(self) -> None:
        """Close the file, and with it the lock of this process."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1

    @property
    def current(self) -> bool:
        """Whether the file is still there: who had it before may have removed it."""
        with suppress(OSError):
            return os.path.samestat(os.fstat(self.descriptor), self.path.stat())
        return False

    def release(self) -> None:
        """Give the lock back; the file goes with the last who has it."""
        with suppress(OSError):
            fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if self.current:
                self.path.unlink()
        self.close()


_held: weakref.WeakSet[_Held] = weakref.WeakSet()


def _close_all() -> None:
    for held in list(_held):
        held.close()


os.register_at_fork(after_in_child=_close_all)


@contextmanager
def in_use(directory: Path, report: Callable[[str], None], shared: bool = False, part: str = "") -> Iterator[None]:
    """Keep other processes out of a directory, which is made where it is not there.

    Arguments:
        directory: it.
        report: takes a line where the disk has no locks, and nothing is kept out.
        shared: whether others may have it at the same time that share it too.
        part: the part of a shared directory that one process alone may have.

    Raises:
        DirectoryError: the directory cannot be used, or another process computes in it.
    """
    check_writable(directory)
    new = not directory.exists()
    make_directory(directory)
    held = _taken(directory / (f"{LOCK}_{part}" if part else LOCK), report, shared)
    try:
        yield
    finally:
        if held is not None:
            held.release()
        if new and directory.is_dir() and not any(directory.iterdir()):
            directory.rmdir()


def _taken(path: Path, report: Callable[[str], None], shared: bool) -> _Held | None:
    """The lock of a file; None on a disk without locks. Raises DirectoryError where another process has it."""
    try:
        while True:
            held = _Held(path, shared)
            if held.current:
                break
            held.close()
        os.truncate(held.descriptor, 0)
        os.pwrite(held.descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode(), 0)
        return held
    except BlockingIOError:
        holder = ""
        with suppress(OSError):
            holder = path.read_text(encoding="utf-8", errors="replace")
        raise DirectoryError(f"{path.parent}: {holder or 'another process'} computes in it; {ACCEPTED}") from None
    except OSError as error:
        report(f"{path.parent}: cannot be locked ({error.strerror}): nothing else may compute in it meanwhile")
        return None
