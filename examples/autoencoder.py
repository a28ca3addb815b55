"""Train an autoencoder of faces with L1 alone and with an edge loss by kvision's Sobel operator, and compare the edges.

    python examples/autoencoder.py                         the faces next to the repository, else those of scikit-image
    python examples/autoencoder.py --data FOLDER           the sheet of faces FOLDER/faces/faces_64.png
    python examples/autoencoder.py --image PORTRAIT...     your own portraits, encoded and decoded by both networks as well

The loss is that of the Kornia paper, alpha |I - I'| + (1 - alpha) |Sobel(I) - Sobel(I')|, with gradients through the kernel. The
network is that of "Deep Feature Consistent Variational Autoencoder" (Hou et al. 2017) without the variational part: faces of 64 x
64 pixels become 100 numbers and faces again. For each seed 30% of the faces are held out, and both networks start from the same
weights and see the same batches. On the faces held out, the edge error with the Sobel term must be at least 10% lower, at an L1
error at most 10% higher; with the faces of the sheet, runs of seeds 0 to 2 gave 11.5 to 12.5% and 2.0 to 5.6%. The program writes a
figure of faces and one of loss curves.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

import kvision as K
from kvision.demo.arguments import device_of, images_of, make_folder, require

SIZE, LATENT, HELD_OUT = 64, 100, 0.3
WIDTHS = (32, 64, 128, 256)  # channels of the encoder
ALPHA, RATE = 0.1, 3e-3  # weight of L1 beside the edges; the largest learning rate
LOWER, HIGHER = 0.10, 0.10  # how much lower the edge error must be, and how much higher the L1 error may be
PLAIN, SOBEL = "L1 alone", "with Sobel"

# --- faces ----------------------------------------------------------------------------------------------------------


def faces(folder: Path | None) -> Tensor:
    """Faces (N, 3, 64, 64) in [0, 1]: the tiles of a sheet, or the hundred small gray ones of scikit-image, enlarged."""
    if folder is not None:
        sheet = K.io.load_image(folder / "faces" / "faces_64.png")[None]
        return K.contrib.extract_tensor_patches(sheet, SIZE, SIZE)[0].contiguous()
    from skimage import data

    gray = torch.from_numpy(data.lfw_subset()[:100]).float()[:, None]
    return K.geometry.resize(gray, (SIZE, SIZE), "bicubic").clamp(0, 1).repeat(1, 3, 1, 1)


def default_folder() -> Path | None:
    """The optional folder of sample images next to the repository."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    return folder if (folder / "faces" / "faces_64.png").is_file() else None


# --- network and losses ---------------------------------------------------------------------------------------------


def network() -> nn.Sequential:
    """Convolutions with stride 2 to 100 numbers, and nearest upsampling before convolutions back to a face."""
    layers: list[nn.Module] = []
    for inputs, outputs in zip((3, *WIDTHS), WIDTHS):
        layers += [nn.Conv2d(inputs, outputs, 4, 2, 1), nn.BatchNorm2d(outputs), nn.LeakyReLU(0.2)]
    last, side = WIDTHS[-1], SIZE >> len(WIDTHS)
    layers += [nn.Flatten(), nn.Linear(last * side**2, LATENT)]
    layers += [nn.Linear(LATENT, last * side**2), nn.Unflatten(1, (last, side, side))]
    for inputs, outputs in zip(WIDTHS[:0:-1], WIDTHS[-2::-1]):
        layers += [*doubled(inputs, outputs), nn.BatchNorm2d(outputs), nn.LeakyReLU(0.2)]
    return nn.Sequential(*layers, *doubled(WIDTHS[0], 3))


def doubled(inputs: int, outputs: int) -> tuple[nn.Module, nn.Module]:
    return nn.Upsample(scale_factor=2), nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode="replicate")


def errors(decoded: Tensor, images: Tensor) -> tuple[Tensor, Tensor]:
    """The L1 error, and that of the edges: the mean difference of the magnitudes of Sobel's gradients."""
    return F.l1_loss(decoded, images), F.l1_loss(K.filters.sobel(decoded), K.filters.sobel(images))


@dataclass(frozen=True)
class Trained:
    """A network, its errors (L1, edges) at each step of training, and on the faces held out."""

    model: nn.Sequential
    curve: list[tuple[float, float]]
    held_out: tuple[float, float]


def train(
    images: Tensor, unseen: Tensor, alpha: float, steps: int, batch: int, seed: int, progress: Callable[[], object]
) -> Trained:
    """Minimize alpha * L1 + (1 - alpha) * edges by Adam. The seed decides the first weights, the batches and the flips."""
    torch.manual_seed(seed)
    model = network().to(images.device)
    flip = K.augmentation.RandomHorizontalFlip()
    optimizer = torch.optim.Adam(model.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps)
    curve = []
    for _ in range(steps):
        chosen = flip(images[torch.randint(len(images), (batch,)).to(images.device)])
        pixels, edges = errors(model(chosen), chosen)
        optimizer.zero_grad()
        (alpha * pixels + (1 - alpha) * edges).backward()
        optimizer.step()
        schedule.step()
        curve.append(torch.stack((pixels, edges)).detach())
        progress()
    model.eval()
    with torch.no_grad():
        pixels, edges = errors(model(unseen), unseen)
    return Trained(model, [(x, y) for x, y in torch.stack(curve).tolist()], (float(pixels), float(edges)))


# --- figures --------------------------------------------------------------------------------------------------------


def draw_faces(rows: dict[str, Tensor], path: Path) -> None:
    """A row of faces for each name."""
    import matplotlib.pyplot as plt

    columns = max(len(row) for row in rows.values())
    figure, axes = plt.subplots(len(rows), columns, figsize=(1.1 * columns, 1.25 * len(rows)), squeeze=False)
    for line, (name, row) in zip(axes, rows.items()):
        line[0].set_title(name, fontsize=9, loc="left")
        for axis, face in zip(line, row):
            axis.imshow(face.clamp(0, 1).permute(1, 2, 0).cpu().numpy())
        for axis in line:
            axis.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    plt.close(figure)


def draw_curves(curves: dict[str, list[tuple[float, float]]], path: Path) -> None:
    """Both errors of the training batches over the steps, means of ten steps."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.4))
    for i, (axis, title) in enumerate(zip(axes, ("L1 error", "edge error"))):
        for name, curve in curves.items():
            means = [
                sum(errors[i] for errors in curve[k : k + 10]) / len(curve[k : k + 10])
                for k in range(0, len(curve), 10)
            ]
            axis.plot([min(10 * k + 10, len(curve)) for k in range(len(means))], means, label=name)
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("step")
        axis.set_yscale("log")
        axis.legend(frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    plt.close(figure)


# --- the run --------------------------------------------------------------------------------------------------------


def squared(image: Tensor) -> Tensor:
    """The square in the middle of an image, (1, 3, 64, 64)."""
    return K.geometry.center_crop(K.geometry.resize(image, SIZE, antialias=True), (SIZE, SIZE))


def compare(
    images: Tensor, seed: int, alpha: float, steps: int, batch: int, description: str
) -> tuple[dict[str, Trained], Tensor]:
    """Both networks of a seed, and the faces that were held out."""
    from tqdm import tqdm

    order = torch.randperm(len(images), generator=torch.Generator().manual_seed(seed)).to(images.device)
    count = round(HELD_OUT * len(images))
    unseen, seen = images[order[:count]], images[order[count:]]
    with tqdm(total=2 * steps, desc=description, unit="step", leave=False) as bar:
        trained = {
            name: train(seen, unseen, weight, steps, batch, seed, bar.update)
            for name, weight in ((PLAIN, 1.0), (SOBEL, alpha))
        }
    return trained, unseen


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with faces/faces_64.png")
    parser.add_argument("--steps", type=int, default=600, help="of each training")
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--alpha", type=float, default=ALPHA, help="weight of L1 beside the edges")
    parser.add_argument("--seeds", type=int, default=3, help="number of comparisons")
    parser.add_argument("--image", type=Path, nargs="+", default=[], help="your own portraits, encoded and decoded")
    parser.add_argument("--out", type=Path, default=Path("out/autoencoder"), help="where the figures go")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    options = parser.parse_args(arguments)
    device = device_of(parser, options.device)
    if options.data and not (options.data / "faces" / "faces_64.png").is_file():
        parser.error(f"--data {options.data}: expected a folder with faces/faces_64.png, there is none")
    pictures = [squared(x) for x in images_of(parser, options.image)]
    folder = options.data or default_folder()
    require(parser, "matplotlib", "tqdm", *(() if folder else ("skimage",)))
    images = faces(folder).to(device)
    make_folder(parser, options.out)
    missed = 0
    for seed in range(options.seeds):
        begin = time.perf_counter()
        trained, unseen = compare(images, seed, options.alpha, options.steps, options.batch, f"seed {seed}")
        (plain, plain_edges), (pixels, edges) = (trained[name].held_out for name in (PLAIN, SOBEL))
        met = edges <= (1 - LOWER) * plain_edges and pixels <= (1 + HIGHER) * plain
        missed += not met
        print(
            f"seed {seed}: edge error {plain_edges:.4f} {PLAIN}, {edges:.4f} {SOBEL} ({edges / plain_edges - 1:+.1%}); "
            f"L1 error {plain:.4f}, {pixels:.4f} ({pixels / plain - 1:+.1%}) of {len(unseen)} faces held out; "
            f"{time.perf_counter() - begin:.0f} s{'' if met else '  MISSED'}",
            flush=True,
        )
        if seed == 0:
            shown = torch.cat([picture.to(device) for picture in pictures] + [unseen[:8]])
            with torch.no_grad():
                decoded = {name: result.model(shown) for name, result in trained.items()}
            draw_faces({"original": shown, **decoded}, options.out / "faces.png")
            draw_curves({name: result.curve for name, result in trained.items()}, options.out / "curves.png")
    print(f"figures are in {options.out}")
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
