"""The settings of the Gaussian belief."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bayesnet_track.graph.settings.base import Model, Number, Positive, Share, Whole


class Unscented(Model):
    """The scaled unscented transform: sigma points alpha sqrt(K + kappa) sds from the mean, K the dimension.

    With the defaults they lie sqrt(3) sds out, where the fourth moment along each axis is right. A small
    alpha (1e-3, with beta 2 and kappa 0) keeps them close to the mean.
    """

    alpha: Positive = Field(default=1.0, description="spread of the points")
    beta: Annotated[Number, Field(ge=0)] = Field(
        default=0.0, description="further weight of the central point in covariances"
    )
    kappa: Annotated[Number, Field(ge=0)] | None = Field(
        default=None, description="added to the dimension; 3 - K without a value"
    )


class Gaussian(Model):
    """One mean and one covariance: the Kalman family.

    Measurements of agents enter by the Kalman update, likelihoods by matching moments over hypotheses drawn
    from the prediction. There is one mode only: if two places are likely, use particles.
    """

    filter: Literal["kalman", "extended", "unscented"] = Field(
        default="extended",
        description="how it predicts: `kalman` where the motion's noise is in px only, `extended` by the "
        "motion's derivative, `unscented` by sigma points",
    )
    likelihood: Literal["samples", "sigma_points"] = Field(
        default="samples",
        description="where agents evaluate their likelihoods: at samples of the prediction, or at 2 D + 1 "
        "sigma points, which is cheaper, and accurate for likelihoods with one mode that are "
        "broader than the prediction",
    )
    samples: Annotated[Whole, Field(ge=20, le=1_000_000)] = Field(
        default=200, description="number of samples of the prediction"
    )
    gate: Share = Field(
        default=0.99,
        description="a measurement farther from the prediction than this share of correct ones is not used; "
        "1: all are used",
    )
    sigma: Unscented = Field(default=Unscented(), description="sigma points of the `unscented` filter")
