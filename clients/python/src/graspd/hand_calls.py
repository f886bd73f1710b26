"""The synchronous client's calls about hands: what there is, their shapes, hands of one's own."""

from __future__ import annotations

from graspd.calls import Connection
from graspd.hands import (
    CreatedHand,
    Hand,
    HandFiles,
    HandGeometry,
    HandLike,
    created_from_wire,
    geometry_from_wire,
    hand_from_wire,
    hand_id,
    hand_name,
    read_files,
    upload,
)
from graspd.retry import NEVER
from graspd.v1 import hand_service_pb2


class HandCalls(Connection):
    """Hands as the server has them."""

    def hands(self, *, timeout: float | None = None) -> list[Hand]:
        """All hands of the server, in the order of their ids."""
        found: list[Hand] = []
        token = ""
        while True:
            request = hand_service_pb2.ListHandsRequest(page_token=token)
            page = self._list_hands(request, timeout)
            found += [hand_from_wire(hand) for hand in page.hands]
            token = page.next_page_token
            if not token:
                return found

    def _list_hands(
        self, request: hand_service_pb2.ListHandsRequest, timeout: float | None
    ) -> hand_service_pb2.ListHandsResponse:
        return self._unary(
            lambda left: self._hands.ListHands.future(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )

    def hand(self, hand: HandLike, *, timeout: float | None = None) -> Hand:
        """One hand.

        Raises:
            NotFoundError: If there is no such hand.
        """
        request = hand_service_pb2.GetHandRequest(name=hand_name(hand))
        answer: hand_service_pb2.GetHandResponse = self._unary(
            lambda left: self._hands.GetHand.future(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )
        return hand_from_wire(answer.hand)

    def hand_geometry(self, hand: HandLike, *, timeout: float | None = None) -> HandGeometry:
        """The shape of a hand and how its parts move.

        Raises:
            NotFoundError: If there is no such hand.
        """
        request = hand_service_pb2.GetHandGeometryRequest(name=hand_name(hand))
        answer: hand_service_pb2.GetHandGeometryResponse = self._unary(
            lambda left: self._hands.GetHandGeometry.future(request, timeout=left, metadata=self._metadata),
            timeout,
            self._settings.retry,
        )
        return geometry_from_wire(hand_id(hand), answer)

    def create_hand(
        self, id: str, files: HandFiles, *, validate_only: bool = False, timeout: float | None = None
    ) -> CreatedHand:
        """Adds a hand from its folder, or from its files' contents by their paths in it; never repeated.

        Args:
            id: The new hand's id: a lower-case letter, then lower-case letters, digits and hyphens.
            files: `hand.urdf`, the meshes that it names, and `hand.toml`; without the last the server proposes one.
            validate_only: Check everything and add nothing.
            timeout: Deadline of this call, seconds.

        Raises:
            InvalidArgumentError: If the files do not make a hand; `violations` names each file and place.
            AlreadyExistsError: If there is a hand of that id.
        """
        contents = read_files(files)
        answer: hand_service_pb2.CreateHandResponse = self._unary(
            lambda left: self._hands.CreateHand.future(
                upload(id, contents, validate_only), timeout=left, metadata=self._metadata
            ),
            timeout,
            NEVER,
        )
        return created_from_wire(answer)

    def delete_hand(self, hand: HandLike, *, timeout: float | None = None) -> None:
        """Removes a hand that was created; never repeated.

        Raises:
            FailedPreconditionError: For a hand that comes with the server.
            NotFoundError: If there is no such hand.
        """
        request = hand_service_pb2.DeleteHandRequest(name=hand_name(hand))
        self._unary(
            lambda left: self._hands.DeleteHand.future(request, timeout=left, metadata=self._metadata),
            timeout,
            NEVER,
        )
