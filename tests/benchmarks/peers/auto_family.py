r"""The family followed by AUTO-07p, from the library and main program that the Python package bifpy carries.

bifpy can compile a model's equations and link them with AUTO's main program; the same is done here, once, with the
equations written in Fortran as a user of AUTO would, and a run of the executable with reading its table is timed. pip
builds bifpy without optimisation; AUTO is measured at its best only with (-march=native takes as long, and is not read
by valgrind where the processor has AVX-512)

    export MAKEFLAGS='F90=gfortran\ -O3\ -march=x86-64-v3\ -funroll-loops F77=gfortran\ -O3'
    pip install --no-binary bifpy bifpy
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from auto_equations import SUPPORT, Formulation, equations
from family_case import Array, Family, FamilyCase, largest_multiplier


@dataclass(frozen=True)
class AutoSettings:
    """The constants of AUTO that were tried; the others follow from the problem."""

    NTST: int  # mesh intervals
    NCOL: int  # collocation points in each
    DSMAX: float  # longest step
    ITNW: int  # iterations allowed; a step that takes all of them is followed by one half as long
    NWTN: int  # of them with a new matrix
    THU: float = 1.0  # weight of the orbit in the arclength, beside S and tau of weight 1
    EPSU: float = 1e-7  # relative size of the last correction
    IAD: int = 0  # steps between adaptations of the mesh

    def file(self, case: FamilyCase, formulation: Formulation) -> str:
        """The constants file."""
        n, own = case.sites, formulation.whole
        constants: dict[str, object] = {
            "NDIM": 2 * n, "NBC": 2 * n + 1, "NINT": 0, "IPS": 7 if own else 4, "JAC": 1,
            "ICP": [1, 2, 3], "NPAR": 12,
            "NTST": self.NTST, "NCOL": self.NCOL, "IAD": self.IAD,
            "ILP": 0, "ISP": 1 if own else 0, "SP": ["PD0", "TR0", "BP0", "LP0"],
            "NMX": 1000, "NPR": 0, "IID": 0, "IIS": 0,
            "ITMX": 9, "ITNW": self.ITNW, "NWTN": self.NWTN,
            "EPSL": self.EPSU, "EPSU": self.EPSU, "EPSS": 1e-7,
            "DS": min(0.1, self.DSMAX), "DSMIN": 1e-5, "DSMAX": self.DSMAX, "IADS": 1,
            "UZSTOP": {1: case.at[-1]}, "UZR": {1: list(case.at[:-1])},
            "THU": dict.fromkeys(range(1, 2 * n + 1), self.THU),
        }  # fmt: skip
        return "".join(f"{name} = {value!r}\n" for name, value in constants.items())


# Found by trying, for an Omega good to 1e-8 at all points. Four points in each interval: the elimination inside an
# interval costs NCOL^3, and more but shorter intervals are cheaper than NCOL = 5 to 7 at this accuracy, down to 4.
# An adapted mesh gains nothing. Without multipliers one matrix a step is cheapest; with them the last matrix has to be
# that of the orbit: with NWTN = 2 they are wrong by up to 0.05 between the S asked for, with 3 by up to 4e-3. EPSU =
# 1e-5 is an eighth cheaper, but leaves 2e-7 in Omega. Orbits weigh little in the arclength: it takes longer steps.
BEST = {
    Formulation.QUARTER: AutoSettings(NTST=5, NCOL=4, DSMAX=0.8, ITNW=9, NWTN=1, THU=0.03),
    Formulation.REDUCED: AutoSettings(NTST=5, NCOL=4, DSMAX=0.4, ITNW=5, NWTN=5, THU=0.1),
    Formulation.PERIOD: AutoSettings(NTST=20, NCOL=4, DSMAX=0.5, ITNW=5, NWTN=5, THU=0.1),
    Formulation.PHYSICAL: AutoSettings(NTST=20, NCOL=4, DSMAX=0.5, ITNW=5, NWTN=5),
}

# The same with steps so short that there are as many points as this package has; the first guesses are good, and a
# correction of 1e-5 leaves 1e-11 in Omega
MANY_POINTS = {
    Formulation.QUARTER: replace(BEST[Formulation.QUARTER], DSMAX=0.07, EPSU=1e-5),
    Formulation.REDUCED: replace(BEST[Formulation.REDUCED], DSMAX=0.07, THU=0.03),
    Formulation.PERIOD: replace(BEST[Formulation.PERIOD], DSMAX=0.1),
}


def auto_library() -> Path | None:
    """Folder with AUTO's library and main program in an installed bifpy; None without."""
    found = importlib.util.find_spec("bifpy")
    if found is None or found.origin is None:
        return None
    folder = Path(found.origin).parent / "auto" / "_lib"
    return folder if (folder / "libbifpy.a").exists() and (folder / "main.o").exists() else None


def missing() -> str:
    """What is absent, as one line; empty if nothing is."""
    if shutil.which("gfortran") is None:
        return "AUTO-07p: needs gfortran (apt-get install gfortran make)"
    if auto_library() is None:
        return "AUTO-07p: needs bifpy, which carries it (pip install bifpy)"
    return ""


class AutoProgram:
    """AUTO compiled for one formulation in `folder`."""

    def __init__(self, folder: Path, case: FamilyCase, formulation: Formulation, library: Path | None = None) -> None:
        self.folder, self.case, self.formulation = folder, case, formulation
        library = library or auto_library()
        assert library is not None
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "support.f90").write_text(SUPPORT)
        (folder / "family.f90").write_text(equations(case, formulation))
        compiler = ["gfortran", "-O3", "-march=x86-64-v3"]
        subprocess.run([*compiler, "-fsyntax-only", "support.f90"], cwd=folder, check=True)
        linked = [str(library / "main.o"), str(library / "libbifpy.a")]
        subprocess.run([*compiler, "-o", "family", "family.f90", *linked], cwd=folder, check=True)

    def follow(self, settings: AutoSettings) -> Family:
        """Run the program and read its table."""
        (self.folder / "fort.2").write_text(settings.file(self.case, self.formulation))
        (self.folder / "reduced.bin").unlink(missing_ok=True)
        run = subprocess.run([str(self.folder / "family")], cwd=self.folder, capture_output=True, text=True)
        if run.returncode != 0:
            raise RuntimeError(run.stdout + run.stderr)
        return self.read()

    def read(self) -> Family:
        """The points of fort.7; multipliers from its last column or from the reduced systems."""
        lines = (line.split() for line in (self.folder / "fort.7").read_text().splitlines())
        rows = np.array([[float(value) for value in line] for line in lines if line and line[0] != "0"])
        S, tau = rows[:, 4], rows[:, -2]
        found = rows[:, -1] if self.formulation.whole else None
        if self.formulation is Formulation.REDUCED:
            found = self.reduced_multipliers(S)
        return Family(S, 2.0 * np.pi * self.formulation.part / tau, found)

    def reduced_multipliers(self, S: Array) -> Array:
        """Largest |multiplier| at each of the points; records that AUTO did not keep are passed over."""
        n = 2 * self.case.sites
        records = np.fromfile(self.folder / "reduced.bin").reshape(-1, 1 + 2 * n * n)
        nearest = [len(records) - 1 - int(np.argmin(abs(records[::-1, 0] - value))) for value in S]
        blocks = records[nearest, 1:].reshape(len(S), 2, n, n).transpose(0, 1, 3, 2)
        return np.array([largest_multiplier(-np.linalg.solve(P1, P0)) for P0, P1 in blocks])
