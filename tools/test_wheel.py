"""Install a wheel as a user without a compiler does, and try it: python tools/test_wheel.py dist/*.whl

    --python python3.10 python3.12 ...   these Pythons; default: this one. torch must be there for them on the index.
    --torch 2.11.0 2.13.0                these versions of torch; default: what pip finds
    --modules python3.10 ...             only import kvision._C in these Pythons, with the torch of this Python

Each combination gets an environment of its own, with nothing but it on the PATH. There the wheel and what it depends on are
installed, `python -m kvision.info` must find every kernel of the CPU, and the programs of SMOKE must run.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

# Native calls with gradients, the routes of torch, files, augmentation, what needs no compiler of export; no file of the sources.
SMOKE = {
    "operators": """
import torch, kvision as K
with K.backend("native"):
    image = torch.rand(2, 3, 32, 40, requires_grad=True)
    blurred = K.filters.gaussian_blur2d(image, 5, (1.5, 1.5))
    matrix = torch.tensor([[[1.0, 0.1, 2], [-0.1, 1, 3]]]).expand(2, 2, 3)
    warped = K.geometry.warp_affine(K.color.rgb_to_lab(blurred), matrix, (30, 30))
    loss = K.filters.sobel(warped).mean() + K.losses.ssim_loss(image, image.flip(-1), 5)
    loss.backward()
assert image.grad.isfinite().all() and image.grad.abs().sum() > 0
with K.backend("reference"):
    torch.testing.assert_close(K.filters.median_blur(image, 3), K.backend("native")(K.filters.median_blur)(image, 3))
""",
    "routes": """
import torch, kvision as K
image = torch.rand(2, 3, 16, 20)
program = torch.export.export(K.filters.Sobel(), (image,), dynamic_shapes=({0: torch.export.Dim.DYNAMIC},))
assert torch.equal(program.module()(image[:1]), K.filters.sobel(image[:1]))
assert torch.equal(torch.func.vmap(K.filters.sobel)(image[None])[0], K.filters.sobel(image))
assert torch.equal(torch.jit.trace(K.filters.Sobel(), image)(image), K.filters.sobel(image))
""",
    "files": """
import torch, kvision as K
K.io.write_image("picture.png", torch.rand(3, 24, 32))
image = K.io.load_image("picture.png")[None]
augment = K.augmentation.AugmentationSequential(
    K.augmentation.RandomAffine(10.0), K.augmentation.ColorJitter(0.2, 0.2, 0.2, 0.1), data_keys=["image", "mask"]
)
images, masks = augment(image, (image[:, :1] > 0.5).float(), seed=torch.tensor([3]))
assert images.shape == image.shape and masks.shape == (1, 1, 24, 32)
frames, _, descriptors = K.feature.SIFTFeature(16)(torch.rand(1, 1, 64, 64))
assert descriptors.shape == (1, 16, 128)
""",
}


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--python", nargs="*", default=[sys.executable])
    parser.add_argument("--torch", nargs="*", default=[""])
    parser.add_argument("--modules", nargs="*", default=[])
    options = parser.parse_args(arguments)
    wheel = options.wheel.resolve()
    for python in options.python:
        for version in options.torch:
            begin = time.perf_counter()
            print(f"{python}, torch {version or 'that pip finds'}: {try_out(wheel, python, version)}", end="")
            print(f", {time.perf_counter() - begin:.0f} s", flush=True)
    for python in options.modules:
        print(f"{python}: kvision._C says {import_module(wheel, python)}", flush=True)


def run(*command: object, **options: object) -> str:
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True, **options)  # type: ignore[call-overload]
    if result.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))[:300]}\n{result.stdout}{result.stderr}")
    return result.stdout


def try_out(wheel: Path, python: str, torch: str) -> str:
    """Install and run in a fresh environment; the versions in it."""
    with tempfile.TemporaryDirectory() as folder:
        run(python, "-m", "venv", folder)
        binaries = Path(folder, "bin")
        # Only the environment is on the PATH: no compiler, no cmake. pip's own settings, such as its index, stay.
        environment = {
            k: v for k, v in os.environ.items() if k.startswith(("PIP_", "SSL_", "HTTP", "http", "no_proxy"))
        }
        environment |= {"PATH": str(binaries), "HOME": folder, "PYTHONNOUSERSITE": "1"}
        installed = [f"torch=={torch}"] if torch else []
        run(binaries / "python", "-m", "pip", "install", "--quiet", "--no-compile", wheel, *installed, env=environment)
        info = run(binaries / "python", "-m", "kvision.info", cwd=folder, env=environment)
        if "kvision._C was not built" in info or "libkvision.so " not in info:
            sys.exit(info)
        for name, program in SMOKE.items():
            run(binaries / "python", "-W", "ignore", "-c", program, cwd=folder, env=environment)
            print(f"  {name} ok", file=sys.stderr)
        return "; ".join(info.splitlines()[:2])


def import_module(wheel: Path, python: str) -> str:
    """What kvision._C of the wheel says in a Python that has no torch: its library is loaded with that of this Python."""
    torch = importlib.util.find_spec("torch")
    assert torch is not None and torch.origin is not None
    with tempfile.TemporaryDirectory() as folder:
        zipfile.ZipFile(wheel).extractall(folder)
        program = (
            "import importlib.machinery as m, importlib.util as u, sys; folder = sys.argv[1]\n"
            "path = folder + '/_C' + m.EXTENSION_SUFFIXES[0]\n"
            "spec = u.spec_from_file_location('_C', path); module = u.module_from_spec(spec); spec.loader.exec_module(module)\n"
            "print(sys.version.split()[0], module.version(), module.active_isa())"
        )
        libraries = {**os.environ, "LD_LIBRARY_PATH": str(Path(torch.origin).parent / "lib")}
        libraries.pop("PYTHONPATH", None)
        return run(python, "-c", program, Path(folder, "kvision"), env=libraries).strip()


if __name__ == "__main__":
    main()
