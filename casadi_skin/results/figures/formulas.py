r"""Formulas without fractions, indices and roots as plain text: matplotlib's parser takes milliseconds for each.

The fonts of `house.mplstyle` have the slanted letters of mathematics among their characters.
"""

from __future__ import annotations

import re
import string
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.text import Text

FORMULA = re.compile(r"(?<!\\)\$(.+?)(?<!\\)\$")
GREEK = dict(zip(("alpha", "beta", "gamma", "lambda", "pi", "sigma", "omega"), "𝛼𝛽𝛾𝜆𝜋𝜎𝜔", strict=True))
SYMBOLS = {rf"\{name}": sign for name, sign in GREEK.items()} | {
    **{letter: chr(ord("𝑎") + i) for i, letter in enumerate(string.ascii_lowercase) if letter != "h"},
    **{letter: chr(ord("𝐴") + i) for i, letter in enumerate(string.ascii_uppercase)},
    **{sign: sign for sign in f"{string.digits} .,()/|=+"},
    "h": "ℎ",
    "-": "−",
    r"\left|": "|",
    r"\right|": "|",
    r"\Vert ": "‖",
    r"\Vert": "‖",
    r"\|": "‖",
    r"\Omega": "Ω",
    r"\Gamma": "Γ",
    r"\infty": "∞",
    "^2": "²",
}
TOKEN = re.compile("|".join(re.escape(token) for token in sorted(SYMBOLS, key=len, reverse=True)))


def in_letters(words: str) -> str:
    """A text with its formulas in characters; the text itself where one of them needs more than a line of these."""
    formulas = FORMULA.findall(words)
    if not formulas or any(TOKEN.sub("", formula) for formula in formulas):
        return words
    return FORMULA.sub(lambda found: TOKEN.sub(lambda token: SYMBOLS[token[0]], found[1]), words)


def write_in_letters(figure: Figure) -> None:
    """Titles, labels and legends of a figure in characters, where these suffice."""
    for text in _texts(figure):
        words = text.get_text()
        if "$" in words:
            text.set_text(in_letters(words))


def _texts(figure: Figure) -> Iterator[Text]:
    """All texts of a figure but those of its ticks, which their formatters make."""
    from matplotlib.text import Text

    yield from figure.texts
    legends = list(figure.legends)
    for axes in figure.axes:
        legend = axes.get_legend()
        legends += [legend] if legend is not None else []
        yield from (child for child in axes.get_children() if isinstance(child, Text))
        yield from (axes.xaxis.label, axes.yaxis.label)
    for legend in legends:
        yield from legend.get_texts()
        yield legend.get_title()
