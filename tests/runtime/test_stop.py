"""Stopping by signals: nothing that arrives is lost, files are valid, and the exit code is the shell's."""

import ctypes
import gc
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import weakref
from contextlib import ExitStack, suppress
from importlib import import_module

import pytest

from bayesnet_track.cli import main as commands
from bayesnet_track.cli.main import main
from bayesnet_track.journal.events.runs import RunEnded
from bayesnet_track.journal.reader import read_events, read_metrics
from bayesnet_track.runtime import stop as module
from bayesnet_track.runtime.recording.rundir import RunDirectory
from bayesnet_track.runtime.stop import SIGNALS, StopRequest, Terminated

HANG_S = 300
"""Far more than a busy machine needs: what takes so long hangs."""


def state():
    """What a stop request changes of the process."""
    handlers = [signal.getsignal(number) for number in SIGNALS]
    return handlers, sys.unraisablehook, sys.excepthook, threading.active_count()


def wait_for_more():
    """Run Python code until a signal ends it."""
    end = time.monotonic() + HANG_S
    while time.monotonic() < end:
        pass
    pytest.fail("what was raised is lost")


def wait_for_repeats():
    time.sleep(50 * module.REPEAT_S)


@pytest.fixture
def often(monkeypatch):
    """What came to nothing is raised again at once."""
    monkeypatch.setattr(module, "REPEAT_S", 0.002)


@pytest.fixture
def complaints(monkeypatch):
    """What Python would print of errors that it gave up."""
    seen = []
    monkeypatch.setattr(sys, "unraisablehook", seen.append)
    monkeypatch.setattr(sys, "excepthook", lambda *error: seen.append(error))
    return seen


# ------------------------------------------------------------------------------------ at once, or noted


@pytest.mark.parametrize("number", SIGNALS)
def test_without_patience_the_first_one_acts(number):
    with pytest.raises(KeyboardInterrupt) as ended, StopRequest() as stop:
        assert (stop.signal, stop.exit_code) == (None, 0)
        signal.raise_signal(number)
    assert (type(ended.value) is Terminated) == (number == signal.SIGTERM)
    assert (stop.signal, stop.exit_code) == (number, 128 + number)


@pytest.mark.parametrize("number", SIGNALS)
def test_with_patience_a_signal_is_noted_and_the_second_acts(number, often):
    with pytest.raises(KeyboardInterrupt), StopRequest() as stop:
        assert not stop.between_frames()
        signal.raise_signal(number)
        assert (stop.signal, stop.exit_code) == (number, 128 + number)
        wait_for_repeats()
        signal.raise_signal(number)
        pytest.fail("the second one did not act")


@pytest.mark.parametrize("number", SIGNALS)
def test_patience_ends(number, often, monkeypatch):
    """Kernels may be compiled in any frame, and callbacks of the compiler give up what is raised."""
    monkeypatch.setattr(module, "PATIENCE_S", 0.01)
    with pytest.raises(KeyboardInterrupt) as ended, StopRequest() as stop:
        stop.between_frames()
        signal.raise_signal(number)
        with suppress(KeyboardInterrupt):
            wait_for_more()
        wait_for_more()
    assert (type(ended.value) is Terminated) == (number == signal.SIGTERM)


def test_everything_is_put_back(often):
    before = state()
    with StopRequest():
        assert all(new != old for new, old in zip(state(), before, strict=True))
    assert state() == before
    with pytest.raises(RuntimeError), StopRequest():
        raise RuntimeError
    assert state() == before
    with pytest.raises(Terminated), StopRequest():
        signal.raise_signal(signal.SIGTERM)
    assert state() == before


def test_an_ignored_signal_stays_ignored():
    """A shell starts what runs in the background so that Ctrl-C does not reach it."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with StopRequest() as stop:
            signal.raise_signal(signal.SIGINT)
            assert stop.signal is None
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_another_thread_handles_no_signals():
    before, seen = state(), []

    def work():
        with StopRequest() as stop:
            seen.append((state(), stop.signal))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [((*before[:-1], before[-1] + 1), None)]


def test_a_signal_that_another_thread_gets_acts_in_the_main_thread(often):
    thread = threading.Thread(target=signal.raise_signal, args=(signal.SIGTERM,))
    with pytest.raises(Terminated), StopRequest():
        thread.start()
        wait_for_more()
    thread.join()


def test_a_signal_that_another_thread_gets_ends_a_call_that_waits(often):
    """Python runs no handler before the call has ended: as for a signal that arrives just before the call."""
    reading, writing = os.pipe()
    let_go = threading.Timer(HANG_S, os.write, (writing, b"too late"))
    let_go.daemon = True
    let_go.start()
    thread = threading.Timer(0.05, lambda: signal.pthread_kill(threading.get_ident(), signal.SIGTERM))
    with pytest.raises(Terminated), StopRequest():
        thread.start()
        os.read(reading, 8)
    assert let_go.is_alive()
    let_go.cancel()
    thread.join()
    os.close(reading)
    os.close(writing)


def test_the_file_descriptor_of_others_that_signals_wake_is_put_back(often):
    ours, theirs = socket.socketpair()
    theirs.setblocking(False)
    before = signal.set_wakeup_fd(theirs.fileno())
    try:
        with StopRequest():
            pass
    finally:
        assert signal.set_wakeup_fd(before) == theirs.fileno()
        ours.close()
        theirs.close()


# ------------------------------------------------------------------------------------ given up by Python


def in_a_callback_from_c(number):
    def called():
        signal.raise_signal(number)

    ctypes.CFUNCTYPE(None)(called)()


def in_a_finalizer(number):
    class Dying:
        def __del__(self):
            signal.raise_signal(number)

    Dying()


def in_a_weak_reference(number):
    class Dying:
        pass

    dying = Dying()
    _ = weakref.ref(dying, lambda _: signal.raise_signal(number))
    del dying


def in_a_garbage_collection(number):
    def collecting(phase, info):
        gc.callbacks.remove(collecting)
        signal.raise_signal(number)

    gc.callbacks.append(collecting)
    gc.collect()


def where_it_is_caught(number):
    with suppress(KeyboardInterrupt):
        signal.raise_signal(number)


def where_c_prints_errors(number):
    try:
        signal.raise_signal(number)
    except KeyboardInterrupt as error:
        sys.excepthook(type(error), error, error.__traceback__)


SWALLOWERS = [
    in_a_callback_from_c,
    in_a_finalizer,
    in_a_weak_reference,
    in_a_garbage_collection,
    where_it_is_caught,
    where_c_prints_errors,
]


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize("swallow", SWALLOWERS)
def test_what_is_given_up_is_raised_again_and_not_printed(swallow, number, often, complaints):
    before = state()
    with pytest.raises(KeyboardInterrupt) as ended, StopRequest() as stop:
        swallow(number)
        assert stop.signal == number
        swallow(number)
        wait_for_more()
    assert (type(ended.value) is Terminated) == (number == signal.SIGTERM)
    assert complaints == []
    assert state() == before


def test_what_else_is_given_up_is_printed_until_an_interruption(complaints):
    """After it, errors of finalizers may be its own doing; what is printed on purpose is not."""

    class Dying:
        def __del__(self):
            raise ValueError("of another kind")

    with pytest.raises(KeyboardInterrupt), StopRequest():
        Dying()
        assert len(complaints) == 1
        in_a_finalizer(signal.SIGINT)
        Dying()
        assert len(complaints) == 1
        sys.excepthook(ValueError, ValueError(), None)
        wait_for_more()
    assert len(complaints) == 2


def test_repeats_do_not_disturb_the_winding_up(often):
    done = []

    def closed_late():
        try:
            yield
        finally:
            wait_for_repeats()
            done.append("generator")

    with pytest.raises(Terminated), StopRequest(), ExitStack() as stack:
        frames = closed_late()
        next(frames)
        stack.callback(frames.close)
        try:
            in_a_callback_from_c(signal.SIGTERM)
            wait_for_more()
        finally:
            wait_for_repeats()
            with suppress(ValueError):
                try:
                    raise ValueError
                finally:
                    wait_for_repeats()
            done.append("finally")
    assert done == ["finally", "generator"]


@pytest.mark.parametrize("is_patient", [False, True])
def test_nothing_is_raised_again_once_the_loop_has_seen_it(is_patient, often, monkeypatch):
    monkeypatch.setattr(module, "PATIENCE_S", 0.02)
    with StopRequest() as stop:
        if is_patient:
            assert not stop.between_frames()
        is_seen = False
        with suppress(KeyboardInterrupt):
            in_a_callback_from_c(signal.SIGTERM)
        while not is_seen:
            with suppress(KeyboardInterrupt):
                is_seen = stop.between_frames()
        wait_for_repeats()
    assert stop.exit_code == 143


def test_a_signal_while_it_is_left_is_noted(monkeypatch):
    join = threading.Thread.join

    def interrupted(thread):
        signal.raise_signal(signal.SIGTERM)
        join(thread)

    before = state()
    with StopRequest() as stop:
        monkeypatch.setattr(threading.Thread, "join", interrupted)
    assert stop.exit_code == 143
    assert state() == before


# ------------------------------------------------------------------------------------ the command line


@pytest.fixture
def answer(monkeypatch, capsys):
    """Exit code of a command that does `work`, and what it wrote to stderr."""

    def run(work):
        monkeypatch.setitem(commands.COMMANDS, "list", lambda options: work())
        before = state()
        code = main(["list"])
        assert state() == before
        return code, capsys.readouterr().err

    return run


@pytest.mark.parametrize("number", SIGNALS)
def test_an_interrupted_import_ends_the_command(answer, number, tmp_path, monkeypatch):
    (tmp_path / "slow_to_import.py").write_text(f"import signal\nsignal.raise_signal({int(number)})\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert answer(lambda: import_module("slow_to_import")) == (128 + number, "")


def test_an_import_of_ours_that_is_interrupted_ends_the_command(capsys, monkeypatch):
    class Finder:
        def find_spec(self, name, path=None, target=None):
            if name == "bayesnet_track.graphs":
                signal.raise_signal(signal.SIGINT)

    for name in [name for name in sys.modules if name.startswith("bayesnet_track.graphs")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delattr("bayesnet_track.graphs")
    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
    assert main(["list"]) == 130
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("number", SIGNALS)
def test_an_interruption_that_became_another_error_is_no_error_of_ours(answer, number, complaints):
    def work():
        where_c_prints_errors(number)
        raise ImportError("numpy.core.multiarray failed to import")

    assert answer(work) == (128 + number, "")
    assert complaints == []


def test_an_interruption_that_came_to_nothing_is_told_in_the_exit_code(answer):
    assert answer(lambda: in_a_callback_from_c(signal.SIGTERM) or 0) == (143, "")


class Half:
    """Interrupted before it has all its parts, which its finalizer needs."""

    def build(self):
        signal.raise_signal(signal.SIGINT)
        self.part = 1

    def __del__(self):
        self.part  # noqa: B018


def build_half():
    half = Half()
    half.build()


def test_what_is_left_half_made_does_not_complain(monkeypatch):
    seen = []
    monkeypatch.setattr(sys, "unraisablehook", seen.append)
    with pytest.raises(KeyboardInterrupt) as raised, StopRequest():
        build_half()
    del raised
    gc.collect()
    assert seen == []
    half = Half()
    del half
    assert len(seen) == 1 and seen[0].exc_type is AttributeError  # the hook works again


# ------------------------------------------------------------------------------------ a running process


HELD = """
import sys
from bayesnet_track.cli.main import main
from bayesnet_track.runtime.recording.record import Recorder

record = Recorder.frame

def record_and_wait(self, result):
    record(self, result)
    if result.frame.index == 9:
        sys.stdin.readline()

Recorder.frame = record_and_wait
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture
def held(tmp_path):
    """A demo that has recorded ten frames, and goes on when it is told to."""
    line = [sys.executable, "-c", HELD, "demo", "--out", str(tmp_path / "run")]
    pipes = {name: subprocess.PIPE for name in ("stdin", "stdout", "stderr")}
    process = subprocess.Popen(line, text=True, **pipes)
    tracks, deadline = tmp_path / "run/tracks.txt", time.monotonic() + HANG_S
    while not tracks.exists() or tracks.read_bytes().count(b"\n") < 10:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.005)
    yield process
    process.kill()
    process.communicate()


def check(out, notice=pytest.fail):
    """The number of frames that were measured; every file must be valid and tell of the same frames."""
    directory = RunDirectory.open(out)
    frames = [metrics.frame for metrics in read_metrics(directory.frames, notice)]
    assert frames == list(range(len(frames)))
    for path in (directory.mot, directory.timings):
        lines = path.read_bytes().split(b"\n")
        assert abs(len(lines) - 1 - len(frames)) <= 1
    return len(frames)


@pytest.mark.parametrize(
    "number", [SIGNALS[0], *(pytest.param(n, marks=pytest.mark.slow) for n in SIGNALS[1:])]
)
def test_a_signal_ends_a_run_in_order(held, tmp_path, number):
    held.send_signal(number)
    said, complained = held.communicate("go on\n", timeout=HANG_S)
    assert held.returncode == 128 + number
    assert "Traceback" not in complained
    assert said.endswith(", interrupted\n") and said.count("\n") == 1
    assert check(tmp_path / "run") == 10
    events = list(read_events(tmp_path / "run/journal.jsonl", pytest.fail))
    assert events[-1] == RunEnded(10, 200, False, "interrupted")


@pytest.mark.slow
def test_a_second_signal_ends_a_frame_that_takes_long(held, tmp_path):
    # Python handles a signal that comes just before a read only when the read ends: let it be within it.
    time.sleep(0.5)
    held.send_signal(signal.SIGINT)
    held.send_signal(signal.SIGTERM)
    # Nobody tells it to go on.
    assert held.wait(timeout=HANG_S) == 143
    assert "Traceback" not in held.stderr.read()
    assert check(tmp_path / "run") == 10


@pytest.mark.slow
def test_a_killed_run_leaves_files_that_can_be_read(held, tmp_path):
    out = tmp_path / "run"
    held.kill()
    held.communicate()
    assert check(out, notice=lambda _: None) == 10
    events = list(read_events(out / "journal.jsonl", lambda _: None))
    assert not any(isinstance(event, RunEnded) for event in events)
    assert main(["log", str(out)]) == 0
    # The truth is written when a demo ends; any file serves.
    truth = tmp_path / "truth.txt"
    truth.write_text("1,2,3,4\n" * 200)
    assert main(["score", str(out), "--truth", str(truth)]) == 0


# Before and after `main`, signals are the interpreter's: here they leave at once, with a code of their own.
WATCHED = """
import os
import signal
import sys
from bayesnet_track.cli.main import main

after, number, *arguments = sys.argv[1:]
events = 0

def profile(frame, event, argument):
    global events
    events += 1
    if events == int(after):
        sys.setprofile(None)
        signal.raise_signal(int(number))

for each in (signal.SIGINT, signal.SIGTERM):
    signal.signal(each, lambda *_: os._exit(99))
print("ready", file=sys.stderr, flush=True)
if int(after):
    sys.setprofile(profile)
code = main(arguments)
sys.setprofile(None)
sys.stdout.flush()
os._exit(code)
"""


def watched(out, after, number):
    line = [sys.executable, "-c", WATCHED, str(after), str(int(number)), "demo", "--quiet", "--out", str(out)]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr.readline() == "ready\n"
    return process


def check_interrupted(process, out, number):
    """True at any instant: nothing has begun, or all is done, or it was interrupted in order."""
    said, complained = process.communicate(timeout=HANG_S)
    assert complained == ""
    assert process.returncode in (0, 99, 128 + number)
    events = []
    if (out / "journal.jsonl").exists():
        events = list(read_events(out / "journal.jsonl", pytest.fail))
    if events:
        frames = check(out)
        end = events[-1]
        assert isinstance(end, RunEnded) and abs(end.frames - frames) <= 1
        assert end.reason == ("end_of_source" if end.complete else "interrupted")
    is_complete = bool(events) and events[-1].complete
    if process.returncode == 99:
        assert is_complete or not out.exists()
    if process.returncode == 0:
        assert is_complete and "against the ground truth" in said


@pytest.mark.slow
@pytest.mark.parametrize("step", range(40))
def test_a_signal_at_any_call(tmp_path, step):
    """Calls and returns of Python code, in callbacks and finalizers too: the 10th to the four millionth."""
    number = SIGNALS[step % 2]
    process = watched(tmp_path / "run", round(10 ** (1 + 5.6 * step / 39)), number)
    check_interrupted(process, tmp_path / "run", number)


@pytest.mark.slow
@pytest.mark.parametrize("wait_ms", range(0, 1500, 75))
def test_a_signal_at_any_time(tmp_path, wait_ms):
    number = SIGNALS[wait_ms // 75 % 2]
    process = watched(tmp_path / "run", 0, number)
    time.sleep(wait_ms / 1000)
    process.send_signal(number)
    check_interrupted(process, tmp_path / "run", number)
