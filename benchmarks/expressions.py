"""Time to weigh 1,000 hypotheses by expressions: milliseconds of CPU time, the least of five repetitions.

python benchmarks/expressions.py
"""

from __future__ import annotations

import time
import timeit

import numpy as np

from bayesnet_track.graph.expressions.evaluate import log_values
from bayesnet_track.graph.expressions.parse import parse

HYPOTHESES, RUNS = 1000, 500
EXPRESSIONS = (
    "normal(h, 0.32 * y + 12, 8)",
    "where(200 < y < 0.2 * x + 310, 1, 0.01)",
    "0.9 * normal(h, 60, 5) + 0.1 * uniform(h, 20, 200)",
    "normal(log(w / h), -0.9, 0.15) * exp(-hypot(x - 160, y - 120) / 40)",
)


def main() -> None:
    """Print a line for each expression."""
    rng = np.random.Generator(np.random.Philox(0))
    names = {name: rng.uniform(10.0, 300.0, HYPOTHESES) for name in "xywh"}
    for text in EXPRESSIONS:
        term = parse(text)
        least = min(
            timeit.repeat(
                lambda term=term: log_values(term, names), number=RUNS, repeat=5, timer=time.process_time
            )
        )
        print(f"{1e3 * least / RUNS:.3f} ms  {text}")


if __name__ == "__main__":
    main()
