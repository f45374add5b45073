"""Renders the conda recipe for every platform and compares it with pyproject.toml."""

import sys
import tomllib
from pathlib import Path

from rattler_build import JinjaConfig, PlatformConfig, RenderConfig, Stage0Recipe, VariantConfig

RENAMED = {"matplotlib": "matplotlib-base"}  # on conda-forge
PLATFORMS = {
    "linux-64": "linux-64",
    "linux-aarch64": "linux-64",
    "osx-64": "osx-64",
    "osx-arm64": "osx-64",
    "win-64": "win-64",
}


def main(root: Path) -> None:
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pairs = [requirement.split(">=") for requirement in project["dependencies"]]
    wanted = {f"{RENAMED.get(name, name)} >={version}" for name, version in pairs}
    wanted.add(f"python {project['requires-python']}")
    recipe = Stage0Recipe.from_yaml((root / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    for target, builder in PLATFORMS.items():  # conda-forge builds for ARM processors on others
        platform = PlatformConfig(target_platform=target, build_platform=builder)
        variants = VariantConfig.from_file_with_context(
            root / "conda" / "variants.yaml", JinjaConfig(platform=platform)
        )
        (rendered,) = recipe.render(variants, RenderConfig(platform=platform))
        given = {str(requirement) for requirement in rendered.recipe.requirements.run}
        if given != wanted:
            raise SystemExit(f"conda/recipe.yaml, {target}: differs from pyproject.toml: {sorted(given ^ wanted)}")
    if rendered.recipe.about.license != project["license"]:
        raise SystemExit(
            f"conda/recipe.yaml: license {rendered.recipe.about.license}, where pyproject.toml has {project['license']}"
        )
    print(f"conda/recipe.yaml renders for {', '.join(PLATFORMS)}, with the requirements of pyproject.toml")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
