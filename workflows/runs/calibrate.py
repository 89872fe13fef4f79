"""tsgdd calibrate: parameters of the cell from a measured curve, and how well each is determined."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tsg_micro.bodies.curve_fit import PARAMETERS, SCENES, Model, fit_curve
from tsg_micro.cells.tissue_file import write_tissue
from tsg_micro.data.errors import InputError
from tsg_micro.data.files import output_folder
from tsg_micro.data.measured_curve import read_curve
from tsg_micro.data.table import Layout
from workflows.store.record import write_summary

__all__ = ["calibrate", "parameter_names"]


def parameter_names(texts: Sequence[str]) -> tuple[str, ...]:
    """Names as in PARAMETERS from texts in any case, with - or _.

    Raises:
        InputError: none, an unknown one, or one twice.
    """
    known = {name.lower(): name for name in PARAMETERS}
    names = []
    for text in texts:
        name = known.get(text.strip().lower().replace("-", "_"))
        if name is None:
            shown = ", ".join(name.replace("_", "-") for name in PARAMETERS)
            raise InputError(f"fit: expected parameters among {shown}, got {text!r}")
        names.append(name)
    if not names or len(set(names)) != len(names):
        raise InputError(f"fit: expected at least one parameter, each once, got {', '.join(texts) or 'none'}")
    return tuple(names)


def calibrate(
    out: Path,
    *,
    data: Path,
    fit: Sequence[str],
    model: Model | None = None,
    column: Sequence[str] = (),
    layout: Layout | None = None,
    save_tissue: Path | None = None,
    plots: bool = True,
) -> dict[str, Any]:
    """Fit parameters of ``model`` to the curve in the CSV file ``data``; figure and summary go to ``out``.

    The tissue that fits best is written to the file ``save_tissue``, if one is given.

    Raises:
        InputError: an argument or the file is not valid.
        ConvergenceError: the equilibrium was lost from the start.
    """
    model = model or Model()
    names = parameter_names(fit)
    load, answer = read_curve(data, model.scene, column, layout)
    out = output_folder(out)
    if save_tissue is not None and (save_tissue.is_dir() or not output_folder(save_tissue.parent)):
        raise InputError(f"save_tissue: expected a file, got the folder {save_tissue}")
    parameters = {
        "data": data,
        "scene": model.scene,
        "fit": names,
        "start": {name: model.value(name) for name in names},
        "blocks": model.blocks if model.scene == "monolayer" else None,
        "top": model.top if model.scene == "cell" else None,
        **model.tissue.as_dict(),
        "bounds": {name: (PARAMETERS[name].low, PARAMETERS[name].high) for name in names},
    }
    begin = time.perf_counter()
    found = fit_curve(model, names, load, answer)
    seconds = time.perf_counter() - begin
    intervals = [None] * len(names) if found.interval is None else found.interval.tolist()
    fitted = {
        name: {"value": value, "interval": interval, "unit": PARAMETERS[name].unit}
        for name, value, interval in zip(names, found.values.tolist(), intervals, strict=True)
    }
    summary = write_summary(
        out,
        command="calibrate",
        parameters=parameters,
        figures={
            "fitted": (fitted, ""),
            "correlation": (found.correlation.tolist(), "1"),
            "rms": (found.rms, SCENES[model.scene]),
            "relative_rms": (found.rms / float(np.abs(answer).max()), "largest measured"),
            "warnings": (list(found.warnings), ""),
            "points": (len(load), ""),
            "evaluations": (found.evaluations, ""),
            "seconds": (seconds, "s"),
        },
    )
    if save_tissue:
        write_tissue(save_tissue, found.model.tissue)
    if plots:
        from tsg_micro.figures.curve_fit import draw_fit

        draw_fit(out, found, load, answer)
    return summary
