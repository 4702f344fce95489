"""The entrances of frames, and of what belongs to each of them."""

from __future__ import annotations

from bayesnet_track.sources.entrances.table import Entrance

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
            "sources.entrances.stacks: stack_of is_animated_png _bytes_of Animation.read",
            "observation.image_headers: pages_of",
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
            "sources.entrances.streams: explain_stream",
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
        ("sources.camera: camera_reader Camera.__init__",),
        "levels that are lost at 8 bits; frames that were dropped are in the journal",
        "an index without a camera; a stride; repeating the run",
        "`0` is a camera, `./0` a file",
    ),
    Entrance(
        "streams over a network",
        "`--source URL --allow-network`, `--live`, `--no-live`",
        (
            "sources.stream: stream_reader",
            "sources.sources: make_reader",
        ),
        "a stream without a declared length is taken as live: the newest frame is tracked",
        "every protocol but http, https and rtsp; any URL without `--allow-network`",
        "a live camera, of which the newest frame counts, or a file, of which all count; `--live` decides",
    ),
    Entrance(
        "depth",
        "`--depth FOLDER`; `depth=` of `Tracker`",
        ("sources.stereo_source: read_points _array _depth_image",),
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
            "vision.calibration: read_calibration _entries",
        ),
        "nothing: frames without a partner are damage, which the journal has",
        "left and right of different numbers, sizes or times; a calibration with missing or infinite "
        "values, or of another size; `--calibration` without a pair",
        "the left and the right camera: a calibration whose right camera is on the left is refused",
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
