"""The paper again: its figures as pictures with their data beside them, and its claims checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from casadi_skin.results.tables import write_csv
from casadi_skin.studies.paper.paper_data import PaperData

if TYPE_CHECKING:
    from casadi_skin.studies.paper.claim import Claim

FIGURES = {  # name: module and function, imported when asked for
    "fig1": ("figures_model", "chain_figure"),
    "fig2": ("figures_model", "procedure_figure"),
    "fig3": ("figures_families", "families_figure"),
    "fig4": ("figures_sensitivity", "sensitivity_figure"),
    "fig5": ("figures_stability", "floquet_figure"),
    "fig6": ("figures_stability", "kick_figure"),
    "fig7": ("figures_families", "theory_figure"),
}
CLAIMS = "claims"
TARGETS = (*FIGURES, CLAIMS)


@dataclass
class Reproduction:
    """Files written so far, in order, and the claims where they were asked for."""

    directory: Path
    files: list[Path] = field(default_factory=list)
    claims: list[Claim] = field(default_factory=list)

    @property
    def verdicts(self) -> dict[str, int]:
        """How many claims have each verdict, most frequent first."""
        return dict(Counter(claim.verdict for claim in self.claims).most_common())


def reproduce(
    targets: Sequence[str],
    directory: Path,
    say: Callable[[str], None] = lambda words: None,
    data: PaperData | None = None,
) -> Reproduction:
    """Write the figures and claims of arXiv:2512.17483 in `targets` (all of TARGETS where empty) into `directory`.

    A figure is a PNG, an SVG and the CSV tables of what it shows; each file is replaced atomically, and a figure's
    files are written as soon as it is computed. `data` holds the computations, new ones unless given. Raises ValueError
    for an unknown target and ArithmeticError where a computation fails.
    """
    wanted = [name for name in TARGETS if name in targets or not targets]
    unknown = [name for name in targets if name not in TARGETS]
    if unknown:
        raise ValueError(f"targets: given {unknown[0]!r}; accepted: {', '.join(TARGETS)}")
    directory.mkdir(parents=True, exist_ok=True)
    data, made = data or PaperData(say), Reproduction(directory)
    for name in wanted:
        say(name)
        if name == CLAIMS:
            _write_claims(data, made)
        else:
            _write_figure(name, data, made)
    return made


def _write_figure(name: str, data: PaperData, made: Reproduction) -> None:
    from casadi_skin.figures import save

    module, function = FIGURES[name]
    figure, tables = getattr(import_module(f"casadi_skin.studies.paper.{module}"), function)(data)
    for stem, (columns, rows) in tables.items():
        path = made.directory / f"{stem}.csv"
        write_csv(path, columns, rows)
        made.files.append(path)
    made.files += save(figure, made.directory / name)


def _write_claims(data: PaperData, made: Reproduction) -> None:
    from casadi_skin.studies.paper.claims import COLUMNS, all_claims

    made.claims = all_claims(data)
    path = made.directory / "claims.csv"
    write_csv(path, COLUMNS, [asdict(claim) for claim in made.claims])
    made.files.append(path)
