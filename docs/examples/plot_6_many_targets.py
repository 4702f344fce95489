"""
Targets that nobody points at
=============================

Two detectors find an orange and a gray square; each becomes a target with a net of its own. When
one is hidden its net calls for help, and a detection gives it back with its identity.
"""

# %%

from itertools import groupby

import matplotlib.pyplot as plt

from bayesnet_track import track
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

scene = make_scene("orange_and_gray", seed=0)
results = list(track("orange_and_gray_detected", SceneSource(scene, "orange_and_gray")))
rows = [(target.target, target) for result in results for target in result.targets]

# %%
# Each line is a target; each colour an agent that is switched on.

agents = ["color", "intensity", "motion"]
figure, axes = plt.subplots(1, 2, figsize=(11, 2.8), width_ratios=[1, 2.4], layout="constrained")
axes[0].imshow(scene.frames[50][:, :, ::-1])
for target in results[50].targets:
    x, y, w, h = target.xywh
    axes[0].add_patch(plt.Rectangle((x, y), w, h, fill=False, color="white", linewidth=2))
    axes[0].text(x + w / 2, y - 4, target.target, color="white", ha="center")
axes[0].set_axis_off()
for row, (name, _) in enumerate(groupby(sorted(rows, key=lambda pair: pair[0]), key=lambda pair: pair[0])):
    for place, agent in enumerate(agents):
        on = [
            result.frame.index
            for result in results
            for target in result.targets
            if target.target == name and agent in target.active
        ]
        axes[1].plot(on, [row + 0.2 * place] * len(on), "s", color=f"C{place}", markersize=4)
axes[1].set(xlabel="frame", ylabel="target", yticks=[0.2, 1.2], yticklabels=["1", "2"])
axes[1].legend(agents, loc="center right", markerscale=2)
plt.show()
