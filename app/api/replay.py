"""``POST /v1/devices/{id}/replay``: a stored session run again, to compare; nothing is kept."""

from fastapi import Request, Response

from app.api.devices import device_in_scope
from app.api.fix_openapi import TRACK_REPLY
from app.api.negotiation import best_type
from app.api.resource import (
    Context,
    Name,
    ProfileName,
    Reader,
    Reference,
    StrictModel,
    registry_router,
)
from app.api.tracks import MEDIA_TYPES, track_response
from app.services.replay import ReplayRequest
from app.services.tracks import TrackPage

router = registry_router("/v1/devices", "tracks")


class Replay(StrictModel):
    """What to run again, and how.

    `session` is the phone's name for it, left out: the newest; `profile` and `radio_map` (an id)
    take the place of the session's and of the site's active one.
    """

    session: Name | None = None
    profile: ProfileName | None = None
    radio_map: Reference | None = None


@router.post("/{device_id}/replay", responses={200: TRACK_REPLY})
async def replay_session(
    device_id: str, body: Replay, principal: Reader, context: Context, request: Request
) -> Response:
    """Run a stored session again and return its final track, all of it, in the form of Accept.

    With the session's own profile and radio map it is the track that is stored at its end.
    """
    media_type = best_type(request, MEDIA_TYPES)
    await device_in_scope(context, principal, device_id)
    asked = ReplayRequest(device_id, body.session, body.profile, body.radio_map)
    points = await context.replays.replay(principal, asked)
    return track_response(request, context, media_type, TrackPage(tuple(points), None))
