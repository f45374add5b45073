"""A scene: what is asked for, declared in TOML, read into frozen objects or refused in one line.

Loads no numerics, so that reading a scene is instant.
"""

from casadi_skin.scene.faults import SceneError
from casadi_skin.scene.model_tables import ModelScene
from casadi_skin.scene.reading import AnyScene, parse_any_scene, parse_scene, read_scene, read_text, scene_schema
from casadi_skin.scene.tables import (
    C_PARTS,
    CORRECTORS,
    EVOLVERS,
    FLOWS,
    PRESET_TOLERANCES,
    PRESETS,
    TRANSCRIPTIONS,
    WALKERS,
    AccuracyTable,
    ChainTable,
    DynamicsTable,
    ExportTable,
    FamilyTable,
    MethodTable,
    Scene,
    SearchCondition,
    SearchTable,
    SpectrumTable,
    StabilityTable,
)

__all__ = [
    "CORRECTORS",
    "C_PARTS",
    "EVOLVERS",
    "FLOWS",
    "PRESETS",
    "PRESET_TOLERANCES",
    "TRANSCRIPTIONS",
    "WALKERS",
    "AccuracyTable",
    "AnyScene",
    "ChainTable",
    "DynamicsTable",
    "ExportTable",
    "FamilyTable",
    "MethodTable",
    "ModelScene",
    "Scene",
    "SceneError",
    "SearchCondition",
    "SearchTable",
    "SpectrumTable",
    "StabilityTable",
    "parse_any_scene",
    "parse_scene",
    "read_scene",
    "read_text",
    "scene_schema",
]
