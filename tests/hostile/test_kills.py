"""What a process that is killed while it draws leaves behind."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from apart import program

DRAWS = """
import os, signal
from pathlib import Path
import matplotlib.animation, matplotlib.figure
from casadi_skin import Chain, follow_family
from casadi_skin.results.figures import animate, save, style

def kill(*_, **__):
    os.kill(os.getpid(), signal.SIGKILL)
"""
CASES = {
    "a picture": """
style.lay_out = kill
matplotlib.figure.Figure.draw = kill
from matplotlib.figure import Figure
save(Figure(), Path(OUT) / "frequency", ("png",))
""",
    "a picture in vectors": """
matplotlib.figure.Figure.draw = kill
from matplotlib.figure import Figure
save(Figure(), Path(OUT) / "frequency", ("pdf",))
""",
    "a film": """
orbit = follow_family(Chain(2, 1.0, 0.25, -1.0), 1, 0.01, tolerance=1e-4).orbits[-1]
matplotlib.animation.PillowWriter.grab_frame = kill
animate(orbit, Path(OUT) / "film_j1.gif")
""",
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_process_that_is_killed_while_it_draws_leaves_nothing(case: str, tmp_path: Path) -> None:
    process = program(f"OUT = {str(tmp_path)!r}\n{DRAWS}{CASES[case]}")
    _, told = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL, told
    assert os.listdir(tmp_path) == []
