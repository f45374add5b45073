"""Imports of the program without parts that no command uses: a third of scipy's time, a quarter of matplotlib's.

The program alone does this, in a process of its own; where the package is imported, others stay as they are.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any


@contextmanager
def _without(name: str) -> Iterator[None]:
    """A module is missing, which others do without; it may be imported afterwards."""
    if name in sys.modules:
        yield
        return
    import warnings

    sys.modules[name] = None  # type: ignore[assignment]  # so Python's documentation has it
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        del sys.modules[name]


@contextmanager
def _without_tables() -> Iterator[None]:
    """No tables of properties in the docstrings of matplotlib: they took a quarter of its import."""
    from matplotlib import artist

    table = artist.kwdoc
    artist.kwdoc = lambda artist: ""
    try:
        yield
    finally:
        artist.kwdoc = table


LATER = {  # executed at their first use: others import them, and do not use them
    *("numpy.ctypeslib", "numpy.f2py", "numpy.testing", "pydoc"),  # scipy
    *("PIL.ExifTags", "fontTools.agl"),  # matplotlib
}
WITHIN: dict[str, Callable[[], AbstractContextManager[None]]] = {  # executed so that they leave out a part
    "matplotlib.figure": _without_tables,
    "matplotlib.projections": partial(_without, "mpl_toolkits.mplot3d"),
    "msgspec._utils": partial(_without, "typing_extensions"),
}


class LeanImports:
    """A finder of the modules above; all others are left to the finders after it."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The specification of a module that is imported in another way; None for most."""
        if name not in LATER and name not in WITHIN:
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            from importlib.util import LazyLoader  # here: --help does not need it

            loader: Any = LazyLoader(spec.loader) if name in LATER else _Within(spec.loader, WITHIN[name])
            spec.loader = loader
        return spec


class _Within:
    """A loader that executes a module within a context."""

    def __init__(self, loader: Any, context: Callable[[], AbstractContextManager[None]]) -> None:
        self.create_module, self._execute, self._context = loader.create_module, loader.exec_module, context

    def exec_module(self, module: ModuleType) -> None:
        """Execute the module."""
        with self._context():
            self._execute(module)


def install() -> None:
    """Import so from now on; at the beginning of the program."""
    sys.meta_path.insert(0, LeanImports())
