"""
What a graph stands for
=======================

A graph file is a Bayes net. Draw it, print the density that it stands for, and see what reaches the
root.
"""

# %%
# The graph ``color_fusion``: two agents look at colours, and a distractor of the target's colour
# fools both. So they hang under a node of their own, which counts colour once.

import matplotlib.pyplot as plt

from bayesnet_track import load_graph
from bayesnet_track.graph.text.formula import formula_text
from bayesnet_track.view.graph_picture import graph_image

plate = load_graph("color_fusion").targets["square"]
all_on = frozenset(plate.agents)
print(formula_text(plate, all_on))

# %%
# Nodes that hold a belief are round, agents have corners; an agent that is switched off is pale. On
# the right is what is left when only two agents are active.

figure, axes = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
for axis, active in zip(axes, (all_on, frozenset({"histogram", "motion"})), strict=True):
    axis.imshow(graph_image(plate, active)[:, :, ::-1])
    axis.set_axis_off()
plt.show()
