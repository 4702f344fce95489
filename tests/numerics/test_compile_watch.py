"""Compiling is noticed when it happens, added up without what lies within, and told to whom it concerns."""

import importlib.util
import threading
from types import SimpleNamespace

import numpy as np

from bayesnet_track.numerics import compile_watch
from bayesnet_track.numerics.compile_watch import WATCH, CompileWatch, working_clock

KERNELS = """
from bayesnet_track.numerics.compiled import compiled

@compiled
def inner(values):
    return values[0] + 1.0

@compiled
def outer(values):
    return 2.0 * inner(values)
"""


def module_of(path):
    spec = importlib.util.spec_from_file_location("kernels_for_a_test", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_spans_within_a_span_do_not_count_twice_and_what_failed_is_forgotten():
    times = iter([10.0, 11.0, 12.0, 13.0, 20.0, 20.5])
    watch = CompileWatch(lambda: next(times))
    calls = []
    with watch.notifying(lambda: calls.append(1)):
        watch.begins("outer")
        watch.begins("inner")
        watch.ends("inner")
        watch.begins("wrong types")
        watch.ends("outer")
    assert watch.seconds == 3.0 and len(calls) == 3
    watch.begins("another")
    watch.ends("another")
    watch.ends("nothing began")
    assert watch.seconds == 3.5 and len(calls) == 3


def test_a_kernel_is_compiled_once_and_then_comes_from_the_cache(tmp_path):
    (tmp_path / "kernels.py").write_text(KERNELS)
    calls, before = [], WATCH.seconds
    with WATCH.notifying(lambda: calls.append(1)):
        module = module_of(tmp_path / "kernels.py")
        assert not calls, "nothing is compiled before it is called"
        assert module.outer(np.ones(3)) == 4.0
        assert len(calls) >= 1 and WATCH.seconds > before
        spent = WATCH.seconds
        calls.clear()
        assert module.outer(np.ones(3)) == 4.0
        assert module_of(tmp_path / "kernels.py").outer(np.ones(3)) == 4.0, "from the cache on disk"
    assert calls == [] and WATCH.seconds == spent


def test_the_clock_of_an_agent_stands_still_while_its_own_thread_compiles(monkeypatch):
    watch = CompileWatch(lambda: now[0])
    now = [100.0]
    monkeypatch.setattr(compile_watch, "WATCH", watch)
    monkeypatch.setattr(compile_watch, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    assert working_clock() == 100.0
    watch.begins("kernel")
    now[0] = 120.0
    watch.ends("kernel")
    now[0] = 121.0
    assert working_clock() == 101.0
    other = []
    thread = threading.Thread(target=lambda: other.append(working_clock()))
    thread.start()
    thread.join()
    assert other == [121.0], "it did not compile"
