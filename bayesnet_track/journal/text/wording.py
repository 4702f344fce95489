"""Numbers of the journal in words: with as many digits as tell a value from its level."""

from __future__ import annotations

import math

from bayesnet_track.journal.target_net import Cause

UNIT = {"ud_px2": " px²", "ud_box": " × box area", "ud_baseline": " × baseline", "score": ""}
"""How a level's unit is written behind its number."""


def cause_text(cause: Cause, relation: str) -> str:
    """`UD 212 px² > 200 for 3 frames`, or with the unit and px² in brackets."""
    value, level = distinct_texts(cause.value, cause.level)
    span = f"for {plural(cause.frames, 'frame')}"
    if cause.unit == "score":
        return f"score {value} {relation} {level} {span}"
    if cause.unit == "ud_px2":
        return f"UD {value} px² {relation} {level} {span}"
    px, level_px = in_px(cause.ud_px2, cause.level * cause.scale_px2)
    unit = UNIT[cause.unit]
    return f"UD {value}{unit} ({px} px²) {relation} {level}{unit} ({level_px} px²) {span}"


def show_turn(cause: Cause, up: bool) -> str:
    """The turning level with as many digits as tell it from the level, rounded so that it does turn."""
    value = round_away(cause.turning, decimals(cause.turning, cause.level), up)
    if cause.unit in ("ud_px2", "score"):
        return value
    px = cause.turning * cause.scale_px2
    return (
        f"{value}{UNIT[cause.unit]} ({round_away(px, decimals(px, cause.level * cause.scale_px2), up)} px²)"
    )


def distinct_texts(value: float, level: float) -> tuple[str, str]:
    """Both numbers with three digits, or as many as it takes to show that they differ."""
    for extra in range(7):
        digits = decimals(value, level) + extra
        first, second = f"{value:.{digits}f}", f"{level:.{digits}f}"
        if first != second or value == level:
            break
    return trim(first), trim(second)


def in_px(value: float, level: float) -> tuple[str, str]:
    """Both numbers as by `distinct_texts`, each with its own three digits if these differ: for a derived
    level.

    >>> in_px(4.381, 264.847), in_px(7.768, 7.771)
    (('4.38', '265'), ('7.768', '7.771'))
    """
    first, second = (trim(f"{number:.{decimals(number)}f}") for number in (value, level))
    if (float(first) < float(second)) == (value < level) and first != second:
        return first, second
    return distinct_texts(value, level)


def decimals(*values: float) -> int:
    """Decimals that give the smallest of the numbers three digits."""
    smallest = min((abs(v) for v in values if v), default=1.0)
    return min(max(2 - math.floor(math.log10(smallest)), 0), 12) if math.isfinite(smallest) else 0


def round_away(value: float, digits: int, up: bool) -> str:
    """The number with so many decimals, rounded away from where the rule fires."""
    if not math.isfinite(value):
        return str(value)
    scaled = value * 10.0**digits
    # A hair of rounding error must not move a whole number to the next one.
    rounded = math.ceil(scaled - 1e-9 * abs(scaled)) if up else math.floor(scaled + 1e-9 * abs(scaled))
    return trim(f"{rounded / 10.0**digits:.{digits}f}")


def trim(text: str) -> str:
    """Without the zeros that say nothing."""
    return text.rstrip("0").rstrip(".") if "." in text else text


def plural(count: float, noun: str) -> str:
    """`1 frame`, `3 frames`."""
    return f"{count:.6g} {noun}{'' if count == 1 else 's'}"
