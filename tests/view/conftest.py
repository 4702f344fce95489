"""Metrics and checked nets made by hand."""

import pytest

from bayesnet_track.graph.checked import CheckedTarget
from bayesnet_track.graph.spec import InferenceNode, Target
from bayesnet_track.journal.metrics import FrameMetrics


@pytest.fixture
def metrics():
    return FrameMetrics(
        frame=29,
        time_s=1.16,
        target="1",
        centre_box=(154.0, 110.0, 41.0, 31.0),
        map=(154.0, 110.0, 41.0, 31.0),
        sd=(3.1, 2.9, 0.4, 0.4),
        ud_px2=212.4,
        ud_nodes={"square": 212.4},
        quiet_px2=94.0,
        status="tracking",
        score=0.62,
        log_evidence=-3.21,
        surprise=0.83,
        ess=212.0,
        particles=500,
        active=("color_histogram", "motion"),
        kl={},
        contribution={},
        agent_ud_px2={},
        strength={},
        learn_rate=0.0,
        region50=(0.0, 1.0, 0.0, 1.0),
        region90=(0.0, 1.0, 0.0, 1.0),
        cloud=((150, 108, 41, 31), (158, 113, 41, 31)),
    )


@pytest.fixture(scope="session")
def checked():
    """Nodes as in a graph file -> a plate with its tree resolved."""

    def resolve(nodes: dict, name: str = "square") -> CheckedTarget:
        spec = Target(nodes=nodes)
        parent = {node: value.parent for node, value in spec.nodes.items()}
        children = {
            node: tuple(child for child in parent if parent[child] == node)
            for node, value in spec.nodes.items()
            if isinstance(value, InferenceNode)
        }
        order, ahead = [], [node for node, above in parent.items() if above is None]
        root = ahead[0]
        while ahead:
            order.append(ahead.pop(0))
            ahead = list(children.get(order[-1], ())) + ahead
        return CheckedTarget(name, spec, root, tuple(order), parent, children, {}, {})

    return resolve


@pytest.fixture(scope="session")
def color_fusion(checked):
    return checked(
        {
            "square": {"fuse": "product", "motion": {"random_walk": {"sd_px": {"x": 20}}}},
            "color": {"parent": "square", "fuse": "pool"},
            "histogram": {"parent": "color", "agent": "color_histogram"},
            "blobs": {"parent": "color", "agent": "color_blobs"},
            "flow": {"parent": "square", "agent": "motion"},
            "intensity": {"parent": "square", "agent": "intensity"},
        }
    )
