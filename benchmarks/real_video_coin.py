"""Which half each real sequence is in: tossed once, stratified, before any figure was looked at.

`NEW` are the sequences that nobody had tuned on when the coin was tossed; the others are those on which the
settings of `general` were chosen until then.
"""

from __future__ import annotations

import random

OLD = (
    "Basketball",
    "Car1",
    "Couple",
    "Crossing",
    "DragonBaby",
    "Girl",
    "Human7",
    "Jogging1",
    "MotorRolling",
    "Skiing",
    "davis_car-shadow",
    "uav_wakeboard10",
    "vot15_bag",
)
NEW = (
    "otb_Biker",
    "otb_BlurCar2",
    "otb_Deer",
    "otb_Lemming",
    "otb_Tiger1",
    "uav_car10",
    "uav_car16_2",
    "uav_group1_1",
    "uav_group2_2",
    "uav_truck4_1",
    "uav_wakeboard3",
    "vot14_car",
)
SEED = 20261122


def toss() -> dict[str, tuple[str, ...]]:
    """Half -> its sequences: of each stratum one half, the odd one in A."""
    coin = random.Random(SEED)
    halves: dict[str, list[str]] = {"A": [], "B": []}
    for stratum in (OLD, NEW):
        drawn = coin.sample(stratum, len(stratum))
        middle = (len(drawn) + 1) // 2
        halves["A"] += drawn[:middle]
        halves["B"] += drawn[middle:]
    return {half: tuple(sorted(names)) for half, names in halves.items()}


HALVES = toss()
