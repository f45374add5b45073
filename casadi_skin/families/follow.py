"""Following a family: the walk, with stability and its changes computed beside it, point by point."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.continuation.points import End
from casadi_skin.families.branch import Branch
from casadi_skin.families.events import StabilityChange, locate_change
from casadi_skin.families.orbit import Orbit
from casadi_skin.families.request import FamilyRequest, FamilyTools
from casadi_skin.models.chain import Chain
from casadi_skin.stability.flow import FlowError


class FamilyWalk:
    """Iterates over the orbits of a family and, between two of them, over the changes of stability.

    What has been computed is in `branch()` at any time, so that an interruption loses nothing. `orbits` and `changes`
    computed earlier may be given: the walk goes on from the last two points walked.
    """

    def __init__(
        self,
        tools: FamilyTools,
        stability: bool = False,
        events: bool = True,
        orbits: Sequence[Orbit] = (),
        changes: Sequence[StabilityChange] = (),
    ) -> None:
        self.tools, self.stability, self.events = tools, stability, events and stability
        self.orbits, self.changes = list(orbits), list(changes)
        self._walk = tools.walk((tools.start, *(o.point for o in self.orbits if o.point.walked)))
        self._end: End | None = None
        self._detail = ""

    def __iter__(self) -> Iterator[Orbit | StabilityChange]:
        for point in self._walk:
            orbit = Orbit(self.tools, point)
            try:
                if self.stability:
                    orbit.floquet()
                if self.events and self.orbits and self.orbits[-1].floquet().stable != orbit.floquet().stable:
                    change = locate_change(self.tools.locator, self.orbits[-1], orbit)
                    self.changes.append(change)
                    yield change
            except FlowError as error:
                self._end, self._detail = End.FLOW, str(error)
                return
            self.orbits.append(orbit)
            yield orbit

    def branch(self) -> Branch:
        """What has been computed so far."""
        request, end = self.tools.request, self._end or self._walk.end
        missed = {request.S_of(kappa) for kappa in self._walk.missed}
        if end is End.REACHED:
            missed |= set(request.at) - {orbit.S for orbit in self.orbits}
        return self.finished(end, self._detail or self._walk.detail, tuple(sorted(missed)))

    def finished(self, end: End | None, detail: str, missed: tuple[float, ...]) -> Branch:
        """The branch of what has been computed, with a known end."""
        orbits, changes = tuple(self.orbits), tuple(self.changes)
        return Branch(self.tools, self.tools.start, orbits, changes, self.stability, end, detail, missed)


def follow_family(
    chain: Chain,
    mode: int,
    amplitude_max: float,
    *,
    at: Sequence[float] = (),
    stability: bool = False,
    events: bool = True,
    tolerance: float = 1e-8,
    transcription: str = "trigonometric",
    corrector: str = "ipopt",
    flow: str = "splitting",
    symmetry: SymmetryClass | None = None,
    progress: Callable[[Orbit], None] | None = None,
) -> Branch:
    """Follow the family of nonlinear modes that grows from linear mode `mode` to S = ||y||^2 = `amplitude_max`.

    Points exactly at the values of `at` are among the orbits; `tolerance` bounds the relative error of Omega, profile
    and multipliers; `progress` is called with each orbit. A family that ends early is returned with `complete` False
    and a `reason`. Raises ValueError for arguments out of range. Method: collocation and pseudo-arclength
    continuation in the gauge (paper, Sec. II; Keller 1977).
    """
    wanted = tuple(float(S) for S in at)
    methods = (transcription, corrector, flow, symmetry)
    request = FamilyRequest(chain, mode, float(amplitude_max), wanted, tolerance, *methods)
    walk = FamilyWalk(FamilyTools(request), stability, events)
    for result in walk:
        if progress is not None and isinstance(result, Orbit):
            progress(result)
    return walk.branch()
