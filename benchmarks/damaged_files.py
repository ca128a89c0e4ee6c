"""Damages files and messages at random: nothing dies, hangs or grows,
and each is refused with its reason in one line.

Files: models, checkpoints, recordings, bags, run logs, datasets and TOMLs, each read in a process
    that is watched.
Messages: what the decoder of every topic makes of mutated payloads.

    saltus bench damaged_files -- --files 1000 --payloads 100000
    saltus bench damaged_files -- --only "model heightmap" "toml run"
"""

import ctypes
import gc
import multiprocessing
import os
import resource
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks._command import Command, progress, tell
from benchmarks._damage import SoundFile, damage, make_samples, samples, shipped
from benchmarks._measuring import resident_mb
from saltus.errors import ConfigError, MessageError, SaltusError
from saltus.recordings.recording import read_recording
from saltus.wire.bus import RawSample, topic_of, unpack_sample
from saltus.wire.codec import Envelope, encode_message
from saltus.wire.messages import CommandMode, DriveCommand, JointPlan, Message, PlanStatus
from saltus.wire.topics import TOPICS

HUNG_S = 60.0
SETTLED = 20
"""Files after which a process has loaded what it needs: growth is counted from there."""
GIVEN_UP = 5
"""Deaths and hangs of one kind after which it is left."""
UNHEARD: dict[str, Message] = {
    "policy/joints": JointPlan(
        time_ns=0, step=0, status=PlanStatus.GO, joint_position=np.zeros(12),
        kp=np.full(12, 40.0), kd=np.ones(12), reason="",
    ),
    "operator/command": DriveCommand(
        time_ns=0, step=0, mode=CommandMode.WALK, velocity_x=0.5, velocity_y=0.0, yaw_rate=0.1
    ),
}  # fmt: skip
"""Messages of topics on which a run of jumps says nothing."""


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command):
    files: int = 1000
    """Damaged files of each kind."""
    payloads: int = 100_000
    """Mutated messages of each topic."""
    only: tuple[str, ...] = ()
    """Kinds of files; without it all, and the messages."""
    seed: int = 0

    def measure(self) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            make_samples(Path(folder), shipped())
            found = samples(Path(folder), shipped())
            if unknown := [name for name in self.only if name not in found]:
                raise ConfigError(f"only = {unknown[0]}: choose from {', '.join(found)}")
            kinds = list(self.only or found)
            table = {
                kind: self._files(kind, Path(folder), index) for index, kind in enumerate(kinds)
            }
            messages = {} if self.only else self.messages(found["recording"].path)
        return {"files": table, "messages": messages}

    def _files(self, kind: str, folder: Path, index: int) -> dict[str, Any]:
        path, found = samples(folder, shipped())[kind].path, Watched()
        good, first = path.read_bytes(), 0
        while first < self.files and found.counts["died"] + found.counts["hung"] < GIVEN_UP:
            first = self._watch(kind, folder, index, first, found)
            path.write_bytes(good)
        counts = {
            name: found.counts[name] for name in ("refused", "read", "raised", "died", "hung")
        }
        return {"files": first, **counts, "slowest_s": found.slowest_s,
            "growth_mb": found.growth_mb,
                "peak_mb": found.peak_mb}  # fmt: skip

    def _watch(self, kind: str, folder: Path, index: int, first: int, found: "Watched") -> int:
        """Lets a process read files until it ends, dies or hangs.

        Returns the number of the next file.
        """
        context = multiprocessing.get_context("spawn")
        here, there = context.Pipe(duplex=False)
        process = context.Process(
            target=_read_all, args=(kind, folder, (self.seed, index), first, self.files, there)
        )
        process.start()
        there.close()
        done = first
        with here:
            try:
                for _ in progress(range(first, self.files), kind):
                    if not here.poll(HUNG_S):
                        found.note(kind, done, "hung", "")
                        break
                    done = found.take(kind, here.recv())
            except EOFError:
                process.join()
                found.note(kind, done, "died", f"exit code {process.exitcode}")
        process.join(1.0)
        process.kill()
        process.join()
        return done if done == self.files else done + 1

    def messages(self, recording: Path) -> dict[str, Any]:
        """Returns what is made of mutated messages of each topic,
        beginning with those of a real run.

        Topics that a run of jumps has none of begin with a message that says the same throughout.
        """
        good: dict[str, list[RawSample]] = {}
        whole = read_recording(recording)
        for name in TOPICS:
            for arrival_ns, envelope, payload in whole.payloads(name):
                good.setdefault(name, []).append(
                    RawSample(_key(name), payload, envelope.to_bytes(), arrival_ns)
                )
            if name not in good:
                message = UNHEARD.get(name) or next(iter(whole.of(TOPICS[name].message)))
                envelope = Envelope(sequence=1, capture_ns=message.time_ns, boot_id=bytes(16))
                good[name] = [
                    RawSample(_key(name), encode_message(message), envelope.to_bytes(), 0)
                ]
        return {name: self._mutate(name, raws) for name, raws in good.items()}

    def _mutate(self, name: str, raws: list[RawSample]) -> dict[str, Any]:
        rng, counts = np.random.default_rng([self.seed, *name.encode()]), Counter[str]()
        topic = topic_of(raws[0].key)
        assert topic is not None
        before_mb = _settled_mb()
        for _ in progress(range(self.payloads), name):
            raw = raws[rng.integers(len(raws))]
            if rng.integers(8):
                raw = replace(raw, payload=damage(raw.payload, rng))
            else:
                raw = replace(raw, attachment=damage(raw.attachment, rng))
            try:
                unpack_sample(topic, raw)
                counts["read"] += 1
            except MessageError:
                counts["refused"] += 1
            except Exception as error:  # what must not be
                counts["raised"] += 1
                tell(f"{name}: {type(error).__name__}: {error}")
        return {
            **{key: counts[key] for key in ("refused", "read", "raised")},
            "growth_mb": _settled_mb() - before_mb,
        }


class Watched:
    """Outcomes of the files of one kind."""

    def __init__(self) -> None:
        self.counts = Counter[str]()
        self.slowest_s = 0.0
        self.growth_mb = 0.0
        self.peak_mb = 0.0

    def take(self, kind: str, told: tuple[int, str, str, float, float, float]) -> int:
        """Counts what a process says of one file; returns the number of the next."""
        number, outcome, text, seconds, growth_mb, peak_mb = told
        self.note(kind, number, outcome, text)
        self.slowest_s = max(self.slowest_s, seconds)
        self.growth_mb, self.peak_mb = max(self.growth_mb, growth_mb), max(self.peak_mb, peak_mb)
        return number + 1

    def note(self, kind: str, number: int, outcome: str, text: str) -> None:
        """Counts an outcome; says what must not be."""
        self.counts[outcome] += 1
        if outcome not in ("refused", "read"):
            tell(f"{kind} {number} {outcome}: {text[:300]}")


def _read_all(
    kind: str, folder: Path, seed: tuple[int, int], first: int, last: int, told: Connection
) -> None:
    """Reads damaged files and says of each what it led to,
    how long it took and what memory it left and needed [MB].
    """
    sample = samples(folder, shipped())[kind]
    good = sample.path.read_bytes()
    for _ in range(2):
        sample.read(sample.path)
    peak_kb, before_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, _settled_mb()
    for number in range(first, last):
        sample.path.write_bytes(damage(good, np.random.default_rng([*seed, number])))
        start_s = time.process_time()
        outcome, text = outcome_of(sample)
        taken_s = time.process_time() - start_s
        growth_mb = 0.0
        if number == first + SETTLED:
            before_mb = _settled_mb()
        elif number == last - 1 or number % 100 == 0:
            growth_mb = _settled_mb() - before_mb
        peak_mb = 1.024e-3 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak_kb)
        told.send((number, outcome, text, taken_s, growth_mb, peak_mb))


def outcome_of(sample: SoundFile) -> tuple[str, str]:
    """Outcome of reading a file: "read", "refused" with the reason, or "raised",
    which must not be.
    """
    try:
        sample.read(sample.path)
    except SaltusError as error:
        text = str(error)
        return ("raised" if "\n" in text else "refused"), text
    except BaseException as error:
        return "raised", f"{type(error).__name__}: {error}"
    return "read", ""


def _settled_mb() -> float:
    """Memory of this process without what is free and only kept [MB]."""
    gc.collect()
    with suppress(OSError, AttributeError):  # not glibc
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    return resident_mb([os.getpid()])


def _key(name: str) -> str:
    return f"{name}/one" if TOPICS[name].publisher == "*" else name
