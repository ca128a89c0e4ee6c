"""What a supervisor hands on to onlookers is what it heard, in batches that every process takes."""

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from saltus.config import RunConfig
from saltus.watch.live import UNSHARED_NS, WAITED_NS, Onlooker
from saltus.wire import codec, sharing
from saltus.wire.bus import RawSample, sender_of
from saltus.wire.messages import Done
from saltus.wire.roles import PROCESSES, keys
from saltus.wire.router import open_router
from saltus.wire.sharing import Sharer, unpack_samples
from saltus.wire.zenoh_bus import ZenohBus

# Nothing is lost on its links, however busy the computer: senders wait
RUN = RunConfig(robot="go1", grid="line", pace="lockstep")
PREFIX = RUN.prefix
TIMEOUT_S = 20.0
MS = 1_000_000
UNSHARED_S = 1e-9 * UNSHARED_NS


@pytest.fixture
def bus() -> Iterator[ZenohBus]:
    """A bus over a router of its own; a client beside it has what is needed of the endpoint."""
    endpoint, router = open_router(speed=RUN.link_speed)
    with contextlib.closing(router), ZenohBus.of_run(endpoint, RUN) as made:
        made.endpoint = endpoint  # type: ignore[attr-defined]
        yield made


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def sample(number: int, size: int, age_ns: int = 0) -> RawSample:
    payload = np.random.default_rng(number).bytes(size)
    return RawSample(
        f"event/{number}", payload, bytes([number % 256]) * 33, time.monotonic_ns() - age_ns
    )


def due(sharer: Sharer) -> Sharer:
    """So that what it is given next is sent at once."""
    sharer._sent_s = float("-inf")
    return sharer


@pytest.mark.parametrize("seed", range(8))
def test_what_is_handed_on_is_what_came_in_and_no_batch_is_too_large(seed: int) -> None:
    rng, sent = np.random.default_rng(seed), list[bytes]()
    sizes = rng.choice([0, 1, 300, 40_000, 600_000, codec.PAYLOAD_MAX, codec.PAYLOAD_MAX + 1], 25)
    given_ = [sample(number, int(size), age_ns=number * MS) for number, size in enumerate(sizes)]
    # Of a stranger
    given_ += [
        replace(given_[0], key="x" * 70_000),
        replace(given_[1], attachment=bytes(70_000)),
    ]
    sharer = Sharer(sent.append, lambda: True)
    sharer.take([])  # it learns that somebody looks on
    due(sharer).take(given_)
    assert all(len(batch) < codec.PAYLOAD_MAX + 100_000 for batch in sent)
    got = [each for batch in sent for each in unpack_samples(batch)]
    assert [(g.key, g.payload, g.attachment) for g in got] == [
        (s.key, s.payload, s.attachment) for s in given_
    ]
    late_ns = [g.arrival_ns - s.arrival_ns for g, s in zip(got, given_, strict=True)]
    assert min(late_ns) >= 0
    assert max(late_ns) < TIMEOUT_S * 1e9


def test_the_sender_of_a_key_is_who_may_put_to_it() -> None:
    for process in PROCESSES:
        for key in keys(process, "put", PREFIX):
            assert sender_of(key.removeprefix(f"{PREFIX}/")) == process
    assert sender_of("other") == sender_of("other/render") == ""


def test_while_nobody_looks_on_nothing_is_sent_or_kept() -> None:
    sent, there = list[bytes](), [False]
    sharer = Sharer(sent.append, lambda: there[0])
    for number in range(5):
        due(sharer).take([sample(number, 10)])
    assert sent == []
    there[0] = True
    due(sharer).take([sample(5, 10)])
    due(sharer).take([sample(6, 10)])
    assert [each.key for each in unpack_samples(sent[-1])] == ["event/6"]


def test_batches_come_once_a_period_and_nothing_is_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s, sent = [100.0], list[bytes]()
    monkeypatch.setattr(sharing.time, "monotonic", lambda: now_s[0])
    sharer = Sharer(sent.append, lambda: True)
    sharer.take([])
    for number in range(100):
        now_s[0] += 0.01
        sharer.take([sample(number, 3)])
    assert 20 <= len(sent) <= 1.0 / sharing.PERIOD_S  # of hundredths of a second: four or five
    keys = [each.key for batch in sent for each in unpack_samples(batch)]
    assert keys == [f"event/{number}" for number in range(len(keys))]
    assert len(keys) > 94


@given(st.binary(max_size=400))
def test_junk_is_no_batch(junk: bytes) -> None:
    for each in unpack_samples(junk):  # what is one by chance has the types of one
        assert isinstance(each.key, str)
        assert isinstance(each.payload, bytes)


def test_a_batch_that_was_cut_or_changed_raises_nothing() -> None:
    sent = list[bytes]()
    sharer = Sharer(sent.append, lambda: True)
    sharer.take([])
    due(sharer).take([sample(number, 50) for number in range(4)])
    whole, rng = sent[0], np.random.default_rng(0)
    ends = [unpack_samples(whole[:end]) for end in range(len(whole))]
    # All that is before the cut
    assert [len(each) for each in ends] == sorted(len(each) for each in ends)
    assert {len(each) for each in ends} == {0, 1, 2, 3}
    for _ in range(300):
        changed = bytearray(whole)
        changed[rng.integers(len(whole))] = rng.integers(256)
        unpack_samples(bytes(changed))


def test_an_onlooker_hears_by_its_supervisor_and_others_hear_no_batches(bus: ZenohBus) -> None:
    with ZenohBus.of_run(bus.endpoint, RUN) as page:  # type: ignore[attr-defined]
        heard, everything = bus.stream(), page.stream()
        sharer, looks_on, publisher = (
            bus.sharer(),
            Onlooker(page, 1000),
            bus.publisher("done", "render"),
        )
        got, direct = list[RawSample](), list[RawSample]()

        def steps(samples: list[RawSample]) -> list[int]:
            return [
                codec.decode_message(Done, each.payload).step
                for each in samples
                if each.key == "done/render"
            ]

        def arrives(number: int) -> bool:
            publisher.put(Done(time_ns=MS, step=number, process="render"))
            sharer.take(heard.drain())
            got.extend(looks_on.drain())
            direct.extend(everything.drain())
            return number in steps(got)

        until(lambda: arrives(0))
        begun_s = time.monotonic()
        for number in range(1, 1000):
            if time.monotonic() - begun_s > UNSHARED_S + 0.5:
                break
            arrives(number)
            time.sleep(0.01)
        until(lambda: arrives(number))
        assert looks_on._own is None
        assert [each for each in steps(got) if each] == sorted(each for each in steps(got) if each)
        assert set(range(1, number)) <= set(steps(got))
        assert {each.key for each in direct} == {"done/render"}


def test_a_supervisor_that_has_nothing_to_say_is_there_and_without_one_an_onlooker_listens_itself(
    bus: ZenohBus,
) -> None:
    with ZenohBus.of_run(bus.endpoint, RUN) as page:  # type: ignore[attr-defined]
        looks_on, sharer, publisher = (
            Onlooker(page, 1000),
            bus.sharer(),
            bus.publisher("done", "render"),
        )
        end_s = time.monotonic() + 2.0 * UNSHARED_S
        while time.monotonic() < end_s:
            sharer.take([])
            assert looks_on.drain() == []
            time.sleep(0.01)
        assert looks_on._own is None
        assert time.monotonic_ns() - looks_on.heard_until_ns() <= WAITED_NS
        got = list[RawSample]()  # now the supervisor is silent

        def heard() -> bool:
            publisher.put(Done(time_ns=MS, step=1, process="render"))
            got.extend(looks_on.drain())
            return len(got) > 3

        until(heard)
        assert looks_on._own is not None
        before_ns = time.monotonic_ns()
        assert before_ns <= looks_on.heard_until_ns() <= time.monotonic_ns()
        assert {each.key for each in got} == {"done/render"}


def test_who_listened_for_itself_hears_by_a_supervisor_that_hands_on_and_nothing_twice_or_not_at_all(
    bus: ZenohBus,
) -> None:
    """As when a page is there before the supervisor has loaded its processes."""
    with ZenohBus.of_run(bus.endpoint, RUN) as page:  # type: ignore[attr-defined]
        heard, looks_on, publisher = (
            bus.stream(),
            Onlooker(page, 1000),
            bus.publisher("done", "render"),
        )
        sharer, got, number = bus.sharer(), list[int](), 0

        def says_one(*, hands_on: bool) -> None:
            nonlocal number
            publisher.put(Done(time_ns=MS, step=(number := number + 1), process="render"))
            time.sleep(0.01)
            if hands_on:
                sharer.take(heard.drain())
            got.extend(codec.decode_message(Done, each.payload).step for each in looks_on.drain())

        while not got:
            says_one(hands_on=False)
        assert looks_on._own is not None
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < 1.0 or looks_on._own is not None:
            assert time.monotonic() - begun_s < TIMEOUT_S
            says_one(hands_on=True)
        own, last = page.stream(), number
        own.end()
        until(lambda: bool(says_one(hands_on=True)) or last in got)
        assert got[: got.index(last)] == list(range(got[0], last))
        publisher.put(Done(time_ns=MS, step=0, process="render"))
        time.sleep(0.1)
        assert own.drain() == [], "a stream that has ended hears nothing"
