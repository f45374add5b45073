"""The whole request of one run, of a chain or of any model: one scene with its tables by name."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated

import msgspec
from msgspec import Meta

from casadi_skin.model.methods import COLLOCATION, GAUSS, SPLITTING, TRIGONOMETRIC
from casadi_skin.runs.model_tables import (
    ContinuationTable,
    DynamicsTable,
    EquilibriumTable,
    ExportTable,
    FiguresTable,
    ModelTable,
    OrbitTable,
    SearchTable,
    SolutionTable,
)
from casadi_skin.runs.scene_tables import (
    AccuracyTable,
    ChainTable,
    FamilyTable,
    LatticeTable,
    MapTable,
    MethodTable,
    SpectrumTable,
    StabilityTable,
    Table,
)


class Scene(Table, frozen=True):
    """A request of one run, of a chain, a lattice or a model; a table that is None is neither built nor computed."""

    chain: ChainTable | None = None
    lattice: LatticeTable | None = None
    model: ModelTable | None = None
    spectrum: SpectrumTable | None = None
    family: FamilyTable | None = None
    equilibrium: EquilibriumTable | None = None
    orbit: OrbitTable | None = None
    solution: SolutionTable | None = None
    continuation: ContinuationTable | None = None
    stability: StabilityTable | None = None
    dynamics: DynamicsTable | None = None
    search: SearchTable | None = None
    export: ExportTable | None = None
    figures: FiguresTable = msgspec.field(default_factory=FiguresTable)
    map: MapTable | None = None
    accuracy: AccuracyTable = msgspec.field(default_factory=AccuracyTable)
    method: MethodTable = msgspec.field(default_factory=MethodTable)
    title: Annotated[str | None, Meta(title="Title of the results", description="a string")] = None
    time_limit: Annotated[
        Annotated[float, Meta(gt=0.0, le=1e7)] | None,
        Meta(title="Seconds that a run or a map may take", description="a number > 0 and <= 1e7"),
    ] = None

    @property
    def sites(self) -> float | None:
        """Number of sites of the chain, infinite for an endless one; None where the scene is one of a model."""
        return None if self.chain is None else self.chain.sites

    def modes(self) -> tuple[int | str, ...]:
        """The modes whose families are followed, numbers where the chain's length is known."""
        if self.family is None:
            return ()
        requested = self.family.mode if isinstance(self.family.mode, tuple) else (self.family.mode,)
        return requested if self.sites is None else self.family.modes(self.sites)

    @property
    def methods(self) -> MethodTable:
        """The table [method] with the names chosen where it leaves them out, as far as the scene alone decides."""
        chosen: dict[str, str] = {}
        if self.family is not None:
            chosen = {"flow": SPLITTING} | ({} if self.chain is None else {"transcription": TRIGONOMETRIC})
        elif self.orbit is not None or self.solution is not None:
            chosen = {"flow": COLLOCATION, "transcription": GAUSS}
        left_out = {name: value for name, value in chosen.items() if getattr(self.method, name) is None}
        return msgspec.structs.replace(self.method, **left_out)

    @property
    def has_diagram(self) -> bool:
        """Whether branches that leave, or curves in two parameters, belong to the branch that is followed."""
        table = self.continuation
        further = table is not None and (table.curve is not None or bool(table.switch) or table.depth is not None)
        return self.equilibrium is not None or (further and self.family is None)

    def same_request(self, other: "Scene") -> bool:
        """Whether the other scene states the same request, whatever its title and its limit of time."""
        given = {"title": None, "time_limit": None}
        mine, theirs = (msgspec.structs.replace(s, method=s.methods, **given) for s in (self, other))
        return mine == theirs


TABLES: Mapping[str, type[Table]] = MappingProxyType(
    {
        "chain": ChainTable,
        "lattice": LatticeTable,
        "model": ModelTable,
        "spectrum": SpectrumTable,
        "family": FamilyTable,
        "equilibrium": EquilibriumTable,
        "orbit": OrbitTable,
        "solution": SolutionTable,
        "continuation": ContinuationTable,
        "stability": StabilityTable,
        "dynamics": DynamicsTable,
        "search": SearchTable,
        "export": ExportTable,
        "figures": FiguresTable,
        "map": MapTable,
        "accuracy": AccuracyTable,
        "method": MethodTable,
    }
)
