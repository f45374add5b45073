"""Words of the command line that no command has, and names that would command a terminal."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenes import Cli


@pytest.mark.parametrize("name", ["\x1b[31m", "a\u202eb", "\udcff", "\x07"])
@pytest.mark.parametrize("words", [["explore"], ["schema"], ["check"], ["run", "--out"], []])
def test_names_do_not_command_the_terminal(words: list[str], name: str, cli: Cli) -> None:
    line = cli(*words, name).line
    assert line.rstrip("\n").isprintable()
    if words != ["run", "--out"]:
        assert repr(name)[1:-1] in line


@pytest.mark.parametrize("words", [["completion"], ["help"], ["schema"], ["check", "--out"], []])
def test_a_long_word_is_cut(words: list[str], cli: Cli) -> None:
    assert len(cli(*words, "x" * 5000).line) < 1000


@pytest.mark.parametrize("words", [["schema"], ["explore", "."], ["new", "chain"]])
def test_a_directory_is_no_file_to_write(words: list[str], cli: Cli, tmp_path: Path) -> None:
    folder = tmp_path / {"schema": "a", "explore": "a.html", "new": "a.toml"}[words[0]]
    folder.mkdir()
    assert f"--out: given {folder}" in cli(*words, "--out", folder).line
    assert list(tmp_path.iterdir()) == [folder]
