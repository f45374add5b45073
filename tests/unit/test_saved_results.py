"""Files of results: what no file can hold, and what is no file; that results lead on is in test_every_result."""

from __future__ import annotations

import functools
from contextlib import suppress
from pathlib import Path
from typing import Any

import casadi as ca
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from programs import Program

from casadi_skin import (
    Branch,
    Chain,
    OdeModel,
    find_orbit,
    follow_family,
    read_result,
    save_result,
    simulate,
)
from casadi_skin.model.ode import OdeModel as Model
from casadi_skin.results.saving import FORMAT
from casadi_skin.results.store import framed

X, Y, MU = (ca.SX.sym(name) for name in ("x", "y", "mu"))
VAN_DER_POL = OdeModel("van der Pol", ca.vertcat(X, Y), ca.vertcat(Y, MU * (1 - X**2) * Y - X), MU)


@functools.cache
def family() -> Branch:
    return follow_family(Chain(2, 1.0, 0.25, -1.0), 1, 0.01, stability=True, tolerance=1e-4, at=[0.005])


@functools.cache
def cycle() -> Any:
    guess = (np.linspace(0, 6.3, 30), np.stack([2 * np.cos(np.linspace(0, 6.3, 30))] * 2))
    return find_orbit(VAN_DER_POL, guess, 6.3, parameters={"mu": 0.2}, tolerance=1e-4, corrector="newton")


def test_a_file_is_a_file_in_a_directory(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^path: given .*, which is a directory; accepted: the path of a file$"):
        family().save(tmp_path)
    with pytest.raises(ValueError, match=r"^path: given .*, in no directory; accepted: a file in a directory that is"):
        family().save(tmp_path / "nowhere" / "result.skin")


def test_what_is_no_result_is_refused(tmp_path: Path) -> None:
    for thing in (1.0, [1.0], Chain(2, 1.0, 0.0, 1.0), object()):
        with pytest.raises(ValueError, match="accepted: "):
            save_result(thing, tmp_path / "no.skin")
    assert not list(tmp_path.iterdir())


def test_programs_are_refused_with_the_reason(tmp_path: Path) -> None:
    x = ca.MX.sym("x", 1)
    twice = Program(ca.Function("twice", [x], [2 * x]))
    model = Model("program", x, -twice(x))
    evolution = simulate(VAN_DER_POL, [2.0, 0.0], [0.0, 0.1], parameters={"mu": 1.0})
    object.__setattr__(evolution.equations, "model", model)
    with pytest.raises(ValueError, match="program: cannot be saved"):
        evolution.save(tmp_path / "no.skin")


def refusal(data: bytes, folder: Path) -> str:
    path = folder / "damaged.skin"
    path.write_bytes(data)
    with pytest.raises(ValueError, match="accepted: ") as caught:
        read_result(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: not a result saved by casadi_skin: ")
    assert message.isprintable()
    assert len(message) < 500
    return message


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    data = cycle().save(tmp_path / "orbit.skin").read_bytes()
    for place in np.linspace(0, len(data) - 1, 60).astype(int):
        flipped = bytearray(data)
        flipped[place] ^= 1
        refusal(bytes(flipped), tmp_path)
    for size in (0, 10, len(data) - 1):
        refusal(data[:size], tmp_path)
    refusal(data + data, tmp_path)
    with pytest.raises(ValueError, match="no such file"):
        read_result(tmp_path / "missing.skin")


names = st.sampled_from(["object", "shared", "array", "tuple", "map", "enum", "point", "refinement", "Orbit", "Chain",
                         "End", "<f8", "|O", "Popen", "os", "model", "family", "space"])  # fmt: skip
values = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 9) | st.floats() | names | st.binary(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(names, inner, max_size=3),
    max_leaves=12,
)


@given(values, st.lists(values, max_size=2))
def test_whatever_a_file_with_the_right_checksum_says_it_is_data_or_refused(
    tmp_path_factory: pytest.TempPathFactory, result: Any, shared: list[Any]
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.skin"
    saved = {"format": FORMAT, "version": "0", "shared": shared, "result": result}
    path.write_bytes(framed(msgspec.msgpack.encode(saved)))
    with suppress(ValueError):
        read_result(path)
