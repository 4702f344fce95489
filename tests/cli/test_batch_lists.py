"""The list of a batch: names that would lead elsewhere, and quotes that would swallow the rest."""

from __future__ import annotations

import json

import pytest

from bayesnet_track.cli.batch.jobs import BatchError, read_list, videos_of
from bayesnet_track.cli.main import main

BAD = ["..", ".", "...", "/etc/x", "a/b", "../a", "a\\b", "a\0b", "a\nb", " ", "a ", "a.", "results.csv"]


def listed(tmp_path, *names):
    rows = [
        {"source": f"{n}.mp4", **({} if name is None else {"name": name})} for n, name in enumerate(names)
    ]
    path = tmp_path / "videos.jsonl"
    path.write_text("\n".join(map(json.dumps, rows)))
    return path


@pytest.mark.parametrize("name", [*BAD, "", "RESULTS.CSV", "results.csv.part", "x" * 201, "é" * 101])
def test_a_name_that_is_no_folder_below_out_is_refused_with_its_line(tmp_path, capsys, name):
    path = listed(tmp_path, "fine", name)
    out = tmp_path / "out"
    assert main(["batch", "two_squares", "--list", str(path), "--init", "1,2,30,40", "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert f"{path}:2: the name {name!r} " in error and "folder below --out" in error
    assert not out.exists()


@pytest.mark.parametrize(("one", "other"), [("a", "a"), ("Auto", "AUTO"), ("é", "e\u0301"), ("a b", "a_b")])
def test_names_that_some_file_systems_take_for_one_are_refused_with_both_lines(tmp_path, one, other):
    path = listed(tmp_path, one, "between", other)
    with pytest.raises(BatchError, match=rf":3: the name .* is that of {path}:1"):
        read_list(path)


def test_names_that_are_made_up_avoid_given_ones_and_lead_nowhere(tmp_path, monkeypatch):
    (tmp_path / "inner").mkdir()
    monkeypatch.chdir(tmp_path / "inner")
    path = listed(tmp_path, "1", None, "x")
    assert [video.name for video in read_list(path)] == ["1", "1-2", "x"]
    sources = ["A.mp4", "a.mp4", "..", ".", "../..", "...mp4", "results.csv.mp4", "rtsp://u:geheim@h/"]
    names = [video.name for video in videos_of(sources)]
    assert names[:3] == ["A", "a-2", tmp_path.name] and names[6] == "results.csv-2"
    assert not [name for name in names if name.strip(".") == "" or "/" in name or "geheim" in name]


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ('source,init\na.mp4,"1,2,3,4\nb.mp4,"5,6,7,8"\nc.mp4,\n', 2, "not closed"),
        ('source,name\na.mp4,a\n"b.mp4,b\nc.mp4,c\n', 3, "not closed"),
        ('"source,name\na.mp4,a\n', 1, "not closed"),
        ("source,init\na.mp4,1,2,3,4\n", 2, "5 values under 2 columns"),
        ('source,name\na.mp4,"a"b\n', 2, "one line"),
        ('{"source": "a.mp4"}\n' + "[" * 100_000 + "\n", 2, "not a line of JSON"),
    ],
)
def test_an_open_quote_is_refused_with_its_line(tmp_path, text, line, what):
    path = tmp_path / "list"
    path.write_text(text)
    with pytest.raises(BatchError, match=rf"list:{line}: .*{what}"):
        read_list(path)
