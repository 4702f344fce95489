"""
What a cue sees
===============

The likelihood of a cue at every place of a picture: where it is high the cue takes a box for the
target. Look at it before you choose the cues of a graph.
"""

# %%
# A cue learns a reference from the first box, and scores hypotheses: boxes, as many at once as you
# like. Here they stand on a lattice, all of the target's size, in a later frame.

import matplotlib.pyplot as plt
import numpy as np

from bayesnet_track.numerics.boxes import centre_from_corner
from bayesnet_track.observation.cue import Hypotheses, installed_cues
from bayesnet_track.observation.planes import Frame, FramePair, PlaneCache, Region
from bayesnet_track.sources.scenes import make_scene

scene = make_scene("orange_and_gray", seed=0)
everywhere = Region(0, 0, scene.width, scene.height)
pictures = [Frame(n, float(n), scene.frames[n]) for n in (0, 1, 30, 31)]
first, later = FramePair(pictures[1], pictures[0]), FramePair(pictures[3], pictures[2])
start = centre_from_corner(scene.truth[1:2])[0]

step = 6
xs, ys = np.arange(0, scene.width, step), np.arange(0, scene.height, step)
centres = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
boxes = np.concatenate([centres, np.tile(start[2:], (len(centres), 1))], axis=1).astype(float)

# %%
# Four cues on the orange square. The colours are sure of the place; the pattern finds it too, but
# also finds gray places not unlike it; motion sees only that something moves here, and is coarse.

names = ["color_histogram", "foreground_color", "intensity", "motion"]
figure, axes = plt.subplots(1, 5, figsize=(12, 2.4), layout="constrained")
axes[0].imshow(pictures[3].image[:, :, ::-1])
axes[0].set_title("frame 31", fontsize=9)
for axis, name in zip(axes[1:], names, strict=True):
    declaration = installed_cues()[name]
    cue = declaration.make(declaration.parameters())
    before, now = (PlaneCache(pair).planes(cue.needs, everywhere) for pair in (first, later))
    seen = cue.log_likelihood(now, Hypotheses(boxes), cue.learn(before, start))
    axis.imshow(
        np.exp(seen).reshape(len(ys), len(xs)), cmap="magma", vmin=0, extent=(0, scene.width, scene.height, 0)
    )
    axis.set_title(name, fontsize=9)
for axis in axes:
    axis.set_axis_off()
plt.show()
