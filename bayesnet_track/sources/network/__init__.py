"""Sources on the network: addresses without their passwords, and which of them have no end."""
