"""Scores of a run against ground truth: accuracy, calibration, speed."""

from bayesnet_track.evaluate.mot import MotScore, score_mot, score_mot_files
from bayesnet_track.evaluate.runs import score_run
from bayesnet_track.evaluate.scores import Score, as_table, score
from bayesnet_track.evaluate.truth import read_truth
from bayesnet_track.sources.scene_source import format_truth

__all__ = [
    "MotScore",
    "Score",
    "as_table",
    "format_truth",
    "read_truth",
    "score",
    "score_mot",
    "score_mot_files",
    "score_run",
]
