"""The server's page in a real browser, as a person uses it: looks, clicks, keys, dropped files, tokens.

    page.py BROWSER OUT --server URL [--tokens URL TOKEN] [--tls URL KEY TOKEN] --assets DIR --recording FILE

KEY is the base64 of the SHA-256 of the public key of a certificate that no authority of the browser has signed.

Screenshots for people go to OUT. Ends with "all checks passed", or with the check that did not.
"""

import argparse
import json
import shutil
import struct
import time
import zlib
from pathlib import Path

from chromium import Browser, Tab

# Of the picture: the share of pixels that are not background, and a number that is another for another picture.
CANVAS = """(() => { const c = document.getElementById("view"), o = document.createElement("canvas"); o.width = 240; o.height = 160;
  const x = o.getContext("2d"); x.drawImage(c, 0, 0, 240, 160); const d = x.getImageData(0, 0, 240, 160).data;
  const ground = getComputedStyle(c).backgroundColor.match(/[0-9.]+/g).map(Number); let other = 0, sum = 0, color = 0;
  for (let i = 0; i < d.length; i += 4) { const far = Math.abs(d[i] - ground[0]) + Math.abs(d[i + 1] - ground[1]) + Math.abs(d[i + 2] - ground[2]);
    if (far > 24) other++; if (Math.max(d[i], d[i + 1], d[i + 2]) - Math.min(d[i], d[i + 1], d[i + 2]) > 70) color++;
    sum = (sum * 31 + d[i] * 7 + d[i + 1] * 3 + d[i + 2]) % 1000003; }
  return { other: other / 38400, color: color / 38400, sum, frames: Number(c.dataset.frames || 0) }; })()"""

# Contrast of text and what is behind it (WCAG 2), the least of all visible text.
CONTRAST = """(() => { const light = c => { const [r, g, b] = c.match(/[0-9.]+/g).slice(0, 3).map(x => { x /= 255; return x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4; });
    return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const solid = e => { for (; e; e = e.parentElement) { const c = getComputedStyle(e).backgroundColor; if (!/, 0\\)$|transparent|color\\(/.test(c)) return c; } return "rgb(255,255,255)"; };
  let least = [99, ""]; const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) { const e = walk.currentNode.parentElement; if (!walk.currentNode.textContent.trim() || !e.checkVisibility() || e.closest(":disabled, noscript, .skip, option")) continue;
    const a = light(getComputedStyle(e).color), b = light(solid(e)), ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < least[0]) least = [ratio, walk.currentNode.textContent.trim().slice(0, 40)]; }
  return least; })()"""

PLANNED = "/grasps for \\d+ hands? in/.test(document.getElementById('said').textContent)"


def changed(tab: Tab, before: dict) -> dict:
    """The picture, once it is another one."""
    end = time.monotonic() + 30
    while True:
        now = tab.js(CANVAS)
        if now["sum"] != before["sum"]:
            return now
        assert time.monotonic() < end, "the picture does not change"
        time.sleep(0.05)


def still(tab: Tab) -> dict:
    """The picture, once nothing changes any more."""
    last = None
    while True:
        now = tab.js(CANVAS)
        if last and now["sum"] == last["sum"] and now["frames"] == last["frames"]:
            return now
        last = now
        time.sleep(0.12)


def pressed(tab: Tab, selector: str) -> bool:
    return tab.js(f"document.querySelector({json.dumps(selector)}).getAttribute('aria-pressed')") == "true"


def text(tab: Tab, name: str) -> str:
    return tab.js(f"document.getElementById({json.dumps(name)}).innerText")


def looks(tab: Tab, out: Path, name: str = "page-light.png") -> None:
    """What is there once the example frame is planned."""
    tab.wait(PLANNED)
    picture = still(tab)
    assert picture["other"] > 0.3, picture
    assert picture["color"] > 0.005, "no contact field, no hand: the picture is grey"
    assert tab.js("document.querySelectorAll('#hands li').length") >= 11
    assert tab.js("document.querySelectorAll('#ranks li').length") >= 1
    assert tab.js("document.querySelectorAll('#parts tr').length") == 5
    assert "candidates in all" in text(tab, "rejected") and "optimize" in text(tab, "stages")
    assert tab.js("document.querySelectorAll('#rejected tr').length") > 3, text(tab, "rejected")
    assert "contact candidates" in text(tab, "hands"), "the selected hand tells of its pads"
    assert text(tab, "failed") == ""
    tab.wait("/running/.test(document.getElementById('load').innerText) && document.getElementById('load').innerText.match(/\\d ms|\\d s/)")
    tab.screenshot(str(out / name))


def mouse(tab: Tab, out: Path) -> None:
    """Clicks on a grasp, on a hand, on moments and on layers; the picture is turned."""
    before, pose = still(tab), tab.js("document.getElementById('figures').textContent")
    tab.click("#ranks [data-rank='1']")
    assert pressed(tab, "#ranks [data-rank='1']") and not pressed(tab, "#ranks [data-rank='0']")
    assert tab.js("document.getElementById('figures').textContent") != pose
    before = changed(tab, before)
    tab.click("[data-moment='0']")
    assert tab.js("document.getElementById('moment').value") == "0" and pressed(tab, "[data-moment='0']")
    before = changed(tab, before)
    tab.click("[data-moment='2']")
    before = changed(tab, before)
    tab.click("#play")
    tab.wait("Number(document.getElementById('moment').value) > 0 && Number(document.getElementById('moment').value) < 2")
    tab.click("#play")
    tab.click("[data-moment='1']")
    before = still(tab)
    tab.click("#layers [data-layer='field']")
    assert not pressed(tab, "#layers [data-layer='field']")
    assert changed(tab, before)["color"] < before["color"], "the contact field is colourful"
    tab.click("#layers [data-layer='field']")
    before = still(tab)
    tab.drag("#view", 120, 20)
    changed(tab, before)
    tab.click("#hands [data-hand='hands/leap']")
    assert pressed(tab, "#hands [data-hand='hands/leap']") and "LEAP" in text(tab, "answer-title")
    assert tab.js("document.querySelectorAll('#ranks li').length") >= 1
    still(tab)
    tab.screenshot(str(out / "page-leap.png"))
    # A hand that was not planned for stands over the table.
    tab.click("#hands [data-hand='hands/allegro']")
    assert "Not planned yet" in text(tab, "answer-about") and tab.js("document.getElementById('moment').disabled")
    tab.click("#hands [data-hand='hands/robotiq-2f85']")


def keyboard(tab: Tab) -> None:
    """Everything without a mouse: the order of focus, and shortcuts."""
    tab.js("document.activeElement.blur()")
    tab.js("window.scrollTo(0, 0)")
    reached = []
    # Twice around: where it begins is up to what was clicked last.
    for _ in range(150):
        tab.key("Tab")
        reached.append(tab.js("(e => e.id || e.className || e.getAttribute('data-layer') || e.tagName)(document.activeElement)"))
    reached = reached[reached.index("skip") :]
    wanted = ["skip", "example", "choose", "estimator", "plan", "view", "moment"]
    places = [reached.index(name) for name in wanted]
    assert places == sorted(places), reached
    tab.js("document.activeElement.blur()")
    before = still(tab)
    tab.key("1")
    assert tab.js("document.getElementById('moment').getAttribute('aria-valuetext')") == "pre-grasp"
    before = changed(tab, before)
    tab.key("3")
    assert tab.js("document.getElementById('moment').getAttribute('aria-valuetext')") == "squeeze"
    before = changed(tab, before)
    tab.js("document.getElementById('moment').focus()")
    tab.key("Home")
    assert tab.js("document.getElementById('moment').value") == "0"
    before = changed(tab, before)
    tab.key("End")
    tab.js("document.activeElement.blur()")
    tab.key("2")
    still(tab)
    rank = tab.js("document.querySelector('#ranks [aria-pressed=true]').dataset.rank")
    tab.key("ArrowRight")
    assert tab.js("document.querySelector('#ranks [aria-pressed=true]').dataset.rank") != rank
    tab.key("ArrowLeft")
    assert tab.js("document.querySelector('#ranks [aria-pressed=true]').dataset.rank") == rank
    hand = tab.js("document.querySelector('#hands [aria-pressed=true]').dataset.hand")
    tab.key("ArrowDown")
    assert tab.js("document.querySelector('#hands [aria-pressed=true]').dataset.hand") != hand
    tab.key("ArrowUp")
    before = still(tab)
    tab.js("document.getElementById('view').focus()")
    tab.key("ArrowLeft")
    changed(tab, before)
    assert tab.js("document.querySelector('#ranks [aria-pressed=true]').dataset.rank") == rank, "arrows turn the picture there"
    tab.js("document.activeElement.blur()")
    # A button that is pressed by its key keeps the focus, though its list is made anew.
    tab.js("document.querySelector('#ranks [data-rank=\"1\"]').focus()")
    tab.key("Enter")
    assert tab.js("document.activeElement.dataset.rank") == "1" and pressed(tab, "#ranks [data-rank='1']")
    tab.js("document.activeElement.blur()")
    # What has no name cannot be told by a screen reader.
    nameless = tab.js(
        "[...document.querySelectorAll('button, input, select, canvas, [role=img]')].filter(e => e.checkVisibility() &&"
        " !(e.innerText || e.getAttribute('aria-label') || (e.labels && e.labels.length))).map(e => e.outerHTML)"
    )
    assert nameless == [], nameless


def themes(tab: Tab, out: Path) -> None:
    """Readable in the light and in the dark."""
    for theme in ["dark", "light"]:
        before = still(tab)
        tab.theme(theme)
        changed(tab, before)
        ratio, words = tab.js(CONTRAST)
        assert ratio >= 4.5, f"{theme}: {words!r} has a contrast of {ratio:.2f}"
        still(tab)
        if theme == "dark":
            tab.screenshot(str(out / "page-dark.png"))


def files(tab: Tab, out: Path, assets: Path, recording: Path) -> None:
    """Files that are dropped: a depth image and its lens, what is none, and a recording."""
    mine = out / "mine.png"
    shutil.copy(assets / "demo_depth.png", mine)
    tab.drop("#view", [str(mine), str(assets / "demo_frame.json")])
    tab.wait("document.getElementById('source').textContent.startsWith('mine.png, 640 × 480, camera pose known')")
    tab.wait(PLANNED)
    # Without a lens it has the figures of the fields, and the camera is the world.
    tab.drop("#view", [str(mine)])
    tab.wait("document.getElementById('source').textContent.endsWith('the camera is the world')")
    tab.wait(PLANNED)
    assert tab.js("document.querySelectorAll('#ranks li').length") >= 1
    assert still(tab)["other"] > 0.3
    # What is no number is named, and so is what the server does not take.
    tab.js("document.getElementById('lens-fx').value = 'wide'")
    tab.click("#plan")
    tab.wait("document.getElementById('failed').textContent.includes('fx, px: expected a number')")
    tab.js("document.getElementById('lens-fx').value = '-5'")
    tab.click("#plan")
    tab.wait("/invalid argument: .*intrinsics/.test(document.getElementById('failed').textContent)")
    tab.js("document.getElementById('lens-fx').value = '585'")
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    header = struct.pack(">IIBBBBB", 1, 1, 8, 0, 0, 0, 0)
    grey = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0\0")) + chunk(b"IEND", b"")
    (out / "grey.png").write_bytes(grey)
    tab.drop("#view", [str(out / "grey.png")])
    tab.wait("document.getElementById('failed').textContent.includes('expected 16-bit grey pixels, found 8 bits')")
    tab.drop("#view", [str(recording)])
    tab.wait("/^1 of \\d/.test(document.getElementById('replay-at').textContent)")
    tab.wait("document.getElementById('replay-about').textContent.includes('Answers are the recorded ones')")
    assert text(tab, "failed") == ""
    count = tab.js("document.querySelectorAll('#ranks li').length")
    assert count >= 1 and still(tab)["other"] > 0.3
    pose = tab.js("document.getElementById('figures').textContent")
    tab.screenshot(str(out / "page-recording.png"))
    tab.js("document.getElementById('said').textContent = ''")
    tab.click("#replay-again")
    tab.wait(PLANNED)
    assert tab.js("document.querySelectorAll('#ranks li').length") == count
    assert tab.js("document.getElementById('figures').textContent") == pose, "planned again it is the same"
    tab.click("#replay-on")
    tab.wait("/^2 of \\d/.test(document.getElementById('replay-at').textContent)")


def narrow(tab: Tab, out: Path) -> None:
    """A window as wide as a telephone."""
    tab.size(390, 844)
    still(tab)
    assert tab.js("document.scrollingElement.scrollWidth") <= 390, "it is wider than the window"
    tab.screenshot(str(out / "page-narrow.png"))
    tab.size(1280, 800)


def tokens(tab: Tab, url: str, token: str) -> None:
    """A server that asks who calls: the page asks too."""
    tab.open(url)
    tab.wait("document.getElementById('token-dialog').open")
    tab.type("wrong")
    tab.key("Enter")
    tab.wait("document.getElementById('token-dialog').open && /not known/.test(document.getElementById('token-why').textContent)")
    tab.type(token)
    tab.key("Enter")
    tab.wait("document.querySelectorAll('#hands li').length >= 11")
    tab.wait("/running/.test(document.getElementById('load').innerText)")


def encrypted(program: str, out: Path, url: str, key: str, token: str) -> None:
    """The page over TLS: a certificate that is not trusted is not, one whose key is known is; then a token, and a plan."""
    browser = Browser(program)
    try:
        answer = Tab(browser, 1280, 800).send("Page.navigate", url=url)
        assert "ERR_CERT" in answer.get("errorText", ""), answer
    finally:
        browser.close()
    browser = Browser(program, f"--ignore-certificate-errors-spki-list={key}")
    try:
        tab = Tab(browser, 1280, 800)
        tab.theme("light")
        tokens(tab, url, token)
        assert tab.js("isSecureContext && performance.getEntriesByType('navigation')[0].nextHopProtocol") == "h2"
        looks(tab, out, "page-tls.png")
        quiet(tab, url, ("401",))
    finally:
        browser.close()


def without_picture(program: str, url: str) -> None:
    """A browser without WebGL: everything but the picture works."""
    browser = Browser(program, "--disable-3d-apis")
    try:
        tab = Tab(browser, 1280, 800)
        tab.open(url)
        tab.wait(PLANNED)
        assert "No picture" in text(tab, "stage") and text(tab, "failed") == ""
        assert tab.js("document.querySelectorAll('#rejected tr').length") > 3
        figures = tab.js("document.getElementById('figures').textContent")
        tab.click("#ranks [data-rank='1']")
        assert pressed(tab, "#ranks [data-rank='1']")
        assert tab.js("document.getElementById('figures').textContent") != figures
        tab.js("document.activeElement.blur()")
        tab.key("1")
        assert tab.js("document.getElementById('moment').getAttribute('aria-valuetext')") == "pre-grasp"
        tab.click("#hands [data-hand='hands/allegro']")
        assert "Not planned yet" in text(tab, "answer-about") and text(tab, "failed") == ""
        quiet(tab, url)
    finally:
        browser.close()


def pictures(tab: Tab, out: Path) -> None:
    """Pictures of the documents that no check makes: the contact field alone."""
    hidden = ["hand", "pads", "contacts", "others", "volume"]
    for layer in [*hidden, "directions"]:
        tab.click(f"#layers [data-layer='{layer}']")
    for _ in range(3):
        tab.js("document.getElementById('view').focus()")
        tab.key("+")
    tab.js("document.activeElement.blur()")
    tab.js("for (const id of ['layers', 'legend']) document.getElementById(id).hidden = true")
    still(tab)
    tab.screenshot(str(out / "contact-field.png"), "#view")


def quiet(tab: Tab, url: str, allowed: tuple[str, ...] = ()) -> None:
    """No exception, no refused script or style, and nothing from elsewhere."""
    thrown = [e["exceptionDetails"] for e in tab.events("Runtime.exceptionThrown")]
    assert not thrown, thrown
    errors = [e["entry"] for e in tab.events("Log.entryAdded") if e["entry"]["level"] == "error"]
    errors = [e for e in errors if not any(words in e["text"] for words in allowed)]
    assert not errors, errors
    urls = {e["request"]["url"] for e in tab.events("Network.requestWillBeSent")}
    elsewhere = [u for u in urls if not u.startswith((url, "about:", "data:", "blob:"))]
    assert len(urls) > 15 and not elsewhere, elsewhere


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("browser")
    parser.add_argument("out", type=Path)
    parser.add_argument("--server", required=True)
    parser.add_argument("--tokens", nargs=2)
    parser.add_argument("--tls", nargs=3)
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--recording", type=Path, required=True)
    parser.add_argument("--pictures", action="store_true", help="pictures of the documents too")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    # The browser stands in another folder.
    args.out, args.assets, args.recording = (p.resolve() for p in (args.out, args.assets, args.recording))
    browser = Browser(args.browser)
    try:
        tab = Tab(browser, 1280, 800)
        tab.theme("light")
        tab.open(args.server)
        steps = [lambda: looks(tab, args.out), lambda: mouse(tab, args.out), lambda: keyboard(tab), lambda: themes(tab, args.out),
                 lambda: files(tab, args.out, args.assets, args.recording), lambda: narrow(tab, args.out), lambda: quiet(tab, args.server)]
        for step in steps:
            began = time.monotonic()
            step()
            print(f"{step.__code__.co_names[0]}: {time.monotonic() - began:.1f} s")
        if args.pictures:
            tab = Tab(browser, 1280, 800)
            tab.theme("light")
            tab.open(args.server)
            looks(tab, args.out)
            pictures(tab, args.out)
        without_picture(args.browser, args.server)
        print("without picture: done")
        if args.tokens:
            asked = Tab(browser, 1280, 800)
            tokens(asked, *args.tokens)
            quiet(asked, args.tokens[0], ("401",))
            print("tokens: done")
        if args.tls:
            encrypted(args.browser, args.out, *args.tls)
            print("tls: done")
    finally:
        browser.close()
    print("all checks passed")


if __name__ == "__main__":
    main()
