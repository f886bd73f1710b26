"""What the runner of documents must see: `python3 -m unittest discover tests/documents`."""

from __future__ import annotations

import importlib.machinery
import importlib.util
import io
import sys
import tempfile
import unittest
from contextlib import redirect_stdout
from pathlib import Path

sys.dont_write_bytecode = True
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from blocks import DocumentError, parse
from commands import bare, commands
from sandbox import Sandbox

loader = importlib.machinery.SourceFileLoader("runner", str(HERE / "run"))
runner = importlib.util.module_from_spec(importlib.util.spec_from_loader("runner", loader))
# Its data classes look for their module.
sys.modules["runner"] = runner
loader.exec_module(runner)


def block(text: str):
    """The only block of a document."""
    (only,) = parse("a.md", text).blocks
    return only


class Reading(unittest.TestCase):
    """Documents are taken apart as they are meant, or refused."""

    def test_blocks_have_their_directives(self) -> None:
        document = parse("a.md", "# A\n<!-- a remark -->\n<!-- given: depth.png -->\n\n```sh\ngraspd x\n```\n```text\ny\n```\n")
        self.assertEqual([(b.language, b.text, b.line) for b in document.blocks], [("sh", "graspd x\n", 5), ("text", "y\n", 8)])
        self.assertEqual([d.kind for d in document.blocks[0].directives], ["given"])
        self.assertEqual(document.blocks[1].directives, [])

    def test_what_is_no_directive_is_refused(self) -> None:
        for text in (
            "<!-- not run -->\n```sh\nx\n```\n",
            "<!-- run `a` with `b` -->\n```sh\na\n```\n",
            "<!-- not run: no reason to -->\nProse.\n",
            "<!-- not run: at the end -->\n",
            "```\nx\n```\n",
            "```sh\nx\n",
        ):
            with self.assertRaises(DocumentError, msg=text):
                parse("a.md", text)

    def test_lines_are_commands_without_comments(self) -> None:
        self.assertEqual(bare("graspd  plan 'a  # b' x#y   # c"), "graspd plan 'a  # b' x#y")
        found = commands("a.md", block("```sh\n# only a comment\ngraspd serve   # first\na \\\n  b\nnats-server -js &\n```\n"))
        self.assertEqual([(c.text, c.line, c.background) for c in found],
                         [("graspd serve", 3, True), ("a b", 4, False), ("nats-server -js", 6, True)])
        with self.assertRaises(DocumentError):
            commands("a.md", block("```sh\nfor i in 1 2; do\necho $i\ndone\n```\n"))

    def test_directives_mean_one_command(self) -> None:
        body = "```sh\ngraspd eval clear\ngraspd eval clear --items 9\n```\n"
        (first, second) = commands("a.md", block("<!-- run `graspd eval clear --items …` as `graspd eval clear --items 1` -->\n" + body))
        self.assertEqual((first.run, second.run), ("graspd eval clear", "graspd eval clear --items 1"))
        (first, second) = commands("a.md", block("<!-- not run `graspd eval clear`: hours -->\n" + body))
        self.assertEqual((first.skip, second.skip), ("hours", None))
        for wrong in ("not run `graspd eval ap`: x", "not run `graspd eval clear …`: x", "run `graspd eval clear` as `true`",
                      "run `graspd eval clear` as `graspd eval ap`"):
            with self.assertRaises(DocumentError, msg=wrong):
                commands("a.md", block(f"<!-- {wrong} -->\n{body}"))


class Running(unittest.TestCase):
    """Blocks are run, and what fails is a failure."""

    def account(self, text: str):
        """Runs a document in a scratch folder."""
        with tempfile.TemporaryDirectory() as folder, redirect_stdout(io.StringIO()):
            box = Sandbox(runner.ROOT, Path("/bin/true"), Path(folder) / "target", Path(folder) / "work")
            account = runner.Account()
            runner.Run(parse("a.md", text), box, account).all()
            return account

    def test_commands_are_run_in_order_in_a_folder_of_their_own(self) -> None:
        account = self.account("```sh\necho one > file\ntest -f README.md && grep -q one file\ngraspd anything\n```\n")
        self.assertEqual((account.run, account.failures), (3, []))

    def test_what_fails_is_told_and_ends_its_block(self) -> None:
        account = self.account("```sh\necho why; false\ntouch never\n```\n```sh\ntest ! -e never\n```\n")
        self.assertEqual((account.run, len(account.failures)), (2, 1))
        self.assertIn("a.md:2: echo why; false: ended with 1, expected 0\n      why", account.failures[0])
        self.assertEqual(self.account("<!-- ends with 1 `false` -->\n```sh\nfalse\n```\n").failures, [])
        self.assertEqual(len(self.account("<!-- ends with 1 `true` -->\n```sh\ntrue\n```\n").failures), 1)
        self.assertEqual(len(self.account("```sh\nfalse | true\n```\n").failures), 1)
        tried = self.account("<!-- up to 3 tries `test -e b …`: try -->\n```sh\ntest -e b || { touch b; false; }\n```\n")
        self.assertEqual((tried.run, tried.failures), (2, []))

    def test_a_block_has_something_that_runs_it_or_a_reason(self) -> None:
        self.assertEqual(len(self.account("```toml\na = 1\n```\n").failures), 1)
        self.assertEqual(len(self.account("```text\ngraspd serve --now\n```\n").failures), 1)
        left_out = self.account("<!-- not run: a rocket is wanted -->\n```sh\nfalse\n```\n")
        self.assertEqual((left_out.failures, left_out.run, len(left_out.skipped)), ([], 0, 1))
        saved = self.account("<!-- save as: a.toml -->\n<!-- then run: `grep -q a a.toml` -->\n```toml\na = 1\n```\n")
        self.assertEqual((saved.run, saved.failures), (1, []))
        self.assertEqual(len(self.account("<!-- save as: a.toml -->\n```toml\na = 1\n```\n").failures), 1)
        self.assertEqual(len(self.account("<!-- run by: README.md -->\n```toml\na = 1\n```\n").failures), 1)
        self.assertEqual(len(self.account("<!-- quoted from: tests/documents/run -->\n```rust\nlet a = 1;\n```\n").failures), 1)
        quoted = self.account("<!-- quoted from: tests/documents/run -->\n```rust\nROOT = Path(__file__).resolve().parents[2]\n```\n")
        self.assertEqual((quoted.elsewhere, quoted.failures), (1, []))
        missing = self.account("<!-- run if `false`: no luck -->\n```sh\nfalse\n```\n")
        self.assertEqual((missing.run, len(missing.missing), missing.failures), (0, 1, []))
        self.assertEqual(len(self.account("<!-- given: moon.png -->\n```sh\ntrue\n```\n").failures), 1)

    def test_servers_run_behind_commands_and_must_end_well(self) -> None:
        account = self.account("```sh\nsleep 60 &\ntrue\n```\n")
        self.assertEqual((account.run, account.failures), (2, []))
        account = self.account("```sh\nbash -c 'trap \"exit 3\" TERM; sleep 60 & wait' &\ntrue\n```\n")
        self.assertEqual(len(account.failures), 1)
        self.assertIn("ended with 3 when it was asked to", account.failures[0])
        account = self.account("```sh\nfalse &\ntrue\n```\n")
        self.assertEqual(len(account.failures), 1)


if __name__ == "__main__":
    unittest.main()
