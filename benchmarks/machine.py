"""Metadata of a result: hardware, versions, command and commit."""

from __future__ import annotations

import datetime
import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch

import kvision
from benchmarks.peers import PEERS
from kvision._backend import unserved


def describe(device: torch.device, peers: Iterable[str]) -> dict[str, Any]:
    """Hardware, versions, threads, command, date and commit, ready for JSON.

    `kernels` is the requested backend, or the reason why kvision's kernels are missing and the references run.
    """
    return {
        "hardware": hardware(device),
        "cpu": cpu_name(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "python": platform.python_version(),
        "torch": torch.__version__,
        "cuda": torch.version.cuda if device.type == "cuda" else None,
        "kvision": kvision.__version__,
        "kernels": unserved.get(device.type, os.environ.get("KVISION_BACKEND", "auto")),
        "peers": {name: PEERS[name].version for name in peers},
        "command": command(),
        "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "commit": commit(),
    }


def hardware(device: torch.device) -> str:
    return torch.cuda.get_device_name(device) if device.type == "cuda" else cpu_name()


def cpu_name() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def command() -> str:
    """The command line, quoted for a shell."""
    module = sys.modules["__main__"].__spec__
    program = f"-m {module.name.removesuffix('.__main__')}" if module else sys.argv[0]
    return " ".join(["python", program, *sys.argv[1:]])


def commit() -> str | None:
    """Hash of the checked-out commit, with a + if the library or the benchmarks differ from it; None outside git."""
    root = Path(__file__).parent.parent

    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=True).stdout.strip()

    try:
        changed = git("status", "--porcelain", "--untracked-files=no", "csrc", "python", "benchmarks/*.py")
        return git("rev-parse", "--short=12", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return None
