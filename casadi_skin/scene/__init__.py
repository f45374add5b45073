"""A scene: what is asked for, declared in TOML, read into frozen objects or refused in one line.

Loads no numerics, so that reading a scene is instant.
"""

from casadi_skin.scene.faults import SceneError
from casadi_skin.scene.reading import parse_scene, read_scene, read_text, scene_schema
from casadi_skin.scene.tables import (
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
    FamilyTable,
    MethodTable,
    Scene,
    SpectrumTable,
    StabilityTable,
)

__all__ = [
    "CORRECTORS",
    "EVOLVERS",
    "FLOWS",
    "PRESETS",
    "PRESET_TOLERANCES",
    "TRANSCRIPTIONS",
    "WALKERS",
    "AccuracyTable",
    "ChainTable",
    "DynamicsTable",
    "FamilyTable",
    "MethodTable",
    "Scene",
    "SceneError",
    "SpectrumTable",
    "StabilityTable",
    "parse_scene",
    "read_scene",
    "read_text",
    "scene_schema",
]
