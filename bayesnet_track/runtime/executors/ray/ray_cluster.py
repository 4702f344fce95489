"""Connect to a Ray cluster, or start one on this computer; which of its nodes an actor should begin on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bayesnet_track.runtime.executors.processes import PlacingError

MISSING = "Ray is not installed: pip install 'bayesnet-track[ray]'"


def connect(address: str | None) -> bool:
    """Connect to the cluster at `address`, or start one here; whether it has to be shut down again.

    Raises:
        PlacingError: Ray is not installed, or there is no cluster.
    """
    try:
        import ray
    except ImportError:
        raise PlacingError(MISSING) from None
    if ray.is_initialized():
        return False
    try:
        if address is None:
            ray.init(log_to_driver=False, logging_level="error", include_dashboard=False)
        else:
            ray.init(address=address, log_to_driver=False, logging_level="error")
    except (ConnectionError, ValueError) as error:
        raise PlacingError(f"no Ray cluster at {address}: {error}") from error
    return True


def living() -> list[str]:
    """Ids of the nodes that the cluster believes to be alive, the one that asks first."""
    import ray

    here = ray.get_runtime_context().get_node_id()
    alive = sorted(node["NodeID"] for node in ray.nodes() if node["Alive"])
    return sorted(alive, key=lambda node: node != here)


def calmest(nodes: Sequence[str], lost_on: Mapping[str, int], busy: Mapping[str, int]) -> str:
    """Of `nodes`, the first of those where the fewest actors were lost and, of these, the fewest are at work.

    >>> calmest(["a", "b", "c"], {"a": 1}, {"b": 2})
    'c'
    >>> calmest(["a", "b"], {}, {"a": 1, "b": 1})
    'a'
    """
    return min(nodes, key=lambda node: (lost_on.get(node, 0), busy.get(node, 0)))
