"""examples/train_distributed.py under torchrun on CPUs: streams, resumption after a killed rank, folders of images."""

from __future__ import annotations

import contextlib
import csv
import os
import signal
import subprocess
import sys
import time
import weakref
from pathlib import Path

import pytest
import torch
import torch.distributed as dist

import kvision as K
from kvision import _backend
from test_examples import EXAMPLES, example
from test_process_folder import below

pytestmark = pytest.mark.programs

SMALL = ("--batch", "4", "--count", "32", "--size", "40", "--crop", "32", "--device", "cpu")
STEPS, EVERY = 60, 3


def torchrun(folder: Path, *options: str, restarts: int = 0, ranks: int = 2) -> subprocess.Popen[str]:
    launcher = (
        "-m",
        "torch.distributed.run",
        "--standalone",
        f"--max-restarts={restarts}",
        f"--nproc-per-node={ranks}",
    )
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(sys.path),
        "KVISION_BACKEND": _backend.current_backend(),
        "OMP_NUM_THREADS": "1",
        "TORCH_DISABLE_SHARE_RDZV_TCP_STORE": "1",  # each start of the ranks gets a store of its own
    }
    return subprocess.Popen(
        [sys.executable, *launcher, EXAMPLES / "train_distributed.py", *SMALL, "--out", folder, *options],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def output_of(launcher: subprocess.Popen[str]) -> str:
    """What it prints, when it has ended. If it hangs, its ranks are ended too."""
    try:
        return launcher.communicate(timeout=300)[0]
    finally:
        launcher.terminate()


def losses(folder: Path) -> list[str]:
    """The loss of each step so far, as written."""
    path = folder / "losses.csv"
    return [row[1] for row in csv.reader(path.open())][1:] if path.exists() else []


def rank_of(launcher: subprocess.Popen[str], rank: int) -> int:
    """The process of that rank."""
    for child in below(launcher.pid):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has ended
            if f"RANK={rank}".encode() in Path(f"/proc/{child}/environ").read_bytes().split(b"\0"):
                return child
    raise AssertionError(f"rank {rank} does not run")


def kill(launcher: subprocess.Popen[str], folder: Path, after: int) -> None:
    """Kill rank 1 once so many losses have been written."""
    while len(losses(folder)) < after:
        assert launcher.poll() is None, launcher.stdout.read()
        time.sleep(0.01)
    os.kill(rank_of(launcher, 1), signal.SIGKILL)
    assert len(losses(folder)) < STEPS


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("undisturbed")
    output = output_of(torchrun(folder, "--steps", str(STEPS), "--every", str(EVERY)))
    assert output.count("images/s in all") == STEPS // EVERY, output
    assert len(losses(folder)) == STEPS
    return losses(folder)


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds processes in /proc")
@pytest.mark.slow
def test_a_killed_rank_changes_no_loss(undisturbed: list[str], tmp_path: Path) -> None:
    """torchrun starts the ranks again after the first time, after the second one does so by hand."""
    options = ("--steps", str(STEPS), "--every", str(EVERY), "--checkpoint", str(tmp_path / "checkpoint"))
    launcher = torchrun(tmp_path, *options, restarts=1)
    try:
        kill(launcher, tmp_path, after=3 * EVERY)
        kill(launcher, tmp_path, after=STEPS // 2)
        assert "continued at step " in output_of(launcher) and launcher.returncode != 0
        launcher = torchrun(tmp_path, *options)
        output = output_of(launcher)
    finally:
        launcher.terminate()
    assert launcher.returncode == 0, output
    assert "continued at step " in output
    assert losses(tmp_path) == undisturbed


@pytest.mark.slow
def test_the_loss_falls(undisturbed: list[str]) -> None:
    numbers = [float(loss) for loss in undisturbed]
    assert sum(numbers[-10:]) < 0.8 * sum(numbers[:10])


def test_streams_of_ranks_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    training = example("train_distributed")
    with training.process_group(torch.device("cpu")):
        setup = training.Setup(torch.device("cpu"), crop=16)
        run = training.Training(setup, training.Textures(4, 24, setup.device))
        pictures = run.pictures.pixels.permute(0, 3, 1, 2)
        results = []
        for rank in (0, 1, 0):
            monkeypatch.setattr(training.dist, "get_rank", lambda rank=rank: rank)
            run.seed_streams()
            results.append((run.augment(pictures), torch.rand(3)))
    for first, second, again in zip(*results):
        assert not torch.equal(first, second) and torch.equal(first, again)


def test_ranks_share_an_epoch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every image once in an epoch, in batches that are the same for 1 and 2 ranks."""
    training = example("train_distributed")

    def batches(ranks: int) -> list[list[int]]:
        monkeypatch.setattr(training.dist, "get_world_size", lambda: ranks)
        parts = []
        for rank in range(ranks):
            monkeypatch.setattr(training.dist, "get_rank", lambda rank=rank: rank)
            parts.append(list(training.Order(count=24, batch=8 // ranks, seed=3, first=0, last=6)))
        return [[index for part in pieces for index in part] for pieces in zip(*parts)]

    alone = batches(1)
    assert alone == batches(2)
    first, second = (sorted(index for batch in epoch for index in batch) for epoch in (alone[:3], alone[3:]))
    assert first == second == list(range(24))
    assert alone[:3] != alone[3:]


def test_images_of_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    groups, init = [], dist.init_process_group

    def init_and_watch(*arguments: object, **options: object) -> None:
        init(*arguments, **options)
        groups.append(weakref.ref(dist.group.WORLD))

    monkeypatch.setattr(dist, "init_process_group", init_and_watch)
    for label, name in enumerate(("dark", "bright")):
        (tmp_path / "data" / name).mkdir(parents=True)
        for i in range(6):
            picture = 0.3 * torch.rand(3, 30 + i, 44) + 0.6 * label
            K.io.write_image(tmp_path / "data" / name / f"{i}.png", picture)
    options = ["--data", str(tmp_path / "data"), *SMALL, "--steps", "3", "--every", "1", "--workers", "1"]
    checkpoint = ["--checkpoint", str(tmp_path / "checkpoint"), "--out", str(tmp_path)]
    assert example("train_distributed").main([*options, *checkpoint]) == 0
    (group,) = groups
    assert group() is None  # its threads have ended before Python does
    printed = capsys.readouterr().out
    assert printed.startswith("1 ranks by gloo, small, 4 images a rank\n") and "step 3/3 loss" in printed
    assert printed.endswith(f"the checkpoint is {tmp_path / 'checkpoint' / 'checkpoint.pt'}\n")
    assert len(losses(tmp_path)) == 3


def test_a_folder_without_classes_is_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        example("train_distributed").main(["--data", str(tmp_path), *SMALL])
    assert stopped.value.code == 2
    assert capsys.readouterr().err.endswith("in a folder of each class, got 0 in 0\n")
