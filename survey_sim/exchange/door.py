"""The door of exchange files: bytes that are safe to hand to a VOTable parser, or a refusal.

Refused before any of it is parsed further: files that unpack beyond a limit, document type declarations (and with them all
entities, external or exploding), data that a STREAM would fetch from elsewhere, elements nested without end, and sizes
declared beyond what the file holds (the parser would allocate them).
"""

from bisect import bisect_right
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from xml.parsers import expat

from survey_sim import packed
from survey_sim.errors import InputError

# Largest file, unpacked: a hundred times the router file of 600 robots.
N_BYTES_MAX = 256 << 20
_DEPTH_MAX = 32
_ARRAYSIZE_MAX = 65_536


@dataclass
class Outline:
    """What the door saw: where rows stand, for messages.

    Attributes
    ----------
    row_lines
        Of each TABLE in turn: the line on which each TR begins.
    last_lines
        Of each TABLE: its last line; infinite while it has not ended.
    """

    table_names: list[str] = field(default_factory=list)
    row_lines: list[list[int]] = field(default_factory=list)
    last_lines: list[float] = field(default_factory=list)

    def place(self, line: int) -> str | None:
        """Table and row (from 0) of a line, if a row stands there."""
        for name, lines, last in zip(self.table_names, self.row_lines, self.last_lines, strict=True):
            row = bisect_right(lines, line) - 1
            if row >= 0 and line <= last:
                return f"table {name}, row {row}"
        return None


def read_bytes(path: Path) -> bytes:
    """Content of a file, unpacked if it is gzip, never more than `N_BYTES_MAX`."""
    content = packed.read_bytes(path, N_BYTES_MAX)
    return packed.gunzip(content, path, N_BYTES_MAX) if content.startswith(packed.GZIP_MAGIC) else content


def check_xml(content: bytes, path: Path) -> Outline:
    """Outline of a document that is safe to parse; InputError if it is not."""
    outline = Outline()
    parser = expat.ParserCreate()
    watch = _Watch(outline, parser, path, len(content))
    parser.StartDoctypeDeclHandler = watch.doctype
    parser.StartElementHandler = watch.start
    parser.EndElementHandler = watch.end
    parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)
    try:
        parser.Parse(content, True)
    except expat.ExpatError as failure:
        rule = f"is not well-formed XML: {expat.ErrorString(failure.code)}, line {failure.lineno}"
        raise InputError(rule, file=path, place=outline.place(failure.lineno), remedy="write the file again") from None
    except (ValueError, LookupError) as failure:
        raise InputError(f"is not readable XML: {failure}", file=path, remedy="save it as UTF-8") from None
    return outline


class _Watch:
    """Expat's handlers: count, note, refuse."""

    def __init__(self, outline: Outline, parser: expat.XMLParserType, path: Path, n_bytes: int) -> None:
        self.outline, self.parser, self.path, self.n_bytes = outline, parser, path, n_bytes
        self.depth = 0

    def doctype(self, *_: object) -> None:
        self._refuse("has a document type declaration (DTDs and entities are not read)", "remove the DOCTYPE")

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self.depth += 1
        tag = name.rpartition(":")[2]
        if self.depth == 1 and tag != "VOTABLE":
            self._refuse(f"is XML but no VOTable: its root is {tag}", "give a VOTable file")
        if self.depth > _DEPTH_MAX:
            self._refuse(f"nests elements deeper than {_DEPTH_MAX}", "flatten the RESOURCEs")
        if tag == "TR":
            if self.outline.row_lines:
                self.outline.row_lines[-1].append(self.parser.CurrentLineNumber)
        elif tag == "TABLE":
            self.outline.table_names.append(attributes.get("name", attributes.get("ID", "without name")))
            self.outline.row_lines.append([])
            self.outline.last_lines.append(inf)
            self._check_size(attributes.get("nrows"), self.n_bytes, "nrows")
        elif tag in {"FIELD", "PARAM"}:
            for part in attributes.get("arraysize", "").replace("*", "").split("x"):
                self._check_size(part, _ARRAYSIZE_MAX, "arraysize")
        elif tag == "STREAM" and "href" in attributes:
            self._refuse("holds its data elsewhere (STREAM href is not followed)", "write the data into the file")

    def end(self, name: str) -> None:
        self.depth -= 1
        if name.rpartition(":")[2] == "TABLE":
            self.outline.last_lines[-1] = self.parser.CurrentLineNumber

    def _check_size(self, text: str | None, most: int, attribute: str) -> None:
        if text and (not text.strip().isdigit() or int(text[:20]) > most):
            self._refuse(f"{attribute}={text[:20]!r} is no possible size", "write the file again")

    def _refuse(self, rule: str, remedy: str) -> None:
        raise InputError(f"{rule}, line {self.parser.CurrentLineNumber}", file=self.path, remedy=remedy)
