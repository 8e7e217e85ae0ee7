"""Resolves a training request once: settings, boxes and photos."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..context import Context
from ..errors import ConfigError, RunFolderError
from ..formats import clean_up, run_files
from ..formats.files import read_json, read_record
from ..formats.projects import model_folders, model_suffix
from ..requests.choices import COMPARISONS, MOST_BLOCKS
from ..requests.declare import read_options
from ..requests.runs import Train, TrainAndEvaluate
from ..requests.values import AUTO
from ..run.config import AUTO_BLOCKS, RunConfig
from ..run.presets import in_strategy, preset
from ..selection.cells import parsed_groups
from ..selection.manual import load_manual
from .inputs import BoxSource, is_photos, load_scene, mask_options, on_device
from .outputs import refuse_inputs, refuse_run_files
from .run_scene import warn_of_other_cameras

if TYPE_CHECKING:
    from ..model.roi import OrientedBox
    from ..model.scene import SfmScene
    from ..run.definition import Run


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A training as requested, before the scene is read."""

    request: Train  # for photos, its scene is the COLMAP project that they become
    photos: Path | None  # photos to make the project from; None if the scene has a model
    config: RunConfig  # the preset with the options; without blocks and groups
    boxes: BoxSource  # the source of the boxes
    compare: tuple[str, ...] = ()  # models to compare with
    evaluated: bool = False  # whether test photos are rendered and compared
    parts: tuple[str, ...] = ()  # parts of the run to do; empty for all

    @staticmethod
    def of(request: Train) -> Asked:
        """Resolve a request; EngineError if options contradict each other or the folder."""
        config = run_config(request)
        evaluated = isinstance(request, TrainAndEvaluate)
        if evaluated and config.test_every == 0:
            raise ConfigError(
                "--test-every 0 leaves no test photo to evaluate.",
                "Use 2 or more, or `train`, which does not evaluate.",
            )
        photos = request.scene if _is_photos(request) else None
        if photos is not None:
            request = replace(request, scene=request.run_dir / run_files.PROJECT)
        refuse_run_files(request.run_dir, option="--run-dir")
        compare: tuple[str, ...] = request.compare if isinstance(request, TrainAndEvaluate) else ()
        return Asked(
            request=request,
            photos=photos,
            config=config,
            boxes=BoxSource.of(request, request.run_dir),
            compare=COMPARISONS if "all" in compare else compare,
            evaluated=evaluated,
            parts=request.part if isinstance(request, TrainAndEvaluate) else (),
        )

    @staticmethod
    def of_run(folder: Path, scene: Path | None, **given: Any) -> Asked:
        """Resolve the training that made a run folder.

        Args:
            folder: of the run.
            scene: present place of its scene; None for the place at its training.
            given: options of `Train` instead of the run's own.

        Raises:
            RunFolderError: it is not a run folder.
            ConfigError: it has no record of its settings, or its scene was moved.
        """
        if not clean_up.is_run_folder(folder):
            raise RunFolderError(
                f"{folder} is not a run folder.", "Give the folder that --run-dir named."
            )
        settings = folder / run_files.SETTINGS
        if not settings.is_file():
            raise ConfigError(
                f"{folder} has no record of its training photos.",
                "Resume the run with `train`, which writes its settings.",
            )
        given |= {"run_dir": folder}
        training = Train(**read_options(settings, Train, given) | given)
        project = folder / run_files.PROJECT
        found = scene or (training.scene if training.scene.exists() else project)
        if not found.exists():
            raise ConfigError(
                f"The scene of {folder} was moved or deleted.", "Give its folder with --scene."
            )
        training = replace(training, scene=found, images=None if scene else training.images)
        manifest = folder / run_files.MANIFEST
        if read_record(manifest).get("rois"):
            # The original boxes file may be gone by now, or have other boxes.
            training = replace(training, rois=manifest, roi=(), only=())
        return Asked.of(training)

    @property
    def has_model(self) -> bool:
        """Whether the scene has a COLMAP model already."""
        return self.photos is None or bool(model_folders(self.request.scene))

    def inputs(self, rois: Sequence[OrientedBox] | None) -> dict[str, Any]:
        """Return boxes, settings and manual photos for `define_run`; empty without boxes."""
        if rois is None:
            return {}
        folder, lists = self.request.run_dir, self.request.selection
        names = [roi.name for roi in rois]
        blocks = self.request.blocks or 1
        if blocks == AUTO:  # a resumed run keeps its blocks on any machine
            blocks = _blocks_before(folder) or AUTO_BLOCKS
        groups = parsed_groups(self.request.group, names) if self.request.group else ()
        config = replace(self.config, blocks=int(blocks), groups=groups)
        if lists is None:
            return {"rois": rois, "config": config}
        own = (folder / run_files.SELECTION / f"{name}.json" for name in names)
        given = [lists / f"{name}.json" for name in names]
        refuse_inputs(own, given, "Give a copy of that folder to --selection.")
        return {"rois": rois, "config": config, "manual": load_manual(lists, rois)}

    def context(self, context: Context) -> Context:
        """Return the context with its device and memory for photos."""
        cache = self.request.image_cache
        memory = None if cache is None else int(1e6 * cache)
        return replace(on_device(context, self.request.device), photo_memory=memory)

    def scene(
        self,
        context: Context,
        *,
        pixels: bool = True,
        check: Callable[[SfmScene], None] | None = None,
    ) -> SfmScene:
        """Load the scene, with the masks of photos and of the boxes' objects; see `load_scene`."""
        from ..photos.contents import FILE as CONTENTS

        cache: Path | None = self.request.run_dir / run_files.CACHE
        # For a plan, the photos' contents matter only if there are results to compare with.
        if not pixels and cache and not (cache / CONTENTS).exists():
            cache = None
        masks = mask_options(self.request, self.boxes.names, self.request.run_dir)
        return load_scene(self.request, context, cache, pixels=pixels, check=check, masks=masks)

    def trained(self, context: Context) -> tuple[Run, Context]:
        """Define a trained run as `defined` does; warn if its scene has changed since."""
        return self.defined(context, check=partial(warn_of_other_cameras, self.request.run_dir))

    def defined(
        self,
        context: Context,
        *,
        pixels: bool = True,
        check: Callable[[SfmScene, Context], None] | None = None,
    ) -> tuple[Run, Context]:
        """Define the run without opening its folder; return it and the context with its device.

        Without `pixels`, the run is defined by its cameras alone, and nothing is written. `check`
        is called with the scene.
        """
        from ..run.definition import define_run

        inputs = self.inputs(self.boxes.given)  # first, to report their errors early
        context = self.context(context)
        scene = self.scene(context, pixels=pixels)
        if check is not None:
            check(scene, context)
        inputs = inputs or self.inputs(self.boxes.boxes(scene))
        return define_run(self.request.run_dir, scene, context=context, **inputs), context


def run_config(request: Train) -> RunConfig:
    """Return the preset with the options of a request, without blocks and groups."""
    config = preset(request.preset)
    if request.strategy and request.strategy != config.strategy:
        config = replace(in_strategy(config, request.strategy), preset=config.preset)
    if request.steps_factor is not None:
        config = config.scaled(request.steps_factor)
    config = replace(
        config,
        **_given(request, "kept_share", "roi_init", "roi_order", "test_every", "seed"),
        **_given(request, "evaluate_on"),
        selection=replace(config.selection, **_given(request, "method", "count", "seed")),
    )
    stages = _given(request, "sh_degree", "made_for")
    return replace(config, scene=replace(config.scene, **stages), roi=replace(config.roi, **stages))


def _given(request: Train, *names: str) -> dict[str, Any]:
    values = {name: getattr(request, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


def _blocks_before(folder: Path) -> int:
    """Return the number of blocks of the run in a folder; 0 without a run or blocks."""
    with suppress(RunFolderError, AttributeError):
        found = read_json(folder / run_files.MANIFEST).get("config", {}).get("blocks", 0)
        return found if isinstance(found, int) and 1 < found <= MOST_BLOCKS else 0
    return 0


def _is_photos(request: Train) -> bool:
    """Whether the scene is photos; ConfigError if the run folder or boxes contradict this."""
    if not is_photos(request.scene):
        return False
    if request.run_dir.resolve().is_relative_to(request.scene.resolve()):
        raise ConfigError(
            f"{request.run_dir} is in the folder of the photos.", "Choose another --run-dir."
        )
    project = request.run_dir / run_files.PROJECT
    if AUTO not in request.roi and not model_suffix(project / "sparse/0"):
        raise ConfigError(
            f"{request.scene} has no COLMAP model, so boxes have no coordinates yet.",
            f'Use --roi {AUTO} instead of boxes (roi = ["{AUTO}"] in a table), or make the model'
            " first (`reconstruct`).",
        )
    return True
