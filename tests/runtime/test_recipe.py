"""The recipe of a run: everything that was asked for, read back, and the same source again."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bayesnet_track import Start, load_graph, track
from bayesnet_track.runtime.checkpoints.recipe import VIDEO_FORMAT, Recipe, RecipeError, make_recipe
from bayesnet_track.sources.origin import Origin, fingerprint_files
from bayesnet_track.sources.paths import SourceError
from bayesnet_track.sources.scenes.library import SceneSource
from bayesnet_track.sources.several import reopen
from bayesnet_track.sources.sources import open_source


@pytest.fixture
def images(tmp_path: Path) -> Path:
    folder = tmp_path / "frames"
    folder.mkdir()
    rng = np.random.Generator(np.random.Philox(5))
    for number in range(4):
        cv2.imwrite(str(folder / f"{number}.png"), rng.integers(0, 255, (24, 32, 3), dtype=np.uint8))
    return folder


def test_a_run_holds_the_recipe_of_what_was_asked_for(tmp_path: Path) -> None:
    source = SceneSource.named("two_squares", 3, 2)
    start = Start(source.scene.start_box)
    list(track("two_squares", source, [start], out=tmp_path / "run", seed=3))
    recipe = Recipe.read(tmp_path / "run")
    assert recipe == make_recipe(load_graph("two_squares"), source, [start], 3)
    assert (recipe.starts, recipe.seed, recipe.only_once) == ((start,), 3, None)
    again = list(recipe.open_source())
    assert [frame.image.tobytes() for frame in again] == [frame.image.tobytes() for frame in source]
    assert recipe.load_graph(tmp_path / "run").text == load_graph("two_squares").text
    (tmp_path / "run" / "graph.yaml").write_text(load_graph("general").text)
    with pytest.raises(RecipeError, match="another graph"):
        recipe.load_graph(tmp_path / "run")


def test_a_folder_is_opened_again_from_elsewhere_and_changes_are_told(
    images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    source = open_source("frames", 1, 3)
    assert source.origin is not None
    first = [item.image.tobytes() for item in source]
    origin = source.origin.marked()
    monkeypatch.chdir("/")
    again = reopen(origin)
    assert [item.image.tobytes() for item in again] == first
    assert (again.description, again.expected_frames, origin.changes()) == ("frames", 2, ())
    (images / "3.png").write_bytes(b"other")
    (change,) = origin.changes()
    assert change.startswith("source: 4 files") and "now 4 files" in change


def test_the_fingerprint_sees_the_ends_and_the_length_of_a_long_file(tmp_path: Path) -> None:
    path = tmp_path / "long"
    data = bytearray(4 << 20)
    seen = set()
    for at in (None, 0, len(data) // 17, len(data) - 1):
        if at is not None:
            data[at] ^= 1
        path.write_bytes(data)
        seen.add(fingerprint_files([path]).sha256)
    path.write_bytes(data + b"\0")
    seen.add(fingerprint_files([path]).sha256)
    assert len(seen) == 5


@pytest.mark.parametrize(
    ("origin", "why"),
    [
        (Origin("plain", "0", "0"), "camera"),
        (Origin("plain", "rtsp://a/b", "rtsp://a/b"), "network"),
        (Origin("own", "", "mine"), "an object"),
    ],
)
def test_what_can_be_read_only_once_says_so(origin: Origin, why: str) -> None:
    with pytest.raises(SourceError, match=why):
        reopen(origin)


@pytest.mark.parametrize("text", [None, "{", "{}", '{"recipe": 1}'])
def test_a_directory_without_a_recipe_is_refused(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / "run.json").write_text(text)
    with pytest.raises(RecipeError, match=r"run\.json"):
        Recipe.read(tmp_path)


@pytest.mark.parametrize(("options", "kind"), [({}, "video"), ({VIDEO_FORMAT: "mp4"}, "mp4")])
def test_the_recipe_knows_the_format_of_the_video(options: dict[str, str], kind: str) -> None:
    recipe = Recipe("g", "0" * 64, Origin("own", "", "own"), has_video=True, options=options)
    assert recipe.optional == (kind,)
