"""netCDF files: numbers of attributes keep their digits, and texts and names their letters, whoever reads them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from maps import TINY, write
from scenes import table
from scipy.io import netcdf_file

from casadi_skin import run_map
from casadi_skin.results.dataset import NETCDF_FILL_VALUE, Dataset, Variable, read_name, write_netcdf
from casadi_skin.runs.program import main


def test_attributes_keep_their_digits_and_letters(tmp_path: Path) -> None:
    path = tmp_path / "file.nc"
    values = [
        Variable("μ", ("Länge",), np.array([1.0, np.nan]), "Größe", True),
        Variable("n", ("k",), np.array(["ξ", "y"]), "names"),
    ]
    write_netcdf(path, Dataset(values, {"gamma": math.pi, "sites": 3, "title": "Über", "empty": ""}))
    with netcdf_file(path, mmap=False) as file:
        assert (float(file.gamma), int(file.sites)) == (math.pi, 3)
        assert (file.title.decode(), file.empty, file.Conventions) == ("Über", b"untitled", b"CF-1.8")
        (stored,) = [held for name, held in file.variables.items() if read_name(name) == "μ"]
        assert (read_name(stored.dimensions[0]), stored.long_name.decode()) == ("Länge", "Größe")
        assert stored.data.tolist() == [1.0, NETCDF_FILL_VALUE]
        assert float(stored._FillValue) == NETCDF_FILL_VALUE
        assert stored._FillValue.dtype.itemsize == 8  # of the kind of the values, as CF demands
        assert [b"".join(row).decode().strip() for row in file.variables["n"][:]] == ["ξ", "y"]


GREEK = 'title = "Über μ"\n' + (
    table("model", file="greek.py", name="model") + table("equilibrium", start=[0.1])
    + table("continuation", parameter="μ", to=1.0)
)  # fmt: skip
MODEL = """import casadi as ca
from casadi_skin import OdeModel
x, p = ca.SX.sym("ξ"), ca.SX.sym("μ")
model = OdeModel("griechisch für alle", x, p - x, p, nominal=(0.3,))
"""


@pytest.mark.slow
def test_a_scene_and_a_model_may_have_any_letters(tmp_path: Path) -> None:
    (tmp_path / "greek.py").write_text(MODEL, encoding="utf-8")
    (tmp_path / "scene.toml").write_text(GREEK, encoding="utf-8")
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    assert main(["explore", str(tmp_path / "out"), "--quiet"]) == 0
    assert "Über μ" in (tmp_path / "out" / "explore.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_map_of_any_letters(tmp_path: Path) -> None:
    """The parameters of the chain in attributes have all their digits."""
    text = TINY.partition("[map]")[0].replace("alpha = 1.0", "alpha = 1.1") + "[map]\nmode = [2]\n"
    found = run_map(write(tmp_path, f'title = "Über"\n{text}'), tmp_path / "out", pictures=False, quiet=True)
    assert found.complete
    with netcdf_file(tmp_path / "out" / "map.nc", mmap=False) as file:
        assert (file.title.decode(), float(file.alpha)) == ("Über", 1.1)
        assert file.variables["mode"][:].tolist() == [2]
