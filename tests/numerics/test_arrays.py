"""The names of arrays: each is given once, and no module means something else by it."""

import re
from pathlib import Path

import bayesnet_track

NAMED = re.compile(r"^(\w+) = NDArray", re.MULTILINE)
SOURCE = Path(bayesnet_track.__file__).parent / "numerics" / "arrays.py"
ELSEWHERE = {"graph/expressions/evaluate.py"}  # the language stands above numerics, which it does not import


def test_no_module_names_an_array_again():
    root, known = Path(bayesnet_track.__file__).parent, set(NAMED.findall(SOURCE.read_text("utf-8")))
    again = {
        str(path.relative_to(root))
        for path in root.rglob("*.py")
        if path != SOURCE and known & set(NAMED.findall(path.read_text("utf-8")))
    }
    assert len(known) > 5
    assert again == ELSEWHERE
