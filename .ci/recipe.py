"""Renders the conda recipe and compares it with pyproject.toml; with "lowest" prints the lowest versions."""

import sys
import tomllib
from pathlib import Path

RENAMED = {"matplotlib": "matplotlib-base"}  # on conda-forge


def main(root: Path, *words: str) -> None:
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    pairs = [requirement.split(">=") for requirement in project["dependencies"]]
    if words:
        print("\n".join(f"{name}=={version}" for name, version in pairs))
        return
    from rattler_build import Stage0Recipe, VariantConfig

    recipe = Stage0Recipe.from_yaml((root / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    rendered = recipe.render(VariantConfig())[0].recipe
    given = {str(requirement) for requirement in rendered.requirements.run}
    wanted = {f"{RENAMED.get(name, name)} >={version}" for name, version in pairs}
    wanted.add(f"python {project['requires-python']}")
    if given != wanted:
        raise SystemExit(f"conda/recipe.yaml: differs from pyproject.toml: {sorted(given ^ wanted)}")
    version = (root / "casadi_skin" / "_version.py").read_text(encoding="utf-8").split('"')[1]
    if str(rendered.package.version) != version:
        raise SystemExit(f"conda/recipe.yaml: version {rendered.package.version}, where the package has {version}")
    print("conda/recipe.yaml renders, with the requirements of pyproject.toml")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
