"""FMUs that this project's exporter did not make: by CasADi's own exporter, and ours spoilt on purpose."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import casadi as ca

from casadi_skin.export.codegen import build_library, find_compiler, fmi_headers
from casadi_skin.fmu.description import library_name

Change = Callable[[bytes], bytes]


def casadi_van_der_pol(folder: Path) -> Path:
    """x' = v, v' = mu (1 - x^2) v - x."""

    def rates(x: ca.MX, v: ca.MX, mu: ca.MX) -> tuple[ca.MX, ca.MX]:
        return v, mu * (1 - x**2) * v - x

    return casadi_fmu(folder, "vdp", rates, {"x": 2.0, "v": 0.0}, {"mu": 1.0})


def casadi_fmu(
    folder: Path, model: str, rates: Callable[..., tuple[ca.MX, ...]], states: Mapping[str, float],
    parameters: Mapping[str, float],
) -> Path:  # fmt: skip
    """An FMU of FMI 3.0 by CasADi's exporter, compiled and packed by hand; values are those at the start."""
    dae = ca.DaeBuilder(model)
    dae.add("time", "independent")
    x = [dae.add(name) for name in states]
    p = [dae.add(name, "parameter", "tunable") for name in parameters]
    for state, rate in zip(x, rates(*x, *p), strict=True):
        dae.eq(dae.der(state), rate)
    for name, start in {**states, **parameters}.items():
        dae.set_start(name, start)
    for name in states:
        dae.set_initial(name, "exact")
    before = Path.cwd()
    os.chdir(folder)  # the exporter writes into the current directory
    try:
        with contextlib.redirect_stderr(io.StringIO()):  # it says that it is experimental
            files = dae.export_fmu()
    finally:
        os.chdir(before)
    name = library_name("3.0", model)
    library = folder / Path(name).name
    sources = [str(folder / name) for name in files if name.endswith(".c")]
    command = [find_compiler(), "-shared", "-fPIC", f"-I{fmi_headers()}", *sources, "-o", str(library), "-lm"]
    subprocess.run(command, check=True)
    with zipfile.ZipFile(folder / f"{model}.fmu", "w") as archive:
        archive.write(folder / "modelDescription.xml", "modelDescription.xml")
        archive.write(library, name)
    return folder / f"{model}.fmu"


def changed(path: Path, target: Path, changes: Mapping[str, Change | None]) -> Path:
    """A copy of an FMU with some of its files changed or, where the change is None, left out."""
    with zipfile.ZipFile(path) as source, zipfile.ZipFile(target, "w") as copy:
        for name in source.namelist():
            change = changes.get(name, lambda content: content)
            if change is not None:
                copy.writestr(name, change(source.read(name)))
    return target


def recompiled(path: Path, target: Path, fmi: str, old: str, new: str, file: str = "instance.h") -> Path:
    """A copy of an FMU of ours whose binary is made of changed sources."""
    folder = target.parent / f"{target.stem}_sources"
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
        library = next(name for name in archive.namelist() if name.startswith("binaries/"))
    header = folder / "sources" / file
    text = header.read_text()
    assert old in text
    header.write_text(text.replace(old, new))
    sources = [p.name for p in (folder / "sources").glob("*.c")]
    built = build_library(folder / "sources", sources, folder / "library")
    return changed(path, target, {library: lambda _: built.read_bytes()})


STATE_SPACE = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="state space" instantiationToken="arrays">
<ModelExchange modelIdentifier="arrays"/>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<Float64 name="A" valueReference="1" causality="parameter" variability="fixed" start="0 1 -1 0"><Dimension start="2"/>
<Dimension start="2"/></Float64>
<Float64 name="B" valueReference="2" causality="parameter" variability="tunable" start="1 0 0 1"><Dimension start="2"/>
<Dimension start="2"/></Float64>
<Float64 name="u" valueReference="3" causality="input" start="0 0"><Dimension start="2"/></Float64>
<Float64 name="x" valueReference="4" causality="output" initial="exact" start="1 0"><Dimension start="2"/></Float64>
<Float64 name="der(x)" valueReference="5" causality="local" derivative="4"><Dimension start="2"/></Float64>
</ModelVariables>
<ModelStructure><Output valueReference="4"/><ContinuousStateDerivative valueReference="5"/></ModelStructure>
</fmiModelDescription>
"""


def state_space(folder: Path) -> Path:
    """x' = A x + B u with arrays of FMI 3.0, written in C by hand."""
    source = Path(__file__).parent / "unit" / "state_space_fmu.c"
    name = library_name("3.0", "arrays")
    library = build_library(source.parent, [source.name], folder / Path(name).name)
    with zipfile.ZipFile(folder / "arrays.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", STATE_SPACE)
        archive.write(library, name)
        archive.writestr("documentation/index.html", "one")
    return folder / "arrays.fmu"


SLAVE_NAMES = (
    "time", "x", "y", "der(x)", "der(y)", "mu", "omega", "cubic", "noise", "size_x", "size_y", "substeps", "odd", "u",
    "force", "drive", "x0", "y0",
)  # fmt: skip
SLAVE_ODDITIES = ("", "set late", "never set", "hidden", "fails", "reset in part", "lags", "by parameters")


def slave(folder: Path, *, odd: str = "", structure: bool = True, clock: bool = True, **starts: float) -> Path:
    """z' = (mu + i omega) z - cubic |z|^2 z + force(t) as an FMU for Co-Simulation alone, with a solver of fixed steps.

    `structure` is whether its states are named in ModelStructure, `clock` whether the time is one of its variables.
    """
    known = dict.fromkeys(SLAVE_NAMES, 0.0)
    known |= dict.fromkeys(("x", "mu", "omega", "cubic", "size_x", "size_y", "drive"), 1.0) | {"substeps": 8.0}
    known |= {name: float(value) for name, value in starts.items()} | {"odd": float(SLAVE_ODDITIES.index(odd))}
    sources = folder / "slave_sources"
    sources.mkdir(exist_ok=True)
    source = Path(__file__).parent / "unit" / "slave_fmu.c"
    (sources / source.name).write_text(source.read_text())
    (sources / "start.h").write_text(f"{{{', '.join(map(repr, known.values()))}}}\n")
    library, path = build_library(sources, [source.name], sources / "library"), folder / "slave.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", slave_description(known, structure, clock))
        archive.write(library, library_name("2.0", "slave"))
    return path


def slave_description(starts: Mapping[str, float], structure: bool, clock: bool) -> str:
    """modelDescription.xml of `slave` with these start values."""
    words = dict.fromkeys(SLAVE_NAMES, 'causality="parameter" variability="tunable"')
    words |= dict.fromkeys(("x", "y"), 'causality="output" initial="exact"')
    words |= dict.fromkeys(("der(x)", "der(y)"), 'causality="local" initial="calculated"')
    words |= {"u": 'causality="input"', "time": f'causality="{"independent" if clock else "local"}"'}
    numbers = {name: f'start="{start!r}"' for name, start in starts.items() if name != "time"}
    numbers |= {"der(x)": 'derivative="2"', "der(y)": 'derivative="3"'}
    variables = "".join(
        f'<ScalarVariable name="{name}" valueReference="{k}" {words[name]}>'
        f"<Real {numbers.get(name, '')}/></ScalarVariable>"
        for k, name in enumerate(SLAVE_NAMES)
    )
    entries = '<Derivatives><Unknown index="4"/><Unknown index="5"/></Derivatives>' if structure else ""
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="2.0" modelName="slave" guid="slave">'
        '<CoSimulation modelIdentifier="slave"/><DefaultExperiment stepSize="0.05"/>'
        f"<ModelVariables>{variables}</ModelVariables><ModelStructure>{entries}</ModelStructure></fmiModelDescription>"
    )
