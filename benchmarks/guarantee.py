"""The guarantee and the alarm on real video, each sequence judged by what the others calibrate.

    python benchmarks/guarantee.py DATA_FOLDER [--graph general] [--seeds 2] [--share 0.05] [--max-frames N]
                                   [--fit] [--features log_fit] [--frames 3] [--data FILE]
                                   [--off-target 0.1] [--empirical] [--levels-of "chosen on"]

The graph runs over every sequence; then, in turn, one is left out, and the others calibrate the levels of
`guarantee` and the total of `alarm` (docs/calibration.md). Printed are the observed mean share of frames
called tracking while IoU is at most `--off-target` (0.5), the share of frames on target that are called
tracking, both also with each run judged when it is over, false alarms, and delays of alarms after the first
frame with an IoU below 0.1. With `--fit` the score of each sequence is fitted to the others (cross-fitted:
near to what the guarantee asks for, and not the same), by `--features`. With `--levels-of` a stratum
calibrates the levels of all others. With `--empirical` the level is the one at which the calibrating
sequences themselves are wrong in at most that share, which promises nothing of a new one. Score and settings
of `general` were chosen on the 25, which voids the guarantee formally. Runs are kept in `--data` (pickle)
and read from there.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np
from measuring import Image, environment, on_one_thread, table
from sequences import STRATA, find_sequences

from bayesnet_track.engine.scoring.outcome import e_value, level_afterwards, next_cusum
from bayesnet_track.evaluate.calibration import OFF_TARGET, fit_calibration, score_of
from bayesnet_track.evaluate.calibration_data import (
    CalibrationData,
    by_video,
    calibration_data,
    with_features,
)
from bayesnet_track.evaluate.guarantees import (
    CalibrationRun,
    control_afterwards,
    control_risk,
    lowest_level,
    runs_of,
    share_called,
    share_wrong,
    total_evidence,
)
from bayesnet_track.graph.settings.scores import Alarm
from bayesnet_track.graph.text.load import load_graph
from bayesnet_track.observation.planes import Frame

Data = Mapping[str, Sequence[CalibrationData]]


def frames_of(images: Iterable[Image]) -> Iterator[Frame]:
    """Frames at a regular rate."""
    for index, image in enumerate(images):
        yield Frame(index, float(index), image, True, float(index))


def run_all(options: argparse.Namespace) -> list[CalibrationData]:
    """Every sequence with every seed."""
    graph = with_features(load_graph(options.graph))
    found = []
    for one in find_sequences(options.data_folder, [], options.max_frames):
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            found.append(calibration_data(graph, one.name, frames_of(one.images()), one.truth, seed))
            print(f"{one.name}, seed {seed}: mean IoU {found[-1].iou.mean():.3f}", flush=True)
    return found


def cross_fitted(data: Sequence[CalibrationData], features: Sequence[str]) -> list[CalibrationData]:
    """The same runs, each with the score that is fitted to the other sequences."""
    found = []
    for video, own in by_video(data).items():
        logistic = fit_calibration([one for one in data if one.video != video], features).logistic
        for one in own:
            if len(one.all_scores) != one.frames:
                raise SystemExit(f"{video}: --fit needs a true box in every frame")
            found.append(replace(one, all_scores=score_of(logistic, one)))
    return found


def guarantee_rows(data: Sequence[CalibrationData], options: argparse.Namespace) -> list[list[str]]:
    """A row for each sequence that is judged, and the means: while it runs, and judged when it is over."""
    runs, off, share = runs_of(data, options.frames), options.off_target, options.share
    source = STRATA[options.levels_of] if options.levels_of else tuple(runs)
    rows, found, live, after = [], [], list[CalibrationRun](), list[CalibrationRun]()
    for video, own in runs.items():
        if options.levels_of and video in source:
            continue
        others = [one for name, one in runs.items() if name != video and name in source]
        if options.empirical:
            above = lowest_level(others, share, off)
            levels: Sequence[float] = (above,)
        else:
            above, levels = control_risk(others, share, off).above, control_afterwards(others, share, off)
        live += [called(run, above) for run in own]
        after += [called(run, level_afterwards(levels, run.means)) for run in own]
        of_video = [share_wrong([part], 0.5, off) for part in (live[-len(own) :], after[-len(own) :])]
        of_video += [share_called([part], 0.5) for part in (live[-len(own) :], after[-len(own) :])]
        found.append([of_video[k] for k in (0, 2, 1, 3)])
        rows.append([video, f"{above:.4f}", *(f"{value:.3f}" for value in found[-1])])
    means = ["mean of sequences", "", *(f"{value:.4f}" for value in np.nanmean(found, axis=0))]
    alike = [f"{value:.4f}" for part in (live, after) for value in frames_alike(part, off)]
    return [*rows, means, ["frames alike", "", *alike]]


def called(run: CalibrationRun, above: float) -> CalibrationRun:
    """The run with 1 where it is called tracking, and 0 elsewhere."""
    return CalibrationRun((run.means > above).astype(float), run.iou)


def frames_alike(runs: Sequence[CalibrationRun], off: float) -> tuple[float, float]:
    """Of all frames those called tracking at an IoU of at most `off`; of all good ones those called so."""
    said, iou = (np.concatenate([getattr(run, name) for run in runs]) for name in ("means", "iou"))
    return float((said * (iou <= off)).mean()), float(said[iou > 0.5].mean())


def alarm_rows(data: Sequence[CalibrationData], share: float) -> list[list[str]]:
    """A row for each run in which the target is lost or an alarm is raised."""
    videos, rows = by_video(data), []
    false, delays, lost = 0, [], 0
    for video, own in videos.items():
        others = [one for name, one in videos.items() if name != video]
        rule = Alarm(total=total_evidence(others, share), videos=len(others), share=share)
        for one in own:
            gone = np.flatnonzero(one.all_iou < OFF_TARGET)
            end = int(gone[0]) if len(gone) else None
            cusum, raised = 0.0, None
            for k, score in enumerate(one.all_scores):
                cusum = next_cusum(cusum, float(score))
                if e_value(cusum, rule) >= 1.0 / share:
                    raised = k
                    break
            is_false = raised is not None and (end is None or raised < end)
            false += is_false
            lost += end is not None and not is_false
            if raised is not None and end is not None and not is_false:
                delays.append(raised - end)
            if end is not None or raised is not None:
                count = int((one.all_iou[end:] < OFF_TARGET).sum()) if end is not None else 0
                what = "false" if is_false else "-" if raised is None or end is None else f"{raised - end}"
                rows.append([video, "-" if end is None else str(end + 1), str(count), what])
    of = f"{false} false in {len(data)} runs; {len(delays)} of {lost} losses noticed"
    return [*rows, ["all", "", of, f"median {median(delays):g}" if delays else "-"]]


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data_folder", type=Path)
    parser.add_argument("--graph", default="general")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--share", type=float, default=0.05)
    parser.add_argument("--off-target", type=float, default=0.5, help="IoU up to which a frame is wrong")
    parser.add_argument("--empirical", action="store_true", help="no allowance for a new sequence")
    parser.add_argument("--levels-of", choices=STRATA, help="what calibrates (default: the others)")
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--max-frames", type=int)
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--features", default="log_fit")
    parser.add_argument("--data", type=Path)
    options = parser.parse_args()
    on_one_thread()
    if options.data is not None and options.data.exists():
        data = pickle.loads(options.data.read_bytes())
    else:
        data = run_all(options)
        if options.data is not None:
            options.data.write_bytes(pickle.dumps(data))
    if options.fit:
        data = cross_fitted(data, options.features.split(","))
    print(environment() + "\n")
    head = ["judged", "above", f"tracking and IoU <= {options.off_target:g}", "of IoU > 0.5 called tracking"]
    head += [f"{name}, judged afterwards" for name in head[2:]]
    print(table(head, guarantee_rows(data, options)) + "\n")
    if options.empirical or options.levels_of:
        return
    head = ["left out", "first frame with IoU < 0.1", "such frames", "alarm after"]
    print(table(head, alarm_rows(data, options.share)))


if __name__ == "__main__":
    main()
