"""What is kept for other machines says the same as pyproject.toml and the Makefile: CI, conda recipe, container."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CONDA = {"matplotlib": "matplotlib-base"}
"""Packages that have another name on conda-forge."""


def test_ci_calls_targets_that_there_are():
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M))
    lines = [step["run"] for job in workflow["jobs"].values() for step in job["steps"] if "run" in step]
    called = {name for line in lines for name in re.findall(r"(?:^|sudo )make ([a-z-]+)", line)}
    assert called == {"lint", "test", "dist", "test-debian", "docs"} & targets
    matrix = workflow["jobs"]["conda"]["strategy"]["matrix"]
    assert (matrix["dolfinx"], matrix["ranks"]) == (["0.9", "0.10", "0.11"], [1, 2, 3])
    assert matrix["python"] == workflow["jobs"]["wheels"]["strategy"]["matrix"]["python"] == ["3.12", "3.13", "3.14"]


def test_the_recipe_wants_what_the_project_wants():
    text = (ROOT / ".ci/conda/meta.yaml").read_text()
    (version,) = re.findall(r'\{% set version = "(.*)" %\}', text)
    recipe = yaml.safe_load(re.sub(r"\{%.*%\}", "", text).replace("{{ version }}", version))
    assert recipe["package"] == {"name": PROJECT["name"], "version": PROJECT["version"]}
    assert recipe["about"]["summary"] == PROJECT["description"]
    wanted = {f"python {PROJECT['requires-python']}"}
    for one in PROJECT["dependencies"]:
        name, bounds = re.findall(r"^([a-z0-9-]+)(.*)$", one)[0]
        wanted.add(f"{CONDA.get(name, name)} {bounds}")
    assert set(recipe["requirements"]["run"]) == wanted | {"fenics-dolfinx >=0.9,<0.12"}
    scripts = [f"{name} = {target}" for name, target in PROJECT["scripts"].items()]
    assert recipe["build"]["entry_points"] == scripts


def test_the_container_is_made_of_what_is_there():
    text = (ROOT / ".ci/Containerfile").read_text()
    copied = [word for line in re.findall(r"^COPY (.*) /src/\S*$", text, re.M) for word in line.split()]
    assert all((ROOT / word).exists() for word in copied)
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert set(copied) == {*wheel["packages"], "pyproject.toml", "README.md", *PROJECT["license-files"]}
    (extras,) = re.findall(r"'/src\[(.*)\]'", text)
    assert set(extras.split(",")) <= PROJECT["optional-dependencies"].keys()
