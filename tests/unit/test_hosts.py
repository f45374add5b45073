"""What hosts and strangers rely on: plain pytest runs the tests, and what stands in several files is the same."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from outputs import module_at

from casadi_skin import __version__

CLONE = Path(__file__).parents[2]
PROJECT = tomllib.loads((CLONE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WITH_THE_ADDRESS = ("CITATION.cff", "conda/recipe.yaml", "mkdocs.yml", "pyproject.toml")
WITH_THE_VERSION = ("CHANGELOG.md", "CITATION.cff", "casadi_skin/_version.py", "conda/recipe.yaml")
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


def text_of(name: str, root: Path = CLONE) -> str:
    return (root / name).read_text(encoding="utf-8")


def versions(root: Path) -> tuple[set[str], str, str]:
    """Versions that the files say, the date of the newest one in CHANGELOG.md, and that of CITATION.cff."""
    newest = re.search(r"^## (\S+) \((.*)\)$", text_of("CHANGELOG.md", root), re.MULTILINE)
    assert newest
    citation = text_of("CITATION.cff", root)
    found = {newest[1], *re.findall(r"^version: (.*)$", citation, re.MULTILINE)}
    found |= set(
        re.findall(r'^(?:__version__ = |  version: )"(.*)"$', text_of("casadi_skin/_version.py", root), re.MULTILINE)
    )
    found |= set(re.findall(r'^  version: "(.*)"$', text_of("conda/recipe.yaml", root), re.MULTILINE))
    return found, newest[2], "".join(re.findall(r"^date-released: (.*)$", citation, re.MULTILINE)) or "unreleased"


def test_one_version_and_one_date_stand_everywhere() -> None:
    found, day, cited = versions(CLONE)
    assert found == {__version__}
    assert day == cited
    if os.environ.get("GITHUB_REF_TYPE") == "tag":  # a release
        assert os.environ["GITHUB_REF_NAME"] == f"v{__version__}"
        assert re.fullmatch(r"\d{4}-\d\d-\d\d", day)


def test_a_release_fills_in_its_version_and_date(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in WITH_THE_VERSION:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(CLONE / name, tmp_path / name)
    script = module_at(CLONE / ".ci" / "version.py")
    monkeypatch.setattr(script, "ROOT", tmp_path)
    before = text_of("CHANGELOG.md", tmp_path)
    for words, expected in (
        ([__version__, "2031-02-03"], ({__version__}, "2031-02-03", "2031-02-03")),
        (["7.0.0", "unreleased"], ({"7.0.0"}, "unreleased", "unreleased")),
        (["7.0.0", "2032-03-04"], ({"7.0.0"}, "2032-03-04", "2032-03-04")),
    ):
        script.main(*words)
        assert versions(tmp_path) == expected
    assert f"## 7.0.0 (2032-03-04)\n\n## {__version__} (2031-02-03)\n" in text_of("CHANGELOG.md", tmp_path)
    assert text_of("CHANGELOG.md", tmp_path).endswith(before.partition(")\n")[2])


def test_the_repository_has_one_address() -> None:
    source, site = PROJECT["urls"]["Source"], PROJECT["urls"]["Documentation"]
    words = "".join(text_of(name) for name in WITH_THE_ADDRESS)
    assert set(re.findall(rf"https://[^/\s]+/[^/\s]+/{source.rpartition('/')[2]}\b", words)) == {source}
    assert set(re.findall(r"https://[\w-]+\.github\.io/[\w/-]*", words)) == {site}


def test_an_index_of_packages_shows_pictures_and_follows_links() -> None:
    core = pytest.importorskip("hatchling.metadata.core")
    manager = pytest.importorskip("hatchling.plugin.manager").PluginManager()
    shown = core.ProjectMetadata(str(CLONE), manager).core.readme
    links = re.findall(r"\]\(([^)#]+)", shown)
    assert len(links) == len(re.findall(r"\]\(([^)#]+)", text_of("README.md"))) > 20
    assert all(link.startswith("https://") for link in links)
    within = [link.removeprefix(f"{PROJECT['urls']['Source']}/").split("/", 2) for link in links if "casadi" in link]
    pictures = [path for kind, tag, path in within if (kind, tag) == ("raw", f"v{__version__}")]
    pages = [path for kind, tag, path in within if (kind, tag) == ("blob", f"v{__version__}")]
    assert pictures == ["docs/pictures/overview.png"]
    assert all((CLONE / path).is_file() for path in pictures + pages)


def test_ci_runs_the_test_line_of_the_readme() -> None:
    (line,) = re.findall(r"^python3 -m venv .*/(pytest .*)$", text_of("README.md"), re.MULTILINE)
    assert f"bin/{line}'" in text_of(".ci/run")
    assert f"python -m {line}\n" in text_of(".github/workflows/tests.yml")
