"""
A first track
=============

Open a scene, give the first box, ask for a box in each frame — as with OpenCV's trackers — and look
at how sure the tracker is.
"""

# %%
# A scene is a video with known truth. Here two squares of one colour cross each other's way.

import matplotlib.pyplot as plt

from bayesnet_track import Tracker
from bayesnet_track.sources.scenes import make_scene

scene = make_scene("two_squares", seed=0)
tracker = Tracker("two_squares")  # a graph of the library; a path, or `general` for anything
tracker.init(scene.frames[0], scene.start_box)  # top-left corner and size, px

boxes, deviations, active = [scene.start_box], [0.0], [2]
for number in range(1, len(scene.frames)):
    ok, box = tracker.update(scene.frames[number])  # ok is False while the target is lost
    boxes.append(box)
    deviations.append(tracker.metrics.ud_px2**0.5)
    active.append(len(tracker.metrics.active))

# %%
# The box is not everything: ``tracker.metrics`` says how far the hypotheses lie apart (the root of
# UD, a distance in px) and which agents worked. Where the squares meet, colour alone cannot distinguish
# them: the uncertainty jumps, and motion is called.

figure, axes = plt.subplots(1, 4, figsize=(11, 2.6), width_ratios=[1, 1, 1, 1.8], layout="constrained")
for axis, number in zip(axes, (20, 29, 60), strict=False):
    axis.imshow(scene.frames[number][:, :, ::-1])
    x, y, w, h = boxes[number]
    axis.add_patch(plt.Rectangle((x, y), w, h, fill=False, color="tab:red", linewidth=2))
    axis.set_title(f"frame {number}", fontsize=9)
    axis.set_axis_off()
axes[3].plot(deviations, color="tab:blue")
axes[3].fill_between(range(len(active)), 0, 25, where=[n > 1 for n in active], color="tab:orange", alpha=0.3)
axes[3].set(xlabel="frame", ylabel="√UD, px", title="orange: motion is on")
plt.show()
