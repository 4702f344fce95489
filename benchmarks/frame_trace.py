"""What one frame enters: modules, functions, and returns to a module that was left before.

    python benchmarks/frame_trace.py [--list]

Traced are the third frame of `Tracker.update` with one particle target (`two_squares`) and the tenth frame
of `DetectionsTracker.update` with ten people (`sort`), kernels compiled. Only modules of the project count.
Returns are those of a reader who goes through each function once, in the order in which the frame enters
them: steps to a module that was left before. --list prints modules and functions in this order.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType, SimpleNamespace
from typing import Any

import numpy as np

from bayesnet_track import DetectionsTracker, Tracker
from bayesnet_track.sources.scenes import make_scene

PACKAGE = Path(sys.modules["bayesnet_track"].__file__ or "").resolve().parent
CUES = PACKAGE.parent / "cues"
GOALS = {"particles, one target": (25, 180, 30), "Kalman crowd of ten": (18, None, None)}


def trace(call: Callable[[], Any]) -> list[CodeType]:
    """The functions of the project that a call enters, in order."""
    entered: list[CodeType] = []

    def note(frame: FrameType, event: str, argument: object) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and (PACKAGE in path.parents or CUES in path.parents):
            entered.append(frame.f_code)

    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
    return entered


def count_returns(modules: list[str]) -> int:
    """How often a module is entered from another one after it was left.

    >>> count_returns(["a", "a", "b", "a", "c", "b"])
    2
    """
    seen, returns = set[str](), 0
    for before, after in zip(["", *modules], modules, strict=False):
        returns += after != before and after in seen
        seen.add(after)
    return returns


def particles() -> list[CodeType]:
    """A frame of one target held by particles."""
    scene = make_scene("two_squares", 0)
    images = list(scene.frames)[:4]
    tracker = Tracker("two_squares")
    tracker.init(images[0], scene.start_box)
    for image in images[1:3]:
        tracker.update(image)
    return trace(lambda: tracker.update(images[3]))


def crowd(count: int = 10) -> list[CodeType]:
    """A frame of a crowd held by Kalman filters."""
    tracker = DetectionsTracker("sort", size=(1920, 1080))

    def seen(frame: int) -> Any:
        left = 100.0 + 150.0 * np.arange(count) + 3.0 * frame
        top = np.full(count, 400.0)
        return SimpleNamespace(
            xyxy=np.column_stack([left, top, left + 50, top + 120]), confidence=np.linspace(0.9, 0.8, count)
        )

    for frame in range(9):
        tracker.update(seen(frame))
    assert len(tracker.targets) == count
    return trace(lambda: tracker.update(seen(9)))


def module_of(code: CodeType) -> str:
    """The module of a function, from the folder of the package on."""
    return str(Path(code.co_filename).relative_to(PACKAGE.parent).with_suffix(""))


def main() -> int:
    """Print what each frame enters."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--list", action="store_true", help="print modules and functions, too")
    options = parser.parse_args()
    print(f"{'':24}{'modules':>9}{'functions':>11}{'returns':>9}   goals")
    for (name, goals), frame in zip(GOALS.items(), (particles, crowd), strict=True):
        codes = frame()
        modules = [module_of(code) for code in dict.fromkeys(codes)]
        goal = ", ".join("–" if one is None else f"≤ {one}" for one in goals)
        print(
            f"{name:24}{len(set(modules)):9}{len(set(codes)):11}{count_returns(modules):9}   {goal}",
            flush=True,
        )
        if options.list:
            for module in dict.fromkeys(modules):
                names = dict.fromkeys(code.co_name for code in codes if module_of(code) == module)
                print(f"  {module}: {', '.join(names)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
