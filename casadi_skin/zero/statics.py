"""A model at rest: the equations that vanish there, their derivatives, and the eigenvalues of the linearisation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from casadi_skin.model.expressions import Expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import Result
from casadi_skin.model.saved import programs_in
from casadi_skin.zero.problem import EPSILON, Array
from casadi_skin.zero.rest_linearised import ComplexArray, Linearised
from casadi_skin.zero.statement import named_values

SECOND, THIRD = 3e-4, 1e-3  # of the size of x: steps of second and third derivatives of a program
SAFETY = 4.0  # of the estimated errors of eigenvalues


@dataclass(frozen=True, eq=False)
class Spectrum(Result):
    """Eigenvalues by descending real part, with estimated absolute errors; both of shape (components,)."""

    values: ComplexArray
    errors: Array

    def __repr__(self) -> str:
        words = "stable" if self.stable else "unstable"
        return f"<Spectrum: {self.values.size} eigenvalues, largest real part {self.values.real.max():.6g}; {words}>"

    @property
    def stable(self) -> bool:
        """Whether none has a positive real part, within estimated errors."""
        return bool(np.all(self.values.real <= self.errors))


@dataclass(frozen=True, eq=False)
class Statics:
    """The equations f(x, p) = 0 of a model at rest: x its state, of a model of second order its positions alone.

    Attributes:
        model: the model as given, which no force drives in time.
        values: value of each parameter by name.

    Raises ValueError for a forced model, and where a parameter has no value.
    """

    model: OdeModel
    given: Mapping[str, float]
    widening: float = 1.0  # of the steps of differences, for their errors

    def __post_init__(self) -> None:
        if self.model.forced:
            period = "" if isinstance(self.model.forcing_period, ca.SX | ca.MX) else f" {self.model.forcing_period:g}"
            why = f"its right-hand side depends on time, with period{period}, and it has orbits in place of equilibria"
            raise ValueError(f"model: given {self.model.name}, which is forced: {why}; accepted: one without time")
        _ = self.values

    @cached_property
    def values(self) -> dict[str, float]:
        """Value of each parameter by name, in the model's order."""
        return named_values(self.model, self.given)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return self.model.size

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return self.model.state_names[: self.size]

    @property
    def oscillates(self) -> bool:
        """Whether pairs of eigenvalues may cross the imaginary axis one by one, as no conserved quantity pins them."""
        return self.model.order == 1 and self.model.hamiltonian is None

    @cached_property
    def function(self) -> ca.Function:
        """Function (x, p) -> f, dense."""
        model = self.model
        return ca.Function("f", [model.state, model.parameters], [ca.densify(model.rhs)], ["x", "p"], ["f"])

    # Derivatives ----------------------------------------------------------------------------------------------------

    @cached_property
    def _jacobian(self) -> ca.Function:
        x, p = self.symbols()
        f = self.function(x, p)
        return ca.Function("J", [x, p], [ca.densify(ca.jacobian(f, x)), ca.densify(ca.jacobian(f, p))])

    @cached_property
    def _second(self) -> ca.Function:
        """Function (x, p, u, v) -> f_xx u v."""
        x, p = self.symbols()
        u, v = (type(x).sym(name, self.size) for name in "uv")
        once = ca.jtimes(self.function(x, p), x, u)
        return ca.Function("B", [x, p, u, v], [ca.densify(ca.jtimes(once, x, v))])

    @cached_property
    def _third(self) -> ca.Function:
        """Function (x, p, u, v, w) -> f_xxx u v w."""
        x, p = self.symbols()
        u, v, w = (type(x).sym(name, self.size) for name in "uvw")
        twice = ca.jtimes(ca.jtimes(self.function(x, p), x, u), x, v)
        return ca.Function("C", [x, p, u, v, w], [ca.densify(ca.jtimes(twice, x, w))])

    def symbols(self) -> tuple[Expression, Expression]:
        """New symbols of the unknowns and of the parameters."""
        kind = type(self.model.state)
        return kind.sym("x", self.size), kind.sym("p", int(self.model.parameters.numel()))

    def jacobian(self, x: Array, p: Array) -> Array:
        """df/dx, shape (n, n)."""
        return np.array(self._jacobian(x, p)[0])

    def by_parameters(self, x: Array, p: Array) -> Array:
        """df/dp, shape (n, parameters)."""
        return np.array(self._jacobian(x, p)[1])

    @cached_property
    def exact(self) -> bool:
        """Whether higher derivatives are exact; those of a program, as an FMU, are differences of its Jacobian."""
        return not programs_in(self.function)

    def second(self, x: Array, p: Array, u: ComplexArray | Array, v: ComplexArray | Array) -> ComplexArray:
        """f_xx u v for complex directions, shape (n,)."""

        def real(a: Array, b: Array) -> Array:
            if self.exact:
                return np.array(self._second(x, p, a, b)).ravel()
            h = self.widening * SECOND * self._scale(x, a)
            return np.asarray((self.jacobian(x + h * a, p) - self.jacobian(x - h * a, p)) @ b / (2.0 * h))

        return real(u.real, v.real) - real(u.imag, v.imag) + 1j * (real(u.real, v.imag) + real(u.imag, v.real))

    def third(
        self, x: Array, p: Array, u: ComplexArray | Array, v: ComplexArray | Array, w: ComplexArray | Array
    ) -> ComplexArray:
        """f_xxx u v w for complex directions, shape (n,)."""
        total = np.zeros(self.size, complex)
        for a, by_u in ((u.real, 1.0), (u.imag, 1j)):
            for b, by_v in ((v.real, 1.0), (v.imag, 1j)):
                for c, by_w in ((w.real, 1.0), (w.imag, 1j)):
                    if np.any(a) and np.any(b) and np.any(c):
                        total += by_u * by_v * by_w * self._real_third(x, p, a, b, c)
        return total

    def _real_third(self, x: Array, p: Array, a: Array, b: Array, c: Array) -> Array:
        """f_xxx a b c, shape (n,)."""
        if self.exact:
            return np.array(self._third(x, p, a, b, c)).ravel()
        h, k = (self.widening * THIRD * self._scale(x, along) for along in (a, b))
        ends = [(i * j, self.jacobian(x + i * h * a + j * k * b, p)) for i in (-1, 1) for j in (-1, 1)]
        return np.asarray(sum(sign * matrix for sign, matrix in ends) @ c / (4.0 * h * k))

    def _scale(self, x: Array, along: Array) -> float:
        """A step along a direction that is the size of x, 1 at least."""
        return max(1.0, float(np.max(np.abs(x)))) / max(float(np.max(np.abs(along))), 1e-300)

    # Eigenvalues ----------------------------------------------------------------------------------------------------

    def linearised(self, x: Array, p: Array, moved: Array | None = None) -> Linearised:
        """df/dx, and its change where the state is off by `moved`; raises ArithmeticError where it is not finite."""
        A = self.jacobian(x, p)
        if not np.all(np.isfinite(A)):
            raise ArithmeticError(f"{self.model.name}: the derivatives are not finite at the equilibrium")
        change = None if moved is None or not np.any(moved) else self.jacobian(x + moved, p) - A
        return Linearised(A, max(EPSILON, self.model.rounding), change)

    def spectrum(self, x: Array, p: Array, moved: Array | None = None) -> Spectrum:
        """Eigenvalues of the linearisation, of a model of second order +-sqrt(mu) of those of df/dx.

        `moved` is the estimated error of x, shape (n,), which the errors of eigenvalues include to first order, beside
        rounding by the condition of each (Wilkinson 1965).
        """
        linear = self.linearised(x, p, moved)
        values, errors = linear.eigensystem[0], linear.errors(SAFETY)
        if self.model.order == 2:
            values, errors = _roots(values, errors)
        places = np.lexsort((-values.imag, -values.real))
        return Spectrum(values[places], errors[places])


def _roots(squares: ComplexArray, errors: Array) -> tuple[ComplexArray, Array]:
    """+-sqrt(mu) and their errors: exactly imaginary where mu is negative; one that is 0 but for errors has theirs."""
    exact = np.where((np.abs(squares.imag) <= errors) & (squares.real < 0.0), squares.real, squares)
    roots = np.sqrt(exact.astype(complex))
    size = np.minimum(errors / np.maximum(np.abs(roots), 1e-300), np.sqrt(errors))
    return np.concatenate([roots, -roots]), np.concatenate([size, size])
