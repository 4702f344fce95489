"""Row 3: serial and processes 1, 2 write the same SHA-256, by the command line."""

from __future__ import annotations

import hashlib

import pytest

from bayesnet_track.cli.main import main

pytestmark = pytest.mark.reliability

FILES = ("journal.jsonl", "frames.npy.gz", "tracks.txt", "graph.yaml", "truth.txt")
WAYS = [("serial", 1), ("processes", 1), ("processes", 2)]
SCENES = {"two_squares": 60, "person_parts": 25, "crowd": 30}


def digests(folder):
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in FILES}


@pytest.mark.parametrize("scene", SCENES)
def test_all_executors_write_the_same(scene, tmp_path, capsys):
    table = {}
    for kind, workers in WAYS:
        out = tmp_path / f"{kind}-{workers}"
        options = ["--executor", kind, "--workers", str(workers), "--end", str(SCENES[scene]), "--quiet"]
        assert main(["demo", scene, "--out", str(out), *options]) == 0
        assert not (out / "inputs.jsonl").exists()
        table[kind, workers] = digests(out)
    capsys.readouterr()
    for (kind, workers), found in table.items():
        print(f"{scene:14} {kind:9} {workers}  journal {found['journal.jsonl'][:12]}")
    assert all(found == table["serial", 1] for found in table.values()), table
