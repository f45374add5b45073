"""Compiled kernels: the same numbers as numpy's, from a cache that is private, and numpy where there is no compiler."""

from __future__ import annotations

import itertools
import os
import stat
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from lattices import plane
from small_models import pendulums

from casadi_skin import Chain, follow_family
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import Monomials
from casadi_skin.native import bordered, elimination, tail, taylor
from casadi_skin.native import jacobian as native_jacobian
from casadi_skin.native import library as native
from casadi_skin.native.decoupling import decoupling_kernel
from casadi_skin.native.library import KernelWarning, cache_folder, library, without
from casadi_skin.native.splitting import splitting_kernel
from casadi_skin.solve.bordered import BorderedSolver, CompiledFactors
from casadi_skin.stability import splitting
from casadi_skin.stability.jacobian import JacobianAlong
from casadi_skin.stability.splitting import SplittingFlow, SplittingMap
from casadi_skin.stability.stepping import OrbitState, SteppedFlow
from casadi_skin.zero import recursion, trigonometric
from casadi_skin.zero.recursion import PolynomialForm, TaylorRecursion
from casadi_skin.zero.request import family_request
from casadi_skin.zero.trigonometric import TrigonometricProblem

needs_compiler = pytest.mark.skipif(without() is not None, reason="no C compiler here")


@pytest.fixture
def fresh() -> Iterator[None]:
    """Nothing that this process loaded before."""
    forget()
    yield
    forget()


def forget() -> None:
    own = (
        library,
        splitting_kernel,
        decoupling_kernel,
        taylor._functions,
        native_jacobian._function,
        bordered._functions,
        tail._function,
        elimination._function,
    )
    for kept in (*own, trigonometric._kept):
        kept.cache_clear()


@pytest.fixture
def caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fresh: None) -> Path:
    """An empty folder for caches."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "casadi_skin"


def both_ways(model: OdeModel, steps: int, orbits: int, monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Transition matrices along random states, by the kernel and by numpy."""
    jacobian, generator = JacobianAlong(model), np.random.default_rng(3)
    flow = SplittingMap(jacobian, steps)
    phases = orbits * flow.fractions.size
    values = jacobian(0.3 * generator.normal(size=(phases, model.size)), generator.normal(size=phases))
    nonzeros, durations = values.reshape(orbits, flow.fractions.size, -1), generator.uniform(0.5, 1.5, size=orbits)
    found = [flow(nonzeros, durations)]
    with monkeypatch.context() as patch:
        patch.setattr(splitting, "splitting_kernel", lambda: None)
        found.append(flow(nonzeros, durations))
    return found


@needs_compiler
@pytest.mark.parametrize(
    "model",
    [
        *(Chain(n, 1.0, 0.3, -1.0).gauge_model() for n in (1, 2, 7, 8, 9, 17, 24, 33, 150)),
        family_request(pendulums(), 1, 1.0).coordinates.scaled,
        family_request(plane((4, 3)), 1, 1.0).coordinates.scaled,  # J with two bands
    ],
    ids=lambda model: f"{model.name}, {model.size}",
)
def test_kernel_and_numpy_agree_to_rounding(model: OdeModel, monkeypatch: pytest.MonkeyPatch) -> None:
    assert splitting_kernel() is not None
    compiled, plain = both_ways(model, 5, 3, monkeypatch)
    np.testing.assert_allclose(compiled, plain, rtol=1e-13, atol=1e-14 * np.max(np.abs(plain)))


@needs_compiler
@pytest.mark.parametrize("sites", [2, 9, 24, 31])
def test_a_flow_that_samples_orbits_itself_gives_the_same_bits(sites: int) -> None:
    """Against the kernels of J and of the flow one after the other; orbits of two resolutions, one taken twice."""
    model, generator = Chain(sites, 1.0, 0.3, -1.0).gauge_model(), np.random.default_rng(5)
    problems = [TrigonometricProblem(model, harmonics) for harmonics in (5, 5, 7)]
    orbits = [OrbitState(each, np.append(generator.normal(size=each.states), [1.7, 0.4])) for each in problems]
    flow, wanted = SplittingFlow(model, 1e-8), [(3, orbits), (4, orbits), (6, orbits[1:2])]
    inside = flow._sampled_inside(wanted)
    assert inside is not None
    for one, other in zip(inside, SteppedFlow.several(flow, wanted), strict=True):
        np.testing.assert_array_equal(one, other)


@needs_compiler
@pytest.mark.parametrize(
    "model",
    [
        *(Chain(n, 1.0, 0.3, g).gauge_model() for n in (1, 2, 24) for g in (-1.0, 0.0)),
        family_request(plane((4, 3)), 1, 1.0).coordinates.scaled,
    ],
    ids=lambda model: f"{model.name}, {model.size}",
)
def test_jacobians_along_orbits_by_the_kernel_are_those_at_their_states(
    model: OdeModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Orbits in odd cosines, sampled by the kernel; and by the problem itself where there is none."""
    problem, generator = TrigonometricProblem(model, 5), np.random.default_rng(4)
    z, theta = generator.normal(size=(3, problem.size)), np.linspace(0.0, 2.0, 7)
    along = JacobianAlong(model)
    assert along._kernel is not None
    found, plain = np.full((2, 3, 7, along.indices.size), np.nan)
    along.along(problem, z, theta, found)
    for one, values in zip(z, found, strict=True):
        exact = np.array(
            [cosines @ np.cos(np.outer(np.arange(1, 11, 2), theta)) for cosines in problem.coefficients(one)]
        )
        at_states = along(exact.T, np.full(7, one[problem.parameter_index]))
        np.testing.assert_allclose(values, at_states, rtol=0, atol=1e-13 * np.max(np.abs(at_states)))
    monkeypatch.setattr(JacobianAlong, "_kernel", None)
    along.along(problem, z, theta, plain)
    np.testing.assert_allclose(found, plain, rtol=0, atol=1e-13 * np.max(np.abs(found)))


@needs_compiler
def test_the_kernel_of_jacobians_takes_terms_of_all_degrees() -> None:
    generator = np.random.default_rng(6)
    sites, nodes, phases = 4, 3, 6
    values, weights = generator.normal(size=(2, sites * nodes + 2)), generator.normal(size=(nodes, phases))
    constant, parameters = generator.normal(size=5), np.array([0.7, -1.3])
    terms = [(power, place, generator.normal(), list(range(place))) for power in range(3) for place in range(5)]
    expected = np.tile(constant, (2, phases, 1))
    states = np.einsum("kam,mi->kia", values[:, : sites * nodes].reshape(2, sites, nodes), weights)
    for power, place, coefficient, factors in terms:
        expected[:, :, place] += coefficient * parameters[:, None] ** power * np.prod(states[:, :, factors], axis=2)
    found = np.full(expected.shape, np.nan)
    native_jacobian.JacobianKernel(constant, terms)(sites, values, weights, parameters, found)
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


@needs_compiler
@pytest.mark.parametrize("highest", [1, 5])
def test_series_by_the_kernel_are_those_by_numpy(highest: int, monkeypatch: pytest.MonkeyPatch) -> None:
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
    monkeypatch.setattr(recursion, "taylor_kernel", lambda *arguments: None)
    plain = TaylorRecursion(problem, form, orders).series(z, slope, lambda right: mixing @ right)
    sizes = np.max(np.abs(plain), axis=1, keepdims=True)
    assert np.all(sizes > 0.0)
    np.testing.assert_allclose(found / sizes, plain / sizes, rtol=0, atol=1e-12)


@needs_compiler
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


@needs_compiler
def test_multipliers_of_a_family_do_not_depend_on_the_kernel(caches: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain(10, 1.0, 0.25, -1.0)
    found = follow_family(chain, 1, 1.0, at=(0.2, 1.0), stability=True, events=False, tolerance=1e-9)
    assert list(caches.glob("splitting-*.so"))
    forget()
    monkeypatch.setenv(native.SWITCH, "0")
    assert splitting_kernel() is None
    plain = follow_family(chain, 1, 1.0, at=(0.2, 1.0), stability=True, events=False, tolerance=1e-9)
    assert list(caches.glob("taylor-*.so"))
    for one, other in zip(found.orbits, plain.orbits, strict=True):
        assert abs(one.Omega - other.Omega) <= 1e-10
        assert abs(one.S - other.S) <= 1e-8
        np.testing.assert_allclose(one.floquet().multipliers, other.floquet().multipliers, rtol=0, atol=1e-10)


@needs_compiler
def test_a_library_is_compiled_once_and_is_of_its_user_alone(caches: Path) -> None:
    old = os.umask(0)
    try:
        assert library("splitting") is not None
    finally:
        os.umask(old)
    (compiled,) = caches.iterdir()
    assert stat.S_IMODE(caches.stat().st_mode) == 0o700
    made = compiled.stat().st_mtime_ns
    library.cache_clear()
    assert library("splitting") is not None
    assert compiled.stat().st_mtime_ns == made


@needs_compiler
def test_another_processor_or_source_is_compiled_anew(
    caches: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "one.c").write_text("int one(void) { return 1; }")
    monkeypatch.setattr(native, "SOURCES", tmp_path)
    monkeypatch.setattr(native, "PROCESSOR", tmp_path / "cpuinfo")  # none: code for every processor
    for count, text in enumerate(("", "flags\t: sse2", "flags\t: sse2 avx"), start=1):
        if text:
            (tmp_path / "cpuinfo").write_text(f"processor\t: 0\n{text}\n\nprocessor\t: 1\n")
        library.cache_clear()
        assert library("one") is not None
        assert len(list(caches.iterdir())) == count
    for count, name in enumerate(("one.c", "shared.h"), start=4):
        (tmp_path / name).write_text("int one(void) { return 2; }")
        library.cache_clear()
        assert library("one") is not None
        assert len(list(caches.iterdir())) == count


@needs_compiler
@pytest.mark.parametrize("fault", ["open", "link", "file", "relative", "parent", "rubbish", "source", "homeless"])
def test_what_is_not_private_or_not_whole_is_not_loaded(
    fault: str, caches: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = str(caches)
    if fault == "open":
        caches.mkdir(mode=0o755)
    elif fault == "link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        caches.symlink_to(tmp_path / "elsewhere")
    elif fault == "file":
        caches.write_text("")
    elif fault == "relative":
        monkeypatch.setenv("XDG_CACHE_HOME", "caches")
        words = "relative path"
    elif fault == "parent":
        tmp_path.chmod(0o777)
        words = "everybody may write"
    elif fault == "homeless":
        monkeypatch.setattr(Path, "home", lambda: Path("~nobody-of-this-name").expanduser())
        monkeypatch.delenv("XDG_CACHE_HOME")
        words = "no folder of caches"
    elif fault == "rubbish":
        assert library("splitting") is not None
        (compiled,) = caches.iterdir()
        caches = tmp_path / "other" / "casadi_skin"  # a library that is loaded once stays what it is
        caches.mkdir(mode=0o700, parents=True)
        (caches / compiled.name).write_bytes(b"no library")
        monkeypatch.setenv("XDG_CACHE_HOME", str(caches.parent))
        words = str(caches)
        library.cache_clear()
    else:
        (tmp_path / "splitting.c").write_text("nothing")
        monkeypatch.setattr(native, "SOURCES", tmp_path)
        words = "failed: .*error"
    with pytest.warns(KernelWarning, match=words):
        assert library("splitting") is None
    assert splitting_kernel() is None


@needs_compiler
def test_libraries_of_other_users_are_not_loaded(caches: Path) -> None:
    assert library("splitting") is not None
    library.cache_clear()
    (compiled,) = caches.iterdir()
    try:
        os.chown(compiled, 65534, -1)
    except PermissionError:
        pytest.skip("files can be given away by root alone")
    with pytest.warns(KernelWarning, match="of another user"):
        assert library("splitting") is None


def test_no_compiler_is_no_fault(caches: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert library("splitting") is None
    assert "no-such-compiler" in str(without())
    assert not caches.exists()
    assert cache_folder() == caches
