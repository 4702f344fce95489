"""Types of arrays, named by what they hold; columns of what the kernels over rows measure."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Bools = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
"""(height, width) or (height, width, channels), as OpenCV has them: rows first, BGR."""
Ints = NDArray[np.int64]
Singles = NDArray[np.float32]


LOG_EVIDENCE, NATS, ESS, HYPOTHESES, AGENT_UD, UD, FIT, AREA, STRENGTH, D2 = range(10)
MEASURES = 10
