"""Arguments of a search, checked before anything is solved: free names, bounds, conditions, and its starts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.model.arguments import accepted_names, pair, short_repr, whole

START_RANGE_MARGIN = 0.02  # of a range, which starts keep from its ends
CONDITION_WORDS = "what is to vanish, or (quantity, lower, upper); a quantity is a name or {}"


@dataclass(frozen=True)
class Condition:
    """lower <= quantity <= upper; an equality where the two are equal."""

    quantity: Any
    lower: float
    upper: float
    name: str

    @property
    def equality(self) -> bool:
        """Whether the two bounds are equal."""
        return self.lower == self.upper


def free_names(free: Sequence[str] | str, known: Iterable[str], label: str = "free") -> tuple[str, ...]:
    """The names of free numbers; raises ValueError for unknown names, for none, and for one that comes twice."""
    accepted = tuple(known)
    if not isinstance(free, str | list | tuple):
        raise TypeError(f"{label}: given {short_repr(free)}; accepted: a list of {', '.join(accepted)}")
    names = (free,) if isinstance(free, str) else tuple(free)
    for name in names:
        if not isinstance(name, str) or name not in accepted:
            raise ValueError(f"{label}: given {short_repr(name)}; {accepted_names(name, accepted)}")
    if not names or len(set(names)) < len(names):
        given = short_repr(list(names)) if names else "none"
        raise ValueError(f"{label}: given {given}; accepted: one or more of {', '.join(accepted)}, each once")
    return names


def checked_bounds(
    bounds: Mapping[str, object] | None, free: Mapping[str, tuple[float, float]], fixed: Iterable[str],
    quantities: Iterable[str],
) -> tuple[dict[str, tuple[float, float]], tuple[Condition, ...]]:  # fmt: skip
    """Limits of the free numbers, and conditions from the bounds on quantities.

    Arguments:
        bounds: pairs by name.
        free: default ranges of the free numbers.
        fixed: parameters that are not free: they take no bounds.
        quantities: other names that may have bounds.

    Raises:
        ValueError, TypeError: names and pairs that cannot be used.
    """
    if not isinstance(bounds, Mapping | None):
        raise TypeError(f"bounds: given {short_repr(bounds)}; accepted: a mapping of names to pairs (lower, upper)")
    limits, conditions, held = dict(free), list[Condition](), tuple(fixed)
    known = tuple(dict.fromkeys((*free, *held, *quantities)))
    for name, given in (bounds or {}).items():
        place = f"bounds[{name}]"
        if not isinstance(name, str) or name not in known:
            raise ValueError(f"bounds: given {short_repr(name)}; {accepted_names(name, known)}")
        lower, upper = pair(place, given)
        if name in free:
            if lower == upper:
                raise ValueError(f"{place}: given {short_repr(given)}; accepted: different bounds, or {name} not free")
            least, most = free[name]
            limits[name] = (lower if lower > -math.inf else least, upper if upper < math.inf else most)
        elif name in held:
            accepted = f"{', '.join(free)}, or quantities of the orbit"
            raise ValueError(f"{place}: given a bound on {name}, which is not free; accepted: {accepted}")
        else:
            conditions.append(Condition(name, lower, upper, name))
    return limits, tuple(conditions)


def checked_conditions(
    constraints: Sequence[object], kinds: tuple[Any, ...], what: str, label: str = "constraints"
) -> tuple[Condition, ...]:
    """Conditions from a list of items, each a quantity that has to vanish or one with its bounds.

    A quantity is a name or of one of `kinds`, which error messages call `what`.
    """
    accepted = CONDITION_WORDS.format(what)
    if not isinstance(constraints, list | tuple):
        raise TypeError(f"{label}: given {short_repr(constraints)}; accepted: a list of items, each {accepted}")
    found = []
    for item, given in enumerate(constraints, start=1):
        place, (quantity, lower, upper) = f"{label}, item {item}", (given, 0.0, 0.0)
        if not isinstance(given, kinds):
            if not isinstance(given, tuple | list) or len(given) != 3:
                raise TypeError(f"{place}: given {short_repr(given)}; accepted: {accepted}")
            quantity, (lower, upper) = given[0], pair(place, given[1:])
        if not isinstance(quantity, (str, *kinds)):
            raise TypeError(f"{place}: given {short_repr(quantity)}; accepted: {accepted}")
        name = quantity if isinstance(quantity, str) else getattr(quantity, "__name__", "<lambda>")
        found.append(Condition(quantity, lower, upper, name if name != "<lambda>" else f"constraint {item}"))
    return tuple(found)


def sampled_starts(
    values: Sequence[float], limits: Sequence[tuple[float, float]], count: int, seed: int
) -> list[tuple[float, ...]]:
    """Free numbers of starts: the own values first, then a Halton sequence (Halton 1960; Owen 2017) in the limits.

    Where a limit is missing the range is from half to twice the own value; of a 0 as wide as the other limit is large,
    and without limits, where nothing says what is small, all starts have the 0. All are moved within their ranges,
    which end a little inside of the limits. Raises ValueError and TypeError for a count or a seed that is none.
    """
    whole("starts", count, 1)
    whole("seed", seed, 0)
    ranges = []
    for value, (low, high) in zip(values, limits, strict=True):
        size = max((abs(end) for end in (low, high) if np.isfinite(end)), default=0.0)
        span = sorted((0.5 * value, 2.0 * value)) if value else [-size, size]
        width = span[1] - span[0]
        least = low if np.isfinite(low) and np.isfinite(high) else max(low, min(span[0], high - width))
        most = high if np.isfinite(high) else max(span[1], least + width)
        inside = START_RANGE_MARGIN * (most - least)
        ranges.append((least + inside, most - inside))
    lows, highs = np.array(ranges).T
    rows = [np.clip(values, lows, highs)]
    if count > 1:
        from scipy.stats import qmc

        drawn = qmc.Halton(len(ranges), scramble=True, seed=np.random.default_rng(seed)).random(count - 1)
        rows += [*(lows + drawn * (highs - lows))]
    return [tuple(row.tolist()) for row in rows]
