"""kvision.demo.workers: no process outlives the program that started it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import kvision.demo.workers

PROGRAM = """
import multiprocessing, os, signal, sys, time
sys.path.append(sys.argv[2])
from workers import exit_with_parent  # without torch

def work(method, depth):
    exit_with_parent()
    if depth:
        multiprocessing.get_context(method).Process(target=work, args=(method, depth - 1)).start()
    os.write(1, b"%d\\n" % os.getpid())  # at once: the lines of processes do not mix
    signal.pause()

if __name__ == "__main__":
    for _ in range(2):
        multiprocessing.get_context(sys.argv[1]).Process(target=work, args=(sys.argv[1], 1)).start()
    signal.pause()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kills by POSIX signals")
@pytest.mark.parametrize(
    "method, killed_by", [("fork", signal.SIGKILL), ("spawn", signal.SIGTERM), ("forkserver", signal.SIGKILL)]
)
def test_workers_end_with_a_killed_program(method: str, killed_by: signal.Signals, tmp_path: Path) -> None:
    """Two workers, each with one of its own: all of them hold the pipe that is read here to its end."""
    (tmp_path / "program.py").write_text(PROGRAM)
    command = [sys.executable, "-S", tmp_path / "program.py", method, Path(kvision.demo.workers.__file__).parent]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        processes = [program.pid]
        try:
            processes += [int(program.stdout.readline()) for _ in range(4)]
            program.send_signal(killed_by)
            assert program.communicate(timeout=10) == ("", None)
        finally:
            for process in processes:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(process, signal.SIGKILL)
