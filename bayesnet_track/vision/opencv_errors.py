"""What OpenCV says of an error."""


def reason_of(error: Exception) -> str:
    """OpenCV's own words, without its file and line, in at most 200 characters.

    >>> reason_of(ValueError("OpenCV(4.12.0) net.cpp:3: error: (-215) no\\n such layer"))
    '(-215) no such layer'
    """
    return " ".join(str(error).split("error: ", 1)[-1].split())[:200]
