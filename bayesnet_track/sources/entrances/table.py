"""The table of entrances: all that comes from outside, which functions read it, and what is said of it.

A test finds every function that reads a file: one that is in no row here, nor in `own_files`, fails it. The
page `docs/entrances.md` is made from this table.
"""

from __future__ import annotations

from bayesnet_track.sources.entrances.entrance import Entrance
from bayesnet_track.sources.entrances.table_of_frames import FRAMES

BOXES = (
    Entrance(
        "start boxes",
        "`--init`, the page of `--view`, `batch --list`; `Tracker.init`, `track`, `Start`",
        (
            "engine.starts: check_given say_blank",
            "cli.commands.start_boxes: parse_start",
            "runtime.live_view.controls: _start",
        ),
        "a box mostly outside of the frame; a first frame of one value",
        "no four finite numbers, no area, no part in the frame, more than ten times its size; no class "
        "where the graph has several",
        "left, top, width, height, or the corners: it is said where only corners fit the frame",
    ),
    Entrance(
        "start boxes from a file",
        "`--init-from FILE`",
        ("cli.commands.start_boxes: read_start",),
        "all that is said of ground truth and of a start box",
        "no box for the first frame that is read; boxes of several targets",
        "as of ground truth of one target",
    ),
    Entrance(
        "detections in a file",
        "`--detections FILE`; `track(..., detections=)`",
        (
            "sources.detection_files: file_detector",
            "runtime.unused_detections: explain_unused",
            "sources.mot_lines: parse_mot",
            "sources.entrances.text_lines: read_text split_words",
        ),
        "boxes without an area, and confidences that are not finite, with their lines; detections of "
        "frames that are not read, outside of the frame, of other labels, or below the thresholds of the "
        "graph; long times without any; how confidences beyond 0 to 1 are mapped",
        "a line that is neither MOT nor JSON Lines; polygons; frames that do not count from 1 (MOT) or 0 "
        "(JSON); coordinates from 0 to 1; files of other formats, with what takes them",
        "8 columns: MOT, or polygons; columns of corners and of sizes, or of two identities; a header or the "
        "numbers decide, else it is refused",
    ),
    Entrance(
        "detections in Python",
        "`DetectionsTracker.update`",
        ("runtime.updates.given_detections: read_given",),
        "boxes without an area, or outside of the frame, with their rows; their id is -1",
        "no `xyxy`, another shape than (n, 4), confidences beyond 0 to 1, no class names where the graph "
        "needs them, not one value for each box",
        "corners, or left, top, width, height: `xyxy` says corners, and what has no area then is left out",
    ),
    Entrance(
        "ground truth of one target",
        "`score --truth`, `fit`, `learn-shape`, `batch`, `compare`",
        ("evaluate.truth: read_truth is_mot",),
        "boxes with confidence 0; frames of the run without a box, and boxes of frames that it does not have",
        "lines that are no boxes, boxes of several targets, two boxes in a frame, decimal commas between "
        "commas",
        "x,y,w,h, corners, or frame,x,y,w,h: numbers that fit two of them are refused; a header line decides",
    ),
    Entrance(
        "ground truth of many targets",
        "`score --truth`, `fit --motion`, `run --seeds --truth`",
        ("evaluate.mot_pairs: read_mot_truth read_mot_tracks",),
        "boxes without an area or with confidence 0; frames that the run does not have, and boxes of another "
        "size of frame",
        "an identity twice in a frame, no true box, frames from 0",
        "as of detections in a file",
    ),
    Entrance(
        "imported annotations",
        "`annotate --import`: COCO, CVAT, Label Studio, YOLO, MOT, or a zip of one",
        (
            "runtime.annotation.formats.formats: read_annotations",
            "runtime.annotation.formats.coco: read_coco",
            "runtime.annotation.formats.cvat_reading: read_cvat",
            "runtime.annotation.formats.label_studio: read_label_studio",
            "runtime.annotation.formats.mot: read_mot _classes",
            "runtime.annotation.formats.yolo: read_yolo _frames _about _about_of_yaml",
            "runtime.annotation.formats.texts: read_json read_xml",
            "runtime.annotation.formats.archives: _unpack text_of",
        ),
        "boxes of frames that the video does not have, outside of the frame, without an area or an "
        "identity, between key frames, of confidence 0 (MOT), or there twice; targets without any; shapes "
        "that become their upright box, and those that are no box",
        "another size or number of frames, two boxes of an identity in a frame, no identity at all, "
        "several videos in one file, a file in which no box can be used",
        "frames counted from 0 or from 1; columns that are a polygon, or a box with an identity, or with a "
        "confidence before or behind it: refused with both",
    ),
)

FILES = (
    Entrance(
        "readings of sensors",
        "`file` of a `readings` agent in the graph",
        ("cues.readings: read_readings _cells _text",),
        "readings of frames that are not read, numbers that are not finite, rows that come again, frames "
        "after the last reading",
        "a missing column, more cells than columns, two values for one frame, a frame that is no whole "
        "number",
        "a decimal comma, or digits in groups: refused in a file with commas",
    ),
    Entrance(
        "masks and templates",
        "`mask` of a factor, `picture` of `color_backprojection`, `learn-shape --masks`",
        (
            "observation.masks: read_mask",
            "vision.detectors.color_backprojection: _make",
        ),
        "masks with too little of the silhouette on edges (`learn-shape`)",
        "several images in a file, an alpha channel or 16 bits in a mask, another size than the frames",
        "none: a mask is what is not black",
    ),
    Entrance(
        "shape models",
        "`model` of a `shape` agent; made by `learn-shape`",
        ("vision.shape: load_model",),
        "nothing: all of it is used",
        "another version, arrays of other shapes, modes that are not orthonormal, values that are not finite",
        "none: the file names its format",
    ),
    Entrance(
        "networks",
        "`model`, `backbone` and `head` of agents and detectors: ONNX",
        (
            "vision.networks: read_onnx",
            "vision.networks: check_apart",
            "vision.siamese_networks: run_by_opencv run_by_onnxruntime",
            "vision.siamese_networks: try_networks _open",
        ),
        "nothing: all of it is used",
        "a file on which the runtime fails, crashes or hangs in a process of its own; other inputs or "
        "outputs than the layout has",
        "the halves of a Siamese network in each other's place: said where they run so",
    ),
    Entrance(
        "graphs",
        "every command with a GRAPH; `load_graph`, `Tracker`, `track`",
        (
            "graph.text.load: bytes_of",
            "graph.text.explain: _lines",
            "cli.fitting.fit: graph_text",
        ),
        "nothing: every key is used",
        "each unknown key or value, with its line and column and the nearest name",
        "a name of an installed graph, or a file of that name: `./general` is the file",
    ),
    Entrance(
        "cue files",
        "`--cue-file FILE`; `cues=`",
        ("observation.cue_files: load_cue_file",),
        "nothing: the code is run",
        "a file without a `CUE`, or whose code fails",
        "none",
    ),
    Entrance(
        "lists of videos",
        "`batch --list FILE`, `batch --source PATTERN`",
        ("cli.batch.lists: read_list _csv_rows videos_of",),
        "nothing: every row is a video; names that begin with a dot are none of a pattern",
        "an unknown column, a row without a source, a pattern that matches nothing",
        "CSV, or JSON Lines: a first line with a brace is JSON",
    ),
    Entrance(
        "stored trackers",
        "`Tracker.load`, `DetectionsTracker.load`, `pickle`",
        ("runtime.updates.storable: Storable.load",),
        "nothing: all of it is used",
        "a file of another version, of another graph or kind of tracker, or one that is damaged",
        "none: the file names what it holds",
    ),
    Entrance(
        "inputs of an earlier run",
        "`--inputs FILE`; `track(..., inputs=)`",
        ("runtime.inputs: replay_inputs",),
        "switches of targets and agents that the run does not have, in its journal",
        "lines that are no inputs; a budget or a view beside it",
        "none",
    ),
)

ENTRANCES = (*FRAMES, *BOXES, *FILES)
