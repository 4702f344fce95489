"""The shape model: a mean shape and its modes of variation, learnt from shape vectors, stored as ``.npz``.

Thesis 3.3: principal components that keep 95 % of the variance of the signed-distance vectors.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayesnet_track.numerics.arrays import Floats

KIND, VERSION = "bayesnet_track shape model", 1
KEEP = 0.95
"""Share of the variance that the modes keep."""


class ShapeModelError(ValueError):
    """A model file that cannot be read or is not one of this version."""


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """A Gaussian over shape vectors: orthonormal modes around a mean.

    Attributes:
        mean: (G * G,) mean shape vector, unit half mean sides of the box.
        modes: (K, G * G) orthonormal, largest variance first; K may be 0.
        variances: (K,) variance along each mode.
        explained: share of the examples' variance that the modes hold, 0..1 (1 when they do not vary).
        examples: how many shapes it was learnt from.
    """

    mean: Floats
    modes: Floats
    variances: Floats
    explained: float = 1.0
    examples: int = 1

    @property
    def grid(self) -> int:
        """Cells per side of the grid."""
        return round(float(np.sqrt(self.mean.size)))


def learn_model(vectors: Floats, keep: float = KEEP) -> ShapeModel:
    """The model of the shape vectors (n, G * G): the fewest modes with at least `keep` of their variance.

    Variances are divided by n. Each mode's largest entry is positive: equal examples give equal files.

    Raises:
        ValueError: no example, or one that is not finite.
    """
    examples = np.asarray(vectors, dtype=np.float64)
    if examples.ndim != 2 or len(examples) == 0:
        raise ValueError("a shape model needs at least one example")
    if not np.isfinite(examples).all():
        raise ValueError("a shape vector is not finite")
    mean = examples.mean(axis=0)
    _, singular, axes = np.linalg.svd(examples - mean, full_matrices=False)
    variances = singular**2 / len(examples)
    total = float(variances.sum())
    if total <= 1e-20:
        return ShapeModel(mean, np.empty((0, mean.size)), np.empty(0), 1.0, len(examples))
    held = np.cumsum(variances) / total
    count = min(int(np.searchsorted(held, keep - 1e-12)) + 1, len(variances))
    return ShapeModel(mean, _sign(axes[:count]), variances[:count], float(held[count - 1]), len(examples))


def merge(old: ShapeModel, new: ShapeModel, rate: float, most: int) -> ShapeModel:
    """The Gaussian with the mean and covariance of the mixture (1 - rate) old + rate new.

    At most `most` modes, those with the largest variances. Rate 0 and 1 give the two models themselves.
    """
    if rate <= 0.0 or rate >= 1.0:
        return old if rate <= 0.0 else new
    mean = (1.0 - rate) * old.mean + rate * new.mean
    columns = np.concatenate(
        [
            old.modes * np.sqrt((1.0 - rate) * old.variances)[:, None],
            new.modes * np.sqrt(rate * new.variances)[:, None],
            (np.sqrt(rate * (1.0 - rate)) * (new.mean - old.mean))[None],
        ]
    )
    # The covariance is columns' columns; its eigenvectors come from the small matrix columns columns'.
    variances, weights = np.linalg.eigh(np.einsum("ap,bp->ab", columns, columns))
    order = [k for k in np.argsort(-variances, kind="stable")[:most] if variances[k] > 1e-12]
    modes = np.einsum("ak,ap->kp", weights[:, order], columns) / np.sqrt(variances[order])[:, None]
    return ShapeModel(mean, _sign(modes), variances[order], 1.0, old.examples + new.examples)


def save_model(path: str | Path, model: ShapeModel) -> None:
    """Write the model; the file holds arrays only, no code.

    Raises:
        OSError: it cannot be written.
    """
    with Path(path).open("wb") as file:
        np.savez_compressed(
            file,
            kind=np.array(KIND),
            version=np.array(VERSION),
            mean=model.mean,
            modes=model.modes,
            variances=model.variances,
            explained=np.array(model.explained),
            examples=np.array(model.examples),
        )


MAX_BYTES = 1 << 28
"""Most that a model may take in memory: far more than one of 100 modes on 64 x 64 cells."""


def load_model(path: str | Path) -> ShapeModel:
    """Read what `save_model` wrote; nothing in the file is executed.

    Raises:
        ShapeModelError: it cannot be read, is something else, of another version, or its arrays do not fit.
    """
    # A pipe would wait for its writer, a device never end, and packed zeros unpack to any size.
    if Path(path).exists() and not Path(path).is_file():
        raise ShapeModelError(f"{path} is no file")
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as packed:
                if sum(part.file_size for part in packed.infolist()) > MAX_BYTES:
                    raise ShapeModelError(f"{path} is larger than {MAX_BYTES >> 20} MB when unpacked")
        with np.load(path, allow_pickle=False) as file:
            if not isinstance(file, np.lib.npyio.NpzFile) or str(file.get("kind")) != KIND:
                raise ShapeModelError(f"{path} is not a shape model; `bayesnet-track learn-shape` makes one")
            version = file["version"]
            if version.shape != () or int(version) != VERSION:
                raise ShapeModelError(
                    f"{path} is a shape model of version {version}; this program reads version {VERSION}"
                )
            return _check(path, {name: file[name] for name in _FIELDS})
    except FileNotFoundError:
        raise ShapeModelError(f"{path} is not there; `bayesnet-track learn-shape` makes one") from None
    except OSError as error:
        raise ShapeModelError(f"{path} cannot be read: {error.strerror or error}") from error
    except ShapeModelError:
        raise
    except (ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ShapeModelError(f"{path} is damaged, or no shape model") from error


_FIELDS = ("mean", "modes", "variances", "explained", "examples")


def _check(path: str | Path, arrays: dict[str, NDArray[np.generic]]) -> ShapeModel:
    mean, modes, variances = (np.array(arrays[name], dtype=np.float64) for name in _FIELDS[:3])
    side = round(float(np.sqrt(mean.size)))
    fits = mean.ndim == 1 and side * side == mean.size and side >= 4
    fits = fits and modes.shape == (variances.size, mean.size) and variances.ndim == 1
    if not fits:
        raise ShapeModelError(
            f"{path}: arrays of shapes {mean.shape}, {modes.shape}, {variances.shape} are no shape model: "
            "a mean of G * G values, K modes of as many, and K variances are needed"
        )
    finite = all(np.isfinite(array).all() for array in (mean, modes, variances))
    if not finite or (variances < 0).any():
        raise ShapeModelError(f"{path}: values that are not finite, or negative variances")
    if not np.allclose(np.einsum("ap,bp->ab", modes, modes), np.eye(len(modes)), atol=1e-6):
        raise ShapeModelError(f"{path}: its modes are not orthonormal")
    return ShapeModel(mean, modes, variances, float(arrays["explained"]), int(arrays["examples"]))


def _sign(modes: Floats) -> Floats:
    """The modes (K, P), each turned so that its largest entry is positive."""
    if len(modes) == 0:
        return np.asarray(modes)
    top = modes[np.arange(len(modes)), np.abs(modes).argmax(axis=1)]
    return np.asarray(modes * np.where(top < 0, -1.0, 1.0)[:, None])
