"""examples/process_folder.py: killed workers and jobs, broken images, lists of paths, decoders of a GPU."""

from __future__ import annotations

import contextlib
import csv
import glob
import io
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import kvision as K
from kvision import _backend
from test_examples import EXAMPLES, example

pytestmark = pytest.mark.programs

COUNT = 500
BROKEN = {
    "empty.png": "the file is empty",
    "text.jpg": "is in no format",
    "short.jpg": "short.jpg",
    "short.png": "short.png",
    "damaged.png": "damaged.png",
    "missing.png": "No such file",
    "small.png": "pipeline: ",
}
BLUR = "K.filters.GaussianBlur2d(5, (1.5, 1.5))"


def slow_step(most: int, out: Path) -> str:
    """A step that takes its time and stops at so many results, so that there is a middle in which to kill something."""
    enough = f"lambda: len([*__import__('pathlib').Path({str(out)!r}).rglob('[!.]*.png')]) >= {most}"
    wait = f"[__import__('time').sleep(0.03), *(__import__('time').sleep(0.01) for _ in iter({enough}, False))]"
    return f"type('Wait', (nn.Module,), {{'forward': lambda self, x: ({wait}, x)[1]}})()"


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """500 images in two folders, in three formats and two sizes, seven of them broken."""
    folder = tmp_path_factory.mktemp("pictures")
    texture = np.random.default_rng(0).integers(0, 256, (60, 80, 3), np.uint8)
    for name in ("a", "b"):
        (folder / name).mkdir()
    for i in range(COUNT - len(BROKEN)):
        path = folder / "ab"[i % 2] / f"{i}{('.jpg', '.png', '.WEBP')[i % 3]}"
        image = np.roll(texture, i, 1)[:, : 80 - 16 * (i % 2)]
        path.write_bytes(cv2.imencode(path.suffix.lower(), image)[1].tobytes())
    whole = {suffix: cv2.imencode(suffix, texture)[1].tobytes() for suffix in (".jpg", ".png")}
    (folder / "empty.png").write_bytes(b"")
    (folder / "text.jpg").write_text("this is no image")
    (folder / "short.jpg").write_bytes(whole[".jpg"][: len(whole[".jpg"]) // 2])
    (folder / "short.png").write_bytes(whole[".png"][: len(whole[".png"]) // 2])
    damaged = bytearray(whole[".png"])
    damaged[len(damaged) // 2 :] = bytes(len(damaged) - len(damaged) // 2)
    (folder / "damaged.png").write_bytes(damaged)
    (folder / "missing.png").symlink_to(folder / "nowhere.png")
    cv2.imwrite(str(folder / "small.png"), texture[:1, :1])
    return folder


def start(pictures: Path, out: Path, *options: str) -> subprocess.Popen[str]:
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(sys.path),
        "KVISION_BACKEND": _backend.current_backend(),
        "OMP_NUM_THREADS": "1",
    }
    command = [
        sys.executable,
        EXAMPLES / "process_folder.py",
        pictures,
        out,
        "--device",
        "cpu",
        "--batch",
        "8",
        *options,
    ]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def results(out: Path) -> dict[str, int]:
    """The results so far, with the time of their writing."""
    return {str(path.relative_to(out)): path.stat().st_mtime_ns for path in out.rglob("[!.]*.png")}


def wait_until(happened: Callable[[], object], job: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 300
    while not happened():
        assert job.poll() is None, job.stdout.read()
        assert time.monotonic() < deadline
        time.sleep(0.01)


# Processes and threads end while these look at them: Ray starts and ends its own as it likes.


def below(process: int) -> list[int]:
    """The children of a process and theirs."""
    children: list[int] = []
    for path in glob.glob(f"/proc/{process}/task/*/children"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            children += map(int, Path(path).read_text().split())
    return children + [grandchild for child in children for grandchild in below(child)]


def command_of(process: int) -> bytes:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""


def kill(process: int) -> bool:
    """Whether it was still there."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)
        return True
    return False


def kill_all(job: subprocess.Popen[str]) -> None:
    """The job and all processes below it, some of which end with those above them."""
    if job.poll() is None:
        for process in [job.pid, *below(job.pid)]:
            kill(process)
        job.wait()


def kill_worker(job: subprocess.Popen[str], engine: str) -> bool:
    """Kill a process that decodes: a child of multiprocessing's server, or of Ray's. Whether there was one."""
    names = {child: command_of(child) for child in below(job.pid)}
    if engine == "ray":
        workers = [child for child, name in names.items() if b"ray::" in name and b"MapBatches" in name]
    else:
        workers = [child for child, name in names.items() if b"forkserver" in name and not below(child)]
    return bool(workers) and kill(workers[0])


def check(pictures: Path, out: Path) -> None:
    """Every image has its result or its line in the report, and some results are what the pipeline gives."""
    names = {str(path.relative_to(pictures)) for path in pictures.rglob("*") if not path.is_dir()}
    assert len(names) == COUNT
    assert set(results(out)) == {f"{name}.png" for name in names - set(BROKEN)}
    assert not list(out.rglob(".*"))
    rows = list(csv.reader((out / "broken.csv").open()))
    assert rows[0] == ["path", "error"] and len(rows) == 1 + len(BROKEN)
    errors = {Path(path).name: error for path, error in rows[1:]}
    assert errors.keys() == BROKEN.keys() and all(BROKEN[name] in errors[name] for name in BROKEN), errors
    for name in sorted(names - set(BROKEN))[::50]:
        expected = K.filters.gaussian_blur2d(K.io.load_image(pictures / name)[None], 5, (1.5, 1.5))[0]
        assert (K.io.load_image(out / f"{name}.png") - expected).abs().max() < 0.6 / 255


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds processes in /proc")
@pytest.mark.parametrize(
    "engine",
    ["local", pytest.param("ray", marks=pytest.mark.skipif(not find_spec("ray"), reason="Ray is not installed"))],
)
def test_each_image_is_processed_once(engine: str, pictures: Path, tmp_path: Path) -> None:
    """A worker is killed in the middle, later the whole job, which is then started again."""
    out = tmp_path / "out"
    options = ("--engine", engine, "--workers", "2", "--actors", "2", "--compare", "0", "--pipeline", BLUR)
    job = start(pictures, out, *options, slow_step(400, out))
    try:
        wait_until(lambda: len(results(out)) >= 40, job)
        wait_until(lambda: kill_worker(job, engine), job)
        wait_until(lambda: len(results(out)) >= 300, job)
        kill_all(job)
        first = results(out)
        assert 300 <= len(first) < COUNT - len(BROKEN)
        job = start(pictures, out, *options)
        output, _ = job.communicate(timeout=300)
    finally:
        kill_all(job)
    assert job.returncode == 0, output
    check(pictures, out)
    assert results(out).items() >= first.items(), "results of the first start were written again"
    assert f"{COUNT} images, " in output and f"results and broken.csv are in {out}" in output.splitlines()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="finds processes in /proc")
@pytest.mark.parametrize("killed_by", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_a_killed_job(killed_by: signal.Signals, pictures: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    job = start(pictures, out, "--workers", "2", "--pipeline", "nn.Identity()", slow_step(40, out))
    processes: list[int] = []
    try:
        wait_until(lambda: len(results(out)) >= 40, job)
        processes = below(job.pid)
        assert sum(b"forkserver" in command_of(process) for process in processes) == 3
        job.send_signal(killed_by)
        job.communicate(timeout=10)  # the workers have its output, too
        assert not any(command_of(process) for process in processes)
    finally:
        kill_all(job)
        for process in processes:
            kill(process)


def run(*options: object) -> int:
    return example("process_folder").main([*map(str, options), "--device", "cpu", "--workers", "0"])


def test_second_start_does_no_work(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run(pictures, out) == 0
    check(pictures, out)
    printed = capsys.readouterr().out
    done = COUNT - len(BROKEN)
    assert printed.startswith(f"500 images, 0 of them done before; {done} done and 7 broken in ")
    assert "the same in a loop of OpenCV, " in printed and "decoding by opencv, " in printed
    first = results(out)
    assert run(pictures, out) == 0
    assert results(out) == first
    assert "500 images, 500 of them done before; 0 done and 0 broken" in capsys.readouterr().out
    assert run(pictures, out, "--retry", "--compare", 0) == 0
    assert "493 of them done before; 0 done and 7 broken" in capsys.readouterr().out
    check(pictures, out)


def test_bad_files_are_lines_of_the_report(tmp_path: Path, monkeypatch, capsys) -> None:
    """A pipe, which would be waited for, a folder, names that are no text, too long a name, too many pixels."""
    monkeypatch.setenv("OPENCV_IO_MAX_IMAGE_PIXELS", "")  # set by the program
    pictures, out = tmp_path / "pictures", tmp_path / "out"
    pictures.mkdir()
    good = {"a.png": 9, f"{'b' * 196}.png": 9, "even.png": 10}
    for name, side in {**good, f"{'c' * 197}.png": 9, "large.png": 11, "no text.png": 9}.items():
        K.io.write_image(pictures / name, torch.rand(3, side, 10))
    os.rename(pictures / "no text.png", pictures / "\udcff.png")
    os.mkfifo(pictures / "pipe.png")
    options = (pictures, out, "--max-pixels", 100, "--compare", 0)
    assert run(*options) == 0
    assert "7 images, 0 of them done before; 3 done and 4 broken" in capsys.readouterr().out
    assert results(out).keys() == {f"{name}.png" for name in good}
    rows = dict(list(csv.reader((out / "broken.csv").open()))[1:])
    assert rows == {
        str(pictures / "\\udcff.png"): "its name is no valid text",
        str(pictures / f"{'c' * 197}.png"): "its name has 201 bytes, more than 200",
        str(pictures / "large.png"): "the image has more than 100 pixels (--max-pixels)",
        str(pictures / "pipe.png"): f"{pictures / 'pipe.png'} is no regular file",
    }
    assert run(*options) == 0
    assert "7 of them done before; 0 done and 0 broken" in capsys.readouterr().out
    assert dict(list(csv.reader((out / "broken.csv").open()))[1:]) == rows


# Workers import the program as their main module, and with it the function that dies.
DIES = """
import os, sys, time
import process_folder

read = process_folder.read

def read_or_die(number, task, *options):
    if "slow" in task.path:
        time.sleep(1000)
    return os._exit(1) if "deadly" in task.path else read(number, task, *options)

process_folder.read = read_or_die

if __name__ == "__main__":
    raise SystemExit(process_folder.main())
"""


@pytest.mark.slow
def test_a_worker_that_dies_or_hangs_costs_a_line(tmp_path: Path) -> None:
    """In a job without stderr, and with OpenCV's own check of a header that asks for more than there is."""
    pictures, out = tmp_path / "pictures", tmp_path / "out"
    pictures.mkdir()
    good = {f"{i}.png" for i in range(12)}
    for name in (*good, "3deadly.png", "large.png", "slow.png"):
        K.io.write_image(pictures / name, torch.rand(3, 9, 101 if name == "large.png" else 9))
    (tmp_path / "program.py").write_text(DIES)
    options = (pictures, out, "--device", "cpu", "--workers", 2, "--batch", 4, "--max-pixels", 900, "--compare", 0)
    options += ("--timeout", 8)
    command = [sys.executable, tmp_path / "program.py", *map(str, options)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(EXAMPLES), *sys.path])}
    shell = f"exec {shlex.join(map(str, command))} 2>&-"
    job = subprocess.run(shell, shell=True, env=environment, stdout=subprocess.PIPE, text=True, timeout=200)
    assert job.returncode == 0 and "15 images, 0 of them done before; 12 done and 3 broken" in job.stdout
    assert results(out).keys() == {f"{name}.png" for name in good}
    rows = dict(list(csv.reader((out / "broken.csv").open()))[1:])
    assert rows == {
        str(pictures / "3deadly.png"): "the process that decoded it died or hung",
        str(pictures / "slow.png"): "the process that decoded it died or hung",
        str(pictures / "large.png"): "the image has more than 900 pixels (--max-pixels)",
    }


def test_bad_jobs_are_refused_before_work(tmp_path: Path, capsys) -> None:
    pictures = tmp_path / "pictures"
    (pictures / "pictures").mkdir(parents=True)
    for name in ("a.png", "pictures/b.png"):
        K.io.write_image(pictures / name, torch.rand(3, 9, 9))
    listed = tmp_path / "list.txt"
    before = sorted(tmp_path.rglob("*"))

    def refused(source: Path, out: Path) -> str:
        with pytest.raises(SystemExit) as stopped:
            run(source, out)
        assert stopped.value.code == 2
        return capsys.readouterr().err.splitlines()[-1]

    for out in (pictures, pictures / "out", tmp_path / "pictures" / ".." / "pictures" / "out"):
        assert refused(pictures, out).endswith("is inside the folder of the images")
    assert refused(pictures, tmp_path).endswith(f"results would go to {pictures}, which is the folder of the images")
    out = tmp_path / "out"
    for lines, said in {
        ("../a.png", "a.png"): f"../a.png and a.png have the same result, {out}/a.png.png",
        ("http://h/a.png?1", "http://h/a.png?2"): f"have the same result, {out}/h/a.png.png",
        ("a.png", "a.png.png/b.png"): f"the result of a.png, {out}/a.png.png, is the folder of other results",
        ("a.png", f"{out}/a.png.png"): f"{out}/a.png.png is an image and a result",
    }.items():
        listed.write_text("\n".join(lines))
        assert refused(listed, out).endswith(said)
    listed.unlink()
    assert sorted(tmp_path.rglob("*")) == before
    out.mkdir()
    with example("process_folder").Report(out, False):
        assert refused(pictures, out).endswith(f"{out}: another job is writing its results there")
        assert [path.name for path in out.iterdir()] == ["broken.csv"]
    assert run(pictures, out, "--compare", 0) == 0


@pytest.mark.parametrize("stderr", ["broken", None])
def test_a_job_without_stderr(stderr: str | None, pictures: Path, tmp_path: Path, monkeypatch) -> None:
    class Pipe(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stderr", stderr and Pipe())
    assert run(pictures / "a" / "0.jpg", tmp_path / "out", "--compare", 0) == 0
    assert results(tmp_path / "out").keys() == {"0.jpg.png"}


def test_a_list_of_paths_and_urls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a b.png", "c.png"):
        K.io.write_image(tmp_path / name, torch.rand(3, 9, 9))
    lines = [
        f"file://{tmp_path}/a%20b.png",
        str(tmp_path / "c.png"),
        "",
        "nowhere://bucket/d.png",
        str(tmp_path / "c.png"),
    ]
    (tmp_path / "list.txt").write_text("\n".join(lines))
    assert run(tmp_path / "list.txt", tmp_path / "out", "--pipeline", "K.filters.Sobel()", "--compare", 0) == 0
    inside = str(tmp_path).lstrip("/")
    assert results(tmp_path / "out").keys() == {f"{inside}/a b.png.png", f"{inside}/c.png.png"}
    assert "3 images, 0 of them done before; 2 done and 1 broken" in capsys.readouterr().out
    assert "nowhere://bucket/d.png," in (tmp_path / "out" / "broken.csv").read_text()


def test_results_as_jpeg(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    K.io.write_image(tmp_path / "gray.png", torch.full((3, 16, 16), 0.5))
    (tmp_path / "list.txt").write_text(str(tmp_path / "gray.png"))
    assert run(tmp_path / "list.txt", tmp_path / "out", "--format", ".jpg") == 0
    (result,) = (tmp_path / "out").rglob("gray.png.jpg")
    assert result.read_bytes().startswith(b"\xff\xd8")
    assert "the same in a loop of OpenCV, 1 images: " in capsys.readouterr().out


def test_a_task_is_finished_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    process = example("process_folder")
    written: list[str] = []
    monkeypatch.setattr(process, "write", lambda task, image: written.append(task.path))
    tasks = [process.Task(str(i), str(tmp_path / f"{i}.png")) for i in range(3)]
    job = process.Job(tasks, process.Report(tmp_path, False), 2, lambda: None)
    for _ in range(2):
        job.finish([(0, torch.zeros(3, 1, 1)), (1, "no image"), (2, torch.zeros(3, 1, 1))])
    job.wait()
    assert sorted(written) == ["0", "2"] and job.broken == 1
    assert (tmp_path / "broken.csv").read_text().splitlines() == ["path,error", "1,no image"]


def test_jpeg_files_go_to_the_decoder_of_the_gpu(pictures: Path, tmp_path: Path) -> None:
    """Whole ones do, turned ones too; where one of them is damaged inside, the others are decoded still."""
    pytest.importorskip("PIL")
    process = example("process_folder")
    hollow = (pictures / "b/3.jpg").read_bytes().replace(b"\xff\xdb", b"\xff\xfe")  # no quantization tables
    (tmp_path / "hollow.jpg").write_bytes(hollow)
    names = ("a/0.jpg", "b/1.png", "short.jpg", "text.jpg")
    paths = [*(pictures / name for name in names), tmp_path / "hollow.jpg"]
    batch = [process.read(i, process.Task(str(path), ""), True) for i, path in enumerate(paths)]
    assert [item.jpeg is not None for item in batch] == [True, False, False, False, True]
    result = dict(process.Apply(["nn.Identity()"], "cpu", "opencv", True)(batch))
    assert torch.equal(result[0], K.io.load_image(paths[0], K.io.ImageLoadType.RGB8)) and result[1].shape == (3, 60, 64)
    assert "short.jpg" in result[2] and "in no format" in result[3]
    assert result[4] == "decode: cannot decode the file: the file is damaged or cut short"


@pytest.mark.parametrize(
    "options, said",
    [
        (["--device", "gpu"], "--device gpu: expected cpu or cuda"),
        (["--decoder", "torchvision"], "--decoder torchvision: expected one of opencv here"),
        (["--pipeline", "K.filters.NoSuch()"], "--pipeline: AttributeError: module 'kvision.filters' has no attribute"),
    ],
)
def test_wrong_options_are_reported(options: list[str], said: str, tmp_path: Path, capsys) -> None:
    with pytest.raises(SystemExit) as stopped:
        example("process_folder").main([str(tmp_path), str(tmp_path / "out"), "--device", "cpu", *options])
    assert stopped.value.code == 2
    assert f"error: {said}" in capsys.readouterr().err.splitlines()[-1]
    with pytest.raises(SystemExit):
        run(tmp_path / "wrong", tmp_path / "out")
    assert "expected a folder of images or a list of paths, there is none" in capsys.readouterr().err
    (tmp_path / "list.bin").write_bytes(b"\xff\xfe\xff")
    with pytest.raises(SystemExit):
        run(tmp_path / "list.bin", tmp_path / "out")
    assert "expected a text file with a path or URL in each line" in capsys.readouterr().err.splitlines()[-1]


def test_single_image(pictures: Path, tmp_path: Path) -> None:
    assert run(pictures / "a" / "0.jpg", tmp_path / "out", "--compare", 0) == 0
    assert (tmp_path / "out" / "0.jpg.png").stat().st_size > 0
