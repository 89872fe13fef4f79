"""Displacement space, quadrature points, and the strain operator that joins them.

B and W are the paper's B_e and w_e; with Mandel vectors at the quadrature points
    strain  epsilon = B u                                 (paper, compatibility)
    force   sum_e w_e B_e^T sigma_e = B^T W sigma         (paper, equilibrium)
There is no matrix of it, cells are worked on many at once (dd_macro.scene.gradients).
In finite strain B u is the gradient of the displacement and sigma the first Piola stress, both with 9 components.
All arrays are plain NumPy and hold what this rank owns: fields at quadrature points are (cells * points, ...),
cell by cell in the local order, nodal fields are flat (3 * nodes,).
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import basix.ufl
import dolfinx
import dolfinx.fem.petsc
import numpy as np
import ufl
from mpi4py import MPI
from numpy.typing import NDArray
from petsc4py import PETSc

from dd_macro.compat import compile_form, geometry_nodes
from dd_macro.scene.gradients import CellGradients, CellMaps
from dd_macro.scene.kinematics import FiniteStrain, Kinematics, SmallStrain
from dd_macro.scene.mesh import TaggedMesh
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import BASIS

__all__ = [
    "GradientOperator",
    "Stiffness",
    "StrainOperator",
    "TangentMatrix",
    "mandel_strain",
    "stiffness_form",
]

Array = NDArray[np.float64]


def mandel_strain(u: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
    """UFL Mandel vector of sym(grad u), the order and factors of tsg_micro.data.mandel."""
    e = ufl.sym(ufl.grad(u))
    r = np.sqrt(2.0)
    return ufl.as_vector([e[0, 0], e[1, 1], e[2, 2], r * e[1, 2], r * e[0, 2], r * e[0, 1]])


class StrainOperator:
    """B and W of a mesh: strain of displacements, nodal forces of stresses.

    Args:
        domain: the mesh.
        degree: degree of the vector Lagrange space, 1 or 2.

    The Gauss rule integrates degree 2 * degree + 1: 8 points in a trilinear hexahedron, 27 for degree 2.

    Raises:
        InputError: another degree.

    Example:
        >>> operator = dd.StrainOperator(dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5)))
        >>> operator.global_dofs, f"{operator.weights.sum():.3g}"
        (54, '3.2e-14')
    """

    components = 6
    directions = BASIS
    """Tensors (components, 3, 3) whose coefficients B u has."""
    theory = "small"
    """Of strain (dd_macro.methods.theory)."""

    def __init__(self, domain: TaggedMesh, *, degree: int = 1) -> None:
        if degree not in (1, 2):
            raise InputError(f"degree: expected 1 or 2, got {degree}")
        self.domain = domain
        mesh = domain.mesh
        rule = {"quadrature_degree": 2 * degree + 1, "quadrature_rule": "default"}
        self.dx = ufl.Measure("dx", mesh, metadata=rule)
        self.displacements = dolfinx.fem.functionspace(mesh, ("Lagrange", degree, (3,)))
        cell, scheme = mesh.basix_cell(), 2 * degree + 1
        self.reference_points, self.reference_weights = basix.make_quadrature(cell, scheme)
        self.points_per_cell = len(self.reference_weights)
        local = self._tabulate(1)[1:]
        self.maps = CellMaps.of(domain.comm, self.cell_corners, local, self.reference_weights)
        if degree > 1:
            element = basix.ufl.element("Lagrange", cell.name, degree)
            local = element.tabulate(1, self.reference_points)[1:]
        self._gradients = CellGradients(self.maps, local, self.directions)
        self._dofs = self.displacements.dofmap.list[: domain.owned_cells].astype(np.int64)
        self._ghosted = dolfinx.fem.Function(self.displacements)
        self.weights: Array = self.maps.weights[self.maps.kind].reshape(-1)

    @staticmethod
    def expression(u: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
        """UFL vector of B u."""
        return mandel_strain(u)

    def local(self, strain: Array) -> Kinematics:
        """What B u (n, 6) means to the material at the quadrature points."""
        return SmallStrain(strain)

    def modulus(self, C: Array) -> Array:
        """C (6, 6) in Pa as it stands between B u and the stress of the equations."""
        return C

    @property
    def comm(self) -> MPI.Comm:
        """The communicator of the mesh."""
        return self.domain.comm

    def stiffness(self, C: Array | None = None) -> Stiffness:
        """K = sum w B^T C B, assembled with the modulus C (6, 6) in Pa, or to be assembled with one at every point."""
        if C is None:
            return TangentMatrix(self)
        K = dolfinx.fem.petsc.assemble_matrix(stiffness_form(self, C))
        K.assemble()
        return Stiffness(K)

    @property
    def owned_nodes(self) -> int:
        """Number of nodes that this rank owns."""
        return int(self.displacements.dofmap.index_map.size_local)

    @property
    def owned_dofs(self) -> int:
        """Number of unknowns that this rank owns: the displacement components of its nodes."""
        return 3 * self.owned_nodes

    @property
    def global_dofs(self) -> int:
        """Number of displacement components on all ranks."""
        return 3 * int(self.displacements.dofmap.index_map.size_global)

    def strain(self, u: Array) -> Array:
        """Mandel strain (n, 6) at the quadrature points of the nodal displacement u (3 * nodes,) in m."""
        x = self._ghosted.x
        x.array[: 3 * self.owned_nodes] = u
        x.scatter_forward()
        return self._gradients.strain(x.array.reshape(-1, 3)[self._dofs])

    def force(self, stress: Array) -> Array:
        """Nodal forces (3 * nodes,) in N of the Mandel stress (n, 6) in Pa: sum w B^T sigma."""
        x, at_cells = self._ghosted.x, self._gradients.force(stress)
        unknowns = (3 * self._dofs[..., None] + np.arange(3)).reshape(-1)
        x.array[:] = np.bincount(unknowns, at_cells.reshape(-1), minlength=len(x.array))
        x.scatter_reverse(dolfinx.la.InsertMode.add)
        return x.array[: 3 * self.owned_nodes].copy()

    def node_coordinates(self) -> Array:
        """Coordinates (nodes, 3) in m of the nodes that this rank owns."""
        return self.displacements.tabulate_dof_coordinates()[: self.owned_nodes]

    @cached_property
    def cell_corners(self) -> Array:
        """Corners (cells, 8, 3) in m, in DOLFINx's tensor-product order."""
        mesh = self.domain.mesh
        return mesh.geometry.x[geometry_nodes(mesh)]

    @cached_property
    def points(self) -> Array:
        """Coordinates (n, 3) in m of the quadrature points."""
        shape = self._tabulate(0)[0]
        return np.einsum("qn,cni->cqi", shape, self.cell_corners).reshape(-1, 3)

    def cell_mean(self, values: Array) -> Array:
        """Volume means (cells, ...) of values (n, ...) at the quadrature points."""
        nq = self.points_per_cell
        w = self.weights.reshape(-1, nq)
        return np.einsum("cq,cq...->c...", w / w.sum(axis=1, keepdims=True), values.reshape(-1, nq, *values.shape[1:]))

    def corner_displacement(self, u: Array) -> Array:
        """Displacement (cells, 8, 3) in m at the corners of the cells, from u, whose first 3 * nodes are nodal."""
        function = dolfinx.fem.Function(self.displacements)
        function.x.array[: 3 * self.owned_nodes] = u[: 3 * self.owned_nodes]
        function.x.scatter_forward()
        # the first eight nodes of a Lagrange hexahedron are its corners
        corners = self.displacements.dofmap.list[: self.domain.owned_cells, :8]
        return function.x.array.reshape(-1, 3)[corners]

    def shape_gradients(self, cells: NDArray[np.int64]) -> Array:
        """Gradients (cells, points, 8, 3) in 1/m of the trilinear functions at the quadrature points of these cells."""
        local = self._tabulate(1)[1:]
        J = np.einsum("kqn,cni->cqik", local, self.cell_corners[cells])
        return np.asarray(np.moveaxis(local, 0, -1) @ np.linalg.inv(J))

    def _tabulate(self, derivatives: int) -> Array:
        element = basix.create_element(basix.ElementFamily.P, basix.CellType.hexahedron, 1)
        return element.tabulate(derivatives, self.reference_points)[..., 0]


class GradientOperator(StrainOperator):
    """B and W for finite strain: B u is the gradient H of the displacement, row by row (n, 9); its stress is P (n, 9).

    A modulus C acts on the symmetric part of H alone.
    """

    components = 9
    directions = np.eye(9).reshape(9, 3, 3)
    theory = "finite"

    @staticmethod
    def expression(u: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
        """UFL vector of grad u."""
        H = ufl.grad(u)
        return ufl.as_vector([H[i, j] for i in range(3) for j in range(3)])

    def local(self, strain: Array) -> Kinematics:
        """Polar decomposition of I + H, H (n, 9)."""
        return FiniteStrain(strain)

    def modulus(self, C: Array) -> Array:
        """C (6, 6) as a matrix (9, 9) in Pa."""
        symmetric = BASIS.reshape(6, 9)
        return np.asarray(symmetric.T @ C @ symmetric)


def stiffness_form(operator: StrainOperator, C: Array) -> Any:
    """The compiled form of K = sum w B^T C B of one symmetric C (6, 6) in Pa."""
    V = operator.displacements
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    modulus = dolfinx.fem.Constant(operator.domain.mesh, np.ascontiguousarray(C, dtype=float))
    return compile_form(ufl.inner(mandel_strain(v), ufl.dot(modulus, mandel_strain(u))) * operator.dx)


class Stiffness:
    """``matrix`` (3 * nodes square, N/m) of the nodal displacement, no boundary conditions yet.

    Elements with unknowns of their own are condensed (dd_macro.scene.condensation); here there are none. ``negative``
    counts the negative eigenvalues that condensation took out.
    """

    negative = 0

    def __init__(self, matrix: PETSc.Mat) -> None:
        self.matrix = matrix

    def assemble(self, C: Array, own: NDArray[np.int64] | None = None) -> PETSc.Mat:
        """``matrix`` with the moduli C in Pa at the quadrature points, or those of C that are each point's ``own``."""
        raise NotImplementedError

    def condense(self, force: Array) -> Array:
        """Right side (3 * nodes,) in N for a force on all unknowns."""
        return force

    def expand(self, u: Array, force: Array) -> Array:
        """All unknowns in m, of the nodal u (3 * nodes,) for this force."""
        return u


class TangentMatrix(Stiffness):
    """K = sum w B^T C B with a C of its own at every quadrature point; one sparsity pattern, assembled again and again.

    ``matrix`` (3 * nodes square, N/m) is that of the last :meth:`assemble`, without boundary conditions.
    """

    def __init__(self, operator: StrainOperator) -> None:
        V = operator.displacements
        mesh = operator.domain.mesh
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        degree = operator.dx.metadata()["quadrature_degree"]
        shape = (operator.components, operator.components)
        element = basix.ufl.quadrature_element(mesh.basix_cell(), value_shape=shape, scheme="default", degree=degree)
        self._moduli = dolfinx.fem.Function(dolfinx.fem.functionspace(mesh, element))
        points = self._moduli.function_space.dofmap.list[: operator.domain.owned_cells]
        self._order = points.reshape(-1)  # quadrature dof of each point, cell by cell
        stress = ufl.dot(self._moduli, operator.expression(u))
        self._form = compile_form(ufl.inner(operator.expression(v), stress) * operator.dx)
        super().__init__(dolfinx.fem.petsc.create_matrix(self._form))

    def assemble(self, C: Array, own: NDArray[np.int64] | None = None) -> PETSc.Mat:
        """``matrix`` with the moduli C in Pa, (n, 6, 6) or with 9 components (n, 9, 9); of ``own`` numbers (n,)."""
        self._moduli.x.array.reshape(-1, *C.shape[1:])[self._order] = C if own is None else C[own]
        self.matrix.zeroEntries()
        dolfinx.fem.petsc.assemble_matrix(self.matrix, self._form)
        self.matrix.assemble()
        return self.matrix
