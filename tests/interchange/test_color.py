"""Color.

Images of floating-point types are RGB in [0, 1]. Functions of uint8 images divide by 255, or give OpenCV's codes with
`opencv=True`.
"""

import colorsys

import numpy as np
import torch

import kvision as K
from interchange.rows import chw, hwc, noise, row, same

C = K.color
X = noise(8, 9, 3)
BYTES = noise(16, 19, 3, dtype=np.uint8)


@row("OpenCV", "`imread` gives BGR", "`K.to_tensor(image, bgr=True)`; `bgr_to_rgb`")
def test_opencv_bgr(cv2):
    decoded = cv2.imdecode(cv2.imencode(".png", np.uint8([[[0, 0, 255]]]))[1], cv2.IMREAD_COLOR)
    assert decoded.tolist() == [[[0, 0, 255]]] and K.to_tensor(decoded, bgr=True).flatten().tolist() == [255, 0, 0]


@row(
    "OpenCV",
    "`RGB2GRAY`: .299, .587, .114 of the values; bytes by weights of 15 bits",
    "`rgb_to_grayscale`, bytes included",
)
def test_opencv_gray(cv2):
    assert all(same(cv2.cvtColor(x, cv2.COLOR_RGB2GRAY), C.rgb_to_grayscale(chw(x)), 1e-6) for x in (X, BYTES))


@row(
    "Pillow", '`convert("L")`: the same weights in 16 bits, rounded', "`rgb_to_grayscale`, a level apart in few pixels"
)
def test_pillow_gray(PIL):
    from PIL import Image

    difference = (
        np.asarray(Image.fromarray(BYTES).convert("L")).astype(int) - hwc(C.rgb_to_grayscale(chw(BYTES)))[..., 0]
    )
    assert abs(difference).max() <= 1 and (difference != 0).mean() < 0.02


@row(
    "torchvision",
    "`rgb_to_grayscale` of bytes: .2989, .587, .114, rounded down",
    "rounded to the nearest: up to a level more",
)
def test_torchvision_gray(torchvision):
    from torchvision.transforms.v2 import functional as F

    difference = (C.rgb_to_grayscale(chw(BYTES)).int() - F.rgb_to_grayscale(chw(BYTES))).flatten()
    assert set(difference.tolist()) == {0, 1}


@row(
    "scikit-image",
    "`rgb2gray`: .2125, .7154, .0721, of code values",
    "`rgb_to_grayscale(x, torch.tensor([.2125, .7154, .0721]))`",
)
def test_skimage_gray(skimage):
    assert same(skimage.color.rgb2gray(X), C.rgb_to_grayscale(chw(X), torch.tensor([0.2125, 0.7154, 0.0721])))


@row("OpenCV", "HSV of floats: hue in degrees; of gray 0", "`rgb_to_hsv`: hue in radians; of gray 0")
def test_opencv_hsv(cv2):
    theirs, ours = cv2.cvtColor(X, cv2.COLOR_RGB2HSV), hwc(C.rgb_to_hsv(chw(X)))
    assert same(theirs / [360, 1, 1], ours / [2 * np.pi, 1, 1], 1e-4)
    assert cv2.cvtColor(np.full((1, 1, 3), 0.5, np.float32), cv2.COLOR_RGB2HSV)[0, 0, 0] == 0
    assert C.rgb_to_hsv(torch.full((3, 1, 1), 0.5))[0] == 0


@row("OpenCV", "HSV of bytes: hue in half degrees, below 180", "`rgb_to_hsv(x, opencv=True)`")
def test_opencv_hsv_of_bytes(cv2):
    assert same(cv2.cvtColor(BYTES, cv2.COLOR_RGB2HSV), hwc(C.rgb_to_hsv(chw(BYTES), opencv=True)), 0)


@row(
    "OpenCV",
    "`HSV2RGB` of bytes: the last columns, which no vector serves, may be a level off",
    "the same value in every column",
)
def test_opencv_hsv_of_columns(cv2):
    line = np.tile(np.uint8([66, 200, 106]), (1, 97, 1))
    assert len(np.unique(cv2.cvtColor(line, cv2.COLOR_HSV2RGB)[0], axis=0)) == 2
    assert len(torch.unique(C.hsv_to_rgb(chw(line), opencv=True)[0, :, 0], dim=1).T) == 1


@row("scikit-image", "`rgb2hsv`: hue in [0, 1)", "`rgb_to_hsv`, hue over 2 pi")
def test_skimage_hsv(skimage):
    assert same(skimage.color.rgb2hsv(X), hwc(C.rgb_to_hsv(chw(X))) / [2 * np.pi, 1, 1], 1e-4)


@row("Matplotlib", "`rgb_to_hsv`: hue in [0, 1)", "`rgb_to_hsv`, hue over 2 pi")
def test_matplotlib_hsv(matplotlib):
    import matplotlib.colors

    assert same(matplotlib.colors.rgb_to_hsv(X), hwc(C.rgb_to_hsv(chw(X))) / [2 * np.pi, 1, 1], 1e-4)


@row(
    "Pillow",
    '`convert("HSV")`: hue in 256ths of a turn, rounded down',
    "`rgb_to_hsv`: hue / (2 pi) * 255 is within a level",
)
def test_pillow_hsv(PIL):
    from PIL import Image

    theirs = np.asarray(Image.fromarray(BYTES).convert("HSV")).astype(int)
    ours = hwc(C.rgb_to_hsv(chw(BYTES))) / [2 * np.pi, 1, 1] * 255
    assert abs(theirs - ours).max() <= 1.001


@row(
    "OpenCV",
    "HLS of floats: hue in degrees, then lightness, then saturation",
    "`rgb_to_hls`: hue in radians, the same order",
)
def test_opencv_hls(cv2):
    theirs = cv2.cvtColor(X, cv2.COLOR_RGB2HLS)
    assert same(theirs / [360, 1, 1], hwc(C.rgb_to_hls(chw(X))) / [2 * np.pi, 1, 1], 1e-4)
    assert same(colorsys.rgb_to_hls(0.2, 0.4, 0.6)[1:], C.rgb_to_hls(torch.tensor([0.2, 0.4, 0.6]).view(3, 1, 1))[1:])


@row("OpenCV", "Lab of floats: sRGB, white D65, L to 100; by a table", "`rgb_to_lab`, to .3")
def test_opencv_lab(cv2):
    assert same(cv2.cvtColor(X, cv2.COLOR_RGB2Lab), hwc(C.rgb_to_lab(chw(X))), 0.3)


@row("OpenCV", "Lab of bytes: L in 255ths, a and b plus 128", "`rgb_to_lab(x, opencv=True)`, to a level")
def test_opencv_lab_of_bytes(cv2):
    theirs = cv2.cvtColor(BYTES, cv2.COLOR_RGB2Lab).astype(int)
    assert abs(theirs - hwc(C.rgb_to_lab(chw(BYTES), opencv=True))).max() <= 1


@row("scikit-image", "`rgb2lab`: white D65 of 2 degrees, `illuminant=` chooses", "`rgb_to_lab`, to .05")
def test_skimage_lab(skimage):
    assert same(skimage.color.rgb2lab(X), hwc(C.rgb_to_lab(chw(X))), 0.05)
    assert not same(skimage.color.rgb2lab(X, illuminant="D50"), hwc(C.rgb_to_lab(chw(X))), 2)


@row("colour", "`XYZ_to_Lab(sRGB_to_XYZ(x))`: white D65 of (.3127, .3290)", "`rgb_to_lab`, to .05")
def test_colour_lab(colour):
    assert same(colour.XYZ_to_Lab(colour.sRGB_to_XYZ(X)), hwc(C.rgb_to_lab(chw(X))), 0.05)


@row("colour", "sRGB: linear below .04045, exponent 2.4", "`rgb_to_linear_rgb`")
def test_colour_srgb(colour):
    x = np.float32([[[0.0, 0.04, 0.0405], [0.2, 0.5, 1.0]]])
    assert same(colour.models.eotf_sRGB(x), hwc(C.rgb_to_linear_rgb(chw(x))), 1e-6)


@row("OpenCV", "`RGB2XYZ` multiplies code values, without sRGB's curve", "`rgb_to_xyz`, to 1e-5")
def test_opencv_xyz(cv2):
    assert same(cv2.cvtColor(X, cv2.COLOR_RGB2XYZ), hwc(C.rgb_to_xyz(chw(X))), 2e-5)


@row("scikit-image", "`rgb2xyz` takes sRGB's curve off first", "`rgb_to_xyz(rgb_to_linear_rgb(x))`")
def test_skimage_xyz(skimage):
    assert same(skimage.color.rgb2xyz(X), hwc(C.rgb_to_xyz(C.rgb_to_linear_rgb(chw(X)))), 2e-5)


@row("OpenCV", "`RGB2YCrCb`: full range, Cr before Cb", "`rgb_to_ycbcr`: Cb before Cr, to 1e-3")
def test_opencv_ycrcb(cv2):
    assert same(cv2.cvtColor(X, cv2.COLOR_RGB2YCrCb)[..., [0, 2, 1]], hwc(C.rgb_to_ycbcr(chw(X))), 1e-3)


@row("Pillow", '`convert("YCbCr")`: full range (JPEG)', "`rgb_to_ycbcr`, within a level")
def test_pillow_ycbcr(PIL):
    from PIL import Image

    theirs = np.asarray(Image.fromarray(BYTES).convert("YCbCr"))
    assert abs(theirs - 255 * hwc(C.rgb_to_ycbcr(chw(BYTES)))).max() <= 1.2


@row("scikit-image", "`rgb2ycbcr`: limited range, 16 to 235 and 240", "`rgb_to_ycbcr`, times 219 and 224, plus 16")
def test_skimage_ycbcr(skimage):
    ours = hwc(C.rgb_to_ycbcr(chw(X))) * [219, 224, 224] + 16
    assert same(skimage.color.rgb2ycbcr(X), ours, 0.1)


@row(
    "OpenCV",
    "`RGB2YUV_I420`: limited range, chroma of the upper left of 2 x 2 pixels",
    "`rgb_to_yuv420`: full range, their mean",
)
def test_opencv_i420(cv2):
    image = np.zeros((2, 2, 3), np.uint8)
    image[0, 0, 0] = 255
    alone, flat = (
        cv2.cvtColor(x, cv2.COLOR_RGB2YUV_I420).flatten()
        for x in (image, np.broadcast_to(image[:1, :1], (2, 2, 3)).copy())
    )
    assert alone[0] == 82 and alone[1:4].tolist() == [16] * 3 and alone[4:].tolist() == flat[4:].tolist()
    _, uv = C.rgb_to_yuv420(chw(image).float() / 255)
    _, flat_uv = C.rgb_to_yuv420(chw(image)[..., :1, :1].expand(-1, -1, 2, 2).float() / 255)
    assert same(4 * uv, flat_uv)


@row(
    "OpenCV",
    "`YUV2RGB_NV12`: limited range of BT.601; U and V side by side below Y",
    "`frames_to_rgb(nv12)`, to a level",
)
def test_opencv_nv12(cv2):
    nv12 = np.uint8([[120, 130, 90, 60], [120, 110, 70, 60], [90, 180, 120, 110]])
    theirs = cv2.cvtColor(nv12, cv2.COLOR_YUV2RGB_NV12)
    ours = C.frames_to_rgb(torch.from_numpy(nv12), dtype=torch.float32)[None]
    assert theirs[0, 0].tolist() == [204, 94, 44] and abs(255 * hwc(ours) - theirs).max() <= 1


@row(
    "PyAV",
    'frames of yuv420p to "rgb24": limited range of BT.601 unless the frame says otherwise',
    "as above, to 2 levels",
)
def test_pyav(av):
    frame = av.VideoFrame(16, 16, "yuv420p")
    for plane, value in zip(frame.planes, (120, 90, 180)):
        plane.update(np.full(plane.buffer_size, value, np.uint8).tobytes())
    theirs = frame.to_ndarray(format="rgb24")[8, 8].astype(int)
    planes = [torch.full((n, n), code, dtype=torch.uint8) for n, code in ((2, 120), (1, 90), (1, 180))]
    ours = C.frames_to_rgb(planes, "i420")[:, 0, 0].numpy().astype(int)
    assert abs(theirs - [204, 94, 44]).max() <= 2 and abs(theirs - ours).max() <= 2


@row(
    "OpenCV",
    "`COLOR_BayerBG2RGB` names the second row's second and third pixel: red is at the upper left",
    "`CFA.BG`, in the interior to a level",
)
def test_opencv_bayer(cv2):
    flat = np.broadcast_to(np.uint8([200, 100, 50]), (8, 8, 3))
    raw = C.rgb_to_raw(chw(flat), C.CFA.BG)
    theirs = cv2.cvtColor(raw[0, 0].numpy(), cv2.COLOR_BayerBG2RGB)[2:-2, 2:-2]
    assert (
        raw[0, 0, 0, 0] == 200
        and theirs[0, 0].tolist() == [200, 100, 50] == C.raw_to_rgb(raw, C.CFA.BG)[0, :, 3, 3].tolist()
    )


@row(
    "Pillow",
    '`convert("RGB")` of RGBA drops alpha',
    "`x[:, :3]`; `rgba_to_rgb` blends with white, or another background",
)
def test_pillow_alpha(PIL):
    from PIL import Image

    rgba = np.uint8([[[100, 50, 20, 0]]])
    assert np.asarray(Image.fromarray(rgba).convert("RGB")).tolist() == [[[100, 50, 20]]]
    assert C.rgba_to_rgb(chw(rgba).float() / 255).min() == 1


@row("torchvision", "`adjust_hue`: a fraction of a turn of HSV's hue", "`adjust_hue`: radians")
def test_torchvision_hue(torchvision):
    from torchvision.transforms.v2 import functional as F

    assert same(F.adjust_hue(chw(X), 0.2), K.enhance.adjust_hue(chw(X), 0.4 * np.pi), 1e-4)


@row(
    "DALI",
    "`hue` turns the chroma plane linearly and clips; `contrast` is about 128",
    "none: `adjust_hue` turns HSV's hue; `adjust_contrast` is about 0",
)
def test_dali_hue(dali):
    from interchange.pipelines import run

    image = np.full((4, 4, 3), 0, np.uint8) + np.uint8([200, 100, 50])
    turned = run(lambda fn, x: fn.hue(x, hue=60.0), image)[0, 0] / 255
    ours = K.enhance.adjust_hue(chw(image).float() / 255, np.pi / 3)[0, :, 0, 0]
    assert not same(turned, ours, 0.02)
    assert run(lambda fn, x: fn.contrast(x, contrast=2.0), image)[0, 0].tolist() == [255, 72, 0]
