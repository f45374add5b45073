"""Interface of a branch: the equations of its solutions by resolution, and how their unknowns are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.settings import Continuation, End, Point, Target
from casadi_skin.follow.unresolved import Unresolved
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.solve.levels import Levels
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.problem import Indices


class SolutionSpace(Protocol):
    """Solutions of one kind that a branch connects: orbits of a family, or solutions of a boundary-value problem.

    Attributes:
        parameter: name of the continuation parameter.
        start_is_limit: whether `start` is a limit of the solutions and none of them.
        locates_folds: whether special points are located while the branch is followed.
        tolerance: relative error allowed in the solutions.
        to: value of `parameter` at which the branch ends.
        stability_included: whether stability is computed with every solution, requested or not.
        free: names of parameters that are solved for with the state.
        state_names, output_sites: names and numbers of the components in files and pictures.
        symmetry: which part of the period is unknown.
        S_rate: the relative change of S per that of the free parameter.
    """

    @property
    def parameter(self) -> str: ...
    @property
    def start_is_limit(self) -> bool: ...
    @property
    def locates_folds(self) -> bool: ...
    @property
    def tolerance(self) -> float: ...
    @property
    def to(self) -> float: ...
    @property
    def stability_included(self) -> bool: ...
    @property
    def free(self) -> Sequence[str]: ...
    @property
    def model(self) -> Any: ...
    @property
    def levels(self) -> Levels: ...
    @property
    def point_solver(self) -> PointSolver: ...
    @property
    def start(self) -> Point: ...
    @property
    def stability_batch(self) -> int: ...
    @property
    def state_names(self) -> tuple[str, ...]: ...
    @property
    def output_sites(self) -> Indices: ...
    @property
    def symmetry(self) -> SymmetryClass: ...
    @property
    def S_rate(self) -> float: ...

    def continuation(self, history: tuple[Point, ...], reported: tuple[Point, ...] = ()) -> Continuation:
        """The continuation from its last points, the start among them, and from points reported after these."""
        ...

    @property
    def held_names(self) -> tuple[str, ...]:
        """Names of the quantities that `target` accepts."""
        ...

    def target(self, name: str, value: float) -> Target:
        """Condition that a quantity has a value; raises ValueError for quantities that cannot be held."""
        ...

    def requested_values(self) -> Mapping[str, Sequence[float]]:
        """Values at which solutions are wanted, by the name of the quantity."""
        ...

    def value(self, name: str, point: Point) -> float:
        """A quantity that can be held at a point; exactly the requested value at a requested point."""
        ...

    def stop(self, point: Point) -> tuple[End | None, str]:
        """End of a branch at a point, with the reason in words; None where it goes on."""
        ...

    def special_between(self, before: Point, after: Point) -> Iterator[Point | Unresolved]:
        """Special points between two points in order, each marked by its kind, and parts where some may be missing.

        Raises NotLocatedError.
        """
        ...

    def singular_near(self, guess: Point) -> Point | None:
        """The branch point near a guess that `special_between` does not find; None where there is none."""
        ...

    def parameter_error(self, point: Point) -> float:
        """Estimated absolute error of the continuation parameter at a special point."""
        ...

    def parameters(self, point: Point) -> dict[str, float]:
        """Values of all parameters by name."""
        ...

    def interval(self, point: Point) -> tuple[float, float]:
        """Start and end of the interval, or the period from phase zero."""
        ...

    def span(self, point: Point) -> tuple[float, float]:
        """Start and end of the part of the interval that is unknown."""
        ...

    def energy(self, point: Point) -> float:
        """The conserved quantity of an orbit; raises NoQuantityError where the model declares none."""
        ...

    def floquets(self, points: Sequence[Point], by: str | None = None) -> list[Floquet]:
        """Stability of several points; raises FlowError, and ValueError where the solutions are no orbits."""
        ...

    def floquet_vectors(self, point: Point, floquet: Floquet) -> ComplexArray:
        """Floquet vectors at phase zero, one a column in the order of the multipliers."""
        ...
