"""In front of everything: is it for us, from us, and not too often; and what a browser may do with our answers."""

from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from retuner.serve.page_access import PageAccess

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
