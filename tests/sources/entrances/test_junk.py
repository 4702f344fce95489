"""What systems put beside the files of a user is never a frame, at any entrance."""

import cv2
import numpy as np
import pytest

from bayesnet_track.cli.batch.jobs import videos_of
from bayesnet_track.cli.main import main
from bayesnet_track.observation.planes import Frame
from bayesnet_track.sources.paths import depth_files
from bayesnet_track.sources.sources import SourceError, open_source

RESOURCE_FORK = b"\0\5\x16\7" + b"x" * 60


def littered(folder, count=3):
    """A folder of images as it comes from a Mac, a network drive and an unpacked archive."""
    for place in (folder, folder / "__MACOSX", folder / "@eaDir" / "1.png"):
        place.mkdir(parents=True)
    for number in range(1, count + 1):
        assert cv2.imwrite(str(folder / f"{number}.png"), np.full((20, 30, 3), 10 * number, np.uint8))
        (folder / f"._{number}.png").write_bytes(RESOURCE_FORK)
        (folder / "__MACOSX" / f"{number}.png").write_bytes(RESOURCE_FORK)
        (folder / "@eaDir" / "1.png" / f"THUMB_{number}.png").write_bytes(RESOURCE_FORK)
    for name in (".DS_Store", "Thumbs.db", "desktop.ini"):
        (folder / name).write_bytes(b"x")
    return folder


@pytest.mark.parametrize("pattern", ["", "*.png", "*", "**/*.png", "**"])
def test_junk_beside_images_is_no_frame_of_a_folder_or_a_glob(tmp_path, pattern):
    with open_source(str(littered(tmp_path / "img") / pattern)) as source:
        items = list(source)
    assert [item.image[0, 0, 0] for item in items if isinstance(item, Frame)] == [10, 20, 30]
    assert len(items) == 3


def test_a_pattern_of_junk_alone_matches_no_image(tmp_path):
    with pytest.raises(SourceError, match="none of them an image"):
        open_source(str(littered(tmp_path / "img") / "._*.png"))


def test_junk_is_no_depth(tmp_path):
    folder = littered(tmp_path / "depth")
    assert [path.name for path in depth_files(str(folder))] == ["1.png", "2.png", "3.png"]
    assert [path.name for path in depth_files(str(folder / "**"))] == ["1.png", "2.png", "3.png"]


def test_junk_is_no_video_of_a_batch(tmp_path):
    littered(tmp_path / "one")
    (tmp_path / "__MACOSX").mkdir()
    assert [video.name for video in videos_of([str(tmp_path / "*")])] == ["one"]


def test_junk_is_no_mask_to_learn_from(tmp_path, capsys):
    folder = tmp_path / "masks"
    folder.mkdir()
    for number in range(3):
        mask = np.zeros((60, 60), np.uint8)
        cv2.ellipse(mask, (30, 30), (10 + number, 20), 0, 0, 360, 255, -1)
        assert cv2.imwrite(str(folder / f"{number}.png"), mask)
        (folder / f"._{number}.png").write_bytes(RESOURCE_FORK)
    assert main(["learn-shape", str(tmp_path / "m.npz"), "--masks", str(folder)]) == 0
    assert "3 examples" in capsys.readouterr().out


def test_a_run_over_littered_images_ends_in_order(tmp_path):
    folder = littered(tmp_path / "img")
    texture = np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8)
    for number in range(1, 4):
        assert cv2.imwrite(str(folder / f"{number}.png"), np.roll(texture, number, axis=1))
    command = ["run", "two_squares", "--source", str(folder), "--init", "20,20,20,20"]
    assert main([*command, "--out", str(tmp_path / "run"), "-q"]) == 0
    assert len((tmp_path / "run" / "tracks.txt").read_text().splitlines()) == 3
