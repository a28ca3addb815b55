"""The Python examples run, and their output is as stated."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
import torch

import kvision as K

pytestmark = pytest.mark.programs

EXAMPLES = Path(__file__).parents[1] / "examples"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses read their module from sys.modules
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_segmentation_losses(tmp_path: Path) -> None:
    losses = example("segmentation_losses")
    reached = losses.main(["--out", str(tmp_path), "--device", "cpu"])
    assert reached.keys() == losses.LOSSES.keys()
    assert min(reached.values()) > 0.9
    assert (tmp_path / "curves.png").stat().st_size > 0


@pytest.mark.parametrize("solver, iterations", [("gauss-newton", 20), ("adam", 150)])
def test_registration_of_a_photograph(solver, iterations, device):
    pytest.importorskip("skimage")
    registration = example("image_registration")
    pair = next(registration.synthetic(device))
    result, levels = registration.register(pair, solver, iterations)
    assert registration.corner_error(pair.start, pair) > 5
    assert registration.corner_error(result, pair) < pair.limit
    assert len(levels) == registration.LEVELS


def test_registration_of_real_pairs(data, device):
    registration = example("image_registration")
    pairs = list(registration.real(data / "homography", device))
    for pair in pairs:
        result, _ = registration.register(pair, "gauss-newton", 20)
        assert registration.corner_error(result, pair) < pair.limit, pair.name
    assert pairs


def test_depth_of_a_stereo_pair(device):
    pytest.importorskip("skimage")
    depth = example("depth_estimation")
    scene = depth.motorcycle(device, width=160)
    results = [depth.quality(depth.errors(scene, d)) for d, _ in depth.descend(scene, 40, 4)]
    start = depth.quality(depth.errors(scene, depth.depth_of(scene, 0.5 * torch.ones_like(scene.truth))))
    assert results[-1][1] > max(0.6, start[1])
    assert results[-1][0] < start[0]
    assert results[-1][1] > results[0][1]


@pytest.mark.slow
def test_each_level_of_depth_is_better_than_the_one_before(device):
    pytest.importorskip("skimage")
    depth = example("depth_estimation")
    scene = depth.motorcycle(device)
    mean, within = zip(*(depth.quality(depth.errors(scene, d)) for d, _ in depth.descend(scene, 120, 5)))
    assert list(mean) == sorted(mean, reverse=True) and mean[-1] < 0.055
    assert list(within) == sorted(within)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, said",
    [
        ("feature_matching", "inliers, fewer than 15: no homography relates these photographs"),
        ("depth_estimation", "less than 0.6: no depth relates these images"),
    ],
)
def test_unrelated_photographs_end_with_a_verdict(name: str, said: str, tmp_path: Path, capsys) -> None:
    pytest.importorskip("skimage")
    photos = K.io.get_sample_images((120, 160), ("astronaut", "coffee"))
    paths = [tmp_path / "left.png", tmp_path / "right.png"]
    for path, photo in zip(paths, photos):
        K.io.write_image(path, photo)
    quick = {
        "feature_matching": ["--features", "200"],
        "depth_estimation": ["--width", "64", "--levels", "2", "--iterations", "10"],
    }
    options = [*map(str, paths), *quick[name], "--out", str(tmp_path / "out"), "--device", "cpu"]
    assert example(name).main(["--image", *options]) == 1
    assert said in capsys.readouterr().out
    assert not (tmp_path / "out" / "panorama.png").exists()


def test_depth_of_a_room(data, device, tmp_path: Path):
    pytest.importorskip("tqdm")
    depth = example("depth_estimation")
    scene = depth.livingroom(data / "rgbd_livingroom", device, width=160)
    levels, _ = depth.estimate(scene, 150, 4, depth.K)
    error = depth.errors(scene, levels[-1][0])
    assert depth.quality(error)[1] > 0.7
    assert "without texture" in depth.limits(scene, error)
    depth.draw(scene, levels, tmp_path / "room.png")
    assert (tmp_path / "room.png").stat().st_size > 0


def test_matching_of_photographs(device, tmp_path: Path):
    pytest.importorskip("skimage")
    matching = example("feature_matching")
    matcher = matching.Matcher(matching.Features(500)).to(device).eval()
    pair = next(matching.synthetic(device))
    matches = matching.match(matcher, pair.first, pair.second)
    assert matches.inliers.sum() > 50 and matching.corner_error(matches.homography, pair) < matching.LIMIT
    matching.draw(pair, matches, tmp_path / "pair.png")
    assert (tmp_path / "pair.png").stat().st_size > 0


def test_panorama_of_views(device):
    pytest.importorskip("skimage")
    matching = example("feature_matching")
    views = matching.views(device)
    stitched = matching.panorama(matching.Matcher(matching.Features(500)).to(device).eval(), views)
    height, width = stitched.shape[2:]
    assert height == views[0].shape[2] and 600 <= width <= 660
    whole = matching.photograph("rocket", device)[..., :300, :]
    common = min(width, whole.shape[3])
    assert (stitched[..., 20:-20, :common] - whole[..., 20:-20, :common]).abs().median() < 0.05


def test_matching_of_real_pairs(data, device):
    matching = example("feature_matching")
    matcher = matching.Matcher(matching.Features(2000)).to(device).eval()
    pairs = list(matching.real(data / "homography", device))
    for pair in pairs:
        matches = matching.match(matcher, pair.first, pair.second)
        assert matching.corner_error(matches.homography, pair) < 3 * matching.LIMIT, pair.name
    assert pairs


def test_attack_on_matching(device, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A short one: it says that it missed its figures, and the images stay near to the originals."""
    pytest.importorskip("skimage")
    attack = example("attack_on_matching")
    options = ["--iterations", "12", "--seeds", "1", "--height", "120", "--features", "120"]
    assert attack.main([*options, "--out", str(tmp_path), "--device", device.type]) == 1
    printed = capsys.readouterr().out
    psnr = [float(x) for x in re.search(r"PSNR ([\d.]+) and ([\d.]+) dB", printed).groups()]
    assert min(psnr) >= attack.WANTED_PSNR
    assert "MISSED" in printed and "0 of 1 attacks succeeded" in printed
    assert (tmp_path / "seed0.png").stat().st_size > 0


@pytest.mark.slow
def test_attack_on_matching_reaches_its_figures(data, device, tmp_path: Path) -> None:
    attack = example("attack_on_matching")
    options = ["--data", str(data / "nonmatching"), "--out", str(tmp_path), "--device", device.type]
    assert attack.main(options) == 0


@pytest.mark.parametrize("workers", [0, 2])
def test_training_with_augmentation(workers: int, device, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    augmentation = example("augmentation")
    photographs(tmp_path)
    options = ["--image", str(tmp_path / "left.png"), str(tmp_path / "right.png"), "--out", str(tmp_path / "out")]
    options += ["--workers", str(workers), "--windows", "24", "--batch", "8", "--epochs", "2"]
    rates = augmentation.main([*options, "--device", device.type])
    assert len(rates) == 3 and all(rate > 0 for rate in rates.values())
    printed = capsys.readouterr().out
    assert float(re.search(r"difference between samples and batches: (\S+)", printed)[1]) < 1e-4
    assert printed.endswith(f"are images in {tmp_path / 'out'}\n")
    for name in ("chain", "draws", "batch"):
        assert K.io.load_image(tmp_path / "out" / f"{name}.png").std() > 0.05


def test_the_chain_of_the_paper_is_moved_back(device: torch.device) -> None:
    augmentation = example("augmentation")
    y, x = torch.meshgrid(*[torch.linspace(-1, 1, 64, device=device)] * 2, indexing="ij")
    images = torch.exp(-8 * ((x - 0.2) ** 2 + (y + 0.1) ** 2)).expand(8, 3, -1, -1)
    torch.manual_seed(0)
    chain = augmentation.chain()[:2]
    augmented, matrices = chain(images)
    assert matrices.shape == (8, 3, 3) and (augmented - images).abs().amax((1, 2, 3)).min() > 0.1
    back = augmentation.move_back(augmented, matrices)
    middle = (..., slice(16, 48), slice(16, 48))
    assert (back[middle] - images[middle]).abs().max() < 0.02


def test_autoencoder_on_small_faces(device, tmp_path: Path) -> None:
    """Both losses fall and the figures are written; what edges gain takes more steps."""
    pytest.importorskip("skimage")
    pytest.importorskip("matplotlib")
    autoencoder = example("autoencoder")
    images = autoencoder.faces(None).to(device)
    assert images.shape == (100, 3, 64, 64) and 0 <= images.min() < 0.2 and 0.8 < images.max() <= 1
    trained, unseen = autoencoder.compare(images, 0, 0.1, 30, 4, "test")
    assert len(unseen) == 30
    for i, (name, result) in enumerate(trained.items()):
        assert sum(x[i] for x in result.curve[-5:]) < 0.9 * sum(x[i] for x in result.curve[:5]), name
    decoded = {name: result.model(unseen[:3]).detach() for name, result in trained.items()}
    autoencoder.draw_faces(decoded, tmp_path / "faces.png")
    autoencoder.draw_curves({name: result.curve for name, result in trained.items()}, tmp_path / "curves.png")
    assert all((tmp_path / name).stat().st_size > 0 for name in ("faces.png", "curves.png"))


def test_autoencoder_cuts_the_sheet_of_faces(data) -> None:
    sheet = K.io.load_image(data / "faces" / "faces_64.png")
    images = example("autoencoder").faces(data)
    assert images.shape == (527, 3, 64, 64)
    assert torch.equal(images[32], sheet[:, 64:128, 64:128])


@pytest.mark.slow
def test_autoencoder_keeps_edges(data, device, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A tenth of the steps is enough to keep edges better; the limits that the example checks take all of them."""
    portrait, out = tmp_path / "portrait.png", tmp_path / "out"
    K.io.write_image(portrait, torch.rand(3, 90, 70))
    options = ["--data", str(data), "--seeds", "1", "--steps", "60", "--image", str(portrait)]
    missed = example("autoencoder").main([*options, "--out", str(out), "--device", str(device)])
    printed = capsys.readouterr().out
    change = float(re.match(r"seed 0: edge error .* with Sobel \(([-+.\d]+)%\)", printed)[1])
    assert change < -5
    assert missed == ("MISSED" in printed)
    assert printed.endswith(f"figures are in {out}\n")
    assert (out / "faces.png").stat().st_size > 0 and (out / "curves.png").stat().st_size > 0


def test_training_from_jpegs(tmp_path: Path, device, capsys: pytest.CaptureFixture[str]) -> None:
    """A file that is no image is left out with its label; batches come in the order of the loader."""
    pytest.importorskip("tqdm")
    training = example("train_from_jpegs")
    training.make_pictures(tmp_path / "photos", 8)
    (tmp_path / "photos" / "rings" / "text.jpg").write_text("no image")
    options = ["--out", str(tmp_path / "out"), "--size", "32", "--batch", "4", "--epochs", "1", "--workers", "0"]
    epochs = training.main([str(tmp_path / "photos"), *options, "--device", device.type])
    assert len(epochs) == 1 and epochs[0].images_per_second > 0
    assert "left out, because they cannot be decoded: 1 files" in capsys.readouterr().out
    assert torch.load(tmp_path / "out" / "model.pt")["classes"] == ["rings", "stripes"]
    files = [path for path in sorted((tmp_path / "photos").rglob("*.jpg")) if path.name != "text.jpg"][:5]
    samples = [(torch.frombuffer(bytearray(path.read_bytes()), dtype=torch.uint8), i) for i, path in enumerate(files)]
    batches = [training.collate([sample]) for sample in samples]
    decoder = training.Decoder(device)
    assert [int(label) for _, labels in decoder.ahead(batches) for label in labels] == [0, 1, 2, 3, 4]


@pytest.mark.slow
def test_calibration_of_a_rendered_board(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    calibration = example("calibration")
    fit = calibration.main(["--out", str(tmp_path), "--device", "cpu"])
    assert (fit.camera_matrix[0] - calibration.CAMERA).abs().max() < 3 and fit.rms.item() < 0.15
    assert (tmp_path / "calibration.png").stat().st_size > 0


@pytest.mark.slow
def test_structure_of_a_rendered_room(tmp_path: Path, device: torch.device) -> None:
    motion = example("structure_from_motion")
    photographs = motion.room(device, views=4, size=(240, 320))
    scene = motion.reconstruct(photographs)
    assert motion.rotation_errors(scene, photographs.truth).max() < 0.3
    assert int(scene.points[:, 0].isfinite().sum()) > 300
    rgb = motion.colors(scene, photographs.images)
    motion.figure(scene, photographs.images, rgb, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 0


@pytest.mark.slow
def test_structure_of_a_living_room(data: Path, tmp_path: Path, device: torch.device) -> None:
    scene, errors = example("structure_from_motion").main(
        ["--data", str(data), "--out", str(tmp_path), "--device", str(device)]
    )
    assert errors.median() < 0.2 and errors.max() < 0.5
    points, rgb = K.geometry.load_pointcloud_ply_binary(tmp_path / "cloud.ply", return_colors=True)
    assert len(points) == len(rgb) == int(scene.points[:, 0].isfinite().sum()) > 1000


NAMES = (
    "calibration",
    "structure_from_motion",
    "image_registration",
    "depth_estimation",
    "segmentation_losses",
    "feature_matching",
    "augmentation",
    "autoencoder",
    "attack_on_matching",
)
WITHOUT_IMAGE = ("train_distributed", "train_from_jpegs")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
@pytest.mark.parametrize("name", NAMES + WITHOUT_IMAGE)
def test_missing_device_is_reported(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        example(name).main(["--device", "cuda"])
    assert stopped.value.code == 2
    assert capsys.readouterr().err.endswith("error: --device cuda: torch finds no CUDA device\n")


@pytest.mark.parametrize("name", (*NAMES, "train_distributed", "process_folder", "cpp/save_pipeline"))
def test_missing_package_is_reported(name: str, tmp_path: Path, monkeypatch, capsys) -> None:
    """The error comes before anything is computed."""
    missing = {"PIL", "matplotlib", "ray", "skimage", "torchvision", "tqdm"}
    for module in missing:
        monkeypatch.setitem(sys.modules, module, None)
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda module: None if module in missing else find_spec(module))
    options = {"train_distributed": ["--model", "resnet50"], "process_folder": [str(tmp_path), str(tmp_path / "out")]}
    with pytest.raises(SystemExit) as stopped:
        example(name).main([*options.get(name, ()), "--device", "cpu"])
    assert stopped.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    if name == "train_distributed":
        assert last.endswith("error: needs torchvision: pip install torchvision")
    else:
        assert re.search(r'error: needs \w+: pip install "\.\[examples\]"$', last)


@pytest.mark.parametrize(
    "name",
    (
        "image_registration",
        "depth_estimation",
        "feature_matching",
        "autoencoder",
        "attack_on_matching",
        "structure_from_motion",
    ),
)
def test_a_wrong_folder_is_an_error(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        example(name).main(["--data", str(tmp_path / "wrong"), "--device", "cpu"])
    assert stopped.value.code == 2
    assert f"error: --data {tmp_path / 'wrong'}: expected a folder with " in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("name", (*NAMES, *WITHOUT_IMAGE, "process_folder"))
def test_a_file_in_place_of_the_folder_of_results_is_said(name: str, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    out.touch()
    given = [str(tmp_path), str(out)] if name == "process_folder" else ["--out", str(out)]
    with pytest.raises(SystemExit) as stopped:
        example(name).main([*given, "--device", "cpu"])
    assert stopped.value.code == 2
    assert capsys.readouterr().err.endswith(f"error: results cannot go to {out}: File exists\n")


def test_a_range_of_depth_that_is_none_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = photographs(tmp_path, 8)
    with pytest.raises(SystemExit) as stopped:
        example("depth_estimation").main(
            ["--image", str(left), str(right), "--near", "5", "--far", "2", "--out", str(tmp_path), "--device", "cpu"]
        )
    assert stopped.value.code == 2
    assert capsys.readouterr().err.endswith("error: --near, --far: expected 0 < near < far, got 5 and 2\n")


@pytest.mark.parametrize("name", NAMES + WITHOUT_IMAGE)
def test_unknown_device_is_reported(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        example(name).main(["--device", "gpu"])
    assert stopped.value.code == 2
    assert capsys.readouterr().err.endswith("error: --device gpu: expected cpu or cuda\n")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("content", [None, b"no image"])
def test_unreadable_image_is_reported(name: str, content, tmp_path: Path, capsys) -> None:
    path = tmp_path / "mine.png"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SystemExit) as stopped:
        example(name).main(
            [
                "--device",
                "cpu",
                "--image",
                str(path),
                *([str(path)] if name in ("depth_estimation", "feature_matching", "attack_on_matching") else []),
            ]
        )
    assert stopped.value.code == 2
    assert f"error: --image {path}: " in capsys.readouterr().err.splitlines()[-1]


def photographs(folder: Path, shift: int = 0) -> tuple[Path, Path]:
    """Two files of one texture, the second shifted to the left."""
    texture = torch.nn.functional.interpolate(torch.rand(1, 3, 12, 20), (96, 160), mode="bicubic").clamp(0, 1)[0]
    paths = folder / "left.png", folder / "right.png"
    for path, image in zip(paths, (texture, texture.roll(-shift, 2))):
        K.io.write_image(path, image)
    return paths


def test_registration_of_user_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, _ = photographs(tmp_path)
    out = tmp_path / "out"
    example("image_registration").main(
        ["--image", str(left), "--solver", "gauss-newton", "--out", str(out), "--device", "cpu"]
    )
    assert "left" in (printed := capsys.readouterr().out) and printed.endswith(f"figures are in {out}\n")
    assert (out / "left_gauss-newton.png").stat().st_size > 0


def test_correlation_separates_other_minima(device) -> None:
    pytest.importorskip("skimage")
    registration = example("image_registration")
    pair = next(registration.synthetic(device))
    assert (
        registration.correlation(pair.truth, pair) > registration.CONVERGED > registration.correlation(pair.start, pair)
    )


def test_depth_of_user_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A flat scene at a shift of 8 pixels of 160, and a range of depth from the views alone."""
    depth = example("depth_estimation")
    left, right = photographs(tmp_path, 8)
    options = [
        "--image",
        str(left),
        str(right),
        "--focal",
        "160",
        "--width",
        "160",
        "--iterations",
        "100",
        "--levels",
        "5",
    ]
    depth.main([*options, "--out", str(tmp_path), "--device", "cpu"])
    printed = capsys.readouterr().out
    median = float(printed.split("median ")[1].split(";")[0])
    assert median == pytest.approx(160 / 8, rel=0.1)
    assert (tmp_path / "stereo.png").stat().st_size > 0
