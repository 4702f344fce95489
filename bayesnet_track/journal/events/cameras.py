"""Events of cameras: what was learnt of their clocks, that one was knocked, which ones are on."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ClockLearnt:
    """The clock of a camera is much better known than at the last report, is elsewhere, or the run ends.

    Attributes:
        frame: step whose evidence it is after.
        camera: the camera.
        offset_s: by how much the times of its frames are later than those of the first camera, s.
        sd_s: of the offset, s.
        before_s: the offset as it was reported last, s; before that as the graph says.
        before_sd_s: of it, s.
    """

    frame: int
    camera: str
    offset_s: float
    sd_s: float
    before_s: float
    before_sd_s: float

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        way = "late" if self.offset_s >= 0 else "early"
        places = 3 if self.sd_s >= 0.002 else 4
        offset, sd = f"{abs(self.offset_s):.{places}f}", f"{self.sd_s:.{places}f}"
        previous = f"{self.before_s:+.{places}f} ± {self.before_sd_s:.{places}f} s"
        return f"clock of camera {self.camera}: {offset} ± {sd} s {way} (before {previous})"


@dataclass(frozen=True)
class CameraKnocked:
    """All that a camera sees is elsewhere at once, and not in other cameras.

    Attributes:
        frame: step in which this was noticed.
        camera: the camera.
        x_px: shift to the right.
        y_px: shift down.
        sd_px: of either, beyond the error of the calibration.
        first_frame: first step that has it.
        agree: targets that are off so.
        targets: of how many.
        chi_square: of the shift, with 2 degrees of freedom, where there were no knock.
    """

    frame: int
    camera: str
    x_px: float
    y_px: float
    sd_px: float
    first_frame: int
    agree: int
    targets: int
    chi_square: float

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        distance = (self.x_px**2 + self.y_px**2) ** 0.5
        way = f"{self.x_px:+.0f} px across, {self.y_px:+.0f} px down, ± {self.sd_px:.1f} px"
        chi_square = f"{self.chi_square:.0f}" if self.chi_square < 1000.0 else "far above 30"
        return (
            f"camera {self.camera} is {distance:.0f} px off since frame {self.first_frame} ({way}): "
            f"{self.agree} of {self.targets} targets were so far off there and in no other camera "
            f"(chi-square {chi_square}); its bias is widened and learnt anew, "
            "unless any one target had made up half of it"
        )


@dataclass(frozen=True)
class CamerasSwitched:
    """Other cameras are on than when one was on last.

    Attributes:
        frame: the step.
        cameras: cameras that are on, the best first.
        switched_off: cameras that no longer are.
        targets: number of targets.
        ud_m2: their mean UD, as it is expected with the cameras on.
        without_m2: the same with none on.
        undetected: expected number of targets that no camera has detected yet.
        gain_m: expected gain of the last camera that is on.
        runner_up: the camera that was next to that one; "" where there is none.
        runner_up_m2: mean UD as it is expected with that one in its place.
        runner_up_cost: declared cost up to which the runner-up would be on in its place.
    """

    frame: int
    cameras: tuple[str, ...]
    switched_off: tuple[str, ...]
    targets: int
    ud_m2: float
    without_m2: float
    undetected: float
    gain_m: float
    runner_up: str
    runner_up_m2: float
    runner_up_cost: float

    def describe(self) -> str:
        """The sentence of the event, without its frame."""
        is_plural = len(self.cameras) > 1
        sentence = f"camera{'s' * is_plural} {', '.join(self.cameras)} on"
        if self.switched_off:
            sentence += f", {', '.join(self.switched_off)} off"
        if self.targets:
            those = f"of {self.targets} targets " if self.targets > 1 else ""
            sentence += (
                f": expected mean UD {those}{self.ud_m2:.3g} m² with {'them' if is_plural else 'it'}, "
                f"{self.without_m2:.3g} without"
            )
        else:
            sentence += f": {self.undetected:.2g} undetected targets are expected"
        if not self.runner_up:
            return sentence
        if self.targets:
            sentence += f"; next {self.runner_up}: {self.runner_up_m2:.3g}"
        return f"{sentence}; unless {self.runner_up} cost at most {self.runner_up_cost:.3g}"
