"""The server's page in a real Firefox, over its Marionette protocol: nothing but Python's own library.

    firefox.py BROWSER OUT --server URL [--tls URL TOKEN] [--no-picture]

Loads and plans the example, clicks, presses keys, in the light and in the dark; with --no-picture without WebGL, where
everything but the picture has to work. Screenshots for people go to OUT. Ends with "all checks passed".
"""

import argparse
import base64
import json
import socket
import subprocess
import tempfile
import time
from pathlib import Path

KEYS = {"Tab": "\ue004", "Enter": "\ue007", "ArrowLeft": "\ue012", "ArrowUp": "\ue013", "ArrowRight": "\ue014", "ArrowDown": "\ue015"}
PLANNED = "/grasps for \\d+ hands? in/.test(document.getElementById('said').textContent)"


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


class Firefox:
    """A headless Firefox of its own, with an empty profile that goes with it."""

    def __init__(self, program: str, **preferences: object):
        self.profile = tempfile.TemporaryDirectory(prefix="graspd-firefox-", ignore_cleanup_errors=True)
        port = free_port()
        wanted = {
            "marionette.port": port,
            "browser.shell.checkDefaultBrowser": False,
            "datareporting.policy.dataSubmissionEnabled": False,
            "toolkit.telemetry.reportingpolicy.firstRun": False,
            "app.normandy.enabled": False,
            "network.captive-portal-service.enabled": False,
            "network.connectivity-service.enabled": False,
            "webgl.force-enabled": True,
            **preferences,
        }
        lines = [f"user_pref({json.dumps(name)}, {json.dumps(value)});" for name, value in wanted.items()]
        (Path(self.profile.name) / "user.js").write_text("\n".join(lines))
        command = [program, "--headless", "--no-remote", "--marionette", "--profile", self.profile.name, "about:blank"]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        end = time.monotonic() + 60
        while True:
            try:
                self.socket = socket.create_connection(("127.0.0.1", port), 120)
                break
            except OSError:
                assert self.process.poll() is None and time.monotonic() < end, "Firefox does not start"
                time.sleep(0.2)
        self.stream = self.socket.makefile("rb")
        self.count = 0
        self._read()
        self.send("WebDriver:NewSession", acceptInsecureCerts=True)
        self.send("WebDriver:SetWindowRect", width=1280, height=886)

    def close(self) -> None:
        self.stream.close()
        self.socket.close()
        self.process.terminate()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.profile.cleanup()

    def _read(self) -> object:
        digits = b""
        while (digit := self.stream.read(1)) != b":":
            assert digit, "Firefox has ended"
            digits += digit
        return json.loads(self.stream.read(int(digits)))

    def send(self, command: str, **parameters: object) -> object:
        self.count += 1
        data = json.dumps([0, self.count, command, parameters]).encode()
        self.socket.sendall(str(len(data)).encode() + b":" + data)
        _, number, error, result = self._read()
        assert number == self.count and error is None, (command, error)
        return result

    def js(self, expression: str) -> object:
        return self.send("WebDriver:ExecuteScript", script=f"return {expression};", args=[])["value"]

    def wait(self, expression: str, seconds: float = 90) -> None:
        end = time.monotonic() + seconds
        while not self.js(f"(() => {{ try {{ return {expression}; }} catch {{ return null; }} }})()"):
            said = self.js("document.body && document.body.innerText.slice(0, 2000)")
            assert time.monotonic() < end, f"never true: {expression}\n{said}"
            time.sleep(0.1)

    def open(self, url: str) -> None:
        self.send("WebDriver:Navigate", url=url)

    def click(self, selector: str) -> None:
        element = self.send("WebDriver:FindElement", using="css selector", value=selector)["value"]
        self.send("WebDriver:ElementClick", id=next(iter(element.values())))

    def key(self, key: str) -> None:
        value = KEYS.get(key, key)
        actions = [{"type": kind, "value": value} for kind in ("keyDown", "keyUp")]
        self.send("WebDriver:PerformActions", actions=[{"type": "key", "id": "keyboard", "actions": actions}])

    def type(self, text: str) -> None:
        for letter in text:
            self.key(letter)

    def screenshot(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self.send("WebDriver:TakeScreenshot", full=False)["value"]))


def pressed(tab: Firefox, selector: str) -> bool:
    return tab.js(f"document.querySelector({json.dumps(selector)}).getAttribute('aria-pressed')") == "true"


def colours(tab: Firefox) -> int:
    """Different colours of the picture: an empty one has few."""
    return tab.js(
        "(() => { const c = document.getElementById('view'), o = document.createElement('canvas'); o.width = 240; o.height = 160;"
        " const x = o.getContext('2d'); x.drawImage(c, 0, 0, 240, 160); const d = x.getImageData(0, 0, 240, 160).data;"
        " return new Set(new Uint32Array(d.buffer)).size; })()"
    )


def use(tab: Firefox, out: Path, name: str, has_picture: bool) -> None:
    """What is there, clicks and keys."""
    tab.wait(PLANNED)
    time.sleep(1)
    tab.screenshot(out / f"{name}.png")
    assert tab.js("document.querySelectorAll('#hands li').length") >= 11
    assert tab.js("document.querySelectorAll('#ranks li').length") >= 2
    assert tab.js("document.querySelectorAll('#rejected tr').length") > 3
    assert tab.js("document.getElementById('failed').innerText") == ""
    tab.wait("/running/.test(document.getElementById('load').innerText)")
    if has_picture:
        assert colours(tab) > 500, colours(tab)
    else:
        assert "No picture" in tab.js("document.getElementById('stage').innerText")
    before = tab.js("document.getElementById('figures').textContent")
    tab.click("#ranks [data-rank='1']")
    assert pressed(tab, "#ranks [data-rank='1']")
    assert tab.js("document.getElementById('figures').textContent") != before
    tab.js("document.activeElement.blur()")
    tab.key("ArrowLeft")
    assert pressed(tab, "#ranks [data-rank='0']")
    hand = tab.js("document.querySelector('#hands [aria-pressed=true]').dataset.hand")
    tab.key("ArrowDown")
    assert tab.js("document.querySelector('#hands [aria-pressed=true]').dataset.hand") != hand
    tab.key("ArrowUp")
    tab.key("1")
    assert tab.js("document.getElementById('moment').getAttribute('aria-valuetext')") == "pre-grasp"
    # From the top: a headless window has no bar of its own to come back from.
    tab.js("document.querySelector('.skip').focus()")
    reached = []
    for _ in range(45):
        tab.key("Tab")
        reached.append(tab.js("(e => e.id || e.className || e.tagName)(document.activeElement)"))
    assert {"example", "choose", "estimator", "plan", "moment"} <= set(reached), reached


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("browser")
    parser.add_argument("out", type=Path)
    parser.add_argument("--server", required=True)
    parser.add_argument("--tls", nargs=2)
    parser.add_argument("--no-picture", action="store_true")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    version = subprocess.run([args.browser, "--version"], capture_output=True, text=True, check=True).stdout.strip()
    runs = [("firefox-light", {"ui.systemUsesDarkTheme": 0}), ("firefox-dark", {"ui.systemUsesDarkTheme": 1})]
    for name, preferences in runs:
        tab = Firefox(args.browser, **preferences, **({"webgl.disabled": True} if args.no_picture else {}))
        try:
            tab.open(args.server)
            use(tab, args.out, name, not args.no_picture)
            dark = tab.js("matchMedia('(prefers-color-scheme: dark)').matches")
            assert dark == (name == "firefox-dark"), name
            light = tab.js("getComputedStyle(document.body).backgroundColor.match(/[0-9.]+/g).map(Number)[0]")
            assert (light < 80) == dark, light
            print(f"{name}: done")
            if args.tls and not dark:
                tab.open(args.tls[0])
                tab.wait("document.getElementById('token-dialog').open")
                tab.type(args.tls[1])
                tab.key("Enter")
                tab.wait("document.querySelectorAll('#hands li').length >= 11")
                tab.wait(PLANNED)
                tab.screenshot(args.out / "firefox-tls.png")
                print("tls: done")
        finally:
            tab.close()
    print(version)
    print("all checks passed")


if __name__ == "__main__":
    main()
