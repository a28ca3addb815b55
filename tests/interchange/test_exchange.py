"""Arrays, files and memory.

Images are (B, C, H, W) in any memory format, which operators keep. `to_tensor` and `to_numpy` convert images of NumPy, PIL and
OpenCV; to floating point they divide by the largest number of the type.
"""

import io

import numpy as np
import torch

import kvision as K
from interchange.rows import noise, row, same

BYTES = noise(6, 8, 3, dtype=np.uint8)
DEEP = BYTES.astype(np.uint16) * 257 - np.uint16(1) * (BYTES > 0)  # 16 bits whose lower byte matters


@row(
    "NumPy",
    "images are (H, W, C): `torch.from_numpy(image).permute(2, 0, 1)[None]` is channels_last, without a copy",
    "operators keep this memory format; `K.to_tensor(image)` copies",
)
def test_numpy(numpy):
    x = torch.from_numpy(BYTES).permute(2, 0, 1)[None]
    assert x.is_contiguous(memory_format=torch.channels_last) and x.data_ptr() == BYTES.ctypes.data
    blurred = K.filters.gaussian_blur2d(x.float(), 3, 1.0)
    assert blurred.is_contiguous(memory_format=torch.channels_last)
    assert torch.equal(K.to_tensor(BYTES), x[0])


@row("NumPy", "`from_dlpack` and torch's share memory", "any operator takes `torch.from_dlpack(array)`")
def test_dlpack(numpy):
    array = noise(3, 4)
    x = torch.from_dlpack(array)
    assert x.data_ptr() == array.ctypes.data and same(numpy.from_dlpack(x), array)


@row(
    "torch",
    "channels_last changes strides, not the order of axes: (B, C, H, W) still",
    "results are in the format of the first image",
)
def test_torch(torch_):
    x = torch.rand(2, 3, 4, 5).to(memory_format=torch_.channels_last)
    assert x.shape == (2, 3, 4, 5) and x.stride() == (60, 1, 15, 3)
    assert K.color.rgb_to_hsv(x).stride() == x.stride()


@row(
    "OpenCV",
    "files of 16 bits: `imread(IMREAD_UNCHANGED)` gives uint16; without it the upper bytes",
    "`K.to_tensor(image, torch.float32, bgr=True)` divides uint16 by 65535",
)
def test_opencv_16_bits(cv2):
    file = cv2.imencode(".png", DEEP)[1]
    image = cv2.imdecode(file, cv2.IMREAD_UNCHANGED)
    assert image.dtype == np.uint16 and same(image, DEEP)
    assert same(cv2.imdecode(file, cv2.IMREAD_COLOR), DEEP >> 8)
    assert same(K.to_tensor(image, torch.float32, bgr=True), DEEP[..., ::-1].transpose(2, 0, 1) / 65535)


@row(
    "OpenCV",
    "`dnn.blobFromImage`: (1, C, H, W) of float32, not divided by 255, BGR unless `swapRB=True`",
    "`255 * K.to_tensor(image, torch.float32)[None]`",
)
def test_opencv_planar(cv2):
    assert same(cv2.dnn.blobFromImage(BYTES), 255 * K.to_tensor(BYTES, torch.float32), 1e-4)


@row(
    "Pillow",
    "gray PNGs of 16 bits are of mode I;16, color ones lose their lower bytes",
    "`K.to_tensor(image)` of the mode I;16 is uint16",
)
def test_pillow_16_bits(PIL):
    import cv2
    from PIL import Image

    gray = Image.open(io.BytesIO(cv2.imencode(".png", DEEP[..., 0])[1]))
    assert gray.mode == "I;16" and same(np.asarray(gray), DEEP[..., 0])
    assert K.to_tensor(gray).dtype == torch.uint16 and same(K.to_tensor(gray).int(), DEEP[..., 0])
    color = Image.open(io.BytesIO(cv2.imencode(".png", DEEP[..., ::-1])[1]))
    assert color.mode == "RGB" and same(np.asarray(color), DEEP >> 8)


@row("Pillow", "`size` is (W, H); `np.asarray(image)` is (H, W, C)", "sizes are (H, W)")
def test_pillow_sizes(PIL):
    from PIL import Image

    image = Image.fromarray(BYTES)
    assert image.size == (8, 6) and np.asarray(image).shape == (6, 8, 3) and K.to_tensor(image).shape == (3, 6, 8)


@row(
    "scikit-image",
    "`img_as_float`: uint8 over 255, uint16 over 65535",
    "`K.to_tensor(image, torch.float64)`",
)
def test_skimage(skimage):
    for image in (BYTES, DEEP):
        assert same(skimage.img_as_float(image).transpose(2, 0, 1), K.to_tensor(image, torch.float64), 1e-12)


@row(
    "Matplotlib",
    "`image.imread` of PNG files: float32 in [0, 1], (H, W, C)",
    "`K.to_tensor(image)`; `K.io.load_image` keeps bytes",
)
def test_matplotlib(matplotlib):
    import cv2
    from matplotlib.image import imread

    image = imread(io.BytesIO(cv2.imencode(".png", BYTES[..., ::-1])[1]), format="png")
    assert image.dtype == np.float32 and same(image.transpose(2, 0, 1), K.to_tensor(BYTES, torch.float32))


@row(
    "pyarrow",
    "`FixedShapeTensorArray`: tensors of one shape, in rows",
    "`torch.from_numpy(array.to_numpy_ndarray())`, after `K.to_numpy(images)` and `from_numpy_ndarray`",
)
def test_arrow(pyarrow):
    images = torch.rand(4, 3, 5, 6)
    array = pyarrow.FixedShapeTensorArray.from_numpy_ndarray(K.to_numpy(images))
    assert len(array) == 4 and array.type.shape == [5, 6, 3]
    back = torch.from_numpy(array.to_numpy_ndarray().copy()).permute(0, 3, 1, 2)
    assert torch.equal(back, images)
