"""The doors between the rooms of the code: who imports whom, read from the source without running it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BELOW = {
    "tsg_micro": ("data", "cells", "equilibrium", "continuum", "bodies", "figures"),
    "dd_macro": ("material", "scene", "methods", "results"),
    "workflows": ("store", "experiments", "scenes", "runs", "studies", "cli"),
}
"""Rooms of each package, from the ground up: imports run downwards only."""
NEIGHBOURS = {("dd_macro.scene", "dd_macro.material"), ("workflows.experiments", "workflows.store")}
"""Rooms of one floor, which do not know each other either way."""
MECHANICS = {"scipy.sparse", "petsc4py", "dolfinx", "ufl", "basix"}
ASSEMBLERS = {"equilibrium_matrix", "make_solver", "NewtonSolver", "LinearSolver", "TangentMatrix"}


def files(package):
    return sorted((ROOT / package).rglob("*.py"))


FILES = [path for package in BELOW for path in files(package)]
NAMES = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in FILES}


def imports(path):
    """Pairs of module and imported name (none for ``import module``) anywhere in a file, in functions too."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            assert node.module is not None, f"{path}: expected absolute imports"
            assert node.level == 0, f"{path}: expected absolute imports"
            yield from ((node.module, name.name) for name in node.names)
        elif isinstance(node, ast.Import):
            yield from ((name.name, None) for name in node.names)


def modules(path):
    """Our own modules that a file imports."""
    for module, name in imports(path):
        found = f"{module}.{name}" if f"{module}.{name}" in NAMES else module
        if found in NAMES:
            yield found


def room(module):
    return ".".join(module.split(".")[:2])


@pytest.mark.parametrize("package", BELOW)
def test_imports_run_downwards(package):
    floor = {f"{package}.{name}": height for height, name in enumerate(BELOW[package])}
    seen = set()
    for module, path in NAMES.items():
        here = room(module)
        if here not in floor:  # the package itself, and its files beside the rooms
            continue
        seen.add(here)
        for other in modules(path):
            there = room(other)
            if there in floor and there != here:
                assert floor[there] < floor[here], f"{module} imports {other}, which is above it"
                assert (here, there) not in NEIGHBOURS, f"{module} imports {other}, which it should not know"
    assert seen == set(floor)


def test_packages_know_what_is_below_them():
    for module, path in NAMES.items():
        package = module.split(".")[0]
        for other in modules(path):
            if package == "tsg_micro":
                assert other.startswith("tsg_micro"), f"{module} imports {other}"
            if package == "dd_macro" and not other.startswith("dd_macro"):
                assert room(other) == "tsg_micro.data", f"{module} imports {other}"
            if package != "workflows" and room(module) != "tsg_micro.figures":
                assert room(other) != "tsg_micro.figures", f"{module} imports {other}: figures are drawn by those above"


def test_the_micro_solver_runs_without_fenicsx():
    for path in files("tsg_micro"):
        for module, _ in imports(path):
            assert module.split(".")[0] not in ("dolfinx", "ufl", "basix", "mpi4py"), f"{path}: {module}"


def test_workflows_assemble_and_factorise_nothing():
    for path in files("workflows"):
        for module, name in imports(path):
            assert not {module, module.split(".")[0], room(module)} & MECHANICS, f"{path}: {module}"
            assert name not in ASSEMBLERS, f"{path}: {name}"


def test_no_circles_between_files():
    graph = {module: set(modules(path)) - {module} for module, path in NAMES.items()}
    while True:
        ends = {module for module, others in graph.items() if not others & graph.keys()}
        if not ends:
            break
        graph = {module: others for module, others in graph.items() if module not in ends}
    assert not graph, f"files that import each other, or what does: {', '.join(sorted(graph))}"
