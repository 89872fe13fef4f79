"""The strain operator, meshes and boundary conditions against closed forms."""

from __future__ import annotations

import dolfinx
import numpy as np
import pytest
import ufl
from basix.ufl import quadrature_element
from mpi4py import MPI

import meshes
from dd_macro import Displacement, GradientOperator, Projection, StrainOperator, Traction, box, isotropic, read_msh
from dd_macro.parallel import total
from dd_macro.scene.boundary import side_dofs
from dd_macro.scene.loads import nodal_forces
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import to_mandel

pytestmark = pytest.mark.mpi


@pytest.mark.parametrize(("degree", "points"), [(1, 8), (2, 27)])
def test_points_and_volume(comm, degree, points):
    operator = StrainOperator(box(comm, elements=(3, 2, 2), size=(3e-5, 2e-5, 4e-5)), degree=degree)
    assert operator.points_per_cell == points
    assert total(comm, operator.weights.sum()) == pytest.approx(2.4e-14, rel=1e-12)
    moment = total(comm, operator.weights @ operator.points**2)
    np.testing.assert_allclose(moment, 2.4e-14 * np.array([3e-5, 2e-5, 4e-5]) ** 2 / 3, rtol=1e-12)


@pytest.fixture
def distorted(comm, folder, gmsh):
    path = folder / "hole.msh"
    if comm.rank == 0:
        meshes.sheet_with_hole(path, elements=(3, 3, 2), size=(2e-4, 1e-4, 2e-5), radius=3e-5)
    comm.barrier()
    return read_msh(path, comm)


@pytest.mark.parametrize("degree", [1, 2])
def test_affine_displacement_has_exact_strain_on_a_distorted_mesh(distorted, rng, degree):
    operator = StrainOperator(distorted, degree=degree)
    H = rng.normal(size=(3, 3))
    strain = operator.strain((operator.node_coordinates() @ H.T).ravel())
    np.testing.assert_allclose(strain, np.broadcast_to(to_mandel(H), strain.shape), atol=1e-10)


def test_strain_of_a_quadratic_displacement_at_each_point(distorted):
    """With degree 2 and a box, u = (xy, yz, zx) is met exactly; the strain must be that of its own point."""
    operator = StrainOperator(box(distorted.comm, elements=(3, 2, 2), size=(1.0, 2.0, 1.5)), degree=2)
    x, y, z = operator.node_coordinates().T
    strain = operator.strain(np.column_stack([x * y, y * z, z * x]).ravel())
    x, y, z = operator.points.T
    r = np.sqrt(0.5)
    np.testing.assert_allclose(strain, np.column_stack([y, z, x, r * y, r * z, r * x]), atol=1e-12)


def test_force_is_the_adjoint_of_strain(distorted, comm):
    operator = StrainOperator(distorted)
    rng = np.random.default_rng(comm.rank)
    u, s = rng.normal(size=operator.owned_dofs), rng.normal(size=(len(operator.weights), 6))
    work = total(comm, [operator.force(s) @ u, operator.weights @ (operator.strain(u) * s).sum(axis=1)])
    assert work[0] == pytest.approx(work[1], rel=1e-11)


@pytest.mark.parametrize("alike", [True, False])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", [StrainOperator, GradientOperator])
def test_forces_are_those_of_the_assembled_form(distorted, comm, kind, degree, alike):
    """int tau : B v, from DOLFINx; cells of one shape and cells of many, ghosts of other ranks."""
    operator = kind(box(comm, elements=(3, 2, 2), size=(1.0, 2.0, 1.5)) if alike else distorted, degree=degree)
    mesh, n = operator.domain.mesh, operator.components
    assert alike == (len(operator.maps.first) == 1)
    element = quadrature_element(mesh.basix_cell(), value_shape=(n,), scheme="default", degree=2 * degree + 1)
    tau = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))
    stress = np.sin(np.outer(operator.points.sum(axis=1) / operator.points.max(), np.arange(1, n + 1)))
    points = tau.function_space.dofmap.list[: operator.domain.owned_cells].reshape(-1)
    tau.x.array.reshape(-1, n)[points] = stress
    form = ufl.inner(tau, operator.expression(ufl.TestFunction(operator.displacements))) * operator.dx
    vector = dolfinx.fem.assemble_vector(dolfinx.fem.form(form))
    vector.scatter_reverse(dolfinx.la.InsertMode.add)
    expected = vector.array[: operator.owned_dofs]
    scale = comm.allreduce(np.abs(expected).max(initial=0), op=MPI.MAX)
    np.testing.assert_allclose(operator.force(stress), expected, rtol=0, atol=1e-13 * scale)


def test_uniform_stress_gives_the_nodal_forces_of_its_tractions(distorted, comm):
    operator = StrainOperator(distorted)
    stress = np.zeros((len(operator.weights), 6))
    stress[:, 2] = 5.0  # sigma_zz loads the faces back and front only
    expected = nodal_forces(operator, [Traction("front", (0, 0, 5.0)), Traction("back", (0, 0, -5.0))])
    scale = comm.allreduce(np.abs(expected).max(initial=0), op=MPI.MAX)
    np.testing.assert_allclose(operator.force(stress), expected, atol=1e-12 * scale)


def test_volume_and_area_of_the_sheet_with_a_hole(distorted, comm):
    operator = StrainOperator(distorted)
    area = 2e-4 * 1e-4 - np.pi * 3e-5**2
    assert total(comm, operator.weights.sum()) / 2e-5 == pytest.approx(area, rel=0.02)
    pull = total(comm, nodal_forces(operator, [Traction("left", (2.0, 0, 0))]).reshape(-1, 3).sum(axis=0))
    np.testing.assert_allclose(pull, [2.0 * 1e-4 * 2e-5, 0, 0], atol=1e-20)


@pytest.mark.parametrize("kind", ["flat_sheet", "tapered_sheet", "curved_sheet"])
def test_sheets_have_their_volume_and_sides(comm, folder, kind):
    more = {"tapered_sheet": {"thickness_ratio": 0.5}, "curved_sheet": {"radius": 1e-4}}.get(kind, {})
    volume = {"flat_sheet": 1.0, "tapered_sheet": 0.75, "curved_sheet": 1.1}[kind] * 4e-13
    path = folder / "sheet.msh"
    if comm.rank == 0:
        getattr(meshes, kind)(path, elements=(12, 3, 2), size=(2e-4, 1e-4, 2e-5), **more)
    comm.barrier()
    sheet = read_msh(path, comm)
    assert set(sheet.names) == {"left", "right", "bottom", "top", "back", "front"}
    assert sheet.global_cells == 72
    operator = StrainOperator(sheet)
    assert total(comm, operator.weights.sum()) == pytest.approx(volume, rel=0.01)
    counts = {name: comm.allreduce(len(side_dofs(operator, name))) for name in sheet.names}
    assert counts == {"left": 12, "right": 12, "bottom": 39, "top": 39, "back": 52, "front": 52}


def test_bad_box(comm):
    with pytest.raises(InputError, match="elements: expected three positive integers, got"):
        box(comm, elements=(3, 0, 1), size=(1, 1, 1))
    with pytest.raises(InputError, match="size: expected three positive lengths"):
        box(comm, elements=(3, 1, 1), size=(1, -1, 1))
    with pytest.raises(InputError, match="degree: expected 1 or 2"):
        StrainOperator(box(comm, elements=(3, 1, 1), size=(1, 1, 1)), degree=3)


def write_gmsh(gmsh, path, *, tetrahedra=False, name="", flat=False):
    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    geo = gmsh.model.geo
    corners = [geo.addPoint(*p, 0, 2.0) for p in ((0, 0), (1, 0), (1, 1), (0, 1))]
    lines = [geo.addLine(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    back = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    for line in lines:
        geo.mesh.setTransfiniteCurve(line, 3)
    geo.mesh.setTransfiniteSurface(back)
    if not tetrahedra:
        geo.mesh.setRecombine(2, back)
    made = geo.extrude([(2, back)], 0, 0, 1, numElements=[] if tetrahedra else [2], recombine=not tetrahedra)
    geo.synchronize()
    if name:
        gmsh.model.addPhysicalGroup(2, [back], name=name)
    gmsh.model.addPhysicalGroup(3, [made[1][1]])
    gmsh.model.mesh.generate(3)
    if flat:
        tags, x, _ = gmsh.model.mesh.getNodes()
        for tag, point in zip(tags, x.reshape(-1, 3), strict=True):
            gmsh.model.mesh.setNode(tag, [*point[:2], 0.0], [])
    gmsh.write(str(path))
    gmsh.finalize()


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ({"tetrahedra": True, "name": "left"}, "expected 8-node hexahedra only, got tetrahedra"),
        ({}, r"expected named physical surfaces \(its sides\), got none"),
        ({"name": "left", "flat": True}, "got 8 degenerate or folded cells"),
    ],
)
def test_bad_mesh_file(comm, folder, gmsh, kind, message):
    path = folder / "bad.msh"
    if comm.rank == 0:
        write_gmsh(gmsh, path, **kind)
    comm.barrier()
    with pytest.raises(InputError, match=message):
        read_msh(path, comm)


def test_missing_or_foreign_mesh_file(comm, folder, gmsh):
    with pytest.raises(InputError, match="no such file"):
        read_msh(folder / "none.msh", comm)
    if comm.rank == 0:
        (folder / "foreign.msh").write_text("not a mesh\n")
    comm.barrier()
    with pytest.raises(InputError, match=r"foreign\.msh"):
        read_msh(folder / "foreign.msh", comm)


def test_bad_conditions(comm):
    operator = StrainOperator(box(comm, elements=(2, 2, 1), size=(1, 1, 1)))
    metric = isotropic(young=1e3, poisson=0.3)

    def scene(*conditions, loads=()):
        return Projection(operator, metric, conditions, loads)

    with pytest.raises(InputError, match="expected one of back, bottom, front, left, right, top, got 'east'"):
        scene(Displacement("east"))
    with pytest.raises(InputError, match="components on 'left': expected some of 0, 1, 2"):
        scene(Displacement("left", (0.0,), (3,)))
    with pytest.raises(InputError, match="displacement on 'left': expected finite numbers"):
        scene(Displacement("left", (0.0, np.nan, 0.0)))
    with pytest.raises(InputError, match=r"expected shape \(3,\), got \(2,\)"):
        scene(Displacement("left", (0.0, 0.0)))
    with pytest.raises(InputError, match="got 3 of 6; fix more components"):
        scene(Displacement("left", (0.0,), (0,)))
    with pytest.raises(InputError, match="traction on 'top': expected three finite numbers"):
        scene(Displacement("left"), loads=[Traction("top", (0, np.inf, 0))])
