"""Answers about identities in a real browser: the doubtful place, keys, undo, and the tracks that follow."""

import json

import cv2
import numpy as np
import pytest

from bayesnet_track import track
from bayesnet_track.evaluate.truth import read_mot_tracks

pytestmark = pytest.mark.slow

DESKTOP, PHONE = (1440, 960, 1), (375, 800, 2)
SIZE, FRAMES, MEETING = (640, 480), 100, 50


@pytest.fixture(scope="module")
def meeting_run(tmp_path_factory):
    """A run over images in which two people meet, are detected as one box for a while, and turn round."""
    folder, rng = tmp_path_factory.mktemp("meeting"), np.random.default_rng(0)
    (folder / "images").mkdir()
    lines = []
    for k in range(FRAMES):
        distance = 1.6 * abs(k - MEETING) + 1.0
        image = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)
        for x, color in ((320 - distance, (40, 60, 200)), (320 + distance, (200, 120, 40))):
            cv2.rectangle(image, (round(x) - 15, 210), (round(x) + 15, 270), color, -1)
        cv2.imwrite(str(folder / f"images/{k:04d}.png"), image)
        for x in (320 - distance, 320 + distance) if distance > 7 else (320.0,):
            x, y, w, h = np.array([x, 240.0, 30.0, 60.0]) + rng.normal(0, 1.2, 4)
            lines.append(f"{k + 1},-1,{x - w / 2:.2f},{y - h / 2:.2f},{w:.2f},{h:.2f},0.9\n")
    (folder / "detections.txt").write_text("".join(lines))
    for _ in track(
        "kalman_detections", folder / "images", out=folder / "run", detections=folder / "detections.txt"
    ):
        pass
    return folder / "run"


def standing(browser):
    return browser.run("return document.querySelector('.ask-panel .standing').innerText")


def number_of_answers(browser, number):
    browser.wait(f"return document.querySelector('.headline dd').innerText.trim() === '{number}'", 60)


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_a_doubtful_place_is_shown_answered_by_key_and_taken_back(
    browser, command, meeting_run, tmp_path, size
):
    out = tmp_path / "out"
    run = command("annotate", "--identities", meeting_run, "--out", out, view=())
    browser.open_view(run.address, size)
    browser.wait("return document.querySelector('.frame svg image') && document.querySelector('.who rect')")
    assert standing(browser).startswith("Who is target ")
    first = standing(browser)
    # The image and the slider stay inside the page and inside their panels.
    assert browser.run("return document.documentElement.scrollWidth <= innerWidth")
    gap = browser.run(
        "const a = document.querySelector('.shown').getBoundingClientRect();"
        "const b = document.querySelector('.transport input').getBoundingClientRect();"
        "const c = document.querySelector('.shown svg').getBoundingClientRect();"
        "return [b.left - a.left, a.right - b.right, b.top - c.bottom]"
    )
    assert min(gap) >= 0
    # The loop runs through the frames of the question until the space bar holds it.
    value = "return Number(document.querySelector('.transport input').value)"
    browser.press(" ")
    browser.run("document.querySelector('.transport input').focus()")
    held = browser.run(value)
    browser.press("\ue014")
    assert browser.run(value) == held + 1 or held == browser.run(
        "return Number(document.querySelector('.transport input').max)"
    )
    browser.screenshot(f"identities_{size[0]}.png")
    browser.press("s")
    number_of_answers(browser, 1)
    (answer,) = [json.loads(line) for line in (out / "identities.jsonl").read_text().splitlines()[1:]]
    assert answer["answer"] == "swap"
    browser.press("u")
    number_of_answers(browser, 0)
    assert standing(browser) == first
    browser.press("s")
    number_of_answers(browser, 1)
    assert browser.complaints() == []
    browser.click(".finish button")
    assert run.process.wait(60) == 0
    before, after = read_mot_tracks(meeting_run / "tracks.txt"), read_mot_tracks(out / "tracks.txt")

    def side(tracks, frame):
        rows = tracks.frames == frame
        return dict(zip(tracks.boxes[rows, 0].round(2).tolist(), tracks.ids[rows].tolist(), strict=True))

    # Before the meeting everyone keeps the number; after it the two numbers are exchanged.
    assert side(after, 20) == side(before, 20)
    assert len(side(after, 90)) == 2
    left, right = sorted(side(before, 90))
    exchanged = {left: side(before, 90)[right], right: side(before, 90)[left]}
    assert side(after, 90) == exchanged
