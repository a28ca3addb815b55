"""Encoded images in memory to tensors, through torchcodec, torchvision or OpenCV."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, Literal, TypeAlias, overload

import torch
from torch import Tensor

from kvision import _check
from kvision.core.exceptions import ImageError, ShapeError, TypeCheckError
from kvision.io._exif import upright
from kvision.io._jpeg import JpegHeader, jpeg_header
from kvision.io._opencv import opencv, pixels_of
from kvision.io.load import ImageLoadType, convert, inconvertible

__all__ = ["decode"]

Mode: TypeAlias = Literal["RGB", "GRAY", "RGBA", "UNCHANGED"]
Backend: TypeAlias = Literal["torchcodec", "torchvision", "opencv"]
Encoded: TypeAlias = bytes | bytearray | memoryview | Tensor

_MODES: dict[Mode, ImageLoadType] = {
    "RGB": ImageLoadType.RGB8,
    "GRAY": ImageLoadType.GRAY8,
    "RGBA": ImageLoadType.RGBA8,
    "UNCHANGED": ImageLoadType.UNCHANGED,
}


@overload
def decode(
    files: Encoded,
    device: str | torch.device | None = ...,
    mode: Mode = ...,
    backend: Backend | None = ...,
    errors: Literal["raise"] = ...,
) -> Tensor: ...
@overload
def decode(
    files: Sequence[Encoded],
    device: str | torch.device | None = ...,
    mode: Mode = ...,
    backend: Backend | None = ...,
    errors: Literal["raise"] = ...,
) -> list[Tensor]: ...
@overload
def decode(
    files: Encoded,
    device: str | torch.device | None = ...,
    mode: Mode = ...,
    backend: Backend | None = ...,
    errors: Literal["raise", "skip"] = ...,
) -> Tensor | None: ...
@overload
def decode(
    files: Sequence[Encoded],
    device: str | torch.device | None = ...,
    mode: Mode = ...,
    backend: Backend | None = ...,
    errors: Literal["raise", "skip"] = ...,
) -> list[Tensor | None]: ...
def decode(
    files: Encoded | Sequence[Encoded],
    device: str | torch.device | None = "cpu",
    mode: Mode = "RGB",
    backend: Backend | None = None,
    errors: Literal["raise", "skip"] = "raise",
) -> Tensor | list[Tensor] | list[Tensor | None] | None:
    """Decode image files that are in memory, upright (EXIF orientation) and in RGB order, each in its own size.

    JPEG files are decoded by the backend, on a CUDA device by nvJPEG through torchcodec or torchvision, a list in one call.
    All other formats, and JPEG files of CMYK or RGB or without an end, are decoded by OpenCV on the CPU, as
    :func:`load_image` does: 16 bits are scaled to 8, alpha that is not asked for is laid over white. The CPU decodes a list
    in ``torch.get_num_threads()`` threads.

    On the CPU all backends give the same values. nvJPEG repeats chroma that is stored at half the resolution (4:2:0 and 4:2:2)
    where they interpolate it: next to colored edges it is far off, and few levels on average; docs/inputs.md has figures.
    ``backend="opencv"`` gives the values of the CPU on every device. What is damaged inside of a whole file is often decoded
    in silence, to gray or wrong blocks, by all of them.

    Args:
        files: the bytes of a file, as bytes or as a uint8 tensor (N,) in CPU memory, or a list or tuple of such.
        device: where the results go; None is the CPU.
        mode: "RGB", "GRAY" (0.299 R + 0.587 G + 0.114 B), "RGBA", all in uint8, or "UNCHANGED", the channels and the type of
            the file.
        backend: "torchcodec", "torchvision" or "opencv"; None takes the first of them that is installed.
        errors: "raise", or "skip", which gives None for what cannot be decoded: a list of results stays as long as `files`.

    Returns:
        (C, H, W), or a list of such. The memory is as the decoder wrote it: channels last from the CPU, planes from CUDA.

    Raises:
        TypeCheckError: an entry of `files` is neither bytes nor a uint8 tensor.
        ShapeError: a tensor of bytes has not one axis.
        ImageError (a ValueError): a file cannot be decoded. It names the index in the list, and the reason.
        ImportError: the backend, or OpenCV for a file that it alone decodes, is not installed.

    Example:
        >>> import pathlib, tempfile, torch, kvision as K
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     paths = [pathlib.Path(folder, name) for name in ("a.jpg", "b.png")]
        ...     K.io.write_image(paths[0], torch.rand(3, 16, 32))
        ...     K.io.write_image(paths[1], torch.rand(3, 4, 5))
        ...     files = [*(path.read_bytes() for path in paths), b"no image"]
        >>> [None if image is None else tuple(image.shape) for image in K.io.decode(files, errors="skip")]
        [(3, 16, 32), (3, 4, 5), None]
    """
    _check.choice("decode", "mode", mode, tuple(_MODES))
    _check.choice("decode", "errors", errors, ("raise", "skip"))
    target = _check.device("decode", device) or torch.device("cpu")
    decoder = _decoder(backend)
    is_list = isinstance(files, (list, tuple))
    encoded = [_as_tensor(i if is_list else None, x) for i, x in enumerate(files if is_list else [files])]
    images: list[Tensor | None] = []
    for i, image in enumerate(_decoded(encoded, decoder, target)):
        if isinstance(image, Tensor):
            if mode == "RGB" and image.dtype == torch.uint8 and image.shape[0] == 3:  # nearly all of them
                images.append(image)
                continue
            reason = inconvertible(image, _MODES[mode])
            reason = reason and f'{reason}; decode it with mode="UNCHANGED"'
        else:
            reason = str(image)
        if reason and errors == "raise":
            which = _name(i) if is_list else "the file"
            cause = image if isinstance(image, ImageError) else None
            raise ImageError(f"decode: cannot decode {which}: {reason}") from cause
        images.append(None if reason or isinstance(image, ImageError) else convert(image, _MODES[mode]))
    return images if is_list else images[0]


def _name(index: int | None) -> str:
    return "files" if index is None else f"files[{index}]"


def _as_tensor(index: int | None, data: Any) -> Tensor:
    """The bytes of a file as a tensor, without a copy where they are contiguous."""
    if isinstance(data, Tensor):
        if data.dtype != torch.uint8 or data.device.type != "cpu":
            raise TypeCheckError(
                f"decode: expected {_name(index)} of bytes in CPU memory, got {data.dtype} on {data.device}"
            )
        if data.dim() != 1:
            raise ShapeError(
                f"decode: expected {_name(index)} of shape (N,), got {tuple(data.shape)}", actual_shape=data.shape
            )
        return data.contiguous()
    if not isinstance(data, (bytes, bytearray, memoryview)):
        raise TypeCheckError(
            f"decode: expected {_name(index)} to be bytes or a uint8 tensor, got {type(data).__name__}",
            actual_type=type(data),
        )
    _use_read_only_memory()
    return torch.frombuffer(data, dtype=torch.uint8) if len(data) else torch.empty(0, dtype=torch.uint8, device="cpu")


@cache
def _use_read_only_memory() -> None:
    """Let torch give its only warning of memory that may not be written: decoders read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.frombuffer(b"\0", dtype=torch.uint8)


# --- backends -------------------------------------------------------------------------------------------------------


class _Decoder(ABC):
    """A decoder of JPEG files that are gray or YCbCr: to one channel or three, upright."""

    serves_cuda = True

    @abstractmethod
    def on_cpu(self, file: Tensor, header: JpegHeader) -> Tensor: ...

    def on_cuda(self, files: list[Tensor], mode: str, headers: list[JpegHeader], device: torch.device) -> list[Tensor]:
        """Files of as many components as `mode`, "RGB" or "GRAY", has."""
        raise NotImplementedError


class _TorchCodec(_Decoder):
    def __init__(self) -> None:
        from torchcodec.decoders import decode_jpeg

        self.decode_jpeg = decode_jpeg

    def on_cpu(self, file: Tensor, header: JpegHeader) -> Tensor:
        pixels: Tensor = self.decode_jpeg(file, mode="UNCHANGED")
        return pixels

    def on_cuda(self, files: list[Tensor], mode: str, headers: list[JpegHeader], device: torch.device) -> list[Tensor]:
        images: list[Tensor] = self.decode_jpeg(files, mode=mode, device=device)
        return images


class _TorchVision(_Decoder):
    def __init__(self) -> None:
        from torchvision.io import ImageReadMode, decode_jpeg

        if not hasattr(torch.ops.image, "decode_jpeg"):
            raise RuntimeError("its own library does not load beside this torch")
        self.decode_jpeg, self.modes = decode_jpeg, ImageReadMode

    def on_cpu(self, file: Tensor, header: JpegHeader) -> Tensor:
        return upright(self.decode_jpeg(file, self.modes.UNCHANGED), header.orientation)

    def on_cuda(self, files: list[Tensor], mode: str, headers: list[JpegHeader], device: torch.device) -> list[Tensor]:
        images = self.decode_jpeg(files, self.modes[mode], device=device)
        return [upright(image, header.orientation) for image, header in zip(images, headers)]


class _OpenCV(_Decoder):
    serves_cuda = False

    def on_cpu(self, file: Tensor, header: JpegHeader) -> Tensor:
        cv2 = opencv()
        flags = cv2.IMREAD_GRAYSCALE if header.components == 1 else cv2.IMREAD_COLOR_RGB
        try:
            pixels = cv2.imdecode(file.numpy(), flags | cv2.IMREAD_IGNORE_ORIENTATION)
        except cv2.error as error:  # more pixels than it is allowed
            raise ImageError(error.err) from error
        if pixels is None:
            raise ImageError("the file is damaged or cut short")
        image = torch.from_numpy(pixels)
        return upright(image[None] if image.dim() == 2 else image.permute(2, 0, 1), header.orientation)


_DECODERS: dict[str, Callable[[], _Decoder]] = {
    "torchcodec": _TorchCodec,
    "torchvision": _TorchVision,
    "opencv": _OpenCV,
}


@cache
def _made(name: str) -> _Decoder | Exception:
    try:
        return _DECODERS[name]()
    except (
        Exception
    ) as error:  # not installed, or it does not load beside this torch: OSError, RuntimeError, AttributeError
        return error


def _decoder(name: str | None) -> _Decoder:
    if name is None:
        # OpenCV is imported by the first file that it decodes.
        return next(decoder for decoder in map(_made, _DECODERS) if isinstance(decoder, _Decoder))
    _check.choice("decode", "backend", name, tuple(_DECODERS))
    decoder = _made(name)
    if isinstance(decoder, Exception):
        raise ImportError(f"decode: backend {name!r} does not load here: {decoder}") from decoder
    return decoder


# --- lists ----------------------------------------------------------------------------------------------------------


def _decoded(files: list[Tensor], decoder: _Decoder, device: torch.device) -> list[Tensor | ImageError]:
    """The pixels of each file on the device, or why there are none."""
    headers = [jpeg_header(file.numpy().data) for file in files]
    images: list[Tensor | ImageError | None] = [None] * len(files)
    if device.type == "cuda" and decoder.serves_cuda:
        for components, mode in ((3, "RGB"), (1, "GRAY")):
            some = [(i, header) for i, header in enumerate(headers) if header and header.components == components]
            indices = [i for i, _ in some]
            for i, image in zip(
                indices, _by_nvjpeg(decoder, [files[i] for i in indices], mode, [h for _, h in some], device)
            ):
                images[i] = image
    rest = [i for i, image in enumerate(images) if image is None]

    def on_cpu(i: int) -> Tensor | ImageError:
        try:
            header = headers[i]
            return decoder.on_cpu(files[i], header) if header else pixels_of(files[i].numpy())
        except ImageError as error:
            return error
        except RuntimeError as error:
            return ImageError(str(error).splitlines()[0])

    threads = min(len(rest), torch.get_num_threads())
    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:  # decoders release the interpreter
            decoded = list(pool.map(on_cpu, rest))
    else:
        decoded = [on_cpu(i) for i in rest]
    for i, pixels in zip(rest, decoded):
        images[i] = pixels.to(device) if isinstance(pixels, Tensor) else pixels
    return images  # type: ignore[return-value]  # none is None


def _by_nvjpeg(
    decoder: _Decoder, files: list[Tensor], mode: str, headers: list[JpegHeader], device: torch.device
) -> Sequence[Tensor | None]:
    """All files in one call; where one of them cannot be decoded, one by one, with None for those."""
    try:
        return decoder.on_cuda(files, mode, headers, device) if files else []
    except RuntimeError:
        if len(files) == 1:
            return [None]
    return [_by_nvjpeg(decoder, [file], mode, [header], device)[0] for file, header in zip(files, headers)]
