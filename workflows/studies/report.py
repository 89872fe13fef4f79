"""The report of ``tsgdd paper``: one table of quantity, paper, ours and command, and every figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from workflows.runs.loads import LOADS
from workflows.store.record import machine, read_summary, versions
from workflows.studies.prerequisites import Chain

__all__ = ["write_report"]

Summary = Mapping[str, Any]

_PAPER = {
    "stretch": {"error_mech": "about 8 %", "error_mat": "about 5 %", "distance": "about 7 %", "own": "about 3 %"},
    "shear": {
        "error_mech": "figure only",
        "error_mat": "figure only",
        "distance": "own data + 5 %",
        "own": "about 3 %",
    },
}
"""What the paper prints in Section 4.2 and 4.3; of other loads nothing."""
_NOTHING = dict.fromkeys(("error_mech", "error_mat", "distance", "own"), "-")


def write_report(file: Path, runs: Path, chain: Chain) -> list[dict[str, str]]:
    """Write the report on the stages in the folder ``runs`` to ``file``; the rows of its table.

    Raises:
        InputError: a stage is not there.
    """
    found = {
        load: {
            "sample": read_summary(runs / f"data-{load}" / "data.h5", "sample"),
            "dns": read_summary(runs / f"dns-{load}", "dns"),
            "free": read_summary(runs / f"dns-{load}-free", "dns"),
            "dd": read_summary(runs / f"dd-{load}", "solve"),
            "compare": read_summary(runs / f"compare-{load}", "compare"),
            "size": read_summary(runs / f"data-size-{load}", "study data-size"),
            "frontier": read_summary(runs / f"frontier-{load}", "bench frontier"),
            "causes": read_summary(runs / f"causes-{load}", "study causes"),
        }
        for load in LOADS
    }
    rve = read_summary(runs / "rve-size", "study rve-size")
    rows = [row for load in LOADS for row in _rows(load, found[load], chain)] + _rve_rows(rve)
    text = [
        "# The multiscale study, with the paper's figures beside ours",
        "",
        f"{chain.blocks[0]} x {chain.blocks[1]} blocks, {chain.strain:.3g} strain, bar force {chain.bar_force:.3g} N, "
        f"{chain.paths} paths of {chain.steps} data from seed {chain.seed}. The full tensegrity is held flat "
        "(`--flat`): an equilibrium of the free sheet too, but under shear not a stable one. Errors are |a - b| / |b| "
        "over the blocks (l2), the outer blocks left out, unless it says otherwise; the paper's are means of relative "
        "errors. Times are of this run, in which one process did everything. "
        f"{machine()['processor']}, {machine()['cores']} cores; tsgdd {versions()['tsgdd']}.",
        "",
        "| quantity | paper | ours | command |",
        "|---|---|---|---|",
        *(f"| {row['quantity']} | {row['paper']} | {row['ours']} | `{row['command']}` |" for row in rows),
        "",
        "## Which RVE",
        "",
        rve["answer"],
        "",
        *_images(runs, "rve-size"),
    ]
    for load, one in LOADS.items():
        text += _load_section(runs, load, one.symbol, found[load])
    text += _other_scenes(runs)
    file.write_text("\n".join(text) + "\n")
    return rows


def _rows(load: str, found: Mapping[str, Summary], chain: Chain) -> Iterable[dict[str, str]]:
    symbol, size, dns = LOADS[load].symbol, found["size"], found["dns"]
    scene = f"--load {load} --strain {chain.strain!r} --bar-force {chain.bar_force!r}"
    blocks = f"--blocks {chain.blocks[0]} {chain.blocks[1]}"
    data = f"--paths {chain.paths} --steps {chain.steps} --seed {chain.seed}"
    asked = size["parameters"]
    study = f"tsgdd study data-size {scene} {blocks} {data} --sizes {asked['count']} --draws {asked['draws']}"
    paper, largest, own = _PAPER.get(load, _NOTHING), size["largest"], size["self_consistent"]
    sampling = found["sample"]["seconds"]
    timed = [p for p in found["frontier"]["points"] if p["method"] == "data-driven, metric tangent"]
    solving = timed[-1]["seconds_solve"]
    relative = {name: found["compare"][f"error_{symbol}_{name}"]["mean"] for name in ("mech", "mat")}

    def row(quantity: str, printed: str, ours: str, command: str) -> dict[str, str]:
        return {"quantity": f"{load}: {quantity}", "paper": printed, "ours": ours, "command": command}

    yield row(f"error of {symbol}, mechanical", paper["error_mech"], _percent(largest, "error_mech"), study)
    yield row(f"error of {symbol}, material", paper["error_mat"], _percent(largest, "error_mat"), study)
    each = f"{_percent(relative, 'mech')}, {_percent(relative, 'mat')}"
    yield row("mean relative error of a block, mechanical and material", "see above", each, "tsgdd compare")
    yield row("normalised distance", paper["distance"], _percent(largest, "distance"), study)
    yield row("the same, data of the tensegrity itself", paper["own"], _percent(own, "distance"), study)
    full = f"tsgdd dns {scene} {blocks} --flat"
    resumed = f", resumed after step {dns['resumed_after_step']}" if dns["resumed_after_step"] else ""
    yield row("time of the full tensegrity, held flat", "-", f"{dns['seconds']:.3g} s{resumed}", full)
    yield row("nominal stress, held flat", "-", f"{dns['nominal_stress']:.1f} Pa", full)
    yield row("rows of blocks against the reaction", "-", f"{dns['row_balance']:.0e}", full)
    free = found["free"]
    deflection = f"{1e6 * free['deflection']:.2g} µm, {free['nominal_stress']:.1f} Pa, {free['seconds']:.3g} s"
    yield row(
        "deflection and nominal stress if it may leave its plane", "-", deflection, full.replace("--flat", "--free")
    )
    yield row(
        "time of sampling",
        "-",
        f"{sampling:.3g} s for {found['sample']['points']} data",
        f"tsgdd sample --load {load} --bar-force {chain.bar_force!r} {data} --out data.h5",
    )
    yield row(
        "time of one data-driven solve on one rank, mesh and metric included",
        "-",
        f"{solving:.2g} s (search {found['dd']['seconds_search']:.2g} s, linear solves "
        f"{found['dd']['seconds_linear_solves']:.2g} s)",
        f"tsgdd bench frontier {scene} {blocks} {data}",
    )
    ratio = f"{dns['seconds'] / solving:.0f} : {sampling / solving:.0f} : 1"
    yield row("full tensegrity : sampling : solve", "-", ratio, f"tsgdd bench frontier {scene} {blocks} {data}")
    solves = f"{size['solves']} in {size['seconds_solves']:.3g} s"
    yield row("solves of the data-size study", "-", solves, study)


def _rve_rows(rve: Summary) -> list[dict[str, str]]:
    slopes = f"{rve['duplicated_slope_min']:.2f} .. {rve['duplicated_slope_max']:.2f}"
    stored = [slope for forces in rve["slopes"]["stored_energy"].values() for slope in forces.values()]
    forces = " ".join(f"--bar-force {force!r}" for force in rve["parameters"]["bar_force"])
    rows = (
        ("RVE chosen", "3x3x1", rve["chosen"]),
        ("RVE, images merged: largest deviation from 1x1x1", "-", f"{rve['merged_largest_deviation']:.0e}"),
        ("RVE, images duplicated: slope of the error over size, energy change and stress", "a figure", slopes),
        ("the same, stored energy with prestress", "a figure", f"{min(stored):.2f} .. {max(stored):.2f}"),
    )
    command = f"tsgdd study rve-size --largest {rve['parameters']['largest']} {forces}"
    return [dict(zip(("quantity", "paper", "ours"), row, strict=True)) | {"command": command} for row in rows]


def _load_section(runs: Path, load: str, symbol: str, found: Mapping[str, Summary]) -> list[str]:
    """Figures of one load, what moves its error, and run time against error."""
    largest, own, frontier = found["size"]["largest"], found["size"]["self_consistent"], found["frontier"]
    changes, drops = found["causes"]["rows"], found["causes"]["largest_drop"]
    return [
        "",
        f"## {load.capitalize()}",
        "",
        f"All blocks counted, the error of {symbol} is {_percent(largest, 'error_mech_all')} (mechanical) and "
        f"{_percent(largest, 'error_mat_all')} (material), the distance {_percent(largest, 'distance_all')}, with data "
        f"of the tensegrity itself {_percent(own, 'distance_all')}.",
        "",
        *_images(runs, f"compare-{load}"),
        *_images(runs, f"sampling-{load}"),
        *_images(runs, f"data-size-{load}"),
        "",
        f"### What moves the error of {symbol}",
        "",
        "One thing changed at a time; a row with a tenth of the data is to be held against that of a tenth. What "
        f"lowers the mechanical error most is '{drops['error_mech']['change']}', by "
        f"{100 * drops['error_mech']['by']:.1f} points, the material error '{drops['error_mat']['change']}', by "
        f"{100 * drops['error_mat']['by']:.1f}. Distances are measured in the metric of the row. The boundary's part "
        "is the difference to all blocks.",
        "",
        "| cause | change | data | mechanical | material | all blocks, mechanical | material | distance | the same, "
        "tensegrity's own data |",
        "|---|---|---|---|---|---|---|---|---|",
        *(
            f"| {row['cause']} | {row['change']} | {row['data']} | {_percent(row, 'error_mech')} | "
            f"{_percent(row, 'error_mat')} | {_percent(row, 'error_mech_all')} | {_percent(row, 'error_mat_all')} | "
            f"{_percent(row, 'distance')} | {_percent(row, 'own_distance')} |"
            for row in changes
        ),
        "",
        *_images(runs, f"causes-{load}"),
        "",
        "### Run time against error",
        "",
        f"The {frontier['reference']} took {frontier['dns_seconds']:.3g} s. Compiled kernels, shortest of three, or of "
        "what 10 s hold. FE2 is that of the same model: what is left against it is the data's.",
        "",
        f"| method | data | error of {symbol}, mechanical | material | against FE2 | solve / s | sampling / s | |",
        "|---|---|---|---|---|---|---|---|",
        *(
            f"| {point['method']} | {point['data']} | {_percent(point, 'error_mech')} | "
            f"{_percent(point, 'error_mat')} | {_percent(point, 'error_fe2')} | {point['seconds_solve']:.3g} | "
            f"{point['seconds_sampling']:.3g} | {point['note']} |"
            for point in frontier["points"]
        ),
        "",
        *_images(runs, f"frontier-{load}"),
    ]


def _other_scenes(runs: Path) -> list[str]:
    """What default options err by on other scenes, if that was measured into the folder ``accuracy`` of the report."""
    command = "`tsgdd bench accuracy --no-parts --out accuracy`"
    text = [
        "",
        "## Other scenes",
        "",
        "All of this is one sheet of one prestress, in the paper's model: trilinear elements and one tissue. Errors on "
        "other shapes, loads and prestresses differ, and so do those of default options, elements that bend and edges "
        "of their own.",
        "",
    ]
    if not (runs / "accuracy" / "summary.json").exists():
        return [*text, f"They were not measured here: {command} in this folder, then the report again."]
    measured = read_summary(runs / "accuracy", "bench accuracy")
    kinematics, version = measured["parameters"]["kinematics"], measured["versions"]["tsgdd"]
    cases: dict[str, dict[str, str]] = {}
    for row in measured["rows"]:
        cases.setdefault(f"{row['case']} | {row['symbol']}", {})[row["zone"]] = _percent(row, "error")
    return [
        *text,
        f"Default options, {kinematics} strain, tsgdd {version} ({command}):",
        "",
        "| scene | error of | inner blocks | all blocks |",
        "|---|---|---|---|",
        *(f"| {case} | {zone['inner']} | {zone['all']} |" for case, zone in cases.items()),
        "",
        *_images(runs, "accuracy"),
    ]


def _percent(values: Mapping[str, Any], name: str) -> str:
    return "-" if values[name] is None else f"{100 * values[name]:.1f} %"


def _images(runs: Path, stage: str) -> list[str]:
    """Every figure of a stage, as Markdown."""
    return [f"![{stage} {file.stem}]({stage}/{file.name})" for file in sorted((runs / stage).glob("[!.]*.png"))]
