"""Training and deployment."""

import numpy as np
import pytest
import torch

import kvision as K
from interchange.rows import chw, noise, row, same

A = K.augmentation
X = torch.rand(2, 3, 16, 20, generator=torch.Generator().manual_seed(0))


class Counted(torch.utils.data.Dataset):
    def __len__(self):
        return 16

    def __getitem__(self, index):
        return index, torch.rand(()).item()


@row(
    "torchdata",
    "a `StatefulDataLoader` that resumes in mid-epoch: the exact order, but workers repeat the epoch's first random numbers",
    "`seed=` of epoch and sample index",
)
def test_torchdata(torchdata):
    from torchdata.stateful_dataloader import StatefulDataLoader

    def loader():
        torch.manual_seed(1)
        return StatefulDataLoader(
            Counted(), batch_size=2, shuffle=True, num_workers=1, generator=torch.Generator().manual_seed(0)
        )

    whole, batches = loader(), []
    for batch in whole:
        batches.append(batch)
        if len(batches) == 4:
            state = whole.state_dict()
    resumed = loader()
    resumed.load_state_dict(state)
    rest = list(resumed)
    assert [b[0].tolist() for b in rest] == [b[0].tolist() for b in batches[4:]]
    assert [b[1].tolist() for b in rest] == [b[1].tolist() for b in batches[:4]] != [b[1].tolist() for b in batches[4:]]
    flip = A.RandomAffine(20.0, p=1.0)
    assert torch.equal(flip(X, seed=torch.tensor([5, 6]))[1:], flip(X[1:], seed=torch.tensor([6])))


class Blurred(torch.nn.Module):
    def forward(self, x):
        return K.filters.gaussian_blur2d(x, (5, 5), (1.5, 1.5))


class Rotated(torch.nn.Module):
    def forward(self, x):
        return K.geometry.rotate(x, 30.0)


@row(
    "OpenVINO",
    "reads the ONNX file of a pipeline; bfloat16 by default on CPUs that have it",
    'the same numbers, with `INFERENCE_PRECISION_HINT="f32"`',
)
def test_openvino(openvino):
    import tempfile

    pytest.importorskip("onnxscript")
    with tempfile.TemporaryDirectory() as folder:
        torch.onnx.export(Blurred(), (X,), dynamo=True, opset_version=20, verbose=False).save(f"{folder}/blur.onnx")
        compiled = openvino.Core().compile_model(f"{folder}/blur.onnx", "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
        assert same(compiled(X.numpy())[0], Blurred()(X))


@row("OpenVINO", "`convert_model(module)` refuses operators of libraries", "export to ONNX")
def test_openvino_modules(openvino):
    with pytest.raises(Exception, match="No conversion rule"):
        openvino.convert_model(Blurred(), example_input=X)


@row(
    "OpenVINO",
    "converts programs of `torch.export`, but for `bitwise_or`",
    'export inside of `kvision.backend("reference")`; not `rotate`',
)
def test_openvino_programs(openvino):
    with K.backend("reference"):
        program, refused = (torch.export.export(module, (X,)) for module in (Blurred(), Rotated()))
    compiled = openvino.Core().compile_model(
        openvino.convert_model(program), "CPU", {"INFERENCE_PRECISION_HINT": "f32"}
    )
    assert same(compiled(X.numpy())[0], Blurred()(X))
    with pytest.raises(Exception, match="bitwise_or"):
        openvino.convert_model(refused)


@row(
    "torchvision",
    "`posterize` of floats: multiples of 2^-bits",
    "`posterize`, `RandomPosterize`: the upper bits of 255 x",
)
def test_torchvision_posterize(torchvision):
    from torchvision.transforms.v2 import functional as F

    ramp = torch.linspace(0, 1, 256).expand(1, 3, 1, 256)
    assert same(F.posterize(ramp, 3).unique(), np.arange(8) / 8) and same(
        K.enhance.posterize(ramp, 3).unique(), np.arange(8) * 32 / 255
    )


@row(
    "torchvision",
    "`MixUp`, `CutMix`: one weight a batch, labels as probabilities",
    "one a sample; labels (y, partner's y, weight), of the partner in `RandomMixUpV2`, of y in `RandomCutMixV2`",
)
def test_torchvision_mixup(torchvision):
    from torchvision.transforms import v2

    images = torch.eye(4).view(4, 4, 1, 1).expand(4, 4, 8, 8).contiguous()
    _, targets = v2.MixUp(num_classes=4)(images, torch.arange(4))
    assert len(targets.amax(1).unique()) == 1 and same(targets.sum(1), np.ones(4))
    mixed, labels = A.RandomMixUpV2(p=1.0, data_keys=["image", "class"])(images, torch.arange(4))
    label, partner, weight = labels.unbind(-1)
    expected = (1 - weight)[:, None] * torch.eye(4)[label.long()] + weight[:, None] * torch.eye(4)[partner.long()]
    assert same(mixed[:, :, 0, 0], expected) and len(weight.unique()) == 4


@row(
    "Kornia",
    "`RandomChannelDropout` in `VideoSequential(same_on_frame=True)`: each frame loses channels of its own",
    "all frames lose the same",
)
def test_kornia_videos(kornia):
    videos = X[:1, None].expand(1, 3, -1, -1, -1)
    torch.manual_seed(0)
    theirs, ours = (
        L.VideoSequential(L.RandomChannelDropout(p=1.0), data_format="BTCHW") for L in (kornia.augmentation, A)
    )
    assert not all(torch.equal(y[:, 0], y[:, 2]) for y in (theirs(videos) for _ in range(6)))
    assert all(torch.equal(y[:, 0], y[:, 2]) for y in (ours(videos) for _ in range(6)))


@row(
    "Kornia",
    "ranges that are an `nn.Parameter` get gradients, but their values are not read again",
    "each call draws from their present values",
)
def test_kornia_ranges(kornia):
    for augmentation, follows in ((kornia.augmentation, False), (A, True)):
        strength = torch.nn.Parameter(torch.tensor([0.9, 1.1]))
        brightness = augmentation.RandomBrightness(strength, p=1.0)
        with torch.no_grad():
            strength.fill_(0.6)
        assert (abs(brightness(torch.full((4, 3, 2, 2), 0.5)) - 0.1).max() < 1e-4) == follows


@row("Kornia", "`get_perspective_transform` onto four equal points: NaN", "the matrix that maps every point there")
def test_kornia_degenerate(kornia):
    square, point = torch.tensor([[[0.0, 0], [1, 0], [1, 1], [0, 1]]]), torch.tensor([[[3.0, 4]]]).expand(1, 4, 2)
    assert kornia.geometry.get_perspective_transform(square, point).isnan().all()
    assert same(K.geometry.get_perspective_transform(square, point), [[0, 0, 3], [0, 0, 4], [0, 0, 1]])


@row("Matplotlib", "`imshow` clips floats to [0, 1] and integers to [0, 255]; (H, W, C)", "`K.to_numpy(images)`")
def test_matplotlib(matplotlib):
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    shown = Figure().add_subplot().imshow(K.to_numpy(chw(noise(4, 5, 3))[0]))
    assert isinstance(shown, AxesImage) and shown.get_array().shape == (4, 5, 3)
