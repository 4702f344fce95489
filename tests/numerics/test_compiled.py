"""Compiled kernels: cached where possible, in memory where not, never an error of the cache."""

import importlib.util
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numba
import pytest

from bayesnet_track.numerics.compile_watch import CacheWarning
from bayesnet_track.numerics.compiled import MARK, SEAL_BYTES

SOURCE = """
from bayesnet_track.numerics.compiled import compiled, compiled_summing

@compiled
def double(x):
    return 2.0 * x

@compiled
def shared(x, parts):
    return x / parts

@compiled_summing
def total(values):
    sum_ = 0.0
    for value in values:
        sum_ += value
    return sum_
"""


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Loads the kernels from a file of their own, as a fresh process would; their cache is beside it."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")  # which Numba has read already
    path = tmp_path / "kernels.py"
    path.write_text(SOURCE)

    def make():
        spec = importlib.util.spec_from_file_location("kernels", path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return make


def cached(folder):
    return sorted((folder / "__pycache__").glob("*.nb?"))


def test_kernels_are_cached_and_found_again(load, tmp_path):
    assert load().double(2.5) == 5.0
    _, data = cached(tmp_path)
    stamp = data.stat().st_mtime_ns
    again = load()
    assert again.double(2.5) == 5.0 and again.double.stats.cache_hits
    assert data.stat().st_mtime_ns == stamp


def test_without_a_folder_for_the_cache_they_compile_in_memory(load, tmp_path, monkeypatch):
    def denied(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", denied)  # how Numba tries whether it may write
    kernels = load()
    assert kernels.double(2.5) == 5.0 and kernels.total((1.0, 2.0)) == 3.0
    assert cached(tmp_path) == []


def test_a_full_disk_loses_the_cache_only(load, tmp_path, monkeypatch):
    kernels = load()

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", full)
    assert kernels.double(2.5) == 5.0
    assert cached(tmp_path) == []


@pytest.mark.parametrize("damage", [b"", b"garbage", None])
@pytest.mark.filterwarnings("ignore::bayesnet_track.numerics.compile_watch.CacheWarning")
def test_a_damaged_cache_is_not_used(load, tmp_path, damage):
    load().double(2.5)
    for path in cached(tmp_path):
        path.write_bytes(path.read_bytes()[:-20] if damage is None else damage)
    assert load().double(2.5) == 5.0


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.99, 1.0])
def test_a_changed_bit_is_found_said_and_mended(load, tmp_path, suffix, share):
    """Also in the machine code itself, which Numba would run, and in the seal."""
    load().double(2.5)
    (path,) = [one for one in cached(tmp_path) if one.suffix == suffix]
    whole = path.read_bytes()
    data = bytearray(whole)
    data[int(share * (len(data) - 1))] ^= 4
    path.write_bytes(data)
    with pytest.warns(CacheWarning, match=f"{path.name}: damaged, so its kernel is compiled anew") as said:
        again = load()
        assert again.double(2.5) == 5.0
    assert len(said) == 1
    assert not again.double.stats.cache_hits
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        third = load()
        assert third.double(2.5) == 5.0 and third.double.stats.cache_hits


def test_files_of_numba_alone_are_replaced_without_a_word(load, tmp_path):
    load().double(2.5)
    for path in cached(tmp_path):
        path.write_bytes(path.read_bytes()[:-SEAL_BYTES])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load().double(2.5) == 5.0
        assert load().double(2.5) == 5.0
    assert all(MARK in path.read_bytes() for path in cached(tmp_path))


def test_importing_the_kernels_of_the_library_does_not_need_a_cache(tmp_path):
    """In a fresh process, with every place that Numba tries for its cache out of reach."""
    nowhere = "/dev/null/nowhere"
    code = (
        "import tempfile\n"
        "def denied(*_, **__): raise PermissionError(13, 'Permission denied')\n"
        "tempfile.TemporaryFile = denied\n"
        "from bayesnet_track.numerics import density\n"
    )
    environment = {"PATH": "", "NUMBA_CACHE_DIR": nowhere, "HOME": nowhere, "XDG_CACHE_HOME": nowhere}
    folder = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], env=environment, cwd=folder)
    assert done.returncode == 0


KERNEL_AND_OTHER_FILE = {
    "sources.py": "SCALE = 2.0",
    "between.py": """
import sources
from bayesnet_track.numerics.compiled import compiled
from sources import SCALE

@compiled
def scaled(x):
    return x * SCALE + 0.0 * sources.SCALE
""",
    "caller.py": """
from between import scaled
from bayesnet_track.numerics.compiled import compiled

@compiled
def twice(x):
    return scaled(scaled(x))
""",
}


@pytest.fixture
def call(tmp_path, monkeypatch):
    """Calls a kernel that calls one of another file, which reads a constant of a third, as anew."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.syspath_prepend(tmp_path)

    def written(**changed):
        for name, text in {**KERNEL_AND_OTHER_FILE, **{f"{one}.py": changed[one] for one in changed}}.items():
            if not (tmp_path / name).exists() or (tmp_path / name).read_text() != text:
                (tmp_path / name).write_text(text)
            sys.modules.pop(name.removesuffix(".py"), None)
        importlib.invalidate_caches()
        kernel = importlib.import_module("caller").twice
        return kernel(1.0), bool(kernel.stats.cache_hits)

    yield written
    for name in KERNEL_AND_OTHER_FILE:
        sys.modules.pop(name.removesuffix(".py"), None)


def test_a_kernel_is_compiled_anew_when_a_constant_in_another_file_has_changed(call):
    assert call() == (4.0, False)
    assert call() == (4.0, True)
    assert call(sources="SCALE = 3.0") == (9.0, False)
    assert call(sources="SCALE = 3.0") == (9.0, True)


def test_a_kernel_is_compiled_anew_when_one_that_it_calls_in_another_file_has_changed(call):
    assert call() == (4.0, False)
    changed = KERNEL_AND_OTHER_FILE["between.py"].replace("x * SCALE", "x + SCALE")
    assert call(between=changed) == (5.0, False)


def test_a_kernel_is_compiled_anew_with_other_settings(call):
    assert call() == (4.0, False)
    changed = KERNEL_AND_OTHER_FILE["between.py"].replace("compiled", "compiled_summing")
    changed = changed.replace("numerics.compiled_summing", "numerics.compiled")
    assert call(between=changed) == (4.0, False)


def test_a_division_by_zero_is_infinite_and_raises_nothing(load):
    """A check for zero would keep every loop with a division from taking several values at once."""
    assert load().shared(1.0, 0.0) == float("inf")


def test_with_the_jit_off_kernels_stay_plain_python(load, monkeypatch):
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)  # as NUMBA_DISABLE_JIT=1 does
    kernels = load()
    assert kernels.double(2.5) == 5.0 and kernels.total([1.0, 2.0]) == 3.0
    assert type(kernels.double) is type(load)
