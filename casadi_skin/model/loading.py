"""A model from a file that a user wrote: an error in a Python file is reported in one line with its place."""

from __future__ import annotations

import inspect
import io
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from casadi_skin.model.arguments import accepted_names, cut

LARGEST_FILE_BYTES = 1 << 25  # bytes of a file
LONGEST_MESSAGE = 200  # characters of an exception that a message shows
USER_MODULE_NAME = "casadi_skin_user_model"


class ModelFileError(ValueError):
    """A file does not give the requested model, in one line."""


def read_source(path: Path) -> str:
    """The text of a file of a model, its ends of lines as Python has them; raises ModelFileError as `read_text`."""
    return io.StringIO(read_text(path), newline=None).read()


def read_text(path: Path, kind: str = "a text file", encoding: str = "utf-8") -> str:
    """The text of a file; raises ModelFileError where there is none, or more than a user writes."""
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # a pipe or a device may never end
            raise ModelFileError(f"{path}: no regular file; accepted: {kind} in UTF-8")
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE_BYTES + 1)
        if len(data) > LARGEST_FILE_BYTES:
            raise ModelFileError(f"{path}: longer than {LARGEST_FILE_BYTES} bytes; accepted: {kind} up to that")
        return data.decode(encoding)
    except ModelFileError:
        raise
    except UnicodeDecodeError as error:
        raise ModelFileError(f"{path}: not UTF-8 at byte {error.start}; accepted: {kind} in UTF-8") from None
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise ModelFileError(f"{path}: cannot be read: {reason}; accepted: {kind} that can be") from None


def run_file(path: Path, source: str) -> dict[str, Any]:
    """Run Python source that was read from `path` and return the names that it defines.

    As with `python FILE`, modules beside the file can be imported. Raises ModelFileError with file, line and exception
    where the code fails.
    """
    module = ModuleType(USER_MODULE_NAME)
    module.__file__ = str(path)
    sys.modules[USER_MODULE_NAME] = module  # dataclasses and pickles look their module up
    with _told_in_one_line(path), _importing_beside(path):
        exec(compile(source, str(path), "exec"), module.__dict__)
    return module.__dict__


def named(path: Path, names: Mapping[str, Any], name: str, kinds: tuple[type, ...]) -> Any:
    """Object of a name in a file that was run: one of the kinds, or the result of a function.

    Raises ModelFileError for a name that is not there, with the nearest one, and for one of another kind.
    """
    accepted = " or ".join(f"{_article(kind.__name__)} {kind.__name__}" for kind in kinds)
    if name not in names:
        known = [key for key, value in names.items() if _may_give(value, kinds)]
        hint = accepted_names(name, known) if known else f"accepted: {accepted} by name"
        raise ModelFileError(f"{path}: defines no {name}; {hint}")
    found = names[name]
    if not isinstance(found, kinds) and callable(found) and not isinstance(found, type):
        found = call(path, name, found)
    if not isinstance(found, kinds):
        given = f"{_article(type(found).__name__)} {type(found).__name__}"
        raise ModelFileError(f"{path}: {name} gives {given}; accepted: {accepted}, or a function that returns one")
    return found


def call(path: Path, name: str, function: Any, *arguments: Any) -> Any:
    """Result of a function from a file; raises ModelFileError where it takes other arguments or fails."""
    try:
        inspect.signature(function).bind(*arguments)
    except (TypeError, ValueError) as error:
        count = f"{len(arguments)} argument{'' if len(arguments) == 1 else 's'}"
        raise ModelFileError(f"{path}: {name} cannot be called with {count}: {error}") from None
    with _told_in_one_line(path), _importing_beside(path):
        return function(*arguments)


def _may_give(value: Any, kinds: tuple[type, ...]) -> bool:
    return isinstance(value, kinds) or (inspect.isfunction(value) and value.__module__ == USER_MODULE_NAME)


def _article(word: str) -> str:
    return "an" if word[0] in "AEIOUaeio" else "a"


@contextmanager
def _importing_beside(path: Path) -> Iterator[None]:
    folder = str(path.resolve().parent)
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        if folder in sys.path:
            sys.path.remove(folder)


@contextmanager
def _told_in_one_line(path: Path) -> Iterator[None]:
    """Turn any exception of the user's code into one that names file, line and exception."""
    try:
        yield
    except SyntaxError as error:
        where = f"{error.filename or path}, line {error.lineno or 1}"
        raise ModelFileError(f"{where}: {type(error).__name__}: {_one_line(error.msg)}") from None
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)
        mine = [frame for frame in frames if frame.filename == str(path)]
        where = f"{path}, line {mine[-1].lineno}" if mine else str(path)
        words = _one_line(str(error))
        raise ModelFileError(f"{where}: {type(error).__name__}{f': {words}' if words else ''}") from None


def _one_line(text: str) -> str:
    return cut(" ".join(text.split()), LONGEST_MESSAGE)
