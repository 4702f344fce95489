"""Synthetic videos with exact ground truth: deterministic, rendered lazily, without a download.

>>> from bayesnet_track.sources.scenes import make_scene
>>> scene = make_scene("two_squares", seed=0)
>>> scene.start_box, len(scene.frames)
((250.5, 170.5, 40.0, 40.0), 200)
>>> scene.frames[29].shape
(240, 320, 3)
"""

from bayesnet_track.sources.scenes.library import make_scene, scene_names
from bayesnet_track.sources.scenes.scene import Scene
from bayesnet_track.sources.scenes.shapes import TwoSquares, random_geometry, two_squares

__all__ = ["Scene", "TwoSquares", "make_scene", "random_geometry", "scene_names", "two_squares"]
