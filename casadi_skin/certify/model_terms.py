"""The exact polynomials of a model: forces, amplitude and conserved quantity, as fractions of its doubles."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from casadi_skin.certify.odd_system import OddSystem, Terms
from casadi_skin.models.ode import OdeModel
from casadi_skin.models.polynomial import NotPolynomialError, exact_terms
from casadi_skin.orbits.amplitude import amplitude_square
from casadi_skin.orbits.coordinates import Coordinates

if TYPE_CHECKING:
    from flint import arb


def system_of(coordinates: Coordinates, S: float) -> OddSystem:
    """The equations of odd cosines of a family's model; raises ValueError where the forces are no odd polynomials.

    Positions are scaled by the factors of the coordinates and by a power of 2 near sqrt(S), both as exact numbers.
    """
    from flint import arb

    model, values = coordinates.model, _values(coordinates)
    accepted = f"certify: given {model.name}; accepted: forces that are odd polynomials of the positions"
    try:
        forces = exact_terms(model.rhs, model.state, _fixed(model), [0.0] * model.size + values)
    except NotPolynomialError as error:
        raise ValueError(f"{accepted} ({error})") from None
    even = next((factors for terms in forces for factors in terms if len(factors) % 2 == 0), None)
    if even is not None:
        raise ValueError(f"{accepted} (a term of degree {len(even)} is even)")
    form = exact_terms(amplitude_square(model).form, model.state, _fixed(model), [0.0] * model.size + values)
    unit = arb(2) ** round(0.5 * float(np.log2(S)))
    scale = [(arb(log).exp() * unit).mid() for log in coordinates.log_scale.tolist()]
    return OddSystem(forces, form[0], scale, arb(S))


def energy_terms(coordinates: Coordinates, forces: Sequence[Terms]) -> Terms | None:
    """Terms of the conserved quantity at rest, above its value at 0, in the model's positions; None without one.

    What the model declares, or for coordinates that declare one the potential of its forces.
    """
    model = coordinates.model
    if model.hamiltonian is not None:
        fixed = [0.0] * model.size + _values(coordinates)
        try:
            terms = exact_terms(model.hamiltonian, model.state, _fixed(model), fixed)[0]
        except NotPolynomialError:
            return None
        return {factors: coefficient for factors, coefficient in terms.items() if factors}
    if coordinates.scaled.hamiltonian is None:
        return None
    return potential(forces, int(np.argmax(coordinates.log_scale)))


def potential(forces: Sequence[Terms], first: int) -> Terms | None:
    """The potential V with M_n force_n = -dV/dy_n for weights M > 0, M = 1 at position `first`; None without one.

    A walk over the linear couplings finds the weights, and every derivative is compared, all in fractions.
    """
    weights = weights_of(forces, first)
    if weights is None:
        return None
    V: dict[tuple[int, ...], Fraction] = {}
    for n, terms in enumerate(forces):
        for factors, coefficient in terms.items():
            key = tuple(sorted((*factors, n)))
            V[key] = V.get(key, Fraction(0)) - weights[n] * coefficient / len(
                key
            )  # Euler: sum of y_n dV/dy_n = degree V
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
    from flint import arb, fmpq

    total = arb(0)
    for factors, coefficient in terms.items():
        product = arb(fmpq(coefficient.numerator, coefficient.denominator))
        for n in factors:
            product *= values[n]
        total += product
    return total


def weights_of(forces: Sequence[Terms], first: int) -> list[Fraction] | None:
    """M_n with M_m dforce_m/dy_n = M_n dforce_n/dy_m at rest, along a walk; None where a part is not reached."""
    weights: dict[int, Fraction] = {first: Fraction(1)}
    queue = deque([first])
    while queue:
        m = queue.popleft()
        for factors, coefficient in forces[m].items():
            n = factors[0]
            if len(factors) == 1 and n not in weights:
                back = forces[n].get((m,), Fraction(0))
                if not back * coefficient > 0:
                    return None
                weights[n] = weights[m] * coefficient / back
                queue.append(n)
    return [weights[n] for n in range(len(forces))] if len(weights) == len(forces) else None


def _fixed(model: OdeModel) -> ca.SX:
    return ca.vertcat(model.velocity, model.parameters)


def _values(coordinates: Coordinates) -> list[float]:
    """Values of the model's parameters in its order; 0 for the one that stands for S in its normalisation."""
    return [float(coordinates.parameters.get(name, 0.0)) for name in coordinates.model.parameter_names]
