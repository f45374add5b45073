"""A branch of periodic orbits of any model by AUTO-07p, from equations that CasADi writes in C.

AUTO starts from one orbit of ours, with derivatives given (JAC = 1), multipliers at every point (ISP = 1) and its mesh
adapted at every third step. Its folder, built with -O3, is named by AUTO_DIR; a run of the executable is timed.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from casadi_skin.model.ode import OdeModel

PERIOD_PLACE = 10  # of the period among the parameters, counted from 0
SAMPLES = 2001  # of the orbit that it starts from
WRAPPER = """
#include "auto_f2c.h"
#include <stddef.h>
int func(integer ndim, const doublereal *u, const integer *icp, const doublereal *par, integer ijac, doublereal *f,
         doublereal *dfdu, doublereal *dfdp)
{
    const double *arg[2] = {u, par};
    double *res[3] = {f, ijac ? dfdu : NULL, ijac > 1 ? dfdp : NULL};
    static double w[equations_SZ_W + 1];
    return equations(arg, res, NULL, w, 0);
}
int stpnt(integer ndim, doublereal t, doublereal *u, doublereal *par)
{
    par[0] = %r, par[10] = %r;
    return 0;
}
int bcnd(integer n, const doublereal *p, const integer *i, integer m, const doublereal *u, const doublereal *v,
         integer j, doublereal *f, doublereal *d) { return 0; }
int icnd(integer n, const doublereal *p, const integer *i, integer m, const doublereal *u, const doublereal *o,
         const doublereal *d, const doublereal *q, integer j, doublereal *f, doublereal *e) { return 0; }
int fopt(integer n, const doublereal *u, const integer *i, const doublereal *p, integer j, doublereal *f,
         doublereal *d, doublereal *e) { return 0; }
int pvls(integer n, const doublereal *u, doublereal *par) { return 0; }
"""


@dataclass(frozen=True)
class AutoBranch:
    """A run of AUTO: seconds of the processor, points, and parameter and period at its end."""

    seconds: float
    points: int
    value: float
    period: float


def folder() -> Path | None:
    """AUTO's own folder, where it is named and built."""
    named = os.environ.get("AUTO_DIR", "")
    return (
        Path(named) if named and (Path(named) / "lib" / "libauto_c.a").exists() and shutil.which("gfortran") else None
    )


class AutoOrbits:
    """AUTO with one model, compiled in a folder.

    Arguments:
        model: of one parameter.
        work: an empty folder.
        orbit: the first one, of this package.
        value: of the parameter there.
    """

    def __init__(self, model: OdeModel, work: Path, orbit: object, value: float) -> None:
        auto = folder()
        self.work, self.size = work, model.full_size
        times = np.linspace(0.0, orbit.period, SAMPLES)  # type: ignore[attr-defined]
        states = orbit.evaluate(times)  # type: ignore[attr-defined]
        np.savetxt(work / "orbit.dat", np.column_stack([times, states]), fmt="%.16e")
        x, p = ca.SX.sym("x", self.size), ca.SX.sym("p", 36)
        rhs = model.vector_field(0.0, x, p[0])
        by_p = ca.horzcat(ca.jacobian(rhs, p[0]), ca.SX.zeros(self.size, 35))
        function = ca.Function("equations", [x, p], [ca.densify(e) for e in (rhs, ca.jacobian(rhs, x), by_p)])
        code = ca.CodeGenerator("model.c", {"casadi_int": "int"})
        code.add(function)
        code.generate(f"{work}/")
        words = f"#define equations_SZ_W {function.sz_w()}\n" + WRAPPER % (value, float(orbit.period))  # type: ignore[attr-defined]
        (work / "auto.c").write_text((work / "model.c").read_text() + words)
        _run(["cc", "-O3", "-march=native", f"-I{auto / 'include'}", "-c", "auto.c"], work)
        objects = [str(path) for path in sorted((auto / "lib").glob("*.o"))]
        _run(["gfortran", "-O3", "-fopenmp", "auto.o", *objects, str(auto / "lib" / "libauto_c.a"), "-o", "auto"], work)

    def follow(self, to: float, start: float, intervals: int, step: float, longest: float) -> AutoBranch:
        """The branch from the first orbit to a value of the parameter, with so many intervals of four points."""
        way = 1.0 if to > start else -1.0
        constants: dict[str, object] = {
            "dat": "orbit", "NDIM": self.size, "IPS": 2, "ILP": 0, "ICP": [1, 11], "JAC": 1, "NPAR": 36,
            "NTST": intervals, "NCOL": 4, "IAD": 3, "ISP": 1, "SP": ["PD0", "TR0", "BP0", "LP0"], "NMX": 5000, "NPR": 0,
            "IID": 0, "ITMX": 9, "ITNW": 7, "NWTN": 3, "EPSL": 1e-9, "EPSU": 1e-9, "EPSS": 1e-7, "IADS": 1,
            "DS": way * step, "DSMIN": 1e-9, "DSMAX": longest, "UZSTOP": {1: to},
        }  # fmt: skip
        (self.work / "fort.2").write_text("".join(f"{name} = {value!r}\n" for name, value in constants.items()))
        for name in ("fort.3", "fort.7", "fort.8", "fort.9"):
            (self.work / name).unlink(missing_ok=True)
        (self.work / "fort.3").touch()
        before = _spent()
        _run(["./auto"], self.work)
        spent = _spent() - before
        rows = [line.split() for line in (self.work / "fort.7").read_text().splitlines()]
        points = [row for row in rows if row[0] != "0"]
        return AutoBranch(spent, len(points), float(points[-1][4]), float(points[-1][-1]))


def _spent() -> float:
    """Seconds of the processor in programs that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _run(command: list[str], work: Path) -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run(command, cwd=work, check=True, capture_output=True, text=True, timeout=300, env=environment)
