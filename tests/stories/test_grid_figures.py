"""The figures that the page on the grid belief states: where it beats Monte Carlo and where not."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

PLACE = Path(__file__).parents[2] / "benchmarks" / "grid_figures.py"


@pytest.fixture(scope="module")
def figures():
    found = importlib.util.spec_from_file_location("grid_figures", PLACE)
    module = importlib.util.module_from_spec(found)
    sys.modules[found.name] = module  # where dataclasses look up their annotations
    found.loader.exec_module(module)
    yield module
    del sys.modules[found.name]


def rms(mixture, size, trials=100):
    """Root mean square error of Monte Carlo; over 100 trials in d dimensions its own sd is 7 % / sqrt d."""
    errors = mixture.monte_carlo_errors(size, np.random.default_rng(3), trials)
    return np.sqrt((errors**2).mean())


def test_the_factorised_sum_is_the_sum_over_the_grid(figures):
    mixture = figures.Mixture(3, centres=figures.ASIDE)
    line = (np.arange(5) + 0.5) / 5
    at = np.stack(np.meshgrid(line, line, line), -1).reshape(-1, 3)
    density = sum(
        share * np.exp(-0.5 * np.sum((at - centre) ** 2, axis=1) / mixture.sd**2)
        for share, centre in zip((0.7, 0.3), mixture.centres, strict=True)
    )
    mean = density @ at / density.sum()
    assert np.linalg.norm(mean - mixture.mean) == pytest.approx(mixture.grid_error(5), rel=1e-9)


def test_the_grid_wins_on_smooth_densities(figures):
    """The thesis' Figure 5.2 has it the other way round; with equal weights symmetry makes the grid exact."""
    two, four = figures.Mixture(2), figures.Mixture(4)
    assert figures.Mixture(2, share=0.5).grid_error(10) < 1e-12
    assert two.grid_error(10) == pytest.approx(2.1e-4, rel=0.03)
    assert rms(two, 100) == pytest.approx(3.5e-2, rel=0.2)  # 4 sds of 5 %
    assert four.grid_error(10) == pytest.approx(3.0e-4, rel=0.03)
    assert rms(four, 10_000, 25) == pytest.approx(5.0e-3, rel=0.28)  # 4 sds of 7 %


def test_monte_carlo_wins_on_narrow_ones_and_in_many_dimensions(figures):
    narrow = figures.Mixture(3, 0.03, centres=figures.ASIDE)
    many = figures.Mixture(8, centres=figures.ASIDE)
    assert narrow.grid_error(12) > 3 * rms(narrow, 12**3, 40)
    assert narrow.grid_error(22) < 0.2 * rms(narrow, 22**3, 10)  # its spacing is below two sds by then
    assert many.grid_error(3) > 20 * rms(many, 3**8, 20)
