"""The exact polynomials of a model: forces, amplitude and conserved quantity, as fractions."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from casadi_skin.certify.cosine_system import CosineSystem, Terms
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.model.amplitude import amplitude_square
from casadi_skin.model.formula import Number
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import NotPolynomialError, constants, exact_terms
from casadi_skin.zero.coordinates import Coordinates

if TYPE_CHECKING:
    from flint import arb


def exact(value: float, decimals: bool) -> Fraction:
    """Exact value of a double: itself, or the shortest decimal that rounds to it."""
    return Fraction(repr(value)) if decimals else Fraction(value)


def ball(number: Fraction) -> arb:
    """A ball around a fraction."""
    from flint import arb, fmpq

    return arb(fmpq(number.numerator, number.denominator))


@dataclass(frozen=True, eq=False)
class ExactEquations:
    """Equations whose numbers are fractions: a model, and values of its velocities (0) and parameters.

    Of a lattice every number in a formula is a parameter, with the value of the written decimal or of its double. Other
    models hold doubles, which are the numbers; with `decimals` ValueError is raised where one is no short decimal.
    """

    model: OdeModel
    values: list[Fraction | None]
    decimals: bool

    @classmethod
    def of(cls, model: OdeModel, parameters: Mapping[str, float], decimals: bool) -> ExactEquations:
        """At values of the parameters by name; 0 for the one that stands for S."""
        numbers: Mapping[str, Number | None] = {}
        if isinstance(model, Lattice):
            model, numbers = model.with_numbers_apart

        def value(name: str) -> Fraction | None:
            if name not in numbers:
                return exact(float(parameters.get(name, 0.0)), decimals)
            number = numbers[name]
            if number is None:
                return None
            return number.exact if decimals else Fraction(number.value)

        values = [Fraction(0)] * model.size + [value(name) for name in model.parameter_names]
        return cls(model, values, decimals)

    def terms(self, expression: ca.SX) -> list[dict[tuple[int, ...], Fraction]]:
        """The terms of polynomials of the positions; raises NotPolynomialError for other expressions."""
        model = self.model
        fixed = ca.vertcat(model.velocity, model.parameters)
        inexact = [c for c in constants(expression, [model.state, fixed]) if exact(c, True) != Fraction(c)]
        if self.decimals and inexact:
            words = f"the double {inexact[0]!r} in the equations of {model.name}, which may stand for another decimal"
            accepted = "with decimals numbers like 0.5 that doubles hold exactly, others as parameters or in a Lattice"
            raise ValueError(f"certify: given {words}; accepted: {accepted}")
        return exact_terms(expression, model.state, fixed, self.values)


def system_of(coordinates: Coordinates, S: float, step: int = 2, decimals: bool = False) -> CosineSystem:
    """The equations of cosines of a family's model; raises ValueError where its forces are no polynomials for them.

    Positions are scaled by doubles near the factors of the coordinates and by a power of 2 near sqrt(S), all exact;
    with `decimals` numbers of formulas, parameters and S are the decimals that are written.
    """
    from flint import arb

    equations = ExactEquations.of(coordinates.model, coordinates.parameters, decimals)
    kind = "odd polynomials" if step == 2 else "polynomials"
    accepted = f"certify: given {equations.model.name}; accepted: forces that are {kind} of the positions"
    try:
        forces = equations.terms(equations.model.rhs)
    except NotPolynomialError as error:
        raise ValueError(f"{accepted} ({error})") from None
    even = next((factors for terms in forces for factors in terms if len(factors) % 2 == 0), None)
    if step == 2 and even is not None:
        raise ValueError(f"{accepted} (a term of degree {len(even)} is even)")
    form = equations.terms(amplitude_square(equations.model).form)
    power = round(0.5 * float(np.log2(S)))
    scale = [_near(log) * arb(2) ** power for log in coordinates.log_scale.tolist()]
    return CosineSystem(forces, form[0], scale, ball(exact(S, decimals)), step)


def _near(log: float) -> arb:
    """A number with the digits of a double near exp(log), of any size."""
    from flint import arb

    power = round(log / math.log(2.0))
    return arb(math.exp(log - power * math.log(2.0))) * arb(2) ** power


def energy_terms(coordinates: Coordinates, forces: Sequence[Terms], decimals: bool = False) -> Terms | None:
    """Terms of the conserved quantity at rest, above its value at 0, in the model's positions; None without one.

    The energy that the model declares, or for coordinates that declare one the potential of its forces.
    """
    equations = ExactEquations.of(coordinates.model, coordinates.parameters, decimals)
    if equations.model.hamiltonian is not None:
        try:
            terms = equations.terms(equations.model.hamiltonian)[0]
        except NotPolynomialError:
            return None
        return {factors: coefficient for factors, coefficient in terms.items() if factors}
    if coordinates.scaled.hamiltonian is None:
        return None
    return potential(forces, int(np.argmax(coordinates.log_scale)))


def potential(forces: Sequence[Terms], first: int) -> Terms | None:
    """The potential V with M_n force_n = -dV/dy_n for weights M > 0, M = 1 at position `first`; None without one.

    A walk over the couplings finds the weights, and every derivative is compared, all in fractions.
    """
    weights = weights_of(forces, first)
    if weights is None:
        return None
    V: dict[tuple[int, ...], Fraction] = {}
    for n, terms in enumerate(forces):
        for factors, coefficient in terms.items():
            key = tuple(sorted((*factors, n)))
            # Euler: the sum of y_n dV/dy_n is V times its degree
            V[key] = V.get(key, Fraction(0)) - weights[n] * coefficient / len(key)
    slopes: list[dict[tuple[int, ...], Fraction]] = [{} for _ in forces]
    for factors, coefficient in V.items():
        for n in set(factors):
            place = factors.index(n)
            slopes[n][factors[:place] + factors[place + 1 :]] = coefficient * factors.count(n)
    matches = all(
        {f: -weights[n] * c for f, c in terms.items()} == {f: c for f, c in slopes[n].items() if c}
        for n, terms in enumerate(forces)
    )
    return V if matches else None


def evaluate(terms: Terms, values: Sequence[arb]) -> arb:
    """A polynomial at balls."""
    from flint import arb

    total = arb(0)
    for factors, coefficient in terms.items():
        product = ball(coefficient)
        for n in factors:
            product *= values[n]
        total += product
    return total


def weights_of(forces: Sequence[Terms], first: int) -> list[Fraction] | None:
    """M_n with M_m dforce_m/dy_n = M_n dforce_n/dy_m, from terms along a walk; None where a part is not reached."""
    weights: dict[int, Fraction] = {first: Fraction(1)}
    queue = deque([first])
    while queue:
        m = queue.popleft()
        for factors, coefficient in forces[m].items():
            for n in set(factors) - set(weights):
                place = factors.index(n)
                other = tuple(sorted((*factors[:place], *factors[place + 1 :], m)))
                back = forces[n].get(other, Fraction(0)) * other.count(m)
                if not back * coefficient > 0:
                    return None
                weights[n] = weights[m] * coefficient * factors.count(n) / back
                queue.append(n)
    return [weights[n] for n in range(len(forces))] if len(weights) == len(forces) else None
