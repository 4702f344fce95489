"""How many hypotheses a belief has: resized, or drawn a second time."""

from __future__ import annotations

from dataclasses import dataclass

from bayesnet_track.journal.text.wording import decimals, distinct_texts, plural, round_away


@dataclass(frozen=True)
class ParticlesResized:
    """The number of hypotheses of an adaptive size is now a quarter above or below the one last reported.

    Attributes:
        frame: the frame.
        target: target id.
        particles: the number of this frame.
        before: the number last reported, or the one at the start.
        method: kld, kld_revised, kld_revised_simplified, asymptotic_normal or likelihood_sum.
        need: the number that the method asked for, before rounding and bounds.
        limit: what kept the number away from the need: max, min, or ess (too few effective hypotheses to
            save any); empty when nothing did. With `early`, max may hold one half of the hypotheses only.
        early: true when this frame's own evidence asked for more than the last frame's: more were drawn in
            the same frame.
        field: the field that asked for the most; empty for likelihood_sum.
        ess: effective hypotheses of the sample that asked.
        bins: occupied bins of the field, where the method counts them.
        bin_px: width of a bin.
        worth: hypotheses that are worth one drawn from the posterior; absent for likelihood_sum.
        sd_px: sd of the field in the posterior, for asymptotic_normal.
        setting: the setting that the number depends on: error, error_px, error_sd or threshold.
        level: its value.
        turning: its value at which nothing would have been reported; null when there is none.
    """

    frame: int
    target: str
    particles: int
    before: int
    method: str
    need: float
    limit: str
    early: bool
    field: str
    ess: float
    bins: int | None
    bin_px: float | None
    worth: float | None
    sd_px: float | None
    setting: str
    level: float
    turning: float | None

    def describe(self) -> str:
        """How many hypotheses are asked for, and why."""
        settings = f"{self.method}, {self.setting} {self.level:g}"
        by = "this frame's evidence" if self.early else "the last frame's evidence"
        asked = f"{_why_so_many(self)}: {by} asks for {self.need:.0f} hypotheses ({settings})"
        held = {"max": ", held by max", "min": ", held by min", "ess": ", too few effective to reduce it"}
        number = f"{self.particles}{held.get(self.limit, '')}, {self.before} before"
        return f"{asked} → {number}{_not_resized(self)}"


@dataclass(frozen=True)
class SecondPass:
    """A frame surprised the belief: further hypotheses were drawn where the first ones found the target.

    Attributes:
        frame: the frame.
        target: target id.
        method: second_pass or iterated.
        kl: KL(posterior || prior) of the first pass, nats; the larger one of its two halves.
        above_kl: threshold above which a second pass is made.
        first: hypotheses of the first pass.
        particles: hypotheses drawn in addition.
        ess_first: effective hypotheses of the first pass.
        ess: effective hypotheses with the second pass.
    """

    frame: int
    target: str
    method: str
    kl: float
    above_kl: float
    first: int
    particles: int
    ess_first: float
    ess: float

    def describe(self) -> str:
        """Hypotheses drawn a second time."""
        found, level = distinct_texts(self.kl, self.above_kl)
        how = "" if self.method == "second_pass" else f", by {self.method}"
        turning = round_away(self.kl, decimals(self.kl, self.above_kl), up=True)
        return (
            f"KL(posterior, prior) {found} nats > {level} → second pass of {self.particles} hypotheses{how}, "
            f"{self.ess_first:.0f} effective before, {self.ess:.0f} after; "
            f"no second pass at above_kl ≥ {turning}"
        )


Events = ParticlesResized | SecondPass


def _why_so_many(event: ParticlesResized) -> str:
    """The numbers that the need was computed from."""
    parts = []
    if event.bins is not None and event.bin_px is not None:
        parts.append(f"{event.field} spans {plural(event.bins, 'bin')} of {event.bin_px:g} px")
    if event.sd_px is not None:
        parts.append(f"{event.field} has an sd of {event.sd_px:.3g} px")
    if event.worth is not None and event.method != "kld":
        parts.append(f"{event.worth:.3g} hypotheses are worth one drawn from the posterior")
    return ", ".join([*parts, f"{event.ess:.0f} effective"])


def _not_resized(event: ParticlesResized) -> str:
    """What would have prevented it: a larger error asks for fewer, a larger threshold for more."""
    if event.turning is None:
        return ""
    up = (event.particles > event.before) == (event.setting != "threshold")
    turning = round_away(event.turning, decimals(event.turning, event.level), up)
    return f"; would have stayed near {event.before} at {event.setting} {'≥' if up else '≤'} {turning}"
