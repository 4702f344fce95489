"""Table of entrances: all that comes from outside, the functions that read it, and the texts about it.

A test finds every function that reads a file: one that is in no row here, nor reads what the program wrote
itself, fails it. The page `docs/entrances.md` is made from this table.
"""

from __future__ import annotations

from dataclasses import dataclass

PACKAGE = "bayesnet_track"


@dataclass(frozen=True)
class Entrance:
    """One kind of data from outside.

    Attributes:
        name: what it is.
        reached: the commands, options and calls by which it is given.
        reads: the functions that read it, as "module: names", below the package.
        says: what a notice says, in words, where something of it is not used.
        refuses: what is refused.
        confused: which two readings could be confused, and what decides.
    """

    name: str
    reached: str
    reads: tuple[str, ...]
    says: str
    refuses: str
    confused: str

    @property
    def readers(self) -> tuple[str, ...]:
        """The functions as dotted paths."""
        parts = (text.split(": ") for text in self.reads)
        return tuple(f"{PACKAGE}.{module}.{name}" for module, names in parts for name in names.split())


FRAMES = (
    Entrance(
        "images",
        "`--source FOLDER`, a glob or a file, `annotate`, `batch`, `fit`, `calibrate`; `track`, "
        "`open_source`",
        (
            "sources.images: ImageReader read_image say_orientation",
            "sources.images: check_names",
            "sources.entrances.levels: to_bgr",
            "observation.image_files: read_checked decode",
        ),
        "levels that are lost at 8 bits, with the range that keeps them; a range that most values miss; "
        "formats that are not read beside images; names unlike the others; two sequences by one pattern; "
        "numbers that are missing; an EXIF orientation, which is not applied; transparent pixels, laid over "
        "black, and values that are not finite",
        "an image that is cut off, too large, or of other values than 8 or 16 bits without `--range`; "
        "several images in a file beside others; two sequences with the same numbers in a folder; a run "
        "ends where images change their size, unless `--on-resize rescale`",
        "`left_1.png`, `right_1.png`: two cameras, or one after the other; a pattern decides. 64 counts of "
        "a thermal camera, or a dark image of 16 bits; `--range` decides",
    ),
    Entrance(
        "files of several images",
        "`--source FILE`: TIFF, Netpbm, animated PNG, WebP, GIF",
        (
            "sources.images: stack_of _bytes_of Animation.read",
            "sources.sources: _is_animated_png",
            "observation.image_files: pages_of",
        ),
        "nothing: every image is a frame; thumbnails and masks of other pages are none",
        "a stack with channels or slices beside time, fewer pages than its description says, more than 2 "
        "GB, an animated WebP for an OpenCV that reads its first frame only",
        "pages of a stack: times, or channels and slices; the description by ImageJ or OME decides",
    ),
    Entrance(
        "videos",
        "`--source FILE`, as images; `track`, `open_source`",
        (
            "sources.video: VideoReader _open",
            "sources.video: explain_stream",
        ),
        "further video streams; pixels that are not square; a mirrored or slanted picture; levels that are "
        "lost at 8 bits; transparent pixels, laid over black, and alpha that cannot be decoded; damage and "
        "missing frames are in the journal as well",
        "what FFmpeg does not read, and files that name other files; a run over a damaged file ends with "
        "code 5",
        "frames as stored, or as a player shows them: quarter turns are applied, the rest is said",
    ),
    Entrance(
        "cameras",
        "`--source 0`, `track`, `open_source`",
        ("sources.live: camera_reader _Camera.__init__",),
        "levels that are lost at 8 bits; frames that were dropped are in the journal",
        "an index without a camera; a stride; repeating the run",
        "`0` is a camera, `./0` a file",
    ),
    Entrance(
        "streams over a network",
        "`--source URL --allow-network`, `--live`, `--no-live`",
        (
            "sources.live: stream_reader",
            "sources.sources: make_reader",
        ),
        "a stream without a declared length is taken as live: the newest frame is tracked",
        "every protocol but http, https and rtsp; any URL without `--allow-network`",
        "a live camera, of which the newest frame counts, or a file, of which all count; `--live` decides",
    ),
    Entrance(
        "depth",
        "`--depth FOLDER`; `depth=` of `Tracker`",
        ("sources.stereo_source: read_depth_points _array _depth_image",),
        "nothing: every file has its frame",
        "another number of files than of images, numbers without a partner, another size, several images "
        "in a file; depths without a calibration",
        "16 bits are units of the calibration, floats are metres",
    ),
    Entrance(
        "stereo pairs and calibration files",
        "`--right`, `--stereo side_by_side`, `--calibration`, `calibrate`, `learn-stereo`",
        (
            "sources.stereo_source: open_stereo_source",
            "vision.calibration: read_rectification _entries",
        ),
        "nothing: frames without a partner are damage, which the journal has",
        "left and right of different numbers, sizes or times; a calibration with missing or infinite "
        "values, or of another size; `--calibration` without a pair",
        "the left and the right camera: a calibration whose right camera is on the left is refused",
    ),
    Entrance(
        "cameras over a ground",
        "`cameras:` of a graph, `calibrate camera`, `ground` and `poses`, `cameras`, `--points`",
        (
            "observation.calibrations: read_tree _storage",
            "graph.checks.cameras: read_file",
            "cli.commands.calibrate_cameras: read_points",
            "cli.commands.detect: read_cameras",
        ),
        "entries that are not used; a principal point outside the image; a camera over 100 m above the "
        "ground",
        "a rotation that is none or a reflection, a camera below the ground, several cameras without a name, "
        "entries that contradict each other; points outside the image, almost in a line, or mirrored",
        "`homography` and `pose`, which may go either way: names that say the direction are needed",
    ),
    Entrance(
        "frames in Python",
        "`Tracker.init`, `Tracker.update`, `DetectionsTracker.update`",
        (
            "runtime.tracker: Tracker.init Tracker.update",
            "runtime.detections_tracker: DetectionsTracker.update",
            "sources.entrances.levels: Levels.__call__",
        ),
        "levels that are lost at 8 bits; a size that the given frame does not have",
        "what is no array of 8 or 16 bits (others with `value_range`), another size or type than before, "
        "no frame for a graph that looks at it, a time that is not later than the last one",
        "BGR or RGB cannot be told apart: BGR is taken, as in OpenCV",
    ),
    Entrance(
        "sources in Python",
        "`track(graph, source)`",
        (
            "runtime.session: track",
            "sources.sources: open_source",
        ),
        "all that is said of the source, the start boxes and the detections",
        "options that are for a source opened there, with a source that is open already",
        "a text names a file, a folder, a pattern, a camera or a URL: what there is decides, as for "
        "`--source`",
    ),
)


BOXES = (
    Entrance(
        "start boxes",
        "`--init`, the page of `--view`, `batch --list`; `Tracker.init`, `track`, `Start`",
        (
            "engine.starts: check_given say_blank",
            "cli.arguments: parse_start",
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
        ("cli.arguments: read_start",),
        "all that is said of ground truth and of a start box",
        "no box for the first frame that is read; boxes of several targets",
        "as of ground truth of one target",
    ),
    Entrance(
        "what sensors measured, in a file",
        "`--detections FILE.csv` for a graph whose sensors measure quantities; `track(..., detections=)`; "
        "its times as `--source`",
        ("sources.scan_files: scan_file parse_scans _times_of ScanReader _table",),
        "numbers that are not finite or lie outside of `within`, with their lines; columns that nothing "
        "measures; a sensor without a detection; rows of frames that are not read",
        "a missing column, or `frame` and `time_s` together; a cell that is no number, or empty beside "
        "others; angles in another unit, lengths below 0; times out of order; two sensors of the same "
        "quantity without a column `sensor`; `time_s` beside another source",
        "whose a row is: the column `sensor` decides, else the quantities that it has",
    ),
    Entrance(
        "detections in a file",
        "`--detections FILE`; `track(..., detections=)`; its frames as `--source`, also left out",
        (
            "sources.detection_files: file_detector",
            "sources.detection_files: names_boxes BoxReader.__init__ _described",
            "runtime.arguments: explain_unused",
            "sources.mot_lines: parse_mot read_text",
            "sources.entrances.text_lines: split_words",
        ),
        "boxes without an area, and confidences that are not finite, with their lines; detections of "
        "frames that are not read, outside of the frame, of other labels, or below the thresholds of the "
        "graph; long times without any; that confidences are percent, or how others beyond 0 to 1 are "
        "mapped; without images, the size and the rate that are assumed",
        "a line that is neither MOT nor JSON Lines; polygons; frames that do not count from 1 (MOT) or 0 "
        "(JSON); coordinates from 0 to 1; files of other formats, with what takes them",
        "8 columns: MOT, or polygons; columns of corners and of sizes, or of two identities; a header or the "
        "numbers decide, else it is refused",
    ),
    Entrance(
        "detections in Python",
        "`DetectionsTracker.update`",
        ("runtime.given_scans: read_given", "runtime.given_scans: read_scans"),
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
        (
            "evaluate.truth: read_mot_truth read_mot_tracks",
            "sources.mot_blocks: read_plain_boxes starts_plain _numbers",
        ),
        "boxes without an area or with confidence 0; frames that the run does not have, and boxes of another "
        "size of frame",
        "an identity twice in a frame, no true box, frames from 0",
        "as of detections in a file",
    ),
    Entrance(
        "places in metres",
        "`score --truth`",
        ("evaluate.world: is_world_truth _read",),
        "columns beside t, id, x and y",
        "a missing column, what is no finite number, an id twice in an instant, no time in common",
        "a header line t,id,x,y without a width or height: metres; else boxes in px",
    ),
    Entrance(
        "answers about identities",
        "`annotate --identities RUN --answers FILE`",
        ("cli.commands.annotate_identities: _answer",),
        "nothing: every answer is carried out, or the file is refused",
        "a line that is no answer, or is about no question of the run; the file then changes nothing",
        "nothing: one format",
    ),
    Entrance(
        "imported annotations",
        "`annotate --import`: COCO, CVAT, Label Studio, YOLO, MOT, or a zip of one",
        (
            "runtime.annotation.desk: read_annotations",
            "runtime.annotation.formats.json_formats: read_coco",
            "runtime.annotation.formats.cvat: read_cvat",
            "runtime.annotation.formats.json_formats: read_label_studio",
            "runtime.annotation.desk: read_mot _classes",
            "runtime.annotation.formats.yolo: read_yolo _frames _about _about_of_yaml",
            "runtime.annotation.formats.reading: read_json read_xml",
            "runtime.annotation.formats.reading: _unpack text_of_file",
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
        "inputs",
        "`inputs` of a graph",
        ("observation.timed_columns: _rows",),
        "columns that no input names; gaps that are several times the usual distance of two rows; frames "
        "before the first row or after the last",
        "no column `frame` or `time_s`, or both; rows that do not rise, a cell that is no finite number, a "
        "decimal comma, a frame without a time where the file goes by time",
        "none: `frame` or `time_s` says by what the rows go",
    ),
    Entrance(
        "polygons of queries",
        "`polygon` of a `count`",
        ("graph.checks.queries: _read_polygon",),
        "nothing: all of it is used",
        "no file, or one that is too large or no text; a row that is not two finite numbers; fewer than 3 "
        "corners, or corners without an area",
        "none: a first line of names is left out",
    ),
    Entrance(
        "masks and templates",
        "`mask` of a factor, `picture` of `color_backprojection`, `learn-shape --masks`",
        (
            "observation.image_files: read_mask",
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
            "vision.siamese_networks: read_onnx",
            "vision.siamese_networks: check_apart",
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
            "cli.commands.fit: graph_text",
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
        ("cli.batch.jobs: read_list _csv_rows videos_of",),
        "nothing: every row is a video; names that begin with a dot are none of a pattern",
        "an unknown column, a row without a source, a pattern that matches nothing",
        "CSV, or JSON Lines: a first line with a brace is JSON",
    ),
    Entrance(
        "stored trackers",
        "`Tracker.load`, `DetectionsTracker.load`, `pickle`",
        ("runtime.storing: Storable.load",),
        "nothing: all of it is used",
        "a file of another version, of another graph or kind of tracker, or one that is damaged",
        "none: the file names what it holds",
    ),
    Entrance(
        "inputs of an earlier run",
        "`--inputs FILE`; `track(..., inputs=)`",
        ("runtime.results: replay_inputs",),
        "switches of targets and agents that the run does not have, in its journal",
        "lines that are no inputs; a budget or a view beside it",
        "none",
    ),
)

ENTRANCES = (*FRAMES, *BOXES, *FILES)
