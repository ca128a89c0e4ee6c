"""Trains the network of the scan on flights that are drawn while it learns: nothing is stored, nothing is repeated."""

import csv
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from saltus.errors import ModelError
from saltus.heightmap.scan.cells import centres
from saltus.heightmap.scan.elevation import ElevationMap, Surroundings, advanced, is_known, new_map
from saltus.heightmap.scan.planes import Heights, Inputs, inputs_of, remembered
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.draws import Draws
from saltus.heightmap.scan.training.flights import Flight, March, draw_flight, redrawn, shoot, true_heights
from saltus.heightmap.scan.training.model import ScanModel, loss, told
from saltus.heightmap.scan.training.rays import first_hits
from saltus.heightmap.scan.training.settings import FlightSettings, ScanTrainSettings

GROUPS = 4
"""Flights of so many groups of robots begin one after the other, so that every batch has young and old maps."""
WARM_UP = 0.03
"""Share of a training in which its rate grows."""
NEAR_M = 1.0
"""Cells that are farther than this from the base count half."""
UNSEEN = 0.5
"""Weight of a cell that was never measured."""
COLUMNS = ("update", "images", "seconds", "loss", "seen_mm", "unseen_mm", "inside_seen", "inside_all", "rate")


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where a training is; figures are means over the last round."""

    update: int
    images: int
    seconds: float
    loss: float
    seen_mm: float
    """Mean absolute error of cells that were measured [mm]."""
    unseen_mm: float
    inside_seen: float
    """Share within the half-width."""
    inside_all: float
    rate: float
    """Learning rate."""


class Trainer:
    """One training: network, optimiser, mean of weights, and how far it is.

    A round draws all of its flights from the seed and its own number, so that a training that goes on from a checkpoint
    does what one would have done that was not interrupted.
    """

    def __init__(self, settings: ScanTrainSettings, device: torch.device, *, compiled: bool = False) -> None:
        self.settings, self.device = settings, device
        torch.manual_seed(settings.seed)
        self.model = ScanModel(settings.network, settings.map).to(device, memory_format=torch.channels_last)
        self.average = ScanModel(settings.network, settings.map).to(device, memory_format=torch.channels_last)
        self.average.load_state_dict(self.model.state_dict())
        on_gpu = device.type == "cuda"
        self.optimiser = torch.optim.AdamW(
            self.model.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=on_gpu
        )
        self.rounds, self.seconds = 0, 0.0
        self._run: Callable[..., Any] = torch.compile(self.model) if compiled else self.model
        self._march: March = torch.compile(first_hits) if compiled else first_hits

    @property
    def updates(self) -> int:
        """How many were made."""
        return self.rounds * self.settings.round

    def round(self, share_before: float, share_after: float) -> Progress:
        """Makes the updates of one round, while the training goes from one share of its way to another."""
        began = time.monotonic()
        settings = self.settings
        draws = Draws(settings.seed * 1_000_003 + self.rounds, self.device)
        torch.manual_seed(settings.seed * 1_000_003 + self.rounds)
        with torch.no_grad():
            flight = draw_flight(settings.batch, settings.flight, draws)
            state = new_map(settings.batch, settings.map, flight.ground.height)
        totals: list[Tensor] = []
        for update in range(settings.round):
            share = share_before + (share_after - share_before) * update / settings.round
            for group in self.optimiser.param_groups:
                group["lr"] = settings.learning_rate * _schedule(share)
            flight, state = self._renewed(update, flight, state, draws)
            state, figures = self._update(flight, state, draws)
            totals.append(figures)
        found = torch.stack(totals).nanmean(0).tolist()
        self.rounds += 1
        self.seconds += time.monotonic() - began
        rate = self.optimiser.param_groups[0]["lr"]
        made = self.updates
        return Progress(
            update=made, images=made * settings.batch, seconds=self.seconds, loss=found[0], seen_mm=1e3 * found[1],
            unseen_mm=1e3 * found[2], inside_seen=found[3], inside_all=found[4], rate=rate,
        )  # fmt: skip

    def _renewed(
        self, update: int, flight: Flight, state: ElevationMap, draws: Draws
    ) -> tuple[Flight, ElevationMap]:
        """New flights for the robots whose time has come."""
        images, batch = self.settings.flight.images, self.settings.batch
        size = -(-batch // GROUPS)
        for group in range(GROUPS):
            rows = torch.arange(group * size, min((group + 1) * size, batch), device=self.device)
            if update and len(rows) and (update + group * images // GROUPS) % images == 0:
                with torch.no_grad():
                    redrawn(flight, rows, draw_flight(len(rows), self.settings.flight, draws))
                    redrawn(state, rows, new_map(len(rows), self.settings.map, flight.ground.height))
        return flight, state

    def _update(self, flight: Flight, state: ElevationMap, draws: Draws) -> tuple[ElevationMap, Tensor]:
        settings = self.settings
        with torch.no_grad():
            state, inputs, around, truth = example(flight, state, settings, draws, self._march)
            known, weight = is_known(state), _weight(state, around, settings.map)
        on_gpu = self.device.type == "cuda"
        with torch.autocast(self.device.type, torch.bfloat16, enabled=on_gpu):
            estimate = told(self._run, inputs, around.filled)
        value = loss(estimate, truth, weight)
        self.optimiser.zero_grad(set_to_none=True)
        value.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), settings.gradient_norm)
        self.optimiser.step()
        _average(self.average, self.model, settings.average, self.updates)
        estimate = Heights(estimate.height.detach(), estimate.half_width.detach())
        state = remembered(state, estimate)
        return state, _figures(value.detach(), estimate, truth, known)

    def save(self, path: Path) -> None:
        """Writes what `resume` reads, whole or not at all."""
        table = {
            "settings": self.settings.to_toml(), "rounds": self.rounds, "seconds": self.seconds,
            "model": self.model.state_dict(), "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }  # fmt: skip
        partial = path.with_name(f".{path.name}.partial")
        try:
            torch.save(table, partial)
            partial.replace(path)
        except (OSError, RuntimeError) as error:  # torch says RuntimeError where a disk is full
            partial.unlink(missing_ok=True)
            raise ModelError(f"cannot write {path}: {error}") from error

    def resume(self, path: Path) -> None:
        """Goes on from a checkpoint of the same settings.

        Raises:
            ModelError: the file is none, or of another training.
        """
        table = read_checkpoint(path)
        if table["settings"] != self.settings.to_toml():
            raise ModelError(f"{path} is of a training with other settings: name another folder with --out")
        self.model.load_state_dict(table["model"])
        self.average.load_state_dict(table["average"])
        self.optimiser.load_state_dict(table["optimiser"])
        self.rounds, self.seconds = int(table["rounds"]), float(table["seconds"])


def example(
    flight: Flight, state: ElevationMap, settings: ScanTrainSettings, draws: Draws, march: March = first_hits
) -> tuple[ElevationMap, Inputs, Surroundings, Tensor]:
    """The next image of every robot: the map with it, what the network is shown, and the true heights."""
    shot = shoot(flight, settings.flight, draws, march)
    state, around = advanced(state, shot.measured, settings.map)
    inputs = inputs_of(state, around, shot.now_s, shot.measured.body_height)
    return state, inputs, around, true_heights(flight, shot, state, around, settings.map, settings.flight)


def train(
    settings: ScanTrainSettings, folder: Path, *, minutes: float | None = None, updates: int | None = None,
    device: torch.device, compiled: bool = False, progress: Callable[[Progress], None] | None = None,
    save_every_s: float = 60.0,
) -> ScanModel:  # fmt: skip
    """Trains until time or updates are over; goes on where `folder` has a checkpoint of the same training.

    Returns:
        The mean of the last weights.
    """
    folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / "scan.pt"
    trainer = Trainer(settings, device, compiled=compiled)
    if checkpoint.exists():
        trainer.resume(checkpoint)
    saved, last = time.monotonic(), 0.0
    while True:
        before, after = _shares(trainer, last, minutes, updates)
        if before >= 1.0 - 1e-9:
            break
        seconds = trainer.seconds
        found = trainer.round(before, after)
        last = trainer.seconds - seconds
        _write_row(folder / "scan.csv", found)
        if progress is not None:
            progress(found)
        if time.monotonic() - saved > save_every_s:
            trainer.save(checkpoint)
            saved = time.monotonic()
    trainer.save(checkpoint)
    return trainer.average.eval()


def _shares(trainer: Trainer, last_s: float, minutes: float | None, updates: int | None) -> tuple[float, float]:
    """How much of the way is behind at the beginning of the next round, and at its end."""
    if minutes is not None:
        whole = 60.0 * minutes
        if trainer.seconds + 0.5 * last_s >= whole:
            return 1.0, 1.0
        return trainer.seconds / whole, min(1.0, (trainer.seconds + last_s) / whole)
    whole = float(updates or 0)
    return trainer.updates / max(whole, 1.0), (trainer.updates + trainer.settings.round) / max(whole, 1.0)


def _schedule(share: float) -> float:
    """Grows at first, then falls as a cosine; never quite to 0."""
    return min(1.0, (share + 1e-3) / WARM_UP) * (0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0))))


def _weight(state: ElevationMap, around: Surroundings, settings: MapSettings) -> Tensor:
    x, y = centres(state.corner, settings, around.base)
    away = (x - around.base[:, :1, None]) ** 2 + (y - around.base[:, 1:2, None]) ** 2
    near = torch.where(away < NEAR_M**2, 1.0, 0.5)
    return near * torch.where(is_known(state), 1.0, UNSEEN)


def _average(average: nn.Module, model: nn.Module, keep: float, updates: int) -> None:
    """A mean that forgets; in the beginning faster."""
    keep = min(keep, (1.0 + updates) / (10.0 + updates))
    mine, new = ([p.data for p in net.parameters()] for net in (average, model))
    torch._foreach_lerp_(mine, new, 1.0 - keep)


def _figures(value: Tensor, estimate: Heights, truth: Tensor, known: Tensor) -> Tensor:
    error = (estimate.height - truth).abs()
    inside = (error <= estimate.half_width).float()
    seen = known.float()
    count = seen.sum()
    return torch.stack(
        (
            value, (error * seen).sum() / count, (error * (1.0 - seen)).sum() / (seen.numel() - count),
            (inside * seen).sum() / count, inside.mean(),
        )
    )  # fmt: skip


def read_checkpoint(path: Path) -> dict[str, Any]:
    """The table that `Trainer.save` wrote, or `ModelError`."""
    try:
        table = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # what a file that is something else makes of its unpickling
        raise ModelError(f"{path} is no checkpoint of a scan's network: torch cannot read it") from error
    if not isinstance(table, dict) or not {"settings", "rounds", "model", "average"} <= table.keys():
        raise ModelError(f"{path} is no checkpoint of a scan's network")
    return table


def load_model(path: Path) -> tuple[ScanModel, ScanTrainSettings]:
    """The mean of weights of a checkpoint, on the CPU, and its settings; or `ModelError`."""
    table = read_checkpoint(path)
    settings = ScanTrainSettings.from_toml(table["settings"])
    model = ScanModel(settings.network, settings.map)
    model.load_state_dict(table["average"])
    return model.eval(), settings


def _write_row(path: Path, found: Progress) -> None:
    is_new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow(COLUMNS)
        writer.writerow([f"{getattr(found, name):.6g}" for name in COLUMNS])
