"""A surveyor's session becomes a survey: what the phone posted, between the truths it stated."""

import asyncio
from dataclasses import dataclass, replace
from functools import partial
from uuid import uuid4

from sqlalchemy import Connection

from app.core.motion.walks import survey_walks
from app.core.session import SessionRecord
from app.core.survey import SurveyWalk
from app.core.types import Observation, Truth
from app.formats.survey_places import Reason, SurveyFrame, Unusable, UnusableError
from app.services.access import Principal
from app.services.errors import AppError, ErrorCode, found
from app.services.replay import MAX_REPLAY_BYTES
from app.services.survey_frames import UploadRequest, survey_frame
from app.services.survey_parsing import SurveyTally, tally_of
from app.services.writing import write
from app.sessions.ports import Clock
from app.storage import surveys
from app.storage.database import Database
from app.storage.log import SqlObservationLog, find_session, logged_bytes
from app.storage.surveys import StoredSurvey

FORMAT = "session"


@dataclass(frozen=True, slots=True)
class SessionSurvey:
    """Which session to take, by the phone's name for it (None: the newest); the survey's name."""

    device_id: str
    session: str | None
    name: str


class SessionSurveys:
    """Makes surveys of sessions, one at a time: what phones post now comes first."""

    def __init__(self, database: Database, clock: Clock) -> None:
        self._database = database
        self._log = SqlObservationLog(database)
        self._clock = clock
        self._turn = asyncio.Lock()

    async def take(self, principal: Principal, asked: SessionSurvey) -> StoredSurvey:
        """Store a session as a survey.

        Raises
        ------
        AppError
            If there is no such session, or nothing in it can be used.
        """
        async with self._turn:
            record = await self._session(principal, asked)
            request = UploadRequest(record.site_id, asked.name)
            frame = await self._database.read(partial(survey_frame, request=request))
            observations = await self._log.observations(record.session_id)
            name = record.session
            walks, tally = await asyncio.to_thread(_walks, name, observations, frame)
        if not tally.holdings():
            reasons = "; ".join(tally.unusable()["counts"]) or "it has no truth records"
            raise AppError(
                ErrorCode.INVALID_FIELD, f"nothing of the session can be used: {reasons}"
            )
        survey = StoredSurvey(
            survey_id=uuid4().hex[:12],
            site_id=record.site_id,
            name=asked.name or f"{record.device_id} {record.session}",
            survey_format=FORMAT,
            created_s=self._clock.now_s(),
            device_id=record.device_id,
        )
        survey = replace(survey, holdings=tally.holdings(), unusable=tally.unusable())
        await write(self._database, partial(_store, survey, walks))
        return survey

    async def _session(self, principal: Principal, asked: SessionSurvey) -> SessionRecord:
        record = found(
            await self._database.read(lambda c: find_session(c, asked.device_id, asked.session)),
            "session",
            asked.session or f"of {asked.device_id}",
        )
        if not principal.covers_site(record.site_id):
            detail = f"the token is not for site {record.site_id!r}"
            raise AppError(ErrorCode.SITE_FORBIDDEN, detail)
        size = await self._database.read(lambda c: logged_bytes(c, record.session_id))
        if size > MAX_REPLAY_BYTES:
            detail = f"the session is larger than {MAX_REPLAY_BYTES >> 20} MB"
            raise AppError(ErrorCode.BODY_TOO_LARGE, detail)
        return record


def _walks(
    name: str, observations: list[Observation], frame: SurveyFrame
) -> tuple[list[SurveyWalk], SurveyTally]:
    unusable: list[Unusable] = []
    kept: list[Observation] = []
    truths = 0
    for observation in observations:
        if not isinstance(observation, Truth):
            kept.append(observation)
            continue
        truths += 1
        try:
            _check(frame, observation)
            kept.append(observation)
        except UnusableError as error:
            unusable.append(Unusable(f"truth {truths}", error.reason, error.detail))
    walks = survey_walks(name, kept)
    unusable += [Unusable(walk.walk, Reason.NO_SCAN) for walk in walks if not walk.scans]
    used = [walk for walk in walks if walk.scans]
    return used, tally_of([*used, *unusable])


def _check(frame: SurveyFrame, truth: Truth) -> None:
    frame.place(frame.floor(truth.floor_id), truth.x_m, truth.y_m)


def _store(survey: StoredSurvey, walks: list[SurveyWalk], connection: Connection) -> None:
    surveys.begin_survey(connection, survey)
    surveys.add_records(connection, survey.survey_id, [surveys.walk_row(w) for w in walks])
    surveys.complete_survey(connection, survey)
