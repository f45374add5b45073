"""FMUs as models: values and Jacobians of a binary, orbits through it, and what is refused before it is loaded."""

from __future__ import annotations

import dataclasses
import gc
import pickle
import re
import stat
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import nullcontext
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from foreign_fmus import casadi_van_der_pol, changed, recompiled
from kernels import numpy_alone
from numpy.typing import NDArray

from casadi_skin import (
    BoundaryValueProblem,
    Chain,
    OdeModel,
    evolve,
    find_equilibrium,
    find_orbit,
    follow_family,
    import_fmu,
    save_model,
    simulate,
)
from casadi_skin.fmu.archive import export_fmu
from casadi_skin.fmu.model import FmuModel
from casadi_skin.model.integrators import cvodes, dop853

Array = NDArray[np.float64]
CHAIN = Chain(sites=4, alpha=0.8, gamma=0.3, g=1.0)
PARAMETERS = ("alpha", "gamma", "g")
VAN_DER_POL_PERIOD = 6.66328685932313  # at mu = 1, by Dormand-Prince with a tolerance of 1e-13


def jacobians(model: OdeModel) -> ca.Function:
    """(t, x, p) -> right-hand side and its Jacobians by state and parameters."""
    field = ca.densify(model.full_rhs)
    return model.function("J", field, ca.jacobian(field, model.full_state), ca.jacobian(field, model.parameters))


@pytest.fixture(scope="module", params=["3.0", "2.0"])
def chain_fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_fmu(CHAIN, tmp_path_factory.mktemp("chain") / "chain.fmu", request.param, mode=2, S=0.5)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return casadi_van_der_pol(tmp_path_factory.mktemp("casadi"))


def points(count: int, seed: int = 0) -> list[tuple[Array, Array]]:
    generator = np.random.default_rng(seed)
    return [(generator.normal(size=8), np.array([1.0, 0.5, 1.0]) * generator.uniform(-1, 1, 3)) for _ in range(count)]


# Values and derivatives -----------------------------------------------------------------------------------------------


def test_chain_comes_back_from_its_binary(chain_fmu: Path) -> None:
    model, truth = import_fmu(chain_fmu, parameters=PARAMETERS), CHAIN.tunable_model()
    assert (model.derivatives, model.parameter_derivatives, model.noise) == ("directional", "directional", 0.0)
    assert model.state_names == truth.state_names
    assert (model.parameter_names, model.nominal) == (PARAMETERS, (0.8, 0.3, 1.0))
    assert np.sum(np.square(model.start_state[:4])) == pytest.approx(0.5, rel=1e-14)
    found, expected = jacobians(model), jacobians(truth)
    for x, p in points(20):
        for ours, theirs in zip(found(0, x, p), expected(0, x, p), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)
    assert found.nnz_out(1) == expected.nnz_out(1)  # the structure comes from the FMU's dependencies
    energy = model.function("outputs", model.outputs["energy"], ca.jacobian(model.outputs["S"], model.state))
    x, p = points(1)[0]
    np.testing.assert_allclose(energy(0, x, p)[1], [[*(2 * x[:4]), 0, 0, 0, 0]], atol=1e-14)


def test_functions_of_the_model_are_mapped_and_differentiated(chain_fmu: Path) -> None:
    model, truth = import_fmu(chain_fmu, parameters=PARAMETERS), CHAIN.tunable_model()
    x = np.random.default_rng(1).normal(size=(8, 5))
    p = ca.DM([0.7, -0.2, 1.4])
    for way in ("serial", "unroll"):
        results = []
        for one in (model, truth):
            states, parameters = ca.MX.sym("X", 8, 5), ca.MX.sym("p", 3)
            rates = ca.vec(one.vector_field.map(5, way)(0.0, states, ca.repmat(parameters, 1, 5)))
            function = ca.Function(
                "f", [states, parameters], [rates, ca.jacobian(rates, ca.vec(states)), ca.jacobian(rates, parameters)]
            )
            results.append(function(x, p))
        for ours, theirs in zip(*results, strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13)
    for direction in ("forward", "reverse"):
        ours, theirs = (getattr(one.vector_field, direction)(1) for one in (model, truth))
        seeds = [np.ones(8)] if direction == "reverse" else [0.0, np.arange(8.0), np.ones(3)]
        arguments = [0.0, x[:, 0], p, np.zeros(8), *seeds]
        for a, b in zip(ours.call(arguments), theirs.call(arguments), strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-13)


def test_states_and_parameters_in_another_order(chain_fmu: Path) -> None:
    order = ["v_2", "y_4", "y_1", "v_1", "v_3", "v_4", "y_3", "y_2"]
    model, truth = (
        import_fmu(chain_fmu, states=states, parameters=parameters)
        for states, parameters in ((order, ["g", "alpha"]), (None, PARAMETERS))
    )
    places = [truth.state_names.index(name) for name in order]
    x, p = points(1)[0]
    found = jacobians(model)(0, x[places], [p[2], p[0]])
    expected = jacobians(truth)(0, x, [p[0], 0.3, p[2]])
    np.testing.assert_array_equal(found[0], np.array(expected[0])[places])
    np.testing.assert_array_equal(found[1], np.array(expected[1])[np.ix_(places, places)])
    np.testing.assert_array_equal(found[2], np.array(expected[2])[np.ix_(places, [2, 0])])
    assert model.start_state == tuple(truth.start_state[i] for i in places)


def test_differences_where_no_derivatives_are_offered_know_their_error(chain_fmu: Path, tmp_path: Path) -> None:
    def silent(text: bytes) -> bytes:
        return text.replace(b'Derivatives="true"', b'Derivatives="false"').replace(
            b'Derivative="true"', b'Derivative="false"'
        )

    path = changed(chain_fmu, tmp_path / "silent.fmu", {"modelDescription.xml": silent})
    model, truth = import_fmu(path, parameters=PARAMETERS), CHAIN.tunable_model()
    assert (model.derivatives, model.parameter_derivatives) == ("differences", "differences")
    found, expected = jacobians(model), jacobians(truth)
    assert model.noise == 0.0
    largest, sizes = 0.0, model.functions[0].derivatives.scale  # an estimate is relative in sizes of states
    for x, p in points(10):
        sizes, (value, *ours), theirs = np.maximum(sizes, np.abs(x)), found(0, x, p), expected(0, x, p)[1:]
        for our, their, across in zip(ours, theirs, (sizes, np.array([0.8, 0.3, 1.0])), strict=True):
            errors, entries = (np.abs(np.array(m)) * across / sizes[:, None] for m in (our - their, their))
            largest = max(largest, errors.max() / max(entries.max(), np.max(np.abs(np.array(value).ravel()) / sizes)))
    assert 0.0 < largest < 1e-11
    assert largest / 2 < model.noise < 1e-10
    assert found.nnz_out(1) == expected.nnz_out(1)


@pytest.mark.slow
def test_error_estimates_know_the_noise_of_the_fmu(tmp_path: Path) -> None:
    """x'' = -lambda x with noise of 1e-7: a tolerance below that is not met, which is told, with an honest error."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("lambda")
    noise = 1e-7 * ca.sin(1e13 * (x[0] + 0.3 * x[1]))
    noisy = OdeModel("noisy", x, ca.vertcat(x[1] + noise, -p * x[0] - noise), p, nominal=(1.0,))
    model = import_fmu(export_fmu(noisy, tmp_path / "noisy.fmu"), parameters=["lambda"])
    start, end = model.start(model.state), model.end(model.state)
    problem = BoundaryValueProblem(model, [start[0], end[0] - 1.0], interval=(0.0, 1.0))
    solution = problem.solve([1.0, 1.0], tolerance=1e-12, corrector="newton")
    assert 1e-6 < model.noise < 1e-2
    error = np.abs(solution.states[:, 0] - np.sin(solution.t) / np.sin(1.0)).max()
    assert solution.at_round_off
    assert 1e-9 < error < solution.error < 1e-5


def test_the_noise_is_that_of_each_state_in_its_own_size(tmp_path: Path) -> None:
    """Van der Pol's equations with a state 2^20 times as large: the noise of the other is as before, to the bit."""
    noises = []
    for size in (1.0, 2.0**20):
        x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
        noise = 1e-6 * ca.sin(1e7 * x[1])
        rates = ca.vertcat(size * x[1], p * (1 - (x[0] / size) ** 2) * x[1] - x[0] / size + noise)
        own = export_fmu(OdeModel("noisy", x, rates, p, nominal=(1.0,)), tmp_path / f"own_{size:g}.fmu")
        told = {
            "modelDescription.xml": lambda xml, size=size: xml.replace(b'"1.0" start="0', b'"%f" start="0' % size, 1)
        }
        model = import_fmu(changed(own, tmp_path / f"{size:g}.fmu", told), parameters=["p"])
        assert model.derivatives == "differences"
        jacobians(model)(0, [1.5 * size, 0.3], [1.0])
        noises.append(model.noise)
    assert 1e-5 < noises[0] < 1e-2
    assert noises[1] == noises[0]


@pytest.mark.slow
@pytest.mark.parametrize("chain_fmu", ["3.0", pytest.param("2.0", marks=pytest.mark.slow)], indirect=True)
def test_derivatives_and_dependencies_that_are_wrong_are_not_used(chain_fmu: Path, tmp_path: Path) -> None:
    fmi = "2.0" if "fmi2.c" in zipfile.ZipFile(chain_fmu).read("sources/config.h").decode() else "3.0"
    old = "sensitivity[i] = *place(c, UNKNOWN, unknowns[i]);"
    wrong = recompiled(chain_fmu, tmp_path / "wrong.fmu", fmi, old, old.replace("*place", "2.0 * *place"))
    assert import_fmu(wrong, parameters=PARAMETERS).derivatives == "differences"

    def shortened(text: bytes) -> bytes:
        return text.replace(b'dependencies="5', b'dependencies="6').replace(b'dependencies="6"', b'dependencies="7"')

    path = changed(chain_fmu, tmp_path / "structure.fmu", {"modelDescription.xml": shortened})
    model = import_fmu(path, parameters=PARAMETERS)
    x, p = points(1)[0]
    np.testing.assert_allclose(jacobians(model)(0, x, p)[1], jacobians(CHAIN.tunable_model())(0, x, p)[1], atol=1e-12)
    assert jacobians(model).nnz_out(1) == 64  # all entries, as the structure is not to be trusted


def test_values_that_the_fmu_cannot_compute_are_not_numbers(chain_fmu: Path) -> None:
    model = import_fmu(chain_fmu, parameters=PARAMETERS)
    x = np.ones(8)
    assert np.all(np.isnan(np.array(model.vector_field(0, x, [1.0, 2.0, 1.0]))))
    assert "failed with status 2 (discard)" in model.complaints[-1]
    assert np.all(np.isfinite(np.array(model.vector_field(0, x, [1.0, 0.2, 1.0]))))


@pytest.mark.slow
def test_forced_model_needs_its_period(tmp_path: Path) -> None:
    x, t, w = ca.SX.sym("x", 2), ca.SX.sym("t"), ca.SX.sym("w")
    rhs = ca.vertcat(x[1], -x[0] - x[0] ** 3 - 0.1 * x[1] + 0.4 * ca.cos(w * t))
    truth = OdeModel("forced", x, rhs, w, time=t, forcing_period=2 * ca.pi / w, nominal=(1.3,))
    path = export_fmu(truth, tmp_path / "forced.fmu")
    with pytest.raises(ValueError, match="the equations depend on time; accepted: with forcing_period="):
        import_fmu(path)
    model = import_fmu(path, parameters=["w"], forcing_period=2 * np.pi / 1.3)
    for at in ((0.7, [0.3, -0.4], 1.3), (2.1, [1.3, 0.4], 0.9)):
        for ours, theirs in zip(jacobians(model)(*at), jacobians(truth)(*at), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-12)
    field, expected = (ca.jacobian(m.rhs, m.time) for m in (model, truth))
    np.testing.assert_allclose(model.function("f", field)(*at), truth.function("f", expected)(*at), atol=1e-10)


def test_numbers_are_the_same_without_kernels(chain_fmu: Path) -> None:
    """Values, both Jacobians, and values that the FMU discards between two that it has, row by row through fmpy."""
    found = []
    for way in (nullcontext(), numpy_alone()):
        with way:
            model = import_fmu(chain_fmu, parameters=PARAMETERS)
            x = np.vstack([np.ones(8), np.full(8, np.inf), np.arange(8.0)])
            p = np.array([[1.0, 0.2, 1.0], [1.0, 0.2, 1.0], [0.5, 0.1, 1.0]])
            energy = model.function("energy", model.outputs["energy"])(0.0, x[0], p[0])
            at = model.instance.numbers(model.instance.points(None), np.arange(3.0), x, p)
            found.append([at, *map(np.array, (energy, *jacobians(model)(0.0, x[2], p[2])))])
            assert "failed with status 2 (discard)" in model.complaints[-1]
            assert np.isnan(at).any(axis=1).tolist() == [False, True, False]
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_array_equal(ours, theirs)


# Simulations and orbits -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("integrator", [cvodes, dop853])
def test_trajectories_are_those_of_the_chain(chain_fmu: Path, integrator: object) -> None:
    model = import_fmu(chain_fmu, parameters=PARAMETERS)
    t = np.array([1.0, 7.0])
    assert callable(integrator)
    trajectory = integrator(model, np.array([0.8, 0.3, 1.0]), np.array(model.start_state), t, 1e-10)
    truth = evolve(CHAIN, model.start_state[:4], None, t, method="dop853", tolerance=1e-13)
    np.testing.assert_allclose(trajectory.states[:, :4], truth.displacements, rtol=0, atol=1e-9)


def test_simulate_takes_it(chain_fmu: Path) -> None:
    model = import_fmu(chain_fmu)
    result = simulate(model, model.start_state, [0.0, 2.0], tolerance=1e-9)
    truth = evolve(CHAIN, model.start_state[:4], None, [2.0], method="dop853", tolerance=1e-13)
    np.testing.assert_allclose(result.states[-1, :4], truth.displacements[0], atol=1e-8)


def circle(t: float) -> Array:
    return np.array([2.0 * np.cos(t), -2.0 * np.sin(t)])


@pytest.mark.slow
def test_limit_cycle_of_a_foreign_fmu(foreign: Path) -> None:
    model = import_fmu(foreign, parameters=["mu"])
    assert model.state_names == ("x", "v")
    how = {"parameters": {"mu": 1.0}, "tolerance": 1e-9, "corrector": "newton"}
    orbit = find_orbit(model, circle, 6.6, **how)
    assert orbit.period == pytest.approx(VAN_DER_POL_PERIOD, abs=1e-9)
    x, mu = ca.SX.sym("x", 2), ca.SX.sym("mu")
    truth = OdeModel("van der Pol", x, ca.vertcat(x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]), mu)
    written = find_orbit(truth, circle, 6.6, **how)
    assert orbit.period == pytest.approx(written.period, abs=1e-11)
    np.testing.assert_allclose(orbit.floquet().multipliers, written.floquet().multipliers, atol=1e-10)
    np.testing.assert_allclose(orbit.floquet("cvodes").multipliers, orbit.floquet().multipliers, atol=1e-7)
    further = orbit.follow("mu", 2.0, at=[2.0]).at(2.0)
    assert float(further.period) == pytest.approx(7.62987447, abs=1e-7)  # type: ignore[attr-defined]


@pytest.mark.slow
def test_family_through_the_binary_is_that_of_the_expressions(tmp_path: Path) -> None:
    chain, values = Chain(8, 1.0, 0.25, -1.0), [0.2, 0.5, 1.0, 1.5, 2.0]
    model = import_fmu(export_fmu(chain, tmp_path / "chain.fmu"), parameters=PARAMETERS)
    model = dataclasses.replace(model, reversal=(1,) * 8 + (-1,) * 8, half_period=(-1,) * 16)
    omega, shape = chain.linear_frequency(1), chain.right_eigenvector(1)
    shape = shape / np.linalg.norm(shape)

    def mode(t: float) -> Array:
        return np.sqrt(values[0]) * np.concatenate([np.cos(omega * t) * shape, -omega * np.sin(omega * t) * shape])

    family = follow_family(chain, mode=1, amplitude_max=2.0, at=values, tolerance=1e-11)
    guess: object = mode
    for S in values:
        select = ca.sumsqr(model.state[:8]) - S
        orbit = find_orbit(model, guess, 2 * np.pi / omega, select=select, symmetric=True, tolerance=1e-10)
        known = family.at(S=S)
        assert 2 * np.pi / orbit.period == pytest.approx(known.Omega, abs=1e-9)
        np.testing.assert_allclose(np.array(orbit.evaluate(0.0)).ravel()[:8], known.profile, atol=1e-9)
        guess = orbit


@pytest.mark.slow
@pytest.mark.skipif(find_spec("gemseo_fmu") is None, reason="pip install --no-deps gemseo-fmu, whose FMUs it takes")
def test_fmus_of_openmodelica() -> None:
    spec = find_spec("gemseo_fmu")
    assert spec is not None
    assert spec.origin is not None
    folder = Path(spec.origin).parent / "problems" / "fmu_files"
    springs = import_fmu(folder / "linux/MassSpringSystem.fmu", parameters=["k2", "m1"])
    assert springs.derivatives == "differences"
    jacobian = np.array(jacobians(springs)(0, springs.start_state, springs.nominal)[1])
    frequencies = np.sort(np.abs(np.linalg.eigvals(jacobian).imag))
    np.testing.assert_allclose(frequencies, [1.0, 1.0, np.sqrt(3.0), np.sqrt(3.0)], atol=1e-10)
    stiffer = np.array(jacobians(springs)(0, springs.start_state, [2.0, 1.0])[1])  # k2 is fixed: it is initialised anew
    np.testing.assert_allclose(np.sort(np.abs(np.linalg.eigvals(stiffer).imag))[2:], np.sqrt(5.0), atol=1e-10)
    damper = import_fmu(folder / "linux/Mass_Damper.fmu", parameters=["damper.d"])
    np.testing.assert_allclose(
        jacobians(damper)(0, damper.start_state, damper.nominal)[1], [[0, 1], [-1e4, -10]], rtol=1e-9
    )
    refused = {
        "linux/add.fmu": "no continuous states",
        "linux/FMU3Model.fmu": "no Model Exchange",
        "win32/Mass_Damper.fmu": "no binary for linux64; it has binaries for win64",
    }
    for name, words in refused.items():
        with pytest.raises(ValueError, match=words):
            import_fmu(folder / name)


# Refusals and folders -------------------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def same_folder() -> Iterator[None]:
    before = Path.cwd()
    yield
    assert Path.cwd() == before


def left_behind() -> set[Path]:
    return set(Path(tempfile.gettempdir()).glob("casadi_skin_fmu_*"))


@pytest.fixture
def own_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def refusal(path: Path, **arguments: object) -> str:
    with pytest.raises(ValueError, match=r"^[^\n]*$") as refused:
        import_fmu(path, **arguments)  # type: ignore[arg-type]
    assert left_behind() == set()
    return str(refused.value)


def archive_of(path: Path, **files: str | bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def test_names_that_are_not_there_get_the_nearest(chain_fmu: Path, own_temporary_folder: Path) -> None:
    assert refusal(chain_fmu, parameters=["gama"]).startswith("parameters: given 'gama'; accepted: gamma, ")
    assert refusal(chain_fmu, parameters=["y_1"]) == "parameters: given 'y_1'; accepted: alpha, gamma, g"
    assert refusal(chain_fmu, parameters=["g", "g"]).startswith("parameters: given g, g; accepted: each one once")
    assert refusal(chain_fmu, states=["y_1", "v3"]).startswith("states: given 'v3'; accepted: v_3, ")
    assert refusal(chain_fmu, states=["y_1", "y_2", "y_3", "y_4"]).startswith("states: left out: v_1, v_2, v_3, v_4")


def test_separators_of_windows_are_separators(chain_fmu: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(chain_fmu) as source, zipfile.ZipFile(tmp_path / "windows.fmu", "w") as copy:
        copy.writestr("resources\\", b"")
        for name in source.namelist():
            copy.writestr(name.replace("/", "\\"), source.read(name))
    model = import_fmu(tmp_path / "windows.fmu")
    assert model.start_state == import_fmu(chain_fmu).start_state
    model.close()


def test_hostile_archives_are_refused(chain_fmu: Path, own_temporary_folder: Path, tmp_path: Path) -> None:
    xml = zipfile.ZipFile(chain_fmu).read("modelDescription.xml")
    for name in (
        "../evil.txt",
        "/tmp/evil.txt",
        "resources/../../evil.txt",
        "resources\\..\\..\\evil.txt",
        "c:evil.txt",
    ):
        path = archive_of(tmp_path / "evil.fmu", **{"modelDescription.xml": xml, name: b"x"})
        assert "would leave the folder" in refusal(path), name
    link = zipfile.ZipInfo("resources/link")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "link.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", xml)
        archive.writestr(link, "/etc/passwd")
    assert "'resources/link' is a link" in refusal(tmp_path / "link.fmu")
    entities = b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "b">]>' + xml.partition(b"?>")[2]
    path = archive_of(tmp_path / "entities.fmu", **{"modelDescription.xml": entities})
    assert "declares entities" in refusal(path)
    wide = entities.decode().replace('version="1.0"', 'version="1.0" encoding="UTF-16"', 1).encode("utf-16")
    path = archive_of(tmp_path / "wide.fmu", **{"modelDescription.xml": wide})
    assert "declares entities" in refusal(path)
    assert not (tmp_path / "evil.txt").exists()


@pytest.mark.slow
def test_bombs_are_refused(
    chain_fmu: Path, own_temporary_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = archive_of(tmp_path / "bomb.fmu", **{"modelDescription.xml": b"", "resources/zeros": bytes(1 << 27)})
    assert path.stat().st_size < 200_000
    assert refusal(path).endswith("134217728 bytes when unpacked; accepted: up to 67108864")
    for module, name, most in (("unzip", "MOST_FILES", 50), ("unzip", "LONGEST_DIRECTORY", 1000)):
        monkeypatch.setattr(f"casadi_skin.fmu.{module}.{name}", most)
        path = archive_of(tmp_path / "many.fmu", **{f"resources/{i}": b"" for i in range(60)})
        assert f"accepted: up to {most}" in refusal(path)


@pytest.mark.slow
def test_damaged_files_are_refused(chain_fmu: Path, own_temporary_folder: Path, tmp_path: Path) -> None:
    assert "cannot be read as an FMU" in refusal(tmp_path / "missing.fmu")
    (tmp_path / "text.fmu").write_text("no archive")
    assert "cannot be read as an FMU" in refusal(tmp_path / "text.fmu")
    whole = bytearray(chain_fmu.read_bytes())
    whole[60:400] = bytes(340)
    (tmp_path / "damaged.fmu").write_bytes(whole)
    assert "damaged: 'modelDescription.xml'" in refusal(tmp_path / "damaged.fmu")
    assert refusal(archive_of(tmp_path / "empty.fmu", x=b"")).endswith(
        "no modelDescription.xml inside; accepted: an FMU"
    )
    path = changed(chain_fmu, tmp_path / "xml.fmu", {"modelDescription.xml": lambda text: text[:500]})
    assert "modelDescription.xml cannot be read" in refusal(path)
    library = next(name for name in zipfile.ZipFile(chain_fmu).namelist() if name.startswith("binaries/"))
    path = changed(chain_fmu, tmp_path / "binary.fmu", {library: lambda content: content[:200]})
    assert "its binary cannot be loaded" in refusal(path)
    wrong = {"modelDescription.xml": lambda text: text.replace(b"{", b"{0")}
    assert "it cannot be instantiated" in refusal(changed(chain_fmu, tmp_path / "token.fmu", wrong))


def test_fmus_that_cannot_be_used_are_refused(chain_fmu: Path, own_temporary_folder: Path, tmp_path: Path) -> None:
    here = next(name for name in zipfile.ZipFile(chain_fmu).namelist() if name.startswith("binaries/"))
    path = changed(chain_fmu, tmp_path / "sources.fmu", {here: None})
    assert refusal(path).endswith("it has sources alone")
    xml = zipfile.ZipFile(chain_fmu).read("modelDescription.xml")
    bare = archive_of(tmp_path / "bare.fmu", **{"modelDescription.xml": xml})
    assert refusal(bare).endswith("it has neither binaries nor sources")
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("binaries/win64/chain.dll", b"")
    assert refusal(path).endswith("it has binaries for win64")

    def without_exchange(text: bytes) -> bytes:
        begin = text.index(b"<ModelExchange")
        return text[:begin] + text[text.index(b"<CoSimulation") :]

    def with_events(text: bytes) -> bytes:
        two = text.replace(b'numberOfEventIndicators="0"', b'numberOfEventIndicators="2"')
        return two.replace(b"<InitialUnknown v", b'<EventIndicator valueReference="9" /><InitialUnknown v', 1)

    path = changed(chain_fmu, tmp_path / "events.fmu", {"modelDescription.xml": with_events})
    assert re.search("it cannot be initialised: fmi[23]GetEventIndicators failed", refusal(path))
    path = changed(chain_fmu, tmp_path / "cs.fmu", {"modelDescription.xml": without_exchange})
    words = "no Model Exchange, Co-Simulation alone: its solver is inside, and there is no right-hand side to ask for"
    assert words in refusal(path)
    assert refusal(path).endswith("may export it; import_co_simulation finds orbits of this one")


@pytest.mark.slow
def test_descriptions_that_say_nonsense_are_refused(
    chain_fmu: Path, own_temporary_folder: Path, tmp_path: Path
) -> None:
    def with_(pattern: bytes, replacement: bytes) -> Path:
        edit = {"modelDescription.xml": lambda text: re.sub(pattern, replacement, text)}
        return changed(chain_fmu, tmp_path / "strange.fmu", edit)

    assert refusal(with_(rb'start="[^"]*"', b'start="abc"')).endswith(
        "strange.fmu: start value 'abc' of y_1; accepted: a number"
    )
    assert "nominal value 'abc' of y_1; accepted" in refusal(with_(rb'nominal="[^"]*"', b'nominal="abc"'))
    assert "listed as a derivative, but of no state" in refusal(with_(rb' derivative="[^"]*"', b""))
    beyond = with_(rb'name="alpha" valueReference="\d+"', b'name="alpha" valueReference="4294967296"')
    assert refusal(beyond).endswith("refused, value reference '4294967296'; accepted: 0 to 4294967295")
    lost = rb'<ContinuousStateDerivative valueReference="9"[^>]*>|(?<=<Derivatives>)\s*<Unknown[^>]*>'
    assert "it cannot be initialised" in refusal(with_(lost, b""))
    for nominal in (b"0.0", b"NaN", b"INF"):  # which no state can have
        model = import_fmu(with_(rb'nominal="[^"]*"', b'nominal="%s"' % nominal))
        assert model.derivatives == "directional"
        np.testing.assert_array_equal(model.functions[0].derivatives.scale, 1.0)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"parameters": "g"}, "parameters: given 'g'; accepted: a list of names"),
        ({"states": [3]}, r"states: given \[3\]; accepted: a list of names"),
        ({"forcing_period": 0.0}, "forcing_period: given 0.0; accepted: a number > 0"),
    ],
)
def test_arguments_that_are_refused(chain_fmu: Path, arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=f"^{words}$"):
        import_fmu(chain_fmu, **arguments)


def test_a_closed_model_fails(chain_fmu: Path) -> None:
    model = import_fmu(chain_fmu)
    model.close()
    model.close()
    with pytest.raises(RuntimeError, match="closed; accepted: calls before that"):
        model.vector_field(0.0, model.start_state, [])


def test_fmpy_is_asked_for_where_it_is_missing(chain_fmu: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(ValueError, match=r"^fmpy is not installed; accepted: pip install 'casadi-skin\[fmu\]'$"):
        import_fmu(chain_fmu)


def test_folder_goes_with_the_model(chain_fmu: Path, own_temporary_folder: Path) -> None:
    model: FmuModel | None = import_fmu(chain_fmu)
    assert len(left_behind()) == 1
    other = import_fmu(chain_fmu)
    assert len(left_behind()) == 2
    assert model is not None
    np.testing.assert_array_equal(
        model.vector_field(0, model.start_state, []), other.vector_field(0, model.start_state, [])
    )
    other.close()
    assert len(left_behind()) == 1
    del model
    gc.collect()
    assert left_behind() == set()


def test_folder_goes_when_a_branch_does(foreign: Path, own_temporary_folder: Path) -> None:
    """Its equilibria, orbits, their stability and special points: nothing that is kept holds the model."""
    model: FmuModel | None = import_fmu(foreign, parameters=["mu"])
    orbit = find_orbit(model, lambda t: [2.0 * np.cos(t), -2.0 * np.sin(t)], 6.6, parameters={"mu": 1.0})
    rests = find_equilibrium(model, [0.0, 0.0], parameters={"mu": -0.5}).follow("mu", 0.5)
    assert orbit.follow("mu", 1.3).stable.all()
    assert len(rests.special_points) == 1
    assert len(left_behind()) == 1
    del model, orbit, rests
    gc.collect()
    assert left_behind() == set()


@pytest.mark.parametrize("chain_fmu", ["3.0", pytest.param("2.0", marks=pytest.mark.slow)], indirect=True)
def test_folder_goes_at_the_end_of_the_program(chain_fmu: Path, tmp_path: Path) -> None:
    program = f"""
import tempfile, pathlib
tempfile.tempdir = {str(tmp_path)!r}
from casadi_skin import import_fmu
model = import_fmu({str(chain_fmu)!r})
assert len(list(pathlib.Path({str(tmp_path)!r}).iterdir())) == 1
print(model.vector_field(0, model.start_state, []).shape)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert list(tmp_path.iterdir()) == []


def test_a_program_is_neither_saved_nor_written_as_c(chain_fmu: Path, tmp_path: Path) -> None:
    model = import_fmu(chain_fmu, parameters=PARAMETERS)
    with pytest.raises(ValueError, match="cannot be saved: its equations are those of a program"):
        save_model(model, tmp_path / "model.json")
    with pytest.raises(ValueError, match="cannot be pickled: its equations are those of a program"):
        pickle.dumps(model)
    with pytest.raises(ValueError, match="cannot be written as C"):
        export_fmu(model, tmp_path / "again.fmu")
    assert list(tmp_path.iterdir()) == []
