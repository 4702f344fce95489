"""Checks of the whole: what packages declare can be loaded, and ten frames are tracked, twice alike."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.metadata import entry_points
from importlib.util import find_spec

from bayesnet_track.cli.doctor.finding import Finding, try_code

GROUPS = {"bayesnet_track.cues": "cue", "bayesnet_track.detectors": "detector"}

_LOAD = """
import json, sys
from importlib.metadata import entry_points
wrong = []
for group in sys.argv[1].split():
    for point in entry_points(group=group):
        if point.dist is None or point.dist.name.lower().replace("_", "-") != "bayesnet-track":
            continue
        try:
            assert point.load().name
        except Exception as error:
            wrong.append(f"{group.split('.')[1][:-1]} {point.name!r}: {type(error).__name__}: {error}")
print(json.dumps(wrong))
"""

_TRACK = """
import hashlib, itertools, json, time
from bayesnet_track import Start, track
from bayesnet_track.numerics.boxes import centre_from_corner, overlap
from bayesnet_track.sources.scene_source import SceneSource
from bayesnet_track.sources.scenes import make_scene
def play():
    scene = make_scene("two_squares", 0)
    run = track("two_squares", SceneSource(scene, "scene:two_squares"), [Start(scene.start_box)], seed=0)
    boxes = [result.targets[0].centre_box for result in itertools.islice(run, 10)]
    run.close()
    truth = centre_from_corner(scene.truth[9:10])
    return repr([tuple(map(float, box)) for box in boxes]), float(overlap([boxes[-1]], truth)[0])
play()
started = time.perf_counter()
first, share = play()
spent = time.perf_counter() - started
print(json.dumps([first == play()[0], share, 10 / spent, hashlib.sha256(first.encode()).hexdigest()[:12]]))
"""


def check_plugins() -> Iterator[Finding]:
    """Every cue and detector of this package can be loaded; those of other packages are only looked for."""
    points = {group: list(entry_points(group=group)) for group in GROUPS}
    if not all(points.values()):
        cure = "install the package: python -m pip install bayesnet-track   (in a checkout: -e .)"
        yield Finding("plug-ins", "broken", "no cues or no detectors are declared", cure)
        return
    trial = try_code(_LOAD, " ".join(GROUPS))
    wrong = [trial.error] if trial.error else json.loads(trial.out)
    if wrong:
        more = f"; and {len(wrong) - 1} more" if len(wrong) > 1 else ""
        yield Finding("plug-ins", "broken", f"cannot be loaded: {wrong[0]}{more}", "mend what is above first")
    else:
        counts = [f"{len(found)} {GROUPS[group]}s" for group, found in points.items()]
        yield Finding("plug-ins", "ok", " and ".join(counts))
    for group, found in points.items():
        for point in found:
            module = point.module.partition(".")[0]
            if find_spec(module) is None:  # finds the package without running it
                package = "a package" if point.dist is None else point.dist.name
                text = f"{package} declares the {GROUPS[group]} {point.name!r}, and {module} is not there"
                yield Finding("plug-ins", "broken", text, f"reinstall or uninstall {package}")


def check_tracking() -> Iterator[Finding]:
    """Ten frames of a built-in scene: the target is held, and the same seed gives the same boxes."""
    trial = try_code(_TRACK, timeout_s=300.0)
    if trial.error:
        yield Finding("self test", "broken", trial.error, "mend what is above; else please report this")
        return
    same, share, rate, code = json.loads(trial.out.splitlines()[-1])
    summary = f"10 frames of two_squares at {rate:.0f} frames/s, overlap {share:.2f}, boxes {code}"
    if not same:
        text = f"{summary}: the same seed gives other boxes a second time"
        yield Finding("self test", "broken", text, "please report this with the lines above")
    elif share < 0.5:
        yield Finding("self test", "broken", f"{summary}: the target is lost", "please report this")
    else:
        yield Finding("self test", "ok", summary)
