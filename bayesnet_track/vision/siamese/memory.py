"""What a Siamese network has answered, kept so that it runs once per frame, target and crop."""

from __future__ import annotations

from threading import Lock

import numpy as np

from bayesnet_track.numerics.arrays import Bytes, Floats, Singles
from bayesnet_track.vision.siamese.crops import Crop, context_side
from bayesnet_track.vision.siamese.networks import TEMPLATE, Networks

LEAST = 1e-4
"""Proposals of a smaller probability are left out."""
FLAT = 8
"""Gray levels between the darkest and the brightest of a crop in which nothing is to be seen."""
TEMPLATES = 256
"""Templates whose descriptions are kept."""

Proposals = tuple[Floats, Floats]
"""(M, 4) centre boxes in the frame, px; (M,) log-probabilities, the largest first."""


class Memory:
    """A network with its answers: a pure function of what it is given, that is quick the second time.

    Threads may share it; OpenCV's networks themselves hold what they work on, so that one runs at a time.
    """

    def __init__(self, networks: Networks) -> None:
        self._networks = networks
        self._described: dict[bytes, Singles] = {}
        self._image: Bytes | None = None
        self._answers: dict[tuple[Crop, bytes, bytes], Proposals] = {}
        self._lock = Lock()

    def proposals(self, image: Bytes, crop: Crop, template: Bytes, size: Floats) -> Proposals:
        """What the network proposes in a crop of a frame for a target of w, h `size` px."""
        shown = template.tobytes()
        key = (crop, shown, size.tobytes())
        with self._lock:
            if self._image is not image:
                self._image = image
                self._answers.clear()
            found = self._answers.get(key)
            if found is None:
                found = self._answers[key] = self._asked(image, crop, shown, template, size)
            return found

    def _asked(self, image: Bytes, crop: Crop, shown: bytes, template: Bytes, size: Floats) -> Proposals:
        features = self._described.get(shown)
        if features is None:
            if len(self._described) >= TEMPLATES:
                self._described.clear()
            features = self._described[shown] = self._networks.describe(template)
        seen = crop.cut(image)
        if int(seen.max()) - int(seen.min()) < FLAT:
            return np.empty((0, 4)), np.empty(0)
        expected = size * TEMPLATE / context_side(size) / crop.coarse
        response = self._networks.compare(features, seen, expected)
        probabilities = response.probabilities.reshape(-1).astype(np.float64)
        order = np.argsort(-probabilities, kind="stable")
        order = order[probabilities[order] >= LEAST]
        return crop.boxes(response)[order], np.log(probabilities[order])
