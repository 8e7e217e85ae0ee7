"""`provenance.json`: the versions, machine and times behind the results of a run folder.

It has one entry for each time the engine worked in the folder. So the origin of a result stays
known after the program or the machine has changed. It has no environment variables, user names,
machine names or paths.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import EngineError, RunFolderError, Stopped
from ..formats.files import read_json, write_json
from ..formats.lock import check_held
from ..formats.run_files import PROVENANCE, STAGE
from ..formats.stage_list import read_stage_list
from ..kernels import library
from ..machine import machine_memory, processor_name, usable_cores
from .stage_folder import DamagedError, read_record

PACKAGES = ("torch", "numpy", "scipy", "scikit-learn", "pillow", "pycolmap")


@contextmanager
def recorded(folder: Path, seed: int, device: str) -> Iterator[None]:
    """Record in `folder`/provenance.json that the block ran there, and how it ended.

    Raises:
        RunFolderError: the file cannot be written, or is not the engine's.
    """
    path = folder / PROVENANCE
    entries = _earlier(path)
    versions = {}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    now: dict[str, Any] = {
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "ended": "killed",  # replaced unless the process is killed
        "seconds": None,
        "versions": {"roigs_engine": __version__, "python": platform.python_version()} | versions,
        "machine": {
            "system": platform.platform(),
            "chip": processor_name(),
            "cores": usable_cores(),
            "memory": machine_memory(),
        },
        "kernels": library.isa(),
        "threads": library.threads(),
        "device": device,
        "seed": seed,
    }
    write_json(path, {"entries": [*entries, now]})
    began = time.monotonic()
    try:
        yield
        now["ended"] = "done"
    except (Stopped, KeyboardInterrupt):
        now["ended"] = "stopped"
        raise
    except EngineError as error:
        now["ended"] = f"failed: {error.message}"
        raise
    except BaseException as error:
        now["ended"] = f"failed: {type(error).__name__}"
        raise
    finally:
        now["seconds"] = round(time.monotonic() - began, 1)
        now["stages"] = _stages(folder)
        with suppress(RunFolderError):  # the error that ended the block is more important
            check_held(folder)
            # Not durable: a sync would also flush the new checkpoint, and so delay a stop.
            write_json(path, {"entries": [*entries, now]}, durable=False)


def _earlier(path: Path) -> list[Any]:
    if not path.exists():
        return []
    hint = "Delete it, or choose another folder."
    record = read_json(path, hint=hint)
    if not isinstance(record, dict) or not isinstance(record.get("entries"), list):
        raise RunFolderError(f"{path} is not a provenance file.", hint)
    return list(record["entries"])


def _stages(folder: Path) -> dict[str, float]:
    """Finished stage -> its seconds of training."""
    found = {}
    for name, place in read_stage_list(folder).items():
        with suppress(RunFolderError, DamagedError):
            record = read_record(place / STAGE)
            if record is not None:
                found[name] = round(record.seconds, 1)
    return found
