"""All stages of a cycle in their order; what is done is not repeated."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from saltus import gpu
from saltus.files import write_whole
from saltus.real2sim.cycle import choosing, finding, measuring, remote_training, training, trials
from saltus.real2sim.cycle.folder import MODELS, CycleFolder
from saltus.real2sim.cycle.report import training_results, write_cycle_report
from saltus.real2sim.cycle.settings import CycleSettings
from saltus.real2sim.reporting.verdict_text import verdict_sentence
from saltus.used_networks import ModelKind

NO_GPU = "as shipped: there was no GPU to train it on"
CAMERA_ALONE = "as shipped: only the camera differs, and a policy sees no images"
NOTHING_FOUND = "nothing was found that could be added: models are trained for what was known"


class CycleObserver(Protocol):
    """Is told how far a cycle is."""

    def say(self, line: str) -> None:
        """Says what came of a stage."""
        ...

    def at(self, stage: str, share: float) -> None:
        """Share of a stage that is done."""
        ...


@dataclass(frozen=True, kw_only=True)
class CycleRun:
    """One cycle of log, find, train and measure, in its folder."""

    folder: CycleFolder
    settings: CycleSettings
    observer: CycleObserver

    def run(self, export: Path | None = None, take: Path | None = None) -> None:
        """Runs what is still missing and writes the report.

        Args:
            export: Folder to write the training into, which is then left to another machine.
            take: Such a folder, with the models that were trained there.

        Raises:
            SaltusError: a stage cannot be done; what was done before is kept.
        """
        self._find()
        if export is not None:
            remote_training.export_training(self.folder, self.settings, export)
            self.observer.say(f"training is left to another machine: {export / 'README.md'}")
        else:
            self._train(take)
            self._choose()
            self._measure()
        write_cycle_report(self.folder, self.settings)

    def _find(self) -> None:
        if self.folder.profile.exists():
            self.observer.say("logs and search: done before")
            return
        logs = finding.record_logs(self.folder, self.settings, self.observer.at)
        self.observer.say(f"logs: {', '.join(log.name for log in logs)}")
        found, again = finding.find_effects(self.folder, self.settings, logs, self.observer.at)
        known, patched = (
            self.folder.read(file) for file in (self.folder.known, self.folder.profile)
        )
        self.observer.say(f"found: {verdict_sentence(found.verdict, known)}")
        for line in finding.not_applied(self.folder):
            self.observer.say(line)
        with_it = (
            None
            if again is None
            else f"with what was found: {verdict_sentence(again.verdict, patched)}"
        )
        self.observer.say(with_it or NOTHING_FOUND)

    def _collect(self) -> None:
        if not self.folder.dataset.exists():
            training.collect_data(self.folder, self.settings, self.observer.at)
            self.observer.say(f"training data: {self.folder.dataset}")

    def _train(self, take: Path | None) -> None:
        if take is not None:
            taken = remote_training.take_training(self.folder, self.settings, take)
            before = training_results(self.folder) or dict.fromkeys(MODELS, "as shipped")
            self._trained(before | dict.fromkeys(taken, "trained elsewhere"))
        elif self.folder.trained.exists():
            self.observer.say("training: done before")
        else:
            left = self._policy_is_left()
            if left is None:
                training.train_policy(self.folder, self.settings)
            self._collect()
            training.train_predictor(self.folder, self.settings, self.observer.at)
            self._trained({"heightmap": "trained here", "policy": left or "trained here"})

    def _policy_is_left(self) -> str | None:
        """Why the policy stays as shipped; None where it is trained."""
        if not training.differs_beyond_camera(self.folder):
            return CAMERA_ALONE
        return None if gpu.has_gpu() else NO_GPU

    def _trained(self, became: dict[ModelKind, str]) -> None:
        write_whole(self.folder.trained, json.dumps(became), synced=True)
        for kind, what in became.items():
            self.observer.say(f"{kind} model: {what}")

    def _choose(self) -> None:
        finds_drives = choosing.finds_drives(self.folder)
        if all(self.folder.model(kind) is None for kind in MODELS) and not finds_drives:
            return
        choice = choosing.choose(self.folder, self.settings, self.observer.at)
        for kind in MODELS:
            if str(kind) in choice.models:
                self.observer.say(f"{kind} model: {choosing.choice_text(choice, kind)}")
        if finds_drives:
            self.observer.say(
                f"drives: {'made up for' if choosing.DRIVES in choice.best else choosing.LEFT}"
            )

    def _measure(self) -> None:
        if not self.folder.hidden.exists():
            self.observer.say(measuring.NOT_MEASURED)
            return
        for course in trials.COURSES:
            said = []
            for when in measuring.MOMENTS:
                done = measuring.measure(self.folder, self.settings, when, course, self.observer.at)
                said.append(f"{done.successes} of {len(done.failures)} {when}")
            self.observer.say(f"{course}: {', '.join(said)}")
