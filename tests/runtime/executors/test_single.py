"""Libraries keep to one thread while agents work, and have theirs back afterwards; memory has a limit."""

import subprocess
import sys

import cv2
import pytest

from bayesnet_track.runtime.executors.worker import one_thread_inside, own_bytes


@pytest.mark.parametrize("opencv", [True, False])
def test_threads_are_as_before_whatever_happens_inside(opencv):
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        with pytest.raises(RuntimeError, match="inside"), one_thread_inside(opencv):
            assert cv2.getNumThreads() == (1 if opencv else 3)
            raise RuntimeError("inside")
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such limit")
def test_a_process_takes_no_more_memory_than_it_may():
    code = "\n".join(
        (
            "from bayesnet_track.runtime.executors.worker import limit_memory",
            "limit_memory(64)",
            "bytearray(16 << 20)",
            "try:",
            "    bytearray(512 << 20)",
            "except MemoryError:",
            "    print('refused')",
        )
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "refused\n" and own_bytes() > 1 << 20
