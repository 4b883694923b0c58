"""One call of an address that a client has named: to allowed hosts only, signed, bounded in time and size.

The name is looked up once, and the connection goes to the address that was checked: a name that means another machine a
moment later (DNS rebinding) leads nowhere else. Redirects are not followed, proxies of the environment not used.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import http.client
import ipaddress
import socket
import ssl
import threading
from contextlib import suppress
from functools import cache
from urllib.parse import urlsplit

CALL_S = 15.0
"""Time of a call, once it is connected."""

CONNECT_S = 5.0

_TOLD_BYTES = 200  # of an answer that is no success: what of it is kept
_TRANSLATED = tuple(map(ipaddress.ip_network, ("64:ff9b::/96", "64:ff9b:1::/48", "2002::/16", "2001::/32")))

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


class CallRefusedError(Exception):
    """The address may not be called."""


class AllowedHosts:
    """Which hosts may be called.

    Parameters
    ----------
    listed
        Names, addresses and networks with commas between: ``hooks.example.org, 10.0.3.7, 10.1.0.0/16``. A name may
        mean public addresses only, unless its address is listed too.
    """

    def __init__(self, listed: str) -> None:
        self.names: set[str] = set()
        self.networks: list[ipaddress.IPv4Network | ipaddress.IPv6Network] = []
        for each in (part.strip() for part in listed.split(",") if part.strip()):
            try:
                self.networks.append(ipaddress.ip_network(each.strip("[]")))
            except ValueError:
                self.names.add(each.lower().rstrip("."))

    def check_name(self, uri: str) -> tuple[str, int]:
        """Return host and port of an address.

        Raises
        ------
        CallRefusedError
            The host is not allowed.
        """
        try:
            parts = urlsplit(uri)
            host, port = (parts.hostname or "").rstrip("."), parts.port or (443 if parts.scheme == "https" else 80)
        except ValueError as error:
            raise CallRefusedError(f"{uri!r} is not an address ({error}).") from error
        if parts.username is not None or parts.password is not None or parts.scheme not in {"http", "https"}:
            raise CallRefusedError(f"{uri!r} is not an address as https://hooks.example.org/path, without a user.")
        if host not in self.names and not self._lists(host):
            raise CallRefusedError(f"{host!r} is none of the hosts that this service may call (WEBHOOK_HOSTS).")
        return host, port

    def resolve(self, uri: str) -> tuple[str, int]:
        """Return the address of a machine, as digits, and the port, that a call may connect to.

        Raises
        ------
        CallRefusedError
            The host is not allowed, or its name means an address that is not.
        OSError
            Nobody knows the name.
        """
        host, port = self.check_name(uri)
        found = dict.fromkeys(str(row[4][0]) for row in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
        refused = [text for text in found if not self._may_connect(text)]
        if refused or not found:
            raise CallRefusedError(f"{host} is {', '.join(refused)}: not a public address, and not in WEBHOOK_HOSTS.")
        return next(iter(found)), port

    def _lists(self, text: str) -> bool:
        try:
            return any(_plain(text) in network for network in self.networks)
        except ValueError:
            return False

    def _may_connect(self, text: str) -> bool:
        address = _plain(text)
        is_public = address.is_global and not address.is_multicast and not any(address in each for each in _TRANSLATED)
        return is_public or self._lists(text)


def _plain(text: str) -> Address:
    """Return an address; one of IPv4 that is written as one of IPv6 is that of IPv4."""
    address = ipaddress.ip_address(text.partition("%")[0])
    return getattr(address, "ipv4_mapped", None) or address


def signature(secret: bytes, id_: str, seconds: int, body: bytes) -> str:
    """Return the header `webhook-signature` of Standard Webhooks."""
    signed = hmac.digest(secret, f"{id_}.{seconds}.".encode() + body, hashlib.sha256)
    return f"v1,{base64.b64encode(signed).decode()}"


def call(uri: str, body: bytes, headers: dict[str, str], allowed: AllowedHosts) -> tuple[int, str]:
    """Send a body by POST; returns status and the begin of the answer.

    Raises
    ------
    CallRefusedError
        The address may not be called.
    OSError, http.client.HTTPException
        It could not be reached, or did not answer in time as HTTP has it.
    """
    machine, port = allowed.resolve(uri)
    parts = urlsplit(uri)
    connection = http.client.HTTPConnection(str(parts.hostname), port)
    plain = socket.create_connection((machine, port), timeout=CONNECT_S)
    plain.settimeout(CALL_S)
    end = threading.Timer(CALL_S, _cut, [plain])
    end.daemon = True
    end.start()
    try:
        connection.sock = plain
        if parts.scheme == "https":
            connection.sock = _tls().wrap_socket(plain, server_hostname=parts.hostname)
        target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
        port_ = "" if parts.port is None else f":{parts.port}"
        host = f"[{parts.hostname}]" if ":" in str(parts.hostname) else parts.hostname
        connection.request("POST", target, body, {**headers, "Host": f"{host}{port_}", "Connection": "close"})
        answer = connection.getresponse()
        told = b"" if 200 <= answer.status < 300 else answer.read(_TOLD_BYTES)
        return answer.status, told.decode(errors="replace")
    finally:
        end.cancel()
        connection.close()
        plain.close()


def _cut(connection: socket.socket) -> None:
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


@cache
def _tls() -> ssl.SSLContext:
    return ssl.create_default_context()
