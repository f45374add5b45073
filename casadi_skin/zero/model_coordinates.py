"""Families of any model of second order that rests at 0: its linear modes and the coordinates of their families.

Positions are scaled so that couplings are symmetric, where there is such a scale. Linear spectra are those of chains,
lattices and models alike.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.amplitude import amplitude_square
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.jumps import JumpError
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import NotPolynomialError, homogeneous_parts
from casadi_skin.model.result import in_turn
from casadi_skin.zero.coordinates import Coordinates
from casadi_skin.zero.family import Method
from casadi_skin.zero.problem import EPSILON, Array, Buffers
from casadi_skin.zero.statement import named_values

SYMMETRY_RTOL = 1e-12  # relative difference of entries that are the same but for rounding
REST_FORCE_RTOL = 1e-12  # force at 0 of a model that rests there, relative to its stiffness
NODE_AMPLITUDE_RTOL = 1e-12  # of the largest amplitude: rounding at sites where a mode rests
SMALL_MODE_AMPLITUDE = 1e-7  # of the largest amplitude of a mode: below it rounding would show where displacements lean


@dataclass(frozen=True)
class LinearModes:
    """Modes of q'' = -K q with y = D q: squares of frequencies ascending, and modes as columns in q.

    `left` holds the left eigenvectors as rows, the modes themselves where K is symmetric. `log_scale` is log D, and
    `stiffness` is K in q, exactly symmetric where it can be made so.
    """

    squares: Array
    modes: Array
    left: Array
    log_scale: Array
    stiffness: Array
    symmetric: bool


def linear_modes(force: ca.SX, state: ca.SX, name: str) -> LinearModes:
    """Modes of the linearised equations about rest, in coordinates that make them symmetric where there are such.

    Arguments:
        force: accelerations, a column of expressions in `state` alone.
        state: positions.
        name: the model's, for messages.

    Returns:
        Modes in ascending order of their squared frequencies.

    Raises:
        ValueError: the model does not rest at 0, is not finite or smooth there, or a frequency is complex.
    """
    K, at_rest = _at_rest(force, state, name)
    if np.max(np.abs(at_rest)) > REST_FORCE_RTOL * max(1.0, float(np.max(np.abs(K)))):
        raise ValueError(f"{name}: its families grow from rest at 0; accepted: forces that are finite and vanish there")
    found = eigenmodes(K, scale_of_couplings(K, force, state))
    if found.symmetric:
        return found
    values, modes = found.squares, found.modes.real
    if np.max(np.abs(values.imag)) > np.sqrt(SYMMETRY_RTOL) * np.max(np.abs(values)):
        worst = values[np.argmax(np.abs(values.imag))]
        raise ValueError(f"{name}: omega^2 = {worst:.6g} of a linear mode is complex; accepted: real ones")
    left = np.asarray(np.linalg.inv(modes), dtype=np.float64)
    return replace(found, squares=values.real, modes=modes, left=left)


def eigenmodes(K: Array, log_scale: Array | None) -> LinearModes:
    """Modes of a matrix, in the scale that makes it symmetric; without one they may be complex."""
    if log_scale is not None:
        scale = np.exp(log_scale)
        K = K / scale[:, None] * scale
        K = 0.5 * (K + K.T)
        squares, modes = np.linalg.eigh(K)
        return LinearModes(squares, modes, modes.T, log_scale, K, True)
    from scipy.linalg import eig

    squares, modes = eig(K)
    order = np.lexsort((squares.imag, squares.real))
    modes = modes[:, order]
    return LinearModes(squares[order], modes, np.linalg.inv(modes), np.zeros(len(K)), K, False)


def _at_rest(force: ca.SX, state: ca.SX, name: str) -> tuple[Array, Array]:
    """Stiffness and force at 0; raises ValueError, naming the force, where one of them is not finite.

    They are computed in numbers, as a family computes them: an expression simplifies 0 * inf and 0 / 0 away.
    """
    columns = [ca.densify(force), ca.densify(ca.jacobian(force, state))]
    at_rest, slopes = (np.array(v) for v in ca.Function("rest", [state], columns)(ca.DM.zeros(state.numel())))
    if np.all(np.isfinite(at_rest)) and np.all(np.isfinite(slopes)):
        return -slopes, at_rest
    bad = int(np.argmax(~np.isfinite(np.hstack([at_rest, slopes])).all(axis=1)))
    place = f"{name}: the force on {state[bad].name()}"
    if not np.isfinite(at_rest[bad, 0]):
        raise ValueError(f"{place} is not finite at rest; accepted: forces that are finite and vanish there")
    by = state[int(np.argmax(~np.isfinite(slopes[bad])))].name()
    accepted = "families grow from rest; accepted: forces with finite derivatives there"
    raise ValueError(f"{place} is not smooth at rest: its derivative by {by} is not finite; {accepted}")


def with_small_amplitudes(mode: Array, stiffness: Array, square: float) -> Array:
    """A mode whose amplitudes below SMALL of the largest are right relative to themselves, from those above."""
    small = np.abs(mode) < SMALL_MODE_AMPLITUDE * np.max(np.abs(mode))
    if not small.any():
        return mode
    from scipy.linalg import solve
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    found, indices = mode.copy(), np.flatnonzero(small)
    inside = stiffness[np.ix_(small, small)] - square * np.eye(indices.size)
    count, part = connected_components(csr_array(inside))
    for k in range(count):
        here = part == k
        block = inside[np.ix_(here, here)]
        if np.min(np.abs(np.linalg.eigvalsh(block))) > SMALL_MODE_AMPLITUDE * np.max(np.abs(stiffness)):
            found[indices[here]] = solve(block, -stiffness[indices[here]][:, ~small] @ mode[~small])
        elif np.max(np.abs(mode[indices[here]])) < NODE_AMPLITUDE_RTOL * np.max(
            np.abs(mode)
        ):  # sites of a node, which rest
            found[indices[here]] = 0.0
    return found


def scale_of_couplings(K: Array, force: ca.SX, state: ca.SX) -> Array | None:
    """The scale that makes the stiffness K at rest symmetric, and the couplings that there are none of at rest too.

    Couplings without a linear part show at a random state; where no scale serves both, that of the linear ones is
    found.
    """
    derivative = ca.jacobian(force, state)
    coupled = derivative.sparsity().nnz() > np.count_nonzero(K) + np.count_nonzero(np.diag(K) == 0.0)
    if coupled:
        random = np.random.default_rng(0).normal(size=len(K))
        J = np.array(ca.Function("J", [state], [ca.densify(derivative)])(random))
        log_scale = symmetrising_scale(-J) if np.all(np.isfinite(J)) else None
        if log_scale is not None:
            S = K / np.exp(log_scale)[:, None] * np.exp(log_scale)
            if np.max(np.abs(S - S.T)) <= SYMMETRY_RTOL * len(K) * np.max(np.abs(S)):
                return log_scale
    return symmetrising_scale(K)


def symmetrising_scale(K: Array) -> Array | None:
    """Logarithms of factors D with D^-1 K D symmetric and largest factor 1 in each connected part; None without any.

    There are such factors where the products of opposite couplings are positive and agree around every loop
    (Kolmogorov's criterion): a walk over the couplings finds them, and every coupling is checked.
    """
    if np.any((K != 0.0) != (K.T != 0.0)) or np.any(K * K.T < 0.0):
        return None
    log_scale, part, pairs = np.zeros(len(K)), np.arange(len(K)), np.argwhere(np.triu(K, 1))
    for _, i, j, _ in tree_of(len(K), pairs.tolist(), range(len(K))):  # d_i^2 / d_j^2 = K_ij / K_ji
        log_scale[j], part[j] = log_scale[i] - 0.5 * np.log(K[i, j] / K[j, i]), part[i]
    for first in np.unique(part):
        log_scale[part == first] -= np.max(log_scale[part == first])
    rows, columns = np.nonzero(K)
    ratios = np.log(K[rows, columns] / K[columns, rows])
    mismatch = 2.0 * (log_scale[rows] - log_scale[columns]) - ratios
    return log_scale if np.max(np.abs(mismatch), initial=0.0) <= SYMMETRY_RTOL * len(K) else None


def tree_of(size: int, pairs: Sequence[Sequence[int]], firsts: Iterable[int]) -> Iterator[tuple[int, int, int, bool]]:
    """Pairs of a tree through each connected part of a graph, breadth first.

    Arguments:
        size: number of places.
        pairs: of places that are joined.
        firsts: places, in whose order parts are gone through, each from the first of these in it.

    Returns:
        Of each pair of the trees its number, the place from which and that to which it is gone along, and whether
        these are in its order.
    """
    touching: list[list[tuple[int, int, bool]]] = [[] for _ in range(size)]
    for k, (i, j) in enumerate(pairs):
        touching[i].append((k, j, True))
        touching[j].append((k, i, False))
    seen = [False] * size
    for first in firsts:
        queue = deque([] if seen[first] else [first])
        seen[first] = True
        while queue:
            here = queue.popleft()
            for k, there, forwards in touching[here]:
                if not seen[there]:
                    seen[there] = True
                    queue.append(there)
                    yield k, here, there, forwards


# Linear modes of models that have families: checks of the model, of its parameters and of a mode ----------------------

SIMPLE_SQUARE_RTOL = 1e-10  # relative distance of squared frequencies that doubles distinguish
HIGHEST_HARMONIC = 7  # whose resonance with another mode is looked for: the coarsest level has no higher ones
MOST_NAMED = 6  # modes in a message
FIRST, LAST = "first", "last"


def modes_of(model: OdeModel, parameters: Mapping[str, float]) -> LinearModes:
    """Linear modes of a model of second order about rest; raises ValueError where there are none."""
    check_kind(model)
    amplitude = amplitude_square(model).parameter
    values = fixed_values(model, parameters, () if amplitude is None else (amplitude,))
    numbers = ca.SX([values.get(name, 0.0) for name in model.parameter_names])
    return linear_modes(ca.substitute(model.rhs, model.parameters, numbers), model.state, model.name)


def check_kind(model: OdeModel) -> None:
    """Raises ValueError, in one line, for a model that has no families of brake orbits from rest."""
    even = (1,) * model.size + (-1,) * model.size
    for accepted, holds in (
        ("of second order, with positions as its state", model.order == 2),
        ("without forcing", not model.forced),
        ("with a declared reversal that keeps positions and turns velocities", model.reversal == even),
        ("with half_period = -1 for every component, or none", model.half_period in (None, (-1,) * model.full_size)),
    ):
        if not holds:
            raise ValueError(f"model: given {model.name}; accepted for families: a model {accepted}")


def fixed_values(model: OdeModel, given: Mapping[str, float], free: tuple[str, ...]) -> dict[str, float]:
    """Values of the parameters but for the free ones, given or nominal."""
    for name in free:
        if name in given:
            raise ValueError(f"parameters: given {name}, which the family is followed in; accepted: the others")
    values = named_values(model, {**dict.fromkeys(free, 0.0), **given})
    return {name: value for name, value in values.items() if name not in free}


def number_of_mode(mode: int | str, count: int, kind: str = "") -> int:
    """Number of one of `count` modes, of a `kind` for messages, that may be named; ValueError for none of them."""
    if isinstance(mode, str) and mode in (FIRST, LAST):
        return 1 if mode == FIRST else count
    if isinstance(mode, bool) or not isinstance(mode, int | np.integer) or not 1 <= int(mode) <= count:
        raise ValueError(f"mode: given {short_repr(mode)}; accepted: 1..{count}{kind}, {FIRST}, {LAST}")
    return int(mode)


@dataclass(frozen=True)
class Resonance:
    """Two modes with `harmonic` times the frequency of `mode` next to that of `other`; `off` is their difference.

    The difference is one of squared frequencies, relative to the largest.
    """

    mode: int
    other: int
    harmonic: int
    omega: float
    off: float

    @property
    def words(self) -> str:
        """What is in resonance."""
        m, j, k = self.harmonic, self.mode, self.other
        if m == 1:
            return f"a 1:1 resonance of modes {j} and {k}"
        return f"an internal resonance at harmonic {m} ({m} omega_{j} = omega_{k} = {self.omega:.10g})"


def nearest_resonance(squares: Array, number: int, odd: bool, lowest: int = 1) -> Resonance | None:
    """The nearest resonance of a mode with another one at a harmonic from the lowest on; None where there is no other.

    Arguments:
        squares: of the frequencies of all modes, ascending.
        number: of the mode, from 1.
        odd: whether forces are odd, so that orbits have odd harmonics alone.
        lowest: harmonic.
    """
    harmonics = np.arange(1, HIGHEST_HARMONIC + 1, 2 if odd else 1)
    harmonics = harmonics[harmonics >= lowest]
    off = np.abs(squares - harmonics[:, None] ** 2 * squares[number - 1]) / np.max(np.abs(squares))
    off[:, number - 1] = np.inf
    if not np.isfinite(off).any():
        return None
    i, other = (int(k) for k in np.unravel_index(np.argmin(off), off.shape))
    omega = float(np.sqrt(np.maximum(squares[other], 0.0)))
    return Resonance(number, other + 1, int(harmonics[i]), omega, float(off[i, other]))


def check_alone(squares: Array, number: int, name: str, odd: bool) -> None:
    """Raises ValueError for a mode that does not oscillate, or has no family alone: it is in resonance with another.

    Arguments are those of `check_harmonics`.
    """
    square, same = squares[number - 1], SIMPLE_SQUARE_RTOL * np.max(np.abs(squares))
    if square <= same:
        words = f"mode {number} of {name} does not oscillate: omega^2 = {square:.6g}"
        raise ValueError(f"mode: {words}; accepted: a mode with omega^2 > 0")
    near = [k + 1 for k in np.flatnonzero(np.abs(squares - square) <= same).tolist()]
    if len(near) > 1:
        words = f"modes {', '.join(map(str, near))} of {name} have the same frequency"
        apart = np.abs(np.diff(squares)) > same
        alone = np.flatnonzero(np.append(True, apart) & np.append(apart, True) & (squares > same)) + 1
        listed = ", ".join([*map(str, alone[:MOST_NAMED]), *(["..."] if alone.size > MOST_NAMED else [])])
        raise ValueError(
            f"mode: {words}: no family belongs to one of them alone, a 1:1 resonance; accepted: a mode with a frequency"
            f" of its own: {listed or 'there is none'}"
        )
    check_harmonics(squares, number, name, odd)


def check_harmonics(squares: Array, number: int, name: str, odd: bool) -> None:
    """Raises ValueError for a mode a harmonic of which is in resonance with another mode.

    Arguments are those of `nearest_resonance`, and the `name` of the model.
    """
    found = nearest_resonance(squares, number, odd, lowest=2)
    if found is not None and found.off <= SIMPLE_SQUARE_RTOL:
        words = f"mode {found.other} of {name} has {found.harmonic} times the frequency of mode {number}, {found.words}"
        accepted = "a mode without such a resonance, or other values of parameters"
        raise ValueError(f"mode: {words}: its family does not start alone; accepted: {accepted}")


DEEPEST_LOG_SCALE = -230.0  # of log D: its cube is still a double
LARGEST_SCALED_AMPLITUDE = 1e3  # amplitude of a scaled mode
TIE_RTOL = 1e-9  # relative difference of amplitudes that are the same but for rounding
RANDOM_AMPLITUDE = 0.1  # amplitude of random positions
JUMP_PHASES = np.linspace(0.0, 2.0 * np.pi, 1001)  # at which a linear mode is looked at for jumps
SYMMETRY_TRIALS = 3  # random states at which the symmetry of the forces' derivative is looked at


class ModelCoordinates(Coordinates):
    """Coordinates of a family of an `OdeModel` at fixed values of its parameters.

    The free parameter of the scaled equations is S where the forces are odd polynomials, else the amplitude sqrt(S),
    both in units near those of `amplitude_max`, a value of S, so that positions may have any unit. Raises ValueError,
    naming what the model lacks, where it has no families of this kind or the mode none of its own.
    """

    def __init__(
        self,
        model: OdeModel,
        mode: int | str,
        parameters: Mapping[str, float] | None = None,
        amplitude_max: float = 1.0,
    ) -> None:
        check_kind(model)
        self._unit = float(2.0 ** round(0.5 * np.log2(amplitude_max)))  # of positions: a power of 2 rounds nothing
        self._model, self._amplitude = model, amplitude_square(model)
        free = () if self._amplitude.parameter is None else (self._amplitude.parameter,)
        self._values = fixed_values(model, parameters or {}, free)
        self._numbers = ca.SX([self._values.get(name, 0.0) for name in model.parameter_names])
        self._force = self._at_values(model.rhs)
        self.modes = linear_modes(self._force, model.state, model.name)
        if np.min(self.modes.log_scale) < DEEPEST_LOG_SCALE:
            span = f"positions whose scales differ by exp({-np.min(self.modes.log_scale):.4g})"
            raise ValueError(
                f"model: given {model.name} with {span}; accepted: up to exp({-DEEPEST_LOG_SCALE:g}), or a Chain"
            )
        self.mode_number = number_of_mode(mode, model.size)
        self._check_mode()
        self._check_drift()
        self._check_amplitude()
        excess = float(np.max(np.abs(self.mode)))
        if excess > LARGEST_SCALED_AMPLITUDE:  # where the mode lives at the end that displacements lean away from
            self.modes = replace(self.modes, log_scale=self.modes.log_scale + np.log(excess))
            for name in ("mode", "scale"):
                self.__dict__.pop(name)
        self._parts = _homogeneous(self._force, model.state)
        words = self.jump(lambda: np.sqrt(amplitude_max) * np.cos(JUMP_PHASES)[:, None] * (self.scale * self.mode))
        if words:
            raise JumpError(model, f"{words}, in the linear mode at S = {amplitude_max:g}")
        self._squared = self._parts is not None and all(degree % 2 for degree in self._parts)

    def _check_mode(self) -> None:
        """Raises ValueError for a mode that does not oscillate, or is in resonance with another."""
        model = self._model
        check_alone(self.modes.squares, self.mode_number, model.name, model.half_period is not None)

    def _check_amplitude(self) -> None:
        """Raises ValueError where S does not grow with the mode, as at a position that rests in it."""
        y = self.scale * self.modes.modes[:, self.mode_number - 1]
        curvature, _ = ca.hessian(self._amplitude.form, self._model.state)
        size = float(np.linalg.norm(np.array(ca.evalf(curvature)))) * float(y @ y)
        if not self._amplitude.value(y) > SIMPLE_SQUARE_RTOL * size:
            words = f"a normalisation by which mode {self.mode_number} of {self._model.name} has no amplitude"
            raise ValueError(f"normalisation: given {words}; accepted: one that is positive for it")

    def jump(self, positions: Callable[[], Array]) -> str:
        model, p = self._model, np.array([self._values.get(name, 0.0) for name in self._model.parameter_names])
        if self._parts is not None or not model.jumps.found:  # polynomials do not jump
            return ""
        y = positions()
        states = np.concatenate([y, np.zeros_like(y)], axis=1)  # no force depends on velocities
        return model.jumps.along(np.zeros(len(states)), states, p)

    def _at_values(self, expression: ca.SX) -> ca.SX:
        """An expression of the model at the values of its parameters."""
        return ca.substitute(expression, self._model.parameters, self._numbers)

    # The equations --------------------------------------------------------------------------------------------------

    @cached_property
    def symplectic(self) -> bool:  # type: ignore[override]
        """Whether the derivative of the forces is symmetric in scaled coordinates, at random states."""
        asymmetric = (np.max(np.abs(J - J.T)) / np.max(np.abs(J)) for J in self._slopes)
        return self.modes.symmetric and all(off <= SYMMETRY_RTOL * self.scale.size for off in asymmetric)

    @cached_property
    def _slopes(self) -> list[Array]:
        """Derivatives of the forces in scaled coordinates at random states."""
        state, scale, generator = self._model.state, self.scale, np.random.default_rng(0)
        derivative = ca.Function("J", [state], [ca.densify(ca.jacobian(self._force, state))])
        spread = RANDOM_AMPLITUDE * self._unit * scale
        states = [spread * generator.uniform(-1.0, 1.0, scale.size) for _ in range(SYMMETRY_TRIALS)]
        return [np.array(derivative(y)) / scale[:, None] * scale for y in states]

    @cached_property
    def scaled(self) -> OdeModel:
        model, n = self._model, self._model.size
        q, v, p = ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.sym("S" if self._squared else "a")
        D = ca.SX(ca.DM(self.scale))
        energy = None
        if model.hamiltonian is not None:
            a = self._unit * (ca.sqrt(p) if self._squared else p)
            value = ca.Function("value", [model.state, model.velocity], [self._at_values(model.hamiltonian)])
            above_rest = value(a * D * q, a * D * v) - value(ca.DM.zeros(n), ca.DM.zeros(n))
            energy = above_rest / a**2
        uniform = float(np.ptp(self.log_scale)) == 0.0
        return OdeModel(
            f"scaled {model.name}", q, self._scaled_force(q, p), p, 2, v, reversal=model.reversal,
            half_period=model.half_period, normalisation=self._amplitude.of(D * q) - 1, hamiltonian=energy,
            checked=False, output_scale=None if uniform else tuple(self.scale),
        )  # fmt: skip

    @cached_property
    def solved(self) -> OdeModel:
        """The scaled equations; where nothing holds the centre of mass X, with a force that is zero at X = 0.

        X'' = omega^2 X has X = 0 as its one periodic solution, so that orbits are isolated and are the same.
        Orbits with half-period symmetry have X = 0 without it.
        """
        scaled, free = self.scaled, np.flatnonzero(self._at_rest())
        if scaled.half_period is not None or not free.size:
            return scaled
        force = scaled.rhs
        for k in free:
            left = self.modes.left[k] / np.linalg.norm(self.modes.left[k])
            one = ca.DM.zeros(scaled.size)
            one[int(np.argmax(np.abs(left)))] = np.sign(left[np.argmax(np.abs(left))]) * self.frequency**2
            force = force + one * ca.dot(ca.DM(left), scaled.state)
        return replace(scaled, rhs=force, hamiltonian=None, checked=False)

    def _at_rest(self) -> NDArray[np.bool_]:
        """Which linear modes have frequency 0."""
        return np.asarray(np.abs(self.modes.squares) <= SIMPLE_SQUARE_RTOL * np.max(np.abs(self.modes.squares)))

    def _check_drift(self) -> None:
        """Raises ValueError for a mode of frequency 0 that is no free motion of a part, where the mean is unknown."""
        resting = np.flatnonzero(self._at_rest())
        if self._model.half_period is not None or not resting.size:
            return
        kept = self._unchanging(self.modes.left[resting].T, transposed=True)
        if min(self.free_motions.shape[1], kept.shape[1]) < resting.size:
            words = f"omega^2 = 0 of {self._model.name}, whose mode is no free motion at all amplitudes"
            raise ValueError(f"model: given {words}; accepted: forces that are odd, or omega^2 > 0")

    @cached_property
    def free_motions(self) -> Array:
        return self._unchanging(self.modes.modes[:, self._at_rest()], transposed=False)

    def _unchanging(self, modes: Array, transposed: bool) -> Array:
        """Those combinations of columns, orthonormal, that the derivative of the forces, or its transpose, takes to 0.

        At random states, as well as at rest: along them forces never change, or do not act.
        """
        if not modes.size:
            return modes
        if not np.all(np.isfinite(self._slopes)):
            return modes[:, :0]
        images = [(J.T if transposed else J) @ modes / np.max(np.abs(J)) for J in self._slopes]
        _, sizes, rows = np.linalg.svd(np.concatenate(images))
        unchanging = modes @ rows[sizes <= SYMMETRY_RTOL * len(modes)].T
        return np.asarray(np.linalg.qr(unchanging)[0])

    def _scaled_force(self, q: ca.SX, p: ca.SX) -> ca.SX:
        """D^-1 f(a D q) / a, with a^2 or a = p in its unit: for polynomials by homogeneous parts, regular at a = 0."""
        linear = -ca.sparsify(ca.SX(ca.DM(self.modes.stiffness))) @ q
        if self._parts is not None:
            return linear + self._nonlinear_parts(q, p)
        D, state, t = ca.SX(ca.DM(self._unit * self.scale)), self._model.state, ca.SX.sym("t")
        along = ca.substitute(self._force, state, t * D * q)
        second = 0.5 * ca.substitute(ca.jacobian(ca.jacobian(along, t), t), t, 0) / D
        bend = float(np.linalg.norm(np.array(ca.Function("bend", [q], [ca.densify(second)])(self.mode))))
        # Below `small` two terms are right to rounding, where f(a q) / a loses all digits.
        small = float(np.sqrt(EPSILON) / max(1.0, bend / np.linalg.norm(self.modes.stiffness @ self.mode)))
        is_small = p**2 <= small**2
        safe = ca.if_else(is_small, small, p)
        return ca.if_else(is_small, linear + p * second, ca.substitute(along, t, safe) / (safe * D))

    def _nonlinear_parts(self, q: ca.SX, p: ca.SX) -> ca.SX:
        """The scaled forces without their linear part, of polynomials."""
        total, D = ca.SX.zeros(q.numel()), ca.SX(ca.DM(self._unit * self.scale))
        for degree, part in (self._parts or {}).items():
            if degree != 1:
                power = (degree - 1) // 2 if self._squared else degree - 1
                total += p**power * ca.substitute(part, self._model.state, D * q) / D
        return total

    @property
    def log_scale(self) -> Array:
        return self.modes.log_scale

    @cached_property
    def mode(self) -> Array:
        q = self.modes.modes[:, self.mode_number - 1]
        if self.modes.symmetric and np.ptp(self.log_scale) > 0.0:
            q = with_small_amplitudes(q, self.modes.stiffness, self.modes.squares[self.mode_number - 1])
        q = q / self.amplitude(self.scale * q)
        sizes = np.abs(self.scale * q)
        largest = int(
            np.argmax(sizes > (1.0 - TIE_RTOL) * np.max(sizes))
        )  # the first of those that only rounding orders
        return np.asarray(q * np.sign(q[largest]))

    def amplitude(self, positions: Array) -> float:
        return float(np.sqrt(self._amplitude.value(positions)))

    @property
    def frequency(self) -> float:
        return float(np.sqrt(self.modes.squares[self.mode_number - 1]))

    def parameter_of(self, S: float) -> float:
        square = S / self._unit / self._unit
        return square if self._squared else float(np.sqrt(square))

    def S_of(self, parameter: float) -> float:
        return (parameter if self._squared else parameter**2) * self._unit * self._unit

    @property
    def S_rate(self) -> float:  # type: ignore[override]
        return 1.0 if self._squared else 2.0

    # Output -----------------------------------------------------------------------------------------------------------

    @property
    def model(self) -> OdeModel:
        return self._model

    @property
    def parameters(self) -> Mapping[str, float]:
        return self._values

    @property
    def description(self) -> str:
        scaled = "positions of the model" if float(np.ptp(self.log_scale)) == 0.0 else "positions scaled to symmetry"
        kind = "Hamiltonian" if self.symplectic else "reversible, and Hamiltonian in no such coordinates"
        return f"{scaled}; the equations are {kind}"

    def band(self) -> tuple[float, float] | None:
        return float(self.modes.squares[0]), float(self.modes.squares[-1])

    # Quantities -----------------------------------------------------------------------------------------------------

    def nonlinear_forces(self, q: Array, parameter: float) -> Array:
        if len(q) not in self._mapped:
            scaled = self.scaled
            state, p = scaled.state, scaled.parameters
            linear = ca.SX(ca.DM(self.modes.stiffness)) @ state
            rest = scaled.rhs + linear if self._parts is None else self._nonlinear_parts(state, p)
            function = ca.Function("N", [state, p], [ca.densify(rest)])
            self._mapped[len(q)] = Buffers(function, len(q))
        return np.asarray(self._mapped[len(q)](q, np.array(parameter))[0].reshape(q.shape))

    @cached_property
    def _mapped(self) -> dict[int, Buffers]:
        return {}

    @property
    def left_mode(self) -> Array:
        return np.asarray(self.modes.left[self.mode_number - 1])


def coordinates_of_model(
    model: OdeModel,
    mode: int | str,
    amplitude_max: float,
    method: Method,
    parameters: Mapping[str, float] | None = None,
) -> ModelCoordinates:
    """Coordinates of the family of an `OdeModel` that grows from a linear mode to S = `amplitude_max`."""
    if method.tail is not None:
        raise ValueError(f"tail: given {short_repr(method.tail)}; accepted: with a chain alone")
    return ModelCoordinates(model, mode, parameters, amplitude_max)


def _homogeneous(force: ca.SX, state: ca.SX) -> dict[int, ca.SX] | None:
    """Homogeneous parts of polynomial forces by degree, without rounding at rest; None for others."""
    try:
        return {degree: part for degree, part in homogeneous_parts(force, state).items() if degree}
    except NotPolynomialError:
        return None


# Linear spectra -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class LinearSpectrum:
    """Linear modes about rest.

    Attributes:
        squares: of the frequencies, ascending, shape (modes,); none of a lattice of infinite length.
        ends: squares of the lowest and the highest frequency.
        mode: function of the number of a mode, from 1, to its displacements at all positions: of norm 1, the largest
            positive.
        cutoffs: squares of the limits of the frequencies of an infinitely long lattice; None where these are not known.
        bands: squares of the ends of its bands, where there are several.
    """

    squares: Array
    ends: tuple[float, float]
    mode: Callable[[int], Array]
    cutoffs: tuple[float, float] | None = None
    bands: tuple[tuple[float, float], ...] = ()


@in_turn
def linear_spectrum(model: Any, parameters: Mapping[str, float] | None = None) -> LinearSpectrum:
    """The linear spectrum of a model.

    Arguments:
        model: a `Chain`, or an `OdeModel` of second order with an equilibrium at 0.
        parameters: values of the parameters of an `OdeModel`, where they are not its nominal ones.

    Returns:
        Frequencies and modes.

    Raises:
        ValueError: the model has no such modes.
    """
    found: LinearSpectrum = model.linear_spectrum(parameters)
    return found


def spectrum_of_model(model: OdeModel, parameters: Mapping[str, float] | None = None) -> LinearSpectrum:
    """`linear_spectrum` of an `OdeModel`."""
    modes = modes_of(model, parameters or {})
    scale = np.exp(modes.log_scale)

    def displacements(mode: int) -> Array:
        return of_norm_one(scale * modes.modes[:, mode - 1])

    return LinearSpectrum(modes.squares, (float(modes.squares[0]), float(modes.squares[-1])), displacements)


def of_norm_one(displacements: Array) -> Array:
    """Displacements scaled to norm 1, the largest positive, shape (positions,)."""
    largest = displacements[np.argmax(np.abs(displacements))]
    return np.asarray(displacements / np.linalg.norm(displacements) * np.sign(largest))


def frequencies_of_model(model: OdeModel, parameters: Mapping[str, float] | None = None) -> Array:
    """Frequencies of all linear modes of an `OdeModel` in ascending order, shape (modes,).

    Raises ValueError where it has no such modes, or the lowest does not oscillate.
    """
    squares = spectrum_of_model(model, parameters).squares
    if squares[0] < 0:
        words = f"mode 1 of {model.name} does not oscillate: omega^2 = {squares[0]:.6g}"
        raise ValueError(f"{words}; accepted: omega^2 >= 0")
    return np.sqrt(squares)
