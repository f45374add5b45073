"""Equations of cosine series: lambda k^2 a_nk + [force_n(q)]_k = 0 and h(q(0)) = S, evaluated in balls.

Positions are y_n = d_n q_n with fixed numbers d_n, q_n = sum over k of a_nk cos(k theta), theta = Omega t, and lambda =
Omega^2. The harmonics are k = 1, 3, 5, ... (step 2) or 0, 1, 2, ... (step 1). Products of cosine series are products of
polynomials: with z = exp(i theta) each series is z^-K times a polynomial in z^step, K its highest harmonic.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import exp, log, prod

import casadi as ca
import numpy as np

from casadi_skin.certify.balls import arb, arb_poly, ball, exact, largest
from casadi_skin.lattice.chain_coordinates import FullChain, LongChain
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.model.amplitude import amplitude_square
from casadi_skin.model.formula import Number
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import NotPolynomialError, constants, exact_terms
from casadi_skin.zero.coordinates import Coordinates

# The linear tail of a long or infinite chain, solved exactly, with bounds of the effect of its cubic terms ------------
#
# Beyond the site t of a core the chain goes on with L sites, L finite or not, in a gauge whose linear couplings are c
# to either side: (E_k + c (shifts)) a_k = cubic terms, E_k = lambda k^2 - alpha - 2. Where |E_k| > 2c the linear part
# has an inverse of norm at most 1/(|E_k| - 2c), and its solution is a_(t+n,k) = u_n a_tk with |u_n| <= |tau_k|^n.


@dataclass(frozen=True, eq=False)
class LinearTail:
    """A tail of a chain's core.

    Attributes:
        site: index of the core's site that it is coupled to.
        first_site: number of the core's first site.
        length: number of its sites; None where it has no end.
        onsite: alpha + 2.
        coupling: c.
        ratio: of the squares of the gauge's factors of neighbours, away from the core.
        cubic: modulus of the cubic coefficient at the core's site, in scaled positions.
        weight: square of the gauge's factor there.
    """

    site: int
    first_site: int
    length: int | None
    onsite: arb
    coupling: arb
    ratio: arb
    cubic: arb
    weight: arb

    def energy(self, k: int, square: arb) -> arb:
        """E_k."""
        return square * k**2 - self.onsite

    def gap(self, k: int, square: arb) -> arb:
        """|E_k| - 2c; raises ValueError where it is not positive."""
        gap = abs(self.energy(k, square)) - 2 * self.coupling
        if not gap > 0:
            times = f"{k} times " if k > 1 else ""
            raise ValueError(f"{times}Omega lies in the band, accepted: outside of it, where the tail decays")
        return gap

    def root(self, k: int, square: arb) -> arb:
        """tau_k, of modulus below 1: the ratio of neighbours in a tail without end."""
        self.gap(k, square)
        E, c = self.energy(k, square), self.coupling
        size = 2 * c / (abs(E) + (E**2 - 4 * c**2).sqrt())
        return -size if E > 0 else size

    def share(self, k: int, square: arb) -> arb:
        """u_1."""
        tau, far = self.root(k, square), self._far(k, square)
        return (tau - far / tau) / (1 - far)

    def _far(self, k: int, square: arb) -> arb:
        """tau_k^(2L + 2)."""
        return arb(0) if self.length is None else self.root(k, square) ** (2 * self.length + 2)

    def squares(self, k: int, square: arb) -> arb:
        """Sum of u_n^2 over the tail."""
        tau, far = self.root(k, square), self._far(k, square)
        near = (1 + far) * (tau**2 - far) / (1 - tau**2)
        return (near - 2 * (self.length or 0) * far) / (1 - far) ** 2

    def first(self, series: Sequence[arb], square: arb, nu: arb) -> arb:
        """Bound of the norm of the first site of the tail, from the series of the core's site."""
        total = arb(0)
        for i, a in enumerate(series):
            total += abs(a * self.root(2 * i + 1, square)) * nu ** (2 * i + 1)
        return total

    def amplitude(self, series: Sequence[arb], square: arb) -> arb:
        """Contribution of the tail to S, as a ball from 0 to its bound."""
        first, slowest = self.first(series, square, arb(1)), self.slowest(len(series), square)
        return (self.weight * self.ratio * first**2 / (1 - self.ratio * slowest**2)).union(arb(0))

    def slowest(self, harmonics: int, square: arb) -> arb:
        """Largest |tau_k|."""
        return largest(abs(self.root(2 * i + 1, square)) for i in range(harmonics))

    def cubic_residual(self, series: Sequence[arb], square: arb, nu: arb) -> arb:
        """Bound of the norm of the tail's cubic terms."""
        slowest = self.slowest(len(series), square)
        return self.cubic * self.ratio * self.first(series, square, nu) ** 3 / (1 - self.ratio * slowest**3)


# Equations of cosine series: lambda k^2 a_nk + [force_n(q)]_k = 0 and h(q(0)) = S, evaluated in balls -----------------

Factors = tuple[int, ...]
Terms = Mapping[Factors, Fraction]


@dataclass(frozen=True, eq=False)
class CosineSystem:
    """Polynomial forces and amplitude of one model at fixed parameters, in scaled positions.

    Attributes:
        forces: of each position the terms of its acceleration in the model's positions, of odd degrees for step 2.
        amplitude: terms of the quadratic form h that S is the value of.
        scale: the factors d_n, each an exact number.
        S: value of the amplitude.
        step: of the harmonics, 2 or 1.
        parameter: s, with which a term of degree p has the factor s^((p - 1)/step); 1 but along a family.
        tail: the tail that a chain's core of odd cosines is coupled to.
    """

    forces: Sequence[Terms]
    amplitude: Terms
    scale: Sequence[arb]
    S: arb
    step: int = 2
    parameter: arb | None = None
    tail: LinearTail | None = None

    @property
    def positions(self) -> int:
        return len(self.forces)

    @property
    def degree(self) -> int:
        """Highest degree of the forces."""
        return max((len(factors) for terms in self.forces for factors in terms), default=1)

    def harmonic(self, index: int) -> int:
        """The harmonic k with an index, 1, 3, 5, ... or 0, 1, 2, ..."""
        return self.step * (index + 1) - 1

    def scaled(self, row: int | None) -> list[tuple[Factors, arb]]:
        """Terms of the acceleration of q_row, or of the amplitude, with coefficients for scaled positions."""
        terms = self.amplitude if row is None else self.forces[row]
        result = []
        for factors, coefficient in terms.items():
            value = prod((self.scale[n] for n in factors), start=ball(coefficient))
            if row is not None:
                value /= self.scale[row]
                if self.parameter is not None:
                    value *= self.parameter ** ((len(factors) - 1) // self.step)
            result.append((factors, value))
        return result


class CosineSeries:
    """The equations and their derivatives at one lambda and one set of coefficients a_nk, H harmonics of each n."""

    def __init__(self, system: CosineSystem, square: arb, coefficients: Sequence[Sequence[arb]]) -> None:
        self.system, self.square, self.coefficients = system, square, coefficients
        self.harmonics = len(coefficients[0])
        self.highest = system.harmonic(self.harmonics - 1)
        self._products: dict[Factors, arb_poly] = {(): arb_poly([1])}
        for n, series in enumerate(coefficients):
            half = [a / 2 for a in series]
            middle = [] if system.step == 2 else [series[0]]
            outer = half[len(middle) :]
            self._products[n,] = arb_poly([*reversed(outer), *middle, *outer])
        self._terms = [system.scaled(n) for n in range(system.positions)]

    @classmethod
    def of(cls, system: CosineSystem, unknowns: Sequence[arb]) -> CosineSeries:
        """From lambda and the coefficients of each position in turn."""
        H = len(unknowns) // system.positions
        return cls(system, unknowns[0], [unknowns[i : i + H] for i in range(1, len(unknowns), H)])

    def _product(self, factors: Factors) -> arb_poly:
        """z^(pK) times a product of p series, a polynomial in z^step."""
        if factors not in self._products:
            self._products[factors] = self._product(factors[:-1]) * self._products[factors[-1:]]
        return self._products[factors]

    def _sum(self, terms: Sequence[tuple[Factors, arb]], last: int) -> list[arb]:
        """Coefficients of z^k of a sum of products, k = last, last - step, ... down to 0 or 1, in ascending order."""
        by_degree: dict[int, arb_poly] = {}
        step = self.system.step
        for factors, coefficient in terms:
            part = self._product(factors) * coefficient
            by_degree[len(factors)] = by_degree.get(len(factors), arb_poly()) + part
        total = [arb(0) for _ in range(last // step + 1)]
        for degree, part in by_degree.items():
            for i, k in enumerate(range(last % step, min(last, degree * self.highest) + 1, step)):
                total[i] += part[(degree * self.highest + k) // step]
        return total

    # The equations ----------------------------------------------------------------------------------------------------

    @property
    def start(self) -> list[arb]:
        """Positions q_n at theta = 0."""
        return [sum(series, arb(0)) for series in self.coefficients]

    @property
    def unknowns(self) -> list[arb]:
        """lambda and the coefficients of each position in turn."""
        return [self.square, *(a for series in self.coefficients for a in series)]

    def amplitude_residual(self) -> arb:
        """h(q(0)) - S."""
        q = self.start
        total = sum((coefficient * q[i] * q[j] for (i, j), coefficient in self.system.scaled(None)), arb(0))
        if self.tail_series is not None:
            assert self.system.tail is not None
            total += self.system.tail.amplitude(self.tail_series, self.square)
        return total - self.system.S

    def amplitude_slope(self) -> list[arb]:
        """Derivatives of h(q(0)) with respect to q_n(0), shape (positions,)."""
        q, slope = self.start, [arb(0) for _ in range(self.system.positions)]
        for (i, j), coefficient in self.system.scaled(None):
            slope[i] += coefficient * q[j]
            slope[j] += coefficient * q[i]
        return slope

    def residual(self, n: int) -> list[arb]:
        """Coefficients of cos(k theta) in the equation of q_n, for every k that occurs."""
        values = self._sum(self._terms[n], self.system.degree * self.highest)
        values = [2 * value if self.system.harmonic(i) else value for i, value in enumerate(values)]
        for i, a in enumerate(self.coefficients[n]):
            values[i] += self.square * self.system.harmonic(i) ** 2 * a
        tail = self.system.tail
        if tail is not None and n == tail.site:
            for i, a in enumerate(self.coefficients[n]):
                values[i] += tail.coupling * tail.share(2 * i + 1, self.square) * a
        return values

    def residuals(self) -> tuple[list[arb], list[tuple[int, int, arb]]]:
        """Those of the amplitude and of H harmonics of each position; beyond, position, harmonic and value of each."""
        finite, beyond = [self.amplitude_residual()], list[tuple[int, int, arb]]()
        for n in range(self.system.positions):
            values = self.residual(n)
            finite += values[: self.harmonics]
            beyond += [(n, self.system.harmonic(i), values[i]) for i in range(self.harmonics, len(values))]
        return finite, beyond

    @property
    def tail_series(self) -> Sequence[arb] | None:
        """Coefficients at the site that a tail is coupled to; None without a tail."""
        return None if self.system.tail is None else self.coefficients[self.system.tail.site]

    def derivatives(self, m: int) -> dict[int, list[arb]]:
        """For each q_n that force m depends on, the coefficients g_p of z^p, p = 0, step, ..., of d force_m/d q_n."""
        parts: dict[int, list[tuple[Factors, arb]]] = {}
        for factors, coefficient in self._terms[m]:
            for place, n in enumerate(factors):
                parts.setdefault(n, []).append((factors[:place] + factors[place + 1 :], coefficient))
        last = (self.system.degree - 1) * self.highest
        return {n: self._sum(terms, last) for n, terms in parts.items()}


# The exact polynomials of a model: forces, amplitude and conserved quantity, as fractions -----------------------------


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
    def of(cls, coordinates: Coordinates, decimals: bool) -> ExactEquations:
        """Those of the model of coordinates, at the values of their parameters; at 0 of the one that stands for S."""
        model = coordinates.model
        numbers: Mapping[str, Number | None] = {}
        if isinstance(model, Lattice):
            model, numbers = model.with_numbers_apart

        def value(name: str) -> Fraction | None:
            if name not in numbers:
                return exact(float(coordinates.parameters.get(name, 0.0)), decimals)
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
    equations = ExactEquations.of(coordinates, decimals)
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


def _near(logarithm: float) -> arb:
    """A number with the digits of a double near exp(log), of any size."""
    power = round(logarithm / log(2.0))
    return arb(exp(logarithm - power * log(2.0))) * arb(2) ** power


def energy_terms(coordinates: Coordinates, forces: Sequence[Terms], decimals: bool = False) -> Terms | None:
    """Terms of the conserved quantity at rest, above its value at 0, in the model's positions; None without one.

    The energy that the model declares, or for coordinates that declare one the potential of its forces.
    """
    equations = ExactEquations.of(coordinates, decimals)
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
    products = (prod((values[n] for n in factors), start=ball(c)) for factors, c in terms.items())
    return sum(products, arb(0))


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


# The equations of a chain's core with the linear tail that it is coupled to -------------------------------------------


def tailed_system(coordinates: LongChain, S: float, decimals: bool) -> CosineSystem:
    """The equations of the core, in the order of its sites, with the tail that they are coupled to."""
    chain, sites = coordinates.chain, coordinates.core.cells
    alone = FullChain(replace(chain, sites=sites), 1)
    if coordinates.declared is not None:
        lattice, values = coordinates.declared
        alone.declared = lattice.of_cells(sites), values
    core = system_of(alone, S, 2, decimals)
    weak, strong = sorted((core.forces[0][1,], core.forces[1][0,]))  # 1 - |gamma| and 1 + |gamma|
    ratio = ball(weak / strong)
    inner = 0 if chain.gamma > 0 else sites - 1
    unit = core.scale[sites - 1 - inner]
    scale = [unit * ratio.sqrt() ** (sites - 1 - abs(n - inner)) for n in range(sites)]
    system = replace(core, scale=scale)
    terms = dict(system.scaled(inner))
    tail = LinearTail(
        inner,
        int(coordinates.output_sites[0]),
        None if chain.infinite else int(chain.sites) - sites,
        -terms[inner,],
        ball(weak * strong).sqrt(),
        ratio,
        abs(terms[inner, inner, inner]),
        scale[inner] ** 2,
    )
    return replace(system, tail=tail)
