"""The specification of a graph: immutable, validated settings."""
