"""The checks of the Gaussian belief: which motions `kalman` takes, and which settings have an effect."""

from __future__ import annotations

from collections.abc import Iterator

from bayesnet_track.graph.checks.plates import Plate
from bayesnet_track.graph.settings.motion import Motion, Noise
from bayesnet_track.graph.text.messages import GraphMessage, Path


def kalman_moves_linearly(plate: Plate) -> Iterator[GraphMessage]:
    """The `kalman` filter is exact, so it takes no noise but that in px; the others approximate the rest."""
    for name, node in plate.inference.items():
        gaussian = node.belief.gaussian if node.belief is not None else None
        if gaussian is None or gaussian.filter != "kalman" or node.motion is None:
            continue
        if node.motion.expressions is not None:
            continue
        moved: dict[Path, Motion] = {("belief", "gaussian", "filter"): node.motion}
        for mode, one in (node.modes or {}).items():
            if one.motion is not None and one.motion.expressions is None:
                moved["modes", mode, "motion"] = one.motion
        for key, motion in moved.items():
            yield from _linear(plate, name, key, motion.settings)


def _linear(plate: Plate, name: str, key: Path, noise: Noise) -> Iterator[GraphMessage]:
    further = [
        f"{part}.{field}"
        for part in ("sd_box", "sd_log")
        for field in type(getattr(noise, part)).model_fields
        if getattr(getattr(noise, part), field) > 0
    ]
    further += ["heavy_tail"] if noise.heavy_tail is not None else []
    if further:
        found = f"filter: kalman with {', '.join(further)}, which is not Gaussian noise in px"
        allowed = "filter: extended or unscented, or noise by sd_px alone"
        yield plate.message(name, found, allowed, key=key)


def gaussian_settings_have_effect(plate: Plate) -> Iterator[GraphMessage]:
    """`samples` and `sigma` stand only where they are used."""
    for name, node in plate.inference.items():
        gaussian = node.belief.gaussian if node.belief is not None else None
        if gaussian is None or node.parent is not None:
            continue
        unused = {
            "samples": ("likelihood", "samples"),
            "sigma": ("filter", "unscented"),
        }
        for key, (setting, needed) in unused.items():
            own = getattr(gaussian, setting)
            if key in gaussian.model_fields_set and own != needed:
                found = f"{key} has no effect beside {setting}: {own}"
                allowed = f"{setting}: {needed}, or no {key}"
                yield plate.message(name, found, allowed, key=("belief", "gaussian", key), on_key=True)
