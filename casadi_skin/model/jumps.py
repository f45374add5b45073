"""Where equations jump: operations such as sign, comparisons and floor, in the expressions, tried along a path.

Along an orbit that crosses a place where f jumps, f- before it and f+ behind, a small difference of states is
multiplied by I + (f+ - f-) n / (n f-), n the normal of that place, in no time (Aizerman and Gantmacher 1958):
linearised equations alone miss it. Where the place is a time, n = 0, and nothing is missed.

An operation alone does not decide: |x|, max(x, 0) and x sign(x) are continuous. So a path is followed to two
neighbouring doubles between which the operation switches, and the right-hand sides there are compared with those
somewhat apart: the difference across a jump is as large, that across a kink far smaller, that across a pole far larger.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import or_
from typing import Any, ClassVar, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import cut
from casadi_skin.model.equations import Array, Equations
from casadi_skin.model.operations import operated, read
from casadi_skin.native.places import Buffers

Booleans: TypeAlias = NDArray[np.bool_]
Indices: TypeAlias = NDArray[np.int64]
Values: TypeAlias = Callable[[Array], Array]  # at places, one a row
TIME, STATE, PARAMETER, INPUT = 1, 2, 4, 8  # by what an operation switches, as bits
PATH_DIVISIONS = 50  # of a stretch of a path until its ends are neighbouring doubles
WITHIN_STRETCH = np.arange(1.0, 16.0)[:, None] / 16.0  # places at which it is divided: one call costs as much as many
TRIED_CROSSINGS = 64  # of one operation along a path that are tried
TRIED_TOGETHER = 64  # of all: a model with many operations has thousands
TIME_PLACES = 4001  # places of an interval of time at which operations are looked at
INTERVAL_END_RTOL = 1e-12  # of an interval of time: as near to its ends, or to another time, a switch is there
APART_FRACTION = 1e-6  # of a stretch: where right-hand sides are compared with those at neighbouring doubles
SIMILAR_JUMP_RATIOS = (
    0.3,
    3.0,
)  # ratio of the two differences across a jump; half is that of a value on it, as sign(0)
SMALLEST_JUMP = 1e-9  # of the largest rate of a state along the path; rounding of few operations is 1e-15
LONGEST_TEXT = 60
ACCEPTED_EQUATIONS = (
    "continuous equations (with kinks, as of fabs, fmax, or if_else of branches that agree) and jumps at fixed times; "
    "simulate takes all"
)

COMPARISON = "a comparison"
COMPARISONS = {"LT": "<", "LE": "<=", "EQ": "==", "NE": "!="}
OPERATION_NAMES = {
    **dict.fromkeys((*COMPARISONS, "NOT", "AND", "OR"), COMPARISON),
    "IF_ELSE_ZERO": "if_else", "SIGN": "sign", "FLOOR": "floor", "CEIL": "ceil", "FMOD": "fmod",
    "REMAINDER": "remainder", "COPYSIGN": "copysign",
}  # fmt: skip
JUMPING_CODES = {int(getattr(ca, f"OP_{code}")): code for code in OPERATION_NAMES}
SINGULAR_CODES = {
    int(getattr(ca, f"OP_{code}")): code for code in ("DIV", "INV", "FABS", "ATAN2", "TAN")
}  # as in x/|x|


class JumpError(ValueError):
    """The equations of a model jump along a solution: in one line the equation, the operation and what is accepted."""

    def __init__(self, model: Any, words: str) -> None:
        super().__init__(f"{model.name}: {words}; accepted: {model.jumps.accepted}")


@dataclass(frozen=True, eq=False)
class Switch:
    """An operation that switches, with its arguments, a value that is constant but where it does, and by what it does.

    `code` is CasADi's name, `by` are bits.
    """

    code: str
    arguments: tuple[ca.SX, ...]
    value: ca.SX
    by: int

    @property
    def name(self) -> str:
        """Its name for users."""
        return OPERATION_NAMES.get(self.code, self.code.lower())

    @property
    def text(self) -> str:
        """The operation as it is written in a message."""
        texts = [cut(str(entry), LONGEST_TEXT) for entry in self.arguments]
        if self.code in COMPARISONS:
            return f"{texts[0]} {COMPARISONS[self.code]} {texts[1]}"
        if self.code in ("DIV", "INV"):
            return f"the division by {texts[-1]}"
        if self.code in ("AND", "OR", "NOT", "IF_ELSE_ZERO"):
            return f"if_else of {texts[0]}"
        return f"{self.name}({', '.join(texts)})"


def switches(
    function: ca.Function, names: Sequence[Sequence[str]], source: Callable[[int, int], int]
) -> tuple[list[ca.SX], list[Switch]]:
    """The operations of a function that may jump, with the symbols of its arguments.

    Arguments:
        function: of columns; one that is a program has none that are seen.
        names: of the entries of each argument.
        source: the bit of an entry of an argument, 0 for one that never changes.
    """
    codes = JUMPING_CODES | SINGULAR_CODES
    if not any(_codes(part) & codes.keys() for part in (function, *function.find_functions())):
        return [], []
    try:
        scalar = function.expand()
    except RuntimeError:  # a program, whose operations nobody sees
        return [], []
    inputs = [ca.vertcat(ca.SX(0, 1), *map(ca.SX.sym, group)) for group in names]
    found: list[Switch] = []

    def apply(code: int, values: list[tuple[int, ca.SX]], _: bool) -> tuple[int, ca.SX]:
        bits, a = zip(*values, strict=True)
        result = operated(code, a)
        deciding = reduce(or_, _deciding(code, bits), 0)
        if code in codes and deciding:
            found.append(Switch(codes[code], a, _value(code, a, result), deciding))
        return reduce(or_, bits, 0), result

    places = [(i, entry) for i, group in enumerate(names) for entry in range(len(group))]
    program, numbers = read(scalar)
    program.evaluated(
        lambda k: (source(*places[k]), inputs[places[k][0]][places[k][1]]), [(0, ca.SX(c)) for c in numbers], apply
    )
    return (inputs, found) if found else ([], [])


def _codes(function: ca.Function) -> set[int]:
    """The operations of a function, without those of the functions that it calls; none of a program."""
    made_of_operations = function.is_a("SXFunction") or function.is_a("MXFunction")
    return {function.instruction_id(k) for k in range(function.n_instructions())} if made_of_operations else set()


def _deciding(code: int, given: Sequence[int]) -> Sequence[int]:
    """The bits of the arguments by which an operation switches."""
    if code == ca.OP_IF_ELSE_ZERO:
        return given[:1]
    return given[1:] if code in (ca.OP_COPYSIGN, ca.OP_DIV) else given


def _value(code: int, a: Sequence[ca.SX], result: ca.SX) -> ca.SX:
    """A value that is constant between the places where the operation jumps, and differs beyond each."""
    whole: dict[int, Callable[[], ca.SX]] = {
        ca.OP_IF_ELSE_ZERO: lambda: a[0] != 0,
        ca.OP_FMOD: lambda: ca.sign(a[0] / a[1]) * ca.floor(ca.fabs(a[0] / a[1])),
        ca.OP_REMAINDER: lambda: ca.floor(a[0] / a[1] + 0.5),
        ca.OP_COPYSIGN: lambda: a[1] >= 0,
        ca.OP_DIV: lambda: ca.sign(a[1]),
        ca.OP_INV: lambda: ca.sign(a[0]),
        ca.OP_FABS: lambda: ca.sign(a[0]),
        ca.OP_ATAN2: lambda: ca.logic_and(a[0] < 0, a[1] < 0),
        ca.OP_TAN: lambda: ca.floor(a[0] / np.pi + 0.5),
    }
    return whole[code]() if code in whole else result


# Jumps of a model -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Jumps:
    """The operations of a model's right-hand side that may jump."""

    model: Equations
    end_motion: ClassVar[bool] = False  # whether no simulation goes on beyond one

    @property
    def accepted(self) -> str:
        """What is accepted in place of equations that jump."""
        return ACCEPTED_EQUATIONS

    @cached_property
    def _found(self) -> tuple[list[ca.SX], list[Switch]]:
        names = ["t"], self.model.state_names, self.model.parameter_names
        return switches(self.model.vector_field, names, lambda argument, _: (TIME, STATE, PARAMETER)[argument])

    @property
    def found(self) -> list[Switch]:
        """The operations, in the order of their evaluation; most models have none."""
        return self._found[1]

    @property
    def by_name(self) -> bool:
        """Whether one of them is no division, fabs, atan2 or tan, which jump in some formulas only."""
        return any(switch.by & STATE and switch.name in OPERATION_NAMES.values() for switch in self.found)

    def times(self, start: float, end: float, parameters: Array) -> Array:
        """Fractions of an interval of time at which operations switch that no state decides, in ascending order."""
        tried = [switch for switch in self.found if switch.by & TIME and not switch.by & STATE]
        if not tried:
            return np.empty(0)
        value = self._values(tried)
        fractions = np.linspace(0.0, 1.0, TIME_PLACES)
        places = np.column_stack(
            [
                start + fractions * (end - start),
                np.zeros((TIME_PLACES, self.model.full_size)),
                np.tile(parameters, (TIME_PLACES, 1)),
            ]
        )
        k, entries = np.nonzero(np.diff(value(places), axis=0))
        if not k.size:
            return np.empty(0)
        after = _neighbours(value, entries, places[k], places[k + 1])[1]
        crossed = sorted(set(((after[:, 0] - start) / (end - start)).tolist()))
        inside = [fraction for fraction in crossed if INTERVAL_END_RTOL < fraction < 1.0 - INTERVAL_END_RTOL]
        return np.array([f for f, last in zip(inside, [0.0, *inside], strict=False) if f - last > INTERVAL_END_RTOL])

    def along(self, times: Array, states: Array, parameters: Array, by: int = STATE) -> str:
        """That the equations jump along a path, with the equation and the operation; empty where they do not.

        Arguments:
            times: shape (places,).
            states: of first order, at these times, shape (places, states).
            parameters: shape (parameters,), or one row a place, shape (places, parameters).
            by: bits, of which one at least decides the operations that are tried. Those that time alone decides are not
                among them: multipliers do not miss them.
        """
        tried = [switch for switch in self.found if switch.by & by]
        if not tried:
            return ""
        rows = np.broadcast_to(parameters, (len(times), np.shape(parameters)[-1]))
        places = np.column_stack([times, states, rows])
        key = by, places.tobytes()
        if key not in self._known:
            self._known.clear()
            self._known[key] = self._jump(places, tried)
        return self._known[key]

    def _jump(self, places: Array, tried: Sequence[Switch]) -> str:
        """The same between places (t, x, p), one a row, by the operations tried."""
        value, field = self._values(tried), self._field
        switched = np.diff(value(places), axis=0) != 0.0
        crossings = [(j, k) for j in range(len(tried)) for k in _some(np.flatnonzero(switched[:, j]))]
        if not crossings:
            return ""
        rates = np.abs(field(places))
        scale = np.max(np.where(np.isfinite(rates), rates, 0.0), axis=0, initial=0.0)
        for start in range(0, len(crossings), TRIED_TOGETHER):
            entries, k = np.array(crossings[start : start + TRIED_TOGETHER]).T
            ends = places[k], places[k + 1]
            jumps = _jumping(field, *ends, *_neighbours(value, entries, *ends), scale)
            first = int(np.argmax(np.any(jumps, axis=1)))
            if jumps[first].any():
                row, switch = int(np.argmax(jumps[first])), tried[entries[first]]
                return f"the equation of {self.model.state_names[row]} jumps, by {switch.text}"
        return ""

    def beside(self, state: Array, parameters: Array, distances: Array) -> str:
        """That the equations jump within distances of a state along each of its components, shapes (states,)."""
        moves = np.concatenate([[-d, d] for d in np.diag(distances)])
        return self.along(np.zeros(len(moves)), state + moves, parameters) if self.found else ""

    @cached_property
    def _field(self) -> Values:
        return _on_rows(self.model.vector_field, self.model.full_size)

    def _values(self, tried: Sequence[Switch]) -> Values:
        key = tuple(map(id, tried))
        if key not in self._functions:
            entries = ca.vertcat(*(switch.value for switch in tried))
            function = ca.Function("switches", self._found[0], [ca.densify(entries)])
            self._functions[key] = _on_rows(function, self.model.full_size)
        return self._functions[key]

    @cached_property
    def _known(self) -> dict[tuple[int, bytes], str]:
        """What was found along the last path: a point of a branch asks more than once."""
        return {}

    @cached_property
    def _functions(self) -> dict[tuple[int, ...], Values]:
        return {}


def _some(changes: Indices) -> Indices:
    """Crossings of one operation that are tried."""
    return changes[:: max(1, changes.size // TRIED_CROSSINGS)]


def _neighbours(value: Values, entries: Indices, before: Array, after: Array) -> tuple[Array, Array]:
    """Neighbouring doubles between two places at which an entry of a value differs, at which it differs as well.

    Of several stretches, one a row, with an entry each.
    """
    each, count = np.arange(len(entries)), len(WITHIN_STRETCH)
    first = value(before)[each, entries]
    for _ in range(PATH_DIVISIONS):
        inner = before[:, None] + WITHIN_STRETCH * (after - before)[:, None]
        if np.all((inner == before[:, None]) | (inner == after[:, None])):
            break
        values = value(inner.reshape(-1, before.shape[1])).reshape(len(entries), count, -1)
        same = values[each, :, entries] == first[:, None]
        passed = np.where(same.all(axis=1), count, np.argmin(same, axis=1))  # places before the first that differs
        ends = np.concatenate([before[:, None], inner, after[:, None]], axis=1)
        before, after = ends[each, passed], ends[each, passed + 1]
    return before, after


def _jumping(field: Values, start: Array, end: Array, before: Array, after: Array, scale: Array) -> Booleans:
    """Whether each row of the field jumps between two neighbours on stretches, shape (stretches, rows)."""
    way = APART_FRACTION * (end - start)
    values = field(np.concatenate([before, after, before - way, after + way])).reshape(4, len(start), -1)
    near, apart = np.abs(values[1] - values[0]), np.abs(values[3] - values[2])
    low, high = SIMILAR_JUMP_RATIOS
    with np.errstate(invalid="ignore"):
        return np.asarray((near > SMALLEST_JUMP * scale) & (near > low * apart) & (near < high * apart))


def _on_rows(function: ca.Function, states: int) -> Values:
    """A function (t, x, p) with one dense result at places (t, x, p), one a row."""
    known = dict[int, Buffers]()  # by the number of places

    def values(places: Array) -> Array:
        count = len(places)
        if count not in known:
            known[count] = Buffers(function, count)
        (found,) = known[count](*np.split(places, [1, 1 + states], axis=1))
        return found.reshape(count, -1).copy()

    return values
