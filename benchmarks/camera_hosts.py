"""Bytes between the engine and the hosts of cameras, and the engine's share of a frame.

Two drawn cameras, people in colours of their own who walk through both images, and `color_histogram`
below each view: `python benchmarks/camera_hosts.py --people 1 4`.
"""

from __future__ import annotations

import argparse
import json
import pickle
import socket
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bayesnet_track import track
from bayesnet_track.numerics.cameras import Camera
from bayesnet_track.runtime.executors import make_executor, messages, workers

SIZE, FPS = (1280, 720), 25.0
AGENTS = {"color": "color_histogram", "texture": "texture"}


def camera_at(x: float, y: float, azimuth: float) -> Camera:
    """A camera 6 m above (x, y) that looks 30 degrees down, along y turned to the left by `azimuth`."""
    down, along, turn = 0.5, np.sqrt(0.75), np.radians(azimuth)
    ahead = np.array([-np.sin(turn) * along, np.cos(turn) * along, -down])
    right = np.array([np.cos(turn), np.sin(turn), 0.0])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    matrix = np.array([[1600.0, 0.0, SIZE[0] / 2], [0.0, 1600.0, SIZE[1] / 2], [0.0, 0.0, 1.0]])
    return Camera(matrix, np.zeros(0), rotation, -rotation @ np.array([x, y, 6.0]), SIZE)


CAMERAS = {"south": camera_at(0.0, 0.0, 0.0), "east": camera_at(10.0, 10.0, 90.0)}


def write_room(folder: Path, people: int, frames: int, agents: tuple[str, ...]) -> Path:
    """The graph, two videos without loss, and files of detections."""
    import cv2

    rng = np.random.default_rng(0)
    starts = np.column_stack([rng.uniform(-1.5, 1.5, people), 8.0 + 4.0 * np.arange(people) / people])
    speeds = rng.uniform(-0.4, 0.4, (people, 2))
    colours = rng.integers(20, 240, (people, 3)).tolist()
    wall = rng.integers(90, 160, (SIZE[1] // 16, SIZE[0] // 16, 1), np.uint8).repeat(3, axis=2)
    for name, camera in CAMERAS.items():
        calibration = {
            "camera_matrix": camera.matrix.tolist(),
            "rotation": camera.rotation.tolist(),
            "translation": camera.translation.tolist(),
            "size": SIZE,
        }
        (folder / f"{name}.json").write_text(json.dumps(calibration))
        path, codec = str(folder / f"{name}.avi"), cv2.VideoWriter.fourcc(*"FFV1")
        writer, lines = cv2.VideoWriter(path, codec, FPS, SIZE), []
        for frame in range(frames):
            places = starts + speeds * frame / FPS
            boxes = camera.boxes(np.column_stack([places, np.tile([0.6, 1.7], (people, 1))]))
            image = cv2.resize(wall, SIZE, interpolation=cv2.INTER_NEAREST)
            for (x, y, w, h), colour in zip(boxes.tolist(), colours, strict=True):
                corners = (round(x - w / 2), round(y - h / 2)), (round(x + w / 2), round(y + h / 2))
                cv2.rectangle(image, *corners, colour, -1)
                lines.append(f"{frame + 1},-1,{x - (w - 1) / 2},{y - (h - 1) / 2},{w},{h},0.9,-1,-1,-1")
            writer.write(image)
        writer.release()
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    person = {
        "belief": {"gaussian": {"filter": "extended", "likelihood": "sigma_points", "gate": 1}},
        "motion": {"constant_velocity": {"sd_velocity": 0.5, "sd": {"w": 0.02, "h": 0.02}}},
        "fuse": "product",
        "learn": {"below": {"ud_box": 0.5}, "rate_max": 0.1},
    }
    nodes = {
        "person": person,
        "view": {"parent": "person", "camera": [*CAMERAS], "fuse": "product"},
        "seen": {"parent": "view", "agent": {"detection": {"sd_place": 0.03, "sd_size": 0.03}}},
        **{agent: {"parent": "view", "agent": AGENTS[agent]} for agent in agents},
    }
    sizes = {"width": {"mean": 0.6, "sd": 0.1}, "height": {"mean": 1.7, "sd": 0.1}}
    target = {
        "state": {"ground": sizes},
        "associate": "assignment",
        "existence": {"detection": 0.95, "clutter": 0.01, "births": 0.05},
        "birth": {"detector": "detections"},
        "nodes": nodes,
    }
    cameras = {name: {"calibration": f"{name}.json"} for name in CAMERAS}
    graph = folder / "room.yaml"
    graph.write_text(
        json.dumps({"bayesnet": 1, "name": "room", "cameras": cameras, "targets": {"person": target}})
    )
    return graph


class Counted:
    """Bytes through the engine's ends of its channels."""

    def __init__(self) -> None:
        self.bytes, self.references, self.is_on = 0, 0, False
        send, receive = messages.send, messages.receive

        def counted_send(channel: socket.socket, message: object) -> None:
            self.count(message, getattr(message, "arguments", ()))
            send(channel, message)

        def counted_receive(channel: socket.socket) -> object:
            message = receive(channel)
            self.count(message, (getattr(message, "value", None),))
            return message

        workers.send, workers.receive = counted_send, counted_receive

    def count(self, message: object, values: Sequence[object]) -> None:
        """Count a message by packing it again; which takes time, and is therefore not done in timed runs."""
        if self.is_on:
            self.bytes += messages.HEAD.size + len(pickle.dumps(message, protocol=5))
            self.references += sum(map(size_of, values))


def size_of(value: object) -> int:
    """Bytes of the arrays of a reference that are sent."""
    if not isinstance(value, messages.EncodedReference):
        return 0
    return sum(np.asarray(array).nbytes for _, array in value.arrays.values() if array is not None)


def measure(folder: Path, graph: Path, hosts: str, counted: Counted, skip: int) -> tuple[float, float, float]:
    """Of a camera's frame: the engine's CPU ms, bytes, and those of references; without the first `skip`."""
    files = {kind: {name: str(folder / f"{name}.{kind}") for name in CAMERAS} for kind in ("avi", "txt")}
    executor = make_executor(hosts=hosts)  # type: ignore[arg-type]
    steps = track(graph, files["avi"], detections=files["txt"], executor=executor)
    began, frames, start = 0.0, 0, (0, 0)
    for result in steps:
        if result.frame.index == skip:
            began, start = time.thread_time(), (counted.bytes, counted.references)
        frames += result.frame.index > skip
        spent, end = time.thread_time() - began, (counted.bytes, counted.references)
    views = frames * len(CAMERAS)
    return 1e3 * spent / views, (end[0] - start[0]) / views, (end[1] - start[1]) / views


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--people", type=int, nargs="+", default=[1, 4])
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--agents", nargs="+", default=["color"], choices=AGENTS)
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    counted = Counted()
    print("people  hosts    engine ms  bytes  of references  (per camera and frame)")
    for people in options.people:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            graph = write_room(folder, people, options.frames, tuple(options.agents))
            counted.is_on = True
            _, sent, learnt = measure(folder, graph, "process", counted, options.frames // 4)
            print(f"{people:6d}  {'process':8s}           {sent:6.0f} {learnt:14.0f}", flush=True)
            counted.is_on = False
            for _ in range(options.repeat):
                for hosts in ("engine", "process"):
                    spent = measure(folder, graph, hosts, counted, options.frames // 4)[0]
                    print(f"{people:6d}  {hosts:8s} {spent:9.2f}", flush=True)


if __name__ == "__main__":
    main()
