"""
Finding thresholds
==================

When shall an agent be called? First measure how uncertain the belief is while all is well, with
only the agents that stay on; then set the levels between that and what trouble looks like.
"""

# %%
# Run colour alone: the graph ``two_squares`` without motion and without rules.

import matplotlib.pyplot as plt
import numpy as np

from bayesnet_track import Start, load_graph, track
from bayesnet_track.sources.scenes import make_scene
from bayesnet_track.sources.scenes.library import SceneSource

graph = {
    "name": "color_alone",
    "targets": {
        "square": {
            "nodes": {
                "square": {"motion": {"random_walk": {"sd_px": {"x": 10, "y": 10}}}, "ud_fields": ["x", "y"]},
                "color": {"parent": "square", "agent": {"color_histogram": {"floor": 0.003}}},
            }
        }
    },
}
scene = make_scene("two_squares", seed=3)
results = list(track(load_graph(graph), SceneSource(scene, "two_squares"), [Start(scene.start_box)]))
ud = np.array([result.targets[0].ud_px2 for result in results])

# %%
# The squares meet in frames 25 to 34 and 174 to 183. Before, UD has its baseline; the upper
# level goes at about one and a half times the quiet one, the lower one in between.

quiet = float(np.median(ud[5:20]))
print(f"baseline {quiet:.0f} px²: activate above {1.5 * quiet:.0f}, deactivate below {1.2 * quiet:.0f}")
figure, axis = plt.subplots(figsize=(9, 3), layout="constrained")
axis.semilogy(ud, color="tab:blue")
axis.axhline(1.5 * quiet, color="tab:red", label="activate")
axis.axhline(1.2 * quiet, color="tab:green", label="deactivate")
for meeting in ((25, 34), (174, 183)):
    axis.axvspan(*meeting, color="tab:gray", alpha=0.3)
axis.set(xlabel="frame", ylabel="UD, px²", ylim=(quiet / 4, None))
axis.legend(loc="upper left")
plt.show()
