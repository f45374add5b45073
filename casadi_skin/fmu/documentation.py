"""The documentation page and the icon inside an FMU."""

from __future__ import annotations

from functools import cache
from html import escape
from io import BytesIO

import numpy as np

from casadi_skin._version import __version__
from casadi_skin.fmu.description import Description, Variable

_STYLE = "body{font-family:sans-serif;max-width:50em;margin:2em auto}td,th{text-align:left;padding:0 1em 0 0}"

_ENERGY = """<p>The output <code>energy</code> is the Hamiltonian in the gauge y<sub>n</sub> = rho<sub>n</sub>
eta<sub>n</sub> with rho = 1 at the edge that the modes lean to (the last site for gamma &ge; 0, the first one below).
The equations keep it; a solver in y does so up to its errors at the far end, which enter weighted by
1/rho<sub>n</sub><sup>2</sup>. It is infinite at |gamma| = 1.</p>
"""


def page(description: Description, fmi: str) -> str:
    """documentation/index.html: the model, its variables, its origin and how it is compiled elsewhere."""
    problem = description.problem
    name = escape(problem.model.name)
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{name}</title><style>{_STYLE}</style></head>
<body>
<h1>{name}</h1>
<p>{escape(problem.description)}. All quantities are dimensionless. Written by casadi_skin {__version__}.</p>
{_chain_words(description)}
<h2>Variables</h2>
<table>
<tr><th>Name</th><th>Causality</th><th>Start</th><th>Meaning</th></tr>
{"".join(map(_row, description.variables))}</table>
<h2>Interfaces</h2>
<p>Model Exchange without events, and Co-Simulation with its own solver: the Runge-Kutta method of order 8(5,3) of
Dormand
and Prince (Hairer, N&oslash;rsett and Wanner, Solving Ordinary Differential Equations I, Sec. II.5). The tolerance of
the
experiment, {problem.tolerance!r} where none is given, bounds the error of one step relative to a state's size, or to
its
nominal value where that is larger. Directional derivatives (in FMI 3.0 adjoint ones as well) are exact; the time,
states and
parameters are accepted as knowns. Parameters are tunable: in Event Mode, and between communication steps. A value
that is
not finite is answered by the status Discard, as is a communication step in which the solution runs to infinity; the
instance
is then as before the call.</p>
<h2>Another platform</h2>
<p>The directory <code>sources</code> has all that is compiled but the header files of the standard: C99, no library
but that
of mathematical functions. For example, with those headers in <code>fmi</code>:</p>
<pre>cc -std=c99 -O2 -fPIC -shared -fvisibility=hidden -Ifmi {" ".join(description.source_files(fmi))} -lm \\
  -o {problem.identifier}.so</pre>
</body>
</html>
"""


def _chain_words(description: Description) -> str:
    if "energy" not in description.problem.meanings:
        return ""
    energy = _ENERGY if "energy" in description.problem.model.outputs else ""
    return f"""<p>y<sub>n</sub>'' = (1 + gamma) y<sub>n-1</sub> - 2 y<sub>n</sub> + (1 - gamma) y<sub>n+1</sub>
- alpha y<sub>n</sub> - g y<sub>n</sub><sup>3</sup>, n = 1..N, with y<sub>0</sub> = y<sub>N+1</sub> = 0
(B. Many Manda, arXiv:2512.17483, Eq. 1).</p>
{energy}<p><code>S</code> is the sum of the squared displacements at each time; where all velocities vanish it is the
amplitude of the orbit.</p>"""


def _row(variable: Variable) -> str:
    start = "" if variable.start is None else f"{variable.start:.6g}"
    cells = (variable.name, variable.causality, start, variable.description)
    return "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>\n"


@cache
def icon() -> bytes:
    """A PNG of 128 by 128: a mode that leans to one edge of its chain."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1.28, 1.28), dpi=100)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    sites = np.arange(1, 10)
    heights = 0.75 * np.exp(0.45 * (sites - 9)) * (-1.0) ** (sites - 9)
    axes.vlines(sites, 0.0, heights, color="#1f4e79", linewidth=2.0)
    axes.plot(sites, heights, "o", color="#1f4e79", markersize=5.0)
    axes.axhline(0.0, color="0.4", linewidth=1.0)
    axes.set(xlim=(0.0, 10.0), ylim=(-1.0, 1.0), xticks=[], yticks=[])
    image = BytesIO()
    figure.savefig(image, format="png", dpi=100, metadata={"Software": None})
    return image.getvalue()
