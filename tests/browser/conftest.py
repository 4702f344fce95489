"""A real Chromium, and pages of runs to open in it."""

import base64
import math
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import load_graph
from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.lives import TargetStarted
from bayesnet_track.journal.events.runs import RunEnded, RunStarted
from bayesnet_track.journal.events.statuses import StatusChanged
from bayesnet_track.journal.events.switches import Activated, Deactivated
from bayesnet_track.journal.metrics import FrameMetrics
from bayesnet_track.journal.target_net import Cause
from bayesnet_track.view.page_data import run_data
from bayesnet_track.view.run_page import Pictures, one_file, room_for_pictures

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
)
DESKTOP, PHONE = (1440, 960, 1), (375, 800, 2)


class Browser:
    """A page in Chromium."""

    def __init__(self, driver, folder):
        self.driver, self.folder = driver, folder

    def open(self, path, size=DESKTOP, dark=False, hash=""):
        self.size(size)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
        self.driver.get("about:blank")
        self.driver.get_log("browser")
        self.driver.get(Path(path).absolute().as_uri() + hash)
        self.wait("return document.getElementById('page')?.dataset.ready")
        self.wait("return document.querySelector('.picture canvas')?.dataset.frame ?? null")

    def open_view(self, address, size=DESKTOP):
        """The page of a run in progress."""
        self.size(size)
        self.driver.get("about:blank")
        self.driver.get_log("browser")
        self.driver.get_log("performance")
        self.driver.get(address)
        self.wait("return document.getElementById('page')?.dataset.ready")

    def wait_for_run(self):
        self.wait("return document.querySelector('.live.running')", 60)
        self.wait("return document.querySelector('.picture canvas')?.dataset.frame ?? null")

    def size(self, size):
        width, height, ratio = size
        metrics = {"width": width, "height": height, "deviceScaleFactor": ratio, "mobile": width < 500}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def wait(self, script, seconds=20.0):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            found = self.run(script)
            if found not in (None, False, ""):
                return found
            time.sleep(0.02)
        raise AssertionError(f"not within {seconds} s: {script}")

    @property
    def frame(self):
        """The frame that is shown: what the scrubber stands at."""
        return int(self.run("return document.querySelector('.scrubber input').value"))

    def wait_for_frame(self, frame):
        self.wait(f"return document.querySelector('.picture canvas').dataset.frame === '{frame}'")
        assert self.frame == frame

    def press(self, key, held=None):
        from selenium.webdriver.common.action_chains import ActionChains

        chain = ActionChains(self.driver)
        if held is None:
            chain.send_keys(key).perform()
        else:
            chain.key_down(held).send_keys(key).key_up(held).perform()

    def click(self, selector):
        """The middle of an element, found again if the page makes it anew meanwhile."""
        from selenium.common.exceptions import StaleElementReferenceException
        from selenium.webdriver.common.action_chains import ActionChains
        from selenium.webdriver.support.ui import WebDriverWait

        def click_now(driver):
            element = driver.find_element("css selector", selector)
            self.run("arguments[0].scrollIntoView({block: 'center'})", element)
            ActionChains(driver).move_to_element(element).click().perform()
            return True

        WebDriverWait(self.driver, 20.0, ignored_exceptions=[StaleElementReferenceException]).until(click_now)

    def complaints(self):
        """What the browser's console says."""
        return [line["message"] for line in self.driver.get_log("browser")]

    def screenshot(self, name):
        """The whole page as a picture; (path, pixels BGR)."""
        width, height = self.run("return [innerWidth, document.documentElement.scrollHeight]")
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        made = self.driver.execute_cdp_cmd(
            "Page.captureScreenshot", {"format": "png", "captureBeyondViewport": True, "clip": clip}
        )
        path = self.folder / name
        path.write_bytes(base64.b64decode(made["data"]))
        return path, cv2.imread(str(path))

    def print(self, name):
        made = self.driver.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})
        path = self.folder / name
        path.write_bytes(base64.b64decode(made["data"]))
        return path


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    driver = shutil.which("chromedriver")
    assert chromium and driver, "install Chromium and its driver: apt-get install chromium chromium-driver"
    options = Options()
    options.binary_location = chromium
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    started = webdriver.Chrome(options=options, service=Service(driver))
    folder = os.environ.get("BAYESNET_TRACK_SCREENSHOTS")
    if folder is not None:
        Path(folder).mkdir(parents=True, exist_ok=True)
    yield Browser(started, tmp_path_factory.mktemp("screenshots") if folder is None else Path(folder))
    started.quit()


class Command:
    """A command that serves a view."""

    def __init__(self, *arguments, view=("--quiet", "--view")):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "bayesnet_track", *map(str, arguments), *view],
            stderr=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
        )
        self.said = []
        for line in self.process.stderr:
            self.said.append(line.strip())
            if line.startswith("view: "):
                break
        assert self.said and self.said[-1].startswith("view: "), self.said
        self.address = self.said[-1].removeprefix("view: ")
        threading.Thread(
            target=lambda: self.said.extend(map(str.strip, self.process.stderr)), daemon=True
        ).start()


@pytest.fixture
def command():
    made = []

    def start(*arguments, **how):
        made.append(Command(*arguments, **how))
        return made[-1]

    yield start
    for one in made:
        one.process.kill()
        one.process.wait(10)


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    """Scene -> the page of a demo run of it."""
    made = {}

    def page(scene):
        if scene not in made:
            run = tmp_path_factory.mktemp("demo") / scene
            assert main(["demo", scene, "--quiet", "--out", str(run)]) == 0
            assert main(["report", str(run)]) == 0
            made[scene] = run / "report.html"
        return made[scene]

    return page


AGENTS = ("color", "intensity", "motion")


@pytest.fixture(scope="session")
def made_up_run():
    return _made_up_run


def _made_up_run(frames, source="long", graph="general", target="1", agents=AGENTS):
    """Events and metrics of a made-up run: UD rises and falls, and the last agent is switched with it."""
    spare = agents[-1]
    rng = np.random.default_rng(4)
    started = RunStarted(
        1, graph, "0" * 64, 0, source, 640, 480, True, frames, 0.04, {"color": 1.0}, {"numpy": "2"}
    )
    events = [started, TargetStarted(0, target, "orange", (320.0, 240.0, 60.0, 80.0), agents)]
    metrics, active = [], set(agents)
    for frame in range(frames):
        ud = 60.0 * math.exp(1.6 * math.sin(frame / 40.0) ** 8 + 0.1 * rng.normal())
        x, y = 320 + 200 * math.sin(frame / 300), 240 + 120 * math.cos(frame / 170)
        clouds = np.rint(np.array([x, y, 60, 80]) + rng.normal(size=(48, 4)) * [9, 9, 2, 2]).astype(int)
        names = tuple(sorted(active))
        numbers = {name: float(rng.exponential()) for name in names}
        metrics.append(
            FrameMetrics(
                frame,
                0.04 * frame,
                target,
                (x, y, 60.0, 80.0),
                (x + 1, y, 60.0, 80.0),
                (9.0, 9.0, 2.0, 2.0),
                ud,
                {"orange": ud},
                60.0,
                "lost" if ud > 280 else "tracking",
                float(np.clip(100 / ud, 0, 1)),
                float(-rng.exponential()),
                0.5,
                200.0,
                500,
                names,
                numbers,
                numbers,
                {name: 100.0 for name in names},
                {**numbers, "orange": 1.0},
                0.1,
                (x - 5, x + 5, y - 5, y + 5),
                (x - 14, x + 14, y - 14, y + 14),
                tuple(map(tuple, clouds.tolist())),
            )
        )
        if ud > 200 and spare not in active:
            cause = Cause("ud_px2", 200.0, ud, 2, ud, ud, 1.0)
            events.append(Activated(frame, target, spare, "orange", cause))
            active.add(spare)
        if ud < 70 and spare in active:
            cause = Cause("ud_px2", 130.0, ud, 4, ud, ud, 1.0)
            events.append(Deactivated(frame, target, spare, "orange", cause, "largest_kl", numbers))
            active.remove(spare)
        if frame and (metrics[-1].status != metrics[-2].status):
            events.append(StatusChanged(frame, target, metrics[-1].status, None, "made up"))
    return [*events, RunEnded(frames, frames, True, "end_of_source")], metrics


@pytest.fixture(scope="session")
def write_page():
    """Write the page of events and metrics, with as many and as large pictures as there is room for."""

    def write(path, events, metrics, graph="orange_and_gray", truth=None):
        timings = [
            {"frame": line.frame, "seconds": 0.004, "parts": {name: 0.001 for name in line.active}}
            for line in metrics
        ]
        header, columns = run_data(events, metrics, timings, graph and load_graph(graph), truth)
        rng = np.random.default_rng(1)
        grain = rng.integers(0, 255, (60, 80, 3), dtype=np.uint8)
        image = cv2.resize(grain, (320, 240), interpolation=cv2.INTER_CUBIC)
        data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 50])[1].tobytes()
        count = min(len(metrics), room_for_pictures(header, columns) // len(data))
        step = -(-len(metrics) // count)
        shown = tuple(line.frame for line in metrics[::step])
        text = "".join(one_file(header, columns, {"": Pictures(shown, (data,) * len(shown), step)}))
        path.write_text(text, encoding="utf-8")
        return path

    return write
