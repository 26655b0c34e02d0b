"""Real sets made small: every n-th pixel of every n-th picture, written as the same kind of folder."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from acquisition.dataset import IlluminationDataset
from reconstruct.holdout import hold_out
from reconstruct.metrics import psnr


def thin_lp(folder: Path, out: Path, step: int, every: int = 1) -> Path:
    """An ``.lp`` folder with every `step`-th pixel of every `every`-th picture, as PNG."""
    out.mkdir(parents=True)
    [lp] = folder.glob("*.lp")
    lines = [line for line in lp.read_text().splitlines()[1:] if line.strip()][::every]
    kept = []
    for number, line in enumerate(lines):
        *name, x, y, z = line.split()
        last = " ".join(name).replace("\\", "/").rsplit("/", 1)[-1]
        place = next(path for path in (folder / last, folder / "jpg" / last) if path.is_file())
        cv2.imwrite(str(out / f"{number:04d}.png"), cv2.imread(str(place))[::step, ::step])
        kept.append(f"{number:04d}.png {x} {y} {z}")
    (out / "dirs.lp").write_text("\n".join([str(len(kept)), *kept]) + "\n")
    return out


def thin_diligent(folder: Path, out: Path, step: int, every: int = 1) -> Path:
    """A DiLiGenT folder with every `step`-th pixel of every `every`-th picture."""
    out.mkdir(parents=True)
    names = (folder / "filenames.txt").read_text().split()[::every]
    for name in (*names, "mask.png"):
        cv2.imwrite(str(out / name), cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)[::step, ::step])
    np.save(out / "normal_gt.npy", np.load(folder / "normal_gt.npy")[::step, ::step])
    (out / "filenames.txt").write_text("\n".join(names) + "\n")
    for name in ("light_directions.txt", "light_intensities.txt"):
        lines = [line for line in (folder / name).read_text().splitlines() if line.strip()][::every]
        (out / name).write_text("\n".join(lines) + "\n")
    return out


def plain_blend_psnr(dataset: IlluminationDataset, test: IlluminationDataset | None = None) -> float:
    """Mean PSNR, dB, of a barycentric blend of the stored values: the bar that a model of photographs has to reach.

    The lights are triangulated in stereographic projection, which keeps circles and so the sphere's own Delaunay
    triangles; outside the hull the nearest light's picture stands in.
    """
    [split] = hold_out("every:5", len(dataset.frames))
    train = list(split.train) if test is None else range(len(dataset.frames))
    judged, held_out = (dataset, split.test) if test is None else (test, range(len(test.frames)))
    plane = np.array([_stereographic(dataset.lights[i].direction) for i in train])
    triangles = Delaunay(plane)
    pictures = [dataset.stored(i) for i in train]
    found = []
    for i in held_out:
        point = _stereographic(judged.lights[i].direction)
        facet = int(triangles.find_simplex(point))
        if facet < 0:
            blend = pictures[int(np.argmin(np.linalg.norm(plane - point, axis=1)))]
        else:
            affine = triangles.transform[facet]
            first_two = affine[:2] @ (point - affine[2])
            weights = np.append(first_two, 1 - first_two.sum())
            blend = sum(w * pictures[k] for w, k in zip(weights, triangles.simplices[facet], strict=True))
        found.append(psnr(_eight_bit(judged.stored(i)), _eight_bit(blend)))
    return float(np.mean(found))


def _stereographic(direction: tuple[float, float, float]) -> NDArray[np.float64]:
    x, y, z = direction
    return np.array([x, y]) / (1 + z)


def _eight_bit(stored: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.rint(np.clip(stored, 0, 1) * 255).astype(np.uint8)
