"""The questions of `init`, one at a time, in a terminal."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from bayesnet_track.cli.starter.task import APART, BELIEF, BUDGET, FOLLOW, HARD, SPEED

Ask = Callable[[str], str]
Say = Callable[[str], object]

NOTHING = "nothing"
"""What an empty answer is called, and may be answered, where several are asked for."""

QUESTIONS: tuple[tuple[str, str, Mapping[str, str], bool, str], ...] = (
    ("follow", "What do you want to follow?", FOLLOW, False, "box"),
    (
        "apart",
        "What sets it apart from its surroundings? (several, with commas)",
        APART,
        True,
        "color,edges",
    ),
    ("hard", "What makes it hard? (several, or nothing)", HARD, True, ""),
    ("speed", "How far does it move from one frame to the next?", SPEED, False, "usual"),
    ("belief", "How shall the belief be held?", BELIEF, False, "particles"),
    ("budget", "How much time is there?", BUDGET, False, "usual"),
)
"""Name of the answer, question, what may be answered, whether several may, the answer to an empty line."""


def chosen(text: str, choices: Mapping[str, str], several: bool) -> tuple[str, ...]:
    """The words or numbers of an answer, in the order of the choices.

    Raises:
        ValueError: one that is not offered, or several where one is asked for.
    """
    names = list(choices)
    found = set()
    if several and text.strip() == NOTHING:
        return ()
    for word in text.replace(",", " ").split():
        name = names[int(word) - 1] if word.isdecimal() and 0 < int(word) <= len(names) else word
        if name not in choices:
            raise ValueError(f"{word!r} is not one of {', '.join(names)}")
        found.add(name)
    if not several and len(found) != 1:
        raise ValueError(f"one of {', '.join(names)} is needed")
    return tuple(name for name in names if name in found)


def ask_all(given: Mapping[str, str], ask: Ask, say: Say) -> dict[str, str]:
    """The answers, as flags have them: those given; the others are asked for until they make sense."""
    answers = dict(given)
    for name, question, choices, several, default in QUESTIONS:
        if name in answers:
            continue
        say(question)
        for number, (word, meaning) in enumerate(choices.items(), 1):
            say(f"  {number} {word:12} {meaning}")
        while True:
            text = ask(f"[{default or NOTHING}] ").strip() or default
            try:
                answers[name] = ",".join(chosen(text, choices, several))
                break
            except ValueError as error:
                say(f"  {error}")
    return answers
