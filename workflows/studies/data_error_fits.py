"""What the solves of ``tsgdd study data-error`` come to: rates, and the states that a target takes."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["ADAPTIVE", "errors_at", "fits", "fitted_slope", "mean_errors", "ratios", "savings", "states_needed"]

ADAPTIVE = "adaptive, from nothing"
TARGETS = (0.02, 0.01, 0.005)
_ABOVE = 1.5
"""Errors are fitted where they are at least as many times their floor."""


def fits(rows: list[dict[str, Any]], symbol: str, floors: set[str]) -> list[dict[str, Any]]:
    """Slope of every source and method, and the states that it needs for each of the targets.

    The floor of a source, where it has one, is the least error of the method, of all methods for the classical one.
    """
    found = []
    for source, method in dict.fromkeys((row["source"], row["method"]) for row in rows):
        most = max(row["states"] for row in rows if row["source"] == source)
        fit: dict[str, Any] = {"source": source, "method": method, "states": most}
        for name in (symbol, "state"):
            sizes, errors = mean_errors(rows, source, method, name)
            alike = {row["method"] for row in rows} if method == "classical" else {method}
            below = [r[name] for r in rows if r["source"] == source and r["method"] in alike and r[name] is not None]
            floor = min(below, default=0.0) if source in floors else 0.0
            slope, at_one = fitted_slope(sizes, errors, floor=floor)
            fit[f"slope_{name}"], fit[f"at_one_{name}"] = slope, at_one
            fit[f"least_{name}"] = float(errors.min()) if len(errors) else None
            fit[f"needed_{name}"] = {f"{target:g}": states_needed(sizes, errors, target) for target in TARGETS}
        found.append(fit)
    return found


def mean_errors(rows: list[dict[str, Any]], source: str, method: str, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of states, and geometric means over the draws of the error ``name``; solves that failed are left out."""
    own = [row for row in rows if (row["source"], row["method"]) == (source, method) and row[name] is not None]
    sizes = sorted({row["states"] for row in own})
    logs = [np.mean([np.log(row[name]) for row in own if row["states"] == size]) for size in sizes]
    return np.array(sizes, dtype=float), np.exp(logs)


def fitted_slope(sizes: np.ndarray, errors: np.ndarray, *, floor: float) -> tuple[float | None, float | None]:
    """Slope of log error over log number of states by least squares, and the error that the line has at one state.

    The ``floor`` is taken off the squares, and errors near it do not count. None of less than three.
    """
    used = errors > _ABOVE * floor
    if used.sum() < 3:
        return None, None
    slope, level = np.polyfit(np.log(sizes[used]), 0.5 * np.log(errors[used] ** 2 - floor**2), 1)
    return float(slope), float(np.exp(level))


def states_needed(sizes: np.ndarray, errors: np.ndarray, target: float) -> float | None:
    """The number of states from which on the error is ``target`` or less, on straight lines in the logarithms.

    The smallest number there is if all of them reach it; None if the largest does not.
    """
    above = np.flatnonzero(errors > target)
    if len(above) == 0:
        return float(sizes[0]) if len(sizes) else None
    k = above[-1]
    if k == len(errors) - 1:
        return None
    part = np.log(errors[k] / target) / np.log(errors[k] / errors[k + 1])
    return float(sizes[k] * (sizes[k + 1] / sizes[k]) ** part)


def ratios(fits: list[dict[str, Any]]) -> dict[str, dict[str, float | None]]:
    """Slope of second-order over that of classical data, for every source with both."""
    slopes = {(fit["source"], fit["method"]): fit for fit in fits}
    ratios: dict[str, dict[str, float | None]] = {}
    for source in dict.fromkeys(fit["source"] for fit in fits if fit["source"] != ADAPTIVE):
        one, two = (slopes[source, name] for name in ("classical", "second order"))
        names = [name for name in one if name.startswith("slope_")]
        ratios[source] = {n[6:]: None if None in (one[n], two[n]) else two[n] / one[n] for n in names}
    return ratios


def savings(fits: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """How many ``times`` the states of adaptive data others need, for every target that adaptive data reach.

    None where they never reach it; ``at_least`` is what they had, all in vain.
    """
    adaptive = next(fit for fit in fits if fit["source"] == ADAPTIVE)
    rows = []
    for fit in (fit for fit in fits if fit["source"] != ADAPTIVE):
        for name in [key[7:] for key in fit if key.startswith("needed_")]:
            for target, needed in adaptive[f"needed_{name}"].items():
                if needed is not None:
                    theirs, most = fit[f"needed_{name}"][target], fit["states"]
                    times = {
                        "times": None if theirs is None else theirs / needed,
                        "at_least": (theirs or most) / needed,
                    }
                    named = {"source": fit["source"], "method": fit["method"], "error": name, "target": float(target)}
                    rows.append(named | times)
    return rows


def errors_at(rows: list[dict[str, Any]], symbol: str, count: int) -> list[dict[str, Any]]:
    """Errors with ``count`` states, on straight lines in the logarithms."""
    found = []
    for source, method in dict.fromkeys((row["source"], row["method"]) for row in rows):
        row: dict[str, Any] = {"source": source, "method": method}
        for name in (symbol, "state"):
            sizes, errors = mean_errors(rows, source, method, name)
            inside = len(sizes) > 0 and sizes[0] <= count <= sizes[-1]
            row[name] = float(np.exp(np.interp(np.log(count), np.log(sizes), np.log(errors)))) if inside else None
        found.append(row)
    return found
