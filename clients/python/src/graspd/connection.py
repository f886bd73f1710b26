"""Where a server is and how it is spoken to: address, encryption, and the channel's settings."""

from __future__ import annotations

import ipaddress
import os
from dataclasses import dataclass
from pathlib import Path

import grpc

from graspd.retry import DEFAULT, RetryPolicy

DEFAULT_ADDRESS = "127.0.0.1:50051"
"""Where `graspd serve` listens unless told otherwise."""
ADDRESS_VARIABLE = "GRASPD_ADDRESS"
"""The environment variable that names another address."""
MAX_MESSAGE_BYTES = 64 << 20
"""Largest answer that is taken."""


@dataclass(frozen=True)
class Tls:
    """Encryption. Without any field the system's certificate authorities are trusted."""

    ca: Path | str | None = None
    """File with the certificates of the authorities to trust, PEM."""
    certificate: Path | str | None = None
    """File with this client's certificate, PEM, where the server asks for one; with `key`."""
    key: Path | str | None = None
    """File with this client's private key, PEM."""
    server_name: str | None = None
    """The name in the server's certificate, where it is not the address."""

    def credentials(self) -> grpc.ChannelCredentials:
        """The files' contents as gRPC takes them.

        Raises:
            ValueError: If there is a certificate without its key, or the other way round.
            OSError: If a file cannot be read.
        """
        if (self.certificate is None) != (self.key is None):
            raise ValueError("tls: found one of certificate and key, expected both or neither")

        def contents(path: Path | str | None) -> bytes | None:
            return None if path is None else Path(path).read_bytes()

        return grpc.ssl_channel_credentials(
            root_certificates=contents(self.ca),
            private_key=contents(self.key),
            certificate_chain=contents(self.certificate),
        )


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How a client connects and how long it waits."""

    address: str | None = None
    """`host:port`, with or without `http://` or `https://`. None: the environment variable `GRASPD_ADDRESS`, and
    127.0.0.1:50051 without one."""
    timeout: float = 10.0
    """Deadline of every call, all its attempts together, seconds."""
    connect_timeout: float = 5.0
    """How long to wait for a server that is starting, seconds."""
    retry: RetryPolicy = DEFAULT
    """What is repeated."""
    tls: Tls | None = None
    """Encryption; `https://` asks for it too."""
    token: str | None = None
    """Bearer token that goes with every call. Only with encryption, or to this machine."""
    max_message_bytes: int = MAX_MESSAGE_BYTES
    """Largest answer that is taken."""
    check_version: bool = True
    """Whether a server that does not fit this client is refused."""

    def __post_init__(self) -> None:
        for name in ("timeout", "connect_timeout"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}: found {getattr(self, name)}, expected seconds, more than 0")

    def resolved(self) -> Target:
        """The target of the channel.

        Raises:
            ValueError: If the address is not one, or a token would travel in the clear.
        """
        address = self.address or os.environ.get(ADDRESS_VARIABLE) or DEFAULT_ADDRESS
        scheme, has_scheme, rest = address.partition("://")
        rest = (rest if has_scheme else address).rstrip("/")
        if has_scheme and scheme not in ("http", "https"):
            raise ValueError(f"address: found {address!r}, expected host:port, http:// or https://")
        if scheme == "http" and has_scheme and self.tls is not None:
            raise ValueError(f"address: found {address!r} with tls, expected https:// or no scheme")
        host, colon, port = rest.rpartition(":")
        if not colon or not host or not port.isdigit():
            raise ValueError(f"address: found {address!r}, expected host:port, for example {DEFAULT_ADDRESS}")
        tls = self.tls or (Tls() if has_scheme and scheme == "https" else None)
        if self.token is not None and tls is None and not _is_this_machine(host):
            raise ValueError(
                f"token: found one for {rest} without encryption, expected tls or an address of this machine"
            )
        return Target(rest, tls)

    def metadata(self) -> tuple[tuple[str, str], ...]:
        """What goes with every call."""
        return () if self.token is None else (("authorization", f"Bearer {self.token}"),)

    def options(self, target: Target) -> list[tuple[str, int | str]]:
        """The channel's options."""
        options: list[tuple[str, int | str]] = [
            ("grpc.max_receive_message_length", self.max_message_bytes),
            ("grpc.max_send_message_length", -1),
            # What is repeated, and when, is for the retry policy alone.
            ("grpc.enable_retries", 0),
            # A server that comes back is found again within the back-off of the retry policy.
            ("grpc.initial_reconnect_backoff_ms", 50),
            ("grpc.max_reconnect_backoff_ms", 1000),
            # Despite its name this is how long one attempt to connect may take, with TLS. Some versions of gRPC lose
            # attempts at ports that nobody listens at yet: longer ones would keep a server waiting that has started.
            ("grpc.min_reconnect_backoff_ms", 1000),
            # Planners stand beside robots; a proxy of the environment does not lead to them.
            ("grpc.enable_http_proxy", 0),
        ]
        if target.tls is not None and target.tls.server_name is not None:
            options.append(("grpc.ssl_target_name_override", target.tls.server_name))
        return options


@dataclass(frozen=True)
class Target:
    """Where a server is, and whether it is spoken to in the clear."""

    address: str
    """`host:port`."""
    tls: Tls | None
    """Encryption."""


def _is_this_machine(host: str) -> bool:
    bare = host.strip("[]")
    try:
        return ipaddress.ip_address(bare).is_loopback
    except ValueError:
        return bare == "localhost"
