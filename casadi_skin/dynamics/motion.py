"""Equations of motion as they are integrated: in the coordinates of the model, or in a gauge that makes them symmetric.

In a gauge the positions are y = D q with a diagonal matrix D of positive factors for which the linear equations at rest
are symmetric. Without it an error at the far end of a nonreciprocal lattice is amplified on its way to the edge that
the modes lean to (Hatano and Nelson 1996).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.spectrum import linear_spectrum
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import NoQuantityError
from casadi_skin.zero.linear_modes import scale_of_couplings
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statement import named_values

GAUGE, PHYSICAL = "gauge", "physical"
LONGEST_ENVELOPE = 700.0  # of -log D: beyond, positions at the far end are below the smallest double


@dataclass(frozen=True, eq=False)
class Gauge:
    """Equations of q, where the positions are y = D q; values of their parameters, and log D, shape (positions,)."""

    model: OdeModel
    parameters: Array
    log_scale: Array

    @cached_property
    def scale(self) -> Array:
        """The factors D, shape (positions,)."""
        return np.exp(self.log_scale)


class EquationsOfMotion:
    """The equations of motion of a model at fixed values of its parameters; this class is that of any `OdeModel`.

    Attributes:
        model: the model as users see it.
        parameters: values of its parameters by name.
        gauge_is_default: whether the equations are integrated in their gauge unless it is said otherwise.
        escape: why a state may run to infinity, for messages.
        well: the displacement beyond which a position escapes; infinite where the model declares none.
    """

    gauge_is_default: bool
    escape: str = ""
    well: float = np.inf

    def __init__(self, model: OdeModel, parameters: Mapping[str, float] | None = None) -> None:
        self.model: Any = model
        self.parameters: Mapping[str, float] = named_values(model, parameters)
        gauge = self.gauge
        self.gauge_is_default = gauge is not None and 0.0 < -float(np.min(gauge.log_scale)) <= LONGEST_ENVELOPE

    @property
    def physical(self) -> OdeModel:
        """The equations in the coordinates of the model."""
        model: OdeModel = self.model
        return model

    @property
    def values(self) -> Array:
        """Values of the parameters of `physical`, in its order."""
        return np.array(list(self.parameters.values()))

    @cached_property
    def gauge(self) -> Gauge | None:
        """The equations in their gauge: of a model of second order whose linear part at 0 can be made symmetric."""
        model = self.physical
        if model.order == 1 or model.forced:
            return None
        force = ca.substitute(model.rhs, model.parameters, ca.SX(ca.DM(self.values)))
        slope = ca.Function("slope", [model.state], [ca.jacobian(force, model.state)])
        K = -np.array(slope(0.0))
        log_scale = scale_of_couplings(K, force, model.state) if np.all(np.isfinite(K)) else None
        if log_scale is None:
            return None
        D = ca.SX(ca.DM(np.exp(log_scale)))
        in_gauge = ca.substitute(force, model.state, D * model.state) / D
        scaled = OdeModel(model.name, model.state, in_gauge, order=2, velocity=model.velocity, checked=False)
        return Gauge(scaled, np.empty(0), log_scale)

    @property
    def positions(self) -> int:
        """Number of positions; 0 in a model of first order."""
        return self.physical.size if self.physical.order == 2 else 0

    @property
    def size(self) -> int:
        """Number of components of the state, positions then velocities in a model of second order."""
        return self.physical.full_size

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components of the state."""
        return self.physical.state_names

    @cached_property
    def linear_frequencies(self) -> tuple[float, float] | None:
        """Lowest and highest linear frequency, of a chain their limits; None for a model without linear modes."""
        if not self.positions:
            return None
        used = [ca.depends_on(self.physical.rhs, entry) for entry in ca.vertsplit(self.physical.parameters)]
        kept = {name: value for (name, value), in_use in zip(self.parameters.items(), used, strict=False) if in_use}
        try:
            spectrum = linear_spectrum(self.model, kept)
        except ValueError:
            return None
        low, high = np.sqrt(np.maximum(spectrum.cutoffs or spectrum.ends, 0.0))
        return float(low), float(high)

    # Coordinates ------------------------------------------------------------------------------------------------------

    def in_coordinates(self, coordinates: str) -> tuple[OdeModel, Array, Array]:
        """Equations to be integrated, values of their parameters, and factors D of the positions.

        Raises ValueError where there is no such gauge, or doubles do not hold its factors.
        """
        if coordinates == PHYSICAL:
            return self.physical, self.values, np.ones(self.physical.size)
        gauge = self._known_gauge("coordinates")
        finite = gauge.log_scale[np.isfinite(gauge.log_scale)]
        if -np.min(finite) > LONGEST_ENVELOPE:
            raise ValueError(
                f"coordinates: given gauge, in which positions span exp({np.min(finite):.4g}); accepted: down to "
                f"exp(-{LONGEST_ENVELOPE:g}), or physical"
            )
        return gauge.model, gauge.parameters, gauge.scale

    def to_gauge(self, positions: Array, name: str) -> Array:
        """q = y/D of positions y, last axis the position; raises ValueError where one that moves has no image."""
        gauge = self._known_gauge(name)
        with np.errstate(divide="ignore", invalid="ignore"):
            q = np.where(positions == 0, 0.0, positions / gauge.scale)
        absent = ~np.all(np.isfinite(q), axis=tuple(range(q.ndim - 1)))
        if np.any(absent):
            moves, accepted = self.names[int(np.argmax(absent))], 'zero there, or coordinates = "physical"'
            words = f"at {moves}, which moves and has no image in the gauge"
            raise ValueError(f"{name}: {words}; accepted: {accepted}, where no energy is kept")
        return np.asarray(q)

    def _known_gauge(self, name: str) -> Gauge:
        if self.gauge is None:
            raise ValueError(f"{name}: given gauge for {self.physical.name}, which has none; accepted: physical")
        return self.gauge

    # Energy -----------------------------------------------------------------------------------------------------------

    @property
    def conserves(self) -> bool:
        """Whether the model declares a conserved quantity, in its coordinates or in its gauge."""
        in_gauge = self.gauge is not None and self.gauge.model.hamiltonian is not None
        return in_gauge or self.physical.hamiltonian is not None

    def energy(self, states: Array) -> Array:
        """The conserved quantity that the model declares at states (many, size), shape (many,).

        Raises ValueError where it declares none, or declares one in a gauge without an image of the states.
        """
        model, values, n = self.physical, self.values, self.positions
        if not self.conserves:
            raise NoQuantityError(f"energy: {model.name} declares no hamiltonian")
        if model.hamiltonian is None:
            gauge = self._known_gauge("energy")
            model, values = gauge.model, gauge.parameters
            states = np.hstack([self.to_gauge(x, "energy") for x in (states[:, :n], states[:, n:])])
        hamiltonian = model.function("H", ca.densify(model.hamiltonian))
        return np.array(hamiltonian(0.0, states.T, values), dtype=float).ravel()


@runtime_checkable
class MovingModel(Protocol):
    """A model that hands in its equations of motion itself, as `Chain` does."""

    def equations_of_motion(self) -> EquationsOfMotion:
        """The equations of motion with their gauge; raises ValueError where they cannot be written down."""
        ...


def equations_of_motion(
    model: MovingModel | OdeModel, parameters: Mapping[str, float] | None = None
) -> EquationsOfMotion:
    """The equations of motion of a model.

    Arguments:
        model: a `Chain`, or any `OdeModel`.
        parameters: values of the parameters of an `OdeModel` by name, where they are not its nominal ones.

    Returns:
        The equations with their gauge.

    Raises:
        ValueError, TypeError: the model or a parameter is not accepted.
    """
    if isinstance(model, OdeModel):
        return EquationsOfMotion(model, parameters)
    if not isinstance(model, MovingModel):
        raise TypeError(f"model: given {short_repr(model)}; accepted: a Chain or an OdeModel")
    if parameters:
        raise ValueError(f"parameters: given {short_repr(parameters)}; accepted: with an OdeModel alone")
    return model.equations_of_motion()


# Equations of motion of a chain, in physical coordinates and in its gauge ---------------------------------------------


class ChainEquations(EquationsOfMotion):
    """Displacements y_n and velocities v_n of all sites; the energy is that of the gauge.

    Raises ValueError for an infinite chain.
    """

    gauge_is_default = True

    def __init__(self, chain: Chain) -> None:
        if chain.infinite:
            raise ValueError("sites: given an infinite chain; accepted for time evolution: a whole number >= 1")
        self.model = chain
        self.parameters = {"alpha": chain.alpha, "gamma": chain.gamma, "g": chain.g}
        if chain.g < 0:
            self.escape = "with g < 0 a large displacement leaves the well and runs to infinity in finite time"
        if chain.g < 0 and chain.alpha > -2.0:
            self.well = float(np.sqrt((2.0 + chain.alpha) / -chain.g))

    @cached_property
    def physical(self) -> OdeModel:
        chain: Chain = self.model
        return chain.physical_model()

    @property
    def values(self) -> Array:
        return np.array([self.parameters["g"]], dtype=float)

    @cached_property
    def gauge(self) -> Gauge:
        chain: Chain = self.model
        return Gauge(chain.gauge_model(), self.values, chain.log_rho)  # eta at S = 1, where kappa is g

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{x}_{n}" for x in "yv" for n in range(1, self.positions + 1))
