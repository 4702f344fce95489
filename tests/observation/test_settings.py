"""A message names settings as its reader gives them: options on the command line, parameters in Python."""

import cv2
import numpy as np
import pytest

from bayesnet_track import Tracker
from bayesnet_track.cli.main import main
from bayesnet_track.observation.settings import by_command_line, setting
from bayesnet_track.sources.entrances.notices import InputNotice


def test_a_black_first_frame_is_said_in_the_words_of_the_reader(tmp_path, capsys):
    black = np.zeros((48, 64, 3), np.uint8)
    with pytest.warns(InputNotice, match=r"start in another one \(start=N\)"):
        Tracker("general").init(black, (20, 12, 16, 16))
    cv2.imwrite(str(tmp_path / "0.png"), black)
    main(
        [
            "run",
            "general",
            "--source",
            str(tmp_path),
            "--init",
            "20,12,16,16",
            "--out",
            str(tmp_path / "r"),
            "-q",
        ]
    )
    assert "start in another one (--start N)" in capsys.readouterr().err
    with pytest.warns(InputNotice, match=r"start in another one \(start=N\)"):
        Tracker("general").init(black, (20, 12, 16, 16))


def test_a_negative_value_is_joined_to_its_option():
    with by_command_line():
        assert setting("--range", "-5,5") == "--range=-5,5" and setting("--end") == "--end"
    assert setting("--range", "-5,5", "(-5, 5)") == "value_range=(-5, 5)"
