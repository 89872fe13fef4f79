"""The study of edges: rows of a clamped sheet, and its figure."""

from __future__ import annotations

import numpy as np

from workflows.studies.edges import row_means


def test_rows_with_edges_are_those_of_the_full_tensegrity(tsgdd, read_summary, is_png, tmp_path):
    out = tmp_path / "out"
    run = ("study", "edges", "--blocks", 8, 5, "--bar-force", 2e-9, "--strain", 0.03, "--out", out)
    done = tsgdd(*run)
    assert done.code == 0, done.err
    assert is_png(out / "rows.png")
    summary = read_summary(out)
    dns, without, within = (
        np.array(summary[f"rows {name}"]) for name in ("every bar and tendon", "without edges", "with edges")
    )
    scale = np.abs(dns).max()
    assert np.abs(without - dns)[[0, -1]].max() > 0.3 * scale  # P_xx, P_zz of the clamped rows
    assert np.abs(within - dns).max() < 0.05 * scale
    assert summary["error_p with edges"]["l2_all"] < 0.5 * summary["error_p without edges"]["l2_all"]
    again = tsgdd(*run, "--no-plots")
    assert again.out.count("there already") == 3


def test_the_mean_of_rows():
    i, j = np.meshgrid(np.arange(6), np.arange(3), indexing="ij")
    midpoint = np.stack([i.ravel() + 0.5, j.ravel() + 0.5, 0.5 + 0 * i.ravel()], axis=1) * 2.0
    stress = np.zeros((18, 6))
    stress[:, 1], stress[:, 2] = j.ravel(), (i.ravel() - 2.5) ** 2
    np.testing.assert_allclose(row_means(midpoint, stress, 2.0), [[0, 0, 0.25], [0, 1, 0.25], [0, 2, 0.25]])


def test_a_sheet_too_small_for_rows(tsgdd, tmp_path):
    done = tsgdd("study", "edges", "--blocks", 4, 8, "--out", tmp_path / "out")
    assert done.code == 2
    assert "blocks: expected at least 5 along x and y, got 4 8" in done.err
