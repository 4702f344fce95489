"""The shape model against a plain decomposition, merging, and files that are damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bayesnet_track.vision.shape import (
    ShapeModel,
    ShapeModelError,
    learn_model,
    load_model,
    merge,
    save_model,
)


def examples(seed: int = 0, count: int = 30, cells: int = 36) -> np.ndarray:
    """Vectors with five directions of falling variance, and a little noise."""
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=(count, 5)) * [4.0, 2.0, 1.0, 0.5, 0.2]
    return (
        rng.normal(size=cells) + spread @ rng.normal(size=(5, cells)) + 0.01 * rng.normal(size=(count, cells))
    )


def covariance(model: ShapeModel) -> np.ndarray:
    return model.modes.T @ np.diag(model.variances) @ model.modes


@pytest.mark.parametrize("keep", [0.5, 0.95, 1.0])
def test_modes_are_numpys_principal_components(keep: float) -> None:
    vectors = examples()
    model = learn_model(vectors, keep)
    variances, axes = np.linalg.eigh(np.cov(vectors.T, bias=True))
    variances, axes = variances[::-1], axes.T[::-1]
    held = np.cumsum(variances) / variances.sum()
    count = len(model.modes)
    assert model.explained >= keep - 1e-9
    assert count == 1 or held[count - 2] < keep  # no fewer would do
    np.testing.assert_allclose(model.mean, vectors.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(model.variances, variances[:count], rtol=1e-8, atol=1e-12)
    if keep < 1:  # directions of equal variance are not unique
        np.testing.assert_allclose(np.abs(np.sum(model.modes * axes[:count], axis=1)), 1.0, atol=1e-6)


def test_one_example_or_equal_ones_have_no_modes() -> None:
    for vectors in (examples(count=1), np.repeat(examples(count=1), 4, axis=0)):
        model = learn_model(vectors)
        assert model.modes.shape == (0, 36) and model.explained == 1.0
        np.testing.assert_allclose(model.mean, vectors[0])


def test_what_cannot_be_learnt_from_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        learn_model(np.empty((0, 36)))
    with pytest.raises(ValueError, match="finite"):
        learn_model(np.full((2, 36), np.nan))


@settings(max_examples=25, deadline=None)
@given(rate=st.floats(0.01, 0.99), seed=st.integers(0, 99))
def test_a_merged_model_has_the_mixtures_moments(rate: float, seed: int) -> None:
    old, new = learn_model(examples(seed), 1.0), learn_model(examples(seed + 100), 1.0)
    both = merge(old, new, rate, 36)
    gap = new.mean - old.mean
    expected = (1 - rate) * covariance(old) + rate * covariance(new) + rate * (1 - rate) * np.outer(gap, gap)
    np.testing.assert_allclose(both.mean, (1 - rate) * old.mean + rate * new.mean, atol=1e-12)
    np.testing.assert_allclose(covariance(both), expected, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(both.modes @ both.modes.T, np.eye(len(both.modes)), atol=1e-5)


def test_at_the_ends_a_merge_is_one_of_the_two_and_the_largest_modes_stay() -> None:
    old, new = learn_model(examples(1)), learn_model(examples(2))
    assert merge(old, new, 0.0, 8) is old and merge(old, new, 1.0, 8) is new
    few, all_ = merge(old, new, 0.3, 2), merge(old, new, 0.3, 36)
    np.testing.assert_array_equal(few.variances, all_.variances[:2])


def test_many_small_steps_learn_the_examples_model() -> None:
    """Rate 1/n at the n-th example is the running mean and covariance."""
    vectors = examples(3, count=12)
    model = ShapeModel(vectors[0], np.zeros((0, 36)), np.zeros(0))
    for n, vector in enumerate(vectors[1:], start=2):
        model = merge(model, ShapeModel(vector, np.zeros((0, 36)), np.zeros(0)), 1 / n, 36)
    np.testing.assert_allclose(model.mean, vectors.mean(axis=0), atol=1e-9)
    expected = np.cov(vectors.T, bias=True)
    # each step drops variances below 1e-12 and rounds anew
    np.testing.assert_allclose(covariance(model), expected, atol=1e-6 * np.abs(expected).max())


def test_a_file_holds_the_model_without_loss_or_code(tmp_path: Path) -> None:
    model = learn_model(examples())
    save_model(tmp_path / "m.npz", model)
    back = load_model(tmp_path / "m.npz")
    for name in ("mean", "modes", "variances"):
        np.testing.assert_array_equal(getattr(back, name), getattr(model, name))
    assert (back.explained, back.examples, back.grid) == (model.explained, 30, 6)
    with np.load(tmp_path / "m.npz", allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file)


def changed(path: Path, **arrays: object) -> Path:
    save_model(path, learn_model(examples()))
    with np.load(path) as file:
        held = {name: file[name] for name in file}
    kept = {name: array for name, array in {**held, **arrays}.items() if array is not None}
    np.savez(path, **kept)
    return path


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"version": np.array(2)}, "of version 2; this program reads version 1"),
        ({"kind": np.array("a cake")}, "is not a shape model; `bayesnet-track learn-shape` makes one"),
        ({"kind": None}, "is not a shape model"),
        ({"modes": None}, "is damaged, or no shape model"),
        ({"mean": np.zeros(35)}, r"shapes \(35,\), .* are no shape model"),
        ({"mean": np.zeros((6, 6))}, "are no shape model"),
        ({"modes": np.zeros((3, 30))}, "are no shape model"),
        ({"variances": np.array([-1.0] * 2), "modes": np.eye(36)[:2]}, "negative variances"),
        ({"mean": np.full(36, np.nan)}, "not finite"),
        ({"modes": np.ones((2, 36)), "variances": np.ones(2)}, "not orthonormal"),
        ({"mean": np.array([{}] * 36)}, "is damaged, or no shape model"),
    ],
)
def test_files_that_do_not_fit_say_why(tmp_path: Path, arrays: dict[str, object], said: str) -> None:
    with pytest.raises(ShapeModelError, match=said):
        load_model(changed(tmp_path / "m.npz", **arrays))


def test_files_that_are_none_say_so(tmp_path: Path) -> None:
    with pytest.raises(ShapeModelError, match="is not there"):
        load_model(tmp_path / "none.npz")
    with pytest.raises(ShapeModelError, match="is no file"):
        load_model(tmp_path)
    save_model(tmp_path / "m.npz", learn_model(examples()))
    whole = (tmp_path / "m.npz").read_bytes()
    np.save(tmp_path / "array.npy", np.zeros(3))
    for content in (b"", b"hello", whole[:200], whole[:-30], (tmp_path / "array.npy").read_bytes()):
        (tmp_path / "bad.npz").write_bytes(content)
        with pytest.raises(ShapeModelError, match=r"bad\.npz"):
            load_model(tmp_path / "bad.npz")
