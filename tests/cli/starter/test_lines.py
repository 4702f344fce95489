"""Lines of a commented YAML file."""

from bayesnet_track.cli.starter.lines import WIDTH, indent, key, remark


def test_a_key_stands_below_its_comment_and_before_what_is_inside():
    assert key("a:", "What it does.", ["b: 1", "", "c: 2"]) == (
        "# What it does.",
        "a:",
        "  b: 1",
        "",
        "  c: 2",
    )


def test_comments_are_broken_where_they_would_be_too_wide():
    lines = remark("word " * 60)
    assert len(lines) > 2 and all(line.startswith("# word") and len(line) <= WIDTH - 10 for line in lines)
    assert indent(indent(["x"])) == ("    x",)
