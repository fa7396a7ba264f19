"""Where the runs of a campaign are done: processes of this machine, or the workers of a cluster."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from navfilter.evaluation.montecarlo.campaign import program
from navfilter.playback.warm_up import available_cores

#: Threads inside a worker would only get into each other's way, and could change the last digit.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

#: Time [s] that a worker, told to end, and a thread of the pool may take for it: a fraction of a second as a rule.
_ENDING_S = 10.0


@contextmanager
def process_pool(workers: int | None = None) -> Iterator[Executor]:
    """Worker processes on this machine.

    Parameters
    ----------
    workers : int, optional
        Default: as many as there are processors for this process.
    """
    # Spawned, not forked: a fork of a process with threads can hang, and all systems behave alike.
    context = multiprocessing.get_context("spawn")
    before, threads = set(multiprocessing.active_children()), set(threading.enumerate())
    with _single_threaded():
        pool = ProcessPoolExecutor(workers or available_cores(), context, initializer=_prepare_worker)
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            ours = set(multiprocessing.active_children()) - before
            for process in ours:
                process.terminate()
            for process in ours:
                process.join(_ENDING_S)
            # the pool's own thread as well: the interpreter wakes it on its way out, through a pipe that it closes
            for thread in set(threading.enumerate()) - threads:
                if not thread.daemon:
                    thread.join(_ENDING_S)
            raise
        pool.shutdown()


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """The workers of a Dask cluster.

    Parameters
    ----------
    address : str
        Of its scheduler, such as "tcp://10.0.0.1:8786". The workers need navfilter in the same version.

    Raises
    ------
    ValueError
        Without the extra ``dask``, when nobody answers there, and when a worker runs another version of navfilter.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ValueError("--dask needs dask.distributed: pip install 'navfilter[dask]'.") from None
    try:
        client = Client(address, timeout="20s", set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise ValueError(f'no Dask scheduler answers at "{address}" ({error}).') from None
    with client:
        other = sorted({str(theirs) for theirs in client.run(program).values()} - {program()})
        if other:
            raise ValueError(
                f"the cluster's workers run navfilter {', '.join(other)}, here it is {program()}. Install the same one "
                "on all."
            )
        # not pure: every seed is computed, none taken from a cache of results
        yield client.get_executor(pure=False)


def _prepare_worker() -> None:
    """Ctrl-C reaches the workers too, but only the parent shall act on it; a worker whose parent is killed must not
    wait for ever.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Any) -> None:
    parent.join()
    os._exit(1)


@contextmanager
def _single_threaded() -> Iterator[None]:
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
