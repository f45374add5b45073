"""Parts made of the collocation equations of periodic orbits, and of a converged orbit."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from casadi_skin.bvp.trigonometric import TrigonometricProblem, cosine_matrix
from casadi_skin.export.c_text import Call, comment, doubles, pattern, plain
from casadi_skin.export.equations import pattern_declaration
from casadi_skin.export.exported_model import Subject
from casadi_skin.export.part import Part, Size, called, declared
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.stability.result import Floquet

SMALL = 3  # half-bandwidths below which a band saves nothing
REPORT = """typedef struct {
    int status;      /* one of the constants below */
    int iterations;  /* linear systems solved */
    double step;     /* length of the last step, relative to the orbit */
    double residual; /* largest |R| before that step */
} @p_newton_report;
enum { @P_CONVERGED, @P_TOO_MANY_ITERATIONS, @P_SINGULAR, @P_DIVERGED, @P_BAD_INPUT };"""
POSITIONS = """void @p_positions(const double *z, double *q)
{
    int n, i;

    for (n = 0; n < @P_SITES; n++)
        for (q[n] = 0.0, i = 0; i < @P_NODES; i++) q[n] += at_zero[i] * z[n * @P_NODES + i];
}"""


def residual_part(subject: Subject) -> Part:
    """The equations with their Jacobian; the linear modes; and positions at t = 0 from the unknowns."""
    problem = subject.problem
    z, residual, jacobian = problem.symbols
    arguments = [z, problem.constants_symbol]
    function = ca.Function(f"{subject.name}_generated_residual", arguments, [ca.densify(residual), jacobian])
    prototype = "int @p_residual(const double *z, double *R, double *dRdz, double *work)"
    sparsity = function.sparsity_out(1)
    words = (
        "The collocation equations R(z) = 0 of periodic orbits that start at rest (EQUATIONS entries) and the "
        "non-zeros of dR/dz by columns, in the pattern below. z holds q_n at the NODES phases Omega t = (i + 1/2) "
        "pi/(2 NODES), site after site, then Omega, then the parameter kappa = g S; the last equation is that the sum "
        "of rho_n^2 q_n^2 is 1 at t = 0. Returns 0."
    )
    sizes = (
        Size("UNKNOWNS", problem.size, "entries of z"),
        Size("EQUATIONS", problem.size - 1, "entries of R"),
        Size("STATE_UNKNOWNS", problem.states, "entries of z that are positions"),
        Size("NODES", problem.resolution, "nodes a site on the quarter of the period"),
        Size("OMEGA", problem.Omega_index, "place of Omega in z"),
        Size("PARAMETER", problem.parameter_index, "place of kappa in z"),
        Size("RESIDUAL_NONZEROS", sparsity.nnz(), "non-zeros of dR/dz"),
    )
    call = Call(prototype, function, ("z", "0"), ("R", "dRdz"))
    part = called("Periodic orbits: collocation equations", call, "RESIDUAL_WORK", words, *sizes)
    mode = declared(
        "int @p_linear_mode(int mode, double *z)",
        "The linear mode 1..SITES as unknowns z with kappa = 0, where a family starts. Returns 0, or 1 for a mode that "
        "is not there or does not oscillate.",
    )
    positions = declared(
        "void @p_positions(const double *z, double *q)", "Positions q_n at t = 0, where all velocities vanish."
    )
    at_zero = (2.0 / problem.resolution) * cosine_matrix(problem.resolution).sum(axis=0)
    return replace(
        part,
        declarations=(*part.declarations, pattern_declaration("@p_residual", sparsity), mode, positions),
        definitions=(
            pattern("@p_residual", sparsity), f"static {doubles('at_zero', at_zero)}", POSITIONS, *part.definitions
        ),
        files=("linear_mode",),
    )  # fmt: skip


def is_banded(problem: TrigonometricProblem) -> bool:
    """Whether Newton's linear systems are solved as a band with a border."""
    return problem.half_bandwidth is not None and SMALL * problem.half_bandwidth < problem.states


def newton_part(subject: Subject) -> Part:
    """Newton's method with the LU that suits the size."""
    problem = subject.problem
    size, n, width = problem.size, problem.states, problem.half_bandwidth or 0
    edge, nonzeros = size - n + 1, problem.function.nnz_out(1)
    banded = is_banded(problem)
    solve = n * (3 * width + 1 + 2 * edge + 1) if banded else size * size
    inner = max(solve, max(1, int(problem.function.sz_w())) + 64)
    sizes = [Size("NEWTON_WORK", 4 * size + nonzeros + inner, "doubles of work")]
    if banded:
        sizes.append(Size("HALF_BANDWIDTH", width, "of the state values in dR/dz"))
    prototype = (
        "int @p_newton(double *z, int held, double value, double tolerance, int most, @p_newton_report *report,\n"
        "              double *work)"
    )
    words = (
        "Newton's method from the guess z for the orbit whose unknown `held` (OMEGA or PARAMETER) has this value, "
        "until a step is not longer than `tolerance`, relative to the orbit, in `most` iterations at most. Returns the "
        "status, 0 where it converged; z is changed then only."
    )
    solver = declared(
        "int @p_solve(const double *dRdz, int held, const double *z, double *b, double *work)",
        "Used by Newton's method.",
    )
    told = declared("const char *@p_newton_words(int status)", "A status in words.")
    return Part(
        "Periodic orbits: Newton's method",
        tuple(sizes),
        (REPORT, declared(prototype, words), told, solver),
        files=("newton", "solve_band" if banded else "solve_dense"),
    )


def orbit_part(subject: Subject) -> Part:
    """The converged orbit as data."""
    orbit = subject.orbit
    assert orbit is not None
    harmonics = orbit.harmonics
    numbers = {
        "Omega": (orbit.Omega, "frequency"),
        "period": (orbit.period, "2 pi/Omega"),
        "S": (orbit.S, "sum of y_n^2 at t = 0"),
        "Omega_error": (orbit.Omega_error, "estimated absolute error of Omega"),
        "profile_error": (orbit.profile_error, "estimated error of y, relative to its largest displacement"),
    }
    if subject.chain is not None:
        numbers["kappa"] = (orbit.point.parameter, "g S, the parameter of the gauge")
    values = orbit.coefficients(harmonics)
    data = [f"const double @p_orbit_{name} = {value:.17g};" for name, (value, _) in numbers.items()]
    told = [f"extern const double @p_orbit_{name}; {comment(words)}" for name, (_, words) in numbers.items()]
    arrays = [doubles("@p_orbit_coefficients", values)]
    coefficients = comment("y_n(t) = sum of c_kn cos((2k+1) Omega t): c_kn at place k SITES + n.")
    told += [coefficients, f"extern const double @p_orbit_coefficients[{values.size}];"]
    if subject.refusal("residual") is None:
        arrays.append(doubles("@p_orbit_z", orbit.point.z))
        unknowns = "The same orbit as unknowns of the collocation equations."
        told += [comment(unknowns), f"extern const double @p_orbit_z[{orbit.point.z.size}];"]
    multipliers, more = _multipliers(orbit)
    sites = () if subject.chain is not None else (Size("SITES", values.shape[1], "positions of the model"),)
    evaluate = declared(
        "int @p_orbit(double t, double *y, double *velocity)",
        "Displacements and velocities of the sites at time t in physical coordinates; either may be a null pointer. "
        "Returns 0.",
    )
    return Part(
        "A converged orbit",
        (Size("HARMONICS", harmonics, "odd harmonics of the orbit"), *sites),
        ("\n".join([*told, *more]), evaluate),
        ("\n".join(data), *arrays, *multipliers),
        files=("orbit",),
    )


def floquet_of(orbit: Orbit) -> Floquet | str:
    """The orbit's multipliers, or why there are none, as of a chain that is too long."""
    try:
        return orbit.floquet()
    except (ValueError, ArithmeticError) as error:
        return " ".join(str(error).split())


def _multipliers(orbit: Orbit) -> tuple[list[str], list[str]]:
    """Definitions and declarations of the orbit's multipliers, or a comment that tells why they are not there."""
    floquet = floquet_of(orbit)
    if isinstance(floquet, str):
        return [], [comment(f"Its multipliers are not here: {plain(floquet)}")]
    values = np.asarray(floquet.multipliers)
    largest = float(floquet.max_abs_multiplier)
    definitions = [
        doubles("@p_orbit_multipliers_real", values.real),
        doubles("@p_orbit_multipliers_imaginary", values.imag),
        f"const double @p_orbit_largest_multiplier = {largest:.17g};",
        f"const double @p_orbit_multiplier_error = {floquet.error:.17g};",
    ]
    told = [
        comment("Its Floquet multipliers; the largest modulus but for the trivial pair, and the error of that."),
        f"extern const double @p_orbit_multipliers_real[{values.size}];",
        f"extern const double @p_orbit_multipliers_imaginary[{values.size}];",
        "extern const double @p_orbit_largest_multiplier, @p_orbit_multiplier_error;",
    ]
    return definitions, told
