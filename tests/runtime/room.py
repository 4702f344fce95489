"""A room of two cameras whose frames are drawn: one person in red, and detections of them."""

from __future__ import annotations

import json

import numpy as np

from bayesnet_track.numerics.boxes import shares_inside
from tests.engine.test_several_cameras import CAMERAS, boxes_of, write_graph

RATES = {"south": 20, "east": 10}
WALK = ((-1.0, 9.0), (0.8, 0.5))
RED = (30, 30, 200)


def place_at(time_s, walk=WALK):
    return np.array(walk[0]) + time_s * np.array(walk[1])


def image_of(camera, place):
    """The image of a camera with the person's box in red before a gray wall with blotches."""
    import cv2

    width, height = CAMERAS[camera].size
    rng = np.random.default_rng(7)
    wall = rng.integers(90, 160, (height // 16, width // 16, 1), np.uint8)
    image = cv2.resize(np.repeat(wall, 3, axis=2), (width, height), interpolation=cv2.INTER_NEAREST)
    x, y, w, h = boxes_of(camera, place)[0]
    left, top = round(x - w / 2 + 0.5), round(y - h / 2 + 0.5)
    image[max(top, 0) : max(round(y + h / 2 + 0.5), 0), max(left, 0) : max(round(x + w / 2 + 0.5), 0)] = RED
    return image


def write_room(folder, count=30, agents=("color",), detected_until=None, walk=WALK, changes=None):
    """Graph, videos and detections of `count` steps; those of `east` end after `detected_until` seconds."""
    import cv2

    for camera, rate in RATES.items():
        size = CAMERAS[camera].size
        # Every frame by itself and without loss.
        writer = cv2.VideoWriter(str(folder / f"{camera}.avi"), cv2.VideoWriter.fourcc(*"FFV1"), rate, size)
        lines = []
        for frame in range(-(-count * rate // 20)):
            writer.write(image_of(camera, place_at(frame / rate, walk)))
            box = boxes_of(camera, place_at(frame / rate, walk))
            is_late = camera == "east" and detected_until is not None and frame / rate > detected_until
            if not is_late and shares_inside(box, *size)[0] >= 0.5:
                x, y, w, h = box[0]
                lines.append(f"{frame + 1},-1,{x - (w - 1) / 2},{y - (h - 1) / 2},{w},{h},0.9,-1,-1,-1")
        writer.release()
        (folder / f"{camera}.txt").write_text("\n".join(lines) + "\n")
    path = write_graph(folder)
    graph = json.loads(path.read_text())
    person = graph["targets"]["person"]
    for agent in agents:
        person["nodes"][agent] = {"parent": "view", "agent": {"color": "color_histogram"}.get(agent, agent)}
    person["nodes"]["view"]["fuse"] = "product"
    person["nodes"]["person"]["learn"] = {"below": {"ud_box": 0.5}, "rate_max": 0.1}
    for name, change in (changes or {}).items():
        person["nodes"][name] |= change
    path.write_text(json.dumps(graph))
    return path


def sources_in(folder):
    return {camera: str(folder / f"{camera}.avi") for camera in RATES}


def detections_in(folder):
    return {camera: str(folder / f"{camera}.txt") for camera in RATES}
