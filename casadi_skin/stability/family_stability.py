"""Stability of the orbits of one family, each part built on first use: flow, multipliers, localised perturbations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Any, Self

import casadi as ca
import numpy as np

from casadi_skin.model.arguments import check_name
from casadi_skin.model.ode import OdeModel
from casadi_skin.solve.levels import Levels
from casadi_skin.solve.watch import one_thread
from casadi_skin.stability.flows import CvodesFlow, FlowMap, OrbitState, SplittingFlow, Transition, complement
from casadi_skin.stability.multipliers import floquet_vectors, floquets, vectors_of_map
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Floquet, reversible_floquet
from casadi_skin.zero.coordinates import Coordinates
from casadi_skin.zero.family import FamilyRequest
from casadi_skin.zero.problem import Array, Buffers, Problem
from casadi_skin.zero.settings import Point, Refinement

if TYPE_CHECKING:
    from casadi_skin.stability.tongues.hill import EdgeHill
    from casadi_skin.zero.coordinates import Localised

STABILITY_BATCH = 32  # points whose stability is computed at a time: an interruption writes none that wait for it


FLOWS: Mapping[str, Callable[[OdeModel, float, Array | None], FlowMap]] = {
    "splitting": SplittingFlow,
    "cvodes": CvodesFlow,
}


class FamilyStability(ABC):
    """The orbits of one family and their stability; `levels` are its equations by resolution."""

    def __init__(self, request: FamilyRequest) -> None:
        self.request = request
        self._cuts: dict[int, Self] = {}

    @property
    @abstractmethod
    def levels(self) -> Levels:
        """Discretisations from coarse to fine with their correctors."""

    @property
    def model(self) -> Any:
        """The model that the family belongs to."""
        return self.request.model

    @property
    def coordinates(self) -> Coordinates:
        """The coordinates that the family is solved in."""
        return self.request.coordinates

    @property
    def tolerance(self) -> float:
        """Relative error of Omega, profile and multipliers."""
        return self.request.tolerance

    @cached_property
    def whole(self) -> Self:
        """The same family with every position an unknown, as its stability needs."""
        if self.coordinates.is_whole:
            return self
        self.coordinates.check_whole()
        return type(self)(replace(self.request, method=replace(self.request.method, tail="full", walker=None)))

    @cached_property
    def _rhs(self) -> Buffers:
        """Acceleration by position and parameter."""
        solved = self.coordinates.solved
        return Buffers(ca.Function("rhs", [solved.state, solved.parameters], [ca.densify(solved.rhs)]))

    @cached_property
    def flow(self) -> FlowMap:
        """Flow map of the variational system, of relative positions: see `frame`."""
        return self._flow(str(self.request.method.flow))

    def _flow(self, name: str) -> FlowMap:
        return FLOWS[name](self.coordinates.scaled, self.tolerance, self.frame)

    @cached_property
    def frame(self) -> Array | None:
        """Relative positions, as orthonormal columns: across free motions; None where there are none."""
        free = self.coordinates.free_motions
        return complement(free) if free.size else None

    def across(self, directions: Array) -> Array:
        """Directions (any, scaled positions) as those of relative positions."""
        return directions if self.frame is None else np.asarray(directions @ self.frame)

    @property
    def stability_batch(self) -> int:
        """Number of points whose stability is best computed together."""
        batch = 1 if self.coordinates.localised else self.whole.flow.batch
        return batch if batch == 1 else min(2 * batch, STABILITY_BATCH)

    def floquets(self, points: Sequence[Point], by: str | None = None) -> list[Floquet]:
        """Stability of several points of the family.

        Arguments:
            points: points of this family.
            by: name of a flow map, that of the request by default.

        Returns:
            One result a point; at |gamma| = 1 of a chain without the algebraic growth of its Jordan block, of a chain
            whose tail is too long or cut that of localised vectors.

        Raises:
            FlowError: the flow map cannot reach the tolerance for one of them.
            ValueError: there is no such flow map.
        """
        if by is not None:
            check_name("flow", by, FLOWS)
        if self.coordinates.localised is not None:
            with one_thread():
                return [self._localised(self.coordinates.localised, point, by) for point in points]
        whole = self.whole
        if whole is not self:
            return whole.floquets([self.on_all_positions(point) for point in points], by)
        states = [orbit_state(point) for point in points]
        flow = self.flow if by in (None, self.request.method.flow) else self._flow(str(by))
        symplectic, pairs = self.coordinates.symplectic, 1 + self.coordinates.free_motions.shape[1]
        with one_thread():
            results = floquets(flow, states, self.accelerations, self.tolerance, symplectic, pairs)
        return [self._with_resting(point, found) for point, found in zip(points, results, strict=True)]

    def _with_resting(self, point: Point, floquet: Floquet) -> Floquet:
        """The stability of all positions, from that of those which are solved for."""
        resting, frequency = self.coordinates.resting
        if not resting:
            return floquet
        phase = 0.5 * np.pi * frequency / point.Omega
        off = phase * point.error.Omega / point.Omega
        error = abs(np.sin(2.0 * phase)) * off + off**2 + np.finfo(float).eps
        mu = np.full(resting, -(np.sin(phase) ** 2), complex)
        return reversible_floquet(mu, np.full(resting, error), floquet.trivial_deviation, floquet.power)

    def _localised(self, localised: Localised, point: Point, by: str | None) -> Floquet:
        """Stability of localised perturbations, on as many sites as decide it."""
        from casadi_skin.stability.multipliers import localised_floquet

        assert self.coordinates.symplectic
        for sites in localised.sites:
            cut = self._cut(sites)
            flow = cut.flow if by in (None, self.request.method.flow) else cut._flow(str(by))
            state = self._on_cut_sites(orbit_state(point), cut)
            first, better = cut.accelerations([state, state.better or state])
            (transition,) = flow.transitions([state], self.tolerance)
            found = localised_floquet(
                transition, (first, better), self.tolerance, localised.bands, state.Omega, localised.cut_first,
                len(localised.stiffness),
            )  # fmt: skip
            if found.tail is None or not found.tail.unresolved.size:
                break
        counted = self._edge.off_circle(orbit_state(point)) if found.power == 2 else None  # of odd orbits alone
        return replace(found, counted=counted)

    @cached_property
    def _edge(self) -> EdgeHill:
        """Hill's equations of orbits at the edge of the tail."""
        from casadi_skin.stability.tongues.hill import EdgeHill

        return EdgeHill(self.coordinates)

    def _cut(self, sites: int) -> Self:
        """The same family on so many sites at the edge alone."""
        if sites not in self._cuts:
            model, mode = self.coordinates.cut(sites)
            method = replace(self.request.method, tail="full", walker=None, stability_sites=None)
            changed = {"model": model, "mode": mode, "method": method, "parameters": None, "certify": False}
            self._cuts[sites] = type(self)(replace(self.request, **changed))
        return self._cuts[sites]

    def _on_cut_sites(self, state: OrbitState, cut: Self) -> OrbitState:
        problem = cut.levels.problem(state.problem.resolution)
        better = None if state.better is None else self._on_cut_sites(state.better, cut)
        return OrbitState(problem, self.coordinates.on_cut_sites(state.problem, state.z, cut.coordinates), better)

    def accelerations(self, orbits: Sequence[OrbitState]) -> Array:
        """q'' at phase zero, shape (orbits, relative positions)."""
        groups = groupby(orbits, key=lambda orbit: orbit.problem)
        states = [problem.samples(np.stack([one.z for one in those]), np.zeros(1)) for problem, those in groups]
        starts = zip(np.concatenate(states)[:, 0], orbits, strict=True)
        return self.across(np.stack([self._rhs(start, np.array(orbit.parameter))[0].copy() for start, orbit in starts]))

    def on_all_positions(self, point: Point) -> Point:
        """A point of a family whose tail is eliminated, as a point of `whole`."""
        if self.whole is self:
            return point

        def everywhere(problem: Problem, z: Array) -> Refinement:
            target = self.whole.levels.problem(problem.resolution)
            return Refinement(target, self.coordinates.on_all_sites(problem, z))  # type: ignore[attr-defined]

        here = everywhere(point.problem, point.z)
        better = None if point.better is None else everywhere(point.better.problem, point.better.z)
        return replace(point, problem=here.problem, z=here.z, tangent=np.zeros(here.z.size), better=better)

    def transition(self, point: Point, relative: bool = True) -> tuple[Transition, Array]:
        """Transition matrix of relative positions, or of all scaled ones, and q'' at phase zero."""
        whole, everywhere = self.whole, self.on_all_positions(point)
        acceleration, flow = whole.accelerations([orbit_state(everywhere)])[0], whole.flow
        if not relative and whole.frame is not None:
            acceleration = whole.frame @ acceleration
            flow = FLOWS[str(self.request.method.flow)](whole.coordinates.scaled, self.tolerance, None)
        return flow.transition(everywhere.problem, everywhere.z), np.asarray(acceleration)

    def floquet_vectors(self, point: Point, floquet: Floquet) -> ComplexArray:
        """Floquet vectors (positions, velocities) at phase zero, shape (2n, 2n), in the order of the multipliers."""
        if self.coordinates.localised is not None:
            raise ValueError("floquet_vectors: given a tail that is cut or too long; accepted: all sites unknown")
        coordinates = self.whole.coordinates
        if coordinates.without_vectors:
            raise ValueError(f"floquet_vectors: {coordinates.without_vectors}")
        if coordinates.symplectic:
            transition, acceleration = self.transition(point)
            return floquet_vectors(transition, acceleration, coordinates.scale, self.whole.frame)
        transition, _ = self.transition(point, relative=False)
        return vectors_of_map(transition, floquet.multipliers, coordinates.scale)


def orbit_state(point: Point) -> OrbitState:
    """A point in the form that flow maps take, with the better orbit that shows its error.

    Where the point has none, as one read from a journal, the state and Omega are put off by their estimated errors.
    """
    problem, z = point.problem, point.z
    if point.better is not None:
        return OrbitState(problem, z, OrbitState(point.better.problem, point.better.z))
    if not (np.isfinite(point.error.profile) and np.isfinite(point.error.Omega)):
        return OrbitState(problem, z)
    off = z.copy()
    off[: problem.states] *= 1.0 + point.error.profile
    off[problem.Omega_index] += point.error.Omega
    off[problem.parameter_index] *= 1.0 + point.error.parameter
    return OrbitState(problem, z, OrbitState(problem, off))
