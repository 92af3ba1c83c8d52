"""Count the hand-written prose and list its long sentences: ``python docs/prose.py [PAGE...]``.

Without a page all that the program says is read as well.

Prose is README, CONTRIBUTING, the pages and notebooks of docs/ and the thesis page's template.
Tables, code blocks and pages made by a program are not counted; the glossary's tables are, as
they are all it has. In the cells of all tables the sentences are short, too.

What the program says is its help, its HTML pages and the strings of their scripts. So is every
text in its modules that is no docstring: errors, reasons, findings, lines. Of docstrings, those of
public names are read: the site's reference shows them.

A sentence ends at a full stop, a question mark or an exclamation mark, never at a colon or a
semicolon. A heading, an item of a list, a cell and a paragraph are sentences of their own. A code
span, a link's address left out, and a field of an f-string are each one word.
"""

import ast
import importlib
import inspect
import json
import re
import sys
import textwrap
from collections.abc import Iterable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, NamedTuple

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[1]
MAX_WORDS = 15_500
MAX_SENTENCE = 25
TEMPLATE = "studies/src/tokt_studies/thesis/page.md.in"
MADE = ("docs/thesis.md",)
"""Made by a program from the template."""
GLOSSARY = "docs/glossary.md"
PUBLIC = ("tokt", "tokt.sklearn", "tokt.mlflow")
"""Modules whose public docstrings the reference shows, as `generate_reference.py` has them."""
STEPS = ("features", "labels", "models", "training", "inference")
ROOMS = ("src/tokt/cli", "studies/src/tokt_studies", *STEPS)

_ABBREVIATION = re.compile(r"(e\.g|i\.e|vs|cf|etc|approx|no|fig|eq|pp?)\.")
_MARKDOWN = MarkdownIt("commonmark").enable("table")
_NOT_SHOWN = re.compile(
    r"\A---\n.*?\n---\n|<!-- Made by .*\Z|<!--.*?-->|<(style|script)\b.*?</\1>", re.DOTALL
)
"""A page's front matter, what a program made at its end, comments, style and scripts."""
_ADMONITION = re.compile(
    r"^ *(?:!!!|\?{3}\+?|===) *\w*(?: *\"(.*)\")?((?:\n+(?: {4}.*)?)*)", re.MULTILINE
)
"""Material's admonitions and tabs: the title is prose, and so is what is indented below."""
_MARKUP = (
    (r"\{%.*?%\}", " "),  # the template's
    (r"\{\{.*?\}\}", "field"),
    (r"(?<=[\])])\{[^}\n]*\}", ""),  # of a picture or a link
    (r"</?[a-zA-Z][^>\n]*>|^ *:::.*", " "),  # tags, where the reference of a module goes
    (r"\s:[a-z0-9-]+:|\{[.#:][^}\n]*\}", " "),  # an icon, attributes
)
_INLINE = {"code_inline": "`code`"} | dict.fromkeys(
    ("softbreak", "hardbreak", "image", "html_inline"), " "
)
_SECTION = re.compile(r"^\w+\n-{3,}$", re.MULTILINE)
"""A heading in a numpy-style docstring, and the line below."""
_SIGNATURE = re.compile(r"^\S.*$", re.MULTILINE)
"""A parameter, a type or an error: what is said of it is indented."""
_STRING = re.compile(r"\"(?:[^\"\\\n]|\\.)*\"|`(?:[^`\\]|\\.)*`")
_JOINT = re.compile(r"[\"`]\s*\+\s*[\"`]")
_COMMENT = re.compile(r"/\*.*?\*/|^\s*//[^\n]*", re.DOTALL | re.MULTILINE)
_INSIDE = {"a", "abbr", "b", "code", "em", "i", "small", "span", "strong", "sub", "sup", "var"}
"""Tags that end no sentence."""
_READ_OUT = ("alt", "aria-label", "content", "placeholder", "title")
_NO_HTML = r"\{% block style %\}.*?\{% endblock %\}|\{%.*?%\}|\{#.*?#\}"
"""Of a template: its style, statements, comments."""
_SQL = re.compile(r"\s*(CREATE|SELECT|INSERT|COALESCE)\b")
_END = re.compile(r"[.!?][\"')\]*_”’]*$")
_WORD = re.compile(r"\w")


class Text(NamedTuple):
    """A paragraph, an item or a heading, and the line it begins in."""

    where: str
    line: int
    text: str


class Long(NamedTuple):
    """A sentence that is too long."""

    where: str
    line: int
    words: int
    sentence: str

    def __str__(self) -> str:
        return f"{self.where}:{self.line}: {self.words} words: {self.sentence}"


def words(text: str) -> list[str]:
    """Its words: what stands between blanks and has a letter or a digit."""
    return [word for word in text.split() if _WORD.search(word)]


def sentences(text: str) -> Iterator[str]:
    """The sentences of one paragraph; an abbreviation or an initial ends none."""
    sentence: list[str] = []
    for word in text.split():
        sentence.append(word)
        bare = word.lstrip("\"'(*_").lower()
        initial = re.fullmatch(r"[A-Z]\.", word)
        if (
            _END.search(word)
            and _WORD.search(word)
            and not (initial or _ABBREVIATION.fullmatch(bare))
        ):
            yield " ".join(sentence)
            sentence = []
    if sentence:
        yield " ".join(sentence)


def paragraphs(where: str, markdown: str, first: int = 1) -> Iterator[Text]:
    """The prose of a page in Markdown: its paragraphs, items and headings without markup."""
    return (text for text, is_cell in _texts(where, markdown, first) if not is_cell)


def _texts(where: str, markdown: str, first: int) -> Iterator[tuple[Text, bool]]:
    """Each text of a page in Markdown, and whether it is a cell of a table."""
    plain = _NOT_SHOWN.sub(_blank_lines, markdown)
    plain = _ADMONITION.sub(lambda found: (found[1] or "") + textwrap.dedent(found[2]), plain)
    for pattern, instead in _MARKUP:
        plain = re.sub(pattern, instead, plain, flags=re.MULTILINE)
    is_cell = False
    for token in _MARKDOWN.parse(plain):
        if token.type == "inline":
            text = "".join(_INLINE.get(part.type, part.content) for part in token.children)
            if words(text):
                yield Text(where, first + token.map[0], text), is_cell
        is_cell = token.type in ("th_open", "td_open")


def _blank_lines(found: re.Match[str]) -> str:
    return "\n" * found[0].count("\n")


def too_long(texts: Iterable[Text]) -> Iterator[Long]:
    """The sentences with more than `MAX_SENTENCE` words."""
    for where, line, text in texts:
        for sentence in sentences(text):
            if (count := len(words(sentence))) > MAX_SENTENCE:
                yield Long(where, line, count, sentence)


def pages() -> list[Path]:
    """The files with hand-written prose."""
    found = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / TEMPLATE]
    found += sorted([*ROOT.glob("docs/**/*.md"), *ROOT.glob("docs/notebooks/*.ipynb")])
    return [page for page in found if _name(page) not in MADE]


def page_texts(page: Path) -> Iterator[Text]:
    """The prose of a page, or of a notebook's cells."""
    content = page.read_text(encoding="utf-8")
    if page.suffix != ".ipynb":
        yield from paragraphs(_name(page), content)
        return
    for number, cell in enumerate(json.loads(content)["cells"], 1):
        if cell["cell_type"] == "markdown":
            yield from paragraphs(f"{_name(page)}, cell {number}", "".join(cell["source"]))


def cell_texts(page: Path) -> Iterator[Text]:
    """The cells of a page's tables."""
    texts = _texts(_name(page), page.read_text(encoding="utf-8"), 1)
    return (text for text, is_cell in texts if is_cell and page.suffix != ".ipynb")


class _Html(HTMLParser):
    """Gathers what a page shows, and what it has read out."""

    def __init__(self, where: str) -> None:
        super().__init__()
        self.texts: list[Text] = []
        self._where, self._said, self._line, self._silent = where, "", 1, False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Begin anew at a block; attributes are texts of their own."""
        self._silent = tag in ("style", "script")
        if tag not in _INSIDE:
            self.end()
        for name, value in attrs:
            if name in _READ_OUT and value:
                self.texts += paragraphs(self._where, value, self.getpos()[0])

    def handle_endtag(self, tag: str) -> None:
        """End a block."""
        self._silent = False
        if tag not in _INSIDE:
            self.end()

    def handle_data(self, data: str) -> None:
        """Go on with a block."""
        if not self._silent:
            self._line = self._line if words(self._said) else self.getpos()[0]
            self._said += data

    def end(self) -> None:
        """What was gathered is a text."""
        if words(self._said):
            self.texts.append(Text(self._where, self._line, " ".join(self._said.split())))
        self._said = ""


def html_texts(where: str, source: str) -> list[Text]:
    """What a page in HTML, or a template of one, shows."""
    reader = _Html(where)
    for pattern, instead in ((_NO_HTML, _blank_lines), (r"\{\{.*?\}\}", "field")):
        source = re.sub(pattern, instead, source, flags=re.DOTALL)
    reader.feed(source)
    reader.end()
    return reader.texts


def script_texts(where: str, source: str) -> Iterator[Text]:
    """The strings of a script; adjoining ones are one, and so is a word for each field."""
    plain = _JOINT.sub("", _COMMENT.sub(_blank_lines, source))
    for found in _STRING.finditer(plain):
        text = re.sub(r"\$\{[^}]*\}", "field", found[0][1:-1])
        yield from paragraphs(where, text, 1 + plain.count("\n", 0, found.start()))


def docstring_texts(where: str, docstring: str) -> Iterator[Text]:
    """The prose of a numpy-style docstring; its examples are left out."""
    told = re.split(r"^Examples\n-+$", docstring, flags=re.MULTILINE)[0]
    text, *sections = _SECTION.split(told)
    listed = "\n".join(_SIGNATURE.sub("", section) for section in sections)
    yield from paragraphs(where, f"{text}\n{textwrap.dedent(listed)}")


def public_docstrings() -> Iterator[Text]:
    """The docstrings that the reference of the site shows."""
    for name in PUBLIC:
        module = importlib.import_module(name)
        yield from docstring_texts(name, inspect.getdoc(module) or "")
        for public in getattr(module, "__all__", ()):
            value = getattr(module, public)
            if not (inspect.isclass(value) or inspect.isroutine(value)):
                continue
            yield from docstring_texts(f"{name}.{public}", inspect.getdoc(value) or "")
            for member, of in vars(value).items() if inspect.isclass(value) else ():
                if not member.startswith("_") and (callable(of) or hasattr(of, "__get__")):
                    where = f"{name}.{public}.{member}"
                    yield from docstring_texts(where, getattr(of, "__doc__", None) or "")


def help_texts(command: Any, name: str = "tokt") -> Iterator[Text]:
    """What ``--help`` says: of a command of typer's, its options and arguments, its commands."""
    for text in (command.help, command.epilog):
        yield from paragraphs(name, text or "")
    for param in command.params:
        yield from paragraphs(f"{name} {param.opts[0]}", getattr(param, "help", None) or "")
    for below in getattr(command, "commands", {}).values():
        yield from help_texts(below, f"{name} {below.name}")


def said_texts(where: str, source: str) -> Iterator[Text]:
    """The texts in a module of Python that are no docstrings; adjoining ones are one."""
    tree = ast.parse(source)
    silent: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr):  # a docstring
            silent.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            silent |= {id(part) for part in node.values}
        elif isinstance(node, ast.BinOp) and _said(node) is not None:
            silent |= {id(node.left), id(node.right)}
        text = None if id(node) in silent else _said(node)
        if text and not _SQL.match(text):
            yield from paragraphs(where, text, getattr(node, "lineno", 1))


def _said(node: ast.AST) -> str | None:
    """A text, with a word for each of its fields; None where it is none."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(_said(part) or "field" for part in parts)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            texts = [_said(left), _said(right)]
            if any(texts):
                return "".join("field" if text is None else text for text in texts)
    return None


def product_texts() -> Iterator[Text]:
    """All that the program says: help, pages, scripts, public docstrings, texts in modules."""
    from typer.main import get_command

    from tokt.cli.app import whole_app

    yield from help_texts(get_command(whole_app()))
    readers = {".py": said_texts, ".html": html_texts, ".js": script_texts}
    for file in sorted(file for room in ROOMS for file in (ROOT / room).rglob("*")):
        if file.suffix in readers:
            yield from readers[file.suffix](_name(file), file.read_text(encoding="utf-8"))
    yield from public_docstrings()


def _name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def counts() -> dict[str, int]:
    """Words of each page of prose."""
    found = {}
    for page in pages():
        texts = [*page_texts(page), *(cell_texts(page) if _name(page) == GLOSSARY else ())]
        found[_name(page)] = sum(len(words(text.text)) for text in texts)
    return found


def main(arguments: list[str]) -> int:
    """Print counts and long sentences, of some pages or of everything; 1 if there is too much."""
    asked = [page for page in pages() if _name(page).startswith(tuple(arguments or [""]))]
    texts = [text for page in asked for text in (*page_texts(page), *cell_texts(page))]
    long = list(too_long(texts if arguments else [*texts, *product_texts()]))
    print(*long, sep="\n")
    found = counts()
    for page, count in found.items():
        print(f"{count:6}  {page}")
    total = sum(found.values())
    print(f"{total:6}  words in all, at most {MAX_WORDS}")
    print(f"{len(long):6}  sentences over {MAX_SENTENCE} words")
    return int(bool(long) or total > MAX_WORDS)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
