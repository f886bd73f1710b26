"""Servers of other versions, with TLS and with tokens: real gRPC servers in this process that say who they are."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Iterator
from concurrent import futures
from contextlib import contextmanager
from pathlib import Path

import grpc
import pytest

import graspd
import graspd.aio
from graspd.v1 import hand_service_pb2, info_service_pb2, info_service_pb2_grpc


class Info(info_service_pb2_grpc.InfoServiceServicer):
    """Says that it is of some version, and remembers who asked."""

    def __init__(self, version: str, token: str | None = None) -> None:
        self.version = version
        self.token = token

    def GetServerInfo(  # noqa: N802
        self, request: info_service_pb2.GetServerInfoRequest, context: grpc.ServicerContext
    ) -> info_service_pb2.GetServerInfoResponse:
        said = dict(context.invocation_metadata()).get("authorization")
        if self.token is not None and said != f"Bearer {self.token}":
            context.abort(grpc.StatusCode.UNAUTHENTICATED, "who is that?")
        return info_service_pb2.GetServerInfoResponse(version=self.version)


def list_hands(
    request: hand_service_pb2.ListHandsRequest, context: grpc.ServicerContext
) -> hand_service_pb2.ListHandsResponse:
    return hand_service_pb2.ListHandsResponse(hands=[hand_service_pb2.Hand(name="hands/old")])


OLD = grpc.method_handlers_generic_handler(
    "graspd.v1.HandService",
    {
        "ListHands": grpc.unary_unary_rpc_method_handler(
            list_hands,
            request_deserializer=hand_service_pb2.ListHandsRequest.FromString,
            response_serializer=hand_service_pb2.ListHandsResponse.SerializeToString,
        )
    },
)
"""A server from before InfoService."""


@contextmanager
def serving(servicer: Info | None, credentials: grpc.ServerCredentials | None = None) -> Iterator[str]:
    server = grpc.server(futures.ThreadPoolExecutor(2))
    if servicer is None:
        server.add_generic_rpc_handlers([OLD])
    else:
        info_service_pb2_grpc.add_InfoServiceServicer_to_server(servicer, server)
    if credentials is None:
        port = server.add_insecure_port("127.0.0.1:0")
    else:
        port = server.add_secure_port("127.0.0.1:0", credentials)
    server.start()
    try:
        yield f"127.0.0.1:{port}"
    finally:
        server.stop(None).wait()


def connect_async(address: str) -> None:
    async def body() -> None:
        async with graspd.aio.connect(address):
            pass

    asyncio.run(body())


def test_a_server_of_another_version_is_refused_in_words() -> None:
    with serving(Info("0.9.3")) as address:
        for connect in (graspd.connect, connect_async):
            with pytest.raises(graspd.VersionError) as caught:
                connect(address)
            assert "0.9.3" in str(caught.value) and "pip install 'graspd==0.9.*'" in str(caught.value)
        with graspd.connect(address, check_version=False) as planner:
            assert planner.server is not None and planner.server.version == "0.9.3"


def test_a_server_that_does_not_tell_is_refused_in_words() -> None:
    with serving(None) as address:
        for connect in (graspd.connect, connect_async):
            with pytest.raises(graspd.VersionError, match=r"does not tell its version.*check_version=False"):
                connect(address)
        with graspd.connect(address, check_version=False) as planner:
            assert planner.server is None
            assert [hand.id for hand in planner.hands()] == ["old"]


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A certificate for localhost and one for a client, each its own authority."""
    folder = tmp_path_factory.mktemp("certificates")
    for name in ("server", "client"):
        subprocess.run(
            [
                *("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
                *("-days", "2", "-subj", f"/CN={name}", "-addext", "subjectAltName=DNS:localhost,DNS:cell-7"),
                *("-keyout", str(folder / f"{name}.key"), "-out", str(folder / f"{name}.pem")),
            ],
            check=True,
            capture_output=True,
        )
    return folder


def test_tls_with_tokens(certificates: Path) -> None:
    pair = ((certificates / "server.key").read_bytes(), (certificates / "server.pem").read_bytes())
    credentials = grpc.ssl_server_credentials([pair])
    with serving(Info(graspd.__version__, token="t0ken"), credentials) as address:
        by_name = address.replace("127.0.0.1", "localhost")
        trusted = graspd.Tls(ca=certificates / "server.pem")
        with graspd.connect(by_name, tls=trusted, token="t0ken") as planner:
            assert planner.server is not None
        with graspd.connect(
            f"https://{by_name}", tls=graspd.Tls(ca=certificates / "server.pem", server_name="cell-7"), token="t0ken"
        ):
            pass
        for token in (None, "wrong"):
            with pytest.raises(graspd.UnauthenticatedError, match="who is that"):
                graspd.connect(by_name, tls=trusted, token=token)
        # Nobody vouches for it; it is spoken to in the clear.
        for tls in (graspd.Tls(), None):
            with pytest.raises(graspd.ConnectError):
                graspd.connect(by_name, tls=tls, connect_timeout=0.5)


def test_clients_show_their_certificates(certificates: Path) -> None:
    pair = ((certificates / "server.key").read_bytes(), (certificates / "server.pem").read_bytes())
    authority = (certificates / "client.pem").read_bytes()
    credentials = grpc.ssl_server_credentials([pair], root_certificates=authority, require_client_auth=True)
    with serving(Info(graspd.__version__), credentials) as address:
        by_name = address.replace("127.0.0.1", "localhost")
        own = graspd.Tls(
            ca=certificates / "server.pem", certificate=certificates / "client.pem", key=certificates / "client.key"
        )
        with graspd.connect(by_name, tls=own):
            pass
        with pytest.raises(graspd.ConnectError):
            graspd.connect(by_name, tls=graspd.Tls(ca=certificates / "server.pem"), connect_timeout=0.5)
