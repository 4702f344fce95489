"""Connect to a Ray cluster, or start one on this computer."""

from __future__ import annotations

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
