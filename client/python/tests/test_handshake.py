"""Errors of failed handshakes with real servers: no trust, or encryption on one side only."""

from __future__ import annotations

import os
import socket
import ssl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import grpc
import pytest
import tritonclient.grpc as triton
import trustme
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

import gleaner
from gleaner import _handshake
from gleaner._endpoint import Endpoint
from gleaner._printable import printable
from gleaner._upload import name_to_send
from programs import Server, certificates

SECONDS = 10.0
DAY = datetime(2020, 1, 1, tzinfo=timezone.utc)


@contextmanager
def fails(*words: str) -> Iterator[None]:
    """Checks that a block fails within seconds, below its time limit of half a minute, with these words."""
    begun = time.monotonic()
    with pytest.raises(gleaner.HandshakeFailed) as caught:
        yield
    assert time.monotonic() - begun < SECONDS
    for word in words:
        assert word in str(caught.value)


def encrypting(data: Path, cert: Path, key: Path, *flags: str) -> Server:
    return Server(data, "--workers", "0", "--tls-cert", str(cert), "--tls-key", str(key), *flags)


@pytest.fixture(scope="module")
def tls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of certificates as `gleaner-server tls` makes them."""
    data = tmp_path_factory.mktemp("certificates")
    certificates(data, "init")
    certificates(data, "client", "arm1")
    return data / "tls"


@pytest.fixture(scope="module")
def encrypted(tls: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    server = encrypting(tmp_path_factory.mktemp("encrypted"), tls / "server.pem", tls / "server.key")
    yield server
    server.stop()


@pytest.fixture(scope="module")
def demanding(tls: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A server that requires a client certificate."""
    data = tmp_path_factory.mktemp("demanding")
    server = encrypting(data, tls / "server.pem", tls / "server.key", "--client-ca", str(tls / "ca.pem"))
    yield server
    server.stop()


def write(folder: Path, issued: trustme.LeafCert) -> tuple[Path, Path]:
    cert, key = folder / "server.pem", folder / "server.key"
    cert.write_bytes(b"".join(pem.bytes() for pem in issued.cert_chain_pems))
    issued.private_key_pem.write_to_path(key)
    return cert, key


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_grpcio_and_tritonclient_accept_the_certificates_of_tls_init(encrypted: Server, tls: Path, host: str) -> None:
    target = f"{host}:{encrypted.address.rpartition(':')[2]}"
    with gleaner.connect(f"https://{target}", ca=tls / "ca.pem") as client:
        assert client.tasks.list() == []
    credentials = grpc.ssl_channel_credentials((tls / "ca.pem").read_bytes())
    with grpc.secure_channel(target, credentials) as channel:
        grpc.channel_ready_future(channel).result(timeout=SECONDS)
    infer = triton.InferenceServerClient(target, ssl=True, root_certificates=str(tls / "ca.pem"))
    assert infer.is_server_live()
    infer.close()


def test_strict_verifier_accepts_the_certificates(encrypted: Server, tls: Path) -> None:
    context = ssl.create_default_context(cafile=tls / "ca.pem")
    context.verify_flags |= ssl.VERIFY_X509_STRICT
    context.set_alpn_protocols(["h2"])
    port = int(encrypted.address.rpartition(":")[2])
    plain = socket.create_connection(("127.0.0.1", port))
    with plain, context.wrap_socket(plain, server_hostname="localhost") as line:
        assert line.selected_alpn_protocol() == "h2"


def test_untrusted_authority_is_named(encrypted: Server, tmp_path: Path) -> None:
    stranger = tmp_path / "stranger.pem"
    trustme.CA().cert_pem.write_to_path(stranger)
    with fails("not trusted", str(stranger), "`ca`"):
        gleaner.connect(encrypted.address, ca=stranger)
    with fails("not trusted", "no public authority", "ca.pem"):
        gleaner.connect(encrypted.address)
    nothing = tmp_path / "nothing.pem"
    nothing.write_text("nothing")
    with fails("nothing.pem", "PEM"):
        gleaner.connect(encrypted.address, ca=nothing)


def test_certificate_for_another_name_is_named(tmp_path: Path) -> None:
    authority = trustme.CA()
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    server = encrypting(tmp_path / "data", *write(tmp_path, authority.issue_cert("lab7.example", "10.0.0.7")))
    try:
        port = server.address.rpartition(":")[2]
        for host in ("127.0.0.1", "localhost"):
            with fails("another name", f"tls renew --name {host}"):
                gleaner.connect(f"https://{host}:{port}", ca=tmp_path / "ca.pem")
    finally:
        server.stop()


def test_certificate_outside_its_validity_is_named(tmp_path: Path) -> None:
    authority = trustme.CA()
    authority.cert_pem.write_to_path(tmp_path / "ca.pem")
    later = DAY.replace(year=2037)
    for begins, ends, words in (
        (None, DAY, ("has expired", "tls renew")),
        (later, later.replace(month=6), ("not valid yet", "clocks")),
    ):
        issued = authority.issue_cert("127.0.0.1", not_before=begins, not_after=ends)
        server = encrypting(tmp_path / "data", *write(tmp_path, issued))
        try:
            with fails(*words):
                gleaner.connect(server.address, ca=tmp_path / "ca.pem")
        finally:
            server.stop()


def test_encrypted_and_unencrypted_servers_are_distinguished(running: Server, encrypted: Server, tls: Path) -> None:
    with fails("does not encrypt", "http://"):
        gleaner.connect(running.address.replace("http://", "https://"), ca=tls / "ca.pem")
    with fails("the server encrypts", "https://", "`ca`"):
        gleaner.connect(encrypted.address.replace("https://", "http://"))


def test_missing_or_untrusted_client_certificate_is_named(demanding: Server, tls: Path, tmp_path: Path) -> None:
    ca, cert, key = tls / "ca.pem", tls / "client-arm1.pem", tls / "client-arm1.key"
    with gleaner.connect(demanding.address, ca=ca, cert=cert, key=key) as client:
        assert client.tasks.list() == []
    with fails("`cert` and `key`", "tls client"):
        gleaner.connect(demanding.address, ca=ca)
    with fails("does not accept", "--client-ca"):
        own, private = write(tmp_path, trustme.CA().issue_cert("arm1"))
        gleaner.connect(demanding.address, ca=ca, cert=own, key=private)
    with fails("cert, key"):
        gleaner.connect(demanding.address, ca=ca, cert=cert, key=tls / "server.key")


def test_address_of_the_pages_is_named(tls: Path, tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    for flags, scheme in (
        ((), "http"),
        (("--tls-cert", str(tls / "server.pem"), "--tls-key", str(tls / "server.key")), "https"),
    ):
        server = Server(tmp_path / scheme, "--workers", "0", "--web-listen", f"127.0.0.1:{port}", *flags)
        try:
            ca: dict[str, Any] = {"ca": tls / "ca.pem"} if flags else {}
            with fails("pages", "--listen"):
                gleaner.connect(f"{scheme}://127.0.0.1:{port}", **ca)
        finally:
            server.stop()


def test_calls_of_a_connected_client_have_a_time_limit(tls: Path, tmp_path: Path) -> None:
    """The server restarts with a certificate that the client does not trust."""
    server = encrypting(tmp_path / "data", tls / "server.pem", tls / "server.key")
    try:
        with gleaner.connect(server.address, ca=tls / "ca.pem") as client:
            assert client.tasks.list() == []
            server.stop()
            cert, key = write(tmp_path, trustme.CA().issue_cert("127.0.0.1"))
            server.flags = ("--workers", "0", "--tls-cert", str(cert), "--tls-key", str(key))
            server.start()
            with fails("not trusted"):
                client.tasks.list()
            with fails("not trusted"):
                client.episodes.label("ep_1", "success")
            with fails("not trusted"):
                list(client.jobs.watch("job_1"))
            with fails("not trusted"):
                gleaner.Policy(client, "arm@prod")
    finally:
        server.stop()


def test_ed25519_certificate_is_named(tmp_path: Path) -> None:
    """Python's own TLS accepts it, grpc does not."""
    pem = tmp_path / "lab.pem"
    key = tmp_path / "lab.key"
    ed25519(pem, key)
    server = encrypting(tmp_path / "data", pem, key)
    try:
        with fails("Ed25519", "tls init"):
            gleaner.connect(server.address, ca=pem)
    finally:
        server.stop()


def ed25519(pem: Path, key: Path) -> None:
    """A certificate that signs itself, as the recipe for openssl was."""
    private = Ed25519PrivateKey.generate()
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "lab")])
    address = x509.IPAddress(ip_address("127.0.0.1"))
    cert = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(private.public_key())
        .serial_number(7)
        .not_valid_before(DAY)
        .not_valid_after(DAY.replace(year=2037))
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([address]), critical=False)
        .sign(private, None)
    )
    pem.write_bytes(cert.public_bytes(serialization.Encoding.PEM))
    key.write_bytes(
        private.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
    )


def test_unreachable_server_is_not_a_failed_handshake() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    for scheme in ("http", "https"):
        assert _handshake.problem(Endpoint(f"{scheme}://127.0.0.1:{port}"), 1.0) is None
        with pytest.raises(gleaner.Unavailable, match="gleaner-server serve") as raised:
            gleaner.connect(f"{scheme}://127.0.0.1:{port}", timeout=0.3)
        assert not isinstance(raised.value, gleaner.HandshakeFailed)


def test_messages_of_a_server_are_escaped(running: Server) -> None:
    hostile = "\x1b[2J\u202e"
    with gleaner.connect(running.address) as client, pytest.raises(gleaner.NotFound) as raised:
        client.tasks.get(hostile)
    assert hostile not in str(raised.value)
    assert "\\u{202e}" in str(raised.value)
    assert printable("Größe 抓取\n\t🤖") == "Größe 抓取\n\t🤖"


def test_fifo_is_rejected_and_names_are_sent_escaped(running: Server, tmp_path: Path) -> None:
    fifo = tmp_path / "fifo.mcap"
    os.mkfifo(fifo)
    with gleaner.connect(running.address) as client:
        with pytest.raises(gleaner.InvalidArgument, match="not a regular file"):
            client.episodes.push(fifo, task="arm", outcome="success")
        with pytest.raises(gleaner.InvalidArgument, match="not a regular file"):
            client.score_recording("run_1", fifo)
    assert name_to_send(Path("a/\x1b[2J\u202e抓.mcap")) == "\\u{1b}[2J\\u{202e}抓.mcap"
    assert len(name_to_send(Path("\x1b" * 200)).encode()) <= 255
