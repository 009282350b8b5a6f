"""What the page's browser may ask for. Reading needs nothing; acting needs the token, and goes into an order file."""

import asyncio
import datetime as dt
import json
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from importlib.resources import files
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from retuner.errors import UserError
from retuner.report.what_if import page_script, panel_style, script_hash
from retuner.serve import documents
from retuner.serve.hub import Hub
from retuner.serve.page_access import LASTS_S, PAGE_POLICY, Gate, PageAccess
from retuner.serve.runs import WatchedLoop, WatchedSession
from retuner.session.orders import Order, OrderKind, proposed_gains, put_order
from retuner.session.outputs import REPORT
from retuner.templates import palette

LARGEST = 4096  # bytes of what a browser sends
MOST_STREAMS = 200
CSS, JAVASCRIPT = "text/css; charset=utf-8", "text/javascript; charset=utf-8"
STATIC = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/app.css": ("app.css", CSS),
    "/app.js": ("app.js", JAVASCRIPT),
    "/drawing.js": ("drawing.js", JAVASCRIPT),
    "/uplot.js": ("uPlot.iife.min.js", JAVASCRIPT),
    "/uplot.css": ("uPlot.min.css", CSS),
    "/uplot.licence.txt": ("uPlot.LICENSE", "text/plain; charset=utf-8"),
    "/icon.svg": ("icon.svg", "image/svg+xml"),
}
"""Every file that is served, by its address: nothing else is ever opened for a browser."""


def _served(content: str | bytes, kind: str) -> Callable[[Request], Response]:
    return lambda _: Response(content, headers={"content-type": kind})


class NotTakenError(Exception):
    """A request that is not taken. status : of HTTP."""

    def __init__(self, status: int, reason: str) -> None:
        self.status = status
        super().__init__(reason)


class PageAnswers:
    """The answers.

    hub : looks at the runs. access : who may do what.
    """

    def __init__(self, hub: Hub, access: PageAccess) -> None:
        self._hub, self._access = hub, access
        self._cookie = access.cookie
        self._drawing = asyncio.Lock()
        self._pages: dict[tuple[str, int, int], str] = {}

    def application(self) -> Gate:
        """The whole, behind its gate."""
        static = files("retuner.serve").joinpath("static")
        routes = [
            *(Route(path, _served(static.joinpath(name).read_bytes(), kind)) for path, (name, kind) in STATIC.items()),
            # what the page shares with all others: colours, and the panel that tries settings
            Route("/palette.css", _served(palette(), CSS)),
            Route("/what_if.css", _served(panel_style(), CSS)),
            Route("/what_if.js", _served(page_script(), JAVASCRIPT)),
            Route("/api/what-if/{session}/{number}", self._told(lambda r: documents.tried(*self._loop(r)))),
            Route("/api/overview", self._told(lambda _: documents.overview(self._hub.runs))),
            Route("/api/loop/{session}/{number}", self._told(lambda r: documents.loop_document(*self._loop(r)))),
            Route("/api/trend/{session}/{number}", self._told(self._trend)),
            Route("/api/decision/{session}/{number}/{decision:int}", self._decision),
            Route("/api/ledger/{session}", self._told(self._rows)),
            Route("/api/ledger/{session}/csv", self._csv),
            Route("/report/{session}", self._report),
            Route("/api/stream", self._stream),
            Route("/api/who", self._told(self._who)),
            Route("/api/login", self._login, methods=["POST"]),
            Route("/api/logout", self._logout, methods=["POST"]),
            Route("/api/order", self._order, methods=["POST"]),
        ]
        inner = Starlette(routes=routes, lifespan=self._looking, exception_handlers={NotTakenError: _not_taken})
        return Gate(inner, self._access)

    @asynccontextmanager
    async def _looking(self, _: Starlette) -> AsyncIterator[None]:
        looking = asyncio.create_task(self._hub.run())
        try:
            yield
        finally:
            looking.cancel()

    def _told(self, document: Callable[[Request], object]) -> Callable[[Request], object]:
        async def answer(request: Request) -> Response:
            return JSONResponse(document(request))

        return answer

    def _session(self, request: Request) -> WatchedSession:
        session = self._hub.runs.sessions.get(request.path_params["session"])
        if session is None:
            raise NotTakenError(404, "there is no such session")
        return session

    def _loop(self, request: Request) -> tuple[WatchedSession, WatchedLoop]:
        found = self._hub.runs.loop(f"{request.path_params['session']}/{request.path_params['number']}")
        if found is None:
            raise NotTakenError(404, "there is no such loop")
        return found

    def _trend(self, request: Request) -> object:
        _, loop = self._loop(request)
        asked = request.query_params
        whole = loop.reader.extent()
        from_s, to_s = (_number(asked.get(name), value) for name, value in zip(("from", "to"), whole, strict=True))
        return documents.trend(loop, from_s, to_s, int(_number(asked.get("points"), 1000.0)))

    async def _decision(self, request: Request) -> Response:
        """The page of a decision: drawn once, by one thread at a time."""
        session, loop = self._loop(request)
        decided = session.ledger.decision(loop.name, request.path_params["decision"])
        if decided is None:
            raise NotTakenError(404, "there is no such decision")
        place = (loop.key, decided.number, len(session.ledger.decisions))
        async with self._drawing:
            if place not in self._pages:
                self._pages[place] = await asyncio.to_thread(documents.decision_html, session, loop, decided)
                while len(self._pages) > 32:
                    self._pages.pop(next(iter(self._pages)))
        headers = {"content-security-policy": PAGE_POLICY}
        return Response(self._pages[place], media_type="text/html; charset=utf-8", headers=headers)

    async def _report(self, request: Request) -> Response:
        """The report that a session left; of its scripts only our own runs, the panel that tries settings."""
        session = self._session(request)
        try:
            content = await asyncio.to_thread((session.folder / REPORT).read_bytes)
        except OSError:
            raise NotTakenError(404, "this session has no report yet") from None
        policy = f"{PAGE_POLICY} allow-scripts; script-src '{script_hash()}'"
        return Response(content, media_type="text/html; charset=utf-8", headers={"content-security-policy": policy})

    def _rows(self, request: Request) -> object:
        asked = request.query_params
        return documents.rows(self._session(request).ledger, asked.get("q", "")[:200], int(_number(asked.get("after"))))

    async def _csv(self, request: Request) -> Response:
        session, wanted = self._session(request), request.query_params.get("q", "")[:200]
        text = documents.rows_csv(one for one in session.ledger.told if documents.fits(one, wanted))
        headers = {"content-disposition": 'attachment; filename="ledger.csv"'}
        return Response(text, media_type="text/csv; charset=utf-8", headers=headers)

    async def _stream(self, request: Request) -> Response:
        if self._hub.watchers >= MOST_STREAMS:
            raise NotTakenError(503, "too many pages watch already; close one")
        wanted = request.query_params.getlist("loop") or None
        last = request.headers.get("last-event-id", "")[:40]
        headers = {"content-type": "text/event-stream"}
        return StreamingResponse(self._hub.events(wanted, last), headers=headers)

    def _who(self, request: Request) -> object:
        acting = self._access.may_act(request.cookies.get(self._cookie, ""))  # of a session that goes on
        return {"acting": acting, "read_only": self._access.read_only}

    async def _login(self, request: Request) -> Response:
        body = await _body(request)
        client = request.client.host if request.client else ""
        cookie = self._access.login(_text(body, "token"), client)
        if cookie is None:
            raise NotTakenError(429, "too many tries; wait a minute")
        if not cookie:
            reason = "this page is read-only" if self._access.read_only else "wrong token"
            raise NotTakenError(403, reason)
        answer = JSONResponse({"acting": True})
        self._give(answer, cookie, LASTS_S)
        return answer

    async def _logout(self, request: Request) -> Response:
        self._access.logout(request.cookies.get(self._cookie, ""))
        answer = JSONResponse({"acting": False})
        self._give(answer, "", 0)
        return answer

    def _give(self, answer: Response, cookie: str, lasts_s: float) -> None:
        answer.set_cookie(
            self._cookie,
            cookie,
            max_age=int(lasts_s),
            path="/",
            secure=self._access.secure,
            httponly=True,
            samesite="strict",
        )

    async def _order(self, request: Request) -> Response:
        """A person's order, put where the session looks for it; its effect stands in the ledger first."""
        cookie = request.cookies.get(self._cookie, "")
        if not self._access.may_act(cookie):
            raise NotTakenError(401, "give the token first: it was printed when the page was started")
        client = request.client.host if request.client else ""
        if not self._access.orders.take(client):
            raise NotTakenError(429, "too many requests; wait a moment")
        body = await _body(request)
        found = self._hub.runs.loop(_text(body, "loop"))
        if found is None:
            raise NotTakenError(404, "there is no such loop")
        session, loop = found
        if session.ledger.ended:
            raise NotTakenError(409, "this session has ended: nothing can be changed any more")
        if session.ledger.broken:
            raise NotTakenError(409, f"the ledger cannot be trusted: {session.ledger.broken}")
        decision = body.get("decision", 0)
        if type(decision) is not int:
            raise NotTakenError(400, "decision must be a whole number")
        texts = {name: _text(body, name) for name in ("by", "note", "digest", "region", "mode")}
        now = dt.datetime.now(dt.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        try:
            kind, gains = OrderKind(_text(body, "order")), proposed_gains(body.get("gains"))
            order = Order(kind, at=now, decision=decision, gains=gains, **texts)
        except ValueError as error:
            raise NotTakenError(400, str(error)) from None
        if order.region and order.region not in loop.regions:
            raise NotTakenError(404, f"there is no region {order.region}; there are {', '.join(loop.regions)}")
        try:
            file = await asyncio.to_thread(put_order, loop.order_folder(session.folder), order)
        except UserError as error:
            raise NotTakenError(429, str(error)) from None
        except OSError as error:
            raise NotTakenError(500, f"the order cannot be put into the session's folder: {error.strerror}") from None
        self._access.acted(cookie)
        answer = JSONResponse({"order": str(order.kind), "file": file.name})
        self._give(answer, cookie, LASTS_S)
        return answer


def _not_taken(_: Request, error: Exception) -> Response:
    return PlainTextResponse(f"{error}\n", status_code=error.status if isinstance(error, NotTakenError) else 500)


async def _body(request: Request) -> dict[str, Any]:
    """The JSON object that a browser sent, of at most LARGEST bytes."""
    raw = b""
    async for part in request.stream():
        raw += part
        if len(raw) > LARGEST:
            raise NotTakenError(413, f"more than {LARGEST} bytes")
    try:
        body = json.loads(raw)
    except (ValueError, RecursionError):
        raise NotTakenError(400, "this is no JSON") from None
    if not isinstance(body, dict):
        raise NotTakenError(400, "this is no JSON object")
    return body


def _text(body: dict[str, Any], name: str) -> str:
    value = body.get(name, "")
    if not isinstance(value, str):
        raise NotTakenError(400, f"{name} must be text")
    return value


def _number(text: str | None, otherwise: float = 0.0) -> float:
    if text is None:
        return otherwise
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise NotTakenError(400, "a number of this address cannot be read")
    return value
