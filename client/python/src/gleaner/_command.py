"""What the commands of this package share: the arguments of a connection, and how an error ends a command."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable

from gleaner._client import Client, connect
from gleaner.errors import GleanerError


def add_connection(parser: argparse.ArgumentParser) -> None:
    """The arguments of a connection, with the variables of the command line tool as defaults."""
    given = os.environ.get
    parser.add_argument("--server", default=given("GLEANER_SERVER", "127.0.0.1:7400"), help="address (GLEANER_SERVER)")
    parser.add_argument("--ca", default=given("GLEANER_CA"), help="file of trusted certificates (GLEANER_CA)")
    parser.epilog = "The token is read from GLEANER_TOKEN."


def connected(given: argparse.Namespace) -> Client:
    """The client of parsed arguments. A client certificate comes from the command line tool's variables."""
    read = os.environ.get
    cert, key = read("GLEANER_CLIENT_CERT"), read("GLEANER_CLIENT_KEY")
    return connect(given.server, read("GLEANER_TOKEN"), ca=given.ca, cert=cert, key=key)


def ended(run: Callable[[], int]) -> int:
    """The exit status of a command; an error of gleaner is one line."""
    try:
        return run()
    except GleanerError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
