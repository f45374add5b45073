"""Tables of the summaries: aligned, whole however wide, with bold names on a terminal alone."""

import sys

import pytest

from casadi_skin.runs.output import print_table


@pytest.mark.parametrize("on_terminal", [False, True])
def test_cells_end_where_the_names_of_their_columns_end(
    on_terminal: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: on_terminal)
    print_table("[title] of a scene", ["mode", "Omega"], [("1", "0.7659589"), ("24",), ("x" * 100, "1")])
    title, head, first, second, third = capsys.readouterr().out.splitlines()
    assert title == "[title] of a scene"
    assert ("\033[1m" in head) == on_terminal
    plain = head.removeprefix("\033[1m").removesuffix("\033[0m")
    assert [plain.index("mode") + 4, len(plain)] == [101, 112]
    assert (first[100], first[103:], second[99:]) == ("1", "0.7659589", "24")
    assert third == f" {'x' * 100}          1"
