"""What our WebSockets share: who may come in, frames of bounded length, and close codes.

Close codes: 4400 bad frame, 4401 no valid token, 4403 not allowed, 4429 too slow,
1009 too big, 1013 come back later.
"""

from fastapi import WebSocket, WebSocketDisconnect
from starlette.websockets import WebSocketState

from app.api.auth import SUBPROTOCOL, Principal, Role, require
from app.services.errors import AppError, ErrorCode

BAD_FRAME = 4400
TOO_SLOW = 4429
TOO_BIG = 1009
GOING_AWAY = 1001
_CLOSE_REASON_BYTES = 123

_CLOSE_CODES: dict[ErrorCode, int] = {
    ErrorCode.TOKEN_MISSING: 4401,
    ErrorCode.TOKEN_INVALID: 4401,
    ErrorCode.TOKEN_EXPIRED: 4401,
    ErrorCode.ROLE_FORBIDDEN: 4403,
    ErrorCode.SITE_FORBIDDEN: 4403,
    ErrorCode.DEVICE_FORBIDDEN: 4403,
    ErrorCode.ORIGIN_FORBIDDEN: 4403,
    ErrorCode.UNAVAILABLE: 1013,
}


async def admit(websocket: WebSocket, *roles: Role) -> Principal | None:
    """Open a socket for ``roles``; None if it was closed at once, with the reason.

    It is accepted first, because a browser shows its page no reason for a refused handshake.
    """
    offered = websocket.scope.get("subprotocols", [])
    await websocket.accept(SUBPROTOCOL if SUBPROTOCOL in offered else None)
    try:
        return await require(*roles)(websocket)
    except AppError as refused:
        await close_socket(websocket, refused)
        return None


async def close_socket(websocket: WebSocket, refused: AppError) -> None:
    """Close a socket for a reason that its client can tell from the close code."""
    if websocket.application_state is not WebSocketState.CONNECTED:
        return
    reason = f"{refused.code}: {refused.detail}".encode()[:_CLOSE_REASON_BYTES]
    await websocket.close(_CLOSE_CODES.get(refused.code, BAD_FRAME), reason.decode(errors="ignore"))


async def next_text(websocket: WebSocket, limit: int) -> str | None:
    """Return the next text frame; None if the socket is closed or had to be closed."""
    try:
        message = await websocket.receive()
    except WebSocketDisconnect:
        return None
    if message["type"] == "websocket.disconnect":
        return None
    text = message.get("text")
    if text is None:
        await websocket.close(BAD_FRAME, "only text frames are understood")
        return None
    if len(text.encode()) > limit:
        await websocket.close(TOO_BIG, f"a frame is longer than {limit} bytes")
        return None
    return str(text)
