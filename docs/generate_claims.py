"""Writes the claims in docs/paper_checked.md: every claim of the paper beside what this program computes.

Run: python docs/generate_claims.py
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "examples" / "paper"))

from claim import COLUMNS, Claim, Verdict
from paper_data import PaperData
from reproduce import all_claims

PAGE = Path(__file__).with_name("paper_checked.md")
HEADING = "## The claims\n\n"
HEADINGS = {"number": "", "ours": "computed"}


def page(claims: Sequence[Claim]) -> str:
    """The claims: a count of verdicts, then what does not agree and what agrees, each in the order of the paper."""
    counts = Counter(claim.verdict for claim in claims)
    verdicts = [f"| {verdict.value} | {counts[verdict.value]} |" for verdict in Verdict]
    agreed = [claim for claim in claims if claim.verdict == Verdict.AGREES.value]
    others = [claim for claim in claims if claim.verdict != Verdict.AGREES.value]
    parts = ["\n".join(["| verdict | claims |", "| --- | --- |", *verdicts])]
    parts += ["### What does not simply agree", _table(others), "### What agrees", _table(agreed)]
    return "\n\n".join(parts) + "\n"


def _table(claims: Sequence[Claim]) -> str:
    lines = ["| " + " | ".join(HEADINGS.get(name, name) for name in COLUMNS) + " |", "|" + " --- |" * len(COLUMNS)]
    lines += ["| " + " | ".join(_cell(str(getattr(claim, name))) for name in COLUMNS) + " |" for claim in claims]
    return "\n".join(lines)


def _cell(text: str) -> str:
    """Text that Markdown shows as it is, in one cell."""
    for special in "\\`*_{}[]<>|":
        text = text.replace(special, {"<": "&lt;", ">": "&gt;"}.get(special, "\\" + special))
    return " ".join(text.split())


if __name__ == "__main__":
    before = PAGE.read_text(encoding="utf-8").partition(HEADING)[0]
    claims = all_claims(PaperData(lambda words: print(words, file=sys.stderr)))
    PAGE.write_text(before + HEADING + page(claims), encoding="utf-8")
