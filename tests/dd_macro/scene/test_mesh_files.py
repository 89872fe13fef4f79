"""Mesh files as people have them: labels, leftovers, groups, parts, hands, units; and files that are none."""

from __future__ import annotations

from pathlib import Path

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

import meshes
from dd_macro import Displacement, Problem, StrainOperator, box, read_msh
from dd_macro.compat import geometry_nodes
from dd_macro.parallel import total
from dd_macro.results.quadrature_file import VTK_CORNERS
from dd_macro.scene.boundary import side_dofs
from dd_macro.scene.hexahedra import hexahedra
from dd_macro.scene.msh import read_msh_file
from tsg_micro.data.errors import InputError

pytestmark = pytest.mark.mpi
CASES = Path(__file__).parents[2] / "data" / "cases" / "mesh"
A = 2e-5


def write_cubes(path, cubes, *, sides=(), groups=(), extra=(), share=True, scale=1.0, start=1):
    """An MSH 2.2 file of cubes at integer corners, quads ``sides`` (tag, corners) and name lines ``groups``."""
    corner = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    numbers: dict[tuple[float, ...], int] = {}
    points, elements = [], []

    def node(x, owner):
        key = tuple(np.round(x, 6)) + (() if share else (owner,))
        if key not in numbers:
            numbers[key] = start + len(numbers)
            points.append(f"{numbers[key]} " + " ".join(repr(float(scale * A * c)) for c in x))
        return numbers[key]

    for i, cube in enumerate(cubes):
        nodes = [node(np.add(cube, c), i) for c in corner]
        elements.append(f"5 2 3 1 {' '.join(map(str, nodes))}")
    for tag, cube, face in sides:
        own = {"bottom": (0, 1, 5, 4), "top": (3, 2, 6, 7), "left": (0, 3, 7, 4), "right": (1, 2, 6, 5)}[face]
        nodes = [node(np.add(cubes[cube], corner[c]), cube) for c in own]
        elements.append(f"3 2 {tag} 1 {' '.join(map(str, nodes))}")
    elements += extra
    lines = [
        "$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(groups)), *groups, "$EndPhysicalNames",
        "$Nodes", str(len(points)), *points, "$EndNodes",
        "$Elements", str(len(elements)), *(f"{i + 1} {e}" for i, e in enumerate(elements)), "$EndElements",
    ]  # fmt: skip
    path.write_text("\n".join(lines) + "\n")


NAMES = ('2 1 "bottom"', '2 2 "top"', '3 3 "body"')
ENDS = ((1, 0, "bottom"), (2, -1, "top"))


@pytest.fixture
def cubes(comm, folder):
    """Read a file of cubes with bottom and top."""

    def make(places, *, sides=ENDS, groups=NAMES, read=True, merge_nodes=False, **more):
        if comm.rank == 0:
            write_cubes(folder / "cubes.msh", places, sides=sides, groups=groups, **more)
        comm.barrier()
        return read_msh(folder / "cubes.msh", comm, merge_nodes=merge_nodes)

    return make


def volume(domain):
    return total(domain.comm, StrainOperator(domain).weights.sum())


COLUMN = [(0, 0, 0), (0, 1, 0), (0, 2, 0)]


@pytest.mark.parametrize("name", ["orphan_point", "orphan_line", "one_number_skipped", "reference_ok"])
def test_only_nodes_of_cells_carry_unknowns_and_their_numbers_are_labels(comm, name):
    body = read_msh(CASES / f"{name}.msh", comm)
    assert StrainOperator(body).global_dofs == 36
    assert volume(body) == pytest.approx(2 * A**3, rel=1e-12)


def test_labels_far_apart_and_leftover_surfaces(cubes):
    extra = ["3 2 4 9 5000000000 5000000001 5000000002 5000000003", "15 2 5 9 5000000000"]
    body = cubes(COLUMN, start=10**12, extra=extra, groups=(*NAMES, '2 4 "plane"'))
    assert StrainOperator(body).global_dofs == 48
    with pytest.raises(InputError, match="expected facets on 'plane', got none"):
        side_dofs(StrainOperator(body), "plane")


def test_groups_are_names(cubes, comm):
    body = read_msh(CASES / "volume_in_two_groups.msh", comm)
    assert volume(body) == pytest.approx(A**3, rel=1e-12)
    cells = {name: comm.allreduce(int((inside < body.owned_cells).sum())) for name, inside in body.regions.items()}
    assert cells == {"cells": 1, "everything": 1}
    twice = ["5 2 4 1 1 2 3 4 5 6 7 8", "3 2 5 1 1 2 6 5"]  # MSH 2.2 writes an element once a group
    body = cubes(COLUMN, extra=twice, groups=(*NAMES, '3 4 "first"', '2 5 "floor"'))
    assert volume(body) == pytest.approx(3 * A**3, rel=1e-12)
    cells = {name: comm.allreduce(int((inside < body.owned_cells).sum())) for name, inside in body.regions.items()}
    assert cells == {"body": 3, "first": 1}
    operator = StrainOperator(body)
    for side in ("bottom", "floor"):
        assert comm.allreduce(len(side_dofs(operator, side))) == 4


@pytest.mark.parametrize("name", ["two_blocks", "gap_1e-13"])
def test_parts_that_touch_are_refused_or_merged(comm, name):
    with pytest.raises(InputError, match="got 6 pairs of coincident nodes and 2 parts that touch but share no node"):
        read_msh(CASES / f"{name}.msh", comm)
    merged = read_msh(CASES / f"{name}.msh", comm, merge_nodes=True)
    glued = read_msh(CASES / "glued_reference.msh", comm)
    assert StrainOperator(merged).global_dofs == StrainOperator(glued).global_dofs == 54
    assert merged.parts is None
    assert volume(merged) == pytest.approx(4 * A**3, rel=1e-6)


def test_parts_that_touch_without_coincident_nodes_or_at_an_edge(cubes):
    with pytest.raises(InputError, match="got 2 parts, with 4 nodes on a face of another part"):
        cubes([(0, 0, 0), (0.5, 1, 0)])
    with pytest.raises(InputError, match="joined by faces, got 2 pieces in 1 part: some hang together at an edge"):
        cubes([(0, 0, 0), (1, 1, 0)])
    for apart in ([(0, 0, 0), (1.01, 0, 0)], [(0, 0, 0), (1.5, 1.02, 0)]):
        assert StrainOperator(cubes(apart)).global_dofs == 48


def test_every_part_must_be_held(comm, cubes):
    conditions = [Displacement("bottom"), Displacement("top")]
    with pytest.raises(InputError, match=r"connected part to be held, a part of 1 cell is not \(1 of 2\)"):
        Problem(StrainOperator(read_msh(CASES / "island.msh", comm)), conditions)
    strips = [*COLUMN, (3, 0, 0), (3, 1, 0), (6, 0, 0), (6, 1, 0)]
    held = [*ENDS, (1, 0, "bottom"), (1, 3, "bottom")]
    fixed = Problem(StrainOperator(cubes(strips, sides=held)), conditions).fixed
    assert comm.allreduce(int(fixed.sum())) == 3 * 12
    rollers = [Displacement("bottom"), Displacement("top", (0.0,), (1,))]
    with pytest.raises(InputError, match="no rigid-body motion left free, got 3 of 6"):
        Problem(StrainOperator(cubes(strips, sides=held)), rollers)


def test_cells_get_positive_volume(comm, cubes):
    for body, count in ((read_msh(CASES / "left_handed_half.msh", comm), 4), (cubes(COLUMN), 3)):
        x = body.mesh.geometry.x[geometry_nodes(body.mesh)[:, VTK_CORNERS]]
        signed = np.linalg.det(x[:, [1, 3, 4]] - x[:, :1])
        np.testing.assert_allclose(signed, A**3, rtol=1e-9)
        assert comm.allreduce(len(signed)) == count


def test_units(comm):
    body = hexahedra(read_msh_file(CASES / "glued_reference.msh"), unit=1e-3)
    assert np.ptp(body.points) == pytest.approx(4e-8)
    with pytest.raises(InputError, match="unit of the mesh: expected one of m, mm, um, nm, got 'inch'"):
        read_msh(CASES / "glued_reference.msh", comm, unit="inch")
    size = (2e-5, 2.0)
    assert read_msh(CASES / "glued_reference.msh", comm, size=size).global_cells == 4
    with pytest.raises(InputError, match=r"got 4e-08 m, its coordinates taken in mm; say their unit \(--mesh-unit m,"):
        read_msh(CASES / "glued_reference.msh", comm, unit="mm", size=size)


def bad(comm, folder, content, message):
    path = folder / "bad.msh"
    if comm.rank == 0:
        path.write_bytes(content)
    comm.barrier()
    with pytest.raises(InputError, match=message):
        read_msh(path, comm)


def test_a_script_is_not_run(comm, folder):
    script = f'SystemCall "touch {folder / "pwned"}";\n'.encode()
    for content in (script, b"\x1f\x8b\x08" + script, b"\n$MeshFormat\n" + script, b"solid x\n", b"", b"$NOD\n1\n"):
        bad(comm, folder, content, r"expected a mesh of gmsh, with \$MeshFormat in its first line")
    bad(comm, folder, b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n" + script, "damaged")
    bad(comm, folder, b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\nMerge 'other.geo';\n", "damaged")
    assert not (folder / "pwned").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("2.2 0 8", "1.0 0 8", "expected MSH format 2.2 or 4.1, got '1.0'"),
        ("2.2 0 8", "2.2 0 4", "expected MSH format"),
        ("$Nodes\n12", "$Nodes\n999999999999", "damaged"),
        ("$Nodes\n12", "$Nodes\n-12", "damaged"),
        ("$Elements\n6", "$Elements\n7", "damaged"),
        ("\n2 2e-05 0 0", "\n1 2e-05 0 0", "expected every node once, got two of number 1"),
        ("\n2 2e-05 0 0", "\n2 nan 0 0", "expected finite coordinates, got others at node 2"),
        ("\n2 2e-05 0 0", "\n2 1e300 0 0", "expected finite coordinates, got others at node 2"),
        ("\n2 2e-05 0 0", "\n2 x 0 0", "damaged"),
        ("\n2 2e-05 0 0", "\n99 2e-05 0 0", "expected coordinates of every node, got none of node 2"),
        ("5 5 2 3 1 1 2 5 4", "5 5 2 3 1 1 1 5 4", "got 1 degenerate or folded cells"),
        ("5 5 2 3 1 1 2 5 4", "5 5 2 3 1 1 2 4 5", "got 1 degenerate or folded cells"),
        ("5 5 2 3 1 1 2 5 4", "5 5 2 3 1 1.5 2 5 4", "damaged"),
        ("5 5 2 3", "5 77 2 3", "expected 8-node hexahedra only, got elements of gmsh type 77"),
        ("$EndElements", "", r"expected \$EndElements"),
        ("$PhysicalNames\n3", "$PhysicalNames\n900", "damaged"),
        ("$Elements", "$Other", r"damaged|expected"),
    ],
)
def test_damage_is_named(comm, folder, old, new, message):
    text = (CASES / "reference_ok.msh").read_text()
    assert old in text
    bad(comm, folder, text.replace(old, new, 1).encode(), message)


def test_all_formats_are_the_same_mesh(comm, folder, gmsh):
    if comm.rank == 0:
        meshes.sheet_with_hole(folder / "sheet.msh", elements=(3, 2, 1), size=(2e-4, 1e-4, 2e-5), radius=3e-5)
        gmsh.initialize([], readConfigFiles=False, interruptible=False)
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.merge(str(folder / "sheet.msh"))
        for version in (2.2, 4.1):
            for binary in (0, 1):
                gmsh.option.setNumber("Mesh.MshFileVersion", version)
                gmsh.option.setNumber("Mesh.Binary", binary)
                gmsh.write(str(folder / f"{version}-{binary}.msh"))
        gmsh.finalize()
    comm.barrier()
    first = hexahedra(read_msh_file(folder / "sheet.msh"))
    for version in (2.2, 4.1):
        for binary in (0, 1):
            body = hexahedra(read_msh_file(folder / f"{version}-{binary}.msh"))
            np.testing.assert_allclose(body.points, first.points, rtol=0, atol=1e-19)
            assert np.array_equal(np.unique(body.cells, axis=0), np.unique(first.cells, axis=0))
            assert body.sides == first.sides
            for tag in np.unique(first.facet_tags):
                assert {frozenset(f) for f in body.facets[body.facet_tags == tag]} == {
                    frozenset(f) for f in first.facets[first.facet_tags == tag]
                }


def test_extent_of_a_side(comm):
    found = box(comm, elements=(2, 3, 1), size=(2.0, 3.0, 1.0)).extent("top")
    np.testing.assert_allclose(np.stack(found), np.array([[0, 3, 0], [2, 3, 1], [1, 3, 0.5]]), atol=1e-14)


BYTES = [(CASES / f"{name}.msh").read_bytes() for name in ("reference_ok", "volume_in_two_groups")]


@hypothesis.settings(max_examples=150)
@hypothesis.given(
    which=st.sampled_from(BYTES),
    flips=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), max_size=4),
    cut=st.floats(0.2, 1),
)
def test_any_bytes_are_read_or_refused(tmp_path_factory, which, flips, cut):
    content = bytearray(which[: int(cut * len(which)) + 1])
    for place, value in flips:
        content[int(place * len(content))] = value
    path = tmp_path_factory.mktemp("fuzz") / "f.msh"
    path.write_bytes(bytes(content))
    try:
        body = hexahedra(read_msh_file(path))
    except InputError:
        return
    assert len(body.cells) >= 1
    assert np.isfinite(body.points).all()
