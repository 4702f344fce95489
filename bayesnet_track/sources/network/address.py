"""Addresses as they may be shown: without what lets somebody in."""

from __future__ import annotations

import re

HIDDEN = "***"

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.\-]*://")
_ADDRESS = re.compile(rf"{_SCHEME.pattern}[^\s'\"<>]+")
_HOST_AND_PORT = re.compile(r"(\[[^\]]*\]|[^:\[\]]*)(:\d+)?")
_SECRET = re.compile(
    r"([?&;][^=&;#\s]*(?:pass|pwd|token|secret|key|auth|sig|cred|login|user|usr|session)[^=&;#\s]*=)[^&;#\s]*",
    re.IGNORECASE,
)


def hide_secrets(text: str) -> str:
    """A text with user, password and tokens of every address in it replaced by three stars.

    >>> hide_secrets("no route to rtsp://admin:secret@10.0.0.7:554/live")
    'no route to rtsp://***@10.0.0.7:554/live'
    """
    return _ADDRESS.sub(lambda found: shown_address(found.group()), text) if "://" in text else text


def shown_address(text: str) -> str:
    """The same for a text that is one address, whatever its password holds; a path stays as it is.

    >>> shown_address("rtsp://admin:let me/in@now@10.0.0.7:554/live")
    'rtsp://***@10.0.0.7:554/live'
    >>> shown_address("http://cam/video.cgi?user=me&pwd=x&fps=5")
    'http://cam/video.cgi?user=***&pwd=***&fps=5'
    >>> shown_address("http://cam:8080/two@2x.mp4")
    'http://cam:8080/two@2x.mp4'
    """
    scheme = _SCHEME.match(text)
    if scheme is None:
        return text
    rest = text[scheme.end() :]
    authority = re.split(r"[/?#]", rest, maxsplit=1)[0]
    # What is no host with a port begins with a user, whose password may hold the letters that end it.
    if _HOST_AND_PORT.fullmatch(authority) is None or "@" in authority:
        rest = f"{HIDDEN}@{rest[rest.rfind('@') + 1 :]}" if "@" in rest else HIDDEN
    return scheme.group() + _SECRET.sub(rf"\1{HIDDEN}", rest)
