"""Diagnosis of a failed connection: a separate attempt at the same address, with an error message and its fix.

grpcio retries a failed handshake without a limit and writes its reason to a log of its C core. The attempt here uses
Python's `ssl` with the same address, authorities and certificates, so that the reason reaches the caller.
"""

from __future__ import annotations

import socket
import ssl
from contextlib import closing, suppress

from gleaner._endpoint import Endpoint

# Seconds to wait for a rejection after the handshake.
_GRACE = 0.5
# The preface of HTTP/2 (RFC 9113, 3.4), with empty settings.
_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
# A request of HTTP/1.1, which the pages answer.
_OLDER = b"OPTIONS * HTTP/1.1\r\nHost: gleaner\r\nConnection: close\r\n\r\n"
_FRAME = 9
_SETTINGS = 4
# An Ed25519 key's identifier (1.3.101.112) as certificates encode it.
_ED25519 = bytes([6, 3, 0x2B, 0x65, 0x70])

# Of `SSLCertVerificationError.verify_code`, as OpenSSL numbers them.
_NOT_YET_VALID, _EXPIRED, _OTHER_HOST, _OTHER_ADDRESS = 9, 10, 62, 64
_UNTRUSTED = (2, 18, 19, 20, 21)


def problem(endpoint: Endpoint, timeout: float) -> str | None:
    """Why server and client cannot connect, with the fix. `None` when they can, or the server is unreachable."""
    try:
        return _encrypted(endpoint, timeout) if endpoint.encrypted else _plain(endpoint, timeout)
    except OSError:
        # Unreachable, or the connection broke: a retry may succeed.
        return None


def _encrypted(endpoint: Endpoint, timeout: float) -> str | None:
    context = _context(endpoint)
    if isinstance(context, str):
        return context
    try:
        with _connected(endpoint, timeout) as plain, context.wrap_socket(plain, server_hostname=endpoint.host) as line:
            certificate = line.getpeercert(binary_form=True) or b""
            # A server that requires a client certificate rejects only after the client's part of the handshake.
            line.settimeout(min(timeout, _GRACE))
            with suppress(TimeoutError):
                line.recv(_FRAME)
    except ssl.SSLCertVerificationError as error:
        return _distrust(endpoint, error)
    except ssl.SSLEOFError:
        return _unencrypted(endpoint, timeout)
    except ssl.SSLError as error:
        return _refusal(endpoint, error, timeout)
    if _ED25519 in certificate:
        return (
            "the server's certificate has an Ed25519 key, which grpc cannot verify; make another one there with "
            "`gleaner-server tls init`"
        )
    return None


def _context(endpoint: Endpoint) -> ssl.SSLContext | str:
    """A TLS context from the endpoint's files, or the error of an unusable file."""
    try:
        context = ssl.create_default_context(cafile=endpoint.ca)
    except ssl.SSLError:
        return f"ca: {endpoint.ca} holds no certificate in PEM form; name the authority's (ca.pem)"
    # Checks that grpc does not make cannot be the cause.
    context.verify_flags &= ~getattr(ssl, "VERIFY_X509_STRICT", 0)
    if endpoint.cert is not None and endpoint.key is not None:
        try:
            context.load_cert_chain(endpoint.cert, endpoint.key)
        except ssl.SSLError as error:
            return f"cert, key: cannot be used together: {_reason(error)}; give a certificate and its own private key"
    context.set_alpn_protocols(["h2"])
    return context


def _plain(endpoint: Endpoint, timeout: float) -> str | None:
    answer = _answer(endpoint, timeout, _PREFACE)
    if answer[:1] == b"\x15" or (not answer and _encrypts(endpoint, timeout)):
        return f"the server encrypts; write https://{endpoint.target} and name its authority with `ca`"
    if not answer and _answer(endpoint, timeout, _OLDER).startswith(b"HTTP/1"):
        return "the server there speaks HTTP/1, not gRPC; is this the address of the pages? give that of --listen"
    return None


def _distrust(endpoint: Endpoint, error: ssl.SSLCertVerificationError) -> str:
    reason = error.verify_message
    if error.verify_code in _UNTRUSTED:
        trusted = f"{endpoint.ca} has not signed it" if endpoint.ca else "no public authority has signed it"
        return (
            f"the server's certificate is not trusted ({reason}): {trusted}; name the certificate file of that "
            "authority with `ca` (ca.pem of `gleaner-server tls init`)"
        )
    if error.verify_code in (_OTHER_HOST, _OTHER_ADDRESS):
        return (
            f"the server's certificate is for another name ({reason}); connect by a name that it has, or add this one "
            f"there with `gleaner-server tls renew --name {endpoint.host}`"
        )
    if error.verify_code == _EXPIRED:
        return (
            f"the server's certificate or its authority has expired ({reason}); renew it there with "
            "`gleaner-server tls renew`, and check this machine's clock"
        )
    if error.verify_code == _NOT_YET_VALID:
        return f"the server's certificate is not valid yet ({reason}); check the clocks of both machines"
    return f"the server's certificate cannot be used ({reason}); make one there with `gleaner-server tls init`"


def _refusal(endpoint: Endpoint, error: ssl.SSLError, timeout: float) -> str:
    reason = _reason(error)
    if "CERTIFICATE_REQUIRED" in reason or (endpoint.cert is None and "HANDSHAKE_FAILURE" in reason):
        return (
            f"the server asks for a certificate of the client's own ({reason}); give `cert` and `key`, made there with "
            "`gleaner-server tls client NAME`"
        )
    if endpoint.cert is not None and ("UNKNOWN_CA" in reason or "CERTIFICATE" in reason or "DECRYPT_ERROR" in reason):
        return f"the server does not accept the certificate `cert` ({reason}); its --client-ca has not signed it"
    if "NO_APPLICATION_PROTOCOL" in reason:
        return "the server there does not speak gRPC; is this the address of the pages? give that of --listen"
    return _unencrypted(endpoint, timeout) or f"the TLS handshake failed ({reason}); is there a gleaner server?"


def _unencrypted(endpoint: Endpoint, timeout: float) -> str | None:
    answer = _answer(endpoint, timeout, _PREFACE)
    if len(answer) == _FRAME and answer[3] == _SETTINGS:
        return f"the server does not encrypt; write http://{endpoint.target}, or start it with --tls-cert and --tls-key"
    return None


def _answer(endpoint: Endpoint, timeout: float, opening: bytes) -> bytes:
    """The first bytes of the answer to an unencrypted request."""
    answer = b""
    try:
        with _connected(endpoint, timeout) as line:
            line.sendall(opening)
            while len(answer) < _FRAME and (more := line.recv(_FRAME - len(answer))):
                answer += more
    except ConnectionError:
        # Closed, perhaps after an answer.
        pass
    return answer


def _encrypts(endpoint: Endpoint, timeout: float) -> bool:
    """Whether the server answers a TLS handshake; its certificate is not checked."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    context.set_alpn_protocols(["h2"])
    try:
        with _connected(endpoint, timeout) as plain, context.wrap_socket(plain):
            return True
    except ssl.SSLError as error:
        return "ALERT" in _reason(error)


def _connected(endpoint: Endpoint, timeout: float) -> closing[socket.socket]:
    return closing(socket.create_connection((endpoint.host, endpoint.port), timeout=timeout))


def _reason(error: ssl.SSLError) -> str:
    return (error.reason or str(error)).replace(" ", "_").upper()
