"""Compiled copies, and that kernels use them instead of assignments to slices."""

import ast
from pathlib import Path

import numpy as np
import pytest

import bayesnet_track
from bayesnet_track.numerics.resampling import copy_row, copy_rows

ROOT = Path(bayesnet_track.__file__).parent
KERNELS = [path for path in sorted(ROOT.rglob("*.py")) if "\n@compiled" in path.read_text()]


def test_there_are_kernels():
    assert len(KERNELS) > 20


def test_a_row_is_filled_with_the_first_values():
    to = np.full(3, -1)
    copy_row(np.arange(5), to)
    assert to.tolist() == [0, 1, 2]


def test_rows_are_filled_with_the_first_rows_and_columns():
    to = np.full((4, 4), -1.0)
    copy_rows(np.arange(12.0).reshape(3, 4), to[1:3, 1:3])
    expected = [[-1, -1, -1, -1], [-1, 0, 1, -1], [-1, 4, 5, -1], [-1, -1, -1, -1]]
    assert to.tolist() == expected


@pytest.mark.parametrize("path", KERNELS, ids=lambda path: path.stem)
def test_no_kernel_assigns_an_array_to_a_slice(path):
    """Numbers are assigned to slices in well under 0.1 s of compiling, arrays in seconds."""
    found = [
        f"{path.name}:{node.lineno} {ast.unparse(node)}"
        for kernel in ast.parse(path.read_text()).body
        if isinstance(kernel, ast.FunctionDef)
        and "compiled" in "".join(map(ast.unparse, kernel.decorator_list))
        for node in ast.walk(kernel)
        if isinstance(node, ast.Assign) and any(_is_slice(target) for target in node.targets)
        if not _is_number(node.value)
    ]
    assert found == []


def _is_slice(target):
    return any(isinstance(part, ast.Slice) for part in ast.walk(target))


def _is_number(value):
    """A number as it is written, a constant of a module, or a scalar type called."""
    is_scalar = isinstance(value, ast.Call) and ast.unparse(value.func) == "np.float32"
    return (
        is_scalar
        or isinstance(value, ast.Constant | ast.UnaryOp)
        or ast.unparse(value) in ("np.inf", "np.nan")
    )
