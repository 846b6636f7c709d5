"""Headless Chromium, controlled over a pipe with its DevTools protocol."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

from armadico.launch.processes import kill_trees

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")

FLAGS = (
    "--headless",
    "--no-sandbox",  # containers lack what a sandbox needs; it opens our own page only
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--disable-extensions",
    "--disable-background-networking",
    "--hide-scrollbars",
    "--enable-webgl",
    "--ignore-gpu-blocklist",
    "--use-angle=swiftshader",  # WebGL by the processor
    "--enable-unsafe-swiftshader",
    "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",  # no internet
    "--remote-debugging-pipe",
)

ANSWER_S = 60.0

Event = dict[str, Any]


class Browser:
    """One page; `events` has all events received, newest last. Leaves nothing running."""

    def __init__(self, folder: Path, width: int, height: int) -> None:
        """Start it; `folder` is for its profile and its log."""
        self.events: list[Event] = []
        self._calls = 0
        self._rest = b""
        with (folder / "chromium.log").open("wb") as log:
            self._popen = self._start(folder, f"--window-size={width},{height}", log.fileno())
        try:
            self._session = self._attach()
            view = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            self.call("Emulation.setDeviceMetricsOverride", **view)
            for domain in ("Page", "Runtime", "Log", "Network"):
                self.call(f"{domain}.enable")
        except BaseException:
            self.stop()
            raise

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def open(self, address: str) -> None:
        """Open a page, and return when it is loaded; its scripts may still run."""
        self.events.clear()
        self.call("Page.navigate", url=address)
        deadline = time.monotonic() + ANSWER_S
        while not self.received("Page.loadEventFired"):
            self._keep(self._next(deadline))

    def evaluate(self, script: str) -> Any:
        """The value of a script in the page; a promise is awaited."""
        parameters = {"expression": script, "awaitPromise": True, "returnByValue": True}
        found = self.call("Runtime.evaluate", **parameters)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def until(self, condition: str, seconds: float = ANSWER_S / 2) -> Any:
        """The value of an expression as soon as it is true, polled in the page."""
        script = f"""new Promise((done, late) => {{
            const end = performance.now() + {1000 * seconds};
            const check = () => {{
                let value = null;
                try {{ value = ({condition}); }} catch {{ }}
                if (value) done(value);
                else if (performance.now() > end) late(new Error(document.body.innerText));
                else setTimeout(check, 20);
            }};
            check();
        }})"""
        return self.evaluate(script)

    def key(self, key: str, code: str, *kinds: str) -> None:
        """Press and release a key, or only one of both: `keyDown`, `keyUp`."""
        number = {"Space": 32, "Enter": 13, "Tab": 9, "Escape": 27}.get(code, ord(key[0].upper()))
        known = {"key": key, "code": code, "windowsVirtualKeyCode": number}
        for kind in kinds or ("keyDown", "keyUp"):
            text = {"text": "\r"} if (code, kind) == ("Enter", "keyDown") else {}
            self.call("Input.dispatchKeyEvent", type=kind, **known, **text)

    def mouse(self, kind: str, x: float, y: float) -> None:
        """Send a mouse event at a place of the page: `mousePressed` and so on."""
        held = {"button": "left", "buttons": 0 if kind == "mouseReleased" else 1, "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **held)

    def drag(self, *points: tuple[float, float]) -> None:
        """Press at the first place and release at the last; a single place is a click."""
        self.mouse("mousePressed", *points[0])
        for point in points[1:]:
            self.mouse("mouseMoved", *point)
        self.mouse("mouseReleased", *points[-1])

    def size(self, width: int, height: int, *, mobile: bool = False, dark: bool = False) -> None:
        """Set the size of the page, and the preferred colour scheme."""
        view = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
        self.call("Emulation.setDeviceMetricsOverride", **view)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.call("Emulation.setEmulatedMedia", features=scheme)

    def screenshot(self) -> bytes:
        """The page as PNG."""
        png: str = self.call("Page.captureScreenshot", format="png")["data"]
        return base64.b64decode(png)

    def received(self, method: str) -> list[Event]:
        """The events of one kind since the page was opened."""
        return [event["params"] for event in self.events if event.get("method") == method]

    def call(self, method: str, **parameters: Any) -> Any:
        """Call a method and return its result; events that arrive meanwhile are kept."""
        return self._call(method, parameters, {"sessionId": self._session})

    def stop(self) -> None:
        """End it and its helpers."""
        kill_trees(self._popen)
        os.close(self._write)
        os.close(self._read)

    def _start(self, folder: Path, size: str, log: int) -> subprocess.Popen[bytes]:
        """The process; it reads calls on descriptor 3 and answers on 4."""
        program = executable()
        assert program is not None, "check `executable` first"
        commands, self._write = os.pipe()
        self._read, answers = os.pipe()
        redirected = f'exec "$@" 3<&{commands} 4>&{answers}'
        profile = f"--user-data-dir={folder / 'profile'}"
        try:
            return subprocess.Popen(
                ["bash", "-c", redirected, "-", program, *FLAGS, profile, size, "about:blank"],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=(commands, answers),
                start_new_session=True,
            )
        finally:
            os.close(commands)
            os.close(answers)

    def _attach(self) -> str:
        """A session with its one page."""
        pages = self._call("Target.getTargets", {}, {})["targetInfos"]
        page = next(target["targetId"] for target in pages if target["type"] == "page")
        parameters = {"targetId": page, "flatten": True}
        session: str = self._call("Target.attachToTarget", parameters, {})["sessionId"]
        return session

    def _call(self, method: str, parameters: Event, address: Event) -> Any:
        self._calls += 1
        message = {"id": self._calls, "method": method, "params": parameters, **address}
        os.write(self._write, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + ANSWER_S
        while (answer := self._next(deadline)).get("id") != self._calls:
            self._keep(answer)
        assert "error" not in answer, f"{method}: {answer['error']}"
        return answer["result"]

    def _keep(self, event: Event) -> None:
        # Debug messages of the page are many, and are not needed.
        if event.get("params", {}).get("type") != "debug":
            self.events.append(event)

    def _next(self, deadline: float) -> Event:
        """The next message; each ends with a zero byte."""
        while b"\0" not in self._rest:
            left = max(deadline - time.monotonic(), 0.0)
            if not select.select([self._read], [], [], left)[0]:
                raise TimeoutError(f"the browser did not answer within {ANSWER_S:.0f} s")
            data = os.read(self._read, 2**20)
            if not data:
                raise ConnectionError("the browser has ended")
            self._rest += data
        text, _, self._rest = self._rest.partition(b"\0")
        message: Event = json.loads(text)
        return message


def executable() -> str | None:
    """The path of a Chromium; None if there is none."""
    return next((found for name in NAMES if (found := shutil.which(name))), None)
