"""Processes that work side by side, here or on a cluster: the only door to dask.distributed.

INPUTS: a function, jobs, a scheduler's address or a number of processes.
OUTPUTS: each job with its result, or with why there is none, as they are done.
"""

import logging
import math
import os
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from time import monotonic, sleep
from typing import Any

from jaxmocap.formats.files.errors import InputError

# A scheduler that does not answer within so many seconds is taken for absent.
CONNECT_TIMEOUT_S = 10
# Seconds between looks for finished jobs.
POLL_INTERVAL_S = 0.05
# Seconds between looks for jobs that take too long.
TIMEOUT_CHECK_S = 1.0
# A job may end so many processes. No job waits at a worker, where it would be blamed for the
# worker's end. Dask's own environment of the workers also sets MALLOC_TRIM_THRESHOLD_, with which a
# process gives memory back only to allocate it again: half of a recording's time went there.
CLUSTER_CONFIG = {
    "distributed.scheduler.allowed-failures": 2,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.nanny.pre-spawn-environ": {
        name: 1 for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    },
}

# The dashboard takes a free port, since another cluster may have the usual one. Only paths are
# sent, so there is nothing that a limit of memory could spill to disk.
LOCAL_CLUSTER: dict[str, Any] = {
    "threads_per_worker": 1,
    "host": "127.0.0.1",
    "dashboard_address": "127.0.0.1:0",
    "silence_logs": logging.CRITICAL,
    "memory_limit": 0,
}


@contextmanager
def cluster_client(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """A client of the scheduler at an address, or of processes here, one per core unless stated.

    Raises:
        InputError: no scheduler answers there, or dask.distributed is not installed.
    """
    try:
        import dask.config as dask_config
        from distributed import Client, LocalCluster
    except ImportError:
        problem = "found no such package: pip install 'jaxmocap[cluster]'"
        raise InputError("dask.distributed", problem) from None
    with ExitStack() as stack:
        if scheduler is None:
            stack.enter_context(dask_config.set(CLUSTER_CONFIG))
            cluster = LocalCluster(n_workers=workers or os.cpu_count() or 1, **LOCAL_CLUSTER)
            stack.enter_context(cluster)
            yield stack.enter_context(Client(cluster))
            return
        try:
            client = Client(scheduler, timeout=CONNECT_TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise InputError(scheduler, f"no scheduler answers there ({error})") from None
        yield stack.enter_context(client)


def results_as_completed(
    client: Any, function: Callable, jobs: Sequence[Any], timeout_s: float | None = None
) -> Iterator[tuple[Any, Any, str | None]]:
    """Every job, its result and why it has none, one of which is None, in the order they end.

    Those left are cancelled when the caller stops. A job that takes longer than ``timeout_s``
    seconds once it has begun is ended, with its process.
    """
    from distributed import as_completed

    futures = client.map(function, jobs, pure=False, retries=0)
    left = {future.key: (future, job) for future, job in zip(futures, jobs, strict=True)}
    completed, clock = as_completed(futures, raise_errors=False), _JobTimer(client, timeout_s)
    try:
        while left:
            for future in completed.next_batch(block=False):
                if future.key not in left:
                    continue
                _, job = left.pop(future.key)
                if future.status == "finished":
                    yield job, future.result(), None
                else:
                    yield job, None, _reason(future)
                # So that the scheduler forgets it.
                future.release()
            for key, worker in clock.overdue(left):
                future, job = left.pop(key)
                future.cancel()
                # One that cannot be ended is left alone.
                with suppress(Exception):
                    client.restart_workers([worker], timeout=CONNECT_TIMEOUT_S)
                yield job, None, f"took longer than {timeout_s:g} s (--job-timeout)"
            sleep(POLL_INTERVAL_S)
    finally:
        client.cancel(futures)


class _JobTimer:
    """Since when each job is being processed."""

    def __init__(self, client: Any, timeout_s: float | None):
        self._client, self._timeout, self._checked_at = client, timeout_s, -math.inf
        self._began: dict[tuple[str, str], float] = {}

    def overdue(self, keys: Container[str]) -> list[tuple[str, str]]:
        """Keys of jobs that take too long, and their workers."""
        now = monotonic()
        if self._timeout is None or now - self._checked_at < TIMEOUT_CHECK_S:
            return []
        self._checked_at = now
        processing = {
            (key, worker) for worker, ks in self._client.processing().items() for key in ks
        }
        self._began = {each: self._began.get(each, now) for each in processing}
        return [
            each
            for each, began in self._began.items()
            if each[0] in keys and now - began > self._timeout
        ]


def _reason(future: Any) -> str:
    """Why a future has no result, in one sentence."""
    if future.status == "cancelled":
        return "was cancelled"
    error = future.exception()
    if type(error).__name__ == "KilledWorker":
        return "its process died, perhaps for want of memory"
    return f"{type(error).__name__}: {error}"
