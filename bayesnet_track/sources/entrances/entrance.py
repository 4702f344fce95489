"""One row of the table of entrances."""

from __future__ import annotations

from dataclasses import dataclass

PACKAGE = "bayesnet_track"


@dataclass(frozen=True)
class Entrance:
    """One kind of data from outside.

    Attributes:
        name: what it is.
        reached: the commands, options and calls by which it is given.
        reads: the functions that read it, as "module: names", below the package.
        says: what a notice says, in words, where something of it is not used.
        refuses: what is refused.
        confused: which two readings could be confused, and what decides.
    """

    name: str
    reached: str
    reads: tuple[str, ...]
    says: str
    refuses: str
    confused: str

    @property
    def readers(self) -> tuple[str, ...]:
        """The functions as dotted paths."""
        parts = (text.split(": ") for text in self.reads)
        return tuple(f"{PACKAGE}.{module}.{name}" for module, names in parts for name in names.split())
