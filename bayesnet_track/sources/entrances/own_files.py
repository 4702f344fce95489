"""Functions that read files which this program or the system wrote, with the reason: no entrance of data."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from bayesnet_track.sources.entrances.entrance import PACKAGE

RUN = "a run directory, whose files the manifest verifies"
SESSION = "a folder of `annotate`, verified by its own reader"
WRITES = "nothing is read: it is written there, or synced"
SYSTEM = "the operating system or the installation"

_BY_REASON: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        RUN: (
            "cli.batch.table.read_table",
            "evaluate.runs._has_end",
            "journal.frame_file.FrameFile.__init__",
            "journal.frame_file.FrameFile.columns",
            "journal.reader._read",
            "journal.timings.read_seconds",
            "journal.writer.read_position",
            "runtime.checkpoints.checkpoint_file._of_another",
            "runtime.checkpoints.checkpoint_file.read_checkpoint",
            "runtime.checkpoints.recipe.Recipe.load_graph",
            "runtime.checkpoints.recipe.Recipe.read",
            "runtime.checkpoints.standing._ending",
            "runtime.checkpoints.unchanged._ends_with_newline",
            "runtime.preparation.held_files",
            "runtime.recording.beliefs.read_beliefs",
            "runtime.recording.manifest._restore",
            "runtime.recording.manifest.read_manifest",
            "runtime.recording.remux.remux",
            "runtime.recording.replace._complete",
            "runtime.recording.run_reader.open_run",
            "runtime.recording.rundir.RunDirectory.check_version",
            "runtime.recording.smoothed.write_smoothed",
            "view.page_data.read_timings",
            "view.run_page.is_page",
        ),
        SESSION: (
            "runtime.annotation.answers_file.read_answers",
            "runtime.annotation.frame_store.FrameStore.image",
            "runtime.annotation.session.open_session",
        ),
        WRITES: (
            "cli.commands.answer.mute",
            "journal.disk.sync_folder",
            "runtime.recording.lock.lock_run",
            "vision.calibration.write_calibration",
        ),
        "the cache of compiled kernels, sealed by a hash": (
            "numerics.compiled.SealedFiles._load_data",
            "numerics.compiled.SealedFiles._load_index",
            "numerics.compiled.is_whole",
        ),
        SYSTEM: (
            "cli.commands.init.init",
            "cli.doctor.check_package",
            "cli.doctor.installed",
            "runtime.executors.memory.own_bytes",
            "view.run_page._built",
        ),
        "the fingerprint of a source, which changes nothing but a comparison": ("sources.origin._samples",),
    }
)

OWN_FILES: Mapping[str, str] = MappingProxyType(
    {f"{PACKAGE}.{name}": reason for reason, names in _BY_REASON.items() for name in names}
)
"""Dotted path -> why what it reads is no entrance."""
