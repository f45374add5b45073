"""An imported FMU as a file: its description is checked, and its necessary parts are unpacked."""

from __future__ import annotations

import hashlib
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from xml.parsers.expat import ParserCreate

from casadi_skin.fmu.unzip import Archive
from casadi_skin.model.files import TemporaryFolder

DESCRIPTION_FILE = "modelDescription.xml"
LARGEST_DESCRIPTION = 1 << 26  # bytes
MOST_ELEMENTS = 1_000_000  # of XML in a description
MOST_VARIABLES = 100_000
MOST_STATES = 2_000
LARGEST_REFERENCE = (1 << 32) - 1  # of FMI's functions
DEEPEST_XML = 100  # elements of XML within each other
CHUNK_BYTES = 1 << 16  # bytes
PLATFORMS = ("linux", "darwin")  # where FMUs are compiled and run


def fmpy_package() -> Any:
    """The package fmpy; raises ValueError where it is not installed."""
    try:
        import fmpy
    except ImportError as error:
        raise ValueError("fmpy is not installed; accepted: pip install 'casadi-skin[fmu]'") from error
    return fmpy


def library_name(fmi: str, identifier: str) -> str:
    """Name of this platform's library in an FMU of FMI 2.0 or 3.0; raises ValueError on other platforms."""
    fmpy = fmpy_package()
    if sys.platform not in PLATFORMS:
        raise ValueError(f"platform: {sys.platform}; accepted: {', '.join(PLATFORMS)}")
    folder = fmpy.platform if fmi.startswith("2") else fmpy.platform_tuple
    return f"binaries/{folder}/{identifier}{fmpy.sharedLibraryExtension}"


class FmuWarning(UserWarning):
    """Oddities of an FMU that do not matter for the model."""


@dataclass(frozen=True, eq=False)
class Unpacked:
    """An FMU's folder, the library in it for this platform, and its modelDescription.xml as fmpy reads it.

    `digest` is the SHA-256 of the file, `remove` removes the folder.
    """

    path: Path
    folder: Path
    library: Path
    description: Any
    remove: Callable[[], object]
    digest: str = ""


def unpack(path: str | Path) -> Unpacked:
    """Unpack an FMU for Model Exchange, without its sources, into a new temporary folder, which the caller removes.

    Raises ValueError, in one line, for other files, for FMUs that are damaged or hostile, have no Model Exchange or no
    binary for this platform, and where fmpy is missing; nothing is left behind then.
    """
    path = Path(path)
    archive = Archive(path)  # refuses pipes and devices
    try:
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        if DESCRIPTION_FILE not in archive.names:
            raise ValueError(f"{path}: no {DESCRIPTION_FILE} inside; accepted: an FMU")
        temporary = TemporaryFolder("casadi_skin_fmu_")
        try:
            archive.write(temporary.path, lambda name: name == DESCRIPTION_FILE)
            description = read_description(path, temporary.path)
            library = _library(path, description, archive.names)
            wanted = ("/".join([*PurePosixPath(library).parts[:2], ""]), "resources/")
            archive.write(temporary.path, lambda name: name.startswith(wanted))
            if archive.repeated:
                names = ", ".join(sorted(archive.repeated)[:3])
                warnings.warn(f"{path}: in it more than once, and not unpacked: {names}", FmuWarning, stacklevel=3)
        except BaseException:
            temporary.remove()
            raise
    finally:
        archive.close()
    return Unpacked(path, temporary.path, temporary.path / library, description, temporary.remove, digest)


def read_description(path: Path, folder: Path) -> Any:
    """The model description of an FMU of FMI 2.0 or 3.0 with Model Exchange, as fmpy reads it."""
    fmpy = fmpy_package()
    try:
        _check_xml((folder / DESCRIPTION_FILE).read_bytes())
        description = fmpy.read_model_description(folder, validate=False)
    except Exception as error:  # fmpy raises whatever its parser meets
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"{path}: {DESCRIPTION_FILE} cannot be read: {reason or type(error).__name__}") from error
    if not str(description.fmiVersion).startswith(("2.", "3.")):
        raise ValueError(f"{path}: FMI {description.fmiVersion}; accepted: 2.0, 3.0")
    if description.modelExchange is None:
        tool = " ".join(str(description.generationTool or "its tool").split())[:80]
        why = "its solver is inside, and there is no right-hand side to ask for"
        way = f"one with Model Exchange, as {tool} may export it; fmpy.simulate_fmu runs this one"
        raise ValueError(f"{path}: no Model Exchange, Co-Simulation alone: {why}; accepted: {way}")
    return description


class _Counter:
    """Elements of a description as a parser meets them, in any encoding; raises ValueError at the first too many."""

    def __init__(self) -> None:
        self.elements = self.variables = self.states = 0
        self.open: list[str] = []

    def doctype(self, *declaration: object) -> None:
        raise ValueError("refused, it declares entities")

    def start(self, name: str, attributes: Mapping[str, str]) -> None:
        reference = attributes.get("valueReference", "0")
        if not (reference.isdecimal() and len(reference) <= 10 and int(reference) <= LARGEST_REFERENCE):
            raise ValueError(f"refused, value reference {reference[:20]!r}; accepted: 0 to {LARGEST_REFERENCE}")
        self.elements += 1
        self.variables += self.open[1:] == ["ModelVariables"]
        self.states += self.open[1:] == ["ModelStructure", "Derivatives"] or name == "ContinuousStateDerivative"
        self.open.append(name)
        for count, most, what in (
            (self.elements, MOST_ELEMENTS, "elements"),
            (self.variables, MOST_VARIABLES, "variables"),
            (self.states, MOST_STATES, "states"),
            (len(self.open), DEEPEST_XML, "elements within each other"),
        ):
            if count > most:
                raise ValueError(f"refused, more than {most} {what}")

    def end(self, name: str) -> None:
        self.open.pop()


def _check_xml(text: bytes) -> None:
    """Raises ValueError for XML that is too much for those who read all of it at once."""
    if len(text) > LARGEST_DESCRIPTION:
        raise ValueError(f"refused, {len(text)} bytes; accepted: up to {LARGEST_DESCRIPTION}")
    parser, counter = ParserCreate(), _Counter()
    parser.StartDoctypeDeclHandler = counter.doctype
    parser.StartElementHandler = counter.start
    parser.EndElementHandler = counter.end
    for start in range(0, len(text), CHUNK_BYTES):
        parser.Parse(text[start : start + CHUNK_BYTES])


def _library(path: Path, description: Any, names: tuple[str, ...]) -> str:
    """Name of the library for this platform in the archive."""
    name = library_name(description.fmiVersion, description.modelExchange.modelIdentifier)
    if name not in names:
        there = {PurePosixPath(n).parts[1] for n in names if n.startswith("binaries/")}
        found = f"binaries for {', '.join(sorted(there))}" if there else "sources alone"
        raise ValueError(f"{path}: no binary for {PurePosixPath(name).parts[1]}; it has {found}")
    return name
