"""Checks of the machine: what may be written, how many processors there are, and the clock."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from bayesnet_track.cli.doctor.finding import Finding, try_code

THREAD_SETTINGS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

_CACHE = """
from pathlib import Path
from bayesnet_track.numerics.compiled import is_whole
from bayesnet_track.numerics import resampling
from bayesnet_track.numerics.kernels import box_kernels
from bayesnet_track.vision.kernels import gradient_kernels
from bayesnet_track.vision.kernels.histograms import histogram_kernels
from bayesnet_track.vision.shape import shape_snake
folders = []  # Numba keeps one for each folder of sources
for module in (resampling, box_kernels, gradient_kernels, histogram_kernels, shape_snake):
    kernels = (v for v in vars(module).values() if hasattr(v, "_cache"))
    kernel = next(v for v in kernels if v.__module__ == module.__name__)  # others come from other folders
    folders.append(getattr(kernel._cache, "cache_path", None))
print(folders[0] or "")
import bayesnet_track
import bayesnet_track.cues
homes = [Path(bayesnet_track.__file__).parent, Path(bayesnet_track.cues.__file__).parent]
homes += [Path(folder) for folder in folders if folder]
files = {f for home in homes for end in ("nbi", "nbc") for f in home.rglob(f"*.{end}")}
for file in sorted(files):
    try:
        whole = is_whole(file)
    except FileNotFoundError:
        continue
    if not whole:
        print(file)
"""


def check_cache() -> Iterator[Finding]:
    """The cache of compiled kernels: it can be written, and what lies in it can be read."""
    trial = try_code(_CACHE)
    if trial.error:
        yield Finding(
            "kernel cache", "note", f"cannot be looked at: {trial.error}", "mend what is above first"
        )
        return
    folder, *damaged = (trial.out or "").splitlines() or [""]
    if damaged:
        which = damaged[0] + (f" and {len(damaged) - 1} more" if len(damaged) > 1 else "")
        cure = f"delete them: {' '.join(damaged[:3])}{' ...' if len(damaged) > 3 else ''}"
        yield Finding("kernel cache", "note", f"damaged, so compiled anew at the next start: {which}", cure)
    if not folder or not _can_write(Path(folder)):
        summary = f"{folder} cannot be written" if folder else "no folder for it can be written"
        text = f"{summary}: every start compiles for some ten seconds"
        cure = "set NUMBA_CACHE_DIR to a folder that you may write"
        yield Finding("kernel cache", "note", text, cure)
    elif not damaged:
        yield Finding("kernel cache", "ok", folder)


def check_folders() -> Iterator[Finding]:
    """The folder where runs go, and that of temporary files."""
    here, temporary = Path.cwd(), Path(tempfile.gettempdir())
    if _can_write(here):
        yield Finding("folders", "ok", f"{here} can be written")
    else:
        text = f"{here} cannot be written, and `demo` writes runs/ there"
        yield Finding("folders", "note", text, "start it in another folder, or give `--out`")
    if not _can_write(temporary):
        cure = "set TMPDIR to a folder that you may write"
        yield Finding("folders", "broken", f"{temporary} cannot be written", cure)


def _can_write(folder: Path) -> bool:
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def processors() -> int:
    """How many processors this process may use: fewer than there are, in a container or a batch system."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_processors() -> Iterator[Finding]:
    """How many processors there are, and who may use how many threads of them."""
    own = processors()
    summary = f"{own} of {os.cpu_count() or own} processors"
    quota = _quota()
    if quota is not None and quota < own:
        summary += f", of which the container may use {quota:g}"
    given = [f"{name}={os.environ[name]}" for name in THREAD_SETTINGS if os.environ.get(name)]
    wrong = [text for text in given if not text.partition("=")[2].isdecimal()]
    too_many = [text for text in given if text not in wrong and int(text.partition("=")[2]) > own]
    if wrong:
        yield Finding("processors", "broken", f"{summary}; {', '.join(wrong)} is no number", "unset it")
    elif too_many:
        text = f"{summary}; {', '.join(too_many)} asks for more threads than there are"
        yield Finding("processors", "note", text, "unset it")
    else:
        yield Finding("processors", "ok", "; ".join([summary, *given]))


def _quota() -> float | None:
    """Processors that the control group grants; None where it grants all, or there is none."""
    try:
        most, period = Path("/sys/fs/cgroup/cpu.max").read_text(encoding="ascii").split()
        return None if most == "max" else int(most) / int(period)
    except (OSError, ValueError):
        return None


def check_clock() -> Iterator[Finding]:
    """The clock of timings: it never goes back, and is fine enough to time an agent."""
    clock = time.get_clock_info("perf_counter")
    if not clock.monotonic or clock.resolution > 1e-3:
        text = f"{clock.implementation}: steps of {clock.resolution:g} s, monotonic: {clock.monotonic}"
        yield Finding(
            "clock", "note", text, "timings of this machine mean little; results do not depend on them"
        )
    else:
        yield Finding("clock", "ok", f"{clock.implementation}, steps of {clock.resolution:g} s")
