"""
Lost, and found again
=====================

A ball flies behind a pillar. A Kalman filter, fed by mean shift, predicts; its uncertainty grows;
the tracker says that the ball is lost — and takes it up where it comes out.
"""

# %%

import matplotlib.pyplot as plt
import numpy as np

from bayesnet_track import Start, track
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

scene = make_scene("flying_ball", seed=0)
results = list(track("kalman_ball", SceneSource(scene, "flying_ball"), [Start(scene.start_box)]))
targets = [result.targets[0] for result in results]
for result in results:
    for decision in result.decisions:
        print(f"frame {result.frame.index}: {decision}"[:110])

# %%
# The circle is as wide as one standard deviation of the centre. Red while the status is ``lost``.

figure, axes = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
axes[0].imshow(scene.frames[20][:, :, ::-1], alpha=0.6)
for target in targets[::2]:
    x, y = target.cxcywh[:2]
    color = "tab:red" if target.status == "lost" else "tab:blue"
    axes[0].add_patch(plt.Circle((x, y), float(np.hypot(*target.sd[:2])), fill=False, color=color))
axes[0].set_axis_off()
axes[1].plot([np.hypot(*target.sd[:2]) for target in targets])
lost = [target.status == "lost" for target in targets]
axes[1].fill_between(range(len(lost)), 0, 30, where=lost, color="tab:red", alpha=0.2)
axes[1].set(xlabel="frame", ylabel="sd of the centre, px", title="red: lost")
plt.show()
