"""Where targets are expected, as lines of ``forecasts.jsonl``: one per frame, target and frames ahead."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bayesnet_track.engine.compiled import Engine
from bayesnet_track.engine.forecasting import forecast
from bayesnet_track.journal.writer import LineFile
from bayesnet_track.runtime.resizing import Resizing
from bayesnet_track.runtime.results import Result

DIGITS = 3


@dataclass(frozen=True, eq=False)
class Forecaster:
    """Looks `horizon` frames ahead with an engine."""

    engine: Engine
    horizon: int
    resizing: Resizing


class ForecastWriter(LineFile):
    """``forecasts.jsonl``: a new file, or one that is continued."""

    def __init__(self, path: Path, forecaster: Forecaster, after: int | None = None) -> None:
        super().__init__(path, after)
        self._forecaster = forecaster

    def write(self, result: Result) -> None:
        """Add what is expected of every target after one frame to the next flush."""
        forecaster, resizing = self._forecaster, self._forecaster.resizing
        for line in result.targets:
            if line.target not in result.states:
                continue
            start = result.states[line.target], result.births[line.target], line
            for seen in forecast(forecaster.engine, *start, forecaster.horizon, resizing.tracked):
                one = resizing.estimate(seen)
                self.append(
                    json.dumps(
                        {
                            "frame": line.frame,
                            "target": line.target,
                            "ahead": one.ahead,
                            "box": _short(one.centre_box),
                            "sd": _short(one.sd),
                            "region50": _short(one.region50),
                            "region90": _short(one.region90),
                            **({"queries": _rounded(one.queries)} if one.queries else {}),
                        }
                    )
                )


def _short(values: tuple[float, ...]) -> list[float]:
    return [round(value, DIGITS) for value in values]


def _rounded(numbers: Mapping[str, float]) -> dict[str, float]:
    return {name: float(f"{number:.6g}") for name, number in numbers.items()}
