"""Lines of numbers, as programs and spreadsheets write them: encodings, separators, quotes, header lines."""

from __future__ import annotations

import codecs
import csv
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

from bayesnet_track.sources.entrances.foreign import name_bytes, refuse_foreign

BOMS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
SHOWN = 40

Line = tuple[int, list[str]]
"""The number of a line, from 1, and its words."""


class NotTextError(ValueError):
    """A file that is not text; says which."""


@dataclass(frozen=True, eq=False)
class Lines:
    """A text as lines of words.

    Attributes:
        name: of the file, for messages.
        header: the names in the first line, None where it holds a number; with the line's number.
        text: the lines that follow.
        first: the number of the first of them.
    """

    name: str
    header: Line | None
    text: list[str]
    first: int

    @property
    def is_plain(self) -> bool:
        """Whether nothing here is a number for `float` alone, such as 1_0 or digits of other scripts."""
        return all(line.isascii() and "_" not in line for line in self.text)

    def __iter__(self) -> Iterator[Line]:
        """Each line that holds something."""
        for number, line in enumerate(self.text, start=self.first):
            words = split_words(line)
            if words:
                yield number, words


def read_text(path: str | Path) -> str:
    """A whole file as text: UTF-8, or UTF-16 with a byte order mark.

    Raises:
        OSError: it cannot be read.
        NotTextError: it is not text.
    """
    data = Path(path).read_bytes()
    encoding = next((name for mark, name in BOMS.items() if data.startswith(mark)), "utf-8")
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        raise NotTextError(f"{path}: not a text file{name_bytes(data)}") from None
    if "\0" in text:
        raise NotTextError(f"{path}: not a text file{name_bytes(data)}")
    return text


def split_lines(text: str, name: str) -> Lines:
    """The lines of a text, whatever ends them; a first line without any number is a header.

    Raises ValueError for a text that is known to be of another format.

    >>> split_lines("frame;id\\r\\n1;7", "a.csv").header
    (1, ['frame', 'id'])
    """
    refuse_foreign(text, name)
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    for number, line in enumerate(lines, start=1):
        words = split_words(line.lstrip("#") if line.startswith("#") else line)
        if words:
            if all(map(_is_name, words)):
                return Lines(name, (number, words), lines[number:], number + 1)
            break
    return Lines(name, None, lines, 1)


def split_words(line: str) -> list[str]:
    """The words of a line, separated by semicolons, or else commas, or else tabs or spaces.

    Empty words at the end are left out, as spreadsheets fill up short lines.

    >>> split_words('1;"2";3;;')
    ['1', '2', '3']
    """
    separator = ";" if ";" in line else "," if "," in line else "\t" if '"' in line and "\t" in line else None
    if '"' in line and separator is not None:
        words = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    else:
        words = line.split(separator)
        if '"' in line:
            words = [word.strip('"') for word in words]
    while words and not words[-1].strip():
        words.pop()
    return words


def _is_name(word: str) -> bool:
    """Whether a word can name a column: it has a letter, or is empty, and is no number such as nan."""
    return not is_number(word) and (not word.strip() or any(map(str.isalpha, word)))


def is_number(word: str) -> bool:
    """True for what `float` reads, but for underscores and digits that are not ASCII."""
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and "_" not in word


def whole(word: str) -> int | None:
    """A whole number of 64 bits, exactly: also 7.0 and 1e3; None for anything else.

    >>> whole("9223372036854775807"), whole("7.0"), whole("7.5")
    (9223372036854775807, 7, None)
    """
    if not word.isascii() or "_" in word:
        return None
    try:
        number = int(word)
    except ValueError:
        try:
            exact = Decimal(word.strip())
        except InvalidOperation:
            return None
        if not exact.is_finite() or exact.adjusted() > SHOWN or exact != exact.to_integral_value():
            return None
        number = int(exact)
    return number if -(2**63) <= number < 2**63 else None


def explain_word(words: list[str], place: str, expected: str) -> ValueError:
    """The error of the first word that is not a number."""
    wrong = next((word.strip() for word in words if not is_number(word)), "")
    shown = f"{place}: {wrong[:SHOWN]!r}"
    parts = wrong.replace(",", " ").split()
    if "," in wrong and all(map(is_number, parts)):
        return ValueError(
            f"{shown} has a comma between other separators: a decimal comma (write "
            f"{wrong.replace(',', '.')[:SHOWN]}), or two numbers (separate all by the same sign)"
        )
    if len(parts) > 1 and all(map(is_number, parts)):
        return ValueError(
            f"{shown} is separated by a space, and the line by commas: decimal commas (write points), or "
            "separators (separate all by the same sign)"
        )
    return ValueError(f"{shown} is not a number; expected {expected}")
