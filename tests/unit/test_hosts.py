"""What hosts and strangers rely on: plain pytest runs the tests, and what stands in several files is the same."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

CLONE = Path(__file__).parents[2]
WARNS = "import warnings\n\ndef test_it():\n    warnings.warn('of a newer version', FutureWarning)\n"


@pytest.mark.parametrize(("environment", "words"), [({"CI": ""}, "1 passed, 1 warning"), ({"CI": "true"}, "1 failed")])
def test_pytest_runs_without_plugins_and_a_warning_is_a_failure_in_ci_alone(
    environment: dict[str, str], words: str, tmp_path: Path
) -> None:
    (tmp_path / "test_it.py").write_text(WARNS, encoding="utf-8")
    tests = str(CLONE / "tests")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:xdist", "-p", "no:cacheprovider", "--rootdir", str(CLONE),
         "-c", str(CLONE / "pyproject.toml"), "--confcutdir", tests, "-p", "conftest", "test_it.py"],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([tests, str(CLONE)])} | environment,
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert words in done.stdout, done.stdout + done.stderr
