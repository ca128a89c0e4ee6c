"""Hosts that share the batches of a round through Ray:
those of a cluster, or the cores of this machine.
"""

import os
import socket
import tempfile
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import NamedTuple, TypeVar

from saltus.errors import ConfigError, SaltusError, StackError
from saltus.provenance import commit

Task = TypeVar("Task")
Result = TypeVar("Result")

LOCAL = "local"
"""In place of an address: a cluster of this machine's cores, which begins and ends with the
work."""
RETRIES = 3
"""Retries of a task whose worker or host is lost, as many as are usual with Ray: one that kills
each of them is at fault."""

CONNECT_S = 5.0
"""For a connection to a cluster's port, as Ray's own first attempt.

Its further ones would take minutes.
"""


class Installation(NamedTuple):
    """Which code runs where."""

    host: str
    commit: str

    @classmethod
    def here(cls) -> "Installation":
        """The place of this process."""
        return cls(socket.gethostname(), commit())


def in_order_on_ray(
    function: Callable[[Path | None, Task], Result],
    file: Path | None,
    tasks: Sequence[Task],
    cluster: str,
    processes: int | None = None,
) -> Generator[Result, None, None]:
    """Yields `function` of the file and each task,
    in the order of the tasks, wherever it is computed.

    A task whose worker is lost is given to another one, so `function`, which every host knows by
    its name, must follow from its arguments alone. The file is sent to the hosts, which share no
    folder. Two tasks a core are begun or done ahead. However the iteration is left, what it began
    ends.

    Raises:
        ConfigError: Ray is not installed, or `processes` is given for a cluster that is not
            `LOCAL`.
        StackError: the cluster cannot be reached, a host has other code, or workers were lost again
            and again.
    """
    with _joined(cluster, processes) as ray:
        host = ray.remote(num_cpus=1, max_retries=RETRIES)(on_host)
        asked_by = Installation.here()
        data = ray.put(None if file is None else file.read_bytes())
        name = "" if file is None else file.name
        rest, waiting = iter(tasks), deque[object]()
        while True:
            # Hosts may have joined or left since the last one.
            ahead = 2 * max(1, int(ray.cluster_resources().get("CPU", 0)))
            free = max(0, ahead - len(waiting))
            waiting += (
                host.remote(function, name, data, task, asked_by) for task in islice(rest, free)
            )
            if not waiting:
                return
            yield ray.get(waiting.popleft())


def on_host(
    function: Callable[[Path | None, Task], Result],
    name: str,
    data: bytes | None,
    task: Task,
    asked_by: Installation,
) -> Result:
    """Runs one task where it was sent.

    Other code than that of who sent it would give other data, and is refused.
    """
    here = Installation.here()
    if here.host != asked_by.host and here.commit != asked_by.commit:
        raise StackError(
            f"host {here.host} has saltus {here.commit}, not {asked_by.commit}: install the same "
            "on every host"
        )
    if data is None:
        return function(None, task)
    with tempfile.TemporaryDirectory(prefix="saltus-") as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        return function(path, task)


@contextmanager
def _joined(cluster: str, processes: int | None) -> Iterator[ModuleType]:
    """Ray, connected to a cluster.

    An error of a task or of Ray is raised as one of Saltus where it is not a bug.
    """
    if processes is not None and cluster != LOCAL:
        raise ConfigError(
            f"processes = {processes}: the cluster at {cluster} knows its own; leave it away"
        )
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is sent to anyone
    try:
        import ray
    except ModuleNotFoundError as error:
        raise ConfigError('Ray is not installed: pip install "saltus[ray]"') from error
    try:
        try:
            _try_port(cluster)
            cores = (processes or len(os.sched_getaffinity(0))) if cluster == LOCAL else None
            ray.init(
                cluster,
                num_cpus=cores,
                include_dashboard=False,
                log_to_driver=False,
                logging_level="ERROR",
            )
        except Exception as error:  # what goes wrong at its start has no common base class
            raise StackError(f"no Ray cluster at {cluster}: {_first_line(error)}") from error
        yield ray
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, SaltusError):
            raise error.cause from error
        if isinstance(
            error.cause, ray.exceptions.RayError
        ):  # a host cannot even begin: it may lack a package
            raise StackError(
                f"a host of the Ray cluster at {cluster}: {_first_line(error.cause)}"
            ) from error
        raise
    except ray.exceptions.RayError as error:
        raise StackError(
            f"Ray at {cluster}: {type(error).__name__}: {_first_line(error)}"
        ) from error
    finally:
        ray.shutdown()


def _try_port(cluster: str) -> None:
    """Raises OSError where nobody listens at an address; what has no port is left to Ray."""
    host, _, port = cluster.removeprefix("ray://").rpartition(":")
    if port.isdecimal():
        socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_S).close()


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)
