"""Worker processes of the examples."""

from __future__ import annotations

import multiprocessing
import os
import threading
from multiprocessing.connection import wait

__all__ = ["exit_with_parent"]


def exit_with_parent(worker: int = 0) -> None:
    """End this process as soon as the one that started it has ended, however that was: a `worker_init_fn` of a DataLoader.

    torch's own workers compare the number of their parent process. With "forkserver" that is the server, which in turn waits
    for the workers: a killed program would leave them all behind.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_after, args=(parent.sentinel,), daemon=True).start()


def _exit_after(sentinel: int) -> None:
    wait([sentinel])  # returns at once when the parent is gone already
    os._exit(1)  # without the finalizers, which wait for queues that nobody reads
