"""The expression language: formulas over a target's state, read, checked, written and evaluated."""
