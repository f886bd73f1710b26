"""Fenced code blocks of a Markdown file, with the directives that stand in HTML comments before them.

A directive says what to do with the block that follows it; readers of the page do not see it:

    <!-- not run: REASON -->                    the block is not run
    <!-- not run `COMMAND`: REASON -->          one command of it is not run
    <!-- run `COMMAND` as `OTHER` -->           one command of it is run with other arguments (smaller numbers)
    <!-- after `COMMAND`: `OTHER` -->           OTHER is run too, after COMMAND (while it runs, if it is a server)
    <!-- ends with 1 `COMMAND` -->              COMMAND is to end with this status
    <!-- up to 3 tries `COMMAND`: REASON -->    COMMAND may fail so often but once, where a busy machine can make it fail
    <!-- run if `TEST`: REASON -->              the block is run where TEST succeeds
    <!-- given: NAME NAME -->                   files that a reader is told to bring (fixtures.py)
    <!-- save as: FILE -->                      the block is the content of this file
    <!-- then run: `COMMAND` -->                COMMAND is run after the block (with the file, say)
    <!-- quoted from: FILE -->                  the block stands, line by line, in a source file that is compiled and tested
    <!-- same as: DOCUMENT -->                  every command of the block stands in that document too, and is run there
    <!-- run by: FILE -->                       another test runs it: FILE, which names this document
    <!-- all LANGUAGE run by: FILE -->          the same of all blocks of a language in this document

COMMAND is a whole command of the block without its comment, or its beginning and ` …`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)
DIRECTIVES = (
    ("skip one", re.compile(r"not run `(?P<command>[^`]+)`: (?P<reason>.+)")),
    ("skip", re.compile(r"not run: (?P<reason>.+)")),
    ("replace", re.compile(r"run `(?P<command>[^`]+)` as `(?P<other>[^`]+)`")),
    ("after", re.compile(r"after `(?P<command>[^`]+)`: `(?P<other>[^`]+)`")),
    ("status", re.compile(r"ends with (?P<status>\d+) `(?P<command>[^`]+)`")),
    ("tries", re.compile(r"up to (?P<tries>\d+) tries `(?P<command>[^`]+)`: (?P<reason>.+)")),
    ("if", re.compile(r"run if `(?P<test>[^`]+)`: (?P<reason>.+)")),
    ("given", re.compile(r"given: (?P<names>.+)")),
    ("save", re.compile(r"save as: (?P<file>\S+)")),
    ("then", re.compile(r"then run: `(?P<command>[^`]+)`")),
    ("quoted", re.compile(r"quoted from: (?P<file>\S+)")),
    ("same", re.compile(r"same as: (?P<file>\S+)")),
    ("elsewhere", re.compile(r"run by: (?P<file>\S+)")),
    ("all elsewhere", re.compile(r"all (?P<language>\w+) run by: (?P<file>\S+)")),
)
# How a comment begins that is meant as a directive: one that is misspelt must not be passed over.
MEANT = re.compile(r"(not run|run|after|up to|ends with|given|save|then|quoted|same|all \w+ run)\b")


class DocumentError(Exception):
    """A document that cannot be run as it is: where, what was found, what was expected."""


@dataclass
class Directive:
    """What a comment says about the block after it."""

    kind: str
    values: dict[str, str]
    line: int


@dataclass
class Block:
    """A fenced block: its language, its lines, the line of its fence, and its directives."""

    language: str
    text: str
    line: int
    directives: list[Directive] = field(default_factory=list)

    def all(self, kind: str) -> list[Directive]:
        """Its directives of a kind."""
        return [d for d in self.directives if d.kind == kind]

    def one(self, kind: str) -> Directive | None:
        """Its directive of a kind."""
        found = self.all(kind)
        return found[0] if found else None


@dataclass
class Document:
    """A Markdown file: its path below the repository's root, and its blocks in order."""

    name: str
    blocks: list[Block]
    elsewhere: dict[str, str]


def directive(text: str, line: int, name: str) -> Directive | None:
    """Reads a comment; `None` for one that is a comment only."""
    text = " ".join(text.split())
    for kind, pattern in DIRECTIVES:
        match = pattern.fullmatch(text)
        if match:
            return Directive(kind, match.groupdict(), line)
    if MEANT.match(text):
        raise DocumentError(f"{name}:{line}: found the comment {text!r}, expected a directive as blocks.py lists them")
    return None


def parse(name: str, text: str) -> Document:
    """Takes a document apart.

    Raises:
        DocumentError: for a fence without an end or a language, and a directive that belongs to no block.
    """
    document = Document(name, [], {})
    pending: list[Directive] = []
    lines = text.split("\n")
    i = 0
    while i < len(lines):
        line, stripped = lines[i], lines[i].strip()
        if stripped.startswith("```"):
            indent, fence, begin = len(line) - len(line.lstrip()), stripped[3:].strip(), i
            i += 1
            while i < len(lines) and lines[i].strip() != "```":
                i += 1
            if i == len(lines):
                raise DocumentError(f"{name}:{begin + 1}: the block has no end")
            if not fence:
                raise DocumentError(f"{name}:{begin + 1}: found a block without a language, expected one, as ```sh")
            body = "\n".join(row[indent:] for row in lines[begin + 1 : i]) + "\n"
            document.blocks.append(Block(fence.split(",")[0], body, begin + 1, pending))
            pending = []
        elif stripped.startswith("<!--"):
            begin = i
            while "-->" not in lines[i]:
                i += 1
                if i == len(lines):
                    raise DocumentError(f"{name}:{begin + 1}: the comment has no end")
            for match in COMMENT.finditer("\n".join(lines[begin : i + 1])):
                found = directive(match[1], begin + 1, name)
                if found and found.kind == "all elsewhere":
                    document.elsewhere[found.values["language"]] = found.values["file"]
                elif found:
                    pending.append(found)
        elif stripped and pending:
            raise DocumentError(f"{name}:{pending[0].line}: found a directive before prose, expected it before a block")
        i += 1
    if pending:
        raise DocumentError(f"{name}:{pending[0].line}: found a directive at the end, expected it before a block")
    return document


def read(root: Path, name: str) -> Document:
    """Reads a document of the repository."""
    return parse(name, (root / name).read_text())
