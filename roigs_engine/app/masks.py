"""Makes masks of objects on many photos from a few strokes on one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..context import QUIET, Context
from ..errors import ConfigError
from ..formats.files import own_folder
from ..formats.mask_record import box_folders
from ..formats.scribbles import Scribble, read_scribbles
from ..formats.splat_ply import check_ply
from ..photos.mask_paths import MaskOptions
from ..requests.models import Masks
from .inputs import boxes_of, load_model, on_device, use_threads
from .outputs import Result, refuse_inputs, refuse_run_files

if TYPE_CHECKING:
    from ..masking.propagation import Knowledge
    from ..model.gaussians import Gaussians
    from ..model.local_frame import LocalFrame
    from ..model.roi import OrientedBox
    from ..model.scene import SfmScene


def make_masks(request: Masks, context: Context = QUIET) -> Result:
    """Make the masks of each box that has strokes; `files` has their folders.

    EngineError: an input cannot be used, there are no strokes, or OpenCV is missing.
    """

    from ..colmap.project import load_colmap
    from ..masking.views import opencv
    from ..model.local_frame import LocalFrame

    refuse_run_files(request.out)
    rois = boxes_of(request)
    names = [roi.name for roi in rois]
    scribbles = [each for each in read_scribbles(request.scribbles) if each.box in names]
    if not scribbles:
        raise ConfigError(
            f"{request.scribbles} has no stroke for a box ({', '.join(names)}).",
            "Name the box as in rois.json.",
        )
    inputs = (request.options_file, request.rois, request.scribbles, request.model)
    refuse_inputs([request.out], inputs)
    if request.model is not None:
        check_ply(request.model)
    opencv()
    use_threads(request.threads)
    context = on_device(context, request.device)
    scene = load_colmap(  # photos are decoded later, one by one
        request.scene,
        images=request.images,
        masks=MaskOptions(used=False),
        pixels=False,
        context=replace(context, emit=QUIET.emit),
    )
    there = {image.name for image in scene.images}
    for name in (*request.photo, *(each.photo for each in scribbles)):
        if name not in there:
            raise ConfigError(
                f"The scene has no usable photo '{name}'.",
                "Use the name of a photo in the COLMAP model.",
            )
    frame, model = LocalFrame.of_scene(scene), None
    if request.model is not None:
        model = load_model(request.model, frame, context)
    else:
        context.info("Without --model, masks follow the sparse points and colours: check each.")
    maker = _Maker(request=request, scene=scene, rois=rois, frame=frame, model=model)
    folders = {}
    for roi in rois:
        own = {each.photo: each for each in scribbles if each.box == roi.name}
        if own:
            folders[roi.name] = maker.make(roi, own, context)
    return Result(files=folders).with_places()


@dataclass(frozen=True, kw_only=True)
class _Maker:
    """Makes the masks of one box at a time; the scene and its boxes are in the world's frame."""

    request: Masks
    scene: SfmScene
    rois: list[OrientedBox]
    frame: LocalFrame
    model: Gaussians | None

    def make(self, roi: OrientedBox, scribbles: Mapping[str, Scribble], context: Context) -> Path:
        """Make the masks of a box from the strokes on each photo; return their folder."""
        from ..colmap.photo_pixels import photo_pixels
        from ..colmap.project import find_model
        from ..masking.box_masks import BoxMasks, basis_digest, masked_photos
        from ..selection import SelectionConfig, select_cameras

        request, scene, frame = self.request, self.scene, self.frame
        knowledge = self._knowledge(roi, context)
        names = [*scribbles, *request.photo]
        if not request.photo:
            quiet = replace(context, emit=QUIET.emit)
            selection = select_cameras(scene, roi, SelectionConfig(), quiet)
            names = masked_photos(selection.names, selection.candidates, list(scribbles))
        folder = own_folder(request.out, box_folders(request.out, roi.name)[0].name)
        images = [image for image in scene.images if image.name in names]
        work = BoxMasks(
            scene=frame.scene(scene),
            roi=frame.box(roi),
            photos=photo_pixels(find_model(request.scene), images, context),
            strokes={name: scribble.strokes for name, scribble in scribbles.items()},
            folder=folder,
            basis=basis_digest(request.model, scene, roi, self.rois),
            anew=request.anew,
        )
        work.make(knowledge, context)
        return folder

    def _knowledge(self, roi: OrientedBox, context: Context) -> Knowledge:
        """Return the model, or points, that carry masks from photo to photo."""
        frame = self.frame
        if self.model is None:
            from ..masking.point_votes import PointVotes

            return PointVotes(frame.scene(self.scene), frame.box(roi))
        from ..masking.gaussian_votes import GaussianVotes

        boxes = [frame.box(each) for each in self.rois]
        votes = GaussianVotes(self.model, frame.box(roi), boxes, context)
        if votes.is_empty:
            raise ConfigError(
                f"The model has no Gaussian in box '{roi.name}'.",
                "Give --model the scene's result.ply.",
            )
        return votes
