"""Formulas in characters: which, with glyphs that the font has, and as wide as matplotlib sets them."""

import pytest
from matplotlib.font_manager import FontProperties, findfont, get_font
from matplotlib.textpath import TextPath

from casadi_skin.results.figures.style import FORMULA_SYMBOLS, in_letters, style

WRITTEN = {
    "$S = 0.2$ (passage 2)": "𝑆 = 0.2 (passage 2)",
    r"total amplitude $S = \Vert y\Vert^2$": "total amplitude 𝑆 = ‖𝑦‖²",
    r"$N = \infty$, $\alpha = 1$, $\gamma = 0.25$, $g = -1$": "𝑁 = ∞, 𝛼 = 1, 𝛾 = 0.25, 𝑔 = −1",
    r"(c)  $S = 1$, max $\left|\lambda\right| = 1.171$": "(c)  𝑆 = 1, max |𝜆| = 1.171",
    r"frequency $\Omega$": "frequency Ω",
}


@pytest.mark.parametrize("formula", WRITTEN)
def test_simple_formulas_are_characters(formula: str) -> None:
    assert in_letters(formula) == WRITTEN[formula]


@pytest.mark.parametrize(
    "formula",
    [
        r"$y_n(0)\,/\,\Vert y\Vert$",
        r"$3\times 10^{4}$",
        r"$\frac{a}{b}$",
        r"$\sqrt{a}$",
        "$S = 1$ and $x_1$",
        r"a \$ sign, and \$ another",
        "no formula",
    ],
)
def test_other_texts_stay_as_they_are(formula: str) -> None:
    assert in_letters(formula) == formula


def test_the_font_has_every_character() -> None:
    with style():
        glyphs = get_font(findfont(FontProperties())).get_charmap()
    assert not {character for text in FORMULA_SYMBOLS.values() for character in text if ord(character) not in glyphs}


@pytest.mark.parametrize("formula", WRITTEN)
def test_characters_take_as_much_room_as_the_formula(formula: str) -> None:
    with style():
        set_by_matplotlib, letters = (TextPath((0, 0), text).get_extents() for text in (formula, in_letters(formula)))
    assert letters.width == pytest.approx(set_by_matplotlib.width, rel=0.1)
