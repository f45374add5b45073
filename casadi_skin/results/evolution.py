"""Tables of a time evolution: columns of dynamics.csv and variables of dynamics.nc."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass
