"""A scene: a request declared in TOML, read into frozen objects or refused in one line.

Loads no numerics, so that reading a scene is instant.
"""

from casadi_skin.scene.faults import SceneError
from casadi_skin.scene.lattice_tables import LatticeTable
from casadi_skin.scene.map_table import MapTable, RangeTable
from casadi_skin.scene.model_tables import ContinuationTable, ModelTable, OrbitTable, SolutionTable
from casadi_skin.scene.reading import parse_scene, read_scene, read_text, scene_of, scene_schema
from casadi_skin.scene.scene import Scene
from casadi_skin.scene.tables import (
    PRESET_TOLERANCES,
    PRESETS,
    AccuracyTable,
    ChainTable,
    FamilyTable,
    MethodTable,
    SpectrumTable,
    StabilityTable,
)
from casadi_skin.scene.task_tables import (
    C_PARTS,
    DynamicsTable,
    ExportTable,
    FiguresTable,
    SearchCondition,
    SearchTable,
)

__all__ = [
    "C_PARTS",
    "PRESETS",
    "PRESET_TOLERANCES",
    "AccuracyTable",
    "ChainTable",
    "ContinuationTable",
    "DynamicsTable",
    "ExportTable",
    "FamilyTable",
    "FiguresTable",
    "LatticeTable",
    "MapTable",
    "MethodTable",
    "ModelTable",
    "OrbitTable",
    "RangeTable",
    "Scene",
    "SceneError",
    "SearchCondition",
    "SearchTable",
    "SolutionTable",
    "SpectrumTable",
    "StabilityTable",
    "parse_scene",
    "read_scene",
    "read_text",
    "scene_of",
    "scene_schema",
]
