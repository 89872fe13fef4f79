"""Scenes shared by the tests; all of them run on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import dd_macro  # noqa: F401  (before anything of DOLFINx)
from tsg_micro.data.dataset import Dataset

COMM = MPI.COMM_WORLD


@pytest.fixture
def comm():
    return COMM


@pytest.fixture
def folder(shared_tmp_path):
    """A folder that is the same on all ranks, and is there on all of them."""
    COMM.barrier()
    return shared_tmp_path


@pytest.fixture
def gmsh():
    """The package, or a skip: its wheel also needs graphics libraries that a bare system may not have."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        pytest.skip(f"gmsh: {error}")
    return gmsh


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def make_dataset():
    def make(strain, stress, **more):
        n = len(strain)
        return Dataset(
            strain=np.asarray(strain, dtype=float),
            stress=np.asarray(stress, dtype=float),
            stress_measure="cauchy",
            path=np.zeros(n, dtype=np.int64),
            step=np.arange(n),
            **more,
        )

    return make
