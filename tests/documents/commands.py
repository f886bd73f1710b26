"""Shell blocks as commands: one a line, with what the directives of the block make of each."""

from __future__ import annotations

import re
import shlex
import subprocess
from dataclasses import dataclass, field

from blocks import Block, DocumentError

# Programs that serve until they are told to end. Where a document shows one in the foreground ("in another terminal"),
# it runs on behind the commands that follow.
SERVICES = re.compile(
    r"^(\w+=\S+ )*(graspd (serve|worker)\b|graspd emulate \w+(?!.*--fault help)|graspd device monitor\b|nats-server\b)"
    r"(?!.*--help)"
)
# A line of a block that is shown as output or as a drawing, and is a command all the same.
LOOKS_LIKE_A_COMMAND = re.compile(r"^\s*(\$ |graspd [a-z]+ |cargo [a-z]+ |pip install |python3? -m |apt-get )", re.MULTILINE)


@dataclass
class Command:
    """A command: what the document says, what is run instead, or why nothing is."""

    text: str
    line: int
    run: str
    skip: str | None = None
    status: int = 0
    tries: int = 1
    background: bool = False
    after: list[str] = field(default_factory=list)


def bare(line: str) -> str:
    """A line without its comment and with single spaces where it is not quoted."""
    out, quote = [], ""
    for i, c in enumerate(line):
        if quote:
            quote = "" if c == quote else quote
        elif c in "'\"":
            quote = c
        elif c == "#" and (i == 0 or line[i - 1].isspace()):
            break
        elif c.isspace():
            if out and out[-1] != " ":
                out.append(" ")
            continue
        out.append(c)
    return "".join(out).strip()


def lines(block: Block) -> list[tuple[int, str]]:
    """Commands as they are written, continued lines joined, with the numbers of their lines in the document."""
    found, joined, start = [], "", 0
    for number, line in enumerate(block.text.split("\n"), block.line + 1):
        start = start if joined else number
        if line.endswith("\\"):
            joined += line[:-1].rstrip() + " "
            continue
        text = bare(joined + line.strip() if joined else line)
        joined = ""
        if text:
            found.append((start, text))
    return found


def fits(pattern: str, command: str) -> bool:
    """Whether a directive means this command."""
    pattern = bare(pattern)
    if pattern.endswith(" …"):
        return command == pattern[:-2] or command.startswith(pattern[:-1])
    return command == pattern


def beginning(command: str) -> list[str]:
    """Program and subcommands, for comparison: the words before the first option, value or path."""
    words = shlex.split(command)
    words = words[next((i for i, w in enumerate(words) if not re.match(r"^\w+=", w)), 0) :]
    found = []
    for word in words:
        if not re.fullmatch(r"[a-z0-9][a-z0-9-]*", word):
            break
        found.append(word)
    return found[:3]


def commands(name: str, block: Block) -> list[Command]:
    """The commands of a shell block.

    Raises:
        DocumentError: for a line that is not a whole command, and a directive that fits no command or several.
    """
    found = []
    for line, text in lines(block):
        if subprocess.run(["bash", "-n", "-c", text], capture_output=True, check=False).returncode != 0:
            raise DocumentError(f"{name}:{line}: found {text!r}, expected a whole command on each line")
        background = text.endswith("&") and not text.endswith("&&")
        run = text[:-1].rstrip() if background else text
        found.append(Command(run, line, run, background=background or bool(SERVICES.match(run))))
    for said in block.directives:
        if said.kind not in ("skip one", "replace", "after", "status", "tries"):
            continue
        meant = [c for c in found if fits(said.values["command"], c.text)]
        if len(meant) != 1:
            raise DocumentError(
                f"{name}:{said.line}: found {len(meant)} commands that are {said.values['command']!r}, expected one"
            )
        (command,) = meant
        if said.kind == "skip one":
            command.skip = said.values["reason"]
        elif said.kind == "status":
            command.status = int(said.values["status"])
        elif said.kind == "tries":
            command.tries = int(said.values["tries"])
        elif said.kind == "after":
            command.after.append(said.values["other"])
        else:
            other = said.values["other"]
            if beginning(other) != beginning(command.text):
                raise DocumentError(
                    f"{name}:{said.line}: found {other!r} in the place of {command.text!r}, expected the same program and "
                    "subcommand with other arguments"
                )
            command.run = other
            command.background = command.background and (bool(SERVICES.match(other)) or not SERVICES.match(command.text))
    return found
