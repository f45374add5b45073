"""Results in files: saved as data with a checksum, and read back bit for bit, to be continued."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import msgspec
import numpy as np

from casadi_skin._version import __version__
from casadi_skin.fmu.model import FmuModel, OtherModelError, at_symbols, checked, identity, noises
from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.family import Family
from casadi_skin.follow.rest_space import EquilibriumSpace
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.long_lattice import LongLattice
from casadi_skin.lattice.motion import EquationsOfMotion, equations_of_motion
from casadi_skin.model.arguments import cut, file_path, short_repr
from casadi_skin.model.files import replacing
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.operations import from_operations, to_operations
from casadi_skin.model.pickled import programs_in
from casadi_skin.model.saved import dumps, loads
from casadi_skin.optimise.nlp import Solution
from casadi_skin.optimise.optimum import CosineOrbit, Optimum
from casadi_skin.optimise.search import SearchResult
from casadi_skin.optimise.search_problem import Ending, Outcome, SearchProblem, Start
from casadi_skin.results.dataset import Cell, Dataset, Variable, versions, write_csv, write_netcdf
from casadi_skin.results.store import Reader, Writer, class_named, framed, read_records
from casadi_skin.zero.orbit import Extended, extended
from casadi_skin.zero.statement import Statement

FORMAT = "casadi_skin result 1"
ACCEPTED = "accepted: a file that save_result wrote"
DAMAGED = (ValueError, TypeError, KeyError, IndexError, AttributeError, ArithmeticError, AssertionError, RuntimeError,
           RecursionError)  # fmt: skip


class SavedResult(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Contents of a file."""

    format: str
    version: str
    shared: list[Any]
    result: Any


def save_result(result: Any, path: str | Path) -> Path:
    """Write a result to a file, from which `read_result` makes it again.

    Arguments:
        result: an orbit, an equilibrium, a solution, a branch or a special point of one, multipliers, eigenvalues, a
            certificate, a curve of edges, a time evolution, a search, or the smallest kick. A map is in its directory:
            see `read_map`. Of the model of an FMU the token, a hash and the choices of its import are written.
        path: the file; an existing one is replaced.

    Returns:
        The path.

    Raises:
        ValueError: the model of the result is a program but no FMU, or the result is of another kind; the path is a
            directory, or its directory does not exist.
        TypeError: the argument is not a path.
        OSError: the file cannot be written.
    """
    target = file_path("path", path)
    if target.is_dir():
        raise ValueError(f"path: given {target}, which is a directory; accepted: the path of a file")
    if not target.parent.is_dir():
        raise ValueError(f"path: given {target}, in no directory; accepted: a file in a directory that is there")
    payload = msgspec.msgpack.encode(saved(result))
    with replacing(target) as temporary:
        temporary.write_bytes(framed(payload))
    return target


def saved(result: Any) -> SavedResult:
    """A result as data; raises ValueError as `save_result` does."""
    writer = Writer(_write_shared)
    try:
        data = writer.value(result)
    except RecursionError:
        raise ValueError(f"result: given {short_repr(result)}; accepted: a result of this package") from None
    if not (isinstance(data, list) and data[0] == "object"):
        raise ValueError(f"result: given {short_repr(result)}; accepted: a result of this package")
    return SavedResult(FORMAT, __version__, writer.shared, data)


def restored(data: SavedResult) -> Any:
    """The result of data; raises one of `DAMAGED` where they are none."""
    if data.format != FORMAT:
        raise ValueError(f"format {short_repr(data.format)}")
    return Reader(data.shared, _read_shared).value(data.result)


def read_result(path: str | Path, *, model: Any = None) -> Any:
    """The result in a file of `save_result`; numbers computed from it equal those of the original, bit for bit.

    Arguments:
        path: the file.
        model: of a result of an FMU, the model that `import_fmu` makes of the same file with the same choices: reading
            runs no binary.

    Returns:
        An object of the class that was saved, whose branch can be continued.

    Raises:
        ValueError: the file cannot be read, holds no result, or is damaged; the model is another one, is missing, or
            the file has its own; in one line.
        TypeError: the argument is not a path.
    """
    source = file_path("path", path)
    try:
        if not source.is_file():
            raise ValueError("no such file")
        records, _, fault = read_records(source.read_bytes(), msgspec.msgpack.Decoder(SavedResult))
        if fault or len(records) != 1:
            raise ValueError(fault or f"{len(records)} records")
        saved = records[0]
        if saved.format != FORMAT:
            raise ValueError(f"format {short_repr(saved.format)}")
        if model is not None and not any(isinstance(data, list) and data[:1] == ["fmu"] for data in saved.shared):
            raise OtherModelError(f"model: given {short_repr(model)}; accepted: none, the model is in the file")
        return Reader(saved.shared, partial(_read_shared, given=model)).value(saved.result)
    except OtherModelError as error:
        raise ValueError(f"{source}: {error}") from None
    except OSError as error:
        raise ValueError(f"{source}: cannot be read: {error.strerror}; {ACCEPTED}") from None
    except DAMAGED as error:
        reason = cut(" ".join(str(error).split()) or type(error).__name__, 200)
        raise ValueError(f"{source}: not a result saved by casadi_skin: {reason}; {ACCEPTED}") from error


# Models and spaces ----------------------------------------------------------------------------------------------------


def _write_shared(writer: Writer, value: Any) -> Any | None:
    """The data of an object that is written once; None for all others."""
    if isinstance(value, Lattice) and value.equations.autonomous:
        return ["lattice", value.name, writer.value(value.declaration)]
    if isinstance(value, FmuModel):
        return ["fmu", identity(value), noises(value)]
    if isinstance(value, Extended) and isinstance(value.inner, FmuModel):
        place = value.inner.parameters.numel()
        return ["extended", writer.value(value.inner), value.nominal[place] if value.nominal else 1.0]
    if isinstance(value, OdeModel):
        return ["model", dumps(value)]
    if isinstance(value, Chain | LongLattice):
        return ["plain", type(value).__name__, writer.named_fields(value, ())]
    if isinstance(value, Family):
        return ["family", writer.value(value.request)]
    if isinstance(value, Statement):
        return _statement(writer, value)
    if isinstance(value, EquationsOfMotion):
        values = None if isinstance(value.model, Chain | LongLattice) else dict(value.parameters)
        return ["motion", writer.value(value.model), values]
    if isinstance(value, BoundarySpace | EquilibriumSpace):
        return ["space", type(value).__name__, writer.named_fields(value, ("first",)), writer.value(value.first)]
    return None


def _read_shared(reader: Reader, data: Sequence[Any], given: Any = None) -> Any:
    word, *rest = data
    if word == "fmu":
        return checked(rest[0], rest[1], given)
    if word == "extended":
        return extended(reader.value(rest[0]), rest[1], {})
    if word == "lattice":
        d = reader.value(rest[1])
        return Lattice(d.cells, d.sites, d.bonds, d.boundary, d.parameters, rest[0])
    if word == "model":
        return loads(rest[0])
    if word == "plain" and rest[0] == "Chain":
        return Chain(**reader.named(rest[1]))
    if word == "plain" and rest[0] == "LongLattice":
        return LongLattice(**reader.named(rest[1]))
    if word == "family":
        return Family(reader.value(rest[0]))
    if word == "statement":
        return _statement_of(reader, *rest)
    if word == "motion":
        return equations_of_motion(reader.value(rest[0]), rest[1])
    if word == "space":
        kind = class_named(rest[0])
        if not issubclass(kind, BoundarySpace | EquilibriumSpace):
            raise ValueError(f"a space of kind {rest[0]}")
        space = kind(**reader.named(rest[1]))
        first = reader.value(rest[2], space)
        return space if first is None else replace(space, first=first)
    raise ValueError(f"a thing of kind {short_repr(word)}")


# Statements -----------------------------------------------------------------------------------------------------------


def _statement(writer: Writer, statement: Statement) -> Any:
    """A statement: its model, its expressions as operations on ends, time, states and parameters, and its numbers."""
    model, kind = statement.model, type(statement.model.state)
    columns: dict[str, list[Any]] = {
        "conditions": [*statement.conditions],
        "integrals": [*statement.integrals],
        "interval": [kind(end) for end in statement.interval],
        "objective": [] if statement.objective is None else [statement.objective],
        "running": [] if statement.running is None else [statement.running],
    }
    symbols = [*model.ends, statement._time, model.full_state, model.parameters]
    results = [ca.vec(expression) for expressions in columns.values() for expression in expressions]
    function = ca.Function("statement", symbols, results)
    if programs_in(function):
        raise ValueError(f"{model.name}: cannot be saved: its conditions are those of a program")
    try:
        operations, entries = to_operations(function)
    except ValueError as error:
        raise ValueError(f"{model.name}: cannot be saved: its conditions {error}") from error
    counts = {name: len(expressions) for name, expressions in columns.items()}
    numbers = {name: writer.value(getattr(statement, name)) for name in ("parameters", "free", "bounds")}
    plain = [not isinstance(end, ca.SX | ca.MX) for end in statement.interval]
    return ["statement", writer.value(model), operations, entries, counts, numbers, plain]


def _statement_of(
    reader: Reader, model_data: Any, operations: list[str], entries: list[list[int | None]], counts: dict[str, int],
    numbers: dict[str, Any], plain: list[bool],
) -> Statement:  # fmt: skip
    model = reader.value(model_data)
    time = type(model.state).sym("t") if model.time is None else model.time
    symbols = [*model.ends, time, model.full_state, model.parameters]
    scalars = [ca.SX.sym("s", block.numel()) if isinstance(block, ca.MX) else block for block in symbols]
    columns = from_operations([s for block in scalars for s in ca.vertsplit(block)], operations, entries)
    taken = iter(at_symbols(columns, scalars, symbols))
    parts = {name: [next(taken) for _ in range(count)] for name, count in counts.items()}
    ends: list[Any] = [float(end) if is_plain else end for end, is_plain in zip(parts["interval"], plain, strict=True)]
    statement = Statement(
        model,
        tuple(parts["conditions"]),
        tuple(parts["integrals"]),
        (ends[0], ends[1]),
        **reader.named(numbers),
        objective=next(iter(parts["objective"]), None),
        running=next(iter(parts["running"]), None),
    )
    vars(statement)["_time"] = time  # the symbol that the integrals are written in
    return statement


# Files of a search: search.csv (optima), starts.csv (where each start led), search.nc, and the journal's records ------

PHASES = 401  # of an orbit in search.nc, over a period
MEANINGS = {
    "S": "total amplitude: sum of y_n^2 at t = 0",
    "Omega": "frequency",
    "period": "period",
}
OF_CHAIN = {"gamma": "nonreciprocity of the optimum", "g": "cubic on-site coefficient of the optimum"}


# The journal ---------------------------------------------------------------------------------------------------------


class OutcomeRecord(msgspec.Struct, frozen=True, tag="outcome"):
    """Where one start led; arrays as bytes of little-endian doubles, empty where there is no solution."""

    start: int
    begins: tuple[float, ...]
    ending: Ending
    words: str
    arrays: tuple[bytes, ...]  # x, lam_g, lam_x, free, place, times
    objective: float
    status: str
    iterations: int
    violation: float
    worst: str
    gap: float


def outcome_record(found: Outcome) -> OutcomeRecord:
    """Record of an outcome."""
    s = found.solution or Solution(np.zeros(0), np.zeros(0), np.zeros(0), math.nan, "", 0)
    arrays = (s.x, s.lam_g, s.lam_x, found.free, found.place, found.times)
    return OutcomeRecord(
        found.start.number, found.start.free, found.ending, found.words,
        tuple(values.astype("<f8").tobytes() for values in arrays), s.objective, s.words, s.iterations,
        found.violation, found.worst, found.gap,
    )  # fmt: skip


def restored_search(record: OutcomeRecord) -> Outcome:
    """The outcome of a record."""
    x, lam_g, lam_x, free, place, times = (np.frombuffer(data, "<f8").copy() for data in record.arrays)
    solution = Solution(x, lam_g, lam_x, record.objective, record.status, record.iterations) if x.size else None
    return Outcome(
        Start(record.start, record.begins), record.ending, record.words, solution, free, place, times,
        record.violation, record.worst, record.gap,
    )  # fmt: skip


# Tables --------------------------------------------------------------------------------------------------------------


def _finite(value: float | None) -> Cell:
    return value if value is not None and math.isfinite(value) else ""


def optimum_row(problem: SearchProblem, optimum: Optimum, rank: int) -> dict[str, Cell]:
    """One row of search.csv; empty where a number is not known, or infinite."""
    check, of_family = optimum.check, isinstance(optimum.orbit, CosineOrbit)
    row: dict[str, Cell] = {"rank": rank}
    if of_family:
        row["on_family"] = "" if optimum.on_family is None else int(optimum.on_family)
    row |= {"objective": optimum.objective, "objective_error": _finite(optimum.errors["objective"])}
    row |= {name: optimum.quantities[0][name] for name in problem.columns}
    row |= {
        "active": "; ".join(optimum.active),
        "kkt": optimum.kkt.largest,
        "curvature": _finite(optimum.curvature),
        problem.resolution_name: optimum.resolution,
        "starts": " ".join(map(str, optimum.starts)),
        "Omega_difference": check.Omega_difference,
        "residual": check.residual,
    }
    row |= {"family_difference": _finite(check.family_difference)} if of_family else {"difference": check.difference}
    return row | {f"error_{name}": _finite(error) for name, error in optimum.errors.items() if name != "objective"}


def start_row(outcome: Outcome, names: Sequence[str]) -> dict[str, Cell]:
    """One row of starts.csv."""
    solution = outcome.solution
    return {
        "start": outcome.start.number,
        "deflated": int(outcome.deflated),
        **{f"from_{name}": value for name, value in zip(names, outcome.start.free, strict=True)},
        "ending": outcome.ending.name.lower(),
        "objective": "" if solution is None else _finite(solution.objective),
        "iterations": 0 if solution is None else solution.iterations,
        "violation": _finite(outcome.gap),
        "violated": outcome.worst if outcome.gap > 0 else "",
        "words": outcome.words,
    }


def write_search(result: SearchResult, directory: Path, scene_text: str, title: str) -> None:
    """Write search.csv, starts.csv and, where there is an optimum, search.nc."""
    found = (*result.optima, *result.others)
    if found:
        rows = [optimum_row(result.problem, optimum, rank) for rank, optimum in enumerate(found, start=1)]
        write_csv(directory / "search.csv", list(rows[0]), rows)
        _write_netcdf(directory / "search.nc", result, scene_text, title)
    if result.outcomes:
        starts = [start_row(outcome, result.problem.free_names) for outcome in result.outcomes]
        write_csv(directory / "starts.csv", list(starts[0]), starts)


# search.nc -----------------------------------------------------------------------------------------------------------


def _write_netcdf(path: Path, result: SearchResult, scene_text: str, title: str) -> None:
    found, problem = (*result.optima, *result.others), result.problem
    variables = [
        Variable("objective", ("optimum",), np.array([o.objective for o in found]), "objective"),
        Variable("kkt", ("optimum",), np.array([o.kkt.largest for o in found]),
                 "largest residual of the conditions of optimality"),
    ]  # fmt: skip
    meanings = MEANINGS | (OF_CHAIN if isinstance(problem.model, Chain) else {})
    for name in problem.columns:
        values = np.array([o.quantities[0][name] for o in found])
        stored = name if name in ("S", "Omega", "period") else f"optimum_{name}"
        variables.append(Variable(stored, ("optimum",), values, meanings.get(name, f"{name} of the optimum")))
    if isinstance(found[0].orbit, CosineOrbit):
        variables += _cosines(found)
    else:
        variables += _states(found, problem.model.state_names)
    known = {"title": title, "scene": scene_text, **versions()}
    if isinstance(problem.model, Chain):
        known |= {name: getattr(problem.model, name) for name in ("sites", "alpha", "gamma", "g")}
    else:
        known |= {"model": problem.model.name}
    known |= {"search_status": result.status.name.lower(), "search_reason": result.reason}
    write_netcdf(path, Dataset(variables, known))


def _cosines(found: Sequence[Optimum]) -> list[Variable]:
    """Profiles and coefficients; the stiffness of every site of a chain."""
    harmonics, sites = max(o.resolution for o in found), found[0].orbit.profile.size
    coefficients = np.zeros((len(found), harmonics, sites))
    for k, optimum in enumerate(found):
        coefficients[k, : optimum.resolution] = optimum.orbit.cosines
    meaning = "c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), k from 0"
    profiles = np.stack([o.orbit.profile for o in found])
    variables = [
        Variable("profile", ("optimum", "site"), profiles, "y_n at t = 0"),
        Variable("coefficients", ("optimum", "harmonic", "site"), coefficients, meaning),
    ]
    if "alpha_n" in found[0].quantities[0]:
        alphas = np.stack([np.atleast_1d(o.alpha_n) for o in found])
        variables.append(Variable("alpha_n", ("optimum", "site"), alphas, "on-site stiffness of every site"))
    return variables


def _states(found: Sequence[Optimum], names: Sequence[str]) -> list[Variable]:
    """States at phases of the period, one variable a state."""
    phases = np.linspace(0.0, 1.0, PHASES)
    states = np.stack([o.orbit.evaluate(phases * o.orbit.period) for o in found])
    return [
        Variable("phase", ("phase",), phases, "place in the period, from 0 to 1"),
        *(Variable(f"state_{name}", ("optimum", "phase"), states[:, :, k], f"{name} along the orbit")
          for k, name in enumerate(names)),
    ]  # fmt: skip
