"""A process of ours in a thread, and the others' end of its bus."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Self

from memory_bus import MemoryBus, MemoryHub
from samples import put_run

from saltus.config import RunConfig
from saltus.runtime.process import ProcessContext


class Stage:
    """Starts the body of a process when it is entered and ends it when it is left;
    `others` is the others' bus.
    """

    def __init__(
        self, name: str, body: Callable[[ProcessContext], None], config: RunConfig, folder: Path
    ) -> None:
        hub = MemoryHub()
        self.context = ProcessContext(
            name, config, put_run(folder, config), MemoryBus(config.prefix, hub)
        )
        self.others = MemoryBus(config.prefix, hub)
        self.done = self.others.latest("done", name)
        self.events = self.others.latest("event", name)
        self.status = self.others.latest("status", name)
        self.thread = threading.Thread(target=body, args=(self.context,), daemon=True)

    def __enter__(self) -> Self:
        self.thread.start()
        assert self.status.wait(timeout_s=10.0) is not None  # subscribed
        return self

    def __exit__(self, *_: object) -> None:
        self.context.stopped = True
        self.thread.join(timeout=5.0)
        assert not self.thread.is_alive()
