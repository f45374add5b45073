"""What tests of compiled kernels share: they are left out, or numpy takes their place for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from casadi_skin import native
from casadi_skin.zero import cosines

needs_kernels = pytest.mark.skipif(not native.kernels(), reason="the package was built without a C compiler")


@contextmanager
def numpy_alone(library: Path = Path("none")) -> Iterator[None]:
    """As in a package that was built without a C compiler, or with a library that cannot be loaded."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native, "LIBRARY", library)
        forget()
        yield
    forget()


def forget() -> None:
    """The kernels, and programs that hold them."""
    for kept in (native.kernels, cosines._equations_of):
        kept.cache_clear()
