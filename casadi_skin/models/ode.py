"""What the toolkit needs to know of a model: states, parameters, right-hand side and declared symmetries."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

Signs = tuple[int, ...]


@dataclass(frozen=True, eq=False)
class OdeModel:
    """An autonomous ODE in CasADi symbols, of first order x' = f(x, p) or second order q'' = f(q, p).

    `state` is x or q, `velocity` the symbol of q' (second order only). `reversal` and `half_period` are the signs
    R and P, one for each component of the full state (x, or q then q'), of a time reversal x(-t) = R x(t) and of
    x(t + T/2) = P x(t). `normalisation` is an expression that vanishes at phase zero of the wanted orbits: it fixes
    their amplitude (and, where no reversal does, their phase: it is stationary there). `hamiltonian` is conserved.
    `shown` are factors, one a component of `state`, that make of it what users see: errors are measured there as well.

    Raises ValueError when the shapes or the symbols do not fit.
    """

    name: str
    state: ca.SX
    rhs: ca.SX
    parameters: ca.SX
    order: int = 1
    velocity: ca.SX | None = None
    reversal: Signs | None = None
    half_period: Signs | None = None
    normalisation: ca.SX | None = None
    hamiltonian: ca.SX | None = None
    shown: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.order not in (1, 2):
            raise ValueError(f"{self.name}: order {self.order}; accepted: 1 or 2")
        if self.rhs.shape != self.state.shape:
            raise ValueError(f"{self.name}: right-hand side of shape {self.rhs.shape}, state {self.state.shape}")
        if (self.velocity is None) != (self.order == 1):
            raise ValueError(f"{self.name}: a velocity symbol belongs to a model of second order, and only there")
        if self.velocity is not None and self.velocity.shape != self.state.shape:
            raise ValueError(f"{self.name}: velocity of shape {self.velocity.shape}, state {self.state.shape}")
        if self.shown is not None and len(self.shown) != self.size:
            raise ValueError(f"{self.name}: shown needs {self.size} factors, given {len(self.shown)}")
        known = {s.element_hash() for s in ca.symvar(ca.vertcat(self.full_state, self.parameters))}
        for label in ("rhs", "normalisation", "hamiltonian"):
            expression = getattr(self, label)
            strangers = [] if expression is None else ca.symvar(expression)
            unknown = [s.name() for s in strangers if s.element_hash() not in known]
            if unknown:
                raise ValueError(f"{self.name}: {label} depends on {', '.join(unknown)}, which is not declared")
        if self.velocity is not None and ca.depends_on(self.rhs, self.velocity):
            raise ValueError(f"{self.name}: a second-order right-hand side that depends on velocity; write first order")
        for label, signs in (("reversal", self.reversal), ("half_period", self.half_period)):
            if signs is not None and (len(signs) != self.full_size or set(signs) - {1, -1}):
                raise ValueError(f"{self.name}: {label} needs {self.full_size} signs, each +1 or -1")

    @property
    def size(self) -> int:
        """Number of components of `state`."""
        return int(self.state.numel())

    @property
    def full_size(self) -> int:
        """Number of components of the first-order state."""
        return self.size * self.order

    @property
    def full_state(self) -> ca.SX:
        """The first-order state: x, or positions then velocities."""
        return self.state if self.velocity is None else ca.vertcat(self.state, self.velocity)

    @property
    def full_rhs(self) -> ca.SX:
        """Time derivative of `full_state`."""
        return self.rhs if self.velocity is None else ca.vertcat(self.velocity, self.rhs)

    def rhs_and_jacobian(self) -> ca.Function:
        """Function (state, parameters) -> (rhs, sparse d rhs/d state, d rhs/d parameters)."""
        arguments = [self.state, self.parameters]
        results = [self.rhs, ca.jacobian(self.rhs, self.state), ca.densify(ca.jacobian(self.rhs, self.parameters))]
        return ca.Function("rhs", arguments, results, ["state", "p"], ["f", "df_dstate", "df_dp"])

    def first_order(self) -> OdeModel:
        """The same model with positions and velocities as one state of first order."""
        if self.order == 1:
            return self
        return OdeModel(
            name=self.name,
            state=self.full_state,
            rhs=self.full_rhs,
            parameters=self.parameters,
            reversal=self.reversal,
            half_period=self.half_period,
            normalisation=self.normalisation,
            hamiltonian=self.hamiltonian,
        )

    def check_symmetries(self, trials: int = 5, seed: int = 0) -> None:
        """Evaluate the declared symmetries and the conserved quantity at random points.

        Raises ValueError naming the first declaration that does not hold.
        """
        x, p, field = self.full_state, self.parameters, self.full_rhs
        energy_rate = ca.SX(0) if self.hamiltonian is None else ca.jacobian(self.hamiltonian, x) @ field
        evaluate = ca.Function("check", [x, p], [field, energy_rate])
        generator = np.random.default_rng(seed)
        for _ in range(trials):
            point, parameter = generator.normal(size=self.full_size), generator.normal(size=p.numel())
            value, rate = (np.array(r).ravel() for r in evaluate(point, parameter))
            if not np.all(np.isfinite(value)):  # perhaps a root or a logarithm of a parameter
                parameter = np.abs(parameter)
                value, rate = (np.array(r).ravel() for r in evaluate(point, parameter))
            if not (np.all(np.isfinite(value)) and np.all(np.isfinite(rate))):
                raise ValueError(f"{self.name}: the right-hand side or the hamiltonian is not finite at a random point")
            scale = 1e-12 * (1.0 + np.abs(value).max())
            for label, signs, sense in (("reversal", self.reversal, -1), ("half_period", self.half_period, 1)):
                if signs is None:
                    continue
                image = np.array(evaluate(np.array(signs) * point, parameter)[0]).ravel()
                if np.abs(image - sense * np.array(signs) * value).max() > scale:
                    raise ValueError(f"{self.name}: the declared {label} is not a symmetry of the right-hand side")
            if abs(rate[0]) > scale * (1.0 + np.abs(point).sum()):
                raise ValueError(f"{self.name}: the declared hamiltonian is not conserved")
