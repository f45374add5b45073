"""The paper again: its figures as pictures with their data beside them, and its claims checked.

Run: python examples/paper/reproduce.py [fig1 ... fig7, claims] --out DIR
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import chain
from pathlib import Path
from types import MappingProxyType

from claim import COLUMNS, Claim
from claims_families import family_claims, sensitivity_claims
from claims_linear import linear_claims
from claims_stability import stability_claims
from figures_families import Drawn, families_figure, sensitivity_figure, theory_figure
from figures_model import chain_figure, procedure_figure
from figures_stability import floquet_figure, kick_figure
from paper_data import PaperData

from casadi_skin.model.arguments import check_name
from casadi_skin.runs.output import InputError
from casadi_skin.runs.study import Study, study_program

FIGURES: Mapping[str, Callable[[PaperData], Drawn]] = MappingProxyType({
    "fig1": chain_figure,
    "fig2": procedure_figure,
    "fig3": families_figure,
    "fig4": sensitivity_figure,
    "fig5": floquet_figure,
    "fig6": kick_figure,
    "fig7": theory_figure,
})  # fmt: skip
CLAIMS = "claims"
TARGETS = (*FIGURES, CLAIMS)


def all_claims(data: PaperData) -> list[Claim]:
    """All claims in the order of the paper, numbered from 1."""
    parts = (linear_claims(data), family_claims(data), sensitivity_claims(data), stability_claims(data))
    return [replace(c, number=i) for i, c in enumerate(chain.from_iterable(parts), start=1)]


@dataclass
class PaperReproduction(Study):
    """The figures and claims of arXiv:2512.17483 in `targets`, all of TARGETS where it is empty.

    A figure is a PNG, an SVG and the CSV tables of its data; each file is replaced atomically, and a figure's files are
    written as soon as it is computed. `claims` are those checked.
    """

    targets: Sequence[str] = ()
    claims: list[Claim] = field(default_factory=list)

    part = "targets"

    def __post_init__(self) -> None:
        for name in self.targets:
            try:
                check_name("targets", name, TARGETS)
            except ValueError as error:
                raise InputError(f"reproduce: {error}") from error

    def run(self) -> None:
        data = PaperData(self.say)
        wanted = [name for name in TARGETS if name in self.targets or not self.targets]
        self.work_through(wanted, str, lambda name: self._make(name, data))

    def _make(self, name: str, data: PaperData) -> None:
        if name == CLAIMS:
            self.claims = all_claims(data)
            self.write_table(CLAIMS, COLUMNS, map(asdict, self.claims))
            return
        figure, tables = FIGURES[name](data)
        for stem, (columns, rows) in tables.items():
            self.write_table(stem, columns, rows)
        self.write_figure(name, figure)

    @property
    def verdicts(self) -> dict[str, int]:
        """Number of claims by verdict, most frequent first."""
        return dict(Counter(claim.verdict for claim in self.claims).most_common())

    def report(self) -> Iterator[str]:
        if self.claims:
            counts = ", ".join(f"{verdict}: {count}" for verdict, count in self.verdicts.items())
            yield f"{len(self.claims)} claims; {counts}"


def main(arguments: Sequence[str] | None = None) -> int:
    """The reproduction as a program; returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="reproduce.py",
        description="Recompute the figures of arXiv:2512.17483, fig1 to fig7, and check its claims.",
        epilog="Example: python examples/paper/reproduce.py fig3 claims --out results/paper",
    )
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="fig1 ... fig7, claims (default: all)")
    return study_program(
        parser, Path("results/paper"), lambda words: PaperReproduction(words.out, words.targets), arguments
    )


if __name__ == "__main__":
    sys.exit(main())
