"""The objects that computing one family needs, each built when first used."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Problem
from casadi_skin.bvp.shooting import ShootingProblem
from casadi_skin.bvp.symmetry import SymmetryClass, symmetry_class
from casadi_skin.bvp.trigonometric import TrigonometricProblem
from casadi_skin.continuation.arclength import ArclengthContinuation
from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.continuation.points import Point, Walk
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.lattice.full_chain import EdgeSite, FullChain
from casadi_skin.lattice.tail_problem import CoreWithTailProblem
from casadi_skin.models.ode import OdeModel
from casadi_skin.solvers.corrector import Corrector
from casadi_skin.solvers.ipopt import IpoptCorrector
from casadi_skin.solvers.levels import Levels
from casadi_skin.solvers.newton import NewtonCorrector
from casadi_skin.stability.cvodes import CvodesFlow
from casadi_skin.stability.flow import FlowMap
from casadi_skin.stability.gauss_flow import GaussFlow
from casadi_skin.stability.rk4 import RungeKuttaFlow
from casadi_skin.stability.splitting import SplittingFlow

if TYPE_CHECKING:
    from casadi_skin.bvp.recursion import PolynomialForm, TaylorRecursion
from casadi_skin.orbits.request import COLLOCATIONS, FamilyRequest

HARMONICS = (4, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 64, 80, 96, 128, 160, 192, 256)
MANY_HARMONICS = (320, 384, 512)  # where few sites make them cheap
INTERVALS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
DIGITS = (8, 10, 12, 14, 15)  # of CVODES' local tolerance: fewer cost as much, and their noise refuses more steps
SHOOTING_SHARE = 0.03  # of the tolerance, local: an orbit's error is 10 to 1000 local tolerances
SHOOTING_NOISE = 10.0  # local tolerances, which a corrector of shooting may leave
ROUND_OFF = 2e-15  # of a residual relative to the state, per square of the resolution
LARGEST = 10_000_000  # sites times harmonics squared: what fits into about a gigabyte
CHEAP = 1_000_000  # the same: what takes a fraction of a second to solve
LONGEST_WHOLE = 5000  # sites of a chain whose stability is computed: all of them take part
SERIES_PRECISION = 1e-6  # of a residual: what is left before Newton's step
SERIES_ORDERS = 24  # cost of a step over its length is flat between 20 and 35


class FamilyTools:
    """Model, problems, correctors and flow map of a request; nothing exists before it is asked for.

    Tools made once serve any number of walks of the same request.
    """

    def __init__(self, request: FamilyRequest) -> None:
        self.request = request
        self._recursions: dict[int, TaylorRecursion] = {}

    @cached_property
    def layout(self) -> FullChain | CoreWithTail:
        """Which sites are unknown: all, those where the cubic term is felt, or at |gamma| = 1 the edge site alone."""
        request, chain = self.request, self.request.chain
        if abs(chain.gamma) == 1.0:
            return EdgeSite(Chain(1, chain.alpha, 0.0, chain.g), 1, chain)
        if request.tailed:
            return CoreWithTail(
                chain, replace(chain, sites=request.core_sites, gamma=abs(chain.gamma)), -1 if chain.g > 0 else 1
            )
        return FullChain(chain, request.mode)

    @property
    def core(self) -> Chain:
        """The chain whose equations are solved in the gauge."""
        return self.layout.core

    @property
    def linear_frequency(self) -> float:
        """Frequency of the linear mode that the family grows from."""
        alone = isinstance(self.layout, EdgeSite)
        return self.core.linear_frequency(1) if alone else self.request.chain.linear_frequency(self.request.mode)

    @property
    def linear(self) -> tuple[Chain, int] | None:
        """Chain and mode whose closed formulas hold for the family; None in an infinite chain."""
        if isinstance(self.layout, EdgeSite):
            return self.core, 1
        return None if self.request.chain.infinite else (self.request.chain, self.request.mode)

    @cached_property
    def whole(self) -> FamilyTools:
        """Tools of the same family with every site an unknown; raises ValueError where these are too many."""
        chain = self.request.chain
        if chain.sites > LONGEST_WHOLE:
            raise ValueError(
                f"sites: given {chain.sites}; stability is that of all sites, accepted: up to {LONGEST_WHOLE}"
            )
        return FamilyTools(replace(self.request, tail="full"))

    @cached_property
    def model(self) -> OdeModel:
        """The scaled equations in the gauge."""
        return self.core.gauge_model()

    @cached_property
    def rhs(self) -> ca.Function:
        """Function (q, kappa) -> acceleration and its derivatives."""
        return self.model.rhs_and_jacobian()

    @cached_property
    def hamiltonian(self) -> ca.Function:
        """Function (q, q', kappa) -> energy of the scaled gauge coordinates."""
        model = self.model
        return ca.Function("H", [model.state, model.velocity, model.parameters], [model.hamiltonian])

    @cached_property
    def symmetry(self) -> SymmetryClass:
        """Part of the period that is unknown."""
        return self.request.symmetry or symmetry_class(self.model)

    @cached_property
    def levels(self) -> Levels:
        """Discretisations from coarse to fine with their correctors."""
        if self.request.transcription == "shooting":
            useful = [d for d in DIGITS[:-2] if 10.0**-d <= SHOOTING_SHARE * self.request.tolerance]
            return Levels(self._problem, self._corrector, (*useful, *DIGITS[-2:]))
        if self.request.transcription in COLLOCATIONS:
            return Levels(self._problem, self._corrector, INTERVALS)
        fits = [H for H in HARMONICS if self.core.sites * H**2 <= LARGEST]
        fits += [H for H in MANY_HARMONICS if self.core.sites * H**2 <= CHEAP]
        return Levels(self._problem, self._corrector, tuple(fits or HARMONICS[:2]))

    @cached_property
    def point_solver(self) -> PointSolver:
        """What makes points of the family at its tolerance."""
        return PointSolver(self.levels, self.request.continuation_settings())

    @cached_property
    def start(self) -> Point:
        """The linear mode at S = 0 with the tangent of the family."""
        layout = self.layout
        frequency = layout.start if isinstance(layout, CoreWithTail) else self.linear_frequency
        return self.point_solver.start(layout.mode, frequency)

    def walk(self, history: tuple[Point, ...]) -> Walk:
        """The way along the family from the last points walked, or from `start`."""
        if self.request.way == "arclength":
            return ArclengthContinuation(self.point_solver, history)
        from casadi_skin.continuation.series import SeriesContinuation

        def precision(problem: Problem) -> float:
            allowed = max(self.corrector_tolerance, ROUND_OFF * problem.resolution**2)
            return min(0.1 * math.sqrt(allowed), SERIES_PRECISION)  # Newton's step squares it

        return SeriesContinuation(self.point_solver, history, self._recursion, precision)

    def _recursion(self, problem: Problem) -> TaylorRecursion:
        """Power series on one level of the levels, made once."""
        from casadi_skin.bvp.recursion import TaylorRecursion

        assert isinstance(problem, TrigonometricProblem)
        if problem.resolution not in self._recursions:
            self._recursions[problem.resolution] = TaylorRecursion(problem, self._polynomial_form, SERIES_ORDERS)
        return self._recursions[problem.resolution]

    @cached_property
    def _polynomial_form(self) -> PolynomialForm:
        from casadi_skin.bvp.recursion import PolynomialForm

        return PolynomialForm.of(self.model)

    def _problem(self, resolution: int) -> Problem:
        if isinstance(self.layout, CoreWithTail):
            return CoreWithTailProblem(self.model, resolution, self.layout.parameter(resolution))
        if self.request.transcription == "trigonometric":
            return TrigonometricProblem(self.model, resolution)
        if self.request.transcription == "shooting":
            return ShootingProblem(self.model, resolution, self.symmetry)
        make = COLLOCATIONS[self.request.transcription]
        return make(self.model, resolution, self.symmetry, self.request.collocation_degree)

    @property
    def corrector_tolerance(self) -> float:
        """What a corrector may leave of the residual, relative to the state, where round-off allows it."""
        return float(np.clip(1e-2 * self.request.tolerance, 1e-12, 1e-6))

    def _corrector(self, problem: Problem) -> Corrector:
        tolerance = self.corrector_tolerance
        if isinstance(problem, ShootingProblem):
            tolerance = max(tolerance, SHOOTING_NOISE * 10.0**-problem.resolution)
        if self.request.corrector == "newton":
            return NewtonCorrector(problem, tolerance)
        return IpoptCorrector(problem, max(tolerance, ROUND_OFF * problem.resolution**2))

    @cached_property
    def flow(self) -> FlowMap:
        """Flow map of the variational system."""
        make: dict[str, Callable[[OdeModel, float], FlowMap]] = {
            "splitting": SplittingFlow,
            "cvodes": CvodesFlow,
            "gauss": GaussFlow,
            "rk4": RungeKuttaFlow,
        }
        return make[self.request.flow](self.model, self.request.tolerance)
