"""The page of a run in a real browser: it opens, scrubs, explains, obeys the keyboard, and asks nobody."""

import csv
import json
import statistics
from dataclasses import replace

import numpy as np
import pytest

from bayesnet_track import Start, open_run, track
from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.target_net import FitCause
from bayesnet_track.sources.scenes.library import SceneSource

pytestmark = pytest.mark.slow

HOSTILE = '</script><script>window.hacked=1</script><img src=x onerror="window.hacked=2">\'"&lt;'
DESKTOP, PHONE = (1440, 960, 1), (375, 800, 2)


def text_of(browser, selector):
    return browser.run(f"return document.querySelector({selector!r}).innerText")


def requests(browser):
    """Addresses of everything that was asked for over a network since the last look."""
    lines = [json.loads(line["message"])["message"] for line in browser.driver.get_log("performance")]
    sent = [
        line["params"]["request"]["url"] for line in lines if line["method"] == "Network.requestWillBeSent"
    ]
    return [address for address in sent if not address.startswith(("file:", "blob:", "data:", "about:"))]


def test_scrubbing_moves_picture_boxes_and_numbers(browser, demo):
    browser.open(demo("two_squares"))
    assert browser.frame == 0
    browser.run(
        "const s = document.querySelector('.scrubber input'); s.value = 29;"
        "s.dispatchEvent(new Event('input', {bubbles: true}))"
    )
    browser.wait_for_frame(29)
    assert "Frame 29" in text_of(browser, ".moment .status")
    label = browser.run("return document.querySelector('.picture canvas').getAttribute('aria-label')")
    assert label.startswith("Frame 29: target 1 tracking, centre")
    assert browser.complaints() == []


def test_the_head_names_the_run_and_says_what_is_not_known(browser, demo):
    page = demo("two_squares")
    browser.open(page)
    assert text_of(browser, "h1") == page.parent.name  # the run's own name, without "partial run"
    names = browser.run("return [...document.querySelectorAll('.headline dt')].map(d => d.innerText)")
    assert names[1:3] == ["lost", "uncertain"]
    # No score was fitted to this graph: a box that is followed is not shown as one that is right.
    assert browser.run("return document.querySelector('.status .chip').className") == "chip not-judged"
    assert "cannot tell whether the box is right" in text_of(browser, ".status")


def test_the_page_of_a_smoothed_run_says_so_and_which_numbers_are_the_filters(browser, tmp_path):
    source = SceneSource.named("flying_ball", 0, 12)
    starts = [Start(source.scene.start_box)]
    list(track("kalman_ball", source, starts, out=tmp_path / "run", keep_beliefs=True))
    assert main(["smooth", str(tmp_path / "run"), "--out", str(tmp_path / "smoothed")]) == 0
    assert main(["report", str(tmp_path / "smoothed")]) == 0
    browser.open(tmp_path / "smoothed" / "report.html")
    assert text_of(browser, "h1 .smoothed").strip() == "smoothed"
    names = browser.run("return [...document.querySelectorAll('.numbers dt')].map(d => d.innerText)")
    assert {"UD", "log evidence, filter", "surprise, filter"} <= set(names)


def test_the_frame_is_saved_as_a_picture_named_after_the_run(browser, demo):
    browser.open(demo("two_squares"), hash="#frame=12")
    browser.wait_for_frame(12)
    browser.run(
        "const made = URL.createObjectURL;"
        "URL.createObjectURL = blob => { window.picture = blob; return made(blob); };"
        "HTMLAnchorElement.prototype.click = function() { window.saved = this.download; };"
        "document.querySelector('.take button').click()"
    )
    assert browser.wait("return window.saved").endswith("_frame_12.png")
    head = browser.run("return window.picture.arrayBuffer().then(b => [...new Uint8Array(b.slice(0, 4))])")
    assert bytes(head) == b"\x89PNG"


def test_pressing_a_node_shows_its_parameters_and_its_band_and_hides_them_again(browser, demo):
    browser.open(demo("two_squares"))
    press = (
        "[...document.querySelectorAll('.node')].find(n => n.querySelector('.name').textContent === 'motion')"
        ".dispatchEvent(new MouseEvent('click', {bubbles: true}))"
    )
    band = "return document.querySelector('.plot-agents canvas').toDataURL()"
    before = browser.run(band)
    browser.run(press)
    assert "coherent_px: 1" in browser.wait("return document.querySelector('.settings')?.innerText")
    # Its band stands out in the timeline, and the others step back.
    assert (
        browser.wait("return document.querySelector('.plot.chosen')?.className").split()[1] == "plot-agents"
    )
    browser.wait(f"return (() => {{ {band} }})() !== {json.dumps(before)}")
    browser.run(press)
    browser.wait("return document.querySelector('.settings') === null")
    browser.wait(f"return (() => {{ {band} }})() === {json.dumps(before)}")
    browser.run(press.replace("'motion'", "'square'"))
    assert "plot-ud" in browser.wait("return document.querySelector('.plot.chosen')?.className")


def test_clicking_an_event_shows_its_frame_and_its_sentence(browser, demo):
    browser.open(demo("two_squares"))
    browser.run(
        "[...document.querySelectorAll('.events b')].find(b => b.textContent === 'motion on').click()"
    )
    sentence = browser.wait("return document.querySelector('.told.on')?.innerText")
    assert "motion on" in sentence and "UD" in sentence and "> 130 for 1 frame" in sentence
    assert "would have stayed off at activate ≥" in sentence
    browser.wait_for_frame(browser.frame)
    lit = browser.run("return [...document.querySelectorAll('.node.agent.on .name')].map(n => n.textContent)")
    # The decision works from the next frame on.
    assert "motion" not in lit
    from selenium.webdriver.common.keys import Keys

    browser.press(Keys.ARROW_RIGHT)
    browser.wait(
        "return [...document.querySelectorAll('.node.agent.on .name')].some(n => n.textContent === 'motion')"
    )


def test_clicking_a_timeline_goes_to_its_frame(browser, demo):
    browser.open(demo("two_squares"))
    browser.click(".plot-score .u-over")
    # The middle of 200 frames, drawn from -0.5 to 199.5.
    assert abs(browser.frame - 100) <= 1


def test_keyboard(browser, demo):
    from selenium.webdriver.common.keys import Keys

    browser.open(demo("two_squares"))
    events = browser.run(
        "return [...document.querySelectorAll('.events .at')].map(n => Number(n.textContent))"
    )
    later = [frame for frame in dict.fromkeys(events) if frame > 0]
    browser.press("n")
    browser.wait_for_frame(later[0])
    browser.press("n")
    browser.wait_for_frame(later[1])
    browser.press("p")
    browser.wait_for_frame(later[0])
    browser.press(Keys.END)
    browser.wait_for_frame(199)
    browser.press(Keys.HOME)
    browser.wait_for_frame(0)
    browser.press(Keys.ARROW_RIGHT)
    browser.wait_for_frame(1)
    browser.press(Keys.ARROW_RIGHT, held=Keys.SHIFT)
    browser.wait_for_frame(11)
    browser.press(Keys.ARROW_LEFT)
    browser.wait_for_frame(10)
    browser.press("?")
    assert browser.wait("return document.querySelector('[role=dialog]')?.innerText").startswith("Keys")
    browser.press(Keys.ESCAPE)
    browser.wait("return document.querySelector('[role=dialog]') === null")
    browser.press(" ")
    browser.wait("return Number(document.querySelector('.scrubber input').value) > 14")
    browser.press(" ")
    browser.wait("return document.querySelector('.play').getAttribute('aria-label') === 'Play'")


def test_targets_are_chosen_by_name_and_on_the_picture(browser, demo):
    browser.open(demo("orange_and_gray"))
    assert "Net of orange" in text_of(browser, ".net")
    browser.run("document.querySelectorAll('nav.targets button')[1].click()")
    browser.wait("return document.querySelector('.net h2').textContent === 'Net of gray'")
    assert "gray 2" in text_of(browser, ".charts h2")
    # The orange square's centre in frame 0 is (270, 190) of 320 x 240.
    browser.run(
        "const c = document.querySelector('.picture canvas'), r = c.getBoundingClientRect();"
        "c.dispatchEvent(new MouseEvent('click', {bubbles: true, clientX: r.left + 270.5 / 320 * r.width,"
        "clientY: r.top + 190.5 / 240 * r.height}))"
    )
    browser.wait("return document.querySelector('.net h2').textContent === 'Net of orange'")


def test_an_address_leads_to_a_frame_of_a_target(browser, demo):
    browser.open(demo("orange_and_gray"), hash="#frame=24&target=2")
    browser.wait_for_frame(24)
    assert "Net of gray" in text_of(browser, ".net")


def test_every_frame_in_a_folder(browser, tmp_path):
    run = tmp_path / "run"
    assert main(["demo", "flying_ball", "--quiet", "--end", "6", "--out", str(run)]) == 0
    assert main(["report", str(run), "--frames", "full"]) == 0
    assert len(list((run / "report" / "frames").iterdir())) == 6
    browser.open(run / "report" / "index.html", hash="#frame=5")
    browser.wait_for_frame(5)
    pixel = browser.run(
        "const c = document.querySelector('.picture canvas');"
        "try { return [...c.getContext('2d').getImageData(c.width / 2, 8, 1, 1).data] }"
        "catch { return 'drawn' }"
    )
    # A picture from a file may be painted, not read back; what is painted without one is #20262e.
    assert pixel != [0x20, 0x26, 0x2E, 255]
    assert browser.complaints() == []


def test_hostile_names_stay_text(browser, tmp_path, write_page, made_up_run):
    events, metrics = made_up_run(
        60, source=HOSTILE, graph=HOSTILE, target=HOSTILE, agents=(HOSTILE, "b'\"<b>")
    )
    page = write_page(tmp_path / "hostile.html", events, metrics, graph=None)
    browser.open(page, hash="#frame=30")
    for _ in range(3):
        browser.press("n")
    browser.wait("return document.querySelector('h1').textContent.length > 0")
    assert text_of(browser, "h1") == HOSTILE
    assert HOSTILE in text_of(browser, ".top .source")
    assert browser.run("return [window.hacked ?? null, document.querySelectorAll('img').length]") == [None, 0]
    assert browser.driver.title.startswith(HOSTILE)
    assert browser.complaints() == []


def test_nothing_is_asked_of_a_network_and_the_policy_forbids_it(browser, demo):
    requests(browser)
    browser.open(demo("two_squares"))
    browser.press("n")
    assert requests(browser) == []
    refused = browser.run(
        "return new Promise(done => {"
        "  document.addEventListener('securitypolicyviolation', e => done(e.violatedDirective));"
        "  fetch('http://127.0.0.1:9/').catch(() => {}); setTimeout(() => done('nothing'), 3000) })"
    )
    assert refused == "connect-src"
    browser.complaints()


def test_a_long_run_opens_quickly(browser, tmp_path, write_page, made_up_run, capsys):
    page = write_page(tmp_path / "long.html", *made_up_run(5000))
    size = page.stat().st_size
    assert size <= 10_000_000
    ready = []
    for _ in range(3):
        browser.open(page)
        ready.append(float(browser.run("return document.getElementById('page').dataset.ready")) / 1000)
        painted = browser.run("return performance.getEntriesByName('first-contentful-paint')[0].startTime")
    opened = statistics.median(ready)
    with capsys.disabled():
        print(
            f"\n5,000 frames: {size / 1e6:.1f} MB, open after {opened:.2f} s, painted {painted / 1e3:.2f} s"
        )
    # The figure to hold is 2 s; machines that share their cores get twice that.
    assert opened <= 4.0
    browser.run(
        "window.took = []; const s = document.querySelector('.scrubber input');"
        "for (let k = 0; k < 50; k += 1) { const t = performance.now(); s.value = 97 * k;"
        "s.dispatchEvent(new Event('input', {bubbles: true})); window.took.push(performance.now() - t) }"
    )
    assert statistics.median(browser.run("return window.took")) < 50


@pytest.mark.parametrize("scene", ["two_squares", "crowd", "orange_and_gray"])
def test_phone_width_needs_no_sideways_scrolling(browser, demo, scene):
    browser.open(demo(scene), PHONE)
    assert browser.run("return document.documentElement.scrollWidth") <= 375
    browser.press("n")
    assert browser.run("return document.documentElement.scrollWidth") <= 375


def test_screenshots_light_dark_phone_and_print(browser, demo):
    page = demo("two_squares")
    browser.open(page, hash="#frame=27")
    _, light = browser.screenshot("desktop.png")
    browser.open(page, dark=True, hash="#frame=27")
    _, dark = browser.screenshot("dark.png")
    browser.open(page, PHONE, hash="#frame=27")
    _, phone = browser.screenshot("phone.png")
    assert light.shape[1] == 1440 and phone.shape[1] == 375 * 2
    assert np.median(light) > 200 and np.median(dark) < 60
    # Each plot has ink: the playhead alone would be a column or two.
    browser.open(page, hash="#frame=27")
    inked = browser.run(
        "return [...document.querySelectorAll('.plot canvas')].map(c => { const d ="
        " c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
        " let n = 0; for (let k = 3; k < d.length; k += 4) n += d[k] > 128; return n })"
    )
    assert len(inked) == 6 and min(inked) > 1000
    printed = browser.print("page.pdf").read_bytes()
    assert printed.startswith(b"%PDF") and len(printed) > 50_000


def test_paper_has_plots_of_its_own_width_and_colours(browser, demo):
    browser.open(demo("two_squares"), PHONE, dark=True)
    # What is still to be drawn in the next frame would be drawn for the phone.
    browser.run("requestAnimationFrame(() => requestAnimationFrame(() => (window.rested = true)))")
    browser.wait("return window.rested")
    browser.run(
        "window.seen = []; addEventListener('beforeprint', () => queueMicrotask(() => seen.push("
        "document.querySelector('.plot-ud .u-wrap').clientWidth,"
        "getComputedStyle(document.documentElement).getPropertyValue('--ink'))))"
    )
    browser.print("dark_phone.pdf")
    wide, ink = browser.run("return window.seen")
    assert wide > 900 and ink == "#17202b"
    browser.wait("return document.querySelector('.plot-ud .u-wrap').clientWidth < 375")


def test_a_loss_says_why_as_long_as_it_lasts(browser, tmp_path, write_page, made_up_run):
    cause = FitCause(0.05, 0.012, 3, 0.031)
    events, metrics = made_up_run(40)
    events = [one for one in events if not isinstance(one, StatusChanged)]
    events.insert(-1, StatusChanged(9, "1", "lost", cause))
    metrics = [replace(line, status="lost" if line.frame > 9 else "tracking", ud_px2=4.0) for line in metrics]
    page = write_page(tmp_path / "lost.html", events, metrics)
    browser.open(page, hash="#frame=9")
    assert text_of(browser, ".told.lost dt + dd").startswith("the best hypothesis has a fit of 0.012")
    assert "would not have been lost at fit_below ≤ 0.031" in text_of(browser, ".told.lost")
    browser.open(page, hash="#frame=30")
    assert text_of(browser, ".since").startswith("lost since frame 10: the best hypothesis has a fit of")
    assert "would not have been lost at fit_below ≤ 0.031" in text_of(browser, ".since")


@pytest.mark.parametrize("width", [1440, 1300, 1161, 1000, 375])
def test_no_column_of_the_totals_is_cut(browser, tmp_path, width, write_page, made_up_run):
    events, metrics = made_up_run(400)
    metrics = [replace(line, status="uncertain") if line.frame % 3 else line for line in metrics]
    browser.open(
        write_page(
            tmp_path / "page.html", events, metrics, truth=np.tile([300.0, 220.0, 60.0, 80.0], (400, 1))
        ),
        (width, 900, 1),
    )
    wide, shown = browser.run(
        "const w = document.querySelector('.totals .wide'); return [w.scrollWidth, w.clientWidth]"
    )
    assert wide <= shown
    last = browser.run("return document.querySelector('.totals td:last-child').dataset.name")
    assert last == "overlap" and text_of(browser, ".totals td:last-child")[:2] == "0."


def test_everything_that_is_pressed_has_a_name(browser, demo):
    browser.open(demo("orange_and_gray"))
    nameless = browser.run(
        "return [...document.querySelectorAll('button, input, select, canvas, svg')].filter(e =>"
        " !(e.getAttribute('aria-label') || e.closest('[aria-hidden=true]') || e.innerText?.trim() ||"
        " e.labels?.[0]?.innerText.trim() || e.closest('[role=img][aria-label]'))).map(e => e.outerHTML)"
    )
    assert nameless == []


def test_in_a_notebook_the_page_works_in_a_frame_that_reaches_nothing_of_it(browser, demo, tmp_path):
    shown = open_run(demo("two_squares").parent).page(height=700)
    (tmp_path / "cell.html").write_text(f"<!doctype html><body>{shown._repr_html_()}</body>", "utf-8")
    for size in (DESKTOP, PHONE):
        browser.size(size)
        browser.driver.get((tmp_path / "cell.html").as_uri())
        browser.driver.switch_to.frame(browser.driver.find_element("css selector", "iframe"))
        browser.wait("return document.getElementById('page')?.dataset.ready")
        browser.wait("return document.querySelector('.picture canvas')?.dataset.frame ?? null")
        browser.run(
            "const s = document.querySelector('.scrubber input'); s.value = 29;"
            "s.dispatchEvent(new Event('input', {bubbles: true}))"
        )
        browser.wait_for_frame(29)
        assert browser.run("return self.origin") == "null"
        assert browser.run("return innerWidth >= document.documentElement.scrollWidth")
        assert "copy link" not in text_of(browser, ".take")  # there is no address to link to
        browser.driver.switch_to.default_content()
    assert browser.complaints() == []


def test_a_band_shows_the_probability_of_each_mode(browser, tmp_path):
    source = SceneSource.named("flying_ball", 0, 12)
    list(track("hidden_ball", source, [Start(source.scene.start_box)], out=tmp_path / "run"))
    assert main(["report", str(tmp_path / "run"), "--frames", "none"]) == 0
    browser.open(tmp_path / "run" / "report.html", hash="#frame=11")
    names = browser.run("return [...document.querySelectorAll('.plot b')].map(one => one.innerText)")
    assert names[:3] == ["Uncertainty", "Modes", "Agents"]
    last = open_run(tmp_path / "run").metrics[-1]
    shown = text_of(browser, ".plot-modes .readout").split()
    assert [shown[0], shown[2]] == ["behind", "seen"]  # what hides is at the bottom
    np.testing.assert_allclose([float(shown[1]), float(shown[3])], [last.hidden, 1 - last.hidden], atol=0.01)
    numbers = browser.run("return [...document.querySelectorAll('.numbers div')].map(d => d.innerText)")
    (hidden,) = (text.split() for text in numbers if text.startswith("hidden"))
    assert float(hidden[1]) == round(last.hidden, 2)
    assert browser.complaints() == []


@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_several_cameras_and_the_ground_stand_side_by_side_and_say_who_was_knocked(browser, demo, size):
    browser.open(demo("room_knocked"), size, hash="#frame=110")
    browser.wait_for_frame(110)
    names = browser.run("return [...document.querySelectorAll('.tile button')].map(b => b.innerText)")
    assert names == ["north", "east", "west", "ground"]
    inked = browser.run(
        "return [...document.querySelectorAll('.tile canvas')].map(c => { const d ="
        " c.getContext('2d').getImageData(0, 0, c.width, c.height).data, inks = new Set();"
        " for (let k = 0; k < d.length; k += 4) inks.add(d[k] << 16 | d[k + 1] << 8 | d[k + 2]);"
        " return ['6fd3ff', 'ffc933', '4ade9b', 'ff8a65', 'c7a6ff'].map(i => inks.has(parseInt(i, 16))) })"
    )
    assert (
        inked == [[True] * 5] * 4
    )  # each of the five targets in its colour, in every camera and on the ground
    assert "camera west is" in text_of(browser, ".events")
    assert " m²" in text_of(browser, ".numbers")
    wide = browser.run("return document.querySelector('.ground canvas').clientWidth")
    browser.click(".ground button")
    browser.wait(f"return document.querySelector('.ground canvas').clientWidth > {wide}")
    assert browser.run("return document.querySelector('.ground button').ariaPressed") == "true"
    assert browser.run("return document.documentElement.scrollWidth") <= size[0]
    assert browser.complaints() == []


def test_a_target_is_chosen_in_the_image_of_any_camera(browser, demo):
    browser.open(demo("room_knocked"), hash="#frame=110&target=1")
    browser.wait_for_frame(110)
    with (demo("room_knocked").parent / "cameras.csv").open() as file:
        (row,) = [
            r for r in csv.DictReader(file) if (r["frame"], r["camera"], r["target"]) == ("110", "east", "5")
        ]
    x, y = float(row["x"]) + float(row["w"]) / 2, float(row["y"]) + float(row["h"]) / 2
    browser.run(
        "const c = document.querySelectorAll('.tile canvas')[1], r = c.getBoundingClientRect();"
        "c.dispatchEvent(new MouseEvent('click', {bubbles: true,"
        " clientX: r.left + arguments[0] / 640 * r.width, clientY: r.top + arguments[1] / 360 * r.height}))",
        x,
        y,
    )
    browser.wait("return document.querySelector('.targets [aria-pressed=true]').innerText.includes('5')")
    assert browser.complaints() == []
