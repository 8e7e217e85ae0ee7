"""The table of a batch: scenes and their settings as TOML, each wrong line named."""

from __future__ import annotations

import argparse
import os
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..errors import ConfigError, EngineError
from ..exchange.formats import format_of
from ..formats.files import UNREADABLE, read_bytes
from ..formats.names import first_taken, is_file_name
from ..formats.run_files import BATCH_OUTPUTS, BATCH_ROWS, is_own
from ..formats.text import decode_text, json_digest
from ..storage.urls import is_url
from . import convert, run
from .options import AUTO
from .options_file import typed
from .values import PATH, shown

DEFAULTS, SCENES = "defaults", "scenes"
OUTPUTS, OBJECT_OUTPUTS = "outputs", "object_outputs"
NO_KEYS = {"help", "events", "run_dir", "update", "dry_run", "part", "threads"}
NO_KEYS |= {"cluster"}
OF_OUTPUTS = {"up", "from_up", "sh_degree"}  # options of `convert`
NO_RESULT = {"device", "image_cache", "preview_seconds"}  # these options change no result
HEADER, KEY = re.compile(r"\s*\[+\s*(.*?)\s*\]+"), re.compile(r"\s*(\"[^\"]*\"|'[^']*'|[\w-]+)\s*=")


@dataclass(frozen=True, kw_only=True)
class Wrong:
    """A wrong line of the table: its number, and what is wrong with it."""

    line: int
    text: str


@dataclass(frozen=True, kw_only=True)
class Row:
    """A scene of the table.

    Attributes:
        name: of its run folder.
        line: where it begins in the file.
        options: of `run`, as in an options file; paths are absolute.
        args: the same as the command line gives them, without a run folder.
        outputs: suffixes of files to write of the result.
        object_outputs: the same of each object.
        output_options: of `convert`, for these files.
        command: `run` or `train`.
        home: its run folder, if that is not in the folder of a batch.
        store: address of the batch's folder, if that is on a store.
        elsewhere: whether it is done on other machines, whose devices are not this one's.
        asked: the options as the table has them, if addresses in `options` became folders.
        blocks: number of blocks, once that is known.
    """

    name: str
    line: int
    options: dict[str, Any]
    args: argparse.Namespace = field(repr=False)
    outputs: tuple[str, ...] = ()
    object_outputs: tuple[str, ...] = ()
    output_options: dict[str, Any] = field(default_factory=dict)
    command: str = "run"
    home: Path | None = None
    store: str = ""
    elsewhere: bool = False
    asked: dict[str, Any] | None = None
    blocks: int = 1

    @property
    def digest(self) -> str:
        """Of everything that decides what its run makes."""
        decides = {k: v for k, v in (self.asked or self.options).items() if k not in NO_RESULT}
        return json_digest(decides)


class Table:
    """A table file.

    Attributes:
        path: the file.
        rows: its scenes, those without a wrong line.
        wrong: what is wrong.
    """

    def __init__(self, path: Path) -> None:
        """Read the file.

        Raises:
            ConfigError: it cannot be read, is not TOML, or has no scene.
        """
        self.path = path
        self.rows: list[Row] = []
        self.wrong: list[Wrong] = []
        self._folder = Path(os.path.abspath(path)).parent
        self._options, self._of_outputs = _options(), _output_options()
        text, record = _read(path)
        self._lines = dict(_lines(text))
        self._check_head(record)
        defaults = self._values(record.get(DEFAULTS, {}), (DEFAULTS,))
        for name, values in record[SCENES].items():
            self._add(name, values, defaults)
        taken = first_taken(record[SCENES])
        if taken is not None:
            self._say((SCENES, taken), f"Another scene is called '{taken}', but for its case.")
        self._check_outputs()

    def _add(self, name: str, values: Any, defaults: Mapping[str, Any]) -> None:
        """Add a scene, unless something is wrong with it."""
        place, before = (SCENES, name), len(self.wrong)
        if not is_file_name(name) or is_own(name) or name in (BATCH_ROWS, BATCH_OUTPUTS):
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
                " around what most photos show.",
            )
        if len(self.wrong) > before:
            return
        outputs, objects = (tuple(found.pop(key, ())) for key in (OUTPUTS, OBJECT_OUTPUTS))
        turned = {key: found.pop(key) for key in OF_OUTPUTS & found.keys()}
        args = argparse.Namespace(**{a.dest: a.default for a in self._options.values()})
        vars(args).update(found, update=True, part=[], dry_run=False)
        plain = {k: str(v) if isinstance(v, Path) else v for k, v in found.items()}
        row = Row(name=name, line=self._line(place), options=plain, args=args, outputs=outputs)
        self.rows.append(replace(row, object_outputs=objects, output_options=turned))

    def _check_outputs(self) -> None:
        """Two scenes must not write one file, nor a file where the other has its objects'."""
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
        """The values of a part of the table by the options' names."""
        found: dict[str, Any] = {}
        for key, value in record.items():
            name, where = key.replace("-", "_"), (*place, key)
            if name in found:
                self._say(where, f"'{key}' is there twice, with - and with _.")
            elif name in (OUTPUTS, OBJECT_OUTPUTS):
                found[name] = self._suffixes(value, where)
            elif name not in self._options and name not in self._of_outputs:
                options = {*self._options, *self._of_outputs}
                known = ", ".join(sorted({*options, OUTPUTS, OBJECT_OUTPUTS}))
                self._say(where, f"'{key:.60}' is no key of a scene. The keys are: {known}.")
            else:
                option = self._options.get(name) or self._of_outputs[name]
                if is_url(value) and option.type is PATH:
                    found[name] = value
                    continue
                try:
                    found[name] = self._absolute(typed(option, value, f"'{key}'"))
                except EngineError as error:
                    self._say(where, str(error))
        if found.get("masks") and found.get("no_masks"):
            self._say(place, "'masks' and 'no_masks' exclude one another. Remove one.")
        return found

    def _suffixes(self, value: Any, where: tuple[str, ...]) -> list[str]:
        """The suffixes of files to write."""
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self._say(where, f"'{where[-1]}' is {shown(value)}; write a list such as [\"glb\"].")
            return []
        found = list(dict.fromkeys(f".{item.lstrip('.').lower()}" for item in value))
        for suffix in found:
            try:
                format_of(Path(f"result{suffix}"))
            except EngineError as error:
                text = f"'{where[-1]}' has {shown(suffix.lstrip('.'))}, which is no format."
                self._say(where, f"{text} {error.hint}")
        return found

    def _absolute(self, value: Any) -> Any:
        """Paths start at the folder of the table."""
        return Path(os.path.normpath(self._folder / value)) if isinstance(value, Path) else value

    def _say(self, place: tuple[str, ...], text: str) -> None:
        self.wrong.append(Wrong(line=self._line(place), text=text))

    def _line(self, place: tuple[str, ...]) -> int:
        """The line of a key, or of what it is in; 1 if it is written in another way."""
        while place:
            lines = [n for key, n in self._lines.items() if key[: len(place)] == place]
            if lines:
                return min(lines)
            place = place[:-1]
        return 1


def _options() -> dict[str, argparse.Action]:
    """The options of `run` that a table may have, by name."""
    parser = argparse.ArgumentParser()
    run.add_arguments(parser)
    return {a.dest: a for a in parser._actions if a.dest not in NO_KEYS}


def _output_options() -> dict[str, argparse.Action]:
    """The options of `convert` that a table may have, by name."""
    parser = argparse.ArgumentParser()
    convert.add_arguments(parser)
    return {a.dest: a for a in parser._actions if a.dest in OF_OUTPUTS}


def _read(path: Path) -> tuple[str, dict[str, Any]]:
    try:
        text = decode_text(read_bytes(path))
        return text, tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"Cannot read {path} ({error.strerror}).", UNREADABLE) from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(
            f"{path} is not TOML ({error}).", "docs/many.md shows what a table looks like."
        ) from error


def _lines(text: str) -> Iterator[tuple[tuple[str, ...], int]]:
    """The keys of a table's headers and lines, and the numbers of these lines."""
    place: tuple[str, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := HEADER.match(line):
            place = tuple(_keys(header[1]))
            yield place, number
        elif key := KEY.match(line):
            yield (*place, key[1].strip("\"'")), number


def _keys(text: str) -> list[str]:
    """The keys of a dotted name, `scenes."hall 1"`."""
    return [part.strip("\"'") for part in re.findall(r'"[^"]*"|\'[^\']*\'|[^.\s]+', text)]
