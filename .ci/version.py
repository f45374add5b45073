"""Writes a version and its date wherever they stand.

`python .ci/version.py 0.2.0` fills them for a release of today, `python .ci/version.py 0.3.0 unreleased` after it.
tests/unit/test_hosts.py compares them.
"""

import re
import sys
from datetime import date
from pathlib import Path

ROOT = Path(__file__).parents[1]


def write(name: str, pattern: str, words: str) -> None:
    """Put words in the place of what the pattern finds, once, in a file of the repository."""
    text, count = re.subn(pattern, words, (ROOT / name).read_text(encoding="utf-8"), count=1, flags=re.MULTILINE)
    if not count:
        raise SystemExit(f"{name}: nothing like {pattern}")
    (ROOT / name).write_text(text, encoding="utf-8", newline="\n")


def main(version: str, day: str = "") -> None:
    day = day or date.today().isoformat()
    write("casadi_skin/_version.py", r'__version__ = ".*"', f'__version__ = "{version}"')
    write("conda/recipe.yaml", r'^  version: ".*"', f'  version: "{version}"')
    released = "" if day == "unreleased" else f"\ndate-released: {day}"
    write("CITATION.cff", r"^version: .*(\ndate-released: .*)?", f"version: {version}{released}")
    known = f"## {version} (" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = f"## {version} ({day})"
    if known:
        write("CHANGELOG.md", rf"^## {re.escape(version)} \(.*\)$", heading)
    else:
        write("CHANGELOG.md", r"\A# Changelog\n", f"# Changelog\n\n{heading}\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
