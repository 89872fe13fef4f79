"""Tensegrity micro-solver: truncated-octahedron cells, their equilibrium, and what they are as a continuum.

The job as a chain: structure -> prestress -> equilibrium -> homogenise, RVE -> sampling -> data set.
SI units throughout; strain and stress vectors are Mandel (tsg_micro.data.mandel).
"""

from tsg_micro.bodies.cell import indent_cell
from tsg_micro.bodies.sheet import ClampedSheet, Sheet, stretch_sheet
from tsg_micro.bodies.spheroid import build_spheroid, compress_spheroid
from tsg_micro.bodies.voxel_body import BlockBody, build_block_body
from tsg_micro.bodies.voxel_path import LoadedBody, VoxelLoads
from tsg_micro.cells.lattice import box_cells, lattice, side_nodes, spheroid_cells
from tsg_micro.cells.laws.linear import Linear, NoCompression
from tsg_micro.cells.member_law import MemberLaw, Members, member_law
from tsg_micro.cells.parameters import CellParameters
from tsg_micro.cells.prestress import (
    SelfStress,
    prestressed,
    self_stress,
    with_bar_force,
    with_force_density,
    with_self_stress,
)
from tsg_micro.cells.structure import Structure, equilibrium_matrix, from_arrays, member_vectors
from tsg_micro.cells.tissue import UNIT_CELLS, Tissue
from tsg_micro.cells.tissue_file import read_tissue, write_tissue
from tsg_micro.cells.truncated_octahedron import unit_cell
from tsg_micro.cells.unit_cell import UnitCell
from tsg_micro.continuum.homogenise import BlockFields, block_fields, cell_gradient, kirchhoff_stress
from tsg_micro.continuum.rve import RVE, RVEState, build_rve
from tsg_micro.continuum.rve_law import RVELaw
from tsg_micro.continuum.rve_source import RVESource
from tsg_micro.continuum.rve_spec import RVESpec
from tsg_micro.continuum.sampling import BOXES, StrainBox, join_paths, sample_paths, strain_path
from tsg_micro.data.dataset import Dataset, convert_dataset, join_datasets, take
from tsg_micro.data.dataset_file import append_dataset, read_dataset, write_dataset
from tsg_micro.data.errors import ConvergenceError, InputError
from tsg_micro.data.mandel import from_mandel, pressure, to_mandel, von_mises
from tsg_micro.data.version import VERSION as __version__
from tsg_micro.equilibrium.load_path import Equilibrium, EquilibriumSolver
from tsg_micro.equilibrium.newton import NewtonOptions

__all__ = [
    "BOXES",
    "RVE",
    "UNIT_CELLS",
    "BlockBody",
    "BlockFields",
    "CellParameters",
    "ClampedSheet",
    "ConvergenceError",
    "Dataset",
    "Equilibrium",
    "EquilibriumSolver",
    "InputError",
    "Linear",
    "LoadedBody",
    "MemberLaw",
    "Members",
    "NewtonOptions",
    "NoCompression",
    "RVELaw",
    "RVESource",
    "RVESpec",
    "RVEState",
    "SelfStress",
    "Sheet",
    "StrainBox",
    "Structure",
    "Tissue",
    "UnitCell",
    "VoxelLoads",
    "__version__",
    "append_dataset",
    "block_fields",
    "box_cells",
    "build_block_body",
    "build_rve",
    "build_spheroid",
    "cell_gradient",
    "compress_spheroid",
    "convert_dataset",
    "equilibrium_matrix",
    "from_arrays",
    "from_mandel",
    "indent_cell",
    "join_datasets",
    "join_paths",
    "kirchhoff_stress",
    "lattice",
    "member_law",
    "member_vectors",
    "pressure",
    "prestressed",
    "read_dataset",
    "read_tissue",
    "sample_paths",
    "self_stress",
    "side_nodes",
    "spheroid_cells",
    "strain_path",
    "stretch_sheet",
    "take",
    "to_mandel",
    "unit_cell",
    "von_mises",
    "with_bar_force",
    "with_force_density",
    "with_self_stress",
    "write_dataset",
    "write_tissue",
]
