"""Real sequences with ground truth, and the sets that figures are reported of.

A folder holds NAME/img/*.jpg and NAME/groundtruth.txt with x,y,w,h per frame (the layout of OTB).
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from measuring import Image
from numpy.typing import NDArray

from bayesnet_track.evaluate.truth import read_truth

SUFFIXES = {".jpg", ".jpeg", ".png"}

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
"""On these the settings of `general` were chosen first."""
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
"""On these nobody had tuned when the coin was tossed."""
UNTUNED = (
    "dtb_Surfing06",
    "otb_Coke",
    "otb_MountainBike",
    "otb_Skating1",
    "otb_Soccer",
    "otb_Suv",
    "uav_bike1",
    "uav_building4",
    "uav_building5",
    "uav_car14",
    "uav_person11",
    "uav_wakeboard4",
    "uav_wakeboard5",
)
"""On these nothing had been chosen or fitted by the end of version 0.2."""
SEED = 20261122


def toss() -> dict[str, tuple[str, ...]]:
    """Half -> its sequences: of OLD and of NEW one half each, the odd one in A; tossed once and for all."""
    coin = random.Random(SEED)
    halves: dict[str, list[str]] = {"A": [], "B": []}
    for stratum in (OLD, NEW):
        drawn = coin.sample(stratum, len(stratum))
        middle = (len(drawn) + 1) // 2
        halves["A"] += drawn[:middle]
        halves["B"] += drawn[middle:]
    return {half: tuple(sorted(names)) for half, names in halves.items()}


HALVES = toss()
STRATA = {
    "chosen on": (*OLD, *NEW),
    "untuned": UNTUNED,
    "half A": HALVES["A"],
    "half B": HALVES["B"],
    "new": NEW,
}
"""Name -> sequences; the untuned ones lie outside the halves, `new` in both."""


@dataclass(frozen=True, eq=False)
class Sequence:
    """Pictures and true corner boxes (n, 4) of one target."""

    name: str
    files: list[Path]
    truth: NDArray[np.float64]

    def images(self) -> Iterator[Image]:
        """The pictures, BGR."""
        for file in self.files:
            image = cv2.imread(str(file), cv2.IMREAD_COLOR)
            if image is None:
                raise SystemExit(f"{file}: cannot be read")
            yield np.asarray(image, dtype=np.uint8)


def find_sequences(folder: Path, names: list[str], most: int | None) -> list[Sequence]:
    """Those below `folder` that have pictures and truth; with `most` only the first frames."""
    found = []
    for truth_file in sorted(folder.glob("*/groundtruth.txt")):
        name = truth_file.parent.name
        files = sorted(f for f in (truth_file.parent / "img").glob("*") if f.suffix.lower() in SUFFIXES)
        if files and (not names or name in names):
            truth = read_truth(truth_file)
            count = min(len(files), len(truth), most or len(files))
            found.append(Sequence(name, files[:count], truth[:count]))
    return found
