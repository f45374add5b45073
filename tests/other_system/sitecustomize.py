"""What Windows has not is taken away from a Python that is started with this folder on its path, and from its workers.

POSIX's names go, and with them /bin/sh; a file that is open can be neither replaced nor removed; text without a named
encoding is an error where the package asks for it. Locks are those of `msvcrt`: of ranges of bytes, of one process
alone. What the standard library itself needs on the system that this is tried on is loaded before, and keeps its names.
"""

from __future__ import annotations

import asyncio  # noqa: F401
import concurrent.futures.process  # noqa: F401
import fcntl
import multiprocessing.connection
import multiprocessing.resource_tracker
import multiprocessing.spawn  # noqa: F401
import os
import shutil  # noqa: F401
import signal
import subprocess
import sys
import tempfile  # noqa: F401
import types
import warnings
from pathlib import Path
from typing import Any

import numpy  # noqa: F401

MODULES = ("fcntl", "grp", "posix", "pty", "pwd", "readline", "resource", "syslog", "termios", "tty")
OF_OS = (
    "O_CLOEXEC", "O_DIRECTORY", "O_NOCTTY", "O_NOFOLLOW", "O_NONBLOCK", "O_SYNC", "chown", "chroot", "fchmod", "fchown",
    "fork", "forkpty", "getegid", "geteuid", "getgid", "getloadavg", "getpgid", "getpgrp", "getpriority", "getsid",
    "getuid", "killpg", "mkfifo", "mknod", "nice", "pread", "preadv", "pwrite", "pwritev", "register_at_fork",
    "sched_getaffinity", "sched_setaffinity", "setgid", "setpgid", "setsid", "setuid", "statvfs", "sync", "sysconf",
    "uname", "wait", "wait3", "wait4",
)  # fmt: skip
KEPT_SIGNALS = ("SIGABRT", "SIGFPE", "SIGILL", "SIGINT", "SIGSEGV", "SIGTERM", "SIG_DFL", "SIG_IGN")
KEPT_OF_SIGNAL = ("default_int_handler", "getsignal", "raise_signal", "set_wakeup_fd", "signal", "strsignal",
                  "valid_signals")  # fmt: skip


def msvcrt() -> types.ModuleType:
    """Locks of bytes of a file from where it is read on, which do not wait."""
    module: Any = types.ModuleType("msvcrt")
    module.LK_UNLCK, module.LK_NBLCK = 0, 2
    hows = {0: fcntl.LOCK_UN, 2: fcntl.LOCK_EX | fcntl.LOCK_NB}

    def locking(descriptor: int, mode: int, length: int) -> None:
        try:
            fcntl.lockf(descriptor, hows[mode], length, os.lseek(descriptor, 0, os.SEEK_CUR))
        except BlockingIOError:
            raise PermissionError(13, "Permission denied") from None

    module.locking = locking
    return module


def guarded(change: Any, of_target: bool = False) -> Any:
    """A function of `os` that changes what stands at a path, refused where this process has it open."""

    def unless_open(path: Any, *more: Any, **options: Any) -> Any:
        for place in (path, *more) if of_target else (path,):
            if options.get("dir_fd") is None and is_open(os.fspath(place)):
                raise PermissionError(13, "it is open: Permission denied", os.fspath(place))
        return change(path, *more, **options)

    return unless_open


def is_open(path: str) -> bool:
    """Whether any process has a file open, or this one has it mapped."""
    if not os.path.isfile(path):
        return False
    state = os.stat(path)
    for descriptor in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            if os.path.samestat(descriptor.stat(), state):
                return True
        except OSError:  # that of the list itself, or of a process of somebody else
            continue
    return f" {os.path.realpath(path)}\n" in Path("/proc/self/maps").read_text(encoding="utf-8")


class NoShell(subprocess.Popen):  # type: ignore[type-arg]
    def __init__(self, args: Any, **options: Any) -> None:
        if not isinstance(args, str) and str(args[0]).startswith("/bin/"):
            raise FileNotFoundError(2, "No such file or directory", args[0])
        super().__init__(args, **options)

    def kill(self) -> None:
        self.send_signal(9)


locks = msvcrt()
os.replace, os.rename = guarded(os.replace, of_target=True), guarded(os.rename, of_target=True)
os.remove = os.unlink = guarded(os.unlink)
subprocess.Popen = NoShell  # type: ignore[misc]
for name in MODULES:
    sys.modules[name] = None  # type: ignore[assignment]
sys.modules["msvcrt"] = locks
for name in OF_OS:
    if hasattr(os, name):
        delattr(os, name)
for name in dir(signal):
    public = name.startswith("SIG") or (name.islower() and not name.startswith("_"))
    if public and name not in (*KEPT_SIGNALS, *KEPT_OF_SIGNAL):
        delattr(signal, name)
warnings.filterwarnings("error", category=EncodingWarning, module="casadi_skin")
