"""Graphs as text: reading with positions, writing, editing, explaining, formulas."""
