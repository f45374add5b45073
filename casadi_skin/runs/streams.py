"""Standard output and error of a command: faults of the first end it in one line, those of the second are nothing."""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO


class OutputError(Exception):
    """Standard output cannot be written; the message says why."""


class _Stream:
    """A stream whose faults are raised as OutputError, or forgotten; None is one that is closed."""

    def __init__(self, stream: TextIO | None, forgiving: bool = False) -> None:
        self._stream, self._forgiving = stream, forgiving

    def write(self, text: str) -> int:
        try:
            if self._stream is None:
                raise OSError(errno.EBADF, "it is closed")
            return self._stream.write(text)
        except (OSError, ValueError) as error:  # ValueError: closed since
            self._fault(error)
            return len(text)

    def flush(self) -> None:
        try:
            if self._stream is not None:
                self._stream.flush()
        except (OSError, ValueError) as error:
            self._fault(error)

    def _fault(self, error: OSError | ValueError) -> None:
        if not self._forgiving:
            raise OutputError(getattr(error, "strerror", None) or str(error)) from error

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def guarded_streams() -> Iterator[None]:
    """Standard streams whose faults are known, without warnings of other packages, inside the block.

    Raises OutputError where something that was printed cannot be written.
    """
    _fill_descriptors()
    output, error = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _Stream(output), _Stream(error, forgiving=True)
    try:
        with warnings.catch_warnings():
            if not sys.warnoptions:  # users can enable them in Python
                warnings.simplefilter("ignore")
            yield
        sys.stdout.flush()
    except OutputError:
        _discard(output)
        raise
    finally:
        sys.stdout, sys.stderr = output, error


def _fill_descriptors() -> None:
    """Open the standard descriptors that are closed, or a file of results would take their place and be printed to."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def _discard(stream: TextIO | None) -> None:
    """Discard the rest of a stream, or Python would try again, and fail, when it ends."""
    try:
        if stream is not None:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    except (OSError, ValueError):  # a stream without a file, as in tests
        return
