"""Every event as the sentence that a person reads; golden."""

import re
from dataclasses import dataclass, replace
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesnet_track.journal.codec import from_json, to_json
from bayesnet_track.journal.events.beliefs import (
    BeliefReset,
    DegenerateBelief,
    MeasurementGated,
    ModeChanged,
    ParticlesResized,
    QueryPassed,
    Reappeared,
    SecondPass,
)
from bayesnet_track.journal.events.cameras import CameraKnocked, CamerasSwitched, ClockLearnt
from bayesnet_track.journal.events.event import Event
from bayesnet_track.journal.events.faults import (
    AgentMissed,
    FactorFlawed,
    FlawEnded,
    MotionFlawed,
    PairFactorChanged,
    Quarantined,
    Readmitted,
    VerifierFailed,
)
from bayesnet_track.journal.events.joins import (
    AttachmentChanged,
    DetectionRefused,
    Joined,
    OcclusionChanged,
    Parted,
    Refusal,
    RingChanged,
)
from bayesnet_track.journal.events.lives import (
    BirthsRefused,
    CandidateConfirmed,
    Continued,
    DetectionsCut,
    DetectorFailed,
    DuplicateEnded,
    Reacquired,
    Recognition,
    Returned,
    TargetDied,
    TargetStarted,
)
from bayesnet_track.journal.events.load import (
    InputRefused,
    ParticlesLimited,
    Released,
    Shed,
    TakenBack,
    Toggled,
)
from bayesnet_track.journal.events.runs import (
    FramesDropped,
    FrameSizeChanged,
    FramesMissing,
    MachineChanged,
    RunEnded,
    RunStarted,
    SourceDamaged,
    SourceStalled,
)
from bayesnet_track.journal.events.statuses import (
    AlarmEnded,
    AlarmRaised,
    AssuranceChanged,
    DistractorSeen,
    DoubtEnded,
    FoundAgain,
    IdentityDoubtful,
    Regained,
    SceneCut,
    StatusChanged,
)
from bayesnet_track.journal.events.switches import (
    Activated,
    Deactivated,
    LocallyAdapted,
    ReferenceGuarded,
    Scheduled,
    SelfStopped,
)
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.target_net import Cause, HiddenCause
from bayesnet_track.journal.text.sentences import Filter, explain, has_several_targets, why

STARTED = RunStarted(1, "two_squares", "ab" * 32, 0, "scene:two_squares", 320, 240, True, 200, 0.04)
BORN = TargetStarted(0, "1", "square", (270.0, 190.0, 40.0, 40.0), ("hue", "motion"))
OFF = Deactivated(
    9,
    "1",
    "motion",
    "square",
    Cause("ud_px2", 130, 81.2, 5, 80.4, 81.2, 1),
    "largest_kl",
    {"color_histogram": 0.31, "motion": 1.92},
)
ON = Activated(29, "1", "motion", "square", Cause("ud_px2", 200, 212.4, 3, 212.3, 212.4, 1))
STOPPED = SelfStopped(109, "1", "color", Cause("ud_px2", 2500, 3021.7, 10, 2600.5, 3021.7, 1), 160)

LIKELY = Recognition("3", 0.9312, 0.5, 41.0, 35.2, -0.1367, 2.13, 7.4, ("color", "intensity"), "new", 0.0688)
UNLIKELY = Recognition(
    "1", 0.1234, 0.5, 41.0, 235.2, -0.1367, -1.2, -0.7, ("color", "intensity"), "new", 0.8766
)

GATED = Refusal(
    26, "seen", (276.5, 129.5, 30.0, 60.0), (292.5, 129.5, 30.0, 60.0), 1, 32.7, 32.5, 18.4668, 0.999,
    0.3, 0.0, 0.1886, 0.0,
)  # fmt: skip

GOLDEN = [
    (
        Scheduled(21, "1", ("net",), "t", 0.83, 0.7, 3, 24, 21),
        "frame 21: with and without net the boxes overlap by 0.83 ≥ 0.7 → net again in 3 frames, frame 24; "
        "would have run in the next one at agree > 0.83",
    ),
    (
        Scheduled(21, "1", ("net",), "t", 0.0, 0.7, 1, 22, 21),
        "frame 21: with and without net the boxes overlap by 0 < 0.7 → net in every frame; would have rested "
        "at no value of agree",
    ),
    (
        Scheduled(21, "1", ("net",), "t", 1.0, 0.7, 3, 24, 21),
        "frame 21: with and without net the boxes overlap by 1 ≥ 0.7 → net again in 3 frames, frame 24; "
        "would have rested at any value of agree",
    ),
    (
        STARTED,
        "run of two_squares (abababababab) on scene:two_squares: 320x240, 200 frames, 25 frames per second; "
        "seed 0",
    ),
    (
        RunStarted(1, "general", "0" * 64, 7, "car.mkv", 640, 480, False, None, 1 / 29.97),
        "run of general (000000000000) on car.mkv: 640x480 gray, 29.97 frames per second; seed 7",
    ),
    (BORN, "frame 0: target 1 starts as square, centre 270, 190, 40 x 40 px → hue, motion on"),
    (
        OFF,
        "frame 9: UD 81.2 px² < 130 for 5 frames → motion off "
        "(largest KL 1.92 against color_histogram 0.31); would have stayed on at deactivate ≤ 80.4",
    ),
    (
        Deactivated(
            9,
            "1",
            "hue",
            "square",
            Cause("ud_px2", 130, 81, 1, 81, 81, 1),
            "min_contribution_per_ms",
            {"hue": 0.5, "motion": 2.0},
        ),
        "frame 9: UD 81 px² < 130 for 1 frame → hue off "
        "(min contribution per ms 0.50 against motion 2.00); would have stayed on at deactivate ≤ 81",
    ),
    (
        ON,
        "frame 29: UD 212 px² > 200 for 3 frames → motion on; would have stayed off at activate ≥ 213",
    ),
    (
        Activated(30, "1", "motion", "square", Cause("ud_box", 0.125, 0.1327, 3, 0.1301, 212.4, 1600), 1.234),
        "frame 30: UD 0.133 × box area (212 px²) > 0.125 × box area (200 px²) for 3 frames → motion on "
        "(helped most so far: 1.23 nats); would have stayed off at activate ≥ 0.131 × box area (209 px²)",
    ),
    (
        Activated(30, "1", "motion", "square", Cause("ud_baseline", 2.0, 2.0004, 1, 2.0004, 188.04, 94)),
        "frame 30: UD 2.0004 × baseline (188.04 px²) > 2 × baseline (188 px²) for 1 frame → motion on; "
        "would have stayed off at activate ≥ 2.01 × baseline (189 px²)",
    ),
    (Activated(31, "1", "motion", "square", None), "frame 31: no agent was active → motion on"),
    (
        LocallyAdapted(100, "1", "hue", 1, Cause("ud_px2", 2500, 2731, 1, 2731, 2731, 1)),
        "frame 100: hue: its own UD 2731 px² > 2500 for 1 frame → adapted itself, attempt 1",
    ),
    (
        STOPPED,
        "frame 109: color: its own UD 3022 px² > 2500 for 10 frames → stopped itself; "
        "may be switched on again from frame 160; would have continued at self_check ≥ 2601",
    ),
    (
        Quarantined(110, "1", "hue", "3 of 500 values are NaN", 120),
        "frame 110: hue failed: 3 of 500 values are NaN → paused for 10 frames, tried again in frame 120",
    ),
    (
        Quarantined(110, "1", "hue", "3 of 500 values are NaN", 150, 3),
        "frame 110: hue failed, the 3rd time in a row: 3 of 500 values are NaN → paused for 40 frames, "
        "tried again in frame 150",
    ),
    (
        Quarantined(0, "1", "hue", "needs colour, and the source is gray"),
        "frame 0: hue failed: needs colour, and the source is gray → off for the rest of the run",
    ),
    (
        Readmitted(119, "1", "hue", True, 1, 10),
        "frame 119: hue was paused for 10 frames after failing → on again",
    ),
    (
        Readmitted(149, "1", "hue", False, 3, 40),
        "frame 149: hue was paused for 40 frames after failing 3 times in a row → may be switched on again",
    ),
    (
        Shed(115, "1", "hue", 23.04, 20.0, 3, 10, 22.41, {"hue": 0.021, "motion": 0.4}),
        "frame 115: 3 of the last 10 frames were late, 23 ms > 20 → hue off (0.021 nats per ms against "
        "motion 0.4); would have stayed on at a budget ≥ 22.5 ms",
    ),
    (
        TakenBack(170, "1", "hue", 9.12, 12.4, 20.0, 50),
        "frame 170: 50 frames took at most 9.12 of 20 ms, with hue 12.4 ms are expected → hue on again",
    ),
    (
        ParticlesLimited(116, "1", 250, 500, 23.04, 20.0),
        "frame 116: frames took 23 of 20 ms → at most 250 hypotheses, 500 before",
    ),
    (
        ParticlesLimited(176, "1", None, 250, 5.2, 20.0),
        "frame 176: frames took 5.2 of 20 ms → as many hypotheses as asked for, 250 before",
    ),
    (
        MachineChanged(115, ("numpy 2.4.0, now 2.4.6", "NumPy CPU: without AVX2")),
        "frame 115: the run continues on another machine or with other libraries: numpy 2.4.0, now 2.4.6; "
        "NumPy CPU: without AVX2",
    ),
    (
        FramesDropped(117, 12),
        "frame 117: 12 frames dropped, because newer ones had arrived",
    ),
    (
        SourceStalled(118, 2.04, "no picture for 2 s", 1),
        "frame 118: source stalled for 2.0 s: no picture for 2 s; reconnecting, attempt 1",
    ),
    (
        Toggled(111, "1", "hue", False),
        "frame 111: switched by hand → hue off; no rule switches it until it is released",
    ),
    (
        Released(112, "1", "hue"),
        "frame 112: released by hand → the rules may switch hue again",
    ),
    (
        InputRefused(113, "1", "hue", "there is no target 1"),
        "frame 113: the request for hue is refused: there is no target 1",
    ),
    (
        AgentMissed(114, "1", "hue", "its process died", "learning"),
        "frame 114: hue gave no answer while learning: its process died → left out of this frame",
    ),
    (
        StatusChanged(120, "1", "lost", Cause("ud_box", 1.0, 1.2, 3, 1.1, 1920, 1600)),
        "frame 120: UD 1.2 × box area (1920 px²) > 1 × box area (1600 px²) for 3 frames → target 1 lost; "
        "would not have been lost at lost.above ≥ 1.1 × box area (1760 px²)",
    ),
    (
        StatusChanged(130, "1", "tracking", Cause("ud_px2", 900, 870, 3, 860, 870, 1)),
        "frame 130: UD 870 px² ≤ 900 for 3 frames → target 1 found again",
    ),
    (
        StatusChanged(131, "1", "lost", None, "no agent is active"),
        "frame 131: no agent is active → target 1 lost",
    ),
    (
        StatusChanged(132, "1", "lost", hidden=HiddenCause(0.5, 0.931)),
        "frame 132: hidden with probability 0.931 > 0.5 → target 1 hidden; would have stayed at lost_above ≥ "
        "0.931",
    ),
    (
        ModeChanged(132, "1", "behind", "seen", 0.931, 0.0421, 5.72, 3.125, 0.931),
        "frame 132: the frame's evidence is 5.72 nats higher in mode behind than in seen → target 1 in mode "
        "behind with probability 0.93, predicted 0.042; hidden with probability 0.93; would have stayed in "
        "seen at ≤ 3.12 nats",
    ),
    (
        ModeChanged(133, "1", "turn", "straight", 0.51, 0.52, -0.04, -0.08),
        "frame 133: the frame's evidence is 0.04 nats lower in mode turn than in straight → target 1 in mode "
        "turn with probability 0.51, predicted 0.52; would have stayed in straight at ≤ -0.08 nats",
    ),
    (
        QueryPassed(21, "1", "in_goal", 0.9136, 0.9, True),
        "frame 21: in_goal of target 1 probable: 0.914 ≥ 0.9 (no event if event_above > 0.914)",
    ),
    (
        QueryPassed(22, "1", "near", 1.0, 0.9, True, "2"),
        "frame 22: near of targets 1 and 2 probable: 1 ≥ 0.9 (at any event_above)",
    ),
    (
        QueryPassed(23, "1", "near", 0.31, 0.9, False, "2"),
        "frame 23: near of targets 1 and 2 no longer probable: 0.31 < 0.9",
    ),
    (
        IdentityDoubtful(230, "4", "9", 211, 0.224, 0.776, 1.8, -0.5),
        "frame 230: identities 4 and 9 could be swapped since frame 211, probability 0.22; decided by "
        "appearance +1.8, motion -0.5 nats",
    ),
    (
        IdentityDoubtful(230, "12", "9", 211, 0.6, 0.4, 0.0, -0.4, False, ("7",)),
        "frame 230: target 12 could be 9 since frame 211, probability 0.60; decided by appearance +0.0, "
        "motion -0.4 nats; also close, and not asked about: 7",
    ),
    (
        DegenerateBelief(12, "1", "all weights are 0"),
        "frame 12: no hypothesis of target 1 can be used: all weights are 0; the prediction stays",
    ),
    (
        FactorFlawed(12, "1", "road", 0, 500, True),
        "frame 12: factor road of target 1 is 0 for all hypotheses → it is left out until it is "
        "above 0 for some",
    ),
    (
        FactorFlawed(12, "1", "road", 3, 500, False),
        "frame 12: factor road of target 1 has no value for 3 of 500 hypotheses (such as 0 / 0) → they count "
        "as impossible",
    ),
    (
        FactorFlawed(12, "1", "road", 500, 500, True),
        "frame 12: factor road of target 1 has no value for 500 of 500 hypotheses (such as 0 / 0) → it is "
        "left out until it is above 0 for some",
    ),
    (
        MotionFlawed(12, "1", "drift x", 3, 500),
        "frame 12: drift x of target 1 has no value for 3 of 500 hypotheses (such as 0 / 0) → it stays as it "
        "is for these",
    ),
    (
        MotionFlawed(12, "1", "sd x", 3, 500),
        "frame 12: sd x of target 1 has no value for 3 of 500 hypotheses (such as 0 / 0) → these have no "
        "such noise",
    ),
    (FlawEnded(19, "1", "road"), "frame 19: road of target 1 has a value for every hypothesis again"),
    (
        PairFactorChanged(12, "1", "2", 40, 800, False),
        "frame 12: the factor of target 1 and target 2 has no value for 40 of 800 pairs of hypotheses "
        "(such as 0 / 0) → they count as impossible",
    ),
    (
        PairFactorChanged(12, "1", "2", 0, 800, True),
        "frame 12: the factor of target 1 and target 2 is 0 for all pairs of hypotheses → it is left out "
        "until it is above 0 for some",
    ),
    (
        PairFactorChanged(14, "1", "2", 0, 800, False),
        "frame 14: the factor of target 1 and target 2 has a value again, and is above 0 for some pairs",
    ),
    (
        BeliefReset(33, "1", 0.2834, 1.0, "belief", 3600.0, "reset"),
        "frame 33: γ 0.283 < 1 over the belief's bounding box (3600 px²) → the belief of target 1 starts "
        "again from the frame's likelihood; would not have happened at below ≤ 0.283",
    ),
    (
        BeliefReset(34, "1", 0.00512, 0.0177, "image", 76800.0, "ignore"),
        "frame 34: γ 0.00512 < 0.0177 over the image (76800 px²) → the frame's evidence is ignored; "
        "would not have happened at below ≤ 0.00512",
    ),
    (
        MeasurementGated(40, "1", "detector", 31.5, 9.21034037, 0.99, 2, 0.99999985562, 0),
        "frame 40: detector measured d² 31.5 > 9.21 from the prediction (gate 0.99, 2 degrees of freedom) "
        "→ not used; nothing else was measured near the prediction; would have been used at gate ≥ 0.9999999",
    ),
    (
        MeasurementGated(41, "1", "detector", 5.02, 3.84145882, 0.95, 1, 0.97494, 1),
        "frame 41: detector measured d² 5.02 > 3.84 from the prediction (gate 0.95, 1 degree of freedom) "
        "→ not used; would have been used at gate ≥ 0.98",
    ),
    (
        MeasurementGated(42, "1", "detector", 4000.0, 9.21034037, 0.99, 2, 1.0, 0),
        "frame 42: detector measured d² 4000 > 9.21 from the prediction (gate 0.99, 2 degrees of freedom) "
        "→ not used; nothing else was measured near the prediction; would have been used at gate: 1",
    ),
    (
        SecondPass(41, "1", "second_pass", 4.6123, 2.0, 500, 500, 6.2, 310.4),
        "frame 41: KL(posterior, prior) 4.61 nats > 2 → second pass of 500 hypotheses, 6 effective before, "
        "310 after; no second pass at above_kl ≥ 4.62",
    ),
    (
        SecondPass(42, "1", "iterated", 2.0004, 2.0, 500, 1000, 40.0, 700.0),
        "frame 42: KL(posterior, prior) 2.0004 nats > 2 → second pass of 1000 hypotheses, by iterated, 40 "
        "effective before, 700 after; no second pass at above_kl ≥ 2.01",
    ),
    (
        Reappeared(*(41, "1", "agents", 200, 0.9312, 0.5, 0.1, 0.008141, 210.4, 84.25, 95.2, 5120.0, 1024.0)),
        "frame 41: UD 5120 px² > 1024; 200 hypotheses searched the whole frame, by agents, and hold "
        "0.931 > 0.5 of the belief → target 1 reappears at 210.4, 84.25, 95.2 px away; would not have at "
        "share ≤ 0.00814",
    ),
    (
        Reappeared(
            *(41, "1", "agents", 100, 0.9312, 0.5, 0.1, 0.008141, 210.4, 84.25, 95.2, 5120.0, 0.0, 123.4)
        ),
        "frame 41: 100 hypotheses searched up to 123 px around its last place, by agents, and hold "
        "0.931 > 0.5 of the belief → target 1 reappears at 210.4, 84.25, 95.2 px away; would not have at "
        "share ≤ 0.00814",
    ),
    (
        Reappeared(
            *(41, "1", "agents", 250, 0.9312, 0.5, 0.5, 0.02141, 210.4, 84.25, 95.2, 0.0, 0.0, 123.4),
            *(0.01234, 0.15),
        ),
        "frame 41: fit 0.0123 < 0.15 of the usual one; 250 hypotheses searched up to 123 px around its last "
        "place, by agents, and hold 0.931 > 0.5 of the belief → target 1 reappears at 210.4, 84.25, 95.2 px "
        "away; would not have at share ≤ 0.0214",
    ),
    (
        Reappeared(
            *(81, "1", "network", 0, 0.9974, 0.5, 0.9, 0.02714, 457.6, 63.42, 282.0, 30.0, 0.0, 1082.3),
        ),
        "frame 81: network searched up to 1082 px around its last place and found the target with "
        "probability 0.997 > 0.5 → target 1 reappears at 457.6, 63.42, 282 px away; would not have at "
        "share ≤ 0.0271",
    ),
    (
        ParticlesResized(
            *(30, "1", 798, 256, "kld_revised", 797.2, "", True),
            *("x", 12.0, 15, 4.0, 7.47, None, "error", 0.1, 0.2491),
        ),
        "frame 30: x spans 15 bins of 4 px, 7.47 hypotheses are worth one drawn from the posterior, "
        "12 effective: this frame's evidence asks for 797 hypotheses (kld_revised, error 0.1) "
        "→ 798, 256 before; would have stayed near 256 at error ≥ 0.25",
    ),
    (
        ParticlesResized(
            *(31, "1", 500, 900, "kld", 40.0, "min", False),
            *("y", 60.0, 1, 10.0, 1.0, None, "error", 0.1, None),
        ),
        "frame 31: y spans 1 bin of 10 px, 60 effective: the last frame's evidence asks for 40 hypotheses "
        "(kld, error 0.1) → 500, held by min, 900 before",
    ),
    (
        ParticlesResized(
            *(32, "1", 5000, 900, "asymptotic_normal", 9e3, "max", False),
            *("x", 60.0, None, None, 2.0, 7.7, "error_px", 0.5, 1.4173),
        ),
        "frame 32: x has an sd of 7.7 px, 2 hypotheses are worth one drawn from the posterior, 60 effective: "
        "the last frame's evidence asks for 9000 hypotheses (asymptotic_normal, error_px 0.5) "
        "→ 5000, held by max, 900 before; would have stayed near 900 at error_px ≥ 1.418",
    ),
    (
        ParticlesResized(
            *(33, "1", 300, 200, "likelihood_sum", 90.0, "ess", True),
            *("", 4.0, None, None, None, None, "threshold", 30.0, 20.06),
        ),
        "frame 33: 4 effective: this frame's evidence asks for 90 hypotheses (likelihood_sum, threshold 30) "
        "→ 300, too few effective to reduce it, 200 before; would have stayed near 200 at threshold ≤ 20",
    ),
    (
        FramesMissing(50, 3.0),
        "frame 50: 3 frame intervals missing before it; the belief is predicted over the gap",
    ),
    (
        FramesMissing(50, 1.0),
        "frame 50: 1 frame interval missing before it; the belief is predicted over the gap",
    ),
    (
        FrameSizeChanged(60, 640, 480, "stop"),
        "frame 60: the frame size changes to 640x480; the run stops",
    ),
    (
        FrameSizeChanged(60, 640, 480, "rescale"),
        "frame 60: the frame size changes to 640x480; they are scaled to the first frame's size",
    ),
    (SourceDamaged(61, "invalid NAL unit"), "frame 61: the source is damaged: invalid NAL unit"),
    (RunEnded(200, 200, True, "end_of_source"), "run ended after 200 frames: end of source"),
    (
        RunEnded(120, 200, False, "source_damaged"),
        "run ended early after 120 of 200 frames: source damaged",
    ),
    (
        CandidateConfirmed(3, "2", "square", "gray_level", 0, 3, 4, 0.8214, None),
        "frame 3: gray_level detected it in 3 of 4 evaluations since frame 0, mean score 0.82 "
        "→ target 2 is new",
    ),
    (
        CandidateConfirmed(3, "2", "square", "gray_level", 3, 1, 1, 0.8214, UNLIKELY),
        "frame 3: gray_level detected it in 1 of 1 evaluation, mean score 0.82 → target 2 is new: it is "
        "target 1 with "
        "probability 0.123 < 0.5 (unseen for 41 frames -0.14, 235 px off -1.20, appearance by "
        "color, intensity -0.70 "
        "nats); would have been target 1 at min_probability ≤ 0.123",
    ),
    (
        CandidateConfirmed(
            3, "2", "square", "gray_level", 3, 1, 1, 0.8214, replace(UNLIKELY, contested=True)
        ),
        "frame 3: gray_level detected it in 1 of 1 evaluation, mean score 0.82 → target 2 is new: "
        "it is target 1 "
        "with probability 0.123 < 0.5 (unseen for 41 frames -0.14, 235 px off -1.20, appearance by color, "
        "intensity -0.70 nats)",
    ),
    (
        Returned(60, "3", "square", BORN.box, ("color",), LIKELY),
        "frame 60: a detection is target 3 with probability 0.931 ≥ 0.5 (unseen for 41 frames "
        "-0.14, 35 px off "
        "+2.13, appearance by color, intensity +7.40 nats; next a new target, 0.069) → target 3 is "
        "back, centre "
        "270, 190, 40 x 40 px; would have been a new target at min_probability ≥ 0.94",
    ),
    (
        Reacquired(60, "3", BORN.box, replace(LIKELY, probability=1.0, rival="1", rival_probability=2e-12)),
        "frame 60: a detection is target 3 with probability 1 ≥ 0.5 (unseen for 41 frames -0.14, 35 px off "
        "+2.13, appearance by color, intensity +7.40 nats; next target 1, 2e-12) → target 3 found "
        "again, centre "
        "270, 190, 40 x 40 px",
    ),
    (
        Continued(60, "3", BORN.box, 58, 0.374, 1.25),
        "frame 60: detections began in frame 58, when those of target 3 had ended, 0.374 sides a frame from "
        "it ≤ 1.25 → target 3 goes on with them, centre 270, 190, 40 x 40 px; would have been a new target "
        "at continue_box < 0.37",
    ),
    (
        Reacquired(60, "3", BORN.box, replace(LIKELY, contested=True)),
        "frame 60: a detection is target 3 with probability 0.931 ≥ 0.5 (unseen for 41 frames -0.14, 35 px "
        "off +2.13, appearance by color, intensity +7.40 nats; next a new target, 0.069) → target 3 found "
        "again, centre 270, 190, 40 x 40 px",
    ),
    (
        TargetDied(80, "3", "lost", 30, 30, True),
        "frame 80: lost for 30 frames → target 3 ends, remembered; would have continued at lost_frames ≥ 31",
    ),
    (
        TargetDied(80, "3", "unseen", 9, 9, False),
        "frame 80: not detected for 9 frames → target 3 ends; would have continued at unseen_frames ≥ 10",
    ),
    (
        TargetDied(80, "3", "lost", 13, 13, False, unseen_frames=15),
        "frame 80: lost for 13 frames → target 3 ends; would have continued at lost_frames ≥ 14 and "
        "unseen_frames ≥ 16",
    ),
    (
        TargetDied(80, "3", "unseen", 9, 9, False, existence=0.0124, end=0.05),
        "frame 80: not detected for 9 frames → target 3 ends; would have continued at unseen_frames ≥ 10 and "
        "existence.end ≤ 0.0124",
    ),
    (
        DuplicateEnded(9, "3", "1", 0.8349, 0.7, 5),
        "frame 9: its belief overlaps that of target 1 by 0.834 ≥ 0.7 for 5 frames → target 3, the younger, "
        "ends; would have continued at overlap > 0.835 or frames > 5",
    ),
    (
        BirthsRefused(9, "square", "motion", 20, 20, 31, 12),
        "frame 9: 20 targets of square live, the maximum → 12 new targets refused, 31 so far; would "
        "have started at max_targets ≥ 32",
    ),
    (
        DetectionRefused(28, "1", GATED),
        "frame 28: in frame 26 a detection 16 px from target 1 went to no target: d² 32.7 > 18.5 (gate "
        "0.999) → target 1 had none; would have been its own at gate ≥ 0.999999, or continue_box ≥ 0.19",
    ),
    (
        DetectionRefused(28, "1", replace(GATED, box=(268.5, 129.5, 60.0, 90.0), place_d2=9.0, gap=4)),
        "frame 28: in frame 26 a detection 24 px from target 1, 60 x 90 px where 30 x 60 px was expected, "
        "went to no target: d² 32.7 > 18.5, mostly by its size (gate 0.999) → target 1 had none, 4 frames "
        "after its last one; would have been its own at gate ≥ 0.999999, or continue_box ≥ 0.19",
    ),
    (
        DetectionRefused(28, "1", replace(GATED, d2=400.0, place_d2=390.0, continue_box=0.5)),
        "frame 28: in frame 26 a detection 16 px from target 1 went to no target: d² 400 > 18.5 (gate "
        "0.999) → target 1 had none; its motion is 4.7 times as large as expected: no gate below 1 would "
        "have kept it",
    ),
    (
        DetectionRefused(28, "1", replace(GATED, overlap=0.1537, min_overlap=0.5, continue_box=0.5)),
        "frame 28: in frame 26 a detection 16 px from target 1 went to no target: d² 32.7 > 18.5 (gate "
        "0.999) and overlap 0.154 < 0.5 (min_overlap) → target 1 had none; would have been its own at gate ≥ "
        "0.999999 and min_overlap ≤ 0.153",
    ),
    (
        DetectionRefused(28, "1", replace(GATED, d2=None, overlap=0.1537, min_overlap=0.2)),
        "frame 28: in frame 26 a detection 16 px from target 1 went to no target: overlap 0.154 < 0.2 "
        "(min_overlap) → target 1 had none; would have been its own at min_overlap ≤ 0.153",
    ),
    (
        DetectionRefused(28, "1", replace(GATED, d2=17.0, continue_box=0.5, is_shared=True)),
        "frame 28: in frame 26 a detection 16 px from target 1 went to no target: it is more probably a "
        "false alarm or another's, d² 17.0 → target 1 had none; its motion is 2.1 times as large as "
        "expected: no gate below 1 would have kept it",
    ),
    (
        DetectionRefused(28, "1", replace(GATED, d2=17.0)),
        "frame 28: in frame 26 a detection 16 px from target 1 went to no target: the target looks different "
        "(appearance) → target 1 had none; would have been its own at a smaller appearance, or "
        "continue_box ≥ 0.19",
    ),
    (
        DetectionsCut(9, "blobs", 32, 28, 10),
        "frame 9: blobs found 60 → the best 32 are used, not 28, in 10 frames so far; would all be used at "
        "max_count ≥ 60",
    ),
    (
        DetectionsCut(0, "detections", 10000, 1, 1),
        "frame 0: detections found 10001 → the best 10000 are used, not 1; max_count is at most 10000",
    ),
    (
        ClockLearnt(40, "south", 0.3921, 0.0312, 0.0, 0.2),
        "frame 40: clock of camera south: 0.392 ± 0.031 s late (before +0.000 ± 0.200 s)",
    ),
    (
        ClockLearnt(90, "south", -0.0312, 0.0012, 0.3921, 0.0312),
        "frame 90: clock of camera south: 0.0312 ± 0.0012 s early (before +0.3921 ± 0.0312 s)",
    ),
    (
        CameraKnocked(820, "north", 12.1, -7.2, 2.64, 819, 4, 4, 57.3),
        "frame 820: camera north is 14 px off since frame 819 (+12 px across, -7 px down, ± 2.6 px): 4 of 4 "
        "targets were so far off there and in no other camera (chi-square 57); its bias is widened and "
        "learnt anew, unless any one target had made up half of it",
    ),
    (
        CameraKnocked(9, "east", 300.0, 400.0, 2.64, 8, 3, 4, 331702951.2),
        "frame 9: camera east is 500 px off since frame 8 (+300 px across, +400 px down, ± 2.6 px): 3 of 4 "
        "targets were so far off there and in no other camera (chi-square far above 30); its bias is widened "
        "and learnt anew, unless any one target had made up half of it",
    ),
    (
        CamerasSwitched(12, ("north",), ("east",), 5, 0.03, 0.09, 0.036, 0.31, "south", 0.05, 0.712),
        "frame 12: camera north on, east off: expected mean UD of 5 targets 0.03 m² with it, 0.09 without; "
        "next south: 0.05; unless south cost at most 0.712",
    ),
    (
        CamerasSwitched(13, ("north", "south"), ("east",), 1, 0.02, 0.09, 0.036, 0.31, "", 0.02, 0.0),
        "frame 13: cameras north, south on, east off: expected mean UD 0.02 m² with them, 0.09 without",
    ),
    (
        CamerasSwitched(14, ("north",), (), 0, 0.0, 0.0, 0.42, 0.2, "south", 0.0, 0.9),
        "frame 14: camera north on: 0.42 undetected targets are expected; unless south cost at most 0.9",
    ),
    (
        DetectorFailed(4, "motion", "raised ValueError: no", 14),
        "frame 4: detector motion failed: raised ValueError: no → paused for 10 frames, tried "
        "again in frame 14",
    ),
    (
        DetectorFailed(14, "motion", "raised ValueError: no", 34, 2),
        "frame 14: detector motion failed: raised ValueError: no → paused for 20 frames "
        "after 2 failures in a row, tried again in frame 34",
    ),
    (
        Joined(20, "1", "2", ("person", "box"), 0, 0.1234, 0.05),
        "frame 20: the beliefs of target 1 and target 2 (person and box) overlap by 0.1234 ≥ 0.05 → joined; "
        "would have stayed on their own at overlap > 0.1234",
    ),
    (
        Parted(90, "1", "2", 0.0, 0.05, 5, 0.0312, 70),
        "frame 90: the beliefs of target 1 and target 2 overlap by 0 < 0.05 for 5 frames → parted, after 70 "
        "frames together; would have stayed joined at overlap ≤ 0.0312 or apart_frames > 5",
    ),
    (
        Parted(90, "1", "2", 0.0, 0.05, 5, 0.0, 1),
        "frame 90: the beliefs of target 1 and target 2 overlap by 0 < 0.05 for 5 frames → parted, after 1 "
        "frame together; would have stayed joined at apart_frames > 5",
    ),
    (
        OcclusionChanged(40, "2", "1", True, 0.6234, 0.5, 0.971, 0),
        "frame 40: target 1 is in front with probability 0.97 and hides 0.623 > 0.5 of target 2 → target 2 "
        "hidden, does not learn",
    ),
    (
        OcclusionChanged(52, "2", "1", False, 0.4, 0.5, 0.9, 12),
        "frame 52: target 1 hides 0.4 ≤ 0.5 of target 2 → target 2 visible again after 12 frames",
    ),
    (
        AttachmentChanged(31, "2", "1", True, 0.931, 0),
        "frame 31: target 2 moves as target 1 does with probability 0.93 → carried by target 1",
    ),
    (
        AttachmentChanged(71, "2", "1", False, 0.04, 40),
        "frame 71: target 2 moves as target 1 does with probability 0.04 → no longer carried, after 40 "
        "frames",
    ),
    (
        RingChanged(12, "1", "3", True, 0.0823, ("1", "2", "3")),
        "frame 12: targets 1, 2, 3 are joined in a ring → target 1 and target 3, with an overlap of 0.082 "
        "the least, are left out: each receives only the other's own belief",
    ),
    (
        RingChanged(15, "1", "3", False, 0.07, ("1", "2", "3")),
        "frame 15: no ring is closed by target 1 and target 3 any more → "
        "their joint belief is of the tree again",
    ),
    (
        DistractorSeen(50, "1", 80.0, 60.0, 0.9, 1.5, 4.0, 0.3, 250),
        "frame 50: look-alike at 80, 60, 0.9 box sides away, only 1.5 < 4 nats less likely than the target → "
        "score at most 0.5 for 250 frames, or until motion shows which is followed; ignored with "
        "within_nats ≤ 1.5",
    ),
    (
        DoubtEnded(60, "1", 0.25, 1.5, 0.5, 241),
        "frame 60: target is 0.25 box sides from where it was heading, and 1.5 from where the look-alike was "
        "heading → score no longer limited; at 0.75 it would have stayed so for 241 frames",
    ),
    (
        DoubtEnded(60, "1", 0.25, 1.3333, 0.5, 1),
        "frame 60: target is 0.25 box sides from where it was heading, and 1.33 from where the look-alike "
        "was heading → score no longer limited; at 0.667 it would have stayed so for 1 frame",
    ),
    (
        DistractorSeen(50, "1", 80.0, 60.0, 0.9, 1.5, 4.0, 0.3, 250, 2.25),
        "frame 50: look-alike at 80, 60, 0.9 box sides away, only 1.5 < 4 nats less likely than the target → "
        "score at most 0.5 for 250 frames, or until motion shows which is followed; ignored with "
        "within_nats ≤ 2.25",
    ),
    (
        DistractorSeen(50, "1", 80.0, 60.0, 0.9, -0.5, 4.0, 0.3, 250, -0.25),
        "frame 50: look-alike at 80, 60, 0.9 box sides away, 0.5 nats more likely than the target → score at "
        "most 0.5 for 250 frames, or until motion shows which is followed; no within_nats ignores it",
    ),
    (
        AssuranceChanged(50, "1", False, 0.9125, 0.92, 10, 0.05),
        "frame 50: mean score of 10 frames 0.912 ≤ 0.92 → target 1 at most uncertain, for the guarantee of "
        "5 %; would have stayed at guarantee.above < 0.912",
    ),
    (
        AssuranceChanged(50, "1", True, 0.9375, 0.92, 1, 0.05),
        "frame 50: mean score of 1 frame 0.938 > 0.92 → target 1 may be called tracking again; not at "
        "guarantee.above 0.938",
    ),
    (
        AlarmRaised(50, "1", 21.25, 0.05, 43, 25),
        "frame 50: e-value 21.2 ≥ 20, scores low since frame 43 → alarm: target 1 is no longer held; false "
        "in at most 5 % of videos like the 25 calibrated on",
    ),
    (
        FoundAgain(50, "1", 0.82, 0.4, 0.25, 3, 0.53, 20, 31.4),
        "frame 50: target 1, missing since frame 20, recognised 31.4 px from where it was held: 0.82 of its "
        "usual fit ≥ 0.4, the last of 3 frames; would have stayed missing at found_fit > 0.53",
    ),
    (
        FoundAgain(50, "1", 0.82, 0.4, 0.25, 3, 0.53, 20, 31.4, 0.91, 0.55),
        "frame 50: target 1, missing since frame 20, recognised 31.4 px from where it was held: 0.82 of its "
        "usual fit ≥ 0.4, the last of 3 frames, score 0.91 ≥ 0.55; would have stayed missing at "
        "found_fit > 0.53",
    ),
    (
        Regained(50, "1", 3, 0.6751, 0.55, 0.55, 0.5731, 0.00376, 0.05, 0.00808, 0.0237, 0.05, None),
        "frame 50: agents and verifiers agree on where target 1 is for 3 frames: score without its limits "
        "0.675 ≥ 0.55, UD 0.00376 × box area ≤ 0.05 → its fit 0.0237 of 0.05 no longer limits the score; "
        "would have stayed so at regain.score_above > 0.574 or regain.ud_box < 0.00808",
    ),
    (
        Regained(50, "1", 3, 0.81, 0.742, 0.55, 0.62, 0.004, 0.05, 0.0081, 0.024, 0.05, 20),
        "frame 50: agents and verifiers agree on where target 1, missing since frame 20, is for 3 frames: "
        "score without its limits 0.81 ≥ 0.742, UD 0.004 × box area ≤ 0.05 → its fit 0.024 of 0.05 no longer "
        "limits the score; would have stayed so at regain.score_above > 0.62 or regain.ud_box < 0.0081",
    ),
    (
        SceneCut(50, "1", 0.83, 0.25, 0.9, 0.765),
        "frame 50: scene cut: distance from the scene before 0.83 > 0.25 (colours 0.9, structure 0.77) → "
        "target 1 lost; would have been ignored at scene_cut ≥ 0.83",
    ),
    (
        VerifierFailed(50, "1", "texture", "raised RuntimeError: no memory"),
        "frame 50: verifier texture raised RuntimeError: no memory → not asked again for this target; the "
        "score goes on with what it last said",
    ),
    (AlarmEnded(50, "1"), "frame 50: scores are high again → alarm for target 1 ends"),
    (
        ReferenceGuarded(50, "1", "hue", True, -0.31, -1.42, 1.0, 0.05, 0),
        "frame 50: hue: the estimate scores -0.31 nats by its reference, -1.42 by its slow one: "
        "1.11 > 1 apart → stops learning, pulled back by 0.05 a frame; "
        "would have learnt at apart_nats ≥ 1.11",
    ),
]


@pytest.mark.parametrize(("event", "sentence"), GOLDEN, ids=lambda value: type(value).__name__)
def test_sentences(event, sentence):
    assert explain(event) == sentence


def test_every_kind_of_event_has_a_sentence():
    explained = {type(event) for event, _ in GOLDEN}
    assert explained == {*get_args(Event)}


def test_an_event_without_a_sentence_is_not_told_as_another():
    """mypy proves that there is none; were one added unproven, it would not pass for a degenerate belief."""

    @dataclass(frozen=True)
    class Unlisted:
        frame: int = 3
        target: str = "1"
        reason: str = "new"

    with pytest.raises(AttributeError, match="describe"):
        explain(Unlisted())


def test_the_target_can_be_named():
    assert explain(ON, name_target=True).startswith("frame 29, target 1: UD 212 px²")
    assert explain(BORN, name_target=True) == explain(BORN), "it is named already"
    assert not has_several_targets([BORN, ON])
    assert has_several_targets([BORN, ON, replace(BORN, target="2")])


@given(
    level=st.floats(1e-3, 1e5),
    excess=st.lists(st.floats(1e-5, 10), min_size=1, max_size=5),
    unit=st.sampled_from(["ud_px2", "ud_box", "ud_baseline"]),
)
def test_the_turning_threshold_really_turns(level, excess, unit):
    """At the printed threshold some frame of the streak is no longer above it; at the set one all are."""
    values = [level * (1 + more) for more in excess]
    cause = Cause(unit, level, values[-1], len(values), min(values), values[-1] * 7, 7.0)
    sentence = explain(Activated(1, "1", "a", "b", cause))
    printed = float(re.search(r"activate ≥ ([\d.]+)", sentence)[1])
    assert printed >= min(values) * (1 - 1e-8)
    value, shown = re.search(r"UD ([\d.]+).*? > ([\d.]+)", sentence).groups()
    assert float(value) > float(shown)
    below = Cause(unit, level, level / 2, 2, level / (1 + excess[0]), level * 3.5, 7.0)
    sentence = explain(Deactivated(1, "1", "a", "b", below, "largest_kl", {}))
    assert float(re.search(r"deactivate ≤ ([\d.]+)", sentence)[1]) <= level / (1 + excess[0]) * (1 + 1e-8)


EVENTS = [event for event, _ in GOLDEN]


def test_filters():
    assert all(Filter().keeps(event) for event in EVENTS)
    assert [e for e in EVENTS if Filter(node="color").keeps(e)] == [STOPPED]
    by_governor = [e for e in EVENTS if Filter(node="square").keeps(e)]
    assert by_governor and all(isinstance(e, Activated | Deactivated) for e in by_governor)
    kinds = [type(e) for e in EVENTS if Filter(kind="status_changed", frames=(121, 132)).keeps(e)]
    assert kinds == [StatusChanged, StatusChanged]
    assert [e for e in EVENTS if Filter(frames=(29, 30)).keeps(e)] == [ON]
    with pytest.raises(ValueError, match="no event is called 'status'; there are run_started, "):
        Filter(kind="status")


METRICS = FrameMetrics(
    frame=29,
    time_s=1.16,
    target="1",
    centre_box=(154.25, 110.5, 40.0, 40.0),
    map=(154.0, 110.0, 40.0, 40.0),
    sd=(3.1, 2.9, 0.4, 0.4),
    ud_px2=212.4,
    ud_nodes={"square": 212.4, "color": 98.0},
    quiet_px2=94.0,
    status="tracking",
    score=0.62,
    log_evidence=-3.21,
    surprise=0.83,
    ess=212.0,
    particles=500,
    active=("hue",),
    kl={"hue": 0.31},
    contribution={"hue": 1.2},
    agent_ud_px2={"hue": 98.0},
    strength={"hue": 2.1, "color": 2.2},
    learn_rate=0.0,
    region50=(0.0, 1.0, 0.0, 1.0),
    region90=(0.0, 1.0, 0.0, 1.0),
    cloud=(),
)


def test_the_file_keeps_the_key_box():
    line = to_json(METRICS)
    assert '"box": [154.25, 110.5, 40.0, 40.0]' in line and "centre_box" not in line
    assert from_json(line) == METRICS


def test_a_line_shows_what_matters():
    shown = "<target 1 in frame 29: tracking, score 0.62, xywh 134.8,91.0,40.0,40.0, hue active>"
    assert repr(METRICS) == shown


def test_why():
    assert why([STARTED, BORN, OFF, ON, STOPPED], [METRICS], 29) == (
        "frame 29 at 1.160 s, target 1: tracking, score 0.62 (uncalibrated)\n"
        "  estimate   centre 154.2, 110.5, 40.0 x 40.0 px; sd 3.1, 2.9, 0.4, 0.4 px\n"
        "  hypotheses 500, of which 212 effective; log evidence -3.21\n"
        "  UD         square 212 px², color 98 px²; baseline 94 px²; learning at 0 % of the full rate\n"
        "  hue        on   KL 0.31, contribution 1.20 nats, its own UD 98 px², strength 2.10 nats\n"
        "             on since frame 0, the start\n"
        "  motion     off  gave no evidence\n"
        f"             {explain(OFF)}\n"
        "  color      off  gave no evidence\n"
        "             off since the start\n"
        f"  from here  {explain(ON).removeprefix('frame 29: ')}\n"
        "  thresholds square deactivates below 130 px², square activates above 200 px², "
        "color stops itself above 2500 px²"
    )


def test_why_tells_who_saw_nothing():
    explained = why([STARTED, BORN], [replace(METRICS, silent=("hue",))], 29)
    assert "  hue        on   did not see the target\n" in explained


def test_why_tells_what_a_score_was_made_from():
    line = replace(METRICS, features={"log_fit": -0.25, "evidence": 1.5, "most": 1.0})
    scores = {"square": {"bias": 1.05, "evidence": 0.0, "log_fit": 2.0}, "other": {"bias": 9.0}}
    assert "\n  score from bias 1.05, log_fit 2 × -0.25 = -0.50; log odds 0.55, probability 0.63\n" in why(
        [STARTED, BORN], [line], 29, scores=scores
    )
    assert "\n  features   evidence 1.50, log_fit -0.25; the coefficients are in the graph\n" in why(
        [STARTED, BORN], [line], 29
    )


ALIKE = DistractorSeen(*(27, "1", 90.0, 80.0, 1.6, 1.37, 4.0, 0.9, 250))


@pytest.mark.parametrize(
    ("most", "hidden", "events", "limit"),
    [
        (1.0, None, [ALIKE], ""),
        (0.5, None, [ALIKE], "; at most 0.50, because of the look-alike seen in frame 27"),
        (0.2, None, [ALIKE], "; at most 0.20, because the best hypothesis fits badly"),
        (
            *(0.5, None, [ALIKE, DoubtEnded(28, "1", 0.5, 1.5, 0.5, 244)]),
            "; at most 0.50, because the best hypothesis fits badly",
        ),
        (0.5, None, [replace(ALIKE, frame=30)], "; at most 0.50, because the best hypothesis fits badly"),
        (0.07, 0.93, [], "; at most 0.07, because the target is hidden with probability 0.93"),
    ],
)
def test_why_names_the_limit_of_a_score(most, hidden, events, limit):
    line = replace(METRICS, hidden=hidden, features={"log_fit": -0.25, "most": most})
    said = why([STARTED, BORN, *events], [line], 29, scores={"square": {"bias": 0.0}})
    assert f"\n  score from bias 0; log odds 0.00, probability 0.50{limit}\n" in said


def test_why_of_a_frame_that_is_not_there():
    with pytest.raises(ValueError, match="frame 30 is not in this run; it has frames 29 to 29"):
        why([BORN], [METRICS], 30)
    with pytest.raises(ValueError, match="it has none"):
        why([], [], 0)


def test_why_of_one_of_several_targets():
    other = replace(METRICS, target="2")
    assert why([BORN], [METRICS, other], 29, "1") == why([BORN], [METRICS], 29)
    with pytest.raises(ValueError, match="target 3 is not live in frame 29"):
        why([BORN], [METRICS, other], 29, "3")
    assert [e for e in (BORN, replace(BORN, target="2")) if Filter(target="2").keeps(e)] == [
        replace(BORN, target="2")
    ]
