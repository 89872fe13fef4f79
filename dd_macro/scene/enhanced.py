"""Trilinear hexahedra that bend: enhanced assumed strain with nine modes, unknowns inside the element.

The displacement gets three inner functions, 1 - xi_b^2 in the element's own coordinates xi in [-1, 1], each times an
amplitude a_b (3,) in m. They do not fit to those of the neighbours, and only their strain counts: with the gradients
    g_b = -2 (j_0 / j) xi_b grad_0 xi_b,      M a = sum_b sym(a_b g_b^T)
(j the determinant of the map to the element, 0: at its centre) the strain is epsilon = B u + M a, and equilibrium gets
M^T W sigma = 0 in every element. As int M dV = 0, a constant stress meets that on any mesh: the patch test. M has xi,
eta, zeta on the normal strains and two linear functions on each shear strain, turned to x, y, z by the map.

In finite strain M a adds to the strain U - I of the material, F = R U = I + grad u: so the modes turn with the body,
and energy and tangent stay those of one potential. Modes on F, sum_b a_b g_b^T, let an element bend of its own accord
when it is compressed; these do so as little as modes turned by F at the centre (docs/elements.md).

The unknowns are one vector: the displacement of the nodes, then a of the cells, (3 * nodes + 9 * cells,) in m. Whoever
solves for it condenses a in the elements (dd_macro.scene.condensation).
"""

from __future__ import annotations

from functools import cached_property

import basix
import numpy as np
from numpy.typing import NDArray

from dd_macro.scene.condensation import CellShapes, CondensedMatrix
from dd_macro.scene.kinematics import FiniteStrain, Kinematics, second_piola
from dd_macro.scene.mesh import TaggedMesh
from dd_macro.scene.spaces import GradientOperator, Stiffness, StrainOperator
from tsg_micro.data.errors import InputError
from tsg_micro.data.mandel import BASIS, from_mandel, to_mandel

__all__ = ["EnhancedFiniteStrain", "EnhancedGradientOperator", "EnhancedModes", "EnhancedStrainOperator"]

Array = NDArray[np.float64]
_HUGE = 1e50


class EnhancedModes:
    """M of the cells of an operator: strain of the amplitudes, and their forces; ``size`` of the amplitudes."""

    def __init__(self, operator: StrainOperator) -> None:
        element = basix.create_element(basix.ElementFamily.P, basix.CellType.hexahedron, 1)
        centre = element.tabulate(1, np.full((1, 3), 0.5))[1:, 0, :, 0]
        J = np.einsum("kn,cni->cik", centre, operator.cell_corners)
        # basix has the unit cube: xi = 2 X - 1
        self._gradient = -4.0 * np.linalg.inv(J)  # of 1 - xi_b^2 over xi_b at the centre, (cells, b, 3)
        self._xi = 2.0 * operator.reference_points - 1.0
        self._volume = np.abs(np.linalg.det(J))
        jacobian = operator.weights.reshape(len(J), operator.points_per_cell) / operator.reference_weights
        self._ratio = self._volume[:, None] / jacobian
        self._weighted = operator.reference_weights[:, None] * self._xi
        self.size = 9 * len(J)

    @property
    def gradients(self) -> Array:
        """g_b (cells, points, 3, 3) in 1/m at the quadrature points."""
        return np.einsum("cq,qb,cbi->cqbi", self._ratio, self._xi, self._gradient)

    def strain(self, a: Array) -> Array:
        """M a, Mandel (n, 6), of the amplitudes a (9 * cells,) in m."""
        linear = to_mandel(a.reshape(-1, 3, 3)[..., None] * self._gradient[:, :, None])  # (cells, b, 6)
        return (self._ratio[..., None] * (self._xi @ linear)).reshape(-1, 6)

    def force(self, stress: Array) -> Array:
        """M^T W sigma (9 * cells,) in N of the Mandel stress (n, 6) in Pa."""
        moment = self._weighted.T @ stress.reshape(*self._ratio.shape, 6)
        force = from_mandel(self._volume[:, None, None] * moment) @ self._gradient[..., None]
        return np.asarray(force.reshape(-1))


class _Enhanced(StrainOperator):
    """What small and finite strain share: more unknowns, of which the matrix is condensed.

    Raises:
        InputError: another degree than 1.
    """

    def __init__(self, domain: TaggedMesh, *, degree: int = 1) -> None:
        if degree != 1:
            raise InputError(f"degree: expected 1 of enhanced elements, got {degree}")
        super().__init__(domain)
        self.modes = EnhancedModes(self)

    @property
    def owned_dofs(self) -> int:
        """Number of unknowns that this rank owns: components of the displacement, and nine of each cell."""
        return super().owned_dofs + self.modes.size

    @cached_property
    def shapes(self) -> CellShapes:
        """The cells by their shape; collective when first asked for."""
        return CellShapes.of(self, self.modes.gradients)

    def stiffness(self, C: Array | None = None) -> Stiffness:
        """The condensed matrix, assembled with the modulus ``C`` (6, 6) in Pa if there is one."""
        matrix = CondensedMatrix(self, self.shapes)
        if C is not None:
            matrix.assemble(C)
        return matrix


class EnhancedStrainOperator(_Enhanced):
    """B, M and W in small strain: epsilon = B u + M a (n, 6).

    Example:
        >>> body = dd.box(MPI.COMM_WORLD, elements=(2, 2, 1), size=(4e-5, 4e-5, 2e-5))
        >>> dd.EnhancedStrainOperator(body).weights.shape
        (32,)
    """

    def strain(self, u: Array) -> Array:
        """Mandel strain (n, 6) at the quadrature points of the unknowns u (3 * nodes + 9 * cells,) in m."""
        nodal, inner = np.split(u, [3 * self.owned_nodes])
        return super().strain(nodal) + self.modes.strain(inner)

    def force(self, stress: Array) -> Array:
        """Forces (3 * nodes + 9 * cells,) in N of the Mandel stress (n, 6) in Pa."""
        return np.concatenate([super().force(stress), self.modes.force(stress)])


class EnhancedGradientOperator(_Enhanced, GradientOperator):
    """B, M and W in finite strain: the gradient H row by row and M a, (n, 15); the stress is P and T, (n, 15)."""

    def strain(self, u: Array) -> Array:
        """H and M a (n, 15) of the unknowns u (3 * nodes + 9 * cells,) in m."""
        nodal, inner = np.split(u, [3 * self.owned_nodes])
        return np.hstack([super().strain(nodal), self.modes.strain(inner)])

    def force(self, stress: Array) -> Array:
        """Forces (3 * nodes + 9 * cells,) in N of P and T (n, 15) in Pa."""
        return np.concatenate([super().force(stress[:, :9]), self.modes.force(stress[:, 9:])])

    def local(self, strain: Array) -> Kinematics:
        """Polar decomposition of I + H, and the strain M a that adds to U - I, of both (n, 15)."""
        return EnhancedFiniteStrain(strain)

    def modulus(self, C: Array) -> Array:
        """C (6, 6) as a matrix (15, 15) in Pa, acting on sym(H) + M a."""
        join = np.hstack([BASIS.reshape(6, 9), np.eye(6)])
        return np.asarray(join.T @ C @ join)


class EnhancedFiniteStrain(FiniteStrain):
    """F = R U of displacement gradients and the strain M a that adds to U - I, (n, 15).

    The material has the strain U - I + M a and the Biot stress T; the equations have T and P, its work conjugate to F.
    """

    def __init__(self, strain: Array) -> None:
        super().__init__(strain[:, :9])
        # of a diverging iteration: as in FiniteStrain, what has no bounds is inside out
        self.added = np.where(np.abs(strain[:, 9:]).max(axis=1, keepdims=True) < _HUGE, strain[:, 9:], -_HUGE)
        self.inside_out |= bool((np.linalg.eigvalsh(from_mandel(self.strain))[:, 0] <= -1.0).any())

    @property
    def strain(self) -> Array:
        """Strain U - I + M a of the material, Mandel (n, 6)."""
        return super().strain + self.added

    @property
    def deformation(self) -> Array:
        """R times the stretch of the material, (n, 3, 3)."""
        return np.asarray(self.R @ (np.eye(3) + from_mandel(self.strain)))

    def nominal_stress(self, stress: Array) -> Array:
        """First Piola stress and Biot stress (n, 15) in Pa of the Biot stress (n, 6)."""
        return np.hstack([super().nominal_stress(stress), stress])

    def nominal_tangent(self, stress: Array, tangent: Array) -> Array:
        """Derivative (n, 15, 15) in Pa of both by H and M a, of the stress (n, 6) and its tangent (n, 6, 6)."""
        A = np.empty((len(stress), 15, 15))
        A[:, :9, :9] = super().nominal_tangent(stress, tangent)
        A[:, 9:, :9] = tangent @ self.stretch_derivative
        A[:, :9, 9:] = (tangent.swapaxes(1, 2) @ self.stretch_derivative).swapaxes(1, 2)
        A[:, 9:, 9:] = tangent
        return A

    def material_stress(self, nominal: Array) -> Array:
        """Biot stress (n, 6) of the stress of the equations (n, 15), both in Pa."""
        return nominal[:, 9:]

    def first_piola(self, nominal: Array) -> Array:
        """First Piola stress (n, 3, 3) of the material, of the stress of the equations (n, 15), both in Pa."""
        U = np.eye(3) + from_mandel(self.strain)
        return np.asarray(self.R @ U @ second_piola(U, self.material_stress(nominal)))

    def turned(self, U: Array, stress: Array) -> Array:
        """Stress of the equations (n, 15) in Pa of data of Biot stress (n, 6), turned with R."""
        return self.nominal_stress(stress)
