"""Who may ask, for how much: tokens, hosts, sizes, and what a browser may load."""

import hmac
import json
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any, TypeAlias
from urllib.parse import parse_qs, urlsplit

from fastapi import HTTPException

Scope: TypeAlias = MutableMapping[str, Any]
Message: TypeAlias = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
ASGIApp = Callable[[Scope, Receive, Send], Awaitable[None]]

LOCAL = ("127.0.0.1", "localhost", "::1")
"""Names of this machine."""

COOKIE = "angie_token"

HEADERS = {
    "content-security-policy": "default-src 'self'; script-src 'self' 'unsafe-inline' "
    "'unsafe-eval' blob:; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "media-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' data: blob:; "
    "worker-src 'self' blob:; frame-ancestors 'none'; form-action 'self'; base-uri 'self'",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}
"""A browser loads nothing from elsewhere, whatever a page says."""

OPEN = ("/health",)
"""Paths for which no token is needed."""


class Guard:
    """Stands before an application (ASGI) and lets through what is allowed.

    Args:
        app: the application.
        token: that must be given, as `Authorization: Bearer TOKEN`, as a cookie, or once as
            `?token=TOKEN`, which sets the cookie; None where none is needed.
        body: most bytes of a request.
        local: answer to names of this machine alone, so that no other site's name can be led here.
    """

    def __init__(self, app: ASGIApp, *, token: str | None, body: int, local: bool) -> None:
        self.app, self.token, self.body, self.local = app, token, body, local

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or hand it on."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {key.decode("latin-1").lower(): value.decode("latin-1")
                   for key, value in scope["headers"]}  # fmt: skip
        refused = self._refused(scope, headers)
        if refused is not None:
            await _answer(scope, send, *refused)
            return
        query = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[0]
        cookie = query if self.token and self._right(query) else ""
        counted = _Counted(receive, self.body, self._too_large())
        await self.app(scope, counted, _Sent(send, cookie))

    def _refused(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str] | None:
        host = headers.get("host", "")
        name = urlsplit(f"//{host}").hostname or ""
        if self.local and name not in LOCAL:
            return 403, "this address answers to localhost alone"
        origin = headers.get("origin")
        if origin not in (None, "null") and urlsplit(origin).netloc != host:
            return 403, "requests of other sites are not answered"
        if self.token and scope["path"] not in OPEN and not self._known(scope, headers):
            return 401, "give the token, as 'Authorization: Bearer TOKEN' or ?token=TOKEN"
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > self.body:
            return 413, self._too_large()
        return None

    def _too_large(self) -> str:
        return f"give at most {self.body / 1e6:g} MB in all"

    def _known(self, scope: Scope, headers: dict[str, str]) -> bool:
        """Whether the token is given in one of the three ways."""
        kind, _, given = headers.get("authorization", "").partition(" ")
        if kind.lower() == "bearer" and self._right(given.strip()):
            return True
        cookie: SimpleCookie = SimpleCookie()
        try:
            cookie.load(headers.get("cookie", ""))
        except CookieError:
            cookie.clear()
        if COOKIE in cookie and self._right(cookie[COOKIE].value):
            return True
        query = parse_qs(scope["query_string"].decode("latin-1"))
        return self._right(query.get("token", [""])[0])

    def _right(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), (self.token or "").encode())


class _Counted:
    """What comes in, until it is too much."""

    def __init__(self, receive: Receive, most: int, refusal: str) -> None:
        self.receive, self.left, self.refusal = receive, most, refusal

    async def __call__(self) -> Message:
        message = await self.receive()
        self.left -= len(message.get("body", b""))
        if self.left < 0:
            raise HTTPException(413, self.refusal)
        return message


class _Sent:
    """What goes out, with the headers of every answer."""

    def __init__(self, send: Send, cookie: str) -> None:
        self.send, self.cookie = send, cookie

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            more = [(key.encode(), value.encode()) for key, value in HEADERS.items()]
            if self.cookie:
                text = f"{COOKIE}={self.cookie}; HttpOnly; SameSite=Strict; Path=/"
                more.append((b"set-cookie", text.encode()))
            message = {**message, "headers": [*message["headers"], *more]}
        await self.send(message)


async def _answer(scope: Scope, send: Send, status: int, text: str) -> None:
    """A short answer in JSON, or a websocket that is closed."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 4000 + status, "reason": text})
        return
    body = json.dumps({"detail": text}).encode()
    headers: list[Any] = [(b"content-type", b"application/json")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
