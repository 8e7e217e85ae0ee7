# SPDX-License-Identifier: GPL-3.0-or-later
"""Structure from motion on the demo photos, with pycolmap on the CPU.

Reads `<scene>/images` and `<scene>/truth.json` and writes `<scene>/sparse/0` and
`<scene>/rois.json`. Poses, focal length and points are those that structure from motion found.
The truth is used for one thing: a reconstruction from photos has no scale, no "up" and no origin,
so a single similarity (scale, rotation, shift), fitted to the camera centres, carries the whole
model into Blender's world frame. There the bounds of the objects are known, and they become the
boxes. Needs `pip install pycolmap`.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import pycolmap

HERE = Path(__file__).resolve().parent
FRAME = "COLMAP model carried into the Blender world by one similarity: z up, metres"


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", type=Path, default=HERE / "scene", help="folder of the scene")
    parser.add_argument(
        "--model", type=Path, help="align this model of the photos and keep its points; find none"
    )
    parser.add_argument("--work", type=Path, help="keep the database here instead of a temporary")
    parser.add_argument("--camera", default="PINHOLE", help="COLMAP camera model, one for all")
    parser.add_argument("--features", type=int, default=3000, help="most features per photo")
    parser.add_argument("--min-track", type=int, default=3, help="fewest photos per written point")
    parser.add_argument("--max-error", type=float, default=1.5, help="largest error in pixels")
    parser.add_argument("--budget", type=float, default=1.75, help="largest model in megabytes")
    parser.add_argument("--margin", type=float, default=0.05, help="box margin, share of the size")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def solve(args: argparse.Namespace, work: Path) -> pycolmap.Reconstruction:
    """Find features and matches, and map incrementally; returns the largest model."""
    database, photos = work / "database.db", args.scene / "images"
    if not database.exists():
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.use_gpu = False
        extraction.sift.max_num_features = args.features
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = args.camera
        pycolmap.extract_features(
            database,
            photos,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader,
            extraction_options=extraction,
            device=pycolmap.Device.cpu,
        )
        pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = args.seed
    options.triangulation.ignore_two_view_tracks = False
    models = work / "models"
    models.mkdir(exist_ok=True)
    found = pycolmap.incremental_mapping(database, photos, models, options)
    if not found:
        raise SystemExit("no model was found")
    sizes = sorted((m.num_reg_images() for m in found.values()), reverse=True)
    print(f"models by registered photos: {sizes}")
    return max(found.values(), key=lambda m: m.num_reg_images())


def align(model: pycolmap.Reconstruction, truth: dict) -> np.ndarray:
    """Transform the model to Blender's world; returns the cameras' remaining errors, metres."""
    images = [model.images[i] for i in model.reg_image_ids()]
    found = np.array([image.projection_center() for image in images])
    wanted = np.array([truth["photos"][image.name]["centre"] for image in images])
    similarity = pycolmap.estimate_sim3d(found, wanted)
    model.transform(similarity)
    moved = np.array([image.projection_center() for image in images])
    return np.linalg.norm(moved - wanted, axis=1)


def boxes(truth: dict, margin: float) -> list[dict]:
    """Boxes round the objects, `margin` of the size wider on each side."""
    rois = []
    for name, bounds in truth["objects"].items():
        low, high = np.array(bounds["min"]), np.array(bounds["max"])
        grow = margin * (high - low)
        corners = {"min": low - grow, "max": high + grow}
        rois.append({"name": name} | {k: [round(x, 4) for x in v] for k, v in corners.items()})
    return rois


def inside(points: np.ndarray, roi: dict) -> np.ndarray:
    """Whether each point is in the box."""
    return np.all((points >= roi["min"]) & (points <= roi["max"]), axis=1)


def choose(model: pycolmap.Reconstruction, rois: list[dict], args: argparse.Namespace) -> set[int]:
    """Choose the points to write: all good ones in the boxes, others until the file is full.

    In the boxes, where points are few and matter most, a track of two photos is enough.
    """
    exact = [key for key, point in model.points3D.items() if point.error <= args.max_error]
    spots = np.array([model.points3D[key].xyz for key in exact])
    boxed = np.any([inside(spots, roi) for roi in rois], axis=0)
    length = np.array([model.points3D[key].track.length() for key in exact])
    chosen = boxed | (length >= args.min_track)
    good, boxed = [exact[k] for k in np.flatnonzero(chosen)], boxed[chosen]
    order = np.random.default_rng(args.seed).permutation(len(good))
    order = order[np.argsort(~boxed[order], kind="stable")]
    kept, size = set(), 200.0 * model.num_reg_images()
    for k in order:
        size += 51 + 32 * model.points3D[good[k]].track.length()
        if size > args.budget * 1e6:
            break
        kept.add(good[k])
    print(f"points: {model.num_points3D()} found, {len(good)} good, {len(kept)} kept")
    return kept


def compact(model: pycolmap.Reconstruction, kept: set[int]) -> pycolmap.Reconstruction:
    """Copy the model with only the kept points and their observations."""
    slim = pycolmap.Reconstruction()
    for camera in model.cameras.values():
        slim.add_camera_with_trivial_rig(pycolmap.Camera(camera.todict()))
    places: dict[tuple[int, int], int] = {}
    for key in sorted(model.reg_image_ids()):
        image = model.images[key]
        seen = [k for k, p in enumerate(image.points2D) if p.has_point3D() and p.point3D_id in kept]
        places |= {(key, k): n for n, k in enumerate(seen)}
        spots = np.array([image.points2D[k].xy for k in seen]).reshape(-1, 2)
        fresh = pycolmap.Image(
            name=image.name, keypoints=spots, camera_id=image.camera_id, image_id=key
        )
        slim.add_image_with_trivial_frame(fresh, image.cam_from_world())
    for key in sorted(kept):
        point = model.points3D[key]
        track = pycolmap.Track()
        for seen_at in point.track.elements:
            place = places.get((seen_at.image_id, seen_at.point2D_idx))
            if place is not None:
                track.add_element(seen_at.image_id, place)
        slim.add_point3D(point.xyz, track, point.color)
    slim.update_point_3d_errors()
    return slim


def report(model: pycolmap.Reconstruction, rois: list[dict], scene: Path) -> None:
    """Print the numbers for the README."""
    camera = next(iter(model.cameras.values()))
    photos = list((scene / "images").rglob("*.jpg"))
    size = sum(p.stat().st_size for p in photos)
    sparse = sum(p.stat().st_size for p in (scene / "sparse" / "0").iterdir())
    print(f"photos: {len(photos)}, registered: {model.num_reg_images()}")
    print(f"points: {model.num_points3D()}, mean track {model.compute_mean_track_length():.2f}")
    print(f"mean reprojection error: {model.compute_mean_reprojection_error():.3f} px")
    print(f"camera: {camera.model.name} {np.round(camera.params, 3).tolist()}")
    print(f"bytes: photos {size}, model {sparse}, together {size + sparse}")
    points = list(model.points3D.values())
    spots = np.array([point.xyz for point in points])
    for roi in rois:
        chosen = [points[k] for k in np.flatnonzero(inside(spots, roi))]
        seen: dict[str, int] = {}
        for point in chosen:
            for name in {model.images[e.image_id].name for e in point.track.elements}:
                seen[name] = seen.get(name, 0) + 1
        often = sum(count >= 5 for count in seen.values())
        wide = sum(name.startswith("wide/") for name in seen)
        print(
            f"{roi['name']}: {len(chosen)} points, seen in {len(seen)} photos ({wide} wide), "
            f"by 5 points or more in {often}"
        )


def main() -> None:
    """Solve, align, slim, write."""
    args = arguments()
    started = time.time()
    truth = json.loads((args.scene / "truth.json").read_text())
    if args.model:
        model = pycolmap.Reconstruction(args.model)
    else:
        with tempfile.TemporaryDirectory() as folder:
            work = args.work or Path(folder)
            work.mkdir(parents=True, exist_ok=True)
            model = solve(args, work)
    names = {model.images[i].name for i in model.reg_image_ids()}
    taken = {name for name in truth["photos"] if not name.startswith("held_out/")}
    print("not registered:", sorted(taken - names) or "none")
    left = align(model, truth)
    print(
        f"camera centres after the similarity: rms {1000 * np.sqrt(np.mean(left**2)):.2f} mm, "
        f"largest {1000 * left.max():.2f} mm"
    )
    rois = boxes(truth, args.margin)
    slim = model if args.model else compact(model, choose(model, rois, args))
    out = args.scene / "sparse" / "0"
    out.mkdir(parents=True, exist_ok=True)
    slim.write_binary(out)
    note = "axis-aligned boxes round the objects of the demo room"
    content = {"scene": "demo", "frame": FRAME, "note": note, "rois": rois}
    (args.scene / "rois.json").write_text(json.dumps(content, indent=2) + "\n")
    report(pycolmap.Reconstruction(out), rois, args.scene)
    print(f"took {time.time() - started:.0f} s")


if __name__ == "__main__":
    main()
