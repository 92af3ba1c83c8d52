"""Jobs through the page: other commands of `tokt`, on this mission's labels.

``POST /api/job`` with ``{"what": "audit"}`` audits the labels; ``{"what": "model"}`` trains a model
of them, exports it into the workspace's ``models/``, and suggests what it says. ``GET /api/job``
answers how it goes, with the last lines printed and the ``result``; so does ``job`` of the status
event, without them. ``POST /api/job/cancel``.
"""

from collections.abc import Sequence
from typing import Literal

from fastapi import APIRouter
from starlette.responses import Response

from tokt.labels.page.state.session import Session, own_model_file
from tokt.models.bundle.bundle import read_bundle

from .messages import Blind, Body, Name, SessionOf, json_response, refuse_blind

router = APIRouter(prefix="/api")


class CancelBody(Body):
    """Who wants a job to end."""

    who: Name | None = None


class JobBody(CancelBody):
    """What to do, and who wants it."""

    what: Literal["audit", "model"]


@router.get("/job")
def get_job(session: SessionOf, blind: Blind) -> Response:
    """The job that is running, or the last one."""
    refuse_blind(blind)
    return _job(session)


@router.post("/job")
def post_job(session: SessionOf, body: JobBody) -> Response:
    """Start a job; one at a time."""
    refuse_blind((body.who or session.annotator) in session.blind)
    workspace, mission = session.store.path.parent, session.mission
    file = own_model_file(workspace, mission)
    name, path = file.stem, mission.path.resolve()
    named = str(path) if mission.name in (path.name, path.stem) else f"{mission.name}={path}"
    own = ("--taxonomy", str(session.taxonomy_file)) if session.taxonomy_file else ()
    build = ("dataset", "build", name, "--mission", named, "--grid", str(session.grid), *own)
    steps: list[Sequence[str]] = [build]
    if body.what == "audit":
        steps.append(("labels", "audit", name))
    else:
        steps += [("train", name, "--name", name), ("export", name, "--output", str(file))]

    def then() -> None:
        if body.what == "model":
            session.use_model(read_bundle(file))

    session.jobs.start(
        body.what, [(*step, "--workspace", str(workspace.resolve())) for step in steps], then
    )
    return _job(session)


@router.post("/job/cancel")
def post_cancel(session: SessionOf, body: CancelBody) -> Response:
    """End the job that is running."""
    refuse_blind((body.who or session.annotator) in session.blind)
    session.jobs.cancel()
    return _job(session)


def _job(session: Session) -> Response:
    last = session.jobs.last
    if last is None:
        return json_response({"job": None})
    printed = {"lines": list(last.lines), "result": last.result}
    return json_response({"job": {**last.to_json(), **printed}})
