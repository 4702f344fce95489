"""Labels of detections as evidence on what a target is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesnet_track.numerics.arrays import Floats, Ints


@dataclass(frozen=True)
class LabelRule:
    """Probabilities of the labels of detections, given what a target is.

    Attributes:
        category: what the labels are evidence on, such as `team`.
        labels: the L labels.
        table: (V, L) probability of each label by the category's value, in its order.
        prior: (V,) of the values when a target starts; false detections have the labels of such targets.
    """

    category: str
    labels: tuple[str, ...]
    table: tuple[tuple[float, ...], ...]
    prior: tuple[float, ...]

    def log(self, labels: Sequence[str]) -> Floats:
        """(N, V) log-probabilities of labels by value; 0 of a label that the rule does not know.

        >>> rule = LabelRule("team", ("red", "blue"), ((0.75, 0.25), (0.5, 0.5)), (0.5, 0.5))
        >>> np.exp(rule.log(["blue", ""])).tolist()
        [[0.25, 0.5], [1.0, 1.0]]
        """
        columns = {label: column for column, label in enumerate(self.labels)}
        nothing = (1.0,) * len(self.table)
        rows = [
            [row[columns[label]] for row in self.table] if label in columns else nothing for label in labels
        ]
        return np.log(np.array(rows, dtype=np.float64).reshape(len(labels), len(self.table)))

    def log_nobody(self, labels: Sequence[str]) -> Floats:
        """(N,) log-probabilities of labels of detections of nobody."""
        return np.asarray(np.logaddexp.reduce(self.log(labels) + np.log(self.prior), axis=1))

    def log_gains(self, labels: Sequence[str]) -> Floats:
        """(N, V) log of how much likelier labels are of a target of each value than of nobody."""
        return np.asarray(self.log(labels) - self.log_nobody(labels)[:, None])

    def told(self, labels: Sequence[str]) -> Floats:
        """(N, V + 1) what an agent is given beside its detections: `log`, then `log_nobody`."""
        return np.column_stack([self.log(labels), self.log_nobody(labels)])

    def learnt(self, values: Floats, likelihoods: Floats, weights: Floats, missed: float) -> Floats:
        """(V,) probabilities of the values after a look.

        From those before, `likelihoods` (M, V) of the labels of detections that are the target's with
        `weights` (M,), and how probably none is.
        """
        share = missed + weights @ (likelihoods / (likelihoods @ values)[:, None])
        posterior = values * share
        return np.asarray(posterior / posterior.sum())


@dataclass(frozen=True, eq=False)
class Label:
    """A label as evidence on a category: log-probabilities (V,) of the label by value, and of nobody's."""

    category: str
    log: Floats
    log_nobody: float

    def of(self, fields: Mapping[str, Floats] | Mapping[str, Ints]) -> Floats:
        """(N,) of hypotheses with these fields."""
        return np.asarray(self.log[fields[self.category].astype(np.intp)])

    def to_power(self, power: float) -> Label:
        """Raised to a power."""
        return Label(self.category, self.log * power, self.log_nobody * power)
