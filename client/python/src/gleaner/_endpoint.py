"""The address of a server, the client's credentials, and the trusted authority."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import grpc

from gleaner.errors import invalid


@dataclass(frozen=True)
class Endpoint:
    """The arguments of `connect`. Worker processes of a data loader use a copy for their own connections."""

    address: str
    token: str | None = field(default=None, repr=False)
    timeout: float = 30.0
    ca: str | os.PathLike[str] | None = None
    cert: str | os.PathLike[str] | None = None
    key: str | os.PathLike[str] | None = None

    @property
    def encrypted(self) -> bool:
        """Whether the connection is encrypted."""
        return self.address.startswith("https://")

    @property
    def target(self) -> str:
        """Host and port."""
        target = self.address.removeprefix("https://" if self.encrypted else "http://").rstrip("/")
        host, colon, port = target.rpartition(":")
        if not (host and colon and port.isdecimal()) or "/" in target:
            raise invalid(f"address {self.address!r}", "expected host:port, such as 127.0.0.1:7400")
        return target

    @property
    def host(self) -> str:
        """The host alone, an IPv6 address without its brackets."""
        return self.target.rpartition(":")[0].removeprefix("[").removesuffix("]")

    @property
    def port(self) -> int:
        """The port."""
        return int(self.target.rpartition(":")[2])

    @property
    def metadata(self) -> tuple[tuple[str, str | bytes], ...]:
        """The metadata of every call."""
        if self.token is None:
            return ()
        token = self.token.strip()
        # The token is a secret: error messages must not contain it.
        if not token or not all("!" <= character <= "~" for character in token):
            raise invalid("token", "a token is one word of visible ASCII characters; copy it again")
        return (("authorization", f"Bearer {token}"),)

    def channel(self, options: list[tuple[str, int | str]]) -> grpc.Channel:
        """A channel that is not connected yet."""
        if (self.cert is None) != (self.key is None):
            raise invalid("cert, key", "a certificate requires its private key; give both")
        if self.encrypted:
            ca, key, cert = _read("ca", self.ca), _read("key", self.key), _read("cert", self.cert)
            return grpc.secure_channel(self.target, grpc.ssl_channel_credentials(ca, key, cert), options=options)
        if self.ca is not None or self.cert is not None:
            raise invalid(f"address {self.address}", "certificates are for encrypted connections; write https://")
        return grpc.insecure_channel(self.target, options=options)


def _read(name: str, path: str | os.PathLike[str] | None) -> bytes | None:
    if path is None:
        return None
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise invalid(name, f"cannot be read: {error}") from None
