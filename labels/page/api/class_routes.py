"""The workspace's classes: read, and written as a whole.

``GET /api/classes`` answers ``classes`` in order (name, obstacle, color, key, description, parent,
``labels``, how many patches of the workspace have it, and whether it was ever ``given``),
``setup``, and why they are ``fixed``. ``POST /api/classes`` takes the list without ``labels`` and
``given``, and the ``setup`` it was made from; a class that was ever given stays, and stays an
obstacle or clear: an undo may bring its labels back. All pages then load the mission anew.
"""

from collections import Counter
from typing import Any

from fastapi import APIRouter
from starlette.responses import Response

from tokt.features.common.atomic import NotDurableError, write_text
from tokt.features.common.errors import ToktError, os_errors_as
from tokt.labels.page.state.session import Session
from tokt.labels.taxonomy import FILE_NAME, FORMAT, Taxonomy

from .messages import Body, Name, SessionOf, Who, json_response, refuse, refuse_blind

router = APIRouter(prefix="/api")


class ClassesBody(Body):
    """All classes in their order, from somebody."""

    who: Name | None = None
    setup: str
    classes: list[dict[str, Any]]


@router.get("/classes")
def get_classes(session: SessionOf, who: Who | None = None) -> Response:
    """The classes in force, and how often each is used; to the blind, how often by themselves."""
    who = who or session.annotator
    used = _used(session, who)
    ever = {*+used} if who in session.blind else session.store.labels_ever()
    classes = [
        {**vars(known), "labels": used[known.name], "given": known.name in ever}
        for known in session.taxonomy.classes
    ]
    return json_response({"classes": classes, "setup": session.setup, "fixed": _fixed(session)})


@router.post("/classes")
def post_classes(session: SessionOf, body: ClassesBody) -> Response:
    """Put other classes in force, and into the workspace's file."""
    with session.changing:
        if _fixed(session):
            raise refuse(409, _fixed(session))
        if body.setup != session.setup:
            raise refuse(409, "the classes were changed meanwhile: look at them again")
        try:
            taxonomy = Taxonomy.from_json({"format": FORMAT, "classes": body.classes}, "classes")
            text = taxonomy.to_toml()
            text.encode()
        except (ToktError, UnicodeEncodeError) as error:
            raise refuse(400, str(error)) from None
        _check_used(session, taxonomy, body.who or session.annotator)
        file = session.store.path.parent / FILE_NAME
        with os_errors_as(str(file)):
            try:
                write_text(file, text)
            except NotDurableError:
                session.use_taxonomy(taxonomy)
                raise
        session.use_taxonomy(taxonomy)
    return get_classes(session, body.who)


def _fixed(session: Session) -> str:
    given = session.taxonomy_file
    return f"tokt label was started with --taxonomy {given}: change that file" if given else ""


def _used(session: Session, who: str) -> Counter[str]:
    if who in session.blind:
        return Counter(session.board.counts(who))
    used = Counter(str(record.label) for record in session.store.settled())
    for entry in session.store.stats():
        used.update(entry.counts)
    return used


def _check_used(session: Session, taxonomy: Taxonomy, who: str) -> None:
    ever, used = session.store.labels_ever(), _used(session, who)
    kinds = {known.name: known.obstacle for known in taxonomy.classes}
    for known in session.taxonomy.classes:
        name, n = known.name, used[known.name]
        if kinds.get(name) == known.obstacle:
            continue
        refuse_blind(who in session.blind, 409)
        if name in ever:
            was = f" {'an obstacle' if known.obstacle else 'clear'}" if name in kinds else ""
            said = f"{n} patches are labelled {name}" if n else f"{name} was given before"
            raise refuse(409, f"{said}, so it stays{was}")
