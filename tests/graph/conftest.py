"""Cues that need no images, and generated graphs, for the tests of the language."""

from __future__ import annotations

from typing import Any, Literal

import pytest
from hypothesis import strategies as st
from pydantic import Field

from bayesnet_track import CueDeclaration, CueParameters, GraphSpec
from bayesnet_track.observation.cue import Cue


class HueParameters(CueParameters):
    bins: int = Field(default=32, ge=4, le=128, description="bins round the hue circle, count")
    sd: float = Field(default=1.0, gt=0, description="spread, px")
    form: Literal["circle", "line"] = Field(default="circle", description="where hue starts")
    soft: bool = Field(default=False, description="whether bins overlap")
    window: tuple[int, int] = Field(default=(3, 3), description="smoothing window, px")


class NeedyParameters(CueParameters):
    path_length: int = Field(gt=0, description="length, count")


def _no_cue(_: Any) -> Cue:
    raise AssertionError("checking a graph loads no cue")


@pytest.fixture(scope="session")
def cues() -> dict[str, CueDeclaration]:
    """Four cues: hue and blobs with parameters, motion without any, needy with a required one."""
    declared = (
        CueDeclaration("hue", "Hue.", HueParameters, _no_cue),
        CueDeclaration("blobs", "Blobs.", HueParameters, _no_cue),
        CueDeclaration("motion", "Flow.", CueParameters, _no_cue),
        CueDeclaration("needy", "Needs a length.", NeedyParameters, _no_cue),
    )
    return {cue.name: cue for cue in declared}


def _mapping(required: dict[str, Any], optional: dict[str, Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries(required, optional=optional)


def _choice(bare: list[str], **settings: Any) -> st.SearchStrategy[Any]:
    keyed = [value.map(lambda inside, name=name: {name: inside}) for name, value in settings.items()]
    return st.one_of(*([st.sampled_from(bare)] if bare else []), *keyed)


def _adaptive_sizes(positive: st.SearchStrategy[float]) -> st.SearchStrategy[Any]:
    """Every way to let the number of hypotheses follow the evidence."""
    confidence = st.floats(min_value=0.5, max_value=1, exclude_max=True)
    further = {
        "confidence": confidence,
        "fields": st.lists(st.sampled_from("xywh"), min_size=1, max_size=4),
    }
    binned = _mapping({"bin_px": positive}, {"error": positive, **further})
    return _choice(
        [],
        kld=binned,
        kld_revised=binned,
        kld_revised_simplified=binned,
        asymptotic_normal=_mapping({"error_px": positive}, further),
        likelihood_sum=_mapping({"threshold": positive}, {}),
    )


def _importance(positive: st.SearchStrategy[float]) -> st.SearchStrategy[Any]:
    """Every importance function."""
    defensive = st.floats(min_value=0, max_value=1, exclude_max=True)
    share = st.floats(min_value=0, max_value=1, exclude_min=True, exclude_max=True)
    above = {"above_kl": st.just(0) | positive, "defensive": defensive}
    adaptive = {
        **above,
        "by": st.sampled_from(["fitted", "parents"]),
        "weights": st.sampled_from(["balance", "separate", "second_only"]),
        "neighbours": st.integers(1, 1000),
    }
    return _choice(
        ["bootstrap", "second_pass", "auxiliary", "prior_editing", "iterated", "likelihood_mixture"],
        second_pass=_mapping({}, adaptive),
        auxiliary=_mapping({}, {"defensive": defensive}),
        prior_editing=_mapping({}, {"rounds": st.integers(1, 20), "accept_above": share}),
        iterated=_mapping({}, {**above, "refinements": st.integers(1, 10), "bandwidth": positive}),
        likelihood_mixture=_mapping({}, {"share": share, "reach_sd": positive}),
    )


def _graphs() -> st.SearchStrategy[dict[str, Any]]:
    names = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,8}", fullmatch=True)
    positive = st.floats(min_value=1e-300, max_value=1e300) | st.integers(1, 1000)
    share = st.floats(min_value=0, max_value=1, exclude_min=True, exclude_max=True)
    sd = st.just(0) | positive
    frames = st.integers(1, 1_000_000)
    level = _choice([], ud_px2=positive, ud_box=positive, ud_baseline=positive)
    switch_level = level | _choice([], score=share)
    noise = {
        "sd_px": _mapping({}, dict.fromkeys("xywh", sd)),
        "sd_box": _mapping({}, dict.fromkeys("xy", sd)),
        "sd_log": _mapping({}, {"scale": sd, "aspect": sd}),
        "heavy_tail": _mapping(
            {"weight": share, "factor": st.floats(min_value=1, max_value=1e9, exclude_min=True)}, {}
        ),
    }
    looked = _choice(
        ["uniform", "agents"],
        agents=_mapping({}, {"max_boxes": st.integers(16, 10_000)}),
        detector=_choice(["motion"], background=_mapping({}, {"min_area_px": st.integers(1, 900)})),
    )
    relocalize = {
        "share": share,
        "above": level,
        "usual": st.just(0) | share,
        "hypotheses": share,
        "by": looked,
    }
    growing = {key: relocalize[key] for key in ("share", "hypotheses", "by")} | {"grow_box": positive}
    factor = st.floats(min_value=1, max_value=1e9, exclude_min=True)
    moving = {
        **noise,
        "sd_angle_deg": sd,
        "inflate": _mapping({}, {"above": level, "max_factor": factor}),
        "size_reversion": _mapping({}, {"sd_scale": positive, "sd_aspect": positive}),
        "camera": st.just("compensate"),
        "relocalize": _mapping({}, relocalize) | _mapping({}, growing),
    }
    velocity = {**moving, "sd_velocity_px": sd, "start_velocity_sd_px": sd}
    acceleration = {
        **moving,
        "sd_acceleration_px": sd,
        "start_velocity_sd_px": sd,
        "start_acceleration_sd_px": sd,
    }
    motion = _choice(
        ["random_walk", "constant_velocity", "damped_velocity", "constant_acceleration"],
        random_walk=_mapping({}, moving),
        constant_velocity=_mapping({}, velocity),
        damped_velocity=_mapping({}, {**velocity, "damping": positive}),
        constant_acceleration=_mapping({}, acceleration),
    )
    schemes = st.sampled_from(["systematic", "multinomial"])
    when = st.just("every_frame") | _mapping({"ess_below": share | st.just(1)}, {})
    counts = st.integers(100, 1_000_000)
    sizes = st.integers(2, 1_000_000) | _adaptive_sizes(positive)
    particles = _mapping(
        {},
        {
            "size": sizes,
            "min": counts,
            "max": counts,
            "resample": schemes,
            "when": when,
            "proposal": _importance(positive),
        },
    )
    spread = st.floats(min_value=1e-6, max_value=9)
    gaussian = _mapping(
        {},
        {
            "filter": st.sampled_from(["kalman", "extended", "unscented"]),
            "likelihood": st.sampled_from(["samples", "sigma_points"]),
            "samples": st.integers(20, 1_000_000),
            "gate": share | st.just(1),
            "sigma": _mapping({}, {"alpha": spread, "beta": spread | st.just(0), "kappa": spread}),
        },
    )
    empty = st.just({})
    window = _mapping({}, {"box": positive})
    nearest = _mapping({}, {"epsilon": share | st.just(1)})
    estimate = _choice(
        ["map", "max_weight", "mean", "robust_mean", "nearest"],
        map=empty,
        max_weight=empty,
        mean=empty,
        robust_mean=window,
        nearest=nearest,
    )
    aside = st.floats(-1, 1)
    part = {
        "offset_box": _mapping({}, {"x": aside, "y": aside}),
        "size_box": _mapping({}, {"w": positive, "h": positive}),
    }
    fuse = _choice(
        ["product", "pool"],
        product=empty,
        pool=st.just("equal") | st.dictionaries(names, positive, min_size=1, max_size=3),
        latent=_mapping({"given": _mapping({}, noise | part)}, {"draw": st.sampled_from(["one", "kernel"])}),
    )
    which = st.sampled_from(["all", "most_helpful", "information_per_ms"])
    drop = st.sampled_from(["largest_kl", "min_contribution_per_ms", "min_information_per_ms"])
    half = st.floats(0.5, 0.99)
    test = _choice(
        ["concentrated"],
        concentrated=_mapping({}, {"share": half, "within_box": positive, "confidence": half}),
    )
    adapt = _mapping(
        {},
        {
            "activate": _mapping({"above": switch_level}, {"frames": frames, "which": which})
            | _mapping({"unless": test}, {"frames": frames, "which": which}),
            "deactivate": _mapping({"below": switch_level}, {"frames": frames, "drop": drop})
            | _mapping({"when": test}, {"frames": frames, "drop": drop}),
            "keep": st.integers(1, 9),
            "information": _mapping({}, {"memory_frames": frames, "exploration": positive | st.just(0)}),
        },
    )
    inference = _mapping(
        {},
        {
            "parent": names,
            "belief": _choice(
                ["particles", "gaussian", "grid"],
                particles=particles,
                gaussian=gaussian,
                grid=_grids(positive),
            ),
            "motion": motion,
            "estimate": estimate,
            "fuse": fuse,
            "ud_fields": st.lists(st.sampled_from("xywh"), min_size=1, max_size=4),
            "adapt": adapt,
            "learn": _mapping(
                {"below": level},
                {
                    "rate_max": share,
                    "guard": _mapping(
                        {}, {"rate": share, "apart_nats": positive, "pull": share | st.just(0)}
                    ),
                },
            ),
            "lost": _mapping(
                {},
                {
                    "above": level,
                    "fit_below": st.just(0) | share,
                    "score_below": share,
                    "uncertain_below": share,
                    "frames": frames,
                },
            ),
            "score": _choice(
                [],
                logistic=_mapping(
                    {"bias": aside},
                    {
                        "evidence": aside,
                        "memory_frames": share,
                        "verifiers": _mapping(
                            {}, {"v": _mapping({"agent": st.just("hue")}, {"every": frames})}
                        ),
                    },
                ),
            ),
            "localization_error": _mapping(
                {}, {"sd_box": sd, "lost_sd_box": positive, "heavy_tail": noise["heavy_tail"]}
            ),
            "distractors": _mapping({}, {"within_nats": positive, "hold": frames}),
            "guarantee": _mapping(
                {"above": share}, {"frames": frames, "afterwards": st.lists(share, max_size=3)}
            ),
            "alarm": _mapping({"total": positive, "videos": frames}, {}),
        },
    )
    parameters = _mapping(
        {},
        {
            "bins": st.integers(4, 128),
            "sd": positive,
            "form": st.sampled_from(["circle", "line"]),
            "soft": st.booleans(),
            "window": st.lists(st.integers(-9, 9), min_size=2, max_size=2),
        },
    )
    cue = _choice(["hue", "motion"], hue=parameters, blobs=parameters, motion=empty)
    agent = _mapping(
        {"parent": names, "agent": cue},
        {
            "active": st.booleans(),
            "self_check": _mapping({"above": level}, {"frames": frames, "rest": frames}),
            "learn_rate_max": st.just(0) | share,
            "temperature": positive,
        },
    )
    factor = _mapping({"parent": names, "factor": st.text(max_size=20)}, {})
    nodes = st.dictionaries(names, inference | agent | factor, min_size=1, max_size=4)
    targets = st.dictionaries(
        names,
        _mapping({"nodes": nodes}, {"state": st.just("box"), **_life(positive, share, frames)}),
        min_size=1,
        max_size=2,
    )
    about = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)
    optional = {
        "bayesnet": st.just(1),
        "about": about,
        "constants": st.dictionaries(names, st.floats(-9, 9), max_size=2),
        "joins": st.lists(_joins(names, share, frames), max_size=2),
    }
    return _mapping({"name": names, "targets": targets}, optional)


def _joins(names: Any, share: Any, frames: Any) -> st.SearchStrategy[dict[str, Any]]:
    """How targets depend on each other."""
    stay = st.floats(min_value=0.5, max_value=1, exclude_max=True)
    further = {
        "between": st.lists(names, min_size=1, max_size=2),
        "occlusion": _mapping({}, {"stay": stay}),
        "attachment": _mapping({}, {"start": stay, "stay": stay, "sd_px": share}),
        "when": _mapping({}, {"overlap": share, "apart_frames": frames}),
        "pairings": st.integers(1, 64),
    }
    return _mapping({"exclusion": _mapping({}, {"nats": share})}, further)


def _life(positive: Any, share: Any, frames: Any) -> dict[str, st.SearchStrategy[Any]]:
    """How targets of a plate are born, recognised and end."""
    settings = _mapping(
        {}, {"min_area_px": st.floats(min_value=1, max_value=1e9), "max_count": st.integers(1, 1000)}
    )
    detector = _choice(["background", "detections"], gray_level=settings, detections=settings)
    confirm = _mapping({}, {"hits": st.integers(1, 3), "of": st.integers(4, 1000)})
    birth = {"labels": st.lists(st.text("abc", min_size=1), max_size=2), "every": frames, "confirm": confirm}
    birth |= {
        "pace": _mapping({"empty": frames}, {"waiting": frames}),
        "max_targets": st.integers(1, 1000),
        "min_distance_box": positive,
    }
    return {
        "birth": _mapping({"detector": detector}, birth),
        "merge_duplicates": _mapping({}, {"overlap": share, "frames": frames}),
        "death": _mapping({}, {"lost_frames": frames, "unseen_frames": frames}),
        "reidentify": _mapping({}, {"frames": frames, "min_probability": share, "lost": st.booleans()}),
        "existence": _mapping({}, {"covered": st.floats(0.1, 0.9), "births": positive, "clutter": positive}),
        "identity": _mapping({}, {"settle": st.integers(1, 9), "report_above": st.floats(0.1, 0.9)}),
        "associate": st.sampled_from(["assignment", "marginal"]),
    }


def _grids(positive: st.SearchStrategy[float]) -> st.SearchStrategy[dict[str, Any]]:
    """Settings of the grid belief."""
    odd = st.integers(1, 31).map(lambda n: 2 * n + 1)
    small = st.floats(min_value=0, max_value=0.1)
    region = {"region": st.sampled_from(["belief", "image"]), "then": st.sampled_from(["reset", "ignore"])}
    rate = st.floats(min_value=1e-6, max_value=0.49)
    reset = _mapping({}, {**region, "below": positive}) | _mapping({}, {**region, "false_rate": rate})
    return _mapping(
        {},
        {
            "cell_px": positive,
            "window": st.integers(8, 512),
            "velocity_cells": odd,
            "velocity_cell_px": positive,
            "scale_cells": odd,
            "scale_cell": st.floats(min_value=1e-3, max_value=1),
            "cut": small,
            "forget": st.floats(min_value=1, max_value=9),
            "reset": reset,
        },
    )


@pytest.fixture(scope="session")
def graphs() -> st.SearchStrategy[dict[str, Any]]:
    """Well-formed graphs as plain data: every model and key of the specification; checks may fail."""
    return _graphs()


@pytest.fixture(scope="session")
def specs(graphs: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[GraphSpec]:
    """The same graphs as specifications."""
    return graphs.map(GraphSpec.model_validate)


@pytest.fixture(scope="session")
def everything() -> dict[str, Any]:
    """One graph that uses every part of the language (and fails checks)."""
    level = {"ud_px2": 200}
    noise = {"sd_px": {"x": 1.5}, "sd_box": {"y": 0.1}, "sd_log": {"scale": 0.02}}
    part = {"offset_box": {"y": -0.4}, "size_box": {"w": 0.5}}
    nodes = {
        "a": {
            "belief": {
                "particles": {
                    "size": {"kld": {"bin_px": 5}},
                    "resample": "multinomial",
                    "when": {"ess_below": 0.5},
                }
            },
            "motion": {"random_walk": {**noise, "heavy_tail": {"weight": 0.5, "factor": 4}}},
            "modes": {
                "seen": {"mean_frames": 40, "then": {"behind": 1}},
                "behind": {"next": {"seen": 1}, "hidden": {"likelihood": 0.1, "lost_above": 0.4}},
            },
            "category": {"team": {"values": ["red", "blue"], "prior": {"red": 0.4, "blue": 0.6}}},
            "estimate": {"robust_mean": {"box": 0.1}},
            "fuse": "product",
            "adapt": {"activate": {"above": level}, "deactivate": {"below": {"ud_box": 0.5}}, "keep": 2},
            "learn": {"below": {"ud_baseline": 2}, "guard": {}},
            "lost": {
                "frames": 9,
                "score_below": 0.25,
                "uncertain_below": 0.6,
                "found_fit": 0.4,
                "regain": {"score_above": 0.6, "ud_box": 0.1, "frames": 4},
            },
            "score": {
                "logistic": {
                    "bias": -1.5,
                    "log_ud_box": -0.5,
                    "verifiers": {"v": {"agent": "hue", "coefficient": 0.5, "every": 3}},
                }
            },
            "localization_error": {"lost_sd_box": 3.5, "heavy_tail": {"weight": 0.25, "factor": 5}},
            "distractors": {"hold": 100},
            "guarantee": {"above": 0.75, "frames": 5, "afterwards": [0.25, 0.75]},
            "alarm": {"total": 30.5, "videos": 24},
        },
        "b": {
            "parent": "a",
            "fuse": {"latent": {"given": {**noise, **part}, "draw": "kernel"}},
            "ud_fields": ["x"],
        },
        "c": {
            "parent": "a",
            "fuse": {"pool": {"d": 1, "e": 0.1}},
            "motion": {"constant_velocity": noise},
            "estimate": {"nearest": {"epsilon": 0.25}},
            "belief": {"gaussian": {"filter": "unscented", "sigma": {"alpha": 0.5, "kappa": 1}}},
        },
        "f": {
            "motion": {
                "damped_velocity": {
                    "damping": 0.5,
                    "sd_log": {"scale": 0.02},
                    "inflate": {"max_factor": 3},
                    "size_reversion": {"sd_scale": 0.5},
                    "camera": "compensate",
                    "relocalize": {
                        "by": {"agents": {"max_boxes": 200}},
                        "usual": 0.01,
                        "sudden": {"reach_box": 3, "pan_box": 0.25},
                    },
                }
            },
            "estimate": "mean",
            "belief": {"particles": {"size": {"asymptotic_normal": {"error_px": 2}}, "min": 100, "max": 900}},
        },
        "g": {
            "motion": {"constant_acceleration": {"sd_acceleration_px": 2}},
            "fuse": "pool",
            "belief": {"particles": {"size": {"likelihood_sum": {"threshold": 20}}}},
        },
        "u": {"motion": {"box_velocity": {"sd_velocity_px": {"w": 1}, "leave_image": True}}},
        "r": {"adapt": {"activate": {"unless": "concentrated"}, "information": {"exploration": 1}}},
        "on_call": {"adapt": {"agents": ["d"], "on_call": {"every": 4, "agree": 0.75, "above": level}}},
        "l": {
            "motion": {
                "expressions": {"fields": {"vx": {"sd": 2}}, "drift": {"x": "x + vx * dt"}, "sd": {"x": 1.5}}
            }
        },
        "m": {"belief": {"particles": {"proposal": {"second_pass": {"by": "parents"}}}}},
        "n": {"belief": {"particles": {"proposal": {"auxiliary": {"defensive": 0.2}}}}},
        "o": {"belief": {"particles": {"proposal": {"prior_editing": {"rounds": 3}}}}},
        "p": {"belief": {"particles": {"proposal": {"iterated": {"bandwidth": 2}}}}},
        "q": {"belief": {"particles": {"proposal": {"likelihood_mixture": {"share": 0.3}}}}},
        "h": {"belief": {"grid": {"cell_px": 3, "reset": {"region": "image", "false_rate": 0.01}}}},
        "d": {"parent": "c", "agent": {"hue": {"bins": 16, "window": [5, 5]}}, "learn_rate_max": 0},
        "t": {"parent": "a", "factor": "normal(h, slope * y + 12, 8)"},
        "e": {"parent": "c", "agent": "motion", "active": False, "self_check": {"above": level, "rest": 7}},
    }
    life = {
        "birth": {
            "detector": {"background": {"min_area_px": 200}},
            "labels": ["car"],
            "pace": {"empty": 5},
            "confirm": {"of": 5},
        },
        "merge_duplicates": {"overlap": 0.8},
        "death": {"unseen_frames": 9},
        "reidentify": {"lost": False},
        "existence": {"confirm": 0.8},
        "identity": {"settle": 4},
        "associate": "marginal",
    }
    return {
        "name": "everything",
        "constants": {"slope": 0.32},
        "about": "two\nlines: \u00e9 # \U0001f600",
        "inputs": {"pan": {"file": "camera.csv"}},
        "cameras": {
            "north": {
                "calibration": "north.yaml",
                "name": "back",
                "bias_px": {"sd": 3.0, "sd_by_place": 5.0},
            },
            "south": {
                "calibration": "south.yaml",
                "clock": {"offset_s": {"sd": 0.2}, "rate": {"sd": 1e-5}},
                "cost": 2.0,
            },
        },
        "adapt": {"cost_per_step": 1.0, "undetected_m": 2.0},
        "targets": {
            "t": {"nodes": nodes, **life},
            "walker": {
                "state": {"ground": {"width": {"mean": 0.6, "sd": 0.1}}},
                "nodes": {
                    "walker": {"motion": {"constant_velocity": {"sd": {"w": 0.01}}}},
                    "view": {"parent": "walker", "camera": "north"},
                },
            },
            "drone": {
                "state": {
                    "space": {"size": {"mean": 0.5, "sd": 0.1}, "z": {"mean": -2.5, "sd": 4.0}},
                },
                "nodes": {
                    "drone": {"motion": {"constant_velocity": {"sd": {"z": 0.01}}}},
                    "view": {"parent": "drone", "camera": "north"},
                },
            },
        },
        "queries": {
            "q": {"of": "t", "probability": "x > 3", "event_above": 0.5},
            "v": {"of": ["t", "t"], "value": "a.x - b.x", "unit": "px", "interval": 0.5},
            "c": {"of": "t", "count": {"polygon": [[0, 0], [4, 0], [4, 3]], "point": "foot"}},
            "k": {"of": "t", "crosses": {"line": [[0, 0], [4, 0]], "from": "left", "hysteresis_px": 3}},
        },
        "joins": [
            {
                "between": ["t", "u"],
                "exclusion": {"nats": 2},
                "occlusion": {"stay": 0.9},
                "when": {"overlap": 0.2},
            },
            {"attachment": {"start": 0.1}},
        ],
    }
