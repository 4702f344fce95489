"""Options of `run`, `demo` and `resume` that show the run in a browser while it goes on."""

from __future__ import annotations

import argparse


def add_view_options(parser: argparse.ArgumentParser) -> None:
    """`--view`, `--view-host`, `--view-now`, `--open`."""
    group = parser.add_argument_group("live view")
    group.add_argument(
        "--view",
        nargs="?",
        const=0,
        type=_port,
        metavar="PORT",
        help="show the run live in a browser; it begins when its page is opened, and a missing start "
        "box can be drawn there (default port: a free one)",
    )
    group.add_argument(
        "--view-host",
        default="127.0.0.1",
        metavar="HOST",
        help="address that the view listens at (default 127.0.0.1: only this machine)",
    )
    group.add_argument("--view-now", action="store_true", help="begin before the page is opened")
    group.add_argument("--open", action="store_true", help="open the page in this machine's browser")


def add_address_options(parser: argparse.ArgumentParser) -> None:
    """`--port`, `--view-host`, `--open`, of a command that always has a view."""
    group = parser.add_argument_group("page")
    group.add_argument("--port", type=_port, metavar="PORT", help="port of the page (default a free one)")
    group.add_argument(
        "--view-host",
        default="127.0.0.1",
        metavar="HOST",
        help="address that the page listens at (default 127.0.0.1: this machine alone)",
    )
    group.add_argument("--open", action="store_true", help="open the page in this machine's browser")


def _port(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 6 and 1024 <= int(text) < 65536):
        raise argparse.ArgumentTypeError(f"{text!r}: a port from 1024 to 65535 is needed")
    return int(text)
