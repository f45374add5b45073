"""A limit cycle inside somebody else's FMU, followed in its parameter: van der Pol, exported by CasADi itself.

Needs a C compiler and `pip install 'casadi-skin[fmu]'`. Run: python examples/foreign_fmu.py PICTURE.png
"""

import os
import subprocess
import sys
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as ca
import fmpy
import numpy as np

from casadi_skin import Branch, find_orbit, import_fmu, style


def made_elsewhere(folder: Path) -> Path:
    """x' = v, v' = mu (1 - x^2) v - x by CasADi's DaeBuilder, which writes sources into the current directory."""
    dae = ca.DaeBuilder("vdp")
    dae.add("time", "independent")
    x, v, mu = dae.add("x"), dae.add("v"), dae.add("mu", "parameter", "tunable")
    dae.eq(dae.der(x), v)
    dae.eq(dae.der(v), mu * (1 - x**2) * v - x)
    for name, start in (("x", 2.0), ("v", 0.0), ("mu", 1.0)):
        dae.set_start(name, start)
    dae.set_initial("x", "exact")
    dae.set_initial("v", "exact")
    before = Path.cwd()
    os.chdir(folder)
    sources = [folder / name for name in dae.export_fmu() if name.endswith(".c")]
    os.chdir(before)
    name = f"binaries/{fmpy.platform_tuple}/vdp{fmpy.sharedLibraryExtension}"
    library = folder / Path(name).name
    headers = Path(fmpy.__file__).parent / "c-code"  # of the standard
    command = [os.environ.get("CC", "cc"), "-shared", "-fPIC", f"-I{headers}", *sources, "-o", library, "-lm"]
    subprocess.run(command, check=True)
    with zipfile.ZipFile(folder / "vdp.fmu", "w") as archive:
        archive.write(folder / "modelDescription.xml", "modelDescription.xml")
        archive.write(library, name)
    return folder / "vdp.fmu"


@style()
def main(picture: Path | None = None) -> Branch:
    with TemporaryDirectory() as folder:
        model = import_fmu(made_elsewhere(Path(folder)), parameters=["mu"])
    print(f"states {', '.join(model.state_names)}, derivatives by the FMU: {model.derivatives}")
    cycle = find_orbit(model, lambda t: [2.0 * np.cos(t), -2.0 * np.sin(t)], 6.5, corrector="newton")
    print(f"mu = 1: period {cycle.period:.10f}, multipliers {cycle.floquet().multipliers.real}")
    branch = cycle.follow("mu", 4.0, at=[1.0, 2.0, 3.0, 4.0])
    for mu in (2.0, 3.0, 4.0):
        print(f"mu = {mu:g}: period {branch.at(mu).period:.8f}")
    if picture is not None:
        draw(branch, picture)
    return branch


def draw(branch: Branch, path: Path) -> None:
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(7.2, 3.2), layout="constrained")
    left.plot(branch["mu"], branch["period"], ".-k")
    left.set(xlabel="mu", ylabel="period")
    for mu, look in ((1.0, "-"), (2.0, "--"), (4.0, ":")):
        orbit = branch.at(mu)
        x, v = orbit.evaluate(np.linspace(0.0, orbit.period, 600)).T
        right.plot(x, v, look, color="k", label=f"mu = {mu:g}")
    right.set(xlabel="x", ylabel="v")
    right.legend(frameon=False, loc="upper left")
    figure.savefig(path, dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
