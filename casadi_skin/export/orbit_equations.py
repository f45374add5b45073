"""Parts made of the collocation equations of periodic orbits, and of a converged orbit."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.export.codegen import (
    Call,
    Part,
    Size,
    arrays,
    comment,
    constants,
    pattern,
    plain,
)
from casadi_skin.export.exported_model import ExportedModel
from casadi_skin.export.site_loops import called
from casadi_skin.follow.solution import Orbit
from casadi_skin.model.arguments import in_words
from casadi_skin.solve.ipopt import nlp_solver
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.problem import Array

IPOPT_HEADER = "coin-or/IpStdCInterface.h"
MOST_SAMPLES = 8192  # of an orbit of a model, over its period


def residual_part(exported: ExportedModel) -> Part:
    """The equations with their Jacobian; the linear modes; and positions at t = 0 from the unknowns."""
    problem = exported.problem
    z, residual, jacobian = problem.symbols
    arguments = [z, problem.constants_symbol]
    function = ca.Function(f"{exported.name}_generated_residual", arguments, [ca.densify(residual), jacobian])
    sparsity = function.sparsity_out(1)
    sizes = (
        Size("UNKNOWNS", problem.size, "entries of z"),
        Size("EQUATIONS", problem.size - 1, "entries of R"),
        Size("STATE_UNKNOWNS", problem.states, "entries of z that are positions"),
        Size("NODES", problem.resolution, "nodes a site on the quarter of the period"),
        Size("OMEGA", problem.Omega_index, "place of Omega in z"),
        Size("PARAMETER", problem.parameter_index, "place of kappa in z"),
        Size("RESIDUAL_NONZEROS", sparsity.nnz(), "non-zeros of dR/dz"),
    )
    call = Call("residual", function, ("z", "0"), ("R", "dRdz"))
    part = called("Periodic orbits: collocation equations", call, "RESIDUAL_WORK", *sizes)
    return part.plus(*pattern("@p_residual", sparsity), files=("linear_mode",))


def newton_part(exported: ExportedModel) -> Part:
    """Newton's method with an LU of the band of the state values."""
    problem = exported.problem
    size, n, width = problem.size, problem.states, problem.half_bandwidth or 1
    edge, nonzeros = size - n + 1, problem.function.nnz_out(1)
    inner = max(n * (3 * width + 2 * edge + 2), max(1, int(problem.function.sz_w())) + 64)
    sizes = (
        Size("NEWTON_WORK", 4 * size + nonzeros + inner, "doubles of work"),
        Size("HALF_BANDWIDTH", width, "of the state values in dR/dz"),
    )
    return Part("Periodic orbits: Newton's method", sizes, files=("newton", "solve_band"))


def ipopt_part(exported: ExportedModel) -> Part:
    """A square problem: the equations and the row that holds kappa, with the Jacobian from its structure."""
    problem = exported.problem
    z, residual, jacobian = problem.symbols
    held = ca.MX.sym("held")
    equations = ca.vertcat(ca.densify(residual), z[problem.parameter_index] - held)
    row = ca.MX(ca.sparsify(ca.DM(problem.parameter_row()).T))
    size = problem.size
    weights, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", size)
    options = {
        "jac_g": ca.Function("jac_g", [z, held], [equations, ca.vertcat(jacobian, row)]),
        "hess_lag": ca.Function("hess_lag", [z, held, weights, multipliers], [ca.MX(size, size)]),
    }
    solver = nlp_solver("solver", {"x": z, "p": held, "f": ca.MX(0), "g": equations}, 1e-12, options, exact=False)
    start, value = ca.MX.sym("start", size), ca.MX.sym("value")
    solved = solver(x0=start, p=value, lbg=0, ubg=0)
    function = ca.Function(f"{exported.name}_generated_ipopt", [start, value], [solved["x"], solved["g"]])
    call = Call("ipopt", function, ("guess", "&kappa"), ("z", "R"))
    return called("Periodic orbits: Ipopt", call, "IPOPT_WORK")


# Converged orbits ---------------------------------------------------------------------------------------------------


def orbit_part(exported: ExportedModel) -> Part:
    """The converged orbit as data."""
    orbit = exported.orbit
    assert orbit is not None
    if exported.chain is None:
        part = _orbit_of_model(orbit)
    else:
        part = _orbit_of_chain(orbit, with_unknowns=exported.refusal("residual") is None)
    return _with_multipliers(part, orbit)


def _orbit_of_chain(orbit: Orbit, with_unknowns: bool) -> Part:
    numbers = {
        "Omega": (orbit.Omega, "frequency"),
        "period": (orbit.period, "2 pi/Omega"),
        "S": (orbit.S, "sum of y_n^2 at t = 0"),
        "kappa": (orbit.point.parameter, "g S, the parameter of the gauge"),
        "Omega_error": (orbit.Omega_error, "estimated absolute error of Omega"),
        "profile_error": (orbit.profile_error, "estimated error of y, relative to its largest displacement"),
    }
    size = Size("HARMONICS", orbit.harmonics, "odd harmonics of the orbit")
    part = Part("A converged orbit", (size,), files=("orbit",)).plus(*constants("@p_orbit", numbers))
    coefficients = {"coefficients": orbit.coefficients(orbit.harmonics)}
    words = "y_n(t) = sum of c_kn cos((2k+1) Omega t): c_kn at place k SITES + n."
    part = part.plus(*arrays("@p_orbit", coefficients, words))
    if with_unknowns:
        unknowns = "The same orbit as unknowns of the collocation equations."
        part = part.plus(*arrays("@p_orbit", {"z": orbit.point.z}, unknowns))
    return part


def _orbit_of_model(orbit: Orbit) -> Part:
    numbers = {
        "period": (orbit.period, "period"),
        "period_error": (orbit.period_error, "estimated absolute error of the period"),
        "error": (orbit.profile_error, "estimated error of x, relative to its largest values"),
    }
    cosines, sines = fourier_series(orbit)
    sizes = (
        Size("ORBIT_STATES", cosines.shape[1], "entries of x: positions of a model of second order, else all states"),
        Size("HARMONICS", len(cosines) - 1, "harmonics of the orbit"),
    )
    part = Part("A converged orbit", sizes, files=("orbit_fourier",)).plus(*constants("@p_orbit", numbers))
    words = (
        "x_n(t) = sum of a_kn cos(2 pi k t/T) + b_kn sin(2 pi k t/T), k = 0..HARMONICS: a_kn and b_kn at place "
        "k ORBIT_STATES + n. Where the model is forced, t is its time."
    )
    return part.plus(*arrays("@p_orbit", {"cosines": cosines, "sines": sines}, words))


def fourier_series(orbit: Orbit) -> tuple[Array, Array]:
    """Coefficients of the cosines and sines of an orbit, each of shape (harmonics + 1, components).

    There are so many that those left out are below a tenth of the orbit's estimated error, or below round-off.
    """
    samples, least = 64, max(0.1 * orbit.profile_error, 1e-15)
    while True:
        c = np.fft.rfft(orbit.evaluate(orbit.period * np.arange(samples) / samples), axis=0) / samples
        size = np.max(np.abs(c) / np.maximum(np.max(np.abs(c), axis=0), 1e-300), axis=1)
        needed = int(np.flatnonzero(size > least)[-1])
        if needed < samples // 4 or samples == MOST_SAMPLES:
            break
        samples *= 2
    c = c[: needed + 1] * np.append(1.0, np.full(needed, 2.0))[:, None]
    return np.asarray(c.real), np.asarray(-c.imag)


def floquet_of(orbit: Orbit) -> Floquet | str:
    """The orbit's multipliers, or why there are none, as of a chain that is too long."""
    try:
        return orbit.floquet()
    except (ValueError, ArithmeticError) as error:
        return in_words(error)


def _with_multipliers(part: Part, orbit: Orbit) -> Part:
    """The part with the orbit's multipliers, or a comment with the reason why they are not there."""
    floquet = floquet_of(orbit)
    if isinstance(floquet, str):
        return part.plus(declaration=comment(f"Its multipliers are not here: {plain(floquet)}"))
    values = np.asarray(floquet.multipliers)
    numbers = {
        "largest_multiplier": (floquet.max_abs_multiplier, "largest modulus of a multiplier but for the trivial ones"),
        "multiplier_error": (floquet.error, "estimated error of that"),
    }
    parts = {"multipliers_real": values.real, "multipliers_imaginary": values.imag}
    return part.plus(*arrays("@p_orbit", parts, "Its Floquet multipliers.")).plus(*constants("@p_orbit", numbers))
