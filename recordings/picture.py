#!/usr/bin/env python3
"""Takes a picture of a recording as the rerun viewer shows it, without a screen and without a GPU.

    python3 recordings/picture.py recordings/NAME.rrd [--out NAME.png] [--tick TICK] [--holdpoint PROGRAM] [--window]

The recording is cut at TICK (240 a second of virtual time) by `holdpoint replay --to`, so that the viewer, which goes to
the end of a file, stands at that moment. Without TICK it shows the end. By default the viewer has no window and is asked
for the picture; with --window it runs in a real window under Xvfb, as on a person's screen, and takes the picture itself.

Needs: pip install rerun-sdk==0.36.3, run with that Python; a Vulkan driver, for which software is enough
(Debian: mesa-vulkan-drivers libvulkan1); for --window also xvfb and the libraries of an X program (Debian: libx11-xcb1
libxcursor1 libxi6 libxrandr2 libxkbcommon-x11-0).
"""

import argparse
import contextlib
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rerun_cli
from rerun.experimental import ViewerClient

WIDTH, HEIGHT = 1600, 900
# How long the viewer may take to show the same picture twice in a row, seconds.
PATIENCE_SECS = 120
# Between two pictures, seconds; a software renderer needs about half of it for a frame.
PAUSE_SECS = 1.5
# A picture of an empty window is smaller than this, bytes.
EMPTY_BYTES_MAX = 20_000


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path)
    parser.add_argument("--out", type=Path, help="the picture [default: beside the recording, as .png]")
    parser.add_argument("--tick", type=int, help="the moment to show [default: the end]")
    parser.add_argument("--holdpoint", default="holdpoint", help="the program that cuts it [default: %(default)s]")
    parser.add_argument("--window", action="store_true", help="use a real window under Xvfb")
    args = parser.parse_args()
    picture = (args.out or args.recording.with_suffix(".png")).resolve()
    if not args.recording.is_file():
        print(f'there is no recording "{args.recording}"', file=sys.stderr)
        return 2
    # No counts of use are sent from a script.
    os.environ.setdefault("CI", "true")
    with tempfile.TemporaryDirectory() as scratch:
        os.environ.setdefault("XDG_RUNTIME_DIR", scratch)
        shown = args.recording.resolve()
        if args.tick is not None:
            shown = cut(shown, args.tick, args.holdpoint, Path(scratch))
        taken = (in_window if args.window else without_window)(shown, Path(scratch))
        picture.write_bytes(taken)
    print(f"{picture.name}: {len(taken)} bytes")
    return 0


def viewer() -> str:
    """The program itself. pip's `rerun` only starts it, and ending that leaves the viewer running."""
    return str(Path(rerun_cli.__file__).parent / "rerun")


def cut(recording: Path, tick: int, program: str, scratch: Path) -> Path:
    """The recording up to the end of `tick`, with its layout."""
    part = scratch / f"{recording.stem}.rrd"
    command = [program, "replay", str(recording), "--to", str(tick), "--out", str(part)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        sys.exit(f"cannot cut {recording} at tick {tick}: {done.stderr.strip()}")
    return part


@contextlib.contextmanager
def running(command: list[str], log: Path, **more):
    """A program that runs meanwhile and is ended afterwards."""
    with log.open("wb") as out:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=out, stderr=out, **more)
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def settled(process: subprocess.Popen, log: Path, take) -> bytes:
    """The first picture that is taken twice in a row; what is loading looks different each time."""
    deadline = time.monotonic() + PATIENCE_SECS
    last = b""
    while time.monotonic() < deadline:
        time.sleep(PAUSE_SECS)
        if process.poll() is not None:
            sys.exit(f"the viewer ended with {process.returncode}:\n{log.read_text(errors='replace')[-2000:]}")
        now = take()
        if len(now) > EMPTY_BYTES_MAX and now == last:
            return now
        last = now
    sys.exit(f"the picture did not settle in {PATIENCE_SECS} s:\n{log.read_text(errors='replace')[-2000:]}")


def without_window(recording: Path, scratch: Path) -> bytes:
    port, log, file = free_port(), scratch / "viewer.log", scratch / "picture.png"
    command = [viewer(), "--headless", str(recording), "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--window-size", f"{WIDTH}x{HEIGHT}"]

    def take() -> bytes:
        file.unlink(missing_ok=True)
        with contextlib.suppress(Exception):  # it does not listen yet
            ViewerClient(f"rerun+http://127.0.0.1:{port}/proxy").save_screenshot(str(file))
        return whole(file)

    with running(command, log) as process:
        return settled(process, log, take)


def whole(file: Path) -> bytes:
    """A file that another program writes, once its size stays the same; nothing where it does not come."""
    deadline, size = time.monotonic() + 5, -1
    while time.monotonic() < deadline:
        time.sleep(0.1)
        now = file.stat().st_size if file.is_file() else 0
        if now > 0 and now == size:
            return file.read_bytes()
        size = now
    return b""


def in_window(recording: Path, scratch: Path) -> bytes:
    """The viewer takes the picture of its own window and ends: an X server without a compositor shows it as black."""
    display, log, file = f":{90 + os.getpid() % 900}", scratch / "viewer.log", scratch / "picture.png"
    server = ["Xvfb", display, "-screen", "0", f"{WIDTH}x{HEIGHT}x24", "-nolisten", "tcp"]
    command = [viewer(), str(recording), "--bind", "127.0.0.1", "--port", str(free_port())]
    command += ["--window-size", f"{WIDTH}x{HEIGHT}", "--screenshot-to", str(file)]
    environment = {**os.environ, "DISPLAY": display, "WAYLAND_DISPLAY": ""}
    with running(server, scratch / "server.log") as x_server:
        deadline = time.monotonic() + 20
        while not Path(f"/tmp/.X11-unix/X{display[1:]}").exists():
            if x_server.poll() is not None or time.monotonic() > deadline:
                sys.exit("Xvfb does not start")
            time.sleep(0.1)
        with running(command, log, env=environment) as process, contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=PATIENCE_SECS)
    if not file.is_file():
        sys.exit(f"the viewer took no picture:\n{log.read_text(errors='replace')[-2000:]}")
    return file.read_bytes()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


if __name__ == "__main__":
    sys.exit(main())
