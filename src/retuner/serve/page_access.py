"""Who may do what: hosts and origins that are ours, a token that lets a person act, limits of rate.

The token is told once, at the start, on the screen; it is never logged and only compared in constant time. Whoever has
given it gets a session cookie that no script can read, that no other site's page can send, and that ends soon.
"""

import hashlib
import hmac
import secrets
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from typing import Any

from retuner.schedule.late_dataclass import dataclass

LASTS_S = 900.0  # A session ends so long after its last act
LONGEST_S = 8 * 3600.0  # longest time after it began: a shift
MOST_SESSIONS = 100
MOST_CLIENTS = 10_000  # Addresses of which the rate is remembered


class Bucket:
    """Limits how often: `burst` at once, then `per_s` a second, for each client apart.

    now_s : a monotonic clock.
    """

    def __init__(self, per_s: float, burst: float, now_s: Callable[[], float]) -> None:
        self._per_s, self._burst, self._now_s = per_s, burst, now_s
        self._left: dict[str, tuple[float, float]] = {}

    def take(self, client: str) -> bool:
        """Whether one more is allowed now."""
        now_s = self._now_s()
        left, at_s = self._left.pop(client, (self._burst, now_s))
        left = min(left + (now_s - at_s) * self._per_s, self._burst)
        while len(self._left) >= MOST_CLIENTS:
            self._left.pop(next(iter(self._left)))
        self._left[client] = (left - 1.0 if left >= 1.0 else left, now_s)
        return left >= 1.0


@dataclass(frozen=True, slots=True)
class SignedIn:
    """A person who has given the token. Times by the monotonic clock."""

    began_s: float
    acted_s: float


class PageAccess:
    """See the head of this file.

    hosts : values of the Host header that are ours. secure : whether TLS is spoken. read_only : nobody may act.
    now_s : a monotonic clock. port : ours; cookies are shared by all ports of a host, so ours is named by it.
    """

    def __init__(
        self, hosts: Iterable[str], now_s: Callable[[], float], *, secure: bool, read_only: bool, port: int
    ) -> None:
        self.cookie = f"retuner_{port}"
        self.hosts = frozenset(host.lower() for host in hosts)
        self.origins = frozenset(f"{'https' if secure else 'http'}://{host}" for host in self.hosts)
        self.secure, self.read_only = secure, read_only
        self.token = secrets.token_urlsafe(24)
        self.requests = Bucket(50.0, 400.0, now_s)
        self.orders = Bucket(1.0, 64.0, now_s)
        self._tries = Bucket(1 / 12, 5.0, now_s)
        self._now_s = now_s
        self._sessions: dict[str, SignedIn] = {}

    def login(self, token: str, client: str) -> str | None:
        """A new session's cookie for the right token; empty for a wrong one, None when there were too many tries."""
        if not self._tries.take(client):
            return None
        if not hmac.compare_digest(token.encode("utf-8", "replace"), self.token.encode()) or self.read_only:
            return ""
        cookie = secrets.token_urlsafe(24)
        while len(self._sessions) >= MOST_SESSIONS:
            self._sessions.pop(next(iter(self._sessions)))
        now_s = self._now_s()
        self._sessions[_digest(cookie)] = SignedIn(now_s, now_s)
        return cookie

    def may_act(self, cookie: str) -> bool:
        """Whether a cookie is of a session that goes on; an old one is forgotten."""
        session = self._sessions.get(_digest(cookie))
        if session is None:
            return False
        now_s = self._now_s()
        if now_s - session.acted_s > LASTS_S or now_s - session.began_s > LONGEST_S:
            del self._sessions[_digest(cookie)]
            return False
        return True

    def acted(self, cookie: str) -> None:
        """A session goes on from now."""
        session = self._sessions.get(_digest(cookie))
        if session is not None:
            self._sessions[_digest(cookie)] = SignedIn(session.began_s, self._now_s())

    def logout(self, cookie: str) -> None:
        """End a session."""
        self._sessions.pop(_digest(cookie), None)


def _digest(cookie: str) -> str:
    """What is kept of a cookie: looking it up tells nothing of the others."""
    return hashlib.sha256(cookie.encode("utf-8", "replace")).hexdigest()


# ---- In front of everything: is it for us, from us, and not too often

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""No script, style or picture but our own files; nobody puts us into a frame."""
PAGE_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'self'; sandbox"
)
"""Policy of a decision's page: it stands in our frame, has its styles inside, and runs no script at all."""
HEADERS = {
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"no-referrer",
    b"cross-origin-opener-policy": b"same-origin",
    b"cross-origin-resource-policy": b"same-origin",
    b"cache-control": b"no-store",
}
OURS = {"same-origin", "none", ""}
"""What Sec-Fetch-Site says where no other site is behind a request; empty: not told, as by a program."""


class Gate:
    """Lets through what may pass.

    inner : the application. access : hosts, origins and rates.
    """

    def __init__(self, inner: Application, access: PageAccess) -> None:
        self._inner, self._access = inner, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
        if scope["type"] == "lifespan":
            await self._inner(scope, receive, send)
            return
        if scope["type"] != "http":  # we speak no websocket
            await send({"type": "websocket.close", "code": 1008})
            return

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                # the headers of an answer with those that every answer has
                given = [(bytes(name).lower(), bytes(value)) for name, value in message.get("headers", [])]
                names = {name for name, _ in given}
                ours = [*HEADERS.items(), (b"content-security-policy", POLICY.encode())]
                message["headers"] = given + [(name, value) for name, value in ours if name not in names]
            await send(message)

        refused = self._refusal(scope)
        if refused is None:
            await self._inner(scope, receive, guarded)
            return
        status, reason = refused
        kind = [(b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close")]
        await guarded({"type": "http.response.start", "status": status, "headers": kind})
        await guarded({"type": "http.response.body", "body": f"{reason}\n".encode()})

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        headers: dict[bytes, bytes] = {}
        for name, value in scope["headers"]:
            if name in headers and name in {b"host", b"origin"}:
                return 400, "a header comes twice"
            headers[name] = value
        if headers.get(b"host", b"").decode("latin-1").lower() not in self._access.hosts:
            return 421, "unknown host name; open the address that `retuner serve` printed"
        origin = headers.get(b"origin", b"").decode("latin-1").lower()
        site = headers.get(b"sec-fetch-site", b"").decode("latin-1")
        acts = scope["method"] not in {"GET", "HEAD"}
        if (origin and origin not in self._access.origins) or (acts and not origin):
            return 403, "a page of another site may not ask for this"
        if (acts or scope["path"] != "/") and site not in OURS:
            return 403, "a page of another site may not ask for this"
        if not self._access.requests.take((scope.get("client") or ("", 0))[0]):
            return 429, "too many requests; wait a moment"
        return None
