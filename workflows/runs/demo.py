"""tsgdd demo: the whole chain on a stretched monolayer, and one figure that shows it."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tsg_micro.cells.tissue import Tissue
from tsg_micro.data.errors import InputError
from tsg_micro.data.figure_style import save_figure
from tsg_micro.data.files import output_folder
from workflows.runs.dns import dns
from workflows.runs.sample import sample
from workflows.store.record import write_summary

__all__ = ["demo"]


def demo(
    out: Path,
    *,
    blocks: tuple[int, int] = (30, 15),
    paths: int = 400,
    steps: int = 10,
    strain: float = 0.05,
    tissue: Tissue = Tissue(),
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """RVE sampling, full tensegrity, data-driven solve and comparison of a sheet under stretch.

    Raises:
        InputError: an argument is not valid.
        ConvergenceError: a solver did not converge.
    """
    from workflows.runs.compare import compare
    from workflows.runs.demo_figure import plot_demo
    from workflows.runs.scene import Scene
    from workflows.runs.solve import solve

    if min(blocks) < 1 or paths < 1:
        raise InputError(f"blocks, paths: expected at least 1, got {blocks[0]} {blocks[1]} and {paths}")
    out = output_folder(out)
    begin = time.perf_counter()
    say(f"1/4  material data: {paths} loading paths of {steps} points through one periodic block")
    data = out / "data.h5"
    sampled = sample(data, load="stretch", paths=paths, steps=steps, tissue=tissue)
    say(f"     {sampled['points']} points in {sampled['seconds']:.0f} s, {sampled['failed_paths']} paths cut")
    say(f"2/4  full tensegrity: {blocks[0]} x {blocks[1]} blocks, every bar and tendon, {strain:.0%} stretch")
    full = dns(
        out / "dns",
        blocks=blocks,
        load="stretch",
        strain=strain,
        tissue=tissue,
        say=lambda text: say(f"     {text}"),
    )
    say("3/4  data-driven finite elements, one element a block")
    solved = solve(
        out / "dd",
        data=data,
        scene=Scene("stretch", strain, elements=(*blocks, 1), graded=False),
        say=lambda text: say(f"     {text}"),
    )
    say("4/4  comparison")
    compared = compare(out / "compare", dd=out / "dd", dns=out / "dns")
    save_figure(plot_demo(out, strain=strain, errors=compared), out / "demo.png")
    seconds = time.perf_counter() - begin
    mech, mat = compared["error_p_mech"]["l2"], compared["error_p_mat"]["l2"]
    say(
        f"pressure, outer blocks left out: mechanical solution {mech:.1%}, material solution {mat:.1%} off the full "
        f"tensegrity; normalised distance {solved['normalised_distance']:.1%}"
    )
    say(
        f"full tensegrity {full['seconds']:.1f} s, data-driven solve {solved['seconds']:.2f} s on data that took "
        f"{sampled['seconds']:.1f} s once; {seconds:.0f} s in all. Figure: {out / 'demo.png'}"
    )
    return write_summary(
        out,
        command="demo",
        parameters={"blocks": blocks, "paths": paths, "steps": steps, "strain": strain, "bar_force": tissue.bar_force},
        figures={
            **{name: (compared[name], "1") for name in ("error_p_mech", "error_p_mat", "error_q_mech", "error_q_mat")},
            "normalised_distance": (solved["normalised_distance"], "1"),
            "sample_seconds": (sampled["seconds"], "s"),
            "dns_seconds": (full["seconds"], "s"),
            "solve_seconds": (solved["seconds"], "s"),
            "seconds": (seconds, "s"),
        },
    )
