"""Archives and binaries made to do harm: nothing is written elsewhere, nothing hangs, nothing is left behind."""

from __future__ import annotations

import os
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest
from foreign_fmus import recompiled

from casadi_skin import Chain, import_fmu
from casadi_skin.fmu import model as fmu_trial
from casadi_skin.fmu import unzip
from casadi_skin.fmu.archive import export_fmu

UNZIP = Path(unzip.__file__)
HERE = sys.executable


@cache
def interpreters() -> list[str]:
    """This Python, and those of other versions from 3.11 on that the machine has."""
    found = {sys.version_info[:2]: HERE}
    known = [*Path("/usr/bin").glob("python3.1?"), *Path.home().glob(".pyenv/versions/3.1*/bin/python3.1?")]
    for path in [*known, *filter(None, (shutil.which(f"python3.{minor}") for minor in range(11, 20)))]:
        version = tuple(int(part) for part in Path(path).name.removeprefix("python").split("."))
        works = subprocess.run([str(path), "-c", ""], capture_output=True, check=False).returncode == 0
        if version >= (3, 11) and works:
            found.setdefault(version, str(path))
    return [found[version] for version in sorted(found)]


def unicode_path(stored: str, shown: str, version: int = 1) -> bytes:
    """Info-ZIP's extra field 0x7075: another name for the file that is stored under the first."""
    content = struct.pack("<BL", version, zlib.crc32(stored.encode())) + shown.encode()
    return struct.pack("<HH", 0x7075, len(content)) + content


def archive_with(path: Path, stored: str, shown: str) -> Path:
    member = zipfile.ZipInfo(stored)
    member.extra = unicode_path(stored, shown)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", b"<x/>")
        archive.writestr(member, b"harm")
    return path


PROGRAM = """
import importlib.util, pathlib, sys
spec = importlib.util.spec_from_file_location("unzip", sys.argv[1])
unzip = importlib.util.module_from_spec(spec)
spec.loader.exec_module(unzip)
try:
    unzip.Archive(pathlib.Path(sys.argv[2])).write(pathlib.Path(sys.argv[3]), lambda name: True)
    print("written")
except ValueError as error:
    print(error)
"""


def unpacked_by(interpreter: str, archive: Path, folder: Path) -> str:
    folder.mkdir(parents=True)
    command = [interpreter, "-W", "error", "-c", PROGRAM, str(UNZIP), str(archive), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.strip()


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    "name", ["../evil.txt", "/evil.txt", "resources/../../evil.txt", "a\\..\\..\\evil.txt", "c:evil.txt"]
)
def test_a_second_name_leads_nowhere_else(name: str, tmp_path: Path) -> None:
    """Python 3.12 and newer put the name of extra field 0x7075 in place of the one that archives show elsewhere."""
    archive = archive_with(tmp_path / "evil.fmu", "resources/good.txt", name)
    show = f"import zipfile; print(zipfile.ZipFile({str(archive)!r}).infolist()[1].filename)"
    for number, interpreter in enumerate(interpreters()):
        before, deep = files(tmp_path), tmp_path / f"deep{number}"
        said = unpacked_by(interpreter, archive, deep / "folder")
        replaced = subprocess.run([interpreter, "-c", show], capture_output=True, text=True, check=True).stdout.strip()
        if replaced == "resources/good.txt":  # Python 3.11 takes no second name
            assert said == "written"
            assert files(deep) == {"folder/modelDescription.xml", "folder/resources/good.txt"}
        else:
            assert said.endswith(f"refused: the file {replaced!r} would leave the folder it is unpacked in")
            assert files(deep) == set()
        assert files(tmp_path) - before <= {f"{deep.name}/{found}" for found in files(deep)}


def test_two_files_of_one_name_and_names_that_are_none(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "twice.fmu", "w") as archive:
        archive.writestr("resources/a", b"1")
        archive.writestr("resources//a", b"2")
    empty = archive_with(tmp_path / "empty.fmu", "resources/good.txt", "")  # Python 3.12 warns of it
    for number, interpreter in enumerate(interpreters()):
        assert unpacked_by(interpreter, tmp_path / "twice.fmu", tmp_path / f"one{number}").endswith(
            "refused: 'resources/a' is in it more than once; accepted: once"
        )
        assert unpacked_by(interpreter, empty, tmp_path / f"two{number}") == "written"


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_methods_that_pack_more_than_deflate_are_refused(method: int, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "packed.fmu", "w", method) as archive:
        archive.writestr("modelDescription.xml", b"<x/>")
    with pytest.raises(ValueError, match=rf"is compressed by method {method}, not deflate$"):
        unzip.Archive(tmp_path / "packed.fmu")


def test_a_small_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    """A tenth of a megabyte that unpacks to a hundred."""
    with zipfile.ZipFile(tmp_path / "bomb.fmu", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", b"<x/>")
        archive.writestr("resources/zeros", bytes(100_000_000))
    assert (tmp_path / "bomb.fmu").stat().st_size < 100_000
    begun = time.perf_counter()
    with pytest.raises(ValueError, match=r"100000004 bytes when unpacked; accepted: up to 67108864$"):
        import_fmu(tmp_path / "bomb.fmu")
    assert time.perf_counter() - begun < 1.0


# Descriptions ---------------------------------------------------------------------------------------------------------


def description(body: str) -> bytes:
    head = '<?xml version="1.0"?><fmiModelDescription fmiVersion="2.0" modelName="m" guid="g">'
    return f'{head}<ModelExchange modelIdentifier="m"/>{body}</fmiModelDescription>'.encode()


def variables(count: int) -> str:
    one = '<ScalarVariable name="x{0}" valueReference="{0}"><Real/></ScalarVariable>'
    return f"<ModelVariables>{''.join(one.format(i) for i in range(count))}</ModelVariables>"


def states(count: int) -> str:
    unknowns = "".join(f'<Unknown index="{i + 1}"/>' for i in range(count))
    return f"<ModelStructure><Derivatives>{unknowns}</Derivatives></ModelStructure>"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "words"),
    [
        (lambda: variables(600_000), "refused, more than 100000 variables"),
        (lambda: variables(10) + states(2_001), "refused, more than 2000 states"),
        (lambda: "<a/>" * 1_000_001, "refused, more than 1000000 elements"),
        (lambda: "<a>" * 200 + "</a>" * 200, "refused, more than 100 elements within each other"),
        (lambda: "<a>" + " " * (1 << 26) + "</a>", r"refused, 6710\d+ bytes; accepted: up to 67108864"),
    ],
)
def test_too_much_of_anything_is_refused_before_it_is_read(body: Callable[[], str], words: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "much.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", description(body()))
    begun = time.perf_counter()
    with pytest.raises(ValueError, match=f"^[^\n]*modelDescription.xml cannot be read: {words}$"):
        import_fmu(tmp_path / "much.fmu")
    assert time.perf_counter() - begun < 10.0


# Binaries -------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    chain = Chain(sites=2, alpha=0.8, gamma=0.3, g=1.0)
    return export_fmu(chain, tmp_path_factory.mktemp("good") / "good.fmu", "2.0")


@pytest.fixture
def own_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def spoilt(good: Path, folder: Path, harm: str) -> Path:
    """The FMU with a function that does harm when the library is loaded."""
    old = "#include <stdlib.h>"
    made = "#include <signal.h>\n#include <unistd.h>\n__attribute__((constructor)) static void harm(void) {"
    return recompiled(good, folder / "spoilt.fmu", "2.0", old, f"{old}\n{made} {harm} }}")


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        ("abort();", r"ends the process that calls it \(SIGABRT\); accepted: one that comes back"),
        pytest.param("raise(SIGSEGV);", r"ends the process that calls it \(SIGSEGV\)", marks=pytest.mark.slow),
        pytest.param("_exit(0);", r"ends the process that calls it \(exit status 0\)", marks=pytest.mark.slow),
        ("for (;;) pause();", r"does not answer within 1 s; accepted: one that does, or a longer time_limit"),
        pytest.param("for (;;) {}", r"does not answer within 1 s", marks=pytest.mark.slow),
        ("fork(); for (;;) pause();", r"does not answer within 1 s"),
        pytest.param("if (!fork()) for (;;) pause(); abort();", r"does not answer within 1 s", marks=pytest.mark.slow),
        pytest.param(
            "if (!fork()) { for (int i = 0; i < 99; i++) close(i); for (;;) pause(); } abort();",
            r"ends the process that calls it \(SIGABRT\)",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_binary_that_never_comes_back_is_refused(
    good: Path, harm: str, words: str, tmp_path: Path, own_temporary_folder: Path
) -> None:
    path = spoilt(good, tmp_path, harm)
    with pytest.raises(ValueError, match=f"^{path}: its binary {words}"):
        import_fmu(path, time_limit=1.0 if "for" in harm else 30.0)
    assert not tried_processes(own_temporary_folder)  # nor one that the binary has forked


def test_a_good_binary_is_tried_once_for_each_file_and_question(good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started = []
    real = subprocess.Popen
    monkeypatch.setattr(subprocess, "Popen", lambda *a, **k: started.append("serve(" in a[0][2]) or real(*a, **k))
    monkeypatch.setattr(fmu_trial, "_answered", set())
    for parameters in ([], [], ["g"]):
        import_fmu(good, parameters=parameters).close()
    assert sum(started) == 2


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("when", ["imported", "tried"])
def test_nothing_is_left_after_a_kill(good: Path, number: int, when: str, tmp_path: Path) -> None:
    """The folder goes, and so does the process in which a binary never answers."""
    path = good if when == "imported" else spoilt(good, tmp_path, "for (;;) pause();")
    folder = tmp_path / "temporary"
    folder.mkdir()
    program = f"""
import time
from casadi_skin import import_fmu
model = import_fmu({str(path)!r})
print("imported", flush=True)
time.sleep(100)
"""
    environment = os.environ | {"TMPDIR": str(folder)}
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None
        try:
            if when == "imported":
                assert process.stdout.readline() == b"imported\n"
            else:
                waited_for(lambda: bool(tried_processes(folder) and list(folder.iterdir())))
            assert len(list(folder.iterdir())) == 1
            process.send_signal(number)
            process.wait(20.0)
        finally:
            process.kill()
    waited_for(lambda: not list(folder.iterdir()) and not tried_processes(folder))


def waited_for(condition: Callable[[], bool]) -> None:
    until = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)


def tried_processes(folder: Path) -> list[str]:
    """Processes in which a process with that temporary folder tries a binary."""
    listed = subprocess.run(["ps", "axeww", "-o", "args"], capture_output=True, text=True, check=True).stdout
    return [line for line in listed.splitlines() if "serve(" in line and f"TMPDIR={folder}" in line]
