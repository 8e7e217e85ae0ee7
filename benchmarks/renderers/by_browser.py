"""Pictures by PlayCanvas (npm) in a headless Chromium."""

from __future__ import annotations

import base64
import http.server
import io
import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from roigs_engine.formats import run_files
from roigs_engine.model.scene import PosedImage, SfmScene
from tests import chromium

VIEWER = "playcanvas@2.23.3"
SCRIPT = "playcanvas/build/playcanvas.js"
PAGE = Path(__file__).with_name("browser.html")
MOST_FRAMES = 40


def pictures(given: Namespace, scene: SfmScene) -> Iterator[tuple[str, Tensor, float]]:
    """Name, picture (H, W, 3) in sRGB and 0.0, photo by photo."""
    os.environ["ROIGS_CHROMIUM"] = given.program
    model = given.model / run_files.RESULT if given.model.is_dir() else given.model
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(_viewer(given.out), folder / "playcanvas.js")
        shutil.copy(PAGE, folder / "index.html")
        (folder / "model.ply").symlink_to(model.resolve())
        (folder / "start.html").write_text("")
        width = max(image.camera.width for image in scene.images)
        height = max(image.camera.height for image in scene.images)
        with (
            _served(folder) as address,
            chromium.Page(folder / "start.html", width=width, height=height) as page,
        ):
            page.call("Page.navigate", url=f"{address}/index.html")
            while not page.run("document.readyState === 'complete' && Boolean(window.ready)"):
                time.sleep(0.1)
            page.run("ready")
            for image in scene.images:
                yield image.name, _picture(page, image), 0.0


def _picture(page: chromium.Page, image: PosedImage) -> Tensor:
    """As soon as two frames are the same: Gaussians are sorted beside the drawing."""
    camera = json.dumps(asdict(image.camera))
    pose = json.dumps(image.world_to_camera.tolist())
    page.run(f"look({camera}, {pose})")
    before = None
    for _ in range(MOST_FRAMES):
        data = base64.b64decode(page.run("frame()").partition(",")[2])
        now = np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
        if before is not None and now.any() and (now == before).all():
            return torch.from_numpy(now.astype(np.float32) / 255)
        before = now
    raise SystemExit(f"error: the browser shows nothing still of {image.name}: {page.problems}")


def _viewer(out: Path) -> Path:
    """The viewer's script, from npm."""
    script = out / "node_modules" / SCRIPT
    if not script.is_file():
        npm = ["npm", "install", "--silent", "--no-save", "--prefix", str(out), VIEWER]
        subprocess.run(npm, check=True)
    return script


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Nothing."""


@contextmanager
def _served(folder: Path) -> Iterator[str]:
    """The folder's address: scripts of a page may read no files beside it."""
    handler = partial(_Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
