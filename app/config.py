"""Settings: the only reader of the environment (``PHAROS_*``); read by main and cli alone."""

from typing import Literal

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict


class Settings(BaseSettings):
    """Everything an operator can set; every field has a default that works on one machine."""

    model_config = SettingsConfigDict(env_prefix="PHAROS_", frozen=True)

    database_url: str = Field(
        "sqlite:///pharos.db", description="SQLAlchemy URL of the SQLite file or PostgreSQL server."
    )
    migrate: bool = Field(True, description="Bring the database schema up to date at start.")
    host: str = Field("127.0.0.1", description="Address to listen on; 0.0.0.0 for all.")
    port: int = Field(8000, ge=0, le=65535, description="Port to listen on.")
    public_url: str | None = Field(
        None, description="Address that browsers and phones use, if not http://host:port."
    )
    log_level: Literal["debug", "info", "warning", "error"] = Field(
        "info", description="Log level: debug, info, warning or error."
    )
    cors_origins: tuple[str, ...] = Field(
        (),
        description='Origins of other sites\' pages that may call the API, as JSON: ["https://x"].',
    )
    cookie_secure: bool = Field(
        False, description="Send the login cookie over HTTPS only; set it when there is HTTPS."
    )
    login_s: float = Field(
        7 * 86400.0, gt=0, description="Seconds that a browser's login lasts at most."
    )
    token_cache_s: float = Field(
        5.0, ge=0, description="Seconds that a token looked up in the database is remembered."
    )
    ingest_wait_s: float = Field(
        2.0, gt=0, description="Seconds that a phone's batch waits to be stored before it gets 503."
    )
    edit_wait_s: float = Field(
        5.0, gt=0, description="Seconds that an edit waits to be stored before it gets 503."
    )

    max_body_bytes: int = Field(1 << 20, gt=0, description="Largest request body as sent.")
    max_decoded_bytes: int = Field(8 << 20, gt=0, description="Largest body after decompression.")
    max_gzip_ratio: int = Field(100, gt=0, description="Largest ratio of decoded to sent bytes.")

    max_survey_bytes: int = Field(1 << 30, gt=0, description="Largest upload of a survey, as sent.")
    spool_dir: str | None = Field(
        None,
        description="Folder for uploads until they are read, kept over restarts; if not set "
        "`pharos-uploads` beside the SQLite file, or one among the system's temporary files.",
    )

    session_evict_s: float = Field(
        180.0, gt=0, description="Seconds without a batch after which a session leaves memory."
    )
    session_idle_s: float = Field(
        600.0, gt=0, description="Seconds without a batch after which a session is over."
    )
    sweep_interval_s: float = Field(
        5.0, gt=0, description="Seconds between looks for sessions to put to rest."
    )
    imu_retention_s: float = Field(
        86400.0, gt=0, description="Seconds that raw inertial records stay in the observation log."
    )
    retention_days: float = Field(
        90.0, gt=0, description="Days that scans, steps and tracks are kept; a site may say others."
    )
