"""The amplitude S of families of a model: the sum of squares at rest, or the S of its normalisation."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from casadi_skin.model.equations import Array
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import NotPolynomialError, homogeneous_parts


@dataclass(frozen=True, eq=False)
class AmplitudeSquare:
    """A square of the amplitude: the quadratic form h(y) of positions at rest that S is the value of.

    `parameter` is the name of the parameter of the model that stands for S in its normalisation, None without one.
    """

    state: ca.SX
    form: ca.SX
    parameter: str | None

    def of(self, positions: ca.SX) -> ca.SX:
        """h at expressions for the positions."""
        return ca.substitute(self.form, self.state, positions)

    def value(self, positions: Array) -> float:
        """h at numbers."""
        return float(ca.evalf(self.of(ca.SX(ca.DM(positions)))))


def amplitude_square(model: OdeModel) -> AmplitudeSquare:
    """Expression whose value is S: the sum of squares of the positions at rest, or that of the normalisation.

    A normalisation is accepted for families as h(y) - p, with h a quadratic form of the positions and p a parameter
    that occurs nowhere else. Raises ValueError for another.
    """
    if model.normalisation is None:
        return AmplitudeSquare(model.state, ca.dot(model.state, model.state), None)
    normalisation = ca.substitute(model.normalisation, model.velocity, ca.SX.zeros(model.size))
    accepted = "a quadratic form of the positions minus a parameter that the forces do not depend on"
    entries = ca.vertsplit(model.parameters)
    used = [k for k, entry in enumerate(entries) if ca.depends_on(normalisation, entry)]
    fault = ValueError(f"{model.name}: given a normalisation that fixes no amplitude of families; accepted: {accepted}")
    if len(used) != 1 or ca.depends_on(model.rhs, entries[used[0]]):
        raise fault
    slope = ca.densify(ca.jacobian(normalisation, entries[used[0]]))
    form = ca.substitute(normalisation, entries[used[0]], 0)
    try:
        degrees = set(homogeneous_parts(form, model.state))
    except NotPolynomialError:
        raise fault from None
    if degrees != {2} or not (slope.is_constant() and float(slope) == -1.0):
        raise fault
    return AmplitudeSquare(model.state, form, model.parameter_names[used[0]])
