"""The provider of an OpenID Connect sign-in: discovery, the address that a browser is sent to, and who came back.

Authorization code with PKCE. What comes back is checked here (signature, issuer, audience, time, nonce); whose account
that is stands in `admission_by_openid.py`, the routes in `lab/openid_pages.py`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any
from urllib.parse import quote_plus, urlsplit

import httpx

from desirepath.settings import Settings

if TYPE_CHECKING:
    from joserfc.jwk import KeySet

ALGORITHMS = ["RS256", "PS256", "ES256", "Ed25519", "EdDSA"]  # never `none`, never one with the client's own secret
SCOPES = "openid email profile"
KEPT_S = 3600.0  # how long what the provider says of itself is believed
PATIENCE_S = 10.0
SLOW_S = 2.0  # ours; whoever answers with nothing for so long ...
AWAY_FOR_S = 20.0  # ours; ... is not asked again for that long: every click would hold one of the server's threads
LEEWAY_S = 60  # clocks that are off
LARGEST = 512 * 1024  # bytes of an answer; the largest key sets have some ten kB
LOOPBACK = ("127.0.0.1", "localhost", "::1")


class OpenIdError(Exception):
    """A sign-in by the provider that cannot go on. `code`: a key below `account.openid.problems`; its text: for the
    log, without tokens."""

    def __init__(self, code: str, detail: str) -> None:
        self.code = code
        super().__init__(f"{code}: {detail}")


@dataclass(frozen=True)
class Provider:
    """What its discovery document says."""

    issuer: str
    authorization_endpoint: str
    token_endpoint: str
    jwks_uri: str
    basic: bool  # whether the client says its secret in the header, else in the body
    names_itself: bool  # RFC 9207: its answers carry `iss`


@dataclass(frozen=True)
class Someone:
    """Who the provider says somebody is. `email`: lower case, empty where it tells none."""

    issuer: str
    subject: str
    email: str
    email_verified: bool
    wanted_name: str


class OpenId:
    """The provider of this installation. Raises RuntimeError where the libraries that it needs are not installed."""

    def __init__(self, settings: Settings) -> None:
        if find_spec("authlib") is None or find_spec("joserfc") is None:
            raise RuntimeError("DESIREPATH_OPENID_ISSUER needs more packages: pip install 'desirepath[openid]'")
        self.name = settings.openid_name
        self._issuer = settings.openid_issuer.rstrip("/")
        self._client_id = settings.openid_client_id
        self._secret = settings.openid_secret
        self._trusts_email = settings.openid_trusts_email
        self._lock = threading.Lock()
        self._known: tuple[float, Provider, KeySet] | None = None
        self._away: tuple[float, str] | None = None

    def address(self, redirect: str, *, state: str, nonce: str, verifier: str) -> str:
        """Where the browser is sent. Raises OpenIdError."""
        from authlib.common.urls import add_params_to_uri
        from authlib.oauth2.rfc7636 import create_s256_code_challenge

        asked = {
            "response_type": "code",
            "client_id": self._client_id,
            "redirect_uri": redirect,
            "scope": SCOPES,
            "state": state,
            "nonce": nonce,
            "code_challenge": create_s256_code_challenge(verifier),
            "code_challenge_method": "S256",
        }
        return str(add_params_to_uri(self._provider()[0].authorization_endpoint, list(asked.items())))

    def someone(self, code: str, redirect: str, *, nonce: str, verifier: str, issuer: str | None) -> Someone:
        """Who came back with this code. issuer: as the answer names it, where it does. Raises OpenIdError."""
        provider, _ = self._provider()
        named = issuer is not None or provider.names_itself
        if named and (issuer or "").rstrip("/") != provider.issuer.rstrip("/"):
            raise OpenIdError("failed", f"the answer is of the issuer {issuer!r}, not of {provider.issuer}")
        form = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": redirect,
            "code_verifier": verifier,
            "client_id": self._client_id,
        }
        basic = None
        if provider.basic and self._secret:  # both percent-encoded: RFC 6749, 2.3.1
            basic = httpx.BasicAuth(quote_plus(self._client_id), quote_plus(self._secret))
        if self._secret and not provider.basic:
            form["client_secret"] = self._secret
        answered = _json_of("POST", provider.token_endpoint, data=form, auth=basic)
        id_token = answered.get("id_token")
        if not isinstance(id_token, str):
            raise OpenIdError("failed", "the token endpoint gave no id_token")
        return self._someone(self._claims(id_token, nonce, answered.get("access_token")))

    def _claims(self, id_token: str, nonce: str, access_token: object) -> Mapping[str, Any]:
        from authlib.oidc.core import CodeIDToken
        from joserfc import jwt
        from joserfc.errors import JoseError

        provider, keys = self._provider()
        try:
            try:
                token = jwt.decode(id_token, keys, algorithms=ALGORITHMS)
            except (JoseError, ValueError):  # perhaps signed by a key that is newer than what is known
                provider, keys = self._provider(refresh=True)
                token = jwt.decode(id_token, keys, algorithms=ALGORITHMS)
            claims = CodeIDToken(
                token.claims,
                token.header,
                {
                    "iss": {"essential": True, "value": provider.issuer},
                    "aud": {"essential": True, "value": self._client_id},
                },
                {"nonce": nonce, "client_id": self._client_id, "access_token": access_token},
            )
            claims.validate(int(time.time()), LEEWAY_S)
        except (JoseError, ValueError) as problem:
            raise OpenIdError("failed", f"the id_token is refused: {type(problem).__name__}: {problem}") from None
        return dict(claims)

    def _someone(self, claims: Mapping[str, Any]) -> Someone:
        subject, email = claims["sub"], claims.get("email")
        if not isinstance(subject, str) or not 0 < len(subject) <= 255:  # OpenID Connect Core, 2
            raise OpenIdError("failed", "the id_token's subject is no text of 1 to 255 characters")
        email = email.strip().lower() if isinstance(email, str) and len(email) <= 254 else ""
        verified = claims.get("email_verified") is True or (self._trusts_email and "email_verified" not in claims)
        wanted = claims.get("preferred_username")
        wanted = email.partition("@")[0] or (wanted if isinstance(wanted, str) else "")
        return Someone(claims["iss"], subject, email, bool(email) and verified, wanted)

    def _provider(self, *, refresh: bool = False) -> tuple[Provider, KeySet]:
        """What the provider says of itself, and its keys; asked for once an hour."""
        with self._lock:
            began = time.monotonic()
            if not refresh and self._known is not None and began - self._known[0] < KEPT_S:
                return self._known[1:]
            if self._away is not None and began - self._away[0] < AWAY_FOR_S:
                raise OpenIdError("away", self._away[1])
            try:
                self._known = time.monotonic(), *self._asked()
            except OpenIdError as problem:
                slow = time.monotonic() - began >= SLOW_S
                self._away = (time.monotonic(), str(problem)) if slow else None
                raise
            return self._known[1:]

    def _asked(self) -> tuple[Provider, KeySet]:
        from joserfc.errors import JoseError
        from joserfc.jwk import KeySet

        document = _json_of("GET", f"{self._issuer}/.well-known/openid-configuration")
        if str(document.get("issuer", "")).rstrip("/") != self._issuer:
            raise OpenIdError("away", f"the provider calls itself {document.get('issuer')!r}, not {self._issuer}")
        methods = document.get("token_endpoint_auth_methods_supported", ["client_secret_basic"])
        provider = Provider(
            str(document["issuer"]),
            self._endpoint(document, "authorization_endpoint"),
            self._endpoint(document, "token_endpoint"),
            self._endpoint(document, "jwks_uri"),
            "client_secret_basic" in methods,
            document.get("authorization_response_iss_parameter_supported") is True,
        )
        try:
            keys = KeySet.import_key_set(_json_of("GET", provider.jwks_uri))  # type: ignore[arg-type]
        except (JoseError, ValueError, KeyError, TypeError) as problem:
            raise OpenIdError("away", f"its keys cannot be read: {problem}") from None
        return provider, keys

    def _endpoint(self, document: Mapping[str, Any], name: str) -> str:
        address = str(document.get(name, ""))
        if not is_safe(address):
            raise OpenIdError("away", f"its {name} = {address!r} is no https address")
        return address


def is_safe(address: str) -> bool:
    """Whether nobody on the way can read what is sent there: https, or this machine itself."""
    parts = urlsplit(address)
    return parts.scheme == "https" or (parts.scheme == "http" and parts.hostname in LOOPBACK)


def _json_of(method: str, address: str, **sent: Any) -> dict[str, Any]:
    """The JSON object that is answered. Raises OpenIdError, whose text holds nothing of what was sent."""
    where = urlsplit(address)._replace(query="").geturl()
    try:
        with (
            httpx.Client(timeout=PATIENCE_S, follow_redirects=False) as client,
            client.stream(method, address, headers={"Accept": "application/json"}, **sent) as answer,
        ):
            body = b""
            for part in answer.iter_bytes():
                body += part
                if len(body) > LARGEST:
                    raise OpenIdError("away", f"{where} answered with more than {LARGEST} bytes")
            if not answer.is_success:
                code = "failed" if method == "POST" and answer.status_code < 500 else "away"
                raise OpenIdError(code, f"{where} answered {answer.status_code}")
            found = httpx.Response(200, content=body).json()
    except (httpx.HTTPError, ValueError) as problem:
        raise OpenIdError("away", f"{where}: {type(problem).__name__}") from None
    if not isinstance(found, dict):
        raise OpenIdError("away", f"{where} answered with no JSON object")
    return found
