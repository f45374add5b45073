"""Generated C against CasADi's virtual machine and numpy, function by function, as ratios of times of one call.

Run with `pytest -m benchmark -s tests/benchmarks/test_export_speed.py`. C is compiled with gcc -O2 and timed inside of
C; CasADi's functions are called through buffers, without conversions. Results are compared, times are printed only.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from casadi_skin import Chain, Orbit, export_c, follow_family
from casadi_skin.export.codegen import c_source, prototype
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.stability.flows import JacobianAlong, SplittingMap, srkn_coefficients
from casadi_skin.zero.cosines import second_derivative_matrix

pytestmark = [
    pytest.mark.benchmark,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not there"),
]
STEPS = 16  # of the flow, a quarter of the period
Times = dict[str, float]

DRIVER = r"""
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include "chain.h"
#define TIME(name, call) do { \
    long n = 1, i; double s; \
    do { clock_t a; n *= 2; a = clock(); for (i = 0; i < n; i++) { call; } \
         s = (double)(clock() - a) / CLOCKS_PER_SEC; } while (s < 0.3); \
    printf("%s %.9g\n", name, s / n); } while (0)
static double x[CHAIN_STATES], f[CHAIN_STATES], J[CHAIN_JACOBIAN_NONZEROS], P[CHAIN_STATES * CHAIN_PARAMETERS];
static double V[CHAIN_STATES * CHAIN_STATES], W[CHAIN_STATES * CHAIN_STATES], work[10000000];
static double z[CHAIN_UNKNOWNS], R[CHAIN_UNKNOWNS], D[CHAIN_RESIDUAL_NONZEROS], mr[CHAIN_SITES], mi[CHAIN_SITES];
int main(void)
{
    chain_newton_report report;
    double largest, trivial;
    int k;
    for (k = 0; k < CHAIN_STATES; k++) { x[k] = sin(k + 1.0); V[k * (CHAIN_STATES + 1)] = 1.0; }
    memcpy(z, chain_orbit_z, sizeof z);
    TIME("rhs", chain_rhs(0.0, x, chain_nominal, f, work));
    TIME("jacobian", chain_jacobian(0.0, x, chain_nominal, f, J, P, work));
    TIME("variational", chain_variational(0.0, x, chain_nominal, CHAIN_STATES, V, f, W, work));
    TIME("residual", chain_residual(z, R, D, work));
    TIME("newton", for (k = 0; k < CHAIN_UNKNOWNS; k++) z[k] = chain_orbit_z[k] * (1.0 + 1e-3 * sin(k + 1.0));
         if (chain_newton(z, CHAIN_PARAMETER, chain_orbit_kappa, 1e-12, 20, &report, work)) return 1);
    TIME("flow", memset(x, 0, sizeof x); chain_positions(z, x);
         chain_flow(0.0, 0.25 * chain_orbit_period, @STEPS, x, V, &chain_orbit_kappa, work));
    TIME("multipliers", if (chain_multipliers(V, 1e-8, mr, mi, &largest, &trivial, work)) return 1);
    TIME("orbit", chain_orbit(0.3, x, f));
    fprintf(stderr, "%d %.17g %.17g\n", report.iterations, z[CHAIN_OMEGA], largest);
    return 0;
}
"""


PLAIN = r"""
void plain(const double *x, const double *p, double *dxdt, int n)
{
    const double below = 1.0 + p[1], above = 1.0 - p[1], own = 2.0 + p[0], g = p[2], *y = x;
    double *a = dxdt + n;
    int i;
    for (i = 0; i < n; i++) dxdt[i] = x[n + i];
    if (n == 1) {
        a[0] = -own * y[0] - g * y[0] * y[0] * y[0];
        return;
    }
    a[0] = above * y[1] - own * y[0] - g * y[0] * y[0] * y[0];
    for (i = 1; i < n - 1; i++) a[i] = below * y[i - 1] + above * y[i + 1] - own * y[i] - g * y[i] * y[i] * y[i];
    a[n - 1] = below * y[n - 2] - own * y[n - 1] - g * y[n - 1] * y[n - 1] * y[n - 1];
}
"""
UNTIMED = """
int casadi_rhs(const double **arg, double **res, long long int *iw, double *w, int mem) { return 0; }
"""
AGAINST = r"""
#include <math.h>
#include <stdio.h>
#include <time.h>
#include "chain.h"
void plain(const double *x, const double *p, double *dxdt, int n);
int casadi_rhs(const double **arg, double **res, long long int *iw, double *w, int mem);
static double x[CHAIN_STATES], f[CHAIN_STATES], g[CHAIN_STATES], work[CHAIN_RHS_WORK], w[9 * CHAIN_STATES + 100];
static double seconds(long n, int which)
{
    clock_t start = clock();
    long i;
    const double *arg[16] = {0, x, chain_nominal};
    double *res[16] = {f};
    if (which == 1) for (i = 0; i < n; i++) chain_rhs(0.0, x, chain_nominal, f, work);
    else if (which == 0) for (i = 0; i < n; i++) plain(x, chain_nominal, g, CHAIN_SITES);
    else for (i = 0; i < n; i++) casadi_rhs(arg, res, 0, w, 0);
    return (double)(clock() - start) / CLOCKS_PER_SEC;
}
int main(void)
{
    double best[3] = {1e9, 1e9, 1e9}, worst = 0.0;
    long n = 1000;
    int k;
    for (k = 0; k < CHAIN_STATES; k++) x[k] = sin(k + 1.0);
    while (seconds(n, 0) < 0.02) n *= 2;
    for (k = 0; k < 60; k++) best[k % 3] = fmin(best[k % 3], seconds(n, k % 3));
    seconds(1, 1);
    for (k = 0; k < CHAIN_STATES; k++) worst = fmax(worst, fabs(f[k] - g[k]));
    printf("%.9g %.9g %.9g %.3g\n", best[1] / (double)n, best[0] / (double)n, best[2] / (double)n, worst);
    return 0;
}
"""


@pytest.mark.parametrize("level", ["-O2", "-O3"])
@pytest.mark.parametrize("sites", [2, 3, 4, 5, 6, 7, 8, 10, 24, 50, 100, 200, 500, 1000])
def test_right_hand_side_against_a_plain_loop(sites: int, level: str, tmp_path: Path) -> None:
    """Generated code takes at most 1.2 times what a loop written by hand takes, at every number of sites."""
    chain = Chain(sites, 1.0, 0.25, 1.0)
    folder = export_c(chain, tmp_path / "c", ["rhs"])
    model = chain.tunable_model()
    generator = ca.CodeGenerator("casadi.c", {"with_export": False})
    generator.add(model.function("casadi_rhs", ca.densify(model.full_rhs)))
    (folder / "casadi.c").write_text(generator.dump() if sites <= 200 else UNTIMED)  # gcc takes a minute for a thousand
    (folder / "main.c").write_text(AGAINST)
    (folder / "plain.c").write_text(PLAIN)
    sources = sorted(path.name for path in folder.glob("*.c"))
    for compiler in filter(shutil.which, ("gcc", "clang", "clang-14")):
        command = [compiler, "-std=c99", level, "-falign-loops=32", *sources, "-lm", "-o", "driver"]
        subprocess.run(command, cwd=folder, check=True)  # where a loop begins makes up to a fourth of its time
        done = subprocess.run([str(folder / "driver")], capture_output=True, text=True, check=True)
        ours, plain, casadi, difference = map(float, done.stdout.split())
        size = (folder / "chain.c").stat().st_size
        told = f"{1e9 * ours:.1f} ns, by hand {1e9 * plain:.1f}: {ours / plain:.2f}; "
        told += f"CasADi's own C {1e9 * casadi:.1f}: {ours / casadi:.2f}; {size} B"
        print(f"  {compiler} {level} N = {sites}: {told}")
        assert difference < 1e-14
        assert ours / plain < 1.2


def in_c(orbit: Orbit, directory: Path) -> Times:
    """Seconds of a call of each function in C; Newton's result is compared with the orbit."""
    export_c(orbit, directory)
    (directory / "main.c").write_text(DRIVER.replace("@STEPS", str(STEPS)))
    sources = sorted(path.name for path in directory.glob("*.c"))
    started = time.perf_counter()
    subprocess.run(["gcc", "-std=c99", "-O2", *sources, "-lm", "-o", "driver"], cwd=directory, check=True)
    print(f"\n  gcc -O2 of everything: {time.perf_counter() - started:.1f} s")
    done = subprocess.run([str(directory / "driver")], capture_output=True, text=True, check=True)
    iterations, Omega, largest = done.stderr.split()
    assert abs(float(Omega) / orbit.Omega - 1) < 1e-12
    assert abs(float(largest) - orbit.floquet().max_abs_multiplier) < 1e-6
    print(f"  Newton from a guess wrong by 1e-3: {iterations} iterations")
    return {name: float(value) for name, value in (line.split() for line in done.stdout.splitlines())}


def seconds(act: Callable[[], object], repeats: int) -> float:
    """Median of the processor time of a call, as C's clock has it: other processes on the machine matter less."""
    act()
    times = []
    for _ in range(repeats):
        number, started = 1, time.process_time()
        act()
        once = time.process_time() - started
        if once < 1e-3:
            number, started = 1 + int(1e-3 / max(once, 1e-6)), time.process_time()
            for _ in range(number):
                act()
            once = time.process_time() - started
        times.append(once / number)
    return float(np.median(times))


def buffered(function: ca.Function, *arguments: np.ndarray) -> Callable[[], object]:
    """A call of a CasADi function without conversions."""
    buffer, trigger = function.buffer()
    given = [np.ascontiguousarray(argument, dtype=float) for argument in arguments]
    results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    for i, argument in enumerate(given):
        buffer.set_arg(i, argument.data)
    for i, result in enumerate(results):
        buffer.set_res(i, result.data)

    def call() -> object:
        trigger()
        return given, results, buffer  # kept alive

    return call


def splitting_in_casadi(chain: Chain) -> ca.Function:
    """The flow with its transition matrix as STEPS steps of an MX function, J V sparse times dense."""
    model = chain.gauge_model()
    n, J = model.size, ca.jacobian(model.rhs, model.state)
    force = ca.Function("force", [model.state, model.parameters], [ca.densify(model.rhs), J])
    X, p, h = ca.MX.sym("X", n, 2 + 4 * n), ca.MX.sym("p"), ca.MX.sym("h")
    q, v, Q, V = ca.horzsplit(X, [0, 1, 2, 2 + 2 * n, 2 + 4 * n])
    drifts, kicks = srkn_coefficients()
    for stage, kick in enumerate(kicks):
        f, Jq = force(q, p)
        v, V = v + kick * h * f, V + kick * h * (Jq @ Q)
        if stage < drifts.size:
            q, Q = q + drifts[stage] * h * v, Q + drifts[stage] * h * V
    step = ca.Function("step", [X, ca.vertcat(p, h)], [ca.horzcat(q, v, Q, V)])
    return step.mapaccum(STEPS)


def in_casadi(orbit: Orbit) -> dict[str, Callable[[], object]]:
    chain, problem = orbit.model, orbit.point.problem
    model, n = chain.tunable_model(), 2 * chain.sites
    J = ca.jacobian(model.full_rhs, model.full_state)
    results = [ca.densify(model.full_rhs), J, ca.densify(ca.jacobian(model.full_rhs, model.parameters))]
    x, p, V = np.sin(np.arange(n) + 1.0), np.array(model.nominal), ca.MX.sym("V", n, n)
    jacobian, state, parameters = model.function("derivatives", *results), ca.MX.sym("x", n), ca.MX.sym("p", 3)
    f, Jx, _ = jacobian(0, state, parameters)
    variational = ca.Function("variational", [state, parameters, V], [f, Jx @ V])
    start = np.zeros((n // 2, 2 + 2 * n))
    start[:, 0] = orbit.profile / chain.rho
    start[:, 2 : 2 + n // 2], start[:, 2 + n + n // 2 :] = np.eye(n // 2), np.eye(n // 2)
    h = np.tile([orbit.point.parameter, 0.25 * orbit.period / STEPS], STEPS)
    return {
        "rhs": buffered(model.vector_field, np.zeros(1), x, p),
        "jacobian": buffered(jacobian, np.zeros(1), x, p),
        "variational": buffered(variational, x, p, np.eye(n)),
        "residual": lambda: problem.evaluate(orbit.point.z),
        "newton": rootfinder(orbit, "newton"),
        "flow": buffered(splitting_in_casadi(chain), start.T, h),
    }


def rootfinder(orbit: Orbit, kind: str) -> Callable[[], object]:
    function, guess, kappa = square(orbit, kind)
    solved = function(guess, kappa)
    assert abs(float(solved[orbit.point.problem.Omega_index]) / orbit.Omega - 1) < 1e-10
    return buffered(function, guess, kappa)


def square(orbit: Orbit, kind: str) -> tuple[ca.Function, np.ndarray, np.ndarray]:
    """CasADi's root finder on the equations at fixed kappa, its guess and kappa."""
    problem = orbit.point.problem
    z, residual, _ = problem.symbols
    held = ca.MX.sym("held")
    equations = {"x": z, "p": held, "g": ca.vertcat(ca.densify(residual), z[problem.parameter_index] - held)}
    finder = ca.rootfinder("finder", kind, equations, {"abstol": 1e-12})
    start, value = ca.MX.sym("start", problem.size), ca.MX.sym("value")
    function = ca.Function(f"solved_{kind}", [start, value], [finder(start, value)])
    guess = orbit.point.z * (1.0 + 1e-3 * np.sin(np.arange(problem.size) + 1.0))
    return function, guess, np.array([orbit.point.parameter])


def in_numpy(orbit: Orbit) -> dict[str, Callable[[], object]]:
    chain, problem, model = orbit.model, orbit.point.problem, orbit.model.gauge_model()
    N, n, H = chain.sites, 2 * chain.sites, problem.resolution
    x, V = np.sin(np.arange(n) + 1.0), np.eye(n)
    z, kappa, Omega = orbit.point.z, orbit.point.parameter, orbit.Omega
    D2, weights, s = second_derivative_matrix(H), chain.weights[:, None], chain.coupling

    def force(y: np.ndarray, left: float, right: float) -> np.ndarray:
        result = -(2 + chain.alpha) * y
        result[1:] += left * y[:-1]
        result[:-1] += right * y[1:]
        return result

    def rhs() -> np.ndarray:
        y = x[:N]
        return np.concatenate([x[N:], force(y, 1 + chain.gamma, 1 - chain.gamma) - chain.g * y**3])

    def variational() -> tuple[np.ndarray, np.ndarray]:
        lower = force(V[:N], 1 + chain.gamma, 1 - chain.gamma) - 3 * chain.g * (x[:N] ** 2)[:, None] * V[:N]
        return rhs(), np.concatenate([V[N:], lower])

    def residual() -> tuple[np.ndarray, np.ndarray]:
        q = z[: problem.states].reshape(N, H)
        stiffness = -(2 + chain.alpha) - 3 * kappa * weights * q**2
        return q @ D2 - (force(q, s, s) - kappa * weights * q**3) / Omega**2, stiffness

    along = JacobianAlong(model)
    splitting = SplittingMap(along, STEPS)
    theta = 0.5 * np.pi * splitting.fractions

    def flow() -> np.ndarray:
        nonzeros = along(problem.sample(z, theta), np.full(theta.size, kappa))
        return splitting(nonzeros[None], np.array([0.25 * orbit.period]))[0]

    corrector, guess = NewtonCorrector(problem, 1e-12), square(orbit, "fast_newton")[1]
    Phi = flow()
    return {
        "rhs": rhs,
        "jacobian": lambda: (rhs(), -(2 + chain.alpha) - 3 * chain.g * x[:N] ** 2),
        "variational": variational,
        "residual": residual,
        "newton": lambda: corrector.correct(guess, problem.parameter_row(), kappa),
        "flow": flow,
        "multipliers": lambda: np.linalg.eigvals(Phi[:N, N:].T @ Phi[N:, :N]),
        "orbit": lambda: orbit.evaluate(0.3),
    }


@pytest.mark.parametrize("sites", [24, 200])
def test_functions(sites: int, tmp_path: Path) -> None:
    orbit = follow_family(
        Chain(sites, 1.0, 0.25, 1.0), mode=sites, amplitude_max=1.0, at=(1.0,), tolerance=1e-10, tail="full"
    ).at(S=1.0)
    c = in_c(orbit, tmp_path / "c")
    vm = {name: seconds(call, 9 if sites > 100 else 101) for name, call in in_casadi(orbit).items()}
    np_ = {name: seconds(call, 9 if sites > 100 else 101) for name, call in in_numpy(orbit).items()}
    print(f"  N = {sites}, H = {orbit.point.problem.resolution}")
    print("  | function | C, microseconds | CasADi / C | numpy / C |")
    for name, value in c.items():
        ratios = [f"{other[name] / value:.3g}" if name in other else "" for other in (vm, np_)]
        print(f"  | {name} | {1e6 * value:.3g} | {ratios[0]} | {ratios[1]} |")


def test_newton_solvers_in_c(tmp_path: Path) -> None:
    """Our Newton with a band, and CasADi's fast_newton: seconds of a solve in C."""
    for sites in (4, 8, 24):
        orbit = follow_family(
            Chain(sites, 1.0, 0.25, 1.0), mode=sites, amplitude_max=1.0, at=(1.0,), tolerance=1e-10
        ).at(S=1.0)
        directory = export_c(orbit, tmp_path / f"band{sites}")
        (directory / "main.c").write_text(DRIVER.replace("@STEPS", str(STEPS)))
        found = {"band": newton_time(directory)}
        function, guess, kappa = square(orbit, "fast_newton")
        started = time.perf_counter()
        source = c_source("fast", [function])
        built = time.perf_counter() - started
        directory = tmp_path / f"fast{sites}"
        directory.mkdir()
        (directory / "fast.c").write_text(source)
        numbers = ", ".join(f"{value:.17g}" for value in guess)
        sizes = {size: getattr(function, size)() for size in ("sz_arg", "sz_res", "sz_iw", "sz_w")}
        names = {"prototype": prototype(function), "name": function.name()}
        (directory / "main.c").write_text(
            FAST.format(numbers=numbers, kappa=kappa[0], Omega=orbit.Omega, **sizes, **names)
        )
        found["fast_newton"] = newton_time(directory)
        words = ", ".join(f"{name} {1e6 * value:.4g} us" for name, value in found.items())
        print(f"  N = {sites}, {orbit.point.problem.size} unknowns: {words}; fast_newton: {len(source) / 1e3:.0f} kB")
        assert built < 60


FAST = """#include <stdio.h>
#include <math.h>
#include <time.h>
{prototype};
static double guess[] = {{{numbers}}}, kappa = {kappa:.17g}, z[sizeof guess / sizeof *guess], w[{sz_w} + 1];
static const double *arg[{sz_arg} + 1];
static double *res[{sz_res} + 1];
static long long int iw[{sz_iw} + 1];
int main(void)
{{
    long n = 1, i;
    double s;
    do {{
        clock_t a;
        n *= 2;
        a = clock();
        for (i = 0; i < n; i++) {{
            arg[0] = guess; arg[1] = &kappa; res[0] = z;
            if ({name}(arg, res, iw, w, 0)) return 1;
        }}
        s = (double)(clock() - a) / CLOCKS_PER_SEC;
    }} while (s < 0.3);
    printf("newton %.9g\\n", s / n);
    return fabs(z[sizeof z / sizeof *z - 2] / {Omega:.17g} - 1.0) > 1e-11;
}}
"""


def newton_time(directory: Path) -> float:
    sources = sorted(path.name for path in directory.glob("*.c"))
    subprocess.run(["gcc", "-std=c99", "-O2", *sources, "-lm", "-o", "driver"], cwd=directory, check=True)
    done = subprocess.run([str(directory / "driver")], capture_output=True, text=True, check=True)
    return next(float(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("newton"))
