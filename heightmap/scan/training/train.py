"""Trains the network of the scan on flights that are drawn while it learns:
nothing is stored, nothing is repeated.
"""

import math
import time
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor
from torch.nn import functional

from saltus.errors import ModelError
from saltus.files import atomic_write
from saltus.heightmap.scan.cells import cell_centres
from saltus.heightmap.scan.elevation import (
    ElevationMap,
    MapContext,
    new_map,
)
from saltus.heightmap.scan.network_inputs import MEASURED, MapHeights, remember_told
from saltus.heightmap.scan.settings import MapSettings
from saltus.heightmap.scan.training.cuda_graph import CudaGraph
from saltus.heightmap.scan.training.examples import UpdateCalls, next_example
from saltus.heightmap.scan.training.files import (
    ScanTrainingProgress,
    read_scan_checkpoint,
    write_row,
)
from saltus.heightmap.scan.training.flights import (
    draw_flight,
    redraw_robots,
)
from saltus.heightmap.scan.training.gradient_limits import GradientLimits
from saltus.heightmap.scan.training.scan_model import ScanModel, scan_loss
from saltus.heightmap.scan.training.seeded_random import SeededRandom
from saltus.heightmap.scan.training.settings import ScanTrainSettings

GROUPS = 4
"""Flights of so many groups of robots begin one after the other, so that every batch has young and
old maps."""
OTHERS, BLOCKS = "others", "blocks"
"""Groups of weights that learn at `learning_rate`, and at `blocks_rate` of it."""
WARM_UP = 0.03
"""Share of a training in which its rate grows."""
NEAR_M = 1.0
"""Cells that are farther than this from the base count half."""
UNSEEN = 0.5
"""Weight of a cell that was never measured, nor any beside it: those are judged as seen, within 3
cm of a hit."""


class ScanTrainer:
    """One training of the scan's network: network, optimiser, mean of weights, and how far it is.

    A round draws all of its flights from the seed and its own number, so that a training that goes
    on from a checkpoint does what one would have done that was not interrupted.
    """

    def __init__(
        self, settings: ScanTrainSettings, device: torch.device, *, compiled: bool = False
    ) -> None:
        self.settings, self.device = settings, device
        torch.manual_seed(settings.seed)
        self.model, self.average = (_new_model(settings, device) for _ in range(2))
        self.average.load_state_dict(self.model.state_dict())
        self._forgets = torch.zeros((), device=device)
        on_gpu = device.type == "cuda"
        groups = _groups(self.model)
        self._rates = {name: torch.zeros((), device=device) for name in groups}
        self.optimiser = torch.optim.AdamW(
            [
                {"name": name, "params": weights, "lr": self._rates[name] if on_gpu else 0.0}
                for name, weights in groups.items()
            ],
            weight_decay=settings.weight_decay, fused=on_gpu, capturable=on_gpu,
        )  # fmt: skip
        self._limits = GradientLimits(self.model)
        self.rounds, self.seconds = 0, 0.0
        self._draws = SeededRandom(settings.seed, device)
        with torch.no_grad():
            self._flight = draw_flight(settings.batch, settings.flight, self._draws)
            self._state = new_map(settings.batch, settings.map, self._flight.ground.height)
        self._totals = torch.zeros(7, device=device)
        self._calls = UpdateCalls.of(self.model, compiled=compiled)
        self._graph: CudaGraph | None = CudaGraph(self._draws, self._update) if on_gpu else None

    @property
    def updates(self) -> int:
        """How many were made."""
        return self.rounds * self.settings.round

    def round(self, share_before: float, share_after: float) -> ScanTrainingProgress:
        """Makes the updates of one round, while the training goes
        from one share of its way to another.
        """
        began = time.monotonic()
        settings = self.settings
        self._draws.begin(settings.seed * 1_000_003 + self.rounds)
        self._renew(torch.arange(settings.batch, device=self.device))
        self._totals.zero_()
        rate = 0.0
        for update in range(settings.round):
            share = share_before + (share_after - share_before) * update / settings.round
            rate = settings.learning_rate * _schedule(share)
            self._set(rate, self.updates + update)
            self._renew_some(update)
            if self._graph is not None:
                self._graph.step()
            else:
                self._update()
        found = (self._totals / settings.round).tolist()
        self.rounds += 1
        self.seconds += time.monotonic() - began
        made = self.updates
        return ScanTrainingProgress(
            update=made, images=made * settings.batch, seconds=self.seconds, loss=found[0],
            map_mm=1e3 * found[1],
            seen_mm=1e3 * found[2], unseen_mm=1e3 * found[3], inside_seen=found[4],
            inside_all=found[5], clipped=found[6], rate=rate,
        )  # fmt: skip

    def _set(self, rate: float, updates: int) -> None:
        """Learning rate, and how much of the mean of weights is forgotten:
        in the beginning more.
        """
        settings = self.settings
        self._forgets.fill_(1.0 - min(settings.average, (1.0 + updates) / (10.0 + updates)))
        for group in self.optimiser.param_groups:
            own = rate * (settings.blocks_rate if group["name"] == BLOCKS else 1.0)
            # A recorded update reads it where it was
            group["lr"] = self._rates[group["name"]].fill_(own) if self._graph is not None else own

    def _renew_some(self, update: int) -> None:
        """New flights for the robots whose time has come."""
        images, batch = self.settings.flight.images, self.settings.batch
        size = -(-batch // GROUPS)
        for group in range(GROUPS):
            due = (
                update
                and group * size < batch
                and (update + group * images // GROUPS) % images == 0
            )
            if due:
                self._renew(
                    torch.arange(group * size, min((group + 1) * size, batch), device=self.device)
                )

    def _renew(self, rows: Tensor) -> None:
        settings = self.settings
        with torch.no_grad():
            redraw_robots(self._flight, rows, draw_flight(len(rows), settings.flight, self._draws))
            redraw_robots(
                self._state, rows, new_map(len(rows), settings.map, self._flight.ground.height)
            )

    def _update(self) -> None:
        """One image of every robot, and one step down.

        All of it in place, so that a GPU can repeat it by itself.
        """
        settings, state = self.settings, self._state
        with torch.no_grad():
            state, inputs, around, truth = next_example(
                self._flight, state, settings, self._draws, self._calls
            )
            known = inputs.measured[:, MEASURED.index("known")]
            # Within 3 cm of a hit: the points that the evaluation calls seen
            seen_cells = functional.max_pool2d(known[:, None], 3, 1, 1)[:, 0] > 0.0
            weight = _weight(state, seen_cells, around, settings.map)
        on_gpu = self.device.type == "cuda"
        with torch.autocast(self.device.type, torch.bfloat16, enabled=on_gpu, cache_enabled=False):
            height, half_width, spread = self._calls.model(*inputs, truth - around.filled)
        estimate = MapHeights(around.filled + height, half_width)
        value = scan_loss(estimate, truth, weight, spread if settings.network.choice else None)
        self.optimiser.zero_grad(set_to_none=True)
        value.backward()
        clipped = self._limits.clip(settings.gradient_norm)
        self.optimiser.step()
        with torch.no_grad():
            for mine, new in zip(self.average.parameters(), self.model.parameters(), strict=True):
                mine.lerp_(new, self._forgets)
            estimate = MapHeights(estimate.height.detach(), estimate.half_width.detach())
            for mine, new in zip(self._state, remember_told(state, estimate), strict=True):
                mine.copy_(new)
            self._totals += torch.nan_to_num(
                torch.cat(
                    (_figures(value.detach(), around.filled, estimate, truth, seen_cells), clipped)
                )
            )

    def begin_with(self, weights: dict[str, Tensor]) -> None:
        """Takes weights in place of those that were drawn.

        What only this network has stays as it was drawn.

        Raises:
            ModelError: they are of a network of other sizes, or of another kind.
        """
        own = self.model.state_dict()
        for name in [name for name in weights if name.startswith("head.") and name in own]:
            rows = len(weights[name])  # outputs that this network has beside those
            if own[name].shape[1:] == weights[name].shape[1:] and rows < len(own[name]):
                weights = {
                    **weights,
                    name: torch.cat((weights[name].to(self.device), own[name][rows:])),
                }
        if (stem := weights.get("stem.weight")) is not None:  # planes that are new count nothing
            new = max(0, own["stem.weight"].shape[1] - stem.shape[1])
            weights = {**weights, "stem.weight": functional.pad(stem, (0, 0, 0, 0, 0, new))}
        added = {name: own[name] for name in own if name.startswith("blocks.")}
        try:
            for model in (self.model, self.average):
                model.load_state_dict({**added, **weights})
        except RuntimeError as error:
            reason = str(error).splitlines()[-1].strip()
            raise ModelError(
                f"the weights to start with do not fit the network of the settings: {reason}"
            ) from error

    def save(self, path: Path) -> None:
        """Writes what `resume` reads, whole or not at all."""
        table = {
            "settings": self.settings.to_toml(), "rounds": self.rounds, "seconds": self.seconds,
            "usual_norm": self._limits.usual_norm,
            "model": self.model.state_dict(), "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }  # fmt: skip
        try:
            with atomic_write(path) as partial:
                torch.save(table, partial)
        except (OSError, RuntimeError) as error:  # torch says RuntimeError where a disk is full
            raise ModelError(f"cannot write {path}: {error}") from error

    def resume(self, path: Path) -> None:
        """Continues from a checkpoint of the same settings.

        Raises:
            ModelError: the file is none, or of another training.
        """
        table = read_scan_checkpoint(path)
        if table["settings"] != self.settings.to_toml():
            raise ModelError(
                f"{path} is of a training with other settings: name another folder with --out"
            )
        try:
            self.model.load_state_dict(table["model"])
            self.average.load_state_dict(table["average"])
        except RuntimeError as error:
            raise ModelError(
                f"{path} is of a network that is shown other planes: name another folder with "
                "--out, and go on from the checkpoint's ONNX file with --start"
            ) from error
        self.optimiser.load_state_dict(table["optimiser"])
        self.rounds, self.seconds = int(table["rounds"]), float(table["seconds"])
        self._limits.usual_norm.copy_(table["usual_norm"])


def _new_model(settings: ScanTrainSettings, device: torch.device) -> ScanModel:
    """In the layout that convolutions in half precision want."""
    model = ScanModel(settings.network, settings.map).to(device)
    return model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def _groups(model: ScanModel) -> dict[str, list[Tensor]]:
    """Weights by how fast they learn."""
    groups: dict[str, list[Tensor]] = {OTHERS: [], BLOCKS: []}
    for name, weight in model.named_parameters():
        groups[BLOCKS if name.startswith("blocks.") else OTHERS].append(weight)
    return {name: weights for name, weights in groups.items() if weights}


def train_scan(
    settings: ScanTrainSettings, folder: Path, *, minutes: float | None = None,
    updates: int | None = None,
    device: torch.device, compiled: bool = False,
    progress: Callable[[ScanTrainingProgress], None] | None = None,
    save_every_s: float = 60.0, start: dict[str, Tensor] | None = None,
) -> ScanModel:  # fmt: skip
    """Trains until time or updates are over.

    Goes on where `folder` has a checkpoint of the same training.

    Without one it begins with `start`, weights by name, or from nothing.

    Returns:
        The mean of the last weights.
    """
    folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / "scan.pt"
    trainer = ScanTrainer(settings, device, compiled=compiled)
    if checkpoint.exists():
        trainer.resume(checkpoint)
    elif start is not None:
        trainer.begin_with(start)
    saved, last = time.monotonic(), 0.0
    while True:
        before, after = _shares(trainer, last, minutes, updates)
        if before >= 1.0 - 1e-9:
            break
        seconds = trainer.seconds
        found = trainer.round(before, after)
        last = trainer.seconds - seconds
        write_row(folder / "scan.csv", found)
        if progress is not None:
            progress(found)
        if time.monotonic() - saved > save_every_s:
            trainer.save(checkpoint)
            saved = time.monotonic()
    trainer.save(checkpoint)
    return trainer.average.eval()


def _shares(
    trainer: ScanTrainer, last_s: float, minutes: float | None, updates: int | None
) -> tuple[float, float]:
    """How much of the way is behind at the beginning of the next round, and at its end."""
    if minutes is not None:
        whole = 60.0 * minutes
        if trainer.seconds + 0.5 * last_s >= whole:
            return 1.0, 1.0
        return trainer.seconds / whole, min(1.0, (trainer.seconds + last_s) / whole)
    whole = float(updates or 0)
    if trainer.updates >= whole:
        return 1.0, 1.0
    return trainer.updates / whole, (trainer.updates + trainer.settings.round) / whole


def _schedule(share: float) -> float:
    """Grows at first, then falls as a cosine; never quite to 0."""
    return min(1.0, (share + 1e-3) / WARM_UP) * (
        0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0)))
    )


def _weight(
    state: ElevationMap, seen_cells: Tensor, around: MapContext, settings: MapSettings
) -> Tensor:
    x, y = cell_centres(state.corner, settings, around.base)
    away = (x - around.base[:, :1, None]) ** 2 + (y - around.base[:, 1:2, None]) ** 2
    near = torch.where(away < NEAR_M**2, 1.0, 0.5)
    return near * torch.where(seen_cells, 1.0, UNSEEN)


def _figures(
    value: Tensor, filled: Tensor, estimate: MapHeights, truth: Tensor, seen_cells: Tensor
) -> Tensor:
    error = (estimate.height - truth).abs()
    inside = (error <= estimate.half_width).float()
    seen = seen_cells.float()
    count = seen.sum()
    return torch.stack(
        (
            value, ((filled - truth).abs() * seen).sum() / count, (error * seen).sum() / count,
            (error * (1.0 - seen)).sum() / (seen.numel() - count),
            (inside * seen).sum() / count, inside.mean(),
        )
    )  # fmt: skip
