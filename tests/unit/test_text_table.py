"""Tables of the summaries: aligned, whole however wide, with bold names on a terminal alone."""

import sys

import pytest

from casadi_skin.runs.output import TextTable


@pytest.fixture
def table() -> TextTable:
    table = TextTable("[title] of a scene", ["mode", "Omega"])
    table.add_row("1", "0.7659589")
    table.add_row("24")
    table.add_row("x" * 100, "1")
    return table


def test_cells_end_where_the_names_of_their_columns_end(table: TextTable) -> None:
    head, first, second, third = table.lines()
    assert head.endswith("mode      Omega")
    assert [head.index("mode") + 4, len(head)] == [101, 112]
    assert (first[100], first[103:], second[99:]) == ("1", "0.7659589", "24")
    assert third == f" {'x' * 100}          1"


@pytest.mark.parametrize("on_terminal", [False, True])
def test_names_are_bold_on_a_terminal(
    table: TextTable, on_terminal: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: on_terminal)
    table.print()
    title, names, *rows = capsys.readouterr().out.splitlines()
    assert title == "[title] of a scene"
    assert ("\033[1m" in names) == on_terminal
    assert rows == table.lines()[1:]
