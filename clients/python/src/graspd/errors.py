"""What can go wrong, as exceptions: one class for each thing that a caller does something else about.

Every error of a call carries what the server says about it: a machine-readable reason, the fields at fault with what
was found and what was expected, when to come back, and further figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import grpc
from google.protobuf.message import DecodeError
from google.rpc import error_details_pb2, status_pb2

_DETAILS_KEY = "grpc-status-details-bin"


@dataclass(frozen=True)
class Violation:
    """A field of the request that was refused."""

    field: str
    """Path of the field in the protocol, for example `frames[0].intrinsics.fx_px`."""
    description: str
    """What was found and what was expected."""


class GraspdError(Exception):
    """Anything that this package raises about a server."""


class ConnectError(GraspdError, ConnectionError):
    """Nobody answers at the address."""


class VersionError(GraspdError):
    """Client and server do not fit together; the message says which of them to change."""


class ProtocolError(GraspdError):
    """The server's answer lacks what the protocol promises."""


class CallError(GraspdError):
    """A call that ended with an error. The subclasses say which; an error without a class of its own is this one."""

    code: grpc.StatusCode
    """The gRPC code."""
    reason: str
    """Machine readable, for example `HAND_NOT_FOUND`; empty when the error does not come from a graspd server."""
    message: str
    """For people."""
    violations: tuple[Violation, ...]
    """The refused fields, where the reason is one of a field."""
    retry_after: float | None
    """Seconds after which the server asks to come back."""
    metadata: Mapping[str, str]
    """Further figures, for example `limit_bytes`."""

    _code: ClassVar[grpc.StatusCode | None] = None

    def __init__(
        self,
        code: grpc.StatusCode,
        message: str,
        *,
        reason: str = "",
        violations: Iterable[Violation] = (),
        retry_after: float | None = None,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        self.code = code
        self.reason = reason
        self.message = message
        self.violations = tuple(violations)
        self.retry_after = retry_after
        self.metadata = dict(metadata or {})
        super().__init__(code, message)

    def __reduce__(self) -> tuple[object, ...]:
        # Errors cross processes: the keyword arguments would be lost.
        return _again, (
            type(self),
            self.code,
            self.message,
            self.reason,
            self.violations,
            self.retry_after,
            dict(self.metadata),
        )

    def __str__(self) -> str:
        label = self.reason or self.code.name
        return f"{label}: {self.message}"

    @property
    def fields(self) -> tuple[str, ...]:
        """Paths of the refused fields."""
        return tuple(v.field for v in self.violations)


class InvalidArgumentError(CallError, ValueError):
    """A field of the request is wrong: `violations` names it, what was found and what was expected."""

    _code = grpc.StatusCode.INVALID_ARGUMENT


class NotFoundError(CallError, LookupError):
    """There is no hand or no estimator of that name."""

    _code = grpc.StatusCode.NOT_FOUND


class AlreadyExistsError(CallError):
    """There is a hand of that id."""

    _code = grpc.StatusCode.ALREADY_EXISTS


class FailedPreconditionError(CallError):
    """The server's state forbids it, for example deleting a hand that comes with the server."""

    _code = grpc.StatusCode.FAILED_PRECONDITION


class ResourceExhaustedError(CallError):
    """The queue is full (with `retry_after`), a message is too large, or a quota is used up."""

    _code = grpc.StatusCode.RESOURCE_EXHAUSTED


class DeadlineExceededError(CallError, TimeoutError):
    """The deadline passed before there was anything to answer."""

    _code = grpc.StatusCode.DEADLINE_EXCEEDED


class CancelledError(CallError):
    """The call was cancelled. Not `asyncio.CancelledError`, which a cancelled task still gets."""

    _code = grpc.StatusCode.CANCELLED


class UnavailableError(CallError, ConnectionError):
    """The server is gone, starting or shutting down."""

    _code = grpc.StatusCode.UNAVAILABLE


class UnimplementedError(CallError):
    """The server has no such method: it is older than this client, or no graspd server."""

    _code = grpc.StatusCode.UNIMPLEMENTED


class UnauthenticatedError(CallError):
    """The server asks who is calling, and the answer was missing or wrong."""

    _code = grpc.StatusCode.UNAUTHENTICATED


class PermissionDeniedError(CallError, PermissionError):
    """The caller may not do that."""

    _code = grpc.StatusCode.PERMISSION_DENIED


class InternalError(CallError):
    """A fault of the server."""

    _code = grpc.StatusCode.INTERNAL


def _again(
    kind: type[CallError],
    code: grpc.StatusCode,
    message: str,
    reason: str,
    violations: tuple[Violation, ...],
    retry_after: float | None,
    metadata: dict[str, str],
) -> CallError:
    return kind(code, message, reason=reason, violations=violations, retry_after=retry_after, metadata=metadata)


_CLASSES: dict[grpc.StatusCode, type[CallError]] = {
    c._code: c for c in CallError.__subclasses__() if c._code is not None
}
_CODES: dict[int, grpc.StatusCode] = {code.value[0]: code for code in grpc.StatusCode}


def call_error(
    code: grpc.StatusCode,
    message: str,
    *,
    reason: str = "",
    violations: Iterable[Violation] = (),
    retry_after: float | None = None,
    metadata: Mapping[str, str] | None = None,
) -> CallError:
    """The error of the class that belongs to the code."""
    return _CLASSES.get(code, CallError)(
        code, message, reason=reason, violations=violations, retry_after=retry_after, metadata=metadata
    )


def code_of(number: int) -> grpc.StatusCode:
    """The gRPC code of a number of `google.rpc.Code`."""
    return _CODES.get(number, grpc.StatusCode.UNKNOWN)


def late() -> CallError:
    """The error of a call that took too long for its caller."""
    return call_error(
        grpc.StatusCode.DEADLINE_EXCEEDED,
        "the deadline passed before the server answered",
        reason="DEADLINE_EXCEEDED",
    )


def from_status(
    code: grpc.StatusCode, message: str | None, metadata: Iterable[tuple[str, str | bytes]] | None
) -> CallError:
    """The error of a call, with the details that travel in the trailing metadata (`google.rpc.Status`)."""
    packed = next((value for key, value in metadata or () if key == _DETAILS_KEY), None)
    details = _Details()
    if isinstance(packed, bytes):
        try:
            details = _Details.unpacked(packed)
        except DecodeError:
            # Something between client and server answered; its code and message are all there is.
            details = _Details()
    if code is grpc.StatusCode.DEADLINE_EXCEEDED and not details.reason:
        # The timer on this side: the server's own answer has a reason.
        return late()
    return call_error(
        code,
        message or code.name,
        reason=details.reason,
        violations=details.violations,
        retry_after=details.retry_after,
        metadata=details.metadata,
    )


@dataclass(frozen=True)
class _Details:
    """What the details of a status say."""

    reason: str = ""
    violations: tuple[Violation, ...] = ()
    retry_after: float | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def unpacked(cls, packed: bytes) -> _Details:
        found = cls()
        for detail in status_pb2.Status.FromString(packed).details:
            info = error_details_pb2.ErrorInfo()
            bad = error_details_pb2.BadRequest()
            retry = error_details_pb2.RetryInfo()
            if detail.Unpack(info):
                found = replace(found, reason=info.reason, metadata=dict(info.metadata))
            elif detail.Unpack(bad):
                violations = tuple(Violation(v.field, v.description) for v in bad.field_violations)
                found = replace(found, violations=violations)
            elif detail.Unpack(retry):
                found = replace(found, retry_after=retry.retry_delay.ToTimedelta().total_seconds())
        return found
