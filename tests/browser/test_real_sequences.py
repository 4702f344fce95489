"""The pages of runs over real sequences, to be looked at; of a built-in scene where no sequences are given.

    BAYESNET_TRACK_SEQUENCES=FOLDER BAYESNET_TRACK_SCREENSHOTS=FOLDER pytest -m slow tests/browser

FOLDER holds NAME/img/*.jpg and NAME/groundtruth.txt with x,y,w,h per frame.
"""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import open_run
from bayesnet_track.cli.main import main
from bayesnet_track.sources.scenes import make_scene

pytestmark = pytest.mark.slow

GIVEN = os.environ.get("BAYESNET_TRACK_SEQUENCES")
NAMES = sorted(truth.parent.name for truth in Path(GIVEN).glob("*/groundtruth.txt")) if GIVEN else ["scene"]
PHONE = (375, 800, 2)
FRAMES = 200


@pytest.fixture(params=NAMES)
def sequence(request, tmp_path):
    """Name, pictures and ground truth."""
    name = request.param
    if GIVEN:
        return name, Path(GIVEN) / name / "img", Path(GIVEN) / name / "groundtruth.txt"
    scene = make_scene("two_squares", seed=0)
    (tmp_path / "img").mkdir()
    for number in range(60):
        cv2.imwrite(str(tmp_path / "img" / f"{number:04d}.png"), scene.frames[number])
    np.savetxt(tmp_path / "groundtruth.txt", scene.truth[:60], delimiter=",")
    return name, tmp_path / "img", tmp_path / "groundtruth.txt"


def fits(browser):
    """Whether nothing is wider than the window."""
    return browser.run("return document.documentElement.scrollWidth <= innerWidth")


def test_page_and_live_view_on_a_desk_and_on_a_phone(browser, command, sequence, tmp_path):
    name, pictures, truth = sequence
    run = tmp_path / "run"
    asked = ["run", "general", "--source", pictures, "--init-from", truth, "--end", FRAMES, "--out", run]

    view = command(*asked)
    browser.open_view(view.address)
    browser.wait("return document.querySelector('.live .standing')?.innerText.includes('ended')", 120)
    browser.wait("return document.querySelector('.picture canvas')?.dataset.frame ?? null")
    _, seen = browser.screenshot(f"{name}_live.png")
    assert seen.std() > 20 and fits(browser)
    browser.size(PHONE)
    browser.screenshot(f"{name}_live_phone.png")
    assert fits(browser) and not browser.complaints()
    view.process.terminate()
    view.process.wait(10)

    assert main(["report", str(run), "--truth", str(truth)]) == 0
    frames = sum(1 for _ in open_run(run).metrics)
    browser.open(run / "report.html", hash=f"#frame={frames // 2}")
    assert browser.frame == frames // 2 and fits(browser)
    browser.screenshot(f"{name}.png")
    browser.open(run / "report.html", PHONE, hash=f"#frame={frames // 2}")
    browser.screenshot(f"{name}_phone.png")
    assert fits(browser) and not browser.complaints()
