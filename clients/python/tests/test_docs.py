"""The documents' blocks of Python, run in order against a real server.

A `text` block after a `python` block is what it prints, `...` standing for anything.
"""

from __future__ import annotations

import doctest
import io
import re
from contextlib import redirect_stdout
from pathlib import Path

import matplotlib as mpl
import pytest

from tests.conftest import REPOSITORY, Server

mpl.use("Agg")

BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
MATCHES = doctest.OutputChecker().check_output


def python_section(path: Path) -> str:
    """The part of the repository's README that is about Python."""
    text = path.read_text()
    begin = text.index("\n## Python\n")
    return text[begin : text.index("\n## ", begin + 1)]


@pytest.mark.parametrize(
    ("name", "at_least"), [("docs/python.md", 18), ("clients/python/README.md", 1), ("README.md", 1)]
)
def test_blocks_run(server: Server, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, at_least: int) -> None:
    path = REPOSITORY / name
    text = python_section(path) if name == "README.md" else path.read_text()
    monkeypatch.setenv("GRASPD_ADDRESS", server.address)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hands").symlink_to(REPOSITORY / "hands")
    names: dict[str, object] = {"__name__": "__main__"}
    said, run = "", 0
    for kind, body in BLOCK.findall(text):
        if kind == "python":
            with redirect_stdout(io.StringIO()) as out:
                exec(compile(body, f"{name}, block {run + 1}", "exec"), names)
            said, run = out.getvalue(), run + 1
        elif kind == "text":
            assert MATCHES(body, said, doctest.ELLIPSIS), f"{name} says:\n{body}\nfound:\n{said}"
    assert run >= at_least
