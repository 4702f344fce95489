"""Compiled kernels over the rows of a table: one Gaussian belief a row, all of one linear motion.

They do for T targets what `belief.gaussian` and `inference.measure` do for one, in a fixed order of
arithmetic that no linear algebra library decides: a row's result does not depend on the rows beside it.
"""

from __future__ import annotations

import math

import numpy as np

from bayesnet_track.numerics.arrays import (
    AGENT_UD,
    AREA,
    D2,
    ESS,
    FIT,
    HYPOTHESES,
    LOG_EVIDENCE,
    MEASURES,
    NATS,
    STRENGTH,
    UD,
    Bools,
    Floats,
    Ints,
)
from bayesnet_track.numerics.compiled import compiled
from bayesnet_track.numerics.gaussian import carry, factor, fill_root


@compiled
def predict_rows(
    mean: Floats, covariance: Floats, move: Floats, noise: Floats, image: Floats
) -> tuple[Floats, Floats]:
    """Means (T, D) and covariances (T, D, D) after m = F m, P = F P F' + Q, confined to an image.

    Centres stay on the image (width, height; infinite: they go anywhere), sizes from 1 px to twice the
    image's; the sds of a box are at
    most those of one that may be anywhere (`belief.motion.borders.Confined`).
    """
    count, size = mean.shape
    predicted, spread = np.empty((count, size)), np.empty((count, size, size))
    half, shrink = np.empty((size, size)), np.empty(size)
    parts, columns = np.zeros(size, np.int64), np.empty((size, size), np.int64)
    for i in range(size):
        for j in range(size):
            if move[i, j] != 0.0:
                columns[i, parts[i]] = j
                parts[i] += 1
    for t in range(count):
        for i in range(size):
            value = 0.0
            for k in range(size):
                half[i, k] = 0.0
            for n in range(parts[i]):
                j = columns[i, n]
                weight = move[i, j]
                value += weight * mean[t, j]
                for k in range(size):
                    half[i, k] += weight * covariance[t, j, k]
            predicted[t, i] = value
        for i in range(size):
            for k in range(size):
                value = 0.0
                for n in range(parts[k]):
                    j = columns[k, n]
                    value += half[i, j] * move[k, j]
                spread[t, i, k] = value + noise[i, k]
        for i in range(size):
            for k in range(i):
                average = 0.5 * (spread[t, i, k] + spread[t, k, i])
                spread[t, i, k], spread[t, k, i] = average, average
        is_wide = False
        for k in range(size):
            shrink[k] = 1.0
        for k in range(4):
            extent = image[k % 2]
            lowest = 0.0 if extent < np.inf else -np.inf
            low, high = (lowest, extent - 1.0) if k < 2 else (1.0, 2.0 * extent)
            predicted[t, k] = min(max(predicted[t, k], low), high)
            limit = math.sqrt((high - low) ** 2 / 12 + (predicted[t, k] - (low + high) / 2) ** 2)
            sd = math.sqrt(spread[t, k, k])
            if sd > limit:
                shrink[k] = limit / sd
                is_wide = True
        if is_wide:
            for i in range(size):
                for k in range(size):
                    spread[t, i, k] *= shrink[i] * shrink[k]
    return predicted, spread


@compiled
def correct_row(
    mean: Floats, covariance: Floats, innovation: Floats, variances: Floats, work: Floats
) -> float:
    """The Kalman update of a row by a measurement of its box, in place, Joseph's form; its log likelihood.

    `innovation` (4,) is what was measured less the mean; `work` (3, D, D) is room to work in.
    """
    size = mean.shape[0]
    gain, complement, half = work[0], work[1], work[2]
    spread, lower, whitened = np.empty((4, 4)), np.zeros((4, 4)), np.empty(4)
    for i in range(4):
        for j in range(4):
            spread[i, j] = covariance[i, j]
        spread[i, i] += variances[i]
    half_log = factor(spread, lower, 4)
    d2, log_noise = 0.0, 0.0
    for i in range(4):
        value = innovation[i]
        for j in range(i):
            value -= lower[i, j] * whitened[j]
        whitened[i] = value / lower[i, i]
        d2 += whitened[i] * whitened[i]
        log_noise += math.log(variances[i])
    for k in range(size):  # gain = P H' S^-1, a row at a time
        for i in range(4):
            value = covariance[k, i]
            for j in range(i):
                value -= lower[i, j] * gain[k, j]
            gain[k, i] = value / lower[i, i]
        for i in range(3, -1, -1):
            value = gain[k, i]
            for j in range(i + 1, 4):
                value -= lower[j, i] * gain[k, j]
            gain[k, i] = value / lower[i, i]
    for k in range(size):
        for i in range(4):
            mean[k] += gain[k, i] * innovation[i]
        for i in range(4):  # of I - K H only these columns are not those of I
            complement[k, i] = (1.0 if k == i else 0.0) - gain[k, i]
    for i in range(size):
        for k in range(size):
            value = 0.0
            for j in range(4):
                value += complement[i, j] * covariance[j, k]
            half[i, k] = value + covariance[i, k] if i >= 4 else value
    for i in range(size):
        for k in range(i + 1):
            value, mirrored, noise = 0.0, 0.0, 0.0
            for j in range(4):
                value += half[i, j] * complement[k, j]
                mirrored += half[k, j] * complement[i, j]
                noise += gain[i, j] * variances[j] * gain[k, j]
            if k >= 4:
                value += half[i, k]
            if i >= 4:
                mirrored += half[k, i]
            average = 0.5 * (value + mirrored) + noise
            covariance[i, k], covariance[k, i] = average, average
    return 0.5 * log_noise - half_log - 0.5 * d2


@compiled
def follow_row(
    mean: Floats, covariance: Floats, move: tuple[Floats, Floats, Floats], box: Floats, variances: Floats
) -> float:
    """Predict a row and correct it by a box (4,), in place; the squared distance of box and prediction.

    It moves by F (D, D), Q (D, D) and b (D,): m = F m + b, P = F P F' + Q. Sizes stay at 1 px or more.
    """
    size = mean.shape[0]
    predicted, spread, offset, work = (
        np.empty(size),
        np.empty((size, size)),
        np.empty(4),
        np.empty((3, size, size)),
    )
    transition, noise, shift = move
    carry(transition, noise, mean, covariance, predicted, spread)
    for i in range(size):
        mean[i] = predicted[i] + shift[i]
        for k in range(size):
            covariance[i, k] = spread[i, k]
    for i in range(4):
        offset[i] = box[i] - mean[i]
    d2 = innovation_d2(covariance, offset, variances)
    correct_row(mean, covariance, offset, variances, work)
    for i in range(2, 4):
        mean[i] = max(mean[i], 1.0)
    return d2


@compiled
def innovation_d2(covariance: Floats, innovation: Floats, variances: Floats) -> float:
    """Squared Mahalanobis distance of a measured box, whose `innovation` (4,) is that from the mean."""
    spread, lower, d2 = np.empty((4, 4)), np.zeros((4, 4)), 0.0
    for i in range(4):
        for j in range(4):
            spread[i, j] = covariance[i, j]
        spread[i, i] += variances[i]
    factor(spread, lower, 4)
    whitened = np.empty(4)
    for i in range(4):
        value = innovation[i]
        for j in range(i):
            value -= lower[i, j] * whitened[j]
        whitened[i] = value / lower[i, i]
        d2 += whitened[i] * whitened[i]
    return d2


@compiled
def update_rows(
    moments: tuple[Floats, Floats],
    detections: Floats,
    is_detected: Bools,
    variances: Floats,
    samples: Floats,
    limits: tuple[float, float, float],
    image: Floats,
    counts: Bools,
) -> Floats:
    """Update rows (T, D), (T, D, D) in place by `detections` (T, 4) where `is_detected`; (T, 10) of each.

    The columns: `LOG_EVIDENCE`; `NATS`, KL of the hypotheses' posterior from their prior; `ESS`, effective
    sample size; how many `HYPOTHESES`; `AGENT_UD`; `UD`, both px^2; `FIT`, the best likelihood (0 where not
    seen); `AREA` of the mean box, px^2; `STRENGTH`, KL of what the agent says from the prior; `D2` of a box
    that is not used, 0 of others. The hypotheses are the boxes `samples` (T, N, 4), or the sigma points where
    there are none; `counts` (4,) are the fields of UD. `limits` are the floor of a likelihood, the largest
    squared distance of a box that is used, and the share of its sd below which a field is known from others.
    """
    mean, covariance = moments
    floor, farthest, least_share = limits
    count, size = mean.shape
    measures = np.zeros((count, MEASURES))
    lower, remainder, scale = np.zeros((size, size)), np.empty((size, size)), np.empty(size)
    capacity = max(2 * size + 1, samples.shape[1])
    boxes, work = np.empty((capacity, 4)), np.empty((3, size, size))
    log, prior, innovation = np.empty(capacity), np.empty(capacity), np.empty(4)
    for t in range(count):
        points = samples.shape[1]
        if points == 0:
            points = place_row(
                mean[t], covariance[t], image, least_share, (boxes, prior), (lower, remainder, scale)
            )
        else:
            for n in range(points):
                prior[n] = -math.log(points)
                for k in range(4):
                    boxes[n, k] = samples[t, n, k]
        likeliest, top = 0, -np.inf
        for n in range(points):
            log[n] = 0.0
            if is_detected[t]:
                d2 = 0.0
                for k in range(4):
                    d2 += (boxes[n, k] - detections[t, k]) ** 2 / variances[t, k]
                log[n] = min(math.log(floor + (1.0 - floor) * math.exp(-0.5 * d2)), 0.0)
            if log[n] > log[likeliest]:
                likeliest = n
            top = max(top, prior[n] + log[n])
        total, share = 0.0, 0.0
        for n in range(points):
            if n < 2 or log[n] != log[n - 1]:  # all alike where nothing was seen
                share = math.exp(prior[n] + log[n] - top)
            total += share
        total = top + math.log(total)
        nats, squares, agent_ud, weight = 0.0, 0.0, 0.0, 0.0
        for n in range(points):
            if n < 2 or log[n] != log[n - 1]:
                weight = math.exp(prior[n] + log[n] - total)
            nats += weight * (log[n] - total)
            squares += weight * weight
            for k in range(4):
                if counts[k]:
                    agent_ud += weight * (boxes[n, k] - boxes[likeliest, k]) ** 2
        if is_detected[t]:
            for k in range(4):
                innovation[k] = detections[t, k] - mean[t, k]
            measures[t, FIT], measures[t, STRENGTH] = math.exp(log[likeliest]), max(nats, 0.0)
            d2 = innovation_d2(covariance[t], innovation, variances[t]) if farthest < np.inf else 0.0
            if d2 > farthest:
                measures[t, D2], squares = d2, 0.0
                for n in range(points):
                    squares += math.exp(2.0 * prior[n])
            else:
                measures[t, LOG_EVIDENCE] = correct_row(
                    mean[t], covariance[t], innovation, variances[t], work
                )
                measures[t, NATS] = max(nats, 0.0)
        measures[t, ESS], measures[t, HYPOTHESES], measures[t, AGENT_UD] = 1.0 / squares, points, agent_ud
        for k in range(4):
            if counts[k]:
                measures[t, UD] += covariance[t, k, k]
        mean[t, 2], mean[t, 3] = max(mean[t, 2], 1.0), max(mean[t, 3], 1.0)
        sides = 1.0
        for k in range(2):
            sides *= min(max(mean[t, k + 2], 1.0), 2.0 * image[k])
        measures[t, AREA] = sides
    return measures


@compiled
def place_row(
    mean: Floats,
    covariance: Floats,
    image: Floats,
    least_share: float,
    points: tuple[Floats, Floats],
    rooms: tuple[Floats, Floats, Floats],
) -> int:
    """Fill in the boxes of a row's sigma points, inside the image, and their log-weights; how many they are.

    The covariance becomes what its root has of it, as where agents' likelihoods are fitted. `rooms` are of
    `root_of`.
    """
    boxes, prior = points
    lower, remainder, scale = rooms
    size = mean.shape[0]
    width = fill_root(covariance, lower, remainder, scale, least_share)
    distance = math.sqrt(width + 1.0)
    log_first, log_other = -math.log(width + 1.0), -math.log(2.0 * (width + 1.0))
    for n in range(2 * width + 1):
        prior[n] = log_first if n == 0 else log_other
        for k in range(4):
            value = mean[k]
            if n > 0:
                step = distance * lower[k, (n - 1) % width]
                value = value + step if n <= width else value - step
            extent = image[k % 2]
            lowest = 0.0 if extent < np.inf else -np.inf
            low, high = (lowest, extent - 1.0) if k < 2 else (1.0, 2.0 * extent)
            boxes[n, k] = min(max(value, low), high)
    for i in range(size):
        for k in range(i + 1):
            value = 0.0
            for j in range(width):
                value += lower[i, j] * lower[k, j]
            covariance[i, k], covariance[k, i] = value, value
    return 2 * width + 1


@compiled
def take_median(values: Floats, count: int) -> float:
    """The median of the first `count` of the values, whose order changes; by Hoare's selection."""
    middle, low, high = count // 2, 0, count - 1
    while low < high:
        pivot, i, j = values[middle], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if j < middle:
            low = i
        if middle < i:
            high = j
    if count % 2:
        return float(values[middle])
    lower = values[0]
    for k in range(1, middle):
        lower = max(lower, values[k])
    return float((lower + values[middle]) / 2)


@compiled
def append_medians(
    values: Floats, counts: Ints, latest: Floats, adds: Bools, least_count: int
) -> tuple[Floats, Ints, Floats]:
    """The windows (T, W) of last values, filled from the right, with one more in the rows that `adds`.

    Also how many each holds, and their medians; NaN where there are fewer than `least_count`.
    """
    rows, size = values.shape
    windows, lengths, medians = values.copy(), counts.copy(), np.full(rows, np.nan)
    room = np.empty(size)
    for t in range(rows):
        if adds[t]:
            for k in range(size - 1):
                windows[t, k] = values[t, k + 1]
            windows[t, size - 1] = latest[t]
            lengths[t] = min(counts[t] + 1, size)
        n = lengths[t]
        if n >= least_count:
            for k in range(n):
                room[k] = windows[t, size - n + k]
            medians[t] = take_median(room, n)
    return windows, lengths, medians
