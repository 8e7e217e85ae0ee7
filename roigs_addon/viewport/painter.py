"""Keeps Gaussians and their orders on the GPU, and draws them."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix
from numpy.typing import NDArray

from ..geometry.splat_cloud import SplatCloud, read_splats
from ..worker import Worker
from . import pace, shaders, targets
from .levels_in_view import InView
from .objects import FileKey, SplatObject
from .packing import PackedSet, pack, pack_order
from .placed import Files, object_texels, sorting_view
from .sorting import SortingView, back_to_front
from .view import Frame, View, whole

Float32 = NDArray[np.float32]

VIEWS = 8
"""Most viewports that keep their own order."""


@dataclass(frozen=True, eq=False)
class GpuSet:
    """A set of Gaussians on the GPU; `files`, `lights`, `photo_focals` have a value per object."""

    files: Files
    means: Float32
    ranges: tuple[tuple[int, int], ...]
    extent: float
    sh_texels: int
    lights: tuple[bool, ...]
    photo_focals: tuple[float, ...]
    geometry: gpu.types.GPUTexture
    colours: gpu.types.GPUTexture

    @classmethod
    def upload(cls, files: Files, packed: PackedSet) -> GpuSet:
        """Copy a set to the GPU: shapes as 32-bit floats, colours as 16-bit floats."""
        return cls(
            files,
            packed.means,
            packed.ranges,
            packed.extent,
            packed.sh_texels,
            packed.lights,
            packed.photo_focals,
            targets.texture(packed.geometry, "RGBA32F"),
            targets.texture(packed.colours, "RGBA16F"),
        )


@dataclass(frozen=True, eq=False)
class Order:
    """The rows of a set from back to front, on the GPU, for one view."""

    gaussians: GpuSet
    view: SortingView
    count: int
    texture: gpu.types.GPUTexture

    @property
    def files(self) -> Files:
        """Return the files of the objects in the order."""
        return tuple(self.gaussians.files[k] for k in self._rows())

    @property
    def linear_light(self) -> bool:
        """Whether it is blended in linear light: decided by most of its Gaussians."""
        ranges, lights = self.gaussians.ranges, self.gaussians.lights
        sizes = ((ranges[k][1] - ranges[k][0]) * (1 if lights[k] else -1) for k in self._rows())
        return sum(sizes) > 0

    def _rows(self) -> list[int]:
        """Return the indices of the set's objects in the order."""
        there = {(segment.start, segment.stop) for segment in self.view.segments}
        return [k for k, range_ in enumerate(self.gaussians.ranges) if range_ in there]

    @classmethod
    def upload(cls, gaussians: GpuSet, view: SortingView, count: int, texels: Float32) -> Order:
        """Copy an order's texels to the GPU."""
        return cls(gaussians, view, count, targets.texture(texels, "R32F"))


@dataclass(eq=False)
class Picture:
    """The content of a viewport."""

    target: targets.SplatPicture
    shows: Hashable
    """Key of everything that the picture depends on."""
    pixel: int
    """Width of a pixel of the picture, in pixels of the view; 1 in a full picture."""
    seconds: float | None
    """Time for a full picture of this viewport; None if unknown."""


class Painter:
    """Draws all splat objects in one order.

    Threads read and sort; until they are done, a viewport keeps its last order. With `wait`,
    drawing waits for them.
    """

    def __init__(self) -> None:
        self.problems: dict[str, str] = {}  # path -> why it cannot be drawn
        self.counts: dict[Hashable, tuple[int, int]] = {}  # viewport -> Gaussians, drawn and all
        self._reader, self._sorter = Worker("splat reader"), Worker("splat sorter")
        self._set: GpuSet | None = None
        self._asked: Files = ()
        self._clouds: dict[FileKey, SplatCloud] = {}
        self._broken: set[FileKey] = set()
        # Whether the GPU holds no hidden objects, and only one level of each object.
        self._lean = False
        self._orders: OrderedDict[Hashable, Order] = OrderedDict()
        self._pictures: dict[Hashable, Picture] = {}
        self._tools: Tools | None = None

    def draw(
        self,
        objects: Sequence[SplatObject],
        view: View,
        *,
        key: Hashable,
        depth: targets.Depth | None = None,
        linear_target: bool = False,
        strength: float = 1.0,
        rested: bool = True,
        wait: bool = False,
    ) -> bool:
        """Draw over the bound framebuffer.

        If a full picture takes long, a view that has changed is drawn coarsely. Then this returns
        True, and the view should be drawn again once it rests.

        Args:
            objects: all objects, hidden or not.
            view: viewpoint and size.
            key: of the viewport.
            depth: of surfaces that hide splats; None if there are none.
            linear_target: whether the framebuffer converts linear light to sRGB when written.
            strength: below 1, the existing picture shows through.
            rested: whether to replace a coarse picture of the same view by a full one.
            wait: whether to wait for files and sorting, and draw in full.
        """
        seen = InView.of(objects, view, fade=not self._lean)
        if not self._update_set(seen.wanted(), wait):
            seen = InView.of(objects, view, fade=False)
            self._update_set(seen.wanted(), wait)
        order = self._update_order(seen, view.matrix, key, wait)
        if order is None or not order.count:
            return False
        tools = self._tools = self._tools or Tools()
        depth = depth or tools.no_depth
        before = self._pictures.get(key)
        drawn = order.gaussians
        self.counts[key] = seen.counts(drawn.files, drawn.ranges, order.files)
        there = seen.among(order.files)
        picture = self._update_picture(order, there, view, key, depth, rested=rested, wait=wait)
        shader = tools.composite
        shader.bind()
        shader.uniform_int("origin", targets.viewport_origin())
        shader.uniform_float("view_size", view.size)
        shader.uniform_bool("linear_target", [linear_target])
        shader.uniform_bool("linear_light", [order.linear_light])
        shader.uniform_float("strength", strength)
        shader.uniform_sampler("picture", picture.target.texture)
        shader.uniform_sampler("scene_depth", depth.texture)
        gpu.state.depth_test_set("NONE")
        gpu.state.depth_mask_set(False)
        gpu.state.blend_set("ALPHA_PREMULT")
        tools.quad.draw(shader)
        gpu.state.blend_set("NONE")
        return picture is not before and picture.pixel > 1

    def pending(self, key: Hashable) -> bool:
        """Whether drawing this viewport again will improve it."""
        return self._reader.pending("set") or self._sorter.pending(key)

    def idle(self) -> bool:
        """Whether nothing is being read or sorted."""
        return self._reader.idle() and self._sorter.idle()

    def forget(self) -> None:
        """Free everything that belongs to files, when no object needs them."""
        self._reader.forget("set")
        self._set, self._asked, self._lean = None, (), False
        self._clouds, self._broken, self.problems, self.counts = {}, set(), {}, {}
        self._orders.clear()
        self._pictures.clear()

    def close(self) -> None:
        """Free everything and end the threads."""
        self.forget()
        self._reader.close()
        self._sorter.close()
        self._tools = None

    def _update_set(self, objects: Sequence[SplatObject], wait: bool) -> bool:
        """Put the visible objects' files on the GPU; those of hidden objects may stay.

        If they do not fit, set `_lean` and return False: the caller tries again with less.
        """
        there = self._set.files if self._set else ()
        # A pending request of another viewport is kept.
        held = Counter(there) | Counter(self._asked) if not self._lean else Counter()
        files = needed([item for item in objects if item.file not in self._broken], held)
        if wait and files != there:
            self._reader.forget("set")
            return self._take_set(*read_set(files, self._clouds))
        if not wait and files != self._asked:
            self._asked = files
            known = dict(self._clouds)
            self._reader.submit("set", lambda: read_set(files, known))
        outcome = self._reader.take("set")
        if outcome is not None:
            if outcome.error:
                raise outcome.error
            return self._take_set(*outcome.value)
        return True

    def _take_set(
        self,
        files: Files,
        packed: PackedSet,
        clouds: dict[FileKey, SplatCloud],
        problems: dict[FileKey, str],
    ) -> bool:
        too_many = packed.rows > most_rows()
        if too_many and not self._lean:
            self._lean, self._asked = True, ()
            return False
        if too_many:
            text = f"{len(packed)} Gaussians do not fit into this GPU's textures."
            problems = {**problems, **dict.fromkeys(files, text)}
            files, packed, clouds = (), pack([]), {}
        self._set = GpuSet.upload(files, packed)
        self._clouds = clouds
        self._broken |= problems.keys()
        self.problems = {key.path: text for key, text in problems.items()}
        self._asked = files
        return True

    def _update_order(self, seen: InView, view: Matrix, key: Hashable, wait: bool) -> Order | None:
        """Return the newest order of a viewport; if it is outdated, request a new one."""
        gaussians = self._set
        outcome = None if wait else self._sorter.take(key)
        if outcome is not None:
            if outcome.error:
                raise outcome.error
            means, *order = outcome.value
            if gaussians is not None and means is gaussians.means:
                self._orders[key] = Order.upload(gaussians, *order)
        if gaussians is not None:
            there = gaussians.files
            objects = seen.among(there)
            wanted = sorting_view(there, gaussians.ranges, gaussians.extent, objects, view)
            held = self._orders.get(key)
            good = held and held.gaussians is gaussians and not held.view.differs(wanted)
            # The thread gets no GPU objects: it must not release the last reference to one.
            means = gaussians.means
            if not good and wait:
                self._orders[key] = Order.upload(gaussians, *sort_means(means, wanted)[1:])
            elif not good and not self._sorter.busy(key):
                self._sorter.submit(key, lambda: sort_means(means, wanted))
        if key in self._orders:
            self._orders.move_to_end(key)
        while len(self._orders) > VIEWS:
            old, _ = self._orders.popitem(last=False)
            self._sorter.forget(old)
            self._pictures.pop(old, None)
            self.counts.pop(old, None)
        return self._orders.get(key)

    def _update_picture(
        self,
        order: Order,
        objects: Sequence[SplatObject],
        view: View,
        key: Hashable,
        depth: targets.Depth,
        *,
        rested: bool,
        wait: bool,
    ) -> Picture:
        """Return the picture of a viewport; draw it again only if it would change."""
        frame = view.frame or whole(view.size)
        there = order.gaussians
        objects_there = object_texels(there.files, objects, view, there.photo_focals)
        clip = np.array(view.projection).tobytes()
        shows = (order, objects_there.tobytes(), clip, frame, view.size, depth.mark)
        held = self._pictures.get(key)
        same = held is not None and held.shows == shows
        seconds = held.seconds if held and not wait else None
        pixel = pace.pixel(seconds, held.pixel if held and same else None, rested)
        if held and same and held.pixel == pixel:
            return held
        size = (-(-view.size[0] // pixel), -(-view.size[1] // pixel))
        target = held.target if held and held.target.size == size else targets.SplatPicture(*size)
        start = targets.drawn()
        with target.cleared().bind():
            self._blend(order, view, frame, size, depth, targets.texture(objects_there, "RGBA32F"))
            taken = targets.drawn() - start
        self._pictures[key] = Picture(
            target, shows, pixel, pace.full_seconds(taken, pixel, seconds)
        )
        return self._pictures[key]

    def _blend(
        self,
        order: Order,
        view: View,
        frame: Frame,
        size: tuple[int, int],
        depth: targets.Depth,
        objects: gpu.types.GPUTexture,
    ) -> None:
        """Blend Gaussians into the bound framebuffer, which has this size."""
        assert self._tools is not None
        gpu.state.depth_test_set("NONE")
        gpu.state.depth_mask_set(False)
        gpu.state.blend_set("ALPHA_PREMULT")
        shader = self._tools.splat(depth is not self._tools.no_depth)
        shader.bind()
        shader.uniform_float("projection", view.projection)
        shader.uniform_float("frame", frame)
        shader.uniform_float("view_size", view.size)
        shader.uniform_int("sh_texels", order.gaussians.sh_texels)
        shader.uniform_bool("linear_light", [order.linear_light])
        shader.uniform_sampler("order", order.texture)
        shader.uniform_sampler("geometry", order.gaussians.geometry)
        shader.uniform_sampler("colours", order.gaussians.colours)
        shader.uniform_sampler("objects", objects)
        if depth is not self._tools.no_depth:
            shader.uniform_float("pixel", (view.size[0] / size[0], view.size[1] / size[1]))
            shader.uniform_sampler("scene_depth", depth.texture)
        shader.uniform_int("count", order.count)
        self._tools.quads.draw_instanced(shader, instance_count=-(-order.count // shaders.TOGETHER))


class Tools:
    """GPU programs and buffers for every image, created with the first one."""

    def __init__(self) -> None:
        self._splat: dict[bool, shaders.Shader] = {}
        self.composite = shaders.composite_shader()
        self.no_depth = targets.no_depth()
        corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
        self.quad = batch_for_shader(self.composite, "TRI_STRIP", {"corner": corners})
        places = [(*corner, float(k)) for k in range(shaders.TOGETHER) for corner in corners]
        triangles = [
            tuple(4 * k + corner for corner in three)
            for k in range(shaders.TOGETHER)
            for three in ((0, 1, 2), (2, 1, 3))
        ]
        self.quads = batch_for_shader(
            self.splat(False), "TRIS", {"place": places}, indices=triangles
        )

    def splat(self, depth: bool) -> shaders.Shader:
        """Return the shader that draws Gaussians, with a scene's depth or without."""
        if depth not in self._splat:
            self._splat[depth] = shaders.splat_shader(depth)
        return self._splat[depth]


def most_rows() -> int:
    """Return the largest number of rows of a texture on this GPU."""
    return gpu.capabilities.max_texture_size_get()


def needed(objects: Sequence[SplatObject], held: Counter[FileKey]) -> Files:
    """Return the files to have on the GPU: one entry per visible object, and held ones.

    Entries of one file are consecutive, so that visibility does not change their order.
    """
    every = Counter(item.file for item in objects)
    visible = Counter(item.file for item in objects if item.visible)
    files: list[FileKey] = []
    for file, most in every.items():
        files += [file] * min(most, max(visible[file], held[file]))
    return tuple(files)


def read_set(
    files: Files, known: dict[FileKey, SplatCloud]
) -> tuple[Files, PackedSet, dict[FileKey, SplatCloud], dict[FileKey, str]]:
    """Read files that are not known yet, and pack all readable ones.

    Returns the readable files, the set, their clouds, and the problems of the others.
    """
    clouds, problems = {}, {}
    for key in files:
        if key in clouds or key in problems:
            continue
        try:
            clouds[key] = known[key] if key in known else read_splats(key.path)
        except ValueError as error:
            problems[key] = str(error)
    good = tuple(key for key in files if key in clouds)
    return good, pack([clouds[key] for key in good]), clouds, problems


def sort_means(means: Float32, view: SortingView) -> tuple[Float32, SortingView, int, Float32]:
    """Sort; return the arguments, the number of Gaussians in the order, and its texels."""
    order = back_to_front(means, view)
    return means, view, len(order), pack_order(order)
