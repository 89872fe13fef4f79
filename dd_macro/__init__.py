"""Model-free data-driven finite elements on DOLFINx, after Kirchdoerfer and Ortiz (paper, Section 4).

The job as a chain: mesh -> strain operator -> metric -> search and projection -> solve -> output, compare, plot.
"""

from dd_macro import compat  # noqa: F401  (first: it decides how DOLFINx is imported)
from dd_macro.compat import KernelError
from dd_macro.material.estimated_tangents import estimate_tangents
from dd_macro.material.fitting import fit_linear, fit_polynomial, mirrors_of
from dd_macro.material.laws import FitReport, Law, LinearLaw, PolynomialEnergy
from dd_macro.material.metric import Metric, isotropic, mean_tangent, metric_from_dataset, secant_modulus
from dd_macro.material.search import MaterialSearch
from dd_macro.material.source import Source
from dd_macro.material.tangent_spaces import TangentSearch
from dd_macro.methods.adaptive import AdaptiveMethod, AdaptiveResult
from dd_macro.methods.adaptive_rounds import Adaptation
from dd_macro.methods.data_methods import DataMethod, PointMethod, PreparedData, TangentMethod
from dd_macro.methods.finite_projection import FiniteProjection, FiniteState, biot_dataset, in_space
from dd_macro.methods.law_method import LawMethod
from dd_macro.methods.method import Material, Method, Prepared, Watch
from dd_macro.methods.metric_choice import METRICS, choose_metric, visited_tangent
from dd_macro.methods.newton import equilibrium, solve_law
from dd_macro.methods.points import DataDrivenResult, Iteration, SolverOptions, solve
from dd_macro.methods.projection import MechanicalState, Projection
from dd_macro.methods.reference import NewtonIteration, ReferenceOptions, ReferenceResult
from dd_macro.methods.registry import METHODS
from dd_macro.methods.second_order import SecondOrderOptions, SecondOrderResult, solve_second_order
from dd_macro.methods.solution import Solution
from dd_macro.methods.theory import THEORIES, make_projection, project
from dd_macro.results.check import CHECKS, ErrorEstimate, check_by_data, check_by_source
from dd_macro.results.compare import BlockStress, Comparison, FieldError, compare_blocks, interior_blocks
from dd_macro.results.compare_bodies import BodyErrors, block_means, body_errors, inner_blocks
from dd_macro.results.quadrature_file import QuadratureFields, read_quadrature, write_quadrature
from dd_macro.results.sides import side_displacement, volume_change
from dd_macro.results.vtkhdf import write_vtkhdf
from dd_macro.results.write import write_solution
from dd_macro.scene.boundary import Displacement
from dd_macro.scene.enhanced import EnhancedGradientOperator, EnhancedStrainOperator
from dd_macro.scene.kinematics import FiniteStrain
from dd_macro.scene.loads import BodyForce, Load, Traction
from dd_macro.scene.mesh import SIDES, TaggedMesh, box, read_msh
from dd_macro.scene.pressure import Pressure
from dd_macro.scene.problem import Problem
from dd_macro.scene.regions import INSIDE, Place, Regions, edge_regions
from dd_macro.scene.spaces import GradientOperator, StrainOperator, TangentMatrix
from dd_macro.scene.voxel_grid import VoxelGrid, voxel_grid
from dd_macro.scene.voxels import voxel_mesh
from tsg_micro.data.version import VERSION as __version__

__all__ = [
    "CHECKS",
    "INSIDE",
    "METHODS",
    "METRICS",
    "SIDES",
    "THEORIES",
    "Adaptation",
    "AdaptiveMethod",
    "AdaptiveResult",
    "BlockStress",
    "BodyErrors",
    "BodyForce",
    "Comparison",
    "DataDrivenResult",
    "DataMethod",
    "Displacement",
    "EnhancedGradientOperator",
    "EnhancedStrainOperator",
    "ErrorEstimate",
    "FieldError",
    "FiniteProjection",
    "FiniteState",
    "FiniteStrain",
    "FitReport",
    "GradientOperator",
    "Iteration",
    "KernelError",
    "Law",
    "LawMethod",
    "LinearLaw",
    "Load",
    "Material",
    "MaterialSearch",
    "MechanicalState",
    "Method",
    "Metric",
    "NewtonIteration",
    "Place",
    "PointMethod",
    "PolynomialEnergy",
    "Prepared",
    "PreparedData",
    "Pressure",
    "Problem",
    "Projection",
    "QuadratureFields",
    "ReferenceOptions",
    "ReferenceResult",
    "Regions",
    "SecondOrderOptions",
    "SecondOrderResult",
    "Solution",
    "SolverOptions",
    "Source",
    "StrainOperator",
    "TaggedMesh",
    "TangentMatrix",
    "TangentMethod",
    "TangentSearch",
    "Traction",
    "VoxelGrid",
    "Watch",
    "__version__",
    "biot_dataset",
    "block_means",
    "body_errors",
    "box",
    "check_by_data",
    "check_by_source",
    "choose_metric",
    "compare_blocks",
    "edge_regions",
    "equilibrium",
    "estimate_tangents",
    "fit_linear",
    "fit_polynomial",
    "in_space",
    "inner_blocks",
    "interior_blocks",
    "isotropic",
    "make_projection",
    "mean_tangent",
    "metric_from_dataset",
    "mirrors_of",
    "project",
    "read_msh",
    "read_quadrature",
    "secant_modulus",
    "side_displacement",
    "solve",
    "solve_law",
    "solve_second_order",
    "visited_tangent",
    "volume_change",
    "voxel_grid",
    "voxel_mesh",
    "write_quadrature",
    "write_solution",
    "write_vtkhdf",
]
