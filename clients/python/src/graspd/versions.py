"""Whether a client and a server fit together, and what to say if they do not.

A server ignores, without a word, the fields that it does not know: a client that is newer than its server could ask
for a keep-out box and not get it. So a client is never newer than its server, and while the major version is 0 the
minor versions are equal.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from graspd._version import __version__
from graspd.errors import VersionError
from graspd.v1 import info_service_pb2


@dataclass(frozen=True)
class ServerInfo:
    """What a server says about itself."""

    version: str
    """Its version, for example `0.1.0`."""
    estimators: tuple[str, ...]
    """Contact estimators by name; the first is the default of `SceneOptions.estimator`."""
    max_message_bytes: int
    """Largest message that it takes."""


def _series(version: str) -> tuple[int, int] | None:
    found = re.match(r"(\d+)\.(\d+)\.\d+", version)
    return (int(found[1]), int(found[2])) if found else None


def check(server: str, address: str, client: str = __version__) -> None:
    """Checks that this client fits a server of that version.

    Raises:
        VersionError: If it does not; the message says what to install.
    """
    ours, theirs = _series(client), _series(server)
    if ours is None or theirs is None:
        raise VersionError(
            f"the server at {address} says its version is {server!r} and this client's is {client!r}: expected "
            "three numbers such as 0.1.0"
        )
    equal_needed = ours[0] == 0 or theirs[0] == 0
    if ours == theirs or (not equal_needed and ours[0] == theirs[0] and ours[1] < theirs[1]):
        return
    fitting = f"{theirs[0]}.{theirs[1]}.*"
    if ours > theirs:
        problem = "the server is older and would ignore what it does not know"
        cure = (
            f"update the server to {ours[0]}.{ours[1]}, or install a client that fits: pip install 'graspd=={fitting}'"
        )
    else:
        problem = "the server speaks a newer protocol than this client"
        cure = f"update this client: pip install 'graspd=={fitting}'"
    raise VersionError(f"this client is graspd {client} and the server at {address} is {server}: {problem}; {cure}")


def accepted(answer: info_service_pb2.GetServerInfoResponse, address: str, checked: bool) -> ServerInfo:
    """What a server said about itself, if it fits or need not.

    Raises:
        VersionError: If it does not fit.
    """
    if checked:
        check(answer.version, address)
    return ServerInfo(answer.version, tuple(answer.estimators), answer.max_message_bytes)


def unknown(address: str) -> VersionError:
    """The error of a server that does not tell its version."""
    return VersionError(
        f"the server at {address} does not tell its version: it is older than this client (graspd {__version__}), "
        "or it is no graspd server; update it, or connect with check_version=False"
    )
