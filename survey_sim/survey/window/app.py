"""The window's web application: for this machine only, one page, a few addresses.

It listens on the loopback address alone, answers only to its own name (so that no page of another site can reach it under
a name of that site), and takes work only from its own page.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import AsyncIterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import FormData, UploadFile
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from survey_sim.allocation import ALGORITHMS
from survey_sim.errors import InputError
from survey_sim.extensions import known_names
from survey_sim.instrument import PRESETS, load_instrument
from survey_sim.routing import ROUTER_NAMES
from survey_sim.survey.window.jobs import Job, Jobs, Wish

HOST = "127.0.0.1"
N_BYTES_UPLOAD_MAX = 512 << 20
N_FILES_MAX = 200
_FOLDER = Path(__file__).resolve().parent
_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "connect-src 'self'; frame-src 'self'; img-src data:"
)
# Files that may be sent along, to be found beside the others.
_BESIDE = {"catalogue.xml", "system_parameters.xml", "starbugs.xml", "stow.xml"}


_FORBIDDEN = JSONResponse({"error": "only the window's own page may ask for this"}, status_code=403)


def make_app(sources: Sequence[Path] = ()) -> Starlette:
    """The application.

    Parameters
    ----------
    sources
        Files and run folders of this machine that the window offers besides uploads.
    """
    offered = {str(number): path.resolve() for number, path in enumerate(sources)}
    for path in offered.values():
        if not path.exists():
            raise InputError("no such file or folder", file=path, remedy="check the path")
    window = _Window(offered)
    return Starlette(
        routes=[
            Route("/", window.page),
            Route("/jobs", window.begin, methods=["POST"]),
            Route("/jobs/{number:int}", window.report),
            Route("/jobs/{number:int}/cancel", window.cancel, methods=["POST"]),
            Route("/jobs/{number:int}/player", window.player),
            Route("/jobs/{number:int}/run.zip", window.archive),
        ],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])],
        lifespan=window.lifespan,
    )


def serve(sources: Sequence[Path] = (), port: int = 8050) -> None:
    """Serve the window on this machine until interrupted."""
    import uvicorn  # noqa: PLC0415

    uvicorn.run(make_app(sources), host=HOST, port=port, log_level="warning")


class _Window:
    """Answers of the application."""

    def __init__(self, offered: Mapping[str, Path]) -> None:
        self.offered = offered
        self.jobs = Jobs()

    @contextlib.asynccontextmanager
    async def lifespan(self, _: Starlette) -> AsyncIterator[None]:
        """Jobs live as long as the application."""
        yield
        self.jobs.close()

    async def page(self, _: Request) -> Response:
        """The window."""
        environment = Environment(autoescape=True, undefined=StrictUndefined, loader=FileSystemLoader(_FOLDER))
        constants = load_instrument("taipan-150")
        text = environment.get_template("window.html").render(
            style=Markup((_FOLDER / "window.css").read_text(encoding="utf-8")),
            script=Markup((_FOLDER / "window.js").read_text(encoding="utf-8")),
            offered={key: str(path) for key, path in self.offered.items()},
            instruments=list(PRESETS),
            algorithms=known_names("allocator", ALGORITHMS),
            routers=known_names("router", ROUTER_NAMES),
            constants=constants,
        )
        return HTMLResponse(text, headers={"Content-Security-Policy": _POLICY})

    async def begin(self, request: Request) -> Response:
        """Take files and wishes, and begin a job."""
        if not _is_own_page(request):
            return _FORBIDDEN
        if int(request.headers.get("content-length", N_BYTES_UPLOAD_MAX + 1)) > N_BYTES_UPLOAD_MAX:
            return JSONResponse({"error": f"more than {N_BYTES_UPLOAD_MAX >> 20} MiB"}, status_code=413)
        async with request.form(max_files=N_FILES_MAX, max_fields=40) as form:
            try:
                job = await self._begin(form)
            except InputError as fault:
                return JSONResponse({"error": str(fault)}, status_code=400)
        return JSONResponse(job.report())

    async def _begin(self, form: FormData) -> Job:
        own = {key: value for key, value in form.multi_items() if isinstance(value, str) and value.strip()}
        offered = own.pop("offered", None)
        wish = Wish.load(_typed(own), section="form")
        number, folder = self.jobs.reserve()
        files = [await _save(file, folder) for file in form.getlist("files") if _is_sent(file)]
        starts = [await _save(file, folder / "start") for file in form.getlist("start") if _is_sent(file)]
        if offered is not None:
            if offered not in self.offered:
                raise InputError("no such choice", place="offered")
            files = [self.offered[offered]]
        elif wish.source != "targets":
            files = [path for path in files if path.name not in _BESIDE]
        if not files:
            raise InputError("no file chosen", place="files", remedy="choose files to upload")
        return self.jobs.begin(Job(number, folder, wish, sorted(files), starts[0] if starts else None))

    async def report(self, request: Request) -> Response:
        """How far a job is."""
        job = self._job(request)
        return JSONResponse({"error": "no such job"}, status_code=404) if job is None else JSONResponse(job.report())

    async def cancel(self, request: Request) -> Response:
        """End a job."""
        if not _is_own_page(request):
            return _FORBIDDEN
        job = self._job(request)
        if job is None:
            return JSONResponse({"error": "no such job"}, status_code=404)
        await run_in_threadpool(self.jobs.cancel, job)
        return JSONResponse(job.report())

    async def player(self, request: Request) -> Response:
        """The player's page of a finished job."""
        job = self._job(request)
        if job is None or job.state != "done":
            return JSONResponse({"error": "no such page"}, status_code=404)
        return HTMLResponse(job.page)

    async def archive(self, request: Request) -> Response:
        """Tables, exchange files and CSV of a finished job."""
        job = self._job(request)
        if job is None or job.state != "done":
            return JSONResponse({"error": "no such run"}, status_code=404)
        headers = {"Content-Disposition": f'attachment; filename="field-{job.number}.zip"'}
        return Response(job.archive(), media_type="application/zip", headers=headers)

    def _job(self, request: Request) -> Job | None:
        return self.jobs.get(request.path_params["number"])


def _is_own_page(request: Request) -> bool:
    """Whether the window's own page asks, or a program that is no browser."""
    origin = request.headers.get("origin")
    return origin is None or origin == f"http://{request.headers['host']}"


def _typed(fields: Mapping[str, str]) -> dict[str, Any]:
    """Form fields as numbers where numbers are meant; what is not one is left for the settings to refuse."""
    typed: dict[str, Any] = {}
    for key, text in fields.items():
        typed[key] = text.strip()
        if key not in {"source", "instrument", "algorithm", "router"}:
            with contextlib.suppress(ValueError):
                typed[key] = int(text) if key == "visits" else float(text)
    return typed


def _is_sent(file: UploadFile | str) -> bool:
    return isinstance(file, UploadFile) and bool(file.filename)


async def _save(file: UploadFile | str, folder: Path) -> Path:
    """Write an upload under a harmless form of its name."""
    if isinstance(file, str):
        raise InputError("is text, not a file", place="files")
    name = re.sub(r"[^A-Za-z0-9._-]", "_", Path(file.filename or "file").name).lstrip(".") or "file"
    folder.mkdir(exist_ok=True)
    path = folder / name
    with path.open("wb") as out:
        while block := await file.read(1 << 20):
            out.write(block)
    return path
