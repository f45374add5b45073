"""family.nc, dynamics.nc: all that a run computed, in netCDF 3 (64-bit offsets) for xarray, MATLAB and Julia."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from casadi_skin._version import __version__
from casadi_skin.files import replacing
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.tail_problem import Regime
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.orbit import Orbit

if TYPE_CHECKING:
    from scipy.io import netcdf_file

    from casadi_skin.dynamics import Evolution

PARTS = ("real", "imaginary")
EMPTY = 9.969209968386869e36  # the fill value of netCDF for doubles


def _versions() -> dict[str, str]:
    import casadi
    import scipy

    return {
        "casadi_skin_version": __version__,
        "casadi_version": casadi.__version__,
        "numpy_version": np.__version__,
        "scipy_version": scipy.__version__,
        "python_version": platform.python_version(),
    }


def put(file: netcdf_file, name: str, dimensions: tuple[str, ...], values: NDArray[np.generic], meaning: str) -> None:
    """Write one variable; raises ArithmeticError on a value that is not finite."""
    data = np.asarray(values)
    if np.iscomplexobj(data):
        dimensions, data = (*dimensions, "part"), np.stack([data.real, data.imag], axis=-1)
    faulty = np.argwhere(~np.isfinite(data))
    if faulty.size:
        place = ", ".join(f"{dimension} {i}" for dimension, i in zip(dimensions, faulty[0].tolist(), strict=True))
        raise ArithmeticError(f"{name}: {data[tuple(faulty[0])]} at {place} (counted from 0); it is not written")
    kind = "i4" if data.dtype.kind in "bi" else "f8"
    variable = file.createVariable(name, kind, dimensions)
    variable[:] = data.astype(kind)
    variable.long_name = meaning  # type: ignore[attr-defined]


def _known(value: float) -> float:
    """The value; netCDF's fill value for one that is infinite, as the energy of an infinite tail that moves along."""
    return EMPTY if value == np.inf else value


def _put_logarithms(file: netcdf_file, orbits: Sequence[Orbit]) -> None:
    """log10 |y_n(0)| and signs; a site at rest has no logarithm and is left empty (`_FillValue`, sign 0)."""
    logarithms, signs = (
        np.stack(parts) for parts in zip(*(o.log10_displacements(o.output_sites) for o in orbits), strict=True)
    )
    at_rest = np.isneginf(logarithms) & (signs == 0)
    meaning = "log10 |y_n| at t = 0, also where y_n is below the smallest double; empty where it is 0"
    put(file, "log10_profile", ("point", "site"), np.where(at_rest, EMPTY, logarithms), meaning)
    setattr(file.variables["log10_profile"], "_FillValue", EMPTY)  # noqa: B010
    put(file, "profile_sign", ("point", "site"), signs.astype(int), "sign of y_n at t = 0")


def write_netcdf(path: Path, branches: Sequence[Branch], scene_text: str, title: str, vectors: bool) -> None:
    """Write all branches along one dimension `point`, in the order given and in arclength order within each.

    All values are dimensionless. Complex values have a last dimension `part` (real, imaginary). `vectors` asks for the
    Floquet vectors at requested points. Raises ArithmeticError on a value that is not finite.
    """
    from scipy.io import netcdf_file

    orbits = [orbit for branch in branches for orbit in branch.orbits]
    if not orbits:
        return
    chain, sites = orbits[0].chain, orbits[0].output_sites
    with replacing(path) as temporary, netcdf_file(temporary, "w", version=2) as file:
        write_origin(file, chain, scene_text, title)
        file.createDimension("point", len(orbits))
        file.createDimension("site", sites.size)
        put(file, "site", ("site",), sites, "number of the site, from 1; up to 0 in an infinite chain with gamma > 0")
        file.createDimension("part", 2)
        _write_orbits(file, orbits)
        if branches[0].with_stability:
            _write_stability(file, orbits)
            if vectors:
                _write_vectors(file, orbits)


def write_evolution(path: Path, evolution: Evolution, orbit: Orbit, scene_text: str, title: str) -> None:
    """Write a time evolution that starts at an orbit or near it; dimensionless.

    Raises ArithmeticError on a value that is not finite.
    """
    from scipy.io import netcdf_file

    with replacing(path) as temporary, netcdf_file(temporary, "w", version=2) as file:
        write_origin(file, orbit.chain, scene_text, title)
        how = {"method": evolution.method, "tolerance": evolution.tolerance, "coordinates": evolution.coordinates}
        start = {"orbit_mode": orbit.tools.request.mode, "orbit_S": orbit.S, "orbit_Omega": orbit.Omega}
        for name, value in {**how, "step": evolution.step or 0.0, **start}.items():
            setattr(file, name, value)
        file.createDimension("time", evolution.t.size)
        file.createDimension("site", orbit.chain.sites)
        put(file, "t", ("time",), evolution.t, "time")
        put(file, "energy", ("time",), evolution.energy, "Hamiltonian of the gauge with rho = 1 at the favoured edge")
        put(file, "displacements", ("time", "site"), evolution.displacements, "displacements y_n")
        put(file, "velocities", ("time", "site"), evolution.velocities, "velocities of y_n")


def write_versions(file: netcdf_file, scene_text: str, title: str) -> None:
    """What was asked for, and what computed it."""
    for name, value in {"title": title, "scene": scene_text, **_versions()}.items():
        setattr(file, name, value or "untitled")


def write_origin(file: netcdf_file, chain: Chain, scene_text: str, title: str) -> None:
    """What was asked for, of which chain, and what computed it."""
    write_versions(file, scene_text, title)
    for name in ("sites", "alpha", "gamma", "g"):
        setattr(file, name, getattr(chain, name))


def _write_orbits(file: netcdf_file, orbits: Sequence[Orbit]) -> None:
    index = [i for _, i in _places(orbits)]
    columns = {
        "mode": ([o.tools.request.mode for o in orbits], "linear mode j that the family grows from"),
        "index": (index, "place along the family"),
        "requested": ([o.point.requested for o in orbits], "1 where S, Omega or the period was asked for"),
        "S": ([o.S for o in orbits], "total amplitude: sum of y_n^2 at t = 0"),
        "Omega": ([o.Omega for o in orbits], "frequency"),
        "Omega_shift": ([o.Omega_shift for o in orbits], "Omega - omega_j"),
        "Omega_error": ([o.Omega_error for o in orbits], "estimated absolute error of Omega"),
        "S_error": ([o.S_error for o in orbits], "estimated absolute error of S"),
        "profile_error": ([o.profile_error for o in orbits], "estimated relative error of the profile"),
        "energy": ([_known(o.energy) for o in orbits], "Hamiltonian of the gauge with rho = 1 at the favoured edge"),
        "residual": ([o.residual for o in orbits], "largest residual relative to the largest term"),
        "at_round_off": ([o.at_round_off for o in orbits], "1 where round-off keeps the errors above the tolerance"),
        "resolution": ([o.point.problem.resolution for o in orbits], "harmonics or intervals of the discretisation"),
    }
    for name, (values, meaning) in columns.items():
        put(file, name, ("point",), np.array(values), meaning)
    profiles = np.array([o.evaluate(0.0, o.output_sites)[0] for o in orbits])
    put(file, "profile", ("point", "site"), profiles, "displacements y_n at t = 0")
    if all(o.regime is not None for o in orbits):
        regimes = np.array([list(Regime).index(o.regime) for o in orbits if o.regime is not None])
        put(file, "regime", ("point",), regimes, "; ".join(f"{i}: {r.value}" for i, r in enumerate(Regime)))
    _put_logarithms(file, orbits)
    harmonics = max(o.harmonics for o in orbits)
    file.createDimension("harmonic", harmonics)
    coefficients = np.stack([o.coefficients(harmonics, o.output_sites) for o in orbits])
    meaning = "c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), k from 0"
    put(file, "coefficients", ("point", "harmonic", "site"), coefficients, meaning)


def _places(orbits: Sequence[Orbit]) -> list[tuple[int, int]]:
    """(mode, index along its family) of each orbit."""
    seen: dict[int, int] = {}
    places = []
    for orbit in orbits:
        mode = orbit.tools.request.mode
        places.append((mode, seen.get(mode, 0)))
        seen[mode] = places[-1][1] + 1
    return places


def _write_stability(file: netcdf_file, orbits: Sequence[Orbit]) -> None:
    results = [o.floquet() for o in orbits]
    stable = np.array([f.stable for f in results])
    put(file, "stable", ("point",), stable, "1 where every mu lies in [-1, 0] within its estimated error")
    largest = np.array([f.max_abs_multiplier for f in results])
    put(file, "max_abs_multiplier", ("point",), largest, "largest modulus, the trivial pair left out")
    error = np.array([f.error for f in results])
    put(file, "multiplier_error", ("point",), error, "estimated error of mu and of max_abs_multiplier where unstable")
    deviation = np.array([f.trivial_deviation for f in results])
    put(file, "trivial_deviation", ("point",), deviation, "distance of the trivial mu from its exact value")
    file.createDimension("multiplier", results[0].multipliers.size)
    multipliers = np.stack([f.multipliers for f in results])
    put(file, "multipliers", ("point", "multiplier"), multipliers, "Floquet multipliers, the trivial pair first")
    if results[0].mu.size:
        file.createDimension("mu_index", results[0].mu.size)
        put(file, "mu", ("point", "mu_index"), np.stack([f.mu for f in results]), "eigenvalues of B^T C")
        errors = np.stack([f.mu_error for f in results])
        put(file, "mu_error", ("point", "mu_index"), errors, "estimated errors of mu")


def _write_vectors(file: netcdf_file, orbits: Sequence[Orbit]) -> None:
    places = [i for i, o in enumerate(orbits) if o.point.requested]
    if not places:
        return
    file.createDimension("requested_point", len(places))
    file.createDimension("component", 2 * orbits[0].chain.sites)
    put(file, "vectors_point", ("requested_point",), np.array(places), "place along `point`, from 0")
    vectors = np.stack([orbits[i].floquet_vectors() for i in places])
    dimensions = ("requested_point", "component", "multiplier")
    put(file, "vectors", dimensions, vectors, "Floquet vectors (positions, velocities) at t = 0, columns")
