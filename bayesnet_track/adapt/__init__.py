"""Adaptation: UD and KL, the rules that switch agents, reference updates. Pure functions to decisions."""
