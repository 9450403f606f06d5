"""What can be set from outside: environment variables `DESIREPATH_*` (or a `.env` file), each with its default."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path
from typing import Literal
from urllib.parse import quote

from pydantic import Field, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from desirepath.grammar.text_files import NotUtf8Error, read_text


class SettingsError(ValueError):
    """A setting that cannot be used; names it and says what would work."""


class Settings(BaseSettings):
    """All settings of one installation."""

    model_config = SettingsConfigDict(env_prefix="DESIREPATH_", env_file=".env", extra="ignore")

    data: Path = Field(Path("data"), description="folder for the database, artefacts, logs and the secret key")
    database_url: str | None = Field(None, description="SQLAlchemy URL; default SQLite inside the data folder")
    database_password_file: Path | None = Field(
        None,
        description="file whose one line is the password of database_url, where that has none; a container's secret",
    )
    artefacts_url: str | None = Field(
        None, description="fsspec URL of the artefact store; default inside the data folder"
    )
    links_to_store: bool = Field(
        False,
        description="browsers reach the S3 store, too: downloads of artefacts are signed links to it, good for minutes",
    )
    host: str = Field(
        "127.0.0.1",
        description="name or address to listen on; 0.0.0.0: every IPv4 address, ::: every one of both kinds",
    )
    port: int = Field(8000, ge=1, le=65534, description="port of the pages; the stage listens on the next one")
    shares_ports: bool = Field(
        False, description="other server processes listen on the same ports; set by `serve --processes`"
    )
    peer_host: str = Field(
        "",
        description="name or address of this machine for the other server processes of this installation; default: "
        "the machine's own name where the server listens on every address, else what it listens on",
    )
    public_url: str | None = Field(
        None, description="address participants reach the pages at, e.g. https://study.example.org"
    )
    public_stage_url: str | None = Field(None, description="address browsers reach the stage at; its own origin")
    trusted_proxies: str = Field(
        "127.0.0.1,::1",
        description="addresses, with commas, of reverse proxies whose word counts for a visitor's address and TLS; "
        "they must replace what a visitor says of it. *: any, where nobody else reaches the server",
    )
    metrics_token: str = Field(
        "", description="who sends it as a bearer token may read /metrics from elsewhere; empty: this machine only"
    )
    second_factor: Literal["offered", "owners", "everybody"] = Field(
        "offered",
        description="whose sign-in needs a code of an authenticator app: who set one up (offered), besides every owner "
        "of the installation or of a study (owners), or every account (everybody)",
    )
    openid_issuer: str = Field(
        "", description="address of the OpenID Connect provider whose accounts may sign in, e.g. a university's"
    )
    openid_client_id: str = Field("", description="this installation's name at that provider")
    openid_client_secret: str = Field("", description="its secret there; empty for a public client (PKCE alone)")
    openid_client_secret_file: Path | None = Field(None, description="file whose one line is that secret")
    openid_name: str = Field("university account", description="on the button: Sign in with your ...")
    openid_admits: str = Field(
        "",
        description="domains and e-mail addresses, with commas, whose owners get an account without any role; others "
        "need an invitation",
    )
    openid_trusts_email: bool = Field(
        False, description="the provider says nothing of having checked addresses, but has: an institution's own"
    )
    prolific_url: str = Field(
        "https://api.prolific.com", description="Prolific's interface; https, or this machine for trying"
    )
    prolific_token: str = Field("", repr=False, description="token of a researcher's account at Prolific")
    prolific_token_file: Path | None = Field(None, description="file whose one line is that token")
    worker: bool = Field(True, description="run a background worker beside the server")
    training_processes: int = Field(1, ge=1, le=8, description="trainings at once; each uses one core")
    machine: str = Field(
        "", max_length=80, description="what the pages of jobs call this machine; default: its own name"
    )
    standing_process: bool = Field(
        True,
        description="keep one process loaded (about 350 MB) while participants are there: instant policies take "
        "seconds",
    )
    contact: str = Field(
        "", description="whom participants may ask; where empty, they read: the person who sent you the link"
    )

    @field_validator("host")
    @classmethod
    def _without_brackets(cls, host: str) -> str:
        return host[1:-1] if host.startswith("[") and host.endswith("]") else host

    @property
    def local_url(self) -> str:
        """Where this machine finds the pages, without a trailing slash."""
        here = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)  # noqa: S104
        return f"http://{in_url(here)}:{self.port}"

    @property
    def own_url(self) -> str:
        """Where participants find the pages, without a trailing slash."""
        return (self.public_url or self.local_url).rstrip("/")

    @property
    def database(self) -> str:
        return self._database_server or f"sqlite:///{(self.data / 'desirepath.sqlite').resolve()}"

    @property
    def jobs_database(self) -> str:
        """DBOS keeps its own tables: in a file of its own, or in a schema of its own on the database server."""
        if self.database_url and not self.database_url.startswith("sqlite"):
            return str(self._database_server)
        return f"sqlite:///{(self.data / 'jobs.sqlite').resolve()}"

    @property
    def openid_secret(self) -> str:
        """Of the client at the OpenID provider. Raises SettingsError if the file that should hold it does not."""
        if self.openid_client_secret_file is None:
            return self.openid_client_secret
        return _password(self.openid_client_secret_file, "openid_client_secret_file")

    @property
    def prolific_secret(self) -> str:
        """The token at Prolific, empty where there is none. Raises SettingsError as `openid_secret`."""
        if self.prolific_token_file is None:
            return self.prolific_token
        return _password(self.prolific_token_file, "prolific_token_file")

    @property
    def openid_allowed(self) -> frozenset[str]:
        """Domains and addresses of `openid_admits`, in lower case."""
        return frozenset(name.strip().lower().lstrip("@") for name in self.openid_admits.split(",") if name.strip())

    @property
    def _database_server(self) -> str | None:
        """`database_url` with its password. Raises SettingsError if the file that should hold it does not."""
        if not self.database_url or self.database_password_file is None:
            return self.database_url
        scheme, _, rest = self.database_url.partition("://")
        user, at, where = rest.rpartition("@")
        if not at or ":" in user:
            return self.database_url
        return f"{scheme}://{user}:{quote(_password(self.database_password_file), safe='')}@{where}"

    @property
    def artefacts(self) -> str:
        return self.artefacts_url or (self.data / "artefacts").resolve().as_uri()


def in_url(host: str) -> str:
    """A host name or address as it stands before a port: IPv6 addresses in brackets."""
    return f"[{host}]" if ":" in host else host


def _password(file: Path, setting: str = "database_password_file") -> str:
    try:
        password = read_text(file).strip()
    except OSError as problem:
        raise SettingsError(
            f"{setting} = {file}: cannot be read by user {os.getuid()} ({problem.strerror}); let others "
            "read the file (chmod 644) in a folder that only its owner may enter (chmod 700), or give it to that user"
        ) from problem
    except NotUtf8Error as problem:
        raise SettingsError(f"{setting} = {file}: {problem}") from None
    if len(password.splitlines()) != 1:
        raise SettingsError(f"{setting} = {file}: must hold one line, the password")
    return password


@lru_cache
def get_settings() -> Settings:
    """The settings of this process, read once. A data folder that `.env` names is put where `setups.py` looks."""
    settings = Settings()
    if settings.data != Path("data"):
        os.environ.setdefault("DESIREPATH_DATA", str(settings.data))
    return settings
