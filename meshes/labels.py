"""Labelled images as segmentation programs write them: TIFF stacks of whole numbers, 0 outside the body.

Of what a TIFF can say, only the numbers of its one stack are read: other files that it names are not opened.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tsg_micro.data.errors import InputError

__all__ = ["LabelImage", "label_image", "nearest_labels", "read_labels"]

_MOST = 10_000
"""Images of a stack at most."""


@dataclass(frozen=True)
class LabelImage:
    """What a file says that it holds."""

    path: Path
    shape: tuple[int, int, int]
    """Along z, y, x."""
    size: int
    """Bytes of the numbers."""


def label_image(path: str | Path) -> LabelImage:
    """Size of the labelled image in a TIFF file, from its headers; one plane counts as a stack of one.

    Raises:
        InputError: no such file, not a TIFF, damaged, not one stack of whole numbers, or tifffile is not there.
    """
    path = Path(path)
    with _stack(path) as stack:
        shape = tuple(int(n) for n in stack.shape if n != 1)
        shape = (1,) * (3 - len(shape)) + shape
        if len(shape) != 3 or stack.dtype is None or stack.dtype.kind not in "biu" or "S" in stack.axes:
            raise InputError(
                f"expected one stack of whole numbers (z, y, x), got {stack.dtype} of axes {stack.axes} and shape "
                f"{' x '.join(map(str, stack.shape))}"
            )
        return LabelImage(path, (shape[0], shape[1], shape[2]), math.prod(shape) * stack.dtype.itemsize)


def read_labels(image: LabelImage) -> NDArray[np.integer[Any]]:
    """Labels (nx, ny, nz) of the image.

    Raises:
        InputError: damaged, compressed in a way that cannot be read here, or no label above 0.
    """
    with _stack(image.path) as stack:
        labels = np.asarray(stack.asarray()).reshape(image.shape).transpose(2, 1, 0)
        labels = labels.astype(np.uint8) if labels.dtype == bool else labels
        if not (labels > 0).any():
            raise InputError("expected labels above 0, got none")
        return labels


@contextlib.contextmanager
def _stack(path: Path) -> Iterator[Any]:
    """The one series of images of the file; what goes wrong with it is one line."""
    try:
        import tifffile
    except ImportError as error:
        raise InputError(f"labels: images are read by tifffile ({error}): tsgdd[images]") from None
    if not path.is_file():
        raise InputError(f"labels {path}: no such file")
    try:
        with _errors_of("tifffile") as errors:
            with tifffile.TiffFile(path, is_ome=False, is_mmstack=False, is_ndtiff=False) as file:
                if len(file.pages) > _MOST:
                    raise InputError(f"expected at most {_MOST} images, got {len(file.pages)}")
                if len(file.series) != 1:
                    raise InputError(f"expected images of one size and type, got {len(file.series)} of them")
                yield file.series[0]
            if errors:  # tifffile goes on without what is not there
                raise InputError(f"damaged ({' '.join(errors[0].split())[:160]})")
    except InputError as error:
        raise InputError(f"labels {path}: {error}") from None
    except Exception as error:  # tifffile and its decoders meet damage with whatever they run into
        why = " ".join(f"{type(error).__name__} {error}".split())[:160]
        raise InputError(f"labels {path}: cannot be read as TIFF ({why})") from None


@contextlib.contextmanager
def _errors_of(name: str) -> Iterator[list[str]]:
    """The errors that the logger ``name`` is told in the block, which are not printed."""
    found: list[str] = []
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: found.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger(name)
    propagated, logger.propagate = logger.propagate, False
    logger.addHandler(handler)
    try:
        yield found
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagated


def nearest_labels(
    labels: NDArray[np.integer[Any]], spacing: tuple[float, float, float], count: tuple[int, int, int], *, edge: float
) -> NDArray[np.integer[Any]]:
    """Labels at the centres of voxels (nx, ny, nz) of ``edge`` m, in the middle of the image; 0 beyond it.

    ``labels`` (px, py, pz) are of voxels of ``spacing`` m along x, y, z.
    """
    index, inside = [], []
    for pixels, step, voxels in zip(labels.shape, spacing, count, strict=True):
        centre = 0.5 * pixels * step + edge * (np.arange(voxels) + 0.5 - 0.5 * voxels)
        place = np.floor(centre / step * (1 + 1e-12)).astype(np.int64)
        inside.append((place >= 0) & (place < pixels))
        index.append(place.clip(0, pixels - 1))
    found = labels[np.ix_(*index)]
    found[~(inside[0][:, None, None] & inside[1][:, None] & inside[2])] = 0
    return found
