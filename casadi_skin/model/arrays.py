"""Checks of arguments that are arrays of numbers, as in `arguments`."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import short_repr


def real_array(name: str, value: Any, accepted: str = "finite numbers") -> NDArray[np.float64]:
    """The value as an array of floats; raises TypeError where it is none, ValueError where a number is not finite.

    A matrix of CasADi's numbers (DM) is an array, and one of one column a vector.
    """
    full = value
    try:
        if isinstance(value, np.ndarray):
            found = value
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # of CasADi, where numpy meets expressions
                full = value.full() if type(value).__name__ == "DM" else value
                found = np.asarray(full)
    except Exception:  # of the object's own conversion to numbers
        raise TypeError(_refused(name, value, accepted)) from None
    if found.dtype.kind not in "iuf" and found.size:  # text, truths, complex numbers and objects are none
        raise TypeError(_refused(name, value, accepted))
    found = found.astype(float)
    if not np.all(np.isfinite(found)):
        raise ValueError(_refused(name, value, accepted))
    return found.ravel() if full is not value and found.ndim == 2 and found.shape[1] == 1 else found


def _refused(name: str, value: Any, accepted: str) -> str:
    return f"{name}: given {short_repr(value)}; accepted: {accepted}"


def instants(t: Any) -> NDArray[np.float64]:
    """Times as an array of one dimension; raises TypeError and ValueError for values that are not numbers."""
    found = np.atleast_1d(real_array("t", t, "numbers"))
    if found.ndim != 1:
        raise ValueError(f"t: given shape {found.shape}; accepted: numbers, shape (times,)")
    return found


def at_instants(t: Any, states: NDArray[np.float64]) -> NDArray[np.float64]:
    """States of the instants of t, one row each: of a single number its row alone, as functions of scipy have it."""
    return np.asarray(states[0] if real_array("t", t, "numbers").ndim == 0 else states)


def site_numbers(value: Any) -> NDArray[np.int64] | None:
    """Numbers of sites or components, shape (sites,); None for all. Raises TypeError, ValueError for other values."""
    if value is None:
        return None
    accepted = "whole numbers, each that of a site"
    found = np.atleast_1d(real_array("sites", value, accepted))
    if found.ndim != 1 or not np.all((found == np.round(found)) & (np.abs(found) < 2.0**53)):
        raise ValueError(f"sites: given {short_repr(value)}; accepted: {accepted}")
    return found.astype(np.int64)
