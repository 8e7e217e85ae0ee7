"""Reads a batch's table: scenes and their settings as TOML. Errors name the wrong line."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..errors import ConfigError, EngineError
from ..exchange.formats import writable
from ..formats.files import UNREADABLE, read_bytes, write_text
from ..formats.names import first_taken, is_file_name, safe_name
from ..formats.projects import model_folders
from ..formats.run_files import BATCH_OUTPUTS, BATCH_ROWS, is_of_batch
from ..formats.text import decode_text, json_digest
from ..photos.files import EXTENSIONS, HEIC
from ..requests.declare import options_of, plain
from ..requests.models import Convert
from ..requests.runs import Train, TrainAndEvaluate
from ..requests.values import AUTO, PathName, PlaceName, begins_as_url, shown
from .inputs import is_photos

DEFAULTS, SCENES = "defaults", "scenes"
OUTPUTS, OBJECT_OUTPUTS = "outputs", "object_outputs"
NO_KEYS = {"run_dir", "update", "dry_run", "part", "threads", "cluster"}
OF_OUTPUTS = {"up", "from_up", "sh_degree"}  # options of `convert` for the outputs
NO_RESULT = {"device", "image_cache", "preview_seconds"}  # these options change no result
HEADER, KEY = re.compile(r"\s*\[{1,2}([^\]]*)\]"), re.compile(r"\s*(\"[^\"]*\"|'[^']*'|[\w-]+)\s*=")
MOST_TABLE = 4 << 20  # bytes, for some 20,000 scenes; reading TOML takes 2 s per million bytes
BETWEEN_KEYS, MOST_PARTS = re.compile(r"[^\w\s.\"'-]"), 200


@dataclass(frozen=True, kw_only=True)
class Wrong:
    """A wrong line of the table: its number, and the mistake."""

    line: int
    text: str


@dataclass(frozen=True, kw_only=True)
class Row:
    """A scene of the table."""

    name: str  # of its run folder
    line: int  # its first line in the file
    options: dict[str, Any]  # of `run`, as in an options file; paths are absolute
    run_dir: Path  # its run folder, in the batch's folder
    options_file: Path  # file of the options, for its engines
    outputs: tuple[str, ...] = ()  # suffixes of files to write of the result
    object_outputs: tuple[str, ...] = ()  # suffixes of files to write of each object
    output_options: dict[str, Any] = field(default_factory=dict)  # of `convert`, for these files
    kind: type[Train] = TrainAndEvaluate  # class of its request
    store: str = ""  # address of the batch's folder, if it is on a store
    elsewhere: bool = False  # whether it runs on other machines, with other devices
    asked: dict[str, Any] | None = None  # the table's options, if addresses became folders here
    update: bool = True  # whether its run folder may have another run

    @property
    def request(self) -> Train:
        """Return the request that plans the row here, even if other machines run it."""
        more = {"device": "cpu"} if self.elsewhere else {}
        return self.kind.of(self.options, run_dir=self.run_dir, update=self.update, **more)

    @property
    def digest(self) -> str:
        """Return a digest of everything that decides its results."""
        decides = {k: v for k, v in (self.asked or self.options).items() if k not in NO_RESULT}
        return json_digest(decides)


class Table:
    """A table file.

    Attributes:
        path: the file.
        rows: its scenes without a wrong line.
        wrong: the wrong lines.
    """

    def __init__(self, path: Path, folder: Path) -> None:
        """Read the file of a batch in `folder`.

        ConfigError: it cannot be read, is not TOML, or has no scene.
        """
        self.path, self._batch = path, folder
        self.rows: list[Row] = []
        self.wrong: list[Wrong] = []
        self._folder = Path(os.path.abspath(path)).parent
        run, convert = options_of(TrainAndEvaluate), options_of(Convert)
        self._options = {name: found for name, found in run.items() if name not in NO_KEYS}
        self._options |= {name: convert[name] for name in OF_OUTPUTS}
        text, record = _read(path)
        self._lines = _first_lines(text)
        self._check_head(record)
        defaults = self._values(record.get(DEFAULTS, {}), (DEFAULTS,))
        for name, values in record[SCENES].items():
            self._add(name, values, defaults)
        taken = first_taken(record[SCENES])
        if taken is not None:
            self._say((SCENES, taken), f"Another scene has the name '{taken}', except for case.")
        self._check_outputs()

    def _add(self, name: str, values: Any, defaults: Mapping[str, Any]) -> None:
        place, before = (SCENES, name), len(self.wrong)
        if not is_file_name(name) or is_of_batch(name):
            text = f"A scene cannot be called {shown(name)}, as its run folder is. Rename it."
            self._say(place, text)
        if not isinstance(values, dict):
            self._say(place, f"'{name}' is {shown(values)}; write [{SCENES}.{name}].")
            return
        given = self._values(values, place)
        if "rois" in given or "roi" in given:  # its own boxes replace those of [defaults]
            defaults = {key: v for key, v in defaults.items() if key not in ("rois", "roi")}
        found = {"compare": [], **defaults, **given}
        if "scene" not in found and len(self.wrong) == before:
            self._say(place, f"Scene '{name}' has no folder. Add scene = \"FOLDER\".")
        if not (found.get("rois") or found.get("roi")) and len(self.wrong) == before:
            self._say(
                place,
                f'Scene \'{name}\' has no box. Add rois = "FILE", or roi = ["{AUTO}"]: a box'
                " around the main object of the photos.",
            )
        if len(self.wrong) > before:
            return
        outputs, objects = (tuple(found.pop(key, ())) for key in (OUTPUTS, OBJECT_OUTPUTS))
        turned = {key: found.pop(key) for key in OF_OUTPUTS & found.keys()}
        row = Row(
            name=name,
            line=self._line(place),
            options={key: plain(value) for key, value in found.items()},
            run_dir=self._batch / name,
            options_file=self._batch / BATCH_ROWS / f"{name}.json",
            outputs=outputs,
            object_outputs=objects,
            output_options=turned,
        )
        self.rows.append(row)

    def _check_outputs(self) -> None:
        """Refuse two scenes that write the same file, or a file in place of another's folder."""
        taken: dict[str, str] = {}
        for row in self.rows:
            places = [f"{row.name}{suffix}" for suffix in row.outputs]
            for place in [*places, *([row.name] if row.object_outputs else [])]:
                other = taken.setdefault(place.casefold(), row.name)
                if other != row.name:
                    text = f"Scenes '{other}' and '{row.name}' both write {BATCH_OUTPUTS}/{place}."
                    self._say((SCENES, row.name), f"{text} Rename one.")

    def _check_head(self, record: dict[str, Any]) -> None:
        for key in record.keys() - {DEFAULTS, SCENES}:
            self._say((key,), f"'{key:.60}' is unknown; write [{DEFAULTS}] or [{SCENES}.NAME].")
        if not isinstance(record.get(DEFAULTS, {}), dict):
            record[DEFAULTS] = {}
            self._say((DEFAULTS,), f"Write [{DEFAULTS}] as a table.")
        if not isinstance(record.get(SCENES), dict) or not record[SCENES]:
            found = " ".join(["The table has no scene.", *(wrong.text for wrong in self.wrong)])
            raise ConfigError(found, f"Add [{SCENES}.NAME] with its scene.")

    def _values(self, record: Mapping[str, Any], place: tuple[str, ...]) -> dict[str, Any]:
        """Return the checked values of a part of the table, by option names."""
        found: dict[str, Any] = {}
        for key, value in record.items():
            name, where = key.replace("-", "_"), (*place, key)
            if name in found:
                self._say(where, f"'{key}' is given twice, with - and with _.")
            elif name in (OUTPUTS, OBJECT_OUTPUTS):
                found[name] = self._suffixes(value, where)
            elif name not in self._options:
                known = ", ".join(sorted({*self._options, OUTPUTS, OBJECT_OUTPUTS}))
                self._say(where, f"'{key:.60}' is no key of a scene. The keys are: {known}.")
            else:
                option = self._options[name]
                if isinstance(option.kind, PathName) and begins_as_url(value):
                    option = replace(option, kind=PlaceName())
                try:
                    checked = option.checked(value, f"'{key}'")
                except EngineError as error:
                    self._say(where, str(error))
                    continue
                if isinstance(checked, Path):  # relative to the folder of the table
                    checked = Path(os.path.normpath(self._folder / checked))
                found[name] = checked
        if found.get("masks") and found.get("no_masks"):
            self._say(place, "'masks' and 'no_masks' exclude one another. Remove one.")
        return found

    def _suffixes(self, value: Any, where: tuple[str, ...]) -> list[str]:
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self._say(where, f"'{where[-1]}' is {shown(value)}; write a list such as [\"glb\"].")
            return []
        found = list(dict.fromkeys(f".{item.lstrip('.').lower()}" for item in value))
        for suffix in found:
            text = f"'{where[-1]}' has {shown(suffix.lstrip('.'))}, which is no format."
            try:
                form = writable(Path(f"result{suffix}"))
            except EngineError as error:
                self._say(where, f"{text} {error.hint}")
                continue
            if suffix != form.suffix:  # more of a name, or even a path
                self._say(where, f"{text} Write {form.suffix.lstrip('.')}.")
        return found

    def _say(self, place: tuple[str, ...], text: str) -> None:
        self.wrong.append(Wrong(line=self._line(place), text=text))

    def _line(self, place: tuple[str, ...]) -> int:
        """Return the line of a key, or of its table; 1 if it is written in another way."""
        while place:
            if place in self._lines:
                return self._lines[place]
            place = place[:-1]
        return 1


def _read(path: Path) -> tuple[str, dict[str, Any]]:
    try:
        text = decode_text(read_bytes(path, MOST_TABLE))
        runs = (run for line in text.splitlines() for run in BETWEEN_KEYS.split(line))
        if any(run.count(".") > MOST_PARTS for run in runs):  # tomllib's memory is quadratic
            raise ValueError("a key has too many parts")
        return text, tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(
            f"{path} is not TOML ({error}).", "docs/many.md shows an example of a table."
        ) from error


def _first_lines(text: str) -> dict[tuple[str, ...], int]:
    """Return the first line of each key and table."""
    found: dict[tuple[str, ...], int] = {}
    place: tuple[str, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := HEADER.match(line):  # such as `[scenes."hall 1"]`
            names = re.findall(r'"[^"]*"|\'[^\']*\'|[^.\s]+', header[1])
            key = place = tuple(name.strip("\"'") for name in names)
        elif named := KEY.match(line):
            key = (*place, named[1].strip("\"'"))
        else:
            continue
        for length in range(1, len(key) + 1):
            found.setdefault(key[:length], number)
    return found


# --- tables of what a folder has ---

BARE = re.compile(r"[A-Za-z0-9_-]+")  # keys that need no quotes in TOML
DEPTH = 3  # levels of folders that are searched
HEAD = """\
# The scenes of a batch. Start it with: python -m roigs_engine batch {name} --run-dir runs/{stem}
# Paths start at the folder of this file. Every option of `run` may stand in [defaults], for all
# scenes, or with one scene, which wins.

[defaults]
preset = "draft"
# max_side = 1600
# outputs = ["spz"]           # files of each result
# object_outputs = ["glb"]    # files of each object
"""


def write_table(path: Path, folder: Path) -> int:
    """Write the table of a folder's scenes; return their number.

    Args:
        path: the table, which must not exist.
        folder: with COLMAP projects or folders of photos below it.

    Raises:
        ConfigError: the table exists, or the folder has no scene.
        RunFolderError: the table cannot be written.
    """
    if path.exists():
        raise ConfigError(f"{path} exists.", "Choose another name, or delete it.")
    if not folder.is_dir():
        raise ConfigError(f"There is no folder {folder}.", "Give the folder of your scenes.")
    scenes = list(_scenes(folder, DEPTH))
    if not scenes:
        raise ConfigError(
            f"{folder} has no scene: no COLMAP project and no photos.",
            "Give the folder that your scenes' folders are in.",
        )
    parts = [HEAD.format(name=_shell(path.name), stem=_shell(path.stem))]
    taken: set[str] = set()
    for scene in scenes:
        name = _free_name(folder, scene, taken)
        parts.append(_table_row(name, scene, path.parent))
    write_text(path, "\n".join(parts))
    return len(scenes)


def _scenes(folder: Path, depth: int) -> Iterator[Path]:
    """Yield the scenes at and below a folder, sorted; none is within another."""
    if model_folders(folder) or (_has_photos(folder) and is_photos(folder)):
        yield folder
        return
    if depth:
        for child in sorted(folder.iterdir()):
            if child.name.startswith(".") or not os.access(child, os.R_OK | os.X_OK):
                continue
            if child.is_dir() and not child.is_symlink():
                yield from _scenes(child, depth - 1)


def _has_photos(folder: Path) -> bool:
    """Whether photos are directly in the folder, or in its folder `images`."""
    places = [place for place in (folder, folder / "images") if place.is_dir()]
    return any(p.suffix.lower() in EXTENSIONS | HEIC for each in places for p in each.iterdir())


def _free_name(folder: Path, scene: Path, taken: set[str]) -> str:
    """Return a name for the scene's run folder: its folders' names, with a number if taken."""
    parts = scene.relative_to(folder).parts or (Path(os.path.abspath(scene)).name,)
    name = safe_name("-".join(parts))
    if is_of_batch(name):
        name = f"{name}-1"
    base, number = name, 1
    while name.casefold() in taken:
        number += 1
        name = f"{base}-{number}"
    taken.add(name.casefold())
    return name


def _table_row(name: str, scene: Path, home: Path) -> str:
    is_near = Path(os.path.abspath(scene)).is_relative_to(os.path.abspath(home))
    place = os.path.relpath(scene, home) if is_near else os.path.abspath(scene)
    boxes = scene / "rois.json"
    lines = [
        f"[scenes.{name if BARE.fullmatch(name) else _quoted(name)}]",
        f"scene = {_quoted(Path(place).as_posix())}",
    ]
    if boxes.is_file():
        lines.append(f"rois = {_quoted((Path(place) / 'rois.json').as_posix())}")
    else:
        lines.append('roi = ["auto"]  # a box around the main object of the photos')
    return "\n".join([*lines, ""])


def _quoted(text: str) -> str:
    """Return a TOML string. JSON's escapes are valid; surrogates are not, and are replaced."""
    text = json.dumps(text.encode("utf-8", "replace").decode(), ensure_ascii=False)
    return text.replace("\x7f", "\\u007f")  # JSON allows it unescaped, TOML does not


def _shell(name: str) -> str:
    return f'"{name}"' if " " in name else name
