import os
import secrets
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import psutil
import pytest
from ray.cluster_utils import Cluster

from saltus.cli.main import main
from saltus.errors import ConfigError, ModelError, StackError
from saltus.heightmap.data.closed_loop import closed_loop_episodes
from saltus.heightmap.data.episode import Episode
from saltus.heightmap.data.ray_workers import LOCAL, Installation, in_order_on_ray, on_host
from saltus.heightmap.data.shards import write_shard
from saltus.heightmap.settings import MIN_TICKS, ClosedLoop
from saltus.resources import resource
from saltus.workers import in_order

LOOP = ClosedLoop(robot="go1", grid="line", robots=2, courses=1, ticks=MIN_TICKS + 4, hardest=0.3)
EPISODES = partial(closed_loop_episodes, LOOP)
KEYS = [(3, 1, batch) for batch in range(4)]
HOPELESS = (3, 1, 99)
MODEL = resource("models/heightmap.onnx")


@pytest.fixture(scope="module", autouse=True)
def _environment() -> Iterator[None]:
    """Nothing is sent to anyone, and Ray leaves no token in the home folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.setenv("RAY_AUTH_TOKEN", secrets.token_hex(32))
        patch.setenv("OMP_NUM_THREADS", "1")
        patch.setenv("PYTHONPATH", str(Path(__file__).parent))  # every host knows `Deadly`
        yield


@pytest.fixture
def cluster() -> Iterator[Cluster]:
    """Two hosts of one core each, as far as Ray can tell."""
    hosts = Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    hosts.add_node(num_cpus=1)
    yield hosts
    hosts.shutdown()


@dataclass(frozen=True)
class Deadly:
    """Batches of which the third kills the worker that is the first to take it,
    and the last fails on every host.
    """

    killed: Path

    def episodes(self, model: Path | None, key: tuple[int, ...]) -> list[Episode]:
        if key == KEYS[2] and not self.killed.exists():
            self.killed.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if key == HOPELESS:
            raise ModelError(f"{model and model.name} is hopeless")
        return closed_loop_episodes(LOOP, model, key)


@pytest.mark.slow
def test_hosts_give_the_data_of_processes_though_a_worker_and_a_host_are_lost(
    cluster: Cluster, tmp_path: Path
) -> None:
    deadly = Deadly(tmp_path / "killed")

    def lossy() -> Iterator[Episode]:
        with closing(
            in_order_on_ray(deadly.episodes, MODEL, [*KEYS, HOPELESS], cluster.address)
        ) as batches:
            yield from next(batches)
            cluster.remove_node(
                next(host for host in cluster.list_all_nodes() if host is not cluster.head_node)
            )
            for batch in islice(batches, len(KEYS) - 1):
                yield from batch
            with pytest.raises(ModelError, match=r"^heightmap\.onnx is hopeless$"):
                next(batches)

    here = (episode for batch in in_order(partial(EPISODES, MODEL), KEYS, 2) for episode in batch)
    for name, episodes in (("ray", lossy()), ("processes", here)):
        write_shard(tmp_path / name, episodes, seed=3, config={})
    assert deadly.killed.exists()
    assert (tmp_path / "ray" / "round_000.h5").read_bytes() == (
        tmp_path / "processes" / "round_000.h5"
    ).read_bytes()


@pytest.mark.slow
def test_an_interrupted_run_leaves_no_process_and_no_shard(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from saltus.heightmap.training.dagger import *\n"
        "from saltus.heightmap.settings import *\n"
        "told = Observer(collected=lambda i, done, ticks: print(done, flush=True), trained=lambda "
        "i, p: None)\n"
        f"dagger(Path(sys.argv[1]), DaggerConfig(batches=50, loop={LOOP!r}), told, processes=1, "
        f"cluster={LOCAL!r})\n"
    )
    command = [sys.executable, "-c", code, tmp_path / "run"]
    run = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
    )
    assert run.stdout is not None
    assert run.stdout.readline() == b"1\n"  # one of fifty batches is done
    of_ray = psutil.Process(run.pid).children(recursive=True)
    assert any(process.name().startswith("ray::") for process in of_ray)
    os.killpg(run.pid, signal.SIGINT)  # as a terminal does
    run.communicate(timeout=20)
    assert run.returncode != 0
    assert psutil.wait_procs(of_ray, timeout=20)[1] == []
    assert list((tmp_path / "run" / "dataset").iterdir()) == []


def test_who_has_no_ray_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigError, match=r"saltus\[ray\]"):
        next(in_order_on_ray(EPISODES, None, KEYS, LOCAL))


def test_the_command_line_asks_for_the_cluster_that_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["heightmap", "dagger", "--ray", "nowhere", "--out", str(tmp_path / "run")]) == 2
    assert "no Ray cluster at nowhere" in capsys.readouterr().err.splitlines()[-1]


def test_an_address_where_nobody_listens_is_named_at_once() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    for address in (f"127.0.0.1:{port}", f"ray://127.0.0.1:{port}", "no address"):
        with pytest.raises(StackError, match=f"no Ray cluster at {address}"):
            next(in_order_on_ray(EPISODES, None, KEYS, address))


def test_a_cluster_knows_its_own_cores() -> None:
    with pytest.raises(ConfigError, match="processes = 3"):
        next(in_order_on_ray(EPISODES, None, KEYS, "10.0.0.1:6379", processes=3))


def test_a_host_with_other_code_is_refused() -> None:
    with pytest.raises(StackError, match="not another: install the same"):
        on_host(EPISODES, "", None, KEYS[0], Installation("elsewhere", "another"))
