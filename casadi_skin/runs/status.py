"""Exit status of commands, and wrong input."""

from __future__ import annotations

DONE, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130


class InputError(ValueError):
    """Something the user gave is wrong; the message is one line."""
