"""Compiled kernels of filters and networks that answer with a map: gradients, spectra, answers, proposals.

Oriented gradients are after Dalal and Triggs (2005) and Felzenszwalb et al. (2010), without an arctangent: a
gradient votes for each orientation by the fourth power of its cosine, which needs scalar products only. The
powers sum to the same for every direction. Votes are shared between the nearest cells.
"""

from __future__ import annotations

import numpy as np

from bayesnet_track.numerics.arrays import Bytes, Floats, Ints, Singles
from bayesnet_track.numerics.compiled import compiled, compiled_summing

CELL = 4
"""Side of a cell, px."""
TRUNCATED = np.float32(0.2)
"""Largest value of a cell: one strong edge must not decide alone."""


@compiled
def oriented_gradients(gray: Bytes, half: int, histograms: Singles) -> None:
    """Add up magnitudes of gradients by cell and orientation.

    Args:
        gray: (4 R, 4 K) uint8, C order.
        half: orientations of half a circle, at least 3.
        histograms: (R, K, N) float32, filled. With N = 2 `half` those of the full circle, k + `half` points
            away from k; with N = `half` both count alike. The first and last column are 0, the first and
            last row hold their own votes only: take them as a rim.
    """
    height, width = gray.shape
    rows, columns, count = histograms.shape
    share = np.array([0.625, 0.875, 0.875, 0.625], np.float32)  # of the own cell; the rest is the neighbour's
    directions = np.empty((half, 2), np.float32)
    for k in range(half):
        directions[k, 0], directions[k, 1] = np.cos(np.pi * k / half), np.sin(np.pi * k / half)
    pooled = np.zeros((rows, count, width), np.float32)
    gx, gy, per = np.zeros(width, np.float32), np.zeros(width, np.float32), np.zeros(width, np.float32)
    for y in range(1, height - 1):
        previous_row, row, next_row = gray[y - 1], gray[y], gray[y + 1]
        for x in range(1, width - 1):
            a = np.float32(row[x + 1]) - np.float32(row[x - 1])
            b = np.float32(next_row[x]) - np.float32(previous_row[x])
            energy = a * a + b * b + np.float32(1e-6)
            gx[x] = a
            gy[x] = b
            per[x] = np.float32(1.0) / (energy * np.sqrt(energy))
        cell = y // 4
        neighbour = cell - 1 if y % 4 < 2 else cell + 1
        cell_share, neighbour_share = share[y % 4], np.float32(1.0) - share[y % 4]
        if neighbour < 0 or neighbour >= rows:
            neighbour, neighbour_share = cell, np.float32(0.0)
        for k in range(half):
            cosine, sine = directions[k, 0], directions[k, 1]
            if count == half:
                votes, neighbour_votes = pooled[cell, k], pooled[neighbour, k]
                for x in range(width):
                    dot = cosine * gx[x] + sine * gy[x]
                    square = dot * dot
                    vote = square * square * per[x]
                    votes[x] += cell_share * vote
                    neighbour_votes[x] += neighbour_share * vote
                continue
            plus, minus = pooled[cell, k], pooled[cell, k + half]
            plus_beside, minus_beside = pooled[neighbour, k], pooled[neighbour, k + half]
            for x in range(width):  # without branches, so that it becomes vector instructions
                dot = cosine * gx[x] + sine * gy[x]
                square = dot * dot
                vote = square * square * per[x]
                with_it = vote if dot > 0 else np.float32(0.0)
                against = vote - with_it
                plus[x] += cell_share * with_it
                minus[x] += cell_share * against
                plus_beside[x] += neighbour_share * with_it
                minus_beside[x] += neighbour_share * against
    for j in range(rows):
        for k in range(count):
            line = pooled[j, k]
            for i in range(1, columns - 1):
                x = 4 * i
                histograms[j, i, k] = (
                    np.float32(0.125) * (line[x - 2] + line[x + 5])
                    + np.float32(0.375) * (line[x - 1] + line[x + 4])
                    + np.float32(0.625) * (line[x] + line[x + 3])
                    + np.float32(0.875) * (line[x + 1] + line[x + 2])
                )
            histograms[j, 0, k] = histograms[j, columns - 1, k] = np.float32(0.0)


@compiled
def normalised_cells(histograms: Singles, half: int, noise: float, features: Singles) -> None:
    """Fill the first channels of `features` with cells relative to the root of the energy around them.

    Args:
        histograms: (R + 2, K + 2, N) float32 of `oriented_gradients`, which says N; likewise `half`.
        noise: energy that is added, so that the grain of flat places does not become a pattern.
        features: (C, R, K) float32: with N = 2 `half` first N channels in which light to dark differs from
            dark to light; then `half` in which it does not.
    """
    rows, columns, count = features.shape[1], features.shape[2], histograms.shape[2]
    energy = np.empty((rows + 2, columns + 2), np.float32)
    for j in range(rows + 2):
        for i in range(columns + 2):
            total = np.float32(0.0)
            for k in range(half):
                magnitude = histograms[j, i, k]
                if count > half:
                    magnitude += histograms[j, i, k + half]
                total += magnitude * magnitude
            energy[j, i] = total
    scale = np.empty(columns, np.float32)
    quarter, middle = np.float32(0.25), np.float32(0.5)
    for j in range(rows):
        previous, current, following = energy[j], energy[j + 1], energy[j + 2]
        for i in range(columns):
            total_energy = (
                np.float32(noise)
                + quarter * previous[i]
                + middle * previous[i + 1]
                + quarter * previous[i + 2]
            )
            total_energy += middle * current[i]
            total_energy += current[i + 1]
            total_energy += middle * current[i + 2]
            total_energy += quarter * following[i]
            total_energy += middle * following[i + 1]
            total_energy += quarter * following[i + 2]
            scale[i] = np.float32(1.0) / np.sqrt(total_energy)
        for k in range(half):
            for i in range(columns):
                positive = histograms[j + 1, i + 1, k] * scale[i]
                if count == half:
                    features[k, j, i] = min(positive, TRUNCATED)
                    continue
                negative = histograms[j + 1, i + 1, k + half] * scale[i]
                features[k, j, i] = min(positive, TRUNCATED)
                features[k + half, j, i] = min(negative, TRUNCATED)
                features[k + count, j, i] = min(positive + negative, TRUNCATED)


@compiled
def cell_means(pixels: Bytes, means: Bytes) -> None:
    """Fill `means` (R, 3 K) uint8 with the means over cells of `pixels` (4 R, 12 K), three channels a pixel.

    Rounded to the nearest, halves to the even one, as OpenCV does.
    """
    width = pixels.shape[1]
    sums = np.empty(width, np.int32)
    for j in range(means.shape[0]):
        a, b, c, d = pixels[4 * j], pixels[4 * j + 1], pixels[4 * j + 2], pixels[4 * j + 3]
        for x in range(width):
            sums[x] = np.int32(a[x]) + np.int32(b[x]) + np.int32(c[x]) + np.int32(d[x])
        for i in range(width // 12):
            for channel in range(3):
                x = 12 * i + channel
                total = sums[x] + sums[x + 3] + sums[x + 6] + sums[x + 9]
                means[j, 3 * i + channel] = (total + 7 + ((total >> 4) & 1)) >> 4


@compiled
def cubic_weights(t: float, weights: Floats) -> None:
    """Fill `weights` (4,) of Catmull and Rom's cubic through four neighbours, `t` in 0..1 past the second."""
    weights[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
    weights[1] = (1.5 * t - 2.5) * t * t + 1.0
    weights[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
    weights[3] = (0.5 * t - 0.5) * t * t


@compiled_summing
def centre_spectra(spectra: Singles, turns: Singles, centred: Singles) -> None:
    """Write the spectra of C channels, each frequency turned by its phase, into `centred` (H, C, 4, H).

    Args:
        spectra: (C, F, F) as OpenCV packs spectra of real images, F even, H = F / 2 + 1: pairs of real and
            imaginary part lie along a row, in the first and in the last column along the column.
        turns: (H, 2, 2, H) cosine and sine of each phase, for vertical frequencies upward and downward.
        centred: [row, channel]: real and imaginary parts at the vertical frequency `row`, then at -`row`.
    """
    side = spectra.shape[1]
    highest = side // 2
    for channel in range(len(spectra)):
        packed = spectra[channel]
        for j in range(highest + 1):
            for sign in range(2):
                line = packed[j if sign == 0 or j == 0 else side - j]
                cosine, sine = turns[j, sign, 0], turns[j, sign, 1]
                real, imaginary = centred[j, channel, 2 * sign], centred[j, channel, 2 * sign + 1]
                for k in range(1, highest):
                    real[k] = line[2 * k - 1] * cosine[k] - line[2 * k] * sine[k]
                for k in range(1, highest):
                    imaginary[k] = line[2 * k - 1] * sine[k] + line[2 * k] * cosine[k]
                for k in (0, highest):
                    column, imaginary_part = min(2 * k, side - 1), np.float32(0.0)
                    real_part = packed[min(max(2 * j - 1, 0), side - 1), column]
                    if 0 < j < highest:
                        imaginary_part = packed[2 * j, column] if sign == 0 else -packed[2 * j, column]
                    real[k] = real_part * cosine[k] - imaginary_part * sine[k]
                    imaginary[k] = real_part * sine[k] + imaginary_part * cosine[k]


@compiled
def fill_halves(kernel: Singles, parts: Singles) -> None:
    """Write the even and odd part of a filter (C, S, S) by column and row into `parts` (2, 2, H, C, H)."""
    channels, side = kernel.shape[0], kernel.shape[1]
    for j in range(side // 2):
        for c in range(channels):
            upper, lower = kernel[c, j], kernel[c, side - 1 - j]
            for i in range(side // 2):
                k = side - 1 - i
                even_left, even_right = upper[i] + lower[i], upper[k] + lower[k]
                odd_left, odd_right = upper[i] - lower[i], upper[k] - lower[k]
                parts[0, 0, j, c, i], parts[1, 0, j, c, i] = even_left + even_right, even_left - even_right
                parts[0, 1, j, c, i], parts[1, 1, j, c, i] = odd_left + odd_right, odd_left - odd_right


@compiled_summing
def pack_row(sums: Singles, j: int, total: Singles) -> None:
    """Put the sums (4, H) of the vertical frequencies `j` and -`j` where OpenCV packs them in `total`."""
    side = total.shape[0]
    highest = side // 2
    for k in range(1, highest):
        total[j, 2 * k - 1] = sums[0, k]
        total[j, 2 * k] = sums[1, k]
    if 0 < j < highest:
        for k in range(1, highest):
            total[side - j, 2 * k - 1] = sums[2, k]
            total[side - j, 2 * k] = sums[3, k]
    for k in (0, highest):
        column = min(2 * k, side - 1)
        total[min(max(2 * j - 1, 0), side - 1), column] = sums[0, k]
        if 0 < j < highest:
            total[2 * j, column] = sums[1, k]


@compiled_summing
def conjugate_product(patches: Singles, waves: Singles, total: Singles) -> None:
    """Fill `total` (F, F), packed, with the sum over channels of a patch times a conjugate filter.

    Args:
        patches: (H, C, 4, H) spectra of the patch by `centre_spectra`.
        waves: (2, 2, H, C, H) of the filter: cosines (0) and sines (1) by column, then by row.
        total: (F, F), F = 2 H - 2.
    """
    rows, channels = patches.shape[0], patches.shape[1]
    sums = np.empty((4, rows), np.float32)
    for j in range(rows):
        sums[:] = np.float32(0.0)
        for c in range(channels):
            even, odd_columns = waves[0, 0, j, c], waves[1, 0, j, c]
            odd_rows, odd = waves[0, 1, j, c], waves[1, 1, j, c]
            patch = patches[j, c]
            for k in range(rows):
                real, imaginary = even[k] - odd[k], -odd_rows[k] - odd_columns[k]
                sums[0, k] += patch[0, k] * real + patch[1, k] * imaginary
                sums[1, k] += patch[1, k] * real - patch[0, k] * imaginary
                real, imaginary = even[k] + odd[k], odd_rows[k] - odd_columns[k]
                sums[2, k] += patch[2, k] * real + patch[3, k] * imaginary
                sums[3, k] += patch[3, k] * real - patch[2, k] * imaginary
        pack_row(sums, j, total)


@compiled
def add_answers(
    maps: Singles,
    lowest: int,
    boxes: Floats,
    tile: tuple[float, float, float],
    indices: Ints,
    levels: Floats,
    shares: Floats,
    answers: Floats,
) -> None:
    """Add the answers at the M hypotheses `indices` to `answers` (N,): bicubic, linear between levels.

    Args:
        maps: (L, V, V) float32, V >= 4, a map per level of scale.
        lowest: level of the first map.
        boxes: (N, 4) centre boxes, px; where not all neighbours are known, the nearest place is read.
        tile: x and y of the place in the middle of the maps, and the side of a cell, px.
        indices: (M,) indices of hypotheses.
        levels: (M,) from `lowest` to `lowest` + L - 1, where there is a share.
        shares: (M,) factors on the answers; those with 0 are not read.
        answers: (N,) added to.
    """
    column_weights, row_weights = np.empty(4), np.empty(4)
    bound, middle = maps.shape[1] - 3, 0.5 * (maps.shape[1] - 1)
    for m in range(len(indices)):
        if shares[m] == 0.0:
            continue
        n = indices[m]
        x, y = (boxes[n, 0] - tile[0]) / tile[2] + middle, (boxes[n, 1] - tile[1]) / tile[2] + middle
        i = min(max(int(np.floor(x)), 1), bound)
        j = min(max(int(np.floor(y)), 1), bound)
        cubic_weights(min(max(x - i, 0.0), 1.0), column_weights)
        cubic_weights(min(max(y - j, 0.0), 1.0), row_weights)
        lower = int(np.floor(levels[m]))
        part = levels[m] - lower
        total = 0.0
        for step in range(2):
            weight = part if step == 1 else 1.0 - part
            if weight == 0.0:
                continue
            answer_map = maps[lower + step - lowest]
            for b in range(4):
                line = 0.0
                for a in range(4):
                    line += column_weights[a] * answer_map[j + b - 1, i + a - 1]
                total += weight * row_weights[b] * line
        answers[n] += shares[m] * total


@compiled
def read_boxes(
    sides: Singles, corner: tuple[float, float], crop_side: int, network_side: int, stride: int, boxes: Floats
) -> None:
    """Fill `boxes` (S * S, 4), row by row, with the centre boxes that a map says in pixels of the frame.

    Args:
        sides: (4, S, S) how far left, top, right and bottom are from the middle of each cell, px of the crop.
        corner: x and y where the crop begins.
        crop_side: side of the crop in the frame; it is `network_side` in so many px.
        stride: from cell to cell, px of the crop.
        boxes: filled; sides of no extent are left tiny.
    """
    cells, scale, middle = sides.shape[1], crop_side / network_side, 0.5 * network_side
    for row in range(cells):
        for column in range(cells):
            box = boxes[row * cells + column]
            for axis in range(2):
                place = float(((row if axis else column) - cells // 2) * stride)
                low_side = np.float64(sides[axis, row, column])
                high_side = np.float64(sides[2 + axis, row, column])
                box[axis] = corner[axis] + scale * (middle + place + 0.5 * (high_side - low_side))
                box[2 + axis] = scale * max(low_side + high_side, 1e-3)


@compiled
def explained(boxes: Floats, proposals: Floats, logs: Floats, sd_place: float, sd_size: float) -> Floats:
    """(N,) largest logs[m] - d^2 / 2 over the proposals (M, 4) for each centre box (N, 4).

    d^2 adds the differences of the centres, in `sd_place` sides of the proposal, and of the logs of the
    sides, in `sd_size`; -inf without proposals.
    """
    log_sizes = np.log(proposals[:, 2:])
    largest = np.full(len(boxes), -np.inf)
    for n in range(len(boxes)):
        x, y = boxes[n, 0], boxes[n, 1]
        w, h = np.log(boxes[n, 2]), np.log(boxes[n, 3])
        for m in range(len(proposals)):
            if logs[m] <= largest[n]:
                continue
            dx = (x - proposals[m, 0]) / (sd_place * proposals[m, 2])
            dy = (y - proposals[m, 1]) / (sd_place * proposals[m, 3])
            wider, higher = (w - log_sizes[m, 0]) / sd_size, (h - log_sizes[m, 1]) / sd_size
            value = logs[m] - 0.5 * (dx * dx + dy * dy + wider * wider + higher * higher)
            if value > largest[n]:
                largest[n] = value
    return largest


@compiled
def choose(
    proposals: Floats, logs: Floats, expected: Floats, window: float, reach: float, penalty: float
) -> tuple[int, float]:
    """The proposal with the largest (1 - window) worth + window h, and its worth, p exp(-penalty (r s - 1)).

    r is the change of shape and s that of size against the box expected, as factors of at least 1. h is a
    raised cosine of the distance in x times one of that in y, 0 from `reach` px on.

    Args:
        proposals: (M, 4) centre boxes, px, M at least 1.
        logs: (M,) their log-probabilities log p, the largest first.
        expected: (4,) centre box.
        window: 0..1.
        reach: px.
        penalty: at least 0.
    """
    context, shape = _context(expected[2], expected[3]), expected[2] / expected[3]
    index, largest, score = 0, -np.inf, 0.0
    for m in range(len(logs)):
        probability = np.exp(logs[m])
        if (1.0 - window) * probability + window <= largest:  # nor can any of those that follow
            break
        x = min(abs(proposals[m, 0] - expected[0]) / reach, 1.0)
        y = min(abs(proposals[m, 1] - expected[1]) / reach, 1.0)
        closeness = (0.5 + 0.5 * np.cos(np.pi * x)) * (0.5 + 0.5 * np.cos(np.pi * y))
        larger = _context(proposals[m, 2], proposals[m, 3]) / context
        wider = proposals[m, 2] / proposals[m, 3] / shape
        change = max(larger, 1.0 / larger) * max(wider, 1.0 / wider)
        penalised = probability * np.exp(-penalty * (change - 1.0))
        value = (1.0 - window) * penalised + window * closeness
        if value > largest:
            index, largest, score = m, value, penalised
    return index, score


@compiled
def _context(w: float, h: float) -> float:
    """Side of the square that a template shows: half the sum of the sides around the box."""
    half = 0.5 * (w + h)
    return float(np.sqrt((w + half) * (h + half)))
