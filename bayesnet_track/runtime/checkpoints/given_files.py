"""Files from outside that a run reads: where they were given, and the SHA-256 of what they held."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from errno import EINVAL
from os import PathLike
from pathlib import Path

from bayesnet_track.graph.checked import CheckedGraph
from bayesnet_track.graph.checks.cues import cue_parameters, plugin_parameters
from bayesnet_track.journal.writer import read_position
from bayesnet_track.observation.cue_files import CueFile
from bayesnet_track.observation.detector import detectors_of_graphs
from bayesnet_track.sources.entrances.notices import few, notice
from bayesnet_track.sources.origin import changed_since, stamps
from bayesnet_track.sources.paths import SourceError

AGAIN = "start again once nothing writes it"


@dataclass(frozen=True)
class GivenFile:
    """A file from outside: its path as given and from the root, and its content."""

    path: str
    absolute: str
    sha256: str

    @property
    def place(self) -> Path:
        """Where it is now: where it was, or as given where that is gone."""
        return Path(self.absolute) if Path(self.absolute).exists() else Path(self.path)

    def changes(self) -> tuple[str, ...]:
        """What is not as it was, in words; raises OSError when it cannot be read."""
        if not self.place.is_file():  # a device or a pipe might never end
            raise OSError(EINVAL, "not a plain file", str(self.place))
        now = file_sha256(self.place)
        return () if now == self.sha256 else (f"{self.path}: {self.sha256[:12]}, now {now[:12]}",)


def model_files(graph: CheckedGraph) -> list[str]:
    """Files that the agents and detectors of a graph read, by their paths as it has them."""
    found: set[str] = set()
    cues = graph.declarations
    for plate in graph.targets.values():
        for _, _, chosen in plate.spec.cue_choices():
            files = cues[chosen.cue].files
            found |= set(() if files is None else files(cue_parameters(chosen, cues[chosen.cue])))
        birth = plate.spec.birth
        if birth is not None:
            declaration = detectors_of_graphs([birth.detector.detector])[birth.detector.detector]
            if declaration.files is not None:
                found |= set(declaration.files(plugin_parameters(birth.detector, declaration.parameters)))
    return sorted(found)


@contextmanager
def steady(paths: Iterable[str | PathLike[str] | None]) -> Iterator[Callable[[], None]]:
    """Files that are read whole before the first frame; gives what to call once that is done.

    Raises:
        SourceError: when that is called, if a file changed since: what was read may not be what it holds.
    """
    before = stamps(Path(path) for path in paths if path is not None)

    def check() -> None:
        changed = changed_since(before)
        if changed:
            raise SourceError(few(changed), "changed while it was read", "files that stay as they are", AGAIN)

    yield check
    changed = changed_since(before)
    if changed:
        notice(
            f"{few(changed)}: changed during the run, which used what it held at the start; run.json has the "
            "SHA-256 of that"
        )


def given_file(path: str | PathLike[str]) -> GivenFile:
    """A file as it is now; raises OSError when it cannot be read."""
    return GivenFile(str(path), str(Path(path).absolute()), file_sha256(path))


def given_cue(file: CueFile) -> GivenFile:
    """The file of a cue, as it was read."""
    return GivenFile(file.path, str(Path(file.path).absolute()), file.sha256)


def file_sha256(path: str | PathLike[str]) -> str:
    """The SHA-256 of a file's bytes, in hexadecimal.

    Raises:
        OSError: it cannot be read.
    """
    return read_position(Path(path)).sha256
