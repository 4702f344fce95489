"""Scores on the ground by `score`: places, identities and the claimed uncertainty, against worked figures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bayesnet_track.cli.main import main

HEADER = "frame,time_s,target,status,x_m,y_m,x_m_sd,y_m_sd,xy_corr"


def write(path: Path, header: str, rows: list[str]) -> Path:
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def scored(tracks: Path, truth: Path, capsys: pytest.CaptureFixture[str], *more: str) -> dict[str, float]:
    assert main(["score", str(tracks), "--truth", str(truth), "--json", *more]) == 0
    figures: dict[str, float] = json.loads(capsys.readouterr().out)
    return figures


def test_places_and_identities_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = write(
        tmp_path / "t.csv",
        "t,id,x,y",
        [f"{0.5 * k},{name},{k},{y}" for k in range(4) for name, y in (("a", 0), ("b", 9))],
    )
    places = [
        (0, 1, 0.0, 0.3), (0, 2, 0.0, 9.0), (1, 1, 1.0, 0.3), (1, 2, 1.8, 9.0),
        (2, 2, 2.0, 0.0), (2, 1, 2.0, 9.0), (3, 5, 3.0, 20.0), (3, 2, 3.0, 0.0),
    ]  # fmt: skip
    rows = [f"{k},{0.5 * k + 0.1},{name},tracked,{x},{y},0.2,0.2,0" for k, name, x, y in places]
    rows += ["3,1.6,1,lost,3,9,0.2,0.2,0"]
    figures = scored(write(tmp_path / "k.csv", HEADER, rows), truth, capsys)
    assert (figures["instants"], figures["true_ids"], figures["track_ids"]) == (4, 2, 3)
    assert (figures["fp"], figures["fn"], figures["idsw"]) == (1, 1, 2)
    assert figures["mota"] == pytest.approx(1 - 4 / 8)
    assert figures["idf1"] == pytest.approx(2 * 4 / 16)
    assert figures["moda"] == pytest.approx(1 - (2 + 2) / 8)
    assert figures["modp"] == pytest.approx((0.4 + 1 + 0.4 + 1 + 1 + 1) / 6)
    assert figures["error_m"] == pytest.approx((0.3 + 0.3 + 0.8) / 7)
    expected = np.sqrt((0.09 + 0.09 + 0.64 + 0.5 + 0.5) / 4)
    assert figures["gospa_m"] == pytest.approx(expected)
    wider = scored(tmp_path / "k.csv", truth, capsys, "--cutoff", "2")
    assert wider["gospa_m"] == pytest.approx(np.sqrt((0.09 + 0.09 + 0.64 + 2 + 2) / 4))


@pytest.mark.parametrize(
    ("claimed", "verdict"), [(1.0, "calibrated"), (0.5, "overconfident"), (2.0, "modest")]
)
def test_the_claimed_uncertainty_is_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], claimed: float, verdict: str
) -> None:
    rng, count = np.random.default_rng(5), 800
    covariance = np.array([[0.04, 0.018], [0.018, 0.0225]])
    errors = rng.multivariate_normal([0, 0], covariance, count)
    truth = write(
        tmp_path / "t.csv", "t,id,x,y", [f"{k},{n},{k},{10 * n}" for k in range(count // 2) for n in (0, 1)]
    )
    rows = [
        f"{k},{k},{n},tracked,{k + errors[2 * k + n, 0]},{10 * n + errors[2 * k + n, 1]},"
        f"{0.2 * claimed},{0.15 * claimed},0.6"
        for k in range(count // 2)
        for n in (0, 1)
    ]
    figures = scored(write(tmp_path / "k.csv", HEADER, rows), truth, capsys)
    assert figures["mota"] > 0.99
    inside = figures["anees_low"] < figures["anees"] < figures["anees_high"]
    assert inside == (verdict == "calibrated")
    assert figures["anees"] == pytest.approx(1 / claimed**2, rel=0.12)
    expected = 1 - np.exp(-(claimed**2) * 4.605 / 2)
    assert figures["coverage"] == pytest.approx(expected, abs=0.04)
    crps = {1.0: 0.099, 0.5: 0.107, 2.0: 0.117}[
        claimed
    ]  # minimal for the true spread; (0.2 + 0.15) / 2 / sqrt(pi)
    assert figures["crps_m"] == pytest.approx(crps, rel=0.06)


def test_correlated_errors_widen_the_bounds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    steps = rng.normal(0, 0.1, (40, 2)).repeat(20, axis=0)
    truth = write(tmp_path / "t.csv", "t,id,x,y", [f"{k},1,{k},0" for k in range(800)])
    rows = [f"{k},{k},1,tracked,{k + x},{y},0.1,0.1,0" for k, (x, y) in enumerate(steps)]
    figures = scored(write(tmp_path / "k.csv", HEADER, rows), truth, capsys)
    assert figures["anees_high"] - figures["anees_low"] > 0.4  # 0.28 if all 800 were independent: 0.14


@pytest.mark.parametrize(
    ("truth", "tracks", "message"),
    [
        ("t,id,x,y\n0,a,1,one\n", None, "t.csv:2: t, id, x, y must be numbers, id a name"),
        ("t,id,x,y\n0,a,1,1\n0,a,2,2\n", None, "t.csv:3: 'a' is at t = 0 already, in line 2"),
        ("t,id,x,y\n0,a,1,nan\n", None, "t.csv:2: a number is not finite"),
        ("t,id,x,y\n", None, "the ground truth has no place to score"),
        ("t,id,x,y\n900,a,1,1\n901,a,1,1\n", None, "no time in common"),
        ("t,id,x,y\n0,a,1,1\n", "frame,time_s,target,x,y\n0,0,1,3,4\n", "k.csv:1: no column x_m, y_m"),
    ],
)
def test_wrong_files_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: str, tracks: str | None, message: str
) -> None:
    (tmp_path / "t.csv").write_text(truth)
    (tmp_path / "k.csv").write_text(tracks or HEADER + "\n0,0.0,1,tracked,1,1,0.1,0.1,0\n")
    assert main(["score", f"{tmp_path}/k.csv", "--truth", f"{tmp_path}/t.csv"]) == 2
    assert message in capsys.readouterr().err


def test_options_for_boxes_are_refused_and_columns_that_are_not_used_are_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = write(tmp_path / "t.csv", "t,id,x,y,z", ["0,a,1,1,5"])
    tracks = write(tmp_path / "k.csv", HEADER, ["0,0.0,1,tracked,1,1,,,"])
    assert main(["score", str(tracks), "--truth", str(truth), "--class", "car"]) == 2
    assert "--class" in capsys.readouterr().err
    write(tracks, HEADER.rsplit(",", 3)[0], ["0,0.0,1,tracked,1,1"])
    assert main(["score", str(tracks), "--truth", str(truth)]) == 0
    captured = capsys.readouterr()
    assert "not used: the columns z" in captured.err
    line = next(line for line in captured.out.splitlines() if line.startswith("anees "))
    assert line.split()[1] == "-"
