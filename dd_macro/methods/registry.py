"""All methods by name. A new one is a file, and a line here."""

from __future__ import annotations

from dd_macro.material.fitting import fit_linear, fit_polynomial
from dd_macro.methods.adaptive import AdaptiveMethod
from dd_macro.methods.data_methods import DataMethod, PointMethod, TangentMethod, without_tangents
from dd_macro.methods.law_method import LawMethod
from dd_macro.methods.method import Method
from dd_macro.methods.points import SolverOptions

__all__ = ["METHODS", "data_methods"]

_PLAIN = SolverOptions(max_iterations=1000, over_relaxation=1.0)

METHODS: dict[str, Method] = {
    "classical": PointMethod(),
    "classical, omega 1": PointMethod(_PLAIN, variant_of="classical"),
    "second order": TangentMethod(),
    "second order, alternating": TangentMethod("alternating", theories=("small",), variant_of="second order"),
    "second order, estimated tangents": TangentMethod(data=without_tangents),
    "second order, averages": TangentMethod(
        data=without_tangents, estimate=100, neighbours=40, variant_of="second order, estimated tangents"
    ),
    "linear elastic law": LawMethod(fit_linear),
    "polynomial energy law": LawMethod(fit_polynomial),
    "adaptive": AdaptiveMethod(),
    "FE2": LawMethod(),
}


def data_methods() -> dict[str, DataMethod]:
    """Those that look up data that they are given."""
    return {name: method for name, method in METHODS.items() if isinstance(method, DataMethod)}
