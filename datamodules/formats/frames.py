"""Images of other projects' episodes: read when they are asked for, decoded and resized one by one."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from datamodules.errors import TrajectoryFileError, UserError

ENCODINGS = ("PNG", "JPEG")
MODES = {1: "L", 3: "RGB", 4: "RGBA"}  # By number of channels; other images, such as depth of 16 bits, fit no byte
MAX_PIXELS = 64 * 2**20
"""Of one image: more than any camera of a robot gives, and a file of some kilobytes can claim that it has more."""


@dataclass(frozen=True)
class Frames:
    """Images of one episode that stay where they are until numpy asks for them.

    Args:
        shape: ``(T + 1, H, W, C)`` or ``(T, H, W, C)``.
        read: Gives one image ``(H, W, C)`` uint8 after the other.
        place: File, episode and key, for messages.
    """

    shape: tuple[int, ...]
    read: Callable[[], Iterable[np.ndarray]]
    place: str

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of all images."""
        return np.dtype(np.uint8)

    def __len__(self) -> int:
        return self.shape[0]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        images, count = np.empty(self.shape, np.uint8), 0
        try:
            for count, image in enumerate(self._checked(), start=1):
                images[count - 1] = image
        except UserError:
            raise
        except Exception as error:  # what HDF5, Arrow and decoders raise on damaged images is not documented
            raise TrajectoryFileError(
                f"{self.place}, step {count}: found {_reason(error)}; expected undamaged images"
            ) from error
        if count < len(self):
            raise TrajectoryFileError(f"{self.place}, step {count}: found no image; expected {len(self)} of them")
        return images

    def _checked(self) -> Iterator[np.ndarray]:
        for step, image in enumerate(self.read()):
            if step >= len(self):
                raise TrajectoryFileError(f"{self.place}: found more images; expected {len(self)} of them")
            if image.shape != self.shape[1:] or image.dtype != np.uint8:
                found = f"an image of shape {image.shape}, type {image.dtype}"
                raise TrajectoryFileError(f"{self.place}, step {step}: found {found}; expected {self.shape[1:]}, uint8")
            yield image

    def resized(self, shape: tuple[int, ...]) -> Frames:
        """The same images in another size ``(H, W, C)``, smoothed."""
        if shape == self.shape[1:]:
            return self
        resize = _resizer((shape[0], shape[1]))
        return Frames((len(self), *shape), lambda: map(resize, self._checked()), self.place)


def _resizer(size: tuple[int, int]) -> Callable[[np.ndarray], np.ndarray]:
    def resize(image: np.ndarray) -> np.ndarray:
        picture = Image.fromarray(image[..., 0] if image.shape[2] == 1 else image)
        return np.asarray(picture.resize(size[::-1], Image.Resampling.BILINEAR)).reshape(*size, image.shape[2])

    return resize


def decode(content: bytes, shape: tuple[int, ...], place: str) -> np.ndarray:
    """Decode a PNG or JPEG image ``(H, W, C)`` or ``(H, W)`` uint8 of a known shape.

    Raises:
        TrajectoryFileError: If it is none, is damaged or has another shape.
    """
    try:
        with Image.open(io.BytesIO(content), formats=ENCODINGS) as picture:
            wanted = (*shape[:2], MODES.get(shape[2] if len(shape) > 2 else 1))
            if (picture.height, picture.width, picture.mode) != wanted:
                found = f"an image of {picture.height} × {picture.width} pixels, {picture.mode}"
                raise TrajectoryFileError(f"{place}: found {found}; expected {' × '.join(map(str, wanted))}")
            return np.asarray(picture, np.uint8).reshape(shape)
    except UserError:
        raise
    except Exception as error:  # what a decoder raises on damaged bytes is not documented
        raise TrajectoryFileError(f"{place}: found {_reason(error)}; expected an undamaged PNG or JPEG") from None


def encode_png(image: np.ndarray) -> bytes:
    """Encode an image ``(H, W, C)`` uint8 without loss."""
    buffer = io.BytesIO()
    Image.fromarray(image[..., 0] if image.shape[2] == 1 else image).save(buffer, format="PNG")
    return buffer.getvalue()


def image_shape(shape: tuple[int, ...]) -> bool:
    """Tell whether ``shape`` is that of an image ``(H, W, C)`` of 1, 3 or 4 channels that is not too large."""
    return len(shape) == 3 and shape[2] in (1, 3, 4) and 0 < shape[0] * shape[1] <= MAX_PIXELS


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
