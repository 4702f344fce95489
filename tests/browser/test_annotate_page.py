"""Annotating in a real browser: a box, the tracker's question, answers by key, undo, resuming, the files."""

import json
import signal
import time

import cv2
import numpy as np
import pytest

from bayesnet_track.runtime.annotation.asking import iou
from bayesnet_track.sources.scenes import make_scene

pytestmark = pytest.mark.slow

DESKTOP, PHONE = (1440, 960, 1), (375, 800, 2)
FRAMES = 60


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Two squares that pass close by each other; its folder of images."""
    folder = tmp_path_factory.mktemp("squares")
    made = make_scene("two_squares", seed=0)
    for number in range(FRAMES):
        cv2.imwrite(str(folder / f"{number:04d}.png"), made.frames[number])
    return folder, made.truth


def place(browser, x, y):
    left, top, w, h = browser.run(
        "const r = document.querySelector('.sheet svg').getBoundingClientRect();"
        "return [r.left, r.top, r.width, r.height]"
    )
    return round(left + x / 320 * w), round(top + y / 240 * h)


def drag(browser, box):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.actions.action_builder import ActionBuilder

    x, y, w, h = box
    actions = ActionBuilder(browser.driver)
    pointer = actions.pointer_action
    pointer.move_to_location(*place(browser, x, y)).pointer_down()
    pointer.move_to_location(*place(browser, x + w / 2, y + h / 2))
    pointer.move_to_location(*place(browser, x + w, y + h)).pointer_up()
    actions.perform()
    ActionChains(browser.driver).reset_actions()


def said(browser):
    return browser.run("return document.querySelector('.ask-panel .standing').innerText")


def settled(browser, text):
    browser.wait(
        "const p = document.querySelector('.ask-panel .standing');"
        f"return p && !p.classList.contains('busy') && p.innerText.includes({text!r})",
        90,
    )


def tracked(browser, folder, kept, in_force):
    """All answers are on the disk, and the page shows what was tracked from those that are in force."""
    end = time.monotonic() + 60
    while len(answers(folder)) < kept:
        assert time.monotonic() < end
        time.sleep(0.02)
    browser.wait(
        f"return document.querySelector('.headline dd').innerText.trim() === '{in_force}'"
        " && !document.querySelector('.standing.busy')",
        60,
    )


def frame(browser):
    return int(browser.run("return document.querySelector('.lanes input').value"))


def answers(folder):
    return [json.loads(line) for line in (folder / "answers.jsonl").read_text().splitlines()[1:]]


def start(browser, command, scene, out, size=DESKTOP):
    run = command("annotate", scene[0], "--out", out, "--graph", "gray_square", "--threshold", "0.6", view=())
    browser.open_view(run.address, size)
    browser.wait("return document.querySelector('.sheet img')?.naturalWidth")
    return run


def test_a_box_is_tracked_asked_about_taken_back_and_gone_on_with(browser, command, scene, tmp_path):
    from selenium.webdriver.common.keys import Keys

    out = tmp_path / "labels"
    run = start(browser, command, scene, out)
    assert "Drag a box around the first target" in said(browser)
    browser.press(Keys.ENTER)
    drag(browser, scene[1][0])
    browser.screenshot("annotate_drawn.png")
    browser.press(Keys.ENTER)
    browser.wait("return !document.querySelector('.drawn')")
    (first,) = answers(out)
    assert (first["kind"], first["frame"], first["target"]) == ("box", 0, "target 1")
    assert iou(tuple(first["box"]), tuple(scene[1][0])) > 0.85
    settled(browser, "?" if "?" in said(browser) else "")
    browser.wait("return document.querySelector('.lane-sure')", 60)
    asked = browser.run("return document.querySelector('.reason')?.innerText ?? ''")
    if asked:
        assert "probability of being on target" in asked
    # Another target by key, then a frame on, and it is gone.
    browser.press("t")
    assert "target 2" in browser.run(
        "return document.querySelector('.targets [aria-pressed=true]').innerText"
    )
    browser.run("document.activeElement.blur()")
    browser.press(Keys.HOME)
    drag(browser, (20, 20, 40, 40))
    # The keyboard puts the drawn box right.
    before = browser.run("return document.querySelector('.drawn text').textContent")
    browser.press(Keys.ARROW_RIGHT)
    assert browser.run("return document.querySelector('.drawn text').textContent") != before
    browser.press(Keys.ENTER)
    browser.wait("return !document.querySelector('.drawn')")
    tracked(browser, out, 2, 2)
    given = answers(out)
    assert [one["target"] for one in given] == ["target 1", "target 2"]
    at = frame(browser)
    browser.press("g")
    tracked(browser, out, 3, 3)
    assert answers(out)[-1]["kind"] == "gone"
    browser.screenshot("annotate_gone.png")
    browser.press("u")
    tracked(browser, out, 4, 2)
    assert answers(out)[-1] == {"kind": "undo"} and at >= 0
    # The command ends at once on Ctrl-C, and its files are written.
    run.process.send_signal(signal.SIGINT)
    assert run.process.wait(60) == 0
    content = json.loads((out / "coco.json").read_text())
    assert {one["name"] for one in content["tracks"]} == {"target 1", "target 2"}
    # Days later: the same answers, the same lanes; `Finish` ends the command.
    kept = (out / "answers.jsonl").read_bytes()
    again = start(browser, command, scene, out)
    browser.wait("return document.querySelectorAll('.lanes g').length === 2", 60)
    browser.wait("return !document.querySelector('.standing.busy')", 60)
    browser.run("[...document.querySelectorAll('button')].find(b => b.innerText.trim() === 'Finish').click()")
    assert again.process.wait(60) == 0
    assert (out / "answers.jsonl").read_bytes() == kept
    assert json.loads((out / "coco.json").read_text()) == content
    assert [line for line in browser.complaints() if "ERR_CONNECTION" not in line] == []


def test_keys_answer_a_question_and_nothing_is_wider_than_a_phone(browser, command, scene, tmp_path):
    out = tmp_path / "labels"
    (tmp_path / "mot.txt").write_text("1,1," + ",".join(f"{value:.2f}" for value in scene[1][0]) + ",1\n")
    run = command(
        "annotate", scene[0], "--out", out, "--import", tmp_path / "mot.txt", "--threshold", "0.99", view=()
    )
    browser.open_view(run.address)
    browser.wait("return document.querySelector('.standing.asks')", 90)
    asked = frame(browser)
    assert asked > 0 and "0.99" in browser.run("return document.querySelector('.reason').innerText")
    picture = "const i = document.querySelector('.sheet img');"
    browser.wait(picture + f"return i.dataset.frame === '{asked}' && i.naturalWidth")
    for dark in (False, True):
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
        for size, name in ((DESKTOP, "1440"), (PHONE, "375")):
            browser.size(size)
            _, pixels = browser.screenshot(f"annotate_{name}_{'dark' if dark else 'light'}.png")
            assert browser.run("return document.documentElement.scrollWidth <= innerWidth")
            assert np.mean(pixels[:8]) < 60 if dark else np.mean(pixels[:8]) > 200
    browser.size(DESKTOP)
    from selenium.webdriver.common.keys import Keys

    browser.press(Keys.ENTER)
    browser.wait(f"return +document.querySelector('.lanes input').value > {asked}", 60)
    assert answers(out)[-1]["kind"] == "correct"
    browser.press("?")
    assert "undo" in browser.wait("return document.querySelector('.help')?.innerText")
    browser.press(Keys.ESCAPE)
    browser.wait("return !document.querySelector('.help')")
    # A name as it may be pasted is one that can be kept, and the longest one is no wider than the page.
    for name in ("car\u00a01", "b" * 90):
        browser.run(
            "const i = document.querySelector('.targets input'); i.value = arguments[0];"
            "i.dispatchEvent(new Event('input', {bubbles: true})); i.form.requestSubmit()",
            name,
        )
    chosen = browser.run(
        "return [...document.querySelectorAll('.targets button')].map(b => b.innerText.trim())"
    )
    assert "car 1" in chosen and "b" * 80 in chosen
    for size in (DESKTOP, PHONE):
        browser.size(size)
        rights = "[...document.querySelectorAll('.ask-panel *')].map(e => e.getBoundingClientRect().right)"
        assert browser.run(f"return Math.max(...{rights}) <= innerWidth")


def test_a_target_that_is_not_tracked_is_led_to_and_corrected(browser, command, scene, tmp_path):
    from selenium.webdriver.common.keys import Keys

    out = tmp_path / "labels"
    (tmp_path / "mot.txt").write_text("1,1,20,20,0.4,40,1\n")
    options = ("--graph", "gray_square", "--import", tmp_path / "mot.txt")
    run = command("annotate", scene[0], "--out", out, *options, view=())
    browser.open_view(run.address)
    settled(browser, "Where is target 1 in frame 0?")
    assert "at least 1 px" in browser.run("return document.querySelector('.reason').innerText")
    drag(browser, scene[1][0])
    browser.press(Keys.ENTER)
    tracked(browser, out, 2, 2)
    browser.wait("return document.querySelector('.lane-sure, .lane-doubtful')", 60)
    run.process.send_signal(signal.SIGINT)
    assert run.process.wait(60) == 0
