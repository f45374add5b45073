"""Compiled kernels: the same numbers as numpy's, built with the package, and numpy where there was no compiler."""

from __future__ import annotations

import ctypes
import itertools
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from kernels import forget, needs_kernels, numpy_alone
from lattices import plane
from small_models import oscillation, pendulums

from casadi_skin import Branch, Chain, Orbit, find_orbit, follow_family, native
from casadi_skin.dynamics.evolution import equations_of_motion
from casadi_skin.dynamics.evolve import evolve
from casadi_skin.model import operations
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import Monomials
from casadi_skin.native import orbits
from casadi_skin.native.dense import DenseKernel
from casadi_skin.search.kick_flow import ChainForce
from casadi_skin.solve.bordered import BorderedSolver, CompiledFactors
from casadi_skin.stability.closed_maps import Multipliers, Spectrum, Trivial, multipliers_along
from casadi_skin.stability.flows import JacobianAlong, SplittingMap, srkn_step
from casadi_skin.stability.full_period import Closed, by_collocation, interval_maps, judged, needed_parts
from casadi_skin.zero.butcher import CollocationTable, gauss_table, radau_table
from casadi_skin.zero.cosines import PolynomialForm, TaylorRecursion, TrigonometricProblem
from casadi_skin.zero.family import family_request


def both_ways(model: OdeModel, steps: int, orbits: int) -> list[np.ndarray]:
    """Transition matrices along random states, by the kernel and by numpy."""
    jacobian, generator = JacobianAlong(model), np.random.default_rng(3)
    flow = SplittingMap(jacobian, steps)
    phases = orbits * flow.fractions.size
    values = jacobian(0.3 * generator.normal(size=(phases, model.size)), generator.normal(size=phases))
    nonzeros, durations = values.reshape(orbits, flow.fractions.size, -1), generator.uniform(0.5, 1.5, size=orbits)
    found = [flow(nonzeros, durations)]
    with numpy_alone():
        return [*found, flow(nonzeros, durations)]


@needs_kernels
@pytest.mark.parametrize(
    "model",
    [
        *(Chain(n, 1.0, 0.3, -1.0).gauge_model() for n in (1, 2, 7, 8, 9, 17, 24, 33, 150)),
        family_request(pendulums(), 1, 1.0).coordinates.scaled,
        family_request(plane((4, 3)), 1, 1.0).coordinates.scaled,  # J with two bands
    ],
    ids=lambda model: f"{model.name}, {model.size}",
)
def test_kernel_and_numpy_agree_to_rounding(model: OdeModel) -> None:
    compiled, plain = both_ways(model, 5, 3)
    np.testing.assert_allclose(compiled, plain, rtol=1e-13, atol=1e-14 * np.max(np.abs(plain)))


@needs_kernels
@pytest.mark.parametrize("n", [1, 2, 3, 5])
@pytest.mark.parametrize("table", [gauss_table(1), gauss_table(6), radau_table(4)])
def test_maps_over_intervals_are_those_by_numpy(table: CollocationTable, n: int) -> None:
    """Also those that need exchanges: two of nineteen, whose first pivot is 1e-9."""
    generator, K = np.random.default_rng(n), 19
    lengths = generator.uniform(0.02, 0.08, size=K)
    stages = generator.normal(size=(K * table.degree, n, n))
    stages[[0, 5 * table.degree], 0, 0] = (1.0 - 1e-9) / (lengths[[0, 5]] * table.matrix[0, 0])
    found = interval_maps(stages, lengths, table)[0]
    with numpy_alone():
        plain = interval_maps(stages, lengths, table)[0]
    np.testing.assert_allclose(found, plain, rtol=0, atol=1e-12 * np.max(np.abs(plain)))


@needs_kernels
@pytest.mark.parametrize("known", [(0, 0), (1, 0), (1, 1), (2, 1)])
@pytest.mark.parametrize("scale", [1.0, 4.0])
@pytest.mark.parametrize("with_product", [False, True])
def test_multipliers_of_chains_of_maps_are_those_by_numpy(
    known: tuple[int, int], scale: float, with_product: bool
) -> None:
    """Far from 1 too, by a periodic Schur form; some vectors are carried along, as those of time and of gradients."""
    generator, K, n = np.random.default_rng(7), 40, 5
    frames = np.linalg.qr(generator.normal(size=(K, n, n)))[0]
    frames = np.concatenate([frames, frames[:1]])
    upper = np.eye(n) * np.exp(scale * np.linspace(0.3, -0.3, n)) + np.triu(0.2 * generator.normal(size=(K, n, n)), 1)
    upper[:, range(sum(known)), range(sum(known))] = 1.0
    maps = frames[1:] @ upper @ frames[:-1].swapaxes(1, 2)
    right, left = np.split(frames.swapaxes(1, 2)[:, : sum(known)], [known[0]], axis=1)
    trivial = Trivial(sum(known), right, left)
    signs, logs = np.linalg.slogdet(maps)
    known_product = (float(signs.prod()), float(logs.sum())) if with_product else None
    found = multipliers_along(maps, trivial, np.ones(n), known_product)
    with numpy_alone():
        plain = multipliers_along(maps, trivial, np.ones(n), known_product)
    np.testing.assert_allclose(found.others.logs, plain.others.logs, rtol=1e-11, atol=1e-9)
    np.testing.assert_allclose(found.trivial.values, plain.trivial.values, rtol=0, atol=1e-6)  # double ones
    np.testing.assert_allclose(found.rounding, plain.rounding, rtol=1e-3, atol=1e-300)
    np.testing.assert_allclose(found.matrix, plain.matrix, rtol=0, atol=1e-11)


def driven_and_free(kind: str) -> Orbit:
    """A forced orbit, one that is free, and one of which several multipliers are far from 1 on long intervals."""
    x, y, z, t, p = (ca.SX.sym(name) for name in "xyztp")
    oscillator = ca.vertcat(y, p * (1.0 - x**2) * y - x)
    if kind == "forced":
        field = ca.vertcat(y, -x - 0.3 * y - x**3 + p * ca.cos(t))
        model = OdeModel("forced", ca.vertcat(x, y), field, p, time=t, forcing_period=2.0 * np.pi)
        return find_orbit(model, lambda t: [0.1 * np.sin(t), 0.1 * np.cos(t)], parameters={"p": 0.2})
    pull = {"free": 0.3, "far": 20.0}[kind]
    model = OdeModel(kind, ca.vertcat(x, y, z), ca.vertcat(oscillator, pull * (x - z)), p)
    return find_orbit(model, lambda t: [2 * np.cos(t), -2 * np.sin(t), np.sin(t)], 6.6, parameters={"p": 1.0})


@needs_kernels
@pytest.mark.parametrize("kind", ["forced", "free", "far"])
def test_multipliers_of_orbits_at_once_are_those_by_numpy(kind: str) -> None:
    point, space = (orbit := driven_and_free(kind)).point, orbit.space
    better, closed = space._better(point), Closed(point.problem, point.z, orbit.model)
    jacobians = point.problem.discretisation.jacobians(point.z, point.problem.numbers, closed.size)
    assert (needed_parts(point.problem, jacobians) is not None) == (kind == "far")
    assert closed.found_at_once(True) is not None
    finer = Closed(better.problem, better.z, orbit.model)
    with numpy_alone():
        other = driven_and_free(kind)
        levels = other.space.levels

    def by_numpy(each: Closed) -> Closed:
        problem = levels.problem(each.problem.resolution).with_constants(each.problem.constants)
        return Closed(problem, each.z, other.model)

    for with_errors in (True, False):
        found = by_collocation(closed, finer if with_errors else None, 1e-8)
        with numpy_alone():
            assert by_numpy(closed).found_at_once(True) is None
            plain = by_collocation(by_numpy(closed), by_numpy(finer) if with_errors else None, 1e-8)
        assert found.trivial == plain.trivial == (kind != "forced")
        np.testing.assert_allclose(found.log_moduli, plain.log_moduli, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(found.multipliers, plain.multipliers, rtol=1e-11, atol=1e-13)
        np.testing.assert_allclose(found.other_errors, plain.other_errors, rtol=0.2, atol=1e-13)
        np.testing.assert_allclose(found.monodromy, plain.monodromy, rtol=1e-10, atol=1e-12)
        np.testing.assert_array_equal(found.on_circle, plain.on_circle)
        np.testing.assert_array_equal(found.real, plain.real)
        sizes = [[each.error, each.max_abs_multiplier, each.allowed_deviation] for each in (found, plain)]
        np.testing.assert_allclose(*sizes, rtol=0.2, atol=1e-13)
        assert max(found.trivial_deviation, plain.trivial_deviation) < 1e-10


@needs_kernels
@pytest.mark.parametrize("angle", [0.3, 2.8])
def test_errors_of_multipliers_are_those_by_numpy(angle: float) -> None:
    """Of a real one, a pair, one beyond the largest double and a trivial one; none where two have one nearest."""
    values = np.array([1.0 + 1e-9, 0.7, 1.2 * np.exp(1j * angle), 1.2 * np.exp(-1j * angle)])
    logs, phases = np.append(np.log(np.abs(values)), 800.0), np.append(values / np.abs(values), -1.0)

    def both(moved: float) -> tuple[np.ndarray, Multipliers]:
        at = logs + moved
        spectra = Spectrum(at[:1], phases[:1]), Spectrum(at[1:], phases[1:])
        row = [at, phases.real, phases.imag, np.full(5, 1e-13), np.eye(5).ravel(), [1.0, 2.0, 3.0, 0.0, 0.0]]
        return np.concatenate(row), Multipliers(*spectra, np.full(4, 1e-13), np.eye(5), 2.0, 3.0)

    (found, one), (better, other) = both(0.0), both(1e-7)
    plain, row = judged(one, other, 1e-8, 0.5), orbits.judged(5, found, better, 4.0, 1e-6)
    multipliers, (all_logs, errors, on_circle, real), matrix, (_, deviation, error, largest, allowed) = row
    for own, numbers in zip(
        (multipliers, all_logs, errors[:4], on_circle[:4], real[:4], matrix, [deviation, error, largest, allowed]),
        (
            plain.multipliers, plain.log_moduli, plain.other_errors, plain.on_circle, plain.real, plain.monodromy,
            [plain.trivial_deviation, plain.error, plain.max_abs_multiplier, plain.allowed_deviation],
        ),
        strict=True,
    ):  # fmt: skip
        np.testing.assert_allclose(own, numbers, rtol=1e-8)  # distances of 1e-7 have nine digits
    better[[1, 6, 11]] = better[[2, 7, 12]]
    assert orbits.judged(5, found, better, 4.0, 1e-6) is None


@needs_kernels
@pytest.mark.parametrize("highest", [1, 5])
def test_series_by_the_kernel_are_those_by_numpy(highest: int) -> None:
    """Random terms of all degrees and powers of the parameter, in any order, also without any state."""
    generator, orders = np.random.default_rng(5), 9
    problem = TrigonometricProblem(Chain(5, 1.0, 0.3, -1.0).gauge_model(), 6)

    def terms(rows: int) -> tuple[Monomials, ...]:
        groups = []
        for power, degree in itertools.product(range(highest), range(5)):
            count = int(generator.integers(1, 4))
            chosen = np.sort(generator.choice(rows, min(count, rows), replace=False))
            factors = generator.integers(0, 5, size=(degree, chosen.size))
            groups.append(Monomials(power, chosen, generator.normal(size=chosen.size), factors))
        return tuple(groups)

    form = PolynomialForm(terms(5), terms(1))
    z, slope = generator.normal(size=(2, problem.size))
    mixing = generator.normal(size=(problem.size, problem.size)) / problem.size
    found = TaylorRecursion(problem, form, orders).series(z, slope, lambda right: mixing @ right)
    with numpy_alone():
        plain = TaylorRecursion(problem, form, orders).series(z, slope, lambda right: mixing @ right)
    sizes = np.max(np.abs(plain), axis=1, keepdims=True)
    assert np.all(sizes > 0.0)
    np.testing.assert_allclose(found / sizes, plain / sizes, rtol=0, atol=1e-12)


@needs_kernels
@pytest.mark.parametrize("sites", [4, 24])
def test_orders_solved_by_the_kernel_are_those_solved_one_by_one(sites: int) -> None:
    chain = Chain(sites, 1.0, 0.25, -1.0)
    problem = TrigonometricProblem(chain.gauge_model(), 4)
    z, row, slope = np.random.default_rng(sites).normal(size=(3, problem.size))
    z[problem.Omega_index] = 1.4
    solve = BorderedSolver(problem).factor(z, problem.evaluate(z)[1], row)
    assert isinstance(solve, CompiledFactors)
    series = TaylorRecursion(problem, PolynomialForm.of(chain.gauge_model()), 12).series
    found, plain = series(z, slope, solve), series(z, slope, lambda right: solve(right))
    sizes = np.max(np.abs(plain), axis=1, keepdims=True)
    np.testing.assert_allclose(found / sizes, plain / sizes, rtol=0, atol=1e-12)


@needs_kernels
def test_multipliers_of_a_family_do_not_depend_on_the_kernels() -> None:
    """Those for any processor, for AVX2 and for AVX-512 give the same bits, numpy the same numbers but for rounding."""

    def family() -> Branch:
        return follow_family(Chain(10, 1.0, 0.25, -1.0), 1, 1.0, at=(0.2, 1.0), stability=True, tolerance=1e-9)

    found = family()
    plain = []
    for numbers, words in {2: "compiled", 4: "compiled for AVX2", 8: "compiled for AVX-512"}.items():
        if numbers <= ctypes.CDLL(str(native.LIBRARY)).numbers_together():
            with library_for(numbers):
                assert native.kernels_in_words() == words
                plain.append(family())
    with numpy_alone():
        assert native.kernels_in_words() == "numpy"
        by_numpy = family()
    assert found.changes
    assert len(by_numpy.changes) == len(found.changes)
    for one, last, *others in zip(found.orbits, by_numpy.orbits, *(each.orbits for each in plain), strict=True):
        for other in others:
            np.testing.assert_array_equal(one.floquet().multipliers, other.floquet().multipliers)
            assert (one.Omega, one.S) == (other.Omega, other.S)
        assert abs(one.Omega - last.Omega) <= 1e-10
        assert abs(one.S - last.S) <= 1e-8
        np.testing.assert_allclose(one.floquet().multipliers, last.floquet().multipliers, rtol=0, atol=1e-10)


@needs_kernels
@pytest.mark.parametrize("name", native.OPERATIONS)
def test_an_operation_of_a_program_is_that_of_casadi(name: str) -> None:
    """Of lists at all kinds of steps, also of numbers that are not finite: a kick by it from rest is its value."""
    numbers = [0.0, 1.0, -1.0, 0.3, -2.5, 7.0, 1e-300, 1e300, np.inf, -np.inf, np.nan]
    x, p, code = ca.SX.sym("x", 24), ca.SX.sym("p", 2), operations.CODES[name]
    pairs = [*((k, k + 1) for k in range(15)), *((23 - 2 * k, k) for k in range(7))]
    arguments = [*((x[a], x[b]) for a, b in pairs), (p[0], x[5]), (p[1], p[0])]
    unary = name in operations.ONE_ARGUMENT
    entries = [ca.SX.unary(code, a) if unary else ca.SX.binary(code, a, b) for a, b in arguments]
    force, generator = ca.Function("force", [x, p], [ca.densify(ca.vertcat(*entries))]), np.random.default_rng(3)
    for _ in range(20):
        state, parameters = generator.choice(numbers, 24), generator.choice(numbers, 2)
        program = native.program_lists(*operations.read(force), parameters)
        assert program is not None
        after = np.concatenate([state, np.zeros(24)])[None]
        kick = np.ones(1), np.zeros(0)
        native.stepped(program, kick, np.array([1]), np.ones(1), after)
        np.testing.assert_array_equal(after[0, 24:], np.array(force(state, parameters)).ravel())


@needs_kernels
@pytest.mark.parametrize("model", [Chain(24, 1.0, 0.25, -1.0), pendulums(5), plane((4, 3))], ids=lambda m: m.name)
def test_steps_of_the_kernel_are_those_of_casadi(model: Any) -> None:
    n = equations_of_motion(model).positions
    start, t = 0.3 * np.random.default_rng(1).normal(size=(2, n)) * (np.arange(n) > n - 4), np.linspace(0.0, 30.0, 40)
    found = evolve(model, *start, t, "symplectic", 1e-8)
    with numpy_alone():
        plain = evolve(model, *start, t, "symplectic", 1e-8)
    np.testing.assert_array_equal(found.states, plain.states)
    assert (found.step, found.evaluations) == (plain.step, plain.evaluations)


@pytest.mark.parametrize("without", [pytest.param(False, marks=needs_kernels), True])
def test_derivatives_of_segments_are_those_of_casadi(without: bool) -> None:
    """Of three segments, the last of which is shorter: states, first and second derivatives."""
    chain, generator, h = Chain(5, 1.0, 0.3, -1.0), np.random.default_rng(2), 0.4
    model, step = chain.gauge_model(), ca.SX.sym("h")
    q, v = srkn_step(model, step, -0.7)
    one = ca.Function("one", [ca.vertcat(model.state, model.velocity, step)], [ca.vertcat(q, v, step)])
    counts, (states, multipliers) = np.array([3, 3, 1]), generator.normal(size=(2, 3, 10))
    force = ChainForce(2.0 + chain.alpha, chain.coupling, -0.7 * np.asarray(chain.weights))
    with numpy_alone() if without else nullcontext():
        found = force.segments(counts, h, states, multipliers)
        first = force.segments(counts, h, states)
    assert first[2] is None
    x, given = ca.SX.sym("x", 11), ca.SX.sym("given", 10)
    for k, count in enumerate(counts.tolist()):
        after = x
        for _ in range(count):
            after = one(after)
        results = [after[:10], ca.jacobian(after[:10], x), ca.hessian(ca.dot(given, after[:10]), x)[0]]
        function = ca.Function("segment", [x, given], results)
        for number, value in enumerate(function(np.append(states[k], h), multipliers[k])):
            expected = np.array(value).reshape(np.shape(found[number][k]))
            np.testing.assert_allclose(found[number][k], expected, rtol=0, atol=1e-13 * np.max(np.abs(expected)))
            if number < 2:
                np.testing.assert_allclose(first[number][k], found[number][k], rtol=0, atol=1e-15)


@needs_kernels
def test_orbits_do_not_depend_on_the_kernels() -> None:
    """The same bits on processors of all kinds, the same numbers by numpy and SuperLU but for rounding."""

    def orbit() -> tuple[float, np.ndarray]:
        found = oscillation()
        return found.period, found.floquet().multipliers

    period, multipliers = orbit()
    for numbers in (2, 4, 8):
        if numbers <= ctypes.CDLL(str(native.LIBRARY)).numbers_together():
            with library_for(numbers):
                other, others = orbit()
            assert other == period
            np.testing.assert_array_equal(others, multipliers)
    with numpy_alone():
        other, others = orbit()
    assert other == pytest.approx(period, rel=1e-12)
    np.testing.assert_allclose(others, multipliers, rtol=0, atol=1e-9)


@contextmanager
def library_for(numbers: int) -> Iterator[None]:
    """The kernels for processors whose registers hold so many numbers."""

    class Plain(ctypes.CDLL):
        numbers_together = staticmethod(lambda: numbers)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("casadi_skin.native.ctypes.CDLL", Plain)
        forget()
        yield
    forget()


# The build ------------------------------------------------------------------------------------------------------------

CLONE = Path(__file__).parents[2]
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler here")


def build(folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """What `python hatch_build.py` says in a folder with the kernels alone."""
    shutil.copy(CLONE / "hatch_build.py", folder)
    shutil.copytree(CLONE / "casadi_skin" / "native", folder / "casadi_skin" / "native", ignore=ignored)
    command = [sys.executable, str(folder / "hatch_build.py")]
    return subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=False)


ignored = shutil.ignore_patterns("*.so", "__pycache__")


@needs_compiler
def test_kernels_are_built_in_a_clone_and_nothing_else_is_left_there(tmp_path: Path) -> None:
    done = build(tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    (made,) = (path for path in tmp_path.rglob("*") if path.suffix not in {"", ".c", ".h", ".py"})
    library = ctypes.CDLL(str(made))
    for name in native.FUNCTIONS:
        assert hasattr(library, name)
        assert all(hasattr(library, name + end) == (platform.machine() == "x86_64") for end in ("_avx2", "_avx512"))


@pytest.mark.parametrize(("compiler", "words"), [("/bin/false", "/bin/false"), ("no-such-cc", "No such file")])
def test_a_build_without_a_compiler_says_so(compiler: str, words: str, tmp_path: Path) -> None:
    done = build(tmp_path, CC=compiler)
    assert done.returncode == 1
    assert done.stderr.startswith("no kernels: ")
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list((tmp_path / "casadi_skin" / "native").glob("*.so"))


def test_a_library_of_another_system_is_no_fault(tmp_path: Path) -> None:
    (tmp_path / "kernels.library").write_bytes(b"of another system")
    with numpy_alone(tmp_path / "kernels.library"):
        assert native.kernels() == {}
        assert native.kernels_in_words() == "numpy; the library is cut off, of other sources or of another system"


@needs_kernels
def test_a_library_of_other_sources_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """As after a change of a source in a clone: arguments that follow one another otherwise would end the process."""
    monkeypatch.setattr(native, "digest_of_sources", lambda: 1)
    with numpy_alone(native.LIBRARY):
        assert native.kernels_in_words() == "numpy; the library is cut off, of other sources or of another system"


@pytest.mark.skipif(not native.LIBRARY.exists(), reason="the package was built without a C compiler")
def test_the_kernels_in_use_are_those_of_the_sources() -> None:
    """Else `python hatch_build.py` builds them anew."""
    assert native.kernels()


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(
    ("compiler", "tag", "words"),
    [("cc", f"py3-none-{platform.system().lower()}", "compiled"), ("/bin/false", "py3-none-any", "numpy")],
)
def test_a_wheel_has_kernels_where_there_is_a_compiler(compiler: str, tag: str, words: str, tmp_path: Path) -> None:
    """Built from a clone with kernels of its own, which stay out of it, and installed away from it."""
    pytest.importorskip("hatchling")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"]
    environment = os.environ | {"CC": compiler, "PYTHONPATH": ""}
    options = ["--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*pip, "wheel", *options, "--wheel-dir", str(tmp_path), str(CLONE)], env=environment, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert f"-{tag}" in wheel.name
    subprocess.run([*pip, "install", "--no-deps", "--target", str(tmp_path / "site"), str(wheel)], check=True)
    done = subprocess.run(
        [sys.executable, "-m", "casadi_skin", "--version"], env=os.environ | {"PYTHONPATH": str(tmp_path / "site")},
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert f"kernels: {words}" in done.stdout


@needs_kernels
@pytest.mark.parametrize("size", [2, 3, 8, 24])
def test_factors_of_small_matrices_are_those_of_numpy(size: int) -> None:
    """Solutions, signs of determinants, and which are singular but for rounding, in any units of the equations."""
    random, signs = np.random.default_rng(size), set[float]()
    for _ in range(30):
        full = random.normal(size=(size, size)) * 10.0 ** random.uniform(-3.0, 3.0, (size, 1))
        full[:-1][random.random((size - 1, size)) < 0.3] = 0.0
        columns, rows = (places.astype(np.int32) for places in np.nonzero(full[:-1].T))
        kernel = DenseKernel((rows, columns), (1e12, 1e-9), np.cos(np.arange(size - 1.0)))
        found = kernel.factors(full[rows, columns], full[-1])
        if np.linalg.cond(full / np.abs(full).max(axis=1)[:, None].clip(1e-300)) > 1e6:
            continue
        memory, sign = found
        b = random.normal(size=(3, size))
        known = np.linalg.solve(full, b.T).T
        kernel.solve(memory, b)
        np.testing.assert_allclose(b, known, rtol=0, atol=1e-9 * np.abs(known).max())
        assert sign == np.linalg.slogdet(full)[0]
        signs.add(sign)
        full[-1] = np.linalg.norm(full[-1]) * np.linalg.qr(full[:-1].T)[0] @ random.normal(size=size - 1)
        assert kernel.factors(full[rows, columns], full[-1]) is None
        assert kernel.factors(np.where(rows == 0, np.nan, full[rows, columns]), full[-1]) is None
    assert signs == {-1.0, 1.0}
