"""What is asked of a search, checked before anything is solved; frozen and picklable, for processes to share."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import casadi as ca

from casadi_skin.arguments import number, numbers, short_repr
from casadi_skin.lattice.chain import Chain
from casadi_skin.models.expressions import is_comparison
from casadi_skin.optimise.names import FREE, NAMED, SHARED, nearest_name
from casadi_skin.optimise.observables import ChainSymbols, Observables

Quantity = str | Callable[..., Any]  # a name of NAMED, or a function of Observables (of several: a tuple of them)

STEEPEST = 0.99  # |gamma| where no bound is given: beyond it the band is nearly a point
FAINTEST = 1e-6  # S where no lower bound is given


@dataclass(frozen=True)
class Condition:
    """lower <= quantity <= upper; an equality where the two are equal."""

    quantity: Quantity
    lower: float
    upper: float
    name: str

    @property
    def equality(self) -> bool:
        """Whether the two bounds are equal."""
        return self.lower == self.upper


@dataclass(frozen=True)
class SearchRequest:
    """A search among the orbits of one mode: what is free within which bounds, what is optimised, what must hold.

    `amplitudes` are the S of the orbits, which share the parameters of the chain; `several` tells that S was given as a
    list. Where "S" is free it is that of the first start. Raises ValueError or TypeError naming the argument, what was
    given and what is accepted.
    """

    chain: Chain
    mode: int
    amplitudes: tuple[float, ...]
    several: bool
    objective: Quantity
    maximise: bool
    free: tuple[str, ...]
    bounds: tuple[tuple[float, float], ...]
    conditions: tuple[Condition, ...]
    tolerance: float = 1e-8

    @property
    def free_count(self) -> int:
        """Number of free numbers."""
        return sum(self.chain.sites if name == "alpha_n" else 1 for name in self.free)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free numbers, one each."""
        sites = range(1, self.chain.sites + 1)
        each = {"alpha_n": tuple(f"alpha_{n}" for n in sites)}
        return tuple(one for name in self.free for one in each.get(name, (name,)))

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Bounds of the free numbers, one pair each."""
        pairs = zip(self.free, self.bounds, strict=True)
        return tuple(pair for name, pair in pairs for _ in range(self.chain.sites if name == "alpha_n" else 1))

    @property
    def mirrored(self) -> bool:
        """Whether the modes lean to the first site."""
        if "gamma" in self.free:
            return self.bounds[self.free.index("gamma")][1] <= 0
        return self.chain.gamma < 0

    def symbols(self, harmonics: int) -> tuple[ca.SX, tuple[Observables, ...]]:
        """The free numbers as symbols, shape (free_count, 1), and the orbits made of them."""
        chain, symbols = self.chain, {}
        for name in self.free:
            symbols[name] = ca.SX.sym(name, chain.sites if name == "alpha_n" else 1)
        alpha = symbols.get("alpha_n", ca.repmat(symbols.get("alpha", ca.SX(chain.alpha)), chain.sites, 1))
        gamma, g = symbols.get("gamma", ca.SX(chain.gamma)), symbols.get("g", ca.SX(chain.g))
        made = ChainSymbols(chain.sites, gamma, alpha, g, self.mirrored)
        orbits = tuple(Observables(made, harmonics) for _ in self.amplitudes)
        if "S" in symbols:
            symbols["S"] = orbits[0].S
        return ca.vertcat(*(symbols[name] for name in self.free)), orbits

    def evaluated(self, quantity: Quantity, orbits: tuple[Observables, ...]) -> Any:
        """A quantity of these orbits."""
        if isinstance(quantity, str):
            return orbits[0].value(quantity)
        return quantity(orbits if self.several else orbits[0])


def search_request(
    chain: object,
    mode: int | str | None,
    S: object,
    objective: Quantity,
    maximise: bool,
    free: Sequence[str],
    bounds: Mapping[str, Sequence[float]],
    constraints: Sequence[object],
    tolerance: float,
) -> SearchRequest:
    """The request made of the arguments of `search_chain`, which see; raises ValueError or TypeError."""
    if not isinstance(chain, Chain):
        raise TypeError(f"chain: given {short_repr(chain)}; accepted: a Chain")
    if chain.infinite:
        raise ValueError("chain: given an infinite chain; accepted: a whole number of sites")
    several = not (isinstance(S, int | float) or hasattr(S, "__float__"))
    amplitudes = numbers("S", S) if several else (number("S", S, "a finite number > 0"),)
    if not amplitudes or min(amplitudes) <= 0:
        raise ValueError(f"S: given {short_repr(S)}; accepted: a finite number > 0, or a list of such numbers")
    names = _free_names(chain, free, several)
    limits, more = _limits(chain, names, bounds)
    _check_gamma(chain, names, limits)
    if not 1e-12 <= number("tolerance", tolerance) <= 1e-2:
        raise ValueError(f"tolerance: given {tolerance!r}; accepted: 1e-12 to 1e-2")
    if chain.g == 0:
        raise ValueError("g: given 0; accepted: not 0 (every orbit would be a linear mode)")
    hardening = chain.g > 0
    asked = chain.mode_number(mode if mode is not None else "last" if hardening else "first")
    conditions = (*_conditions(constraints), *more)
    request = SearchRequest(
        chain, asked, amplitudes, several, objective, bool(maximise), names, limits, conditions, float(tolerance)
    )
    _check_expressions(request)
    return request


def _free_names(chain: Chain, free: Sequence[str], several: bool) -> tuple[str, ...]:
    if isinstance(free, str):
        free = (free,)
    for name in free:
        if name not in FREE:
            raise ValueError(f"free: given {short_repr(name)}; {nearest_name(str(name), FREE)}")
    names = tuple(free)
    if not names or len(set(names)) < len(names):
        raise ValueError(
            f"free: given {short_repr(list(names))}; accepted: one or more of {', '.join(FREE)}, each once"
        )
    if "alpha" in names and "alpha_n" in names:
        raise ValueError("free: given alpha and alpha_n; accepted: one of them")
    if several and "S" in names:
        raise ValueError("free: given S with a list of S; accepted: S free with one number as its start")
    return names


def _pair(place: str, given: object) -> tuple[float, float]:
    accepted = "a pair (lower, upper) of numbers, None where there is no bound"
    try:
        pair = tuple(cast(Iterable[object], given))
    except TypeError:
        pair = ()
    if len(pair) != 2 or isinstance(given, str):
        raise TypeError(f"{place}: given {short_repr(given)}; accepted: {accepted}")
    ends = []
    for value, absent in zip(pair, (-math.inf, math.inf), strict=True):
        infinite = value is None or (isinstance(value, float) and value == absent)
        ends.append(absent if infinite else number(place, value, accepted))
    if ends[0] > ends[1]:
        raise ValueError(f"{place}: given {short_repr(given)}; accepted: a lower bound <= the upper one")
    return ends[0], ends[1]


def _limits(
    chain: Chain, names: tuple[str, ...], bounds: Mapping[str, Sequence[float]]
) -> tuple[tuple[tuple[float, float], ...], tuple[Condition, ...]]:
    """Bounds of the free names, and conditions made of the bounds on other quantities."""
    if not isinstance(bounds, Mapping):
        raise TypeError(f"bounds: given {short_repr(bounds)}; accepted: a mapping of names to pairs (lower, upper)")
    side = 1.0 if chain.gamma >= 0 else -1.0
    ends = sorted((0.0, side * STEEPEST))
    natural = {"gamma": (ends[0], ends[1]), "S": (FAINTEST, math.inf)}
    natural["g"] = (0.0, math.inf) if chain.g > 0 else (-math.inf, 0.0)
    more, limits = [], {name: natural.get(name, (-math.inf, math.inf)) for name in names}
    for name, given in bounds.items():
        place = f"bounds[{name}]"
        known = {**FREE, **NAMED}
        if name not in known:
            raise ValueError(f"bounds: given {short_repr(name)}; {nearest_name(str(name), tuple(known))}")
        lower, upper = _pair(place, given)
        if name in names:
            if lower == upper:
                raise ValueError(f"{place}: given {short_repr(given)}; accepted: different bounds, or {name} not free")
            least, most = natural.get(name, (-math.inf, math.inf))
            low, high = (lower if lower > -math.inf else least), (upper if upper < math.inf else most)
            if name in ("S", "g") and (low < least or high > most):
                least = 0.0 if name == "S" else least
                if low < least or high > most or high <= 0 < most:
                    raise ValueError(
                        f"{place}: given {short_repr(given)}; accepted: bounds within {least:g} to {most:g}"
                    )
            limits[name] = (max(low, FAINTEST) if name == "S" else low, high)
        elif name in FREE and name != "alpha_n":
            raise ValueError(f"{place}: given a bound on {name}, which is not free; accepted: {', '.join(names)}, "
                             "or quantities of the orbit")  # fmt: skip
        elif name == "alpha_n":
            raise ValueError(f"{place}: given a bound on alpha_n, which is not free; accepted: {', '.join(names)}")
        else:
            more.append(Condition(name, lower, upper, name))
    return tuple(limits[name] for name in names), tuple(more)


def _check_gamma(chain: Chain, names: tuple[str, ...], limits: tuple[tuple[float, float], ...]) -> None:
    lower, upper = limits[names.index("gamma")] if "gamma" in names else (chain.gamma, chain.gamma)
    if max(abs(lower), abs(upper)) >= 1:
        raise ValueError(f"gamma: given {short_repr([lower, upper])}; accepted in a search: |gamma| < 1")
    if lower < 0 < upper:
        reason = "a chain mirrored has -gamma, and its gauge is another"
        raise ValueError(
            f"bounds[gamma]: given {short_repr([lower, upper])}; accepted: bounds on one side of 0 ({reason})"
        )


def _conditions(constraints: Sequence[object]) -> tuple[Condition, ...]:
    accepted = "a function, which is to vanish, or (name or function, lower, upper)"
    if callable(constraints) or isinstance(constraints, str | Mapping):
        raise TypeError(f"constraints: given {short_repr(constraints)}; accepted: a list of items, each {accepted}")
    found = []
    for item, given in enumerate(constraints, start=1):
        place = f"constraints, item {item}"
        if callable(given):
            quantity: Any = given
            lower = upper = 0.0
        else:
            if not isinstance(given, tuple | list) or len(given) != 3:
                raise TypeError(f"{place}: given {short_repr(given)}; accepted: {accepted}")
            quantity = given[0]
            lower, upper = _pair(place, given[1:])
        if not (callable(quantity) or isinstance(quantity, str)):
            raise TypeError(f"{place}: given {short_repr(quantity)}; accepted: {accepted}")
        name = quantity if isinstance(quantity, str) else getattr(quantity, "__name__", "")
        found.append(Condition(quantity, lower, upper, name if name and name != "<lambda>" else f"constraint {item}"))
    return tuple(found)


def _check_expressions(request: SearchRequest) -> None:
    """Make every expression once, on two harmonics: names, kinds and shapes are refused here, before any solve."""
    _, orbits = request.symbols(harmonics=2)
    objective = _expression("objective", request, request.objective, orbits)
    if objective.is_constant():
        raise ValueError(f"objective: given the constant {objective}; accepted: a quantity of the orbit")
    if objective.shape != (1, 1):
        raise ValueError(f"objective: given an expression of shape {objective.shape}; accepted: a scalar")
    equalities = 0
    for condition in request.conditions:
        rows = _expression(f"constraints, {condition.name}", request, condition.quantity, orbits)
        equalities += rows.numel() if condition.equality else 0
    if equalities > request.free_count:
        words = f"given {equalities} equalities with {request.free_count} free ({', '.join(request.free)})"
        raise ValueError(f"constraints: {words}; accepted: no more equalities than free numbers")


def _expression(place: str, request: SearchRequest, quantity: Quantity, orbits: tuple[Observables, ...]) -> ca.SX:
    if isinstance(quantity, str):
        if quantity not in NAMED:
            raise ValueError(f"{place}: given {short_repr(quantity)}; {nearest_name(quantity, NAMED)}")
        if request.several and quantity not in SHARED:
            raise ValueError(
                f"{place}: given {short_repr(quantity)} with a list of S; accepted: a function of the orbits"
            )
    elif not callable(quantity):
        raise TypeError(f"{place}: given {short_repr(quantity)}; accepted: a name or a function of the observables")
    try:
        made = request.evaluated(quantity, orbits)
    except AttributeError as error:
        words = str(error).removeprefix("observable: ")
        raise ValueError(f"{place}: {words}") from None
    except (TypeError, ValueError, NotImplementedError, RuntimeError, IndexError) as error:
        words = " ".join(str(error).split())[:200]
        raise TypeError(f"{place}: the function given fails: {words}") from None
    if isinstance(made, bool) or not isinstance(made, int | float | ca.SX | ca.DM):
        raise TypeError(f"{place}: given a function that returns {short_repr(made)}; accepted: a CasADi expression")
    expression = ca.SX(made)
    if is_comparison(expression):
        raise ValueError(f"{place}: given a comparison, {short_repr(made)}; accepted: a difference, x - 1 for x == 1")
    if not (expression.is_column() and expression.numel() > 0):
        raise ValueError(f"{place}: given an expression of shape {expression.shape}; accepted: a scalar or a column")
    return expression
