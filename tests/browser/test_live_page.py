"""A run in progress in a real browser: where it starts, holding it, switching, looking back, its end."""

import itertools
import json

import cv2
import numpy as np
import pytest

from bayesnet_track import Start, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.reader import read_inputs
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

pytestmark = pytest.mark.slow

DESKTOP, PHONE = (1440, 960, 1), (375, 800, 2)
FILES = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "inputs.jsonl")


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """Two squares there and back: long enough to be held while it runs."""
    folder = tmp_path_factory.mktemp("video")
    scene = make_scene("two_squares", seed=0)
    frames = [scene.frames[number] for number in range(150)]
    for number, frame in enumerate([*frames, *frames[::-1]]):
        cv2.imwrite(str(folder / f"{number:04d}.png"), frame)
    return folder


def corner(browser, x, y, width=320, height=240):
    """Where on the screen a place of the first frame is."""
    left, top, w, h = browser.run(
        "const r = document.querySelector('.sheet svg').getBoundingClientRect();"
        "return [r.left, r.top, r.width, r.height]"
    )
    return left + x / width * w, top + y / height * h


def drag(browser, start, end):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.actions.action_builder import ActionBuilder

    actions = ActionBuilder(browser.driver)
    pointer = actions.pointer_action
    pointer.move_to_location(*map(round, corner(browser, *start))).pointer_down()
    pointer.move_to_location(*map(round, corner(browser, *np.add(start, end) / 2)))
    pointer.move_to_location(*map(round, corner(browser, *end))).pointer_up()
    actions.perform()
    ActionChains(browser.driver).reset_actions()


def boxes(browser):
    values = browser.run("return [...document.querySelectorAll('.boxes fieldset input')].map(i => +i.value)")
    return [values[k : k + 4] for k in range(0, len(values), 4)]


def standing(browser):
    return browser.run("return document.querySelector('.live .standing').innerText")


def agent(browser, name):
    return browser.run(
        "return [...document.querySelectorAll('.node.agent')].find("
        f"n => n.querySelector('.name').textContent === '{name}')"
    )


def press_button(browser, text):
    browser.run(
        f"[...document.querySelectorAll('button')].find(b => b.innerText.trim().startsWith({text!r})).click()"
    )


def test_from_a_dragged_box_to_a_run_that_is_held_switched_stopped_and_repeated(
    browser, command, video, tmp_path
):
    from selenium.webdriver.common.keys import Keys

    run = tmp_path / "run"
    started = command("run", "two_squares", "--source", video, "--out", run)
    browser.open_view(started.address)
    browser.wait("return document.querySelector('.sheet img')?.complete")
    # Enter without a box says what is missing; Escape takes back what was drawn.
    browser.press(Keys.ENTER)
    assert "Draw a box" in browser.wait("return document.querySelector('.problem')?.innerText")
    drag(browser, (20, 30), (60, 90))
    assert len(boxes(browser)) == 1
    browser.press(Keys.ESCAPE)
    assert boxes(browser) == []
    x, y, w, h = map(int, make_scene("two_squares", seed=0).start_box)
    drag(browser, (x, y), (x + w, y + h))
    drawn = boxes(browser)[0]
    assert np.abs(np.subtract(drawn, (x, y, w, h))).max() <= 1
    browser.screenshot("live_start.png")
    # The keyboard puts it right to the pixel.
    for now, key, wanted, held in [
        (drawn[0], (Keys.ARROW_LEFT, Keys.ARROW_RIGHT), x, None),
        (drawn[1], (Keys.ARROW_UP, Keys.ARROW_DOWN), y, None),
        (drawn[2], (Keys.ARROW_LEFT, Keys.ARROW_RIGHT), w, Keys.SHIFT),
        (drawn[3], (Keys.ARROW_UP, Keys.ARROW_DOWN), h, Keys.SHIFT),
    ]:
        for _ in range(abs(int(wanted - now))):
            browser.press(key[wanted > now], held)
    assert boxes(browser) == [[x, y, w, h]]
    browser.press(Keys.ENTER)
    browser.wait_for_run()

    browser.press(" ")
    browser.wait("return document.querySelector('.live.paused')")
    browser.wait("const s = document.querySelector('.scrubber input'); return s.value === s.max")
    at = browser.frame
    assert f"Paused at frame {at} of 299" in standing(browser)
    browser.press(".")
    browser.wait_for_frame(at + 1)
    assert "Paused" in standing(browser)

    # What a person switches works from the frame after the next one on, and stays.
    was_on = "on" in agent(browser, "color").get_attribute("class").split()
    browser.run("arguments[0].focus()", agent(browser, "color"))
    browser.press(Keys.ENTER)
    asked = browser.wait("return document.querySelector('.hands')?.innerText")
    assert ("color off by hand" if was_on else "color on by hand") in asked
    browser.press(".")
    browser.wait_for_frame(at + 2)
    browser.press(".")
    browser.wait_for_frame(at + 3)
    browser.wait("return document.querySelector('.badge')")
    assert ("on" in agent(browser, "color").get_attribute("class").split()) != was_on
    browser.screenshot("live_switched.png")
    press_button(browser, "Give back to the rules")
    browser.press(".")
    browser.wait_for_frame(at + 4)
    browser.wait("return document.querySelector('.hands') === null")

    # Looking back while it runs: it goes on, and nothing can be switched there.
    browser.press(Keys.HOME)
    browser.wait_for_frame(0)
    press_button(browser, "Go on")
    browser.wait(f"return +document.querySelector('.scrubber input').max > {at + 8}")
    assert browser.frame == 0
    node = agent(browser, "color")
    assert node.get_attribute("aria-pressed") is None
    assert node.get_attribute("aria-label") == "color: its parameters"
    assert "frames ahead" in browser.run("return document.querySelector('.catch-up').innerText")
    browser.screenshot("live_back.png")
    browser.press("l")
    browser.wait(f"return +document.querySelector('.scrubber input').value > {at + 8}")

    # Stopping asks once more.
    press_button(browser, "Stop")
    press_button(browser, "Stop for good?")
    browser.wait("return document.querySelector('.live.ended')")
    assert "You stopped the run" in standing(browser)
    press_button(browser, "Close the view")
    assert started.process.wait(20) == 130
    browser.wait("return document.querySelector('.live .standing').innerText.includes('this page stays')")
    browser.press(Keys.HOME)
    browser.wait_for_frame(0)
    lines = [json.loads(line["message"])["message"] for line in browser.driver.get_log("performance")]
    sent = [
        line["params"]["request"]["url"] for line in lines if line["method"] == "Network.requestWillBeSent"
    ]
    assert sent and all(one.startswith((started.address, "blob:", "data:", "about:")) for one in sent)

    inputs = list(read_inputs(run / "inputs.jsonl"))
    assert [(type(one).__name__, one.frame) for one in inputs] == [("Toggled", at + 2), ("Released", at + 4)]
    tracked = len((run / "tracks.txt").read_text().splitlines())
    again = tmp_path / "again"
    given = [
        "--init",
        f"{x:g},{y:g},{w:g},{h:g}",
        "--inputs",
        str(run / "inputs.jsonl"),
        "--end",
        str(tracked),
    ]
    main(["run", "two_squares", "--source", str(video), "--out", str(again), "--quiet", *given])
    for name in FILES[1:]:
        assert (again / name).read_bytes() == (run / name).read_bytes()
    # The journals differ in how many frames were declared, and how it ended.
    first, second = ((one / "journal.jsonl").read_text().splitlines()[1:-1] for one in (run, again))
    assert first == second and first


def test_two_targets_are_drawn_with_a_finger_on_a_phone(browser, command, video, tmp_path):
    run = tmp_path / "run"
    started = command("run", "orange_and_gray", "--source", video, "--out", run, "--end", "60")
    browser.open_view(started.address, PHONE)
    browser.wait("return document.querySelector('.sheet img')?.complete")
    touch = {"enabled": True, "maxTouchPoints": 1}
    browser.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", touch)
    try:
        for start, end in [((100, 60), (150, 120)), ((200, 120), (240, 160))]:
            for kind, place in [
                ("touchStart", start),
                ("touchMove", np.add(start, end) / 2),
                ("touchMove", end),
                ("touchEnd", None),
            ]:
                points = [] if place is None else [dict(zip("xy", corner(browser, *place), strict=True))]
                browser.driver.execute_cdp_cmd(
                    "Input.dispatchTouchEvent", {"type": kind, "touchPoints": points}
                )
    finally:
        browser.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
    assert np.abs(np.subtract(boxes(browser), [[100, 60, 50, 60], [200, 120, 40, 40]])).max() <= 1
    plates = browser.run("return [...document.querySelectorAll('.boxes select')].map(s => s.value)")
    assert plates == ["orange", "gray"]
    assert browser.run("return document.documentElement.scrollWidth") <= 375
    browser.screenshot("live_start_phone.png")
    press_button(browser, "Start tracking")
    browser.wait("return document.querySelector('.live')", 60)
    browser.wait("return document.querySelector('.live.ended')", 60)
    assert browser.run("return document.documentElement.scrollWidth") <= 375
    assert len(browser.run("return [...document.querySelectorAll('nav.targets button')]")) == 2
    browser.screenshot("live_phone.png")
    assert browser.complaints() == []


def test_a_demo_waits_for_its_page_and_stays_until_it_is_closed(browser, command, tmp_path):
    from selenium.webdriver.common.keys import Keys

    run = tmp_path / "run"
    started = command("demo", "two_squares", "--end", "40", "--out", run)
    assert not (run / "journal.jsonl").exists()
    browser.open_view(started.address)
    browser.wait("return document.querySelector('.live.ended')", 60)
    assert "The run has ended after 40 frames" in standing(browser)
    browser.wait_for_frame(39)
    browser.press(Keys.ARROW_LEFT)
    browser.wait_for_frame(38)
    nameless = browser.run(
        "return [...document.querySelectorAll('button, input, select, canvas, [role=button]')].filter(e =>"
        " !(e.getAttribute('aria-label') || e.innerText?.trim() || e.labels?.[0]?.innerText.trim()"
        " || e.closest('[aria-hidden=true]') || e.closest('[role=img][aria-label]'))).map(e => e.outerHTML)"
    )
    assert nameless == []
    # Another page of the same run is told everything from its first frame on.
    browser.driver.refresh()
    browser.wait("return document.querySelector('.live.ended')")
    browser.wait_for_frame(39)
    assert started.process.poll() is None
    browser.driver.get("about:blank")
    assert started.process.wait(20) == 0


def test_an_address_without_its_token_shows_nothing(browser, command, tmp_path):
    started = command("demo", "two_squares", "--end", "5", "--out", tmp_path / "run")
    host = "/".join(started.address.split("/")[:3])
    browser.driver.get(f"{host}/")
    assert "token" in browser.run("return document.body.innerText")
    assert browser.run("return document.scripts.length") == 0
    started.process.terminate()
    assert started.process.wait(10) == 143


def test_a_run_that_goes_on_has_what_was_before(browser, command, tmp_path):
    from selenium.webdriver.common.keys import Keys

    source = SceneSource.named("two_squares", 0, 60)
    results = track("two_squares", source, [Start(source.scene.start_box)], out=tmp_path / "run")
    for _ in itertools.islice(results, 30):
        pass
    results.close()
    started = command("resume", tmp_path / "run")
    browser.open_view(started.address)
    browser.wait("return document.querySelector('.live.ended')", 60)
    assert "The run has ended after 60 frames" in standing(browser)
    at = browser.run("return [...document.querySelectorAll('.events .at')].map(e => +e.textContent)")
    assert at[:3] == [0, 6, 25]
    browser.press(Keys.HOME)
    browser.wait_for_frame(0)
    assert browser.run("return document.querySelector('.moment .status').innerText").startswith("Frame 0")
    browser.driver.get("about:blank")
    assert started.process.wait(20) == 0
