"""What `fit --what sds` and `fit --what policy` give on videos that they were not fitted to.

    python benchmarks/fitted.py policy DATA_FOLDER --graph FORMER.yaml --max-frames 60 [--coin] [--clips 4]
    python benchmarks/fitted.py policy --scenes two_squares_random --graph two_squares
    python benchmarks/fitted.py sds DATA_FOLDER --graph color_fusion --max-frames 60 [--coin] [--clips 4]

DATA_FOLDER holds NAME/img/*.jpg and NAME/groundtruth.txt, as in benchmarks/sequences.py. Its sequences are
split into two halves, A and B; of a scene, half A are the seeds from 300 on, half B the next ones, as many
each as `--scene-seeds` says. Fitted on A and judged on B, then the other way round. The fit uses seed 0, the
report others. Intervals are of a paired bootstrap over sequences, whose figures are means over seeds. With
--coin the halves are those of real_video_coin. With --clips each sequence is tracked from several frames on.
With --only-a nothing is fitted to B.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from calibration import frames_of
from measuring import environment, on_one_thread, table
from numpy.typing import NDArray
from real_video_coin import HALVES
from sequences import Sequence as Video
from sequences import find_sequences, track

from bayesnet_track import Tracker
from bayesnet_track.cli.fitting import tracking as fit_tracking
from bayesnet_track.cli.fitting import videos as fit_videos
from bayesnet_track.cli.fitting.fit import graph_text
from bayesnet_track.evaluate.calibration_data import CalibrationData, calibration_data, with_features
from bayesnet_track.evaluate.cue_sds import fit_sds, followed, residuals_of, shares_inside
from bayesnet_track.evaluate.fitting import Fitted, fit, mass_below
from bayesnet_track.evaluate.scores import success_auc
from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.observation.cue import installed_cues
from bayesnet_track.sources.scenes import make_scene

Floats = NDArray[np.float64]

STRATA = (
    "Basketball Car1 Couple Crossing DragonBaby Girl Human7 Jogging1 MotorRolling Skiing",
    "otb_Biker otb_BlurCar2 otb_Deer otb_Lemming otb_Tiger1",
    "uav_car10 uav_car16_2 uav_group1_1 uav_group2_2 uav_truck4_1 uav_wakeboard10 uav_wakeboard3",
    "davis_car-shadow vot14_car vot15_bag",
)
"""The 25 sequences, by where they are from; each half has half of every line."""

RESAMPLES = 10_000


def halves(seed: int = 13) -> tuple[list[str], list[str]]:
    """Every other name of each stratum in a drawn order; strata take turns at which half begins."""
    rng, found = np.random.default_rng(seed), ([], [])
    for number, line in enumerate(STRATA):
        names = line.split()
        for place, k in enumerate(rng.permutation(len(names))):
            found[(number + place) % 2].append(names[k])
    return found


def clips(video: Video, most: int, length: int) -> list[Video]:
    """Up to `most` pieces of `length` frames that begin at equal distances, each a video of its own."""
    frames = len(video.files)
    count = max(1, min(most, frames // length))
    firsts = [round(k * (frames - length) / (count - 1)) for k in range(count)] if count > 1 else [0]
    return [
        Video(f"{video.name}@{at}", video.files[at : at + length], video.truth[at : at + length])
        for at in firsts
    ]


def interval(differences: Floats) -> str:
    """Mean with the 95 % interval of a bootstrap over sequences."""
    rng = np.random.default_rng(0)
    means = differences[rng.integers(len(differences), size=(RESAMPLES, len(differences)))].mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return f"{differences.mean():+.4f} [{low:+.4f}, {high:+.4f}]"


def write_scenes(name: str, seeds: Sequence[int], folder: Path) -> list[Video]:
    """Scenes as folders of pictures with ground truth."""
    for seed in seeds:
        scene, place = make_scene(name, seed), folder / f"{name}_{seed}"
        (place / "img").mkdir(parents=True)
        for k, image in enumerate(scene.frames):
            cv2.imwrite(str(place / "img" / f"{k:04d}.png"), np.asarray(image))
        np.savetxt(place / "groundtruth.txt", scene.truth, delimiter=",")
    return find_sequences(folder, [f"{name}_{seed}" for seed in seeds], None)


def as_given(videos: Sequence[Video], folder: Path) -> list[fit_videos.Video]:
    """The same videos as `fit` has them, each a folder of links to its frames."""
    for one in videos:
        (folder / one.name).mkdir()
        for k, file in enumerate(one.files):
            (folder / one.name / f"{k:05d}{file.suffix}").symlink_to(file.absolute())
    return [fit_videos.Video(one.name, str(folder / one.name), one.truth) for one in videos]


def judge_policy(graph: str, learnt: Sequence[Video], unseen: Sequence[Video], o: argparse.Namespace) -> None:
    """Choose on `learnt`, compare with the graph's own rules on `unseen`, run by run in turn."""
    text = graph_text(graph)
    checked = fit_tracking.check_text(text, graph)
    with tempfile.TemporaryDirectory() as links:
        given = as_given(learnt, Path(links))
        chosen = fit_tracking.fit_policy(text, checked, given, o.max_frames, 1)
    print("\n".join(line.strip() for line in chosen.splitlines() if line not in text.splitlines()))
    specs = {"own": checked.spec, "fitted": fit_tracking.check_text(chosen, graph).spec}
    Tracker(specs["own"])
    # Name of the rules and of the sequence -> AUC, CPU ms and agents of each run.
    found: dict[tuple[str, str], list[tuple[float, ...]]] = {}
    for video in unseen:
        for seed in range(o.first_seed, o.first_seed + o.seeds):
            for name in specs if seed % 2 else reversed(specs):
                run = track(Tracker(specs[name], seed), video)
                score = run.score(video.truth)
                # The first frames start up, and touch memory for the first time.
                row = (float(score.auc), 1e3 * float(np.mean(run.cpu_seconds[3:])), score.mean_active)
                found.setdefault((name, video.name.partition("@")[0]), []).append(row)
    means = {
        name: np.array([np.mean(rows, axis=0) for (rules, _), rows in found.items() if rules == name])
        for name in specs
    }
    rows = [[name, *(f"{one:.4f}" for one in means[name].mean(axis=0))] for name in specs]
    print("\n" + table(["rules", "AUC", "CPU ms / frame", "agents"], rows))
    auc, _, agents = (means["fitted"] - means["own"]).T
    time = np.log(means["fitted"][:, 1]) - np.log(means["own"][:, 1])
    print(f"\nAUC, fitted less own: {interval(auc)}; log of CPU time: {interval(time)}")
    print(f"agents: {interval(agents)}\n")


def watched(graph: CheckedGraph, videos: Sequence[Video], seeds: Sequence[int]) -> list[CalibrationData]:
    """Runs of a graph over videos."""
    measuring = with_features(graph)
    return [
        calibration_data(measuring, video.name, frames_of(video.images()), video.truth, seed)
        for video in videos
        for seed in seeds
    ]


def per_video(data: Sequence[CalibrationData], what: Callable[[CalibrationData], float]) -> Floats:
    """A figure of each video, mean over seeds and clips."""
    found: dict[str, list[float]] = {}
    for one in data:
        found.setdefault(one.video.partition("@")[0], []).append(what(one))
    return np.array([np.mean(values) for values in found.values()])


def held(fitted: Fitted, share: float) -> Callable[[CalibrationData], float]:
    """Share of true centres within the central region, mean of x and y."""
    return lambda one: float((np.abs(mass_below(fitted, one) - 0.5) <= share / 2).mean())


def judge_sds(graph: str, learnt: Sequence[Video], unseen: Sequence[Video], o: argparse.Namespace) -> None:
    """Fit sds, score and localization error on `learnt`; residuals, regions and AUC on `unseen`."""
    text = graph_text(graph)
    own = fit_tracking.check_text(text, graph)
    sds = fit_sds([residuals_of(own, frames_of(one.images()), one.truth) for one in learnt])
    there = [residuals_of(own, frames_of(one.images()), one.truth) for one in unseen]
    plate, declared = next(iter(own.targets.values())), installed_cues()
    rows = []
    for (agent, name), one in sds.items():
        cue = plate.agent(agent).agent
        before = float(cue.parameters.get(name, declared[cue.plugin].parameters().model_dump()[name]))
        frames = [video[agent, name] for video in there if video.get((agent, name))]
        values = [np.concatenate(found) for found in frames]
        following = [followed(found, one.value) for found in frames]
        rows.append([agent, name])
        for value, held_by in ((one.value, values), (one.value, following), (before, values)):
            rows[-1] += [f"{value:.3g}", *(f"{share:.3f}" for share in shares_inside(held_by, value))]
    inside = ["in 50 %", "in 90 %"]
    head = ["agent", "sd", "fitted", *inside, "following", *inside, "before", *inside]
    print(table(head, rows) + "\n")

    new = fit_tracking.check_text(fit_tracking.write_sds(text, own, sds, len(learnt)), graph)
    rows, iou = [], {}
    for name, one in (("before", own), ("fitted", new)):
        fitted = fit(watched(one, learnt, [0]), ("log_ud_box", "log_fit"))
        runs = watched(one, unseen, range(o.first_seed, o.first_seed + o.seeds))
        iou[name] = per_video(runs, lambda run: success_auc(run.iou))
        shares = [interval(per_video(runs, held(fitted, share))) for share in (0.5, 0.9)]
        rows.append([name, *(one.removeprefix("+") for one in shares), f"{iou[name].mean():.4f}"])
    print(table(["sds", "in 50 % region", "in 90 % region", "AUC, every box"], rows))
    print(f"\nAUC, fitted less before: {interval(iou['fitted'] - iou['before'])}\n")


def main() -> None:
    """Fit on A, judge on B; then the other way round."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["sds", "policy"])
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--scenes", help="name of a scene, instead of DATA_FOLDER")
    parser.add_argument("--scene-seeds", type=int, default=6, help="scenes in each half")
    parser.add_argument("--graph", default="general")
    parser.add_argument("--first-seed", type=int, default=10, help="first seed of the report")
    parser.add_argument("--seeds", type=int, default=2, help="seeds of the report")
    parser.add_argument("--max-frames", type=int)
    parser.add_argument("--coin", action="store_true", help="the halves of real_video_coin")
    parser.add_argument("--clips", type=int, help="of --max-frames each, of every sequence")
    parser.add_argument(
        "--only-a", action="store_true", help="judge on B what was fitted to A, not vice versa"
    )
    options = parser.parse_args()
    if (options.data is None) == (options.scenes is None):
        parser.error("give either DATA_FOLDER or --scenes")
    if options.clips and not (options.data and options.max_frames):
        parser.error("--clips needs DATA_FOLDER and --max-frames")
    on_one_thread()
    print(environment(), flush=True)
    with tempfile.TemporaryDirectory() as made:
        if options.scenes is None:
            names = [list(half) for half in HALVES.values()] if options.coin else halves()
            end = None if options.clips else options.max_frames
            sides = [find_sequences(options.data, half, end) for half in names]
            if options.clips:
                sides = [
                    [clip for one in side for clip in clips(one, options.clips, options.max_frames)]
                    for side in sides
                ]
        else:
            sides = [
                write_scenes(options.scenes, range(first, first + options.scene_seeds), Path(made))
                for first in (300, 300 + options.scene_seeds)
            ]
        ways = [(*sides, "A, judged on B"), (*sides[::-1], "B, judged on A")]
        for learnt, unseen, way in ways[: 1 if options.only_a else 2]:
            print(f"\nfitted on {way}: {len(learnt)} and {len(unseen)} videos", flush=True)
            print(f"fitted on {', '.join(one.name for one in learnt)}\n", flush=True)
            judge = judge_policy if options.what == "policy" else judge_sds
            judge(options.graph, learnt, unseen, options)


if __name__ == "__main__":
    main()
