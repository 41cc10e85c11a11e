"""TorchRL's collectors of many processes, imported without their warnings; what the fork server preloads."""

from __future__ import annotations

import warnings

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # TorchRL 0.14 subclasses what it deprecates
    from torchrl.collectors import MultiAsyncCollector


class RoomyCollector(MultiAsyncCollector):
    """A collector whose queue holds a result of every worker.

    TorchRL's own queue holds one. A worker that cannot put its result for a second, because the caller
    is busy, collects again and drops the result (``_main_async_collector_impl``, ``has_timed_out``). A
    worker waits for an answer to what it has put, so with room for all of them none finds the queue full.
    """

    @property
    def _queue_len(self) -> int:
        return len(self.create_env_fn)
