"""A message of 200 MB on a key of a run: nobody takes it in,
and what else travels there goes on.
"""

import subprocess
import sys
import threading
import time

import psutil

from saltus.resources import shipped_file
from saltus.wire.messages import Done
from saltus.wire.router import open_router
from saltus.wire.zenoh_bus import ZenohBus

MANY = 50  # messages after it, 100 a second
TIMEOUT_S = 30.0
SENDER = """
import sys, zenoh
settings = zenoh.Config.from_file(sys.argv[1])
settings.insert_json5("connect/endpoints", f'["{sys.argv[2]}"]')
with zenoh.open(settings) as session:
    session.put(sys.argv[3], bytes(200_000_000), congestion_control=zenoh.CongestionControl.BLOCK)
"""


def test_it_is_dropped_and_the_stream_beside_it_goes_on() -> None:
    endpoint, router = open_router()
    settings = str(shipped_file("zenoh_cfg/client.json5"))
    with ZenohBus(endpoint, "robot/0") as sender, ZenohBus(endpoint, "robot/0") as receiver:
        publisher, latest = sender.publisher("done", "render"), receiver.latest("done", "render")
        ended = threading.Event()

        def stream() -> None:
            step = 0
            while not ended.wait(0.01):
                step += 1
                publisher.put(
                    Done(time_ns=10_000_000 * step, step=step, process="render", frame_id=step)
                )

        thread = threading.Thread(target=stream)
        thread.start()
        try:
            assert latest.wait(TIMEOUT_S) is not None
            process = psutil.Process()
            before, most = process.memory_info().rss, 0
            with subprocess.Popen(
                [sys.executable, "-c", SENDER, settings, endpoint, "robot/0/done/render"]
            ) as huge:
                while huge.poll() is None:
                    latest.take()
                    most = max(most, process.memory_info().rss - before)
                    time.sleep(0.002)
            assert huge.returncode == 0
            for _ in range(MANY):
                assert latest.wait(TIMEOUT_S) is not None
        finally:
            ended.set()
            thread.join()
    router.close()
    assert most < 40e6
    assert receiver.rejected == {}
