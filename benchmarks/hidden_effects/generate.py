"""From a plan to logs and, elsewhere, what is true of them."""

import json
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_effects import sizes
from benchmarks.hidden_effects.damage import damage
from benchmarks.hidden_effects.plan import Run
from benchmarks.hidden_effects.scene import Scene, Setting
from benchmarks.hidden_effects.stage import Stage, make_stage
from benchmarks.hidden_effects.tables import write

OUTSIDE_PART = 0.5
"""Least part of an outside effect's energy that no mixture of the library's effects may explain."""
WILD, FAINT = 3.0, 0.7
"""Residual in parts of a proportional one, from which a size is not used, and up to which, outside
the library."""
DRAWS = 6
"""How often an effect is drawn anew when it cannot be seen, or when the library explains it."""


def generate(runs: tuple[Run, ...], logs: Path, truth: Path, *, tuning: bool, jobs: int) -> None:
    """Writes the runs that are not there yet."""
    truth.mkdir(parents=True, exist_ok=True)
    open_ = [run for run in runs if not (truth / f"{run.name}.json").exists()]
    print(f"{len(runs) - len(open_)} of {len(runs)} runs are there", flush=True)
    with ProcessPoolExecutor(jobs) as pool:
        futures = [pool.submit(generate_run, run, logs, truth, tuning) for run in open_]
        try:
            for number, future in enumerate(
                as_completed(futures), start=len(runs) - len(open_) + 1
            ):
                print(f"{number}/{len(runs)} {future.result()}", flush=True)
        finally:  # who is interrupted waits for the runs that are being made, not for all
            pool.shutdown(wait=False, cancel_futures=True)


def generate_run(run: Run, logs: Path, truth: Path, tuning: bool) -> str:
    """Writes one log and its truth; the truth comes last, as a mark that the run is whole."""
    rng = np.random.default_rng(run.seed)
    stage = make_stage(run, tuning)
    settings, findings = _hide(run, stage, rng)
    files = stage.record(settings, rng)
    said = damage(files, run.damage, rng) if run.damage else ""
    write(files, logs / run.name)
    record: dict[str, Any] = {
        "name": run.name,
        "kind": run.kind,
        "category": run.category,
        "quiet": run.quiet,
        "damage": run.damage,
        "damage_in_words": said,
        "tuning": tuning,
        "run": asdict(run),
        "settings": [asdict(setting) for setting in settings],
        "effects": [
            {
                "name": setting.effect,
                "where": list(setting.where),
                "params": stage.scene.parameters(setting),
                "params_at": stage.scene.parameters_at(setting),
                "size": setting.size,
            }
            for setting in settings
        ],
        **findings,
    }
    truth.mkdir(parents=True, exist_ok=True)
    (truth / f"{run.name}.json").write_text(json.dumps(record, indent=1), encoding="utf-8")
    return run.name


def _hide(
    run: Run, stage: Stage, rng: np.random.Generator
) -> tuple[tuple[Setting, ...], dict[str, Any]]:
    """Draws the effects of a run and their sizes, and finds out what they could be taken for."""
    scene = stage.scene
    settings = tuple(_draw(run, stage, effect, rng) for effect in run.effects)
    if (
        run.category == "two" and rng.uniform() < 0.5
    ):  # confusable only where they sit at the same joints
        settings = (settings[0], Setting(**{**vars(settings[1]), "where": settings[0].where}))
    found = sizes.one_sigma(stage.sizing, list(settings)) if settings else []
    kept, shown = [], []
    for number, (setting, sigma, multiple) in enumerate(
        zip(settings, found, run.multiples, strict=True)
    ):
        size = run.sizes[number] if run.sizes else min(multiple * sigma, scene.largest(setting))
        kept.append(setting.sized(size))
        base, with_it = scene.respond([(), (kept[-1],)])
        shown.append(sizes.best_rms(scene, sizes.visible(scene, with_it - base), setting.where))
    extra: dict[str, Any] = {
        "one_sigma_of_effects": [sigma if np.isfinite(sigma) else None for sigma in found],
        "multiples": [
            s.size / sigma if np.isfinite(sigma) else 0.0
            for s, sigma in zip(kept, found, strict=True)
        ],
        "shown_rms": shown,
    }
    if run.category != "damaged":
        where = kept[0].where if kept else stage.anywhere(rng)
        extra |= _rivals(run, scene, tuple(kept), where)
    return tuple(kept), extra


def _draw(run: Run, stage: Stage, effect: str, rng: np.random.Generator) -> Setting:
    """Draws an effect until it can be seen, and, where it is outside the library,
    until the library cannot have it.
    """
    for _ in range(DRAWS):
        setting = stage.scene.draw(effect, stage.where(effect, rng), rng)
        if run.sizes:
            return setting
        sigma = sizes.one_sigma(stage.sizing, [setting], sizes.ROUGH)[0]
        multiple = run.multiples[run.effects.index(effect)]
        setting = setting.sized(min(sigma, stage.scene.largest(setting)))
        if not multiple * sigma <= stage.scene.largest(setting):
            continue
        part = _part_of_proportional(stage.sizing, setting, sigma, multiple)
        if part > WILD or (run.category == "outside" and part < FAINT):
            continue
        if (
            run.category == "outside"
            and _unexplained(stage.scene, setting.sized(sigma), run.seed) < OUTSIDE_PART
        ):
            continue
        return setting
    return setting


def _part_of_proportional(scene: Scene, setting: Setting, sigma: float, multiple: float) -> float:
    """Residual in parts of that which grows with the size:
    large where it makes a position loop swing.
    """
    base, one, several = scene.respond(
        [(), (setting.sized(sigma),), (setting.sized(sigma * multiple),)]
    )
    first = max(sizes.best_rms(scene, one - base, setting.where), 1.0)
    return sizes.best_rms(scene, several - base, setting.where) / (multiple * first)


def _library(scene: Scene, where: tuple[str, ...], seed: int) -> list[Setting]:
    """Every effect of the library at one sigma, at the same place; twice where it has a shape."""
    rng = np.random.default_rng(seed)
    settings = []
    for effect in scene.library:
        first = scene.draw(effect, scene.place(effect, where), rng)
        settings.append(first)
        if set(first.shape) - {"sign"}:
            settings.append(scene.draw(effect, first.where, rng))
    found = sizes.one_sigma(scene, settings, sizes.ROUGH, scene.sizing_rounds)
    return [
        setting.sized(min(sigma, scene.largest(setting)))
        for setting, sigma in zip(settings, found, strict=True)
    ]


def _unexplained(scene: Scene, setting: Setting, seed: int) -> float:
    marks = sizes.signatures(scene, [setting, *_library(scene, setting.where, seed)])
    return sizes.outside_of(marks[0], marks[1:])


def _rivals(
    run: Run, scene: Scene, settings: tuple[Setting, ...], where: tuple[str, ...]
) -> dict[str, Any]:
    """One-sigma sizes of the whole library in this log,
    and for each hidden effect the |cos| with every other.
    """
    library = _library(scene, where, run.seed)
    at_one = [s.sized(s.size / max(m, 1.0)) for s, m in zip(settings, run.multiples, strict=True)]
    marks = sizes.signatures(scene, [*at_one, *library])
    own, others = marks[: len(settings)], marks[len(settings) :]
    names = [setting.effect for setting in library]
    rivals: list[dict[str, float]] = []
    for number, setting in enumerate(settings):
        beside = np.delete(own, number, axis=0)
        cosines = sizes.nearest(own[number], others, beside)
        together = {
            other.effect: float(sizes.nearest(own[number], own[[i]])[0])
            for i, other in enumerate(settings)
            if i != number
        }
        table: dict[str, float] = {}
        for name, cosine in zip(names, cosines, strict=True):
            if name != setting.effect and name not in together:
                table[name] = max(table.get(name, 0.0), float(cosine))
        rivals.append({**table, **together})
    return {
        "rivals": rivals,
        "one_sigma": {s.effect: s.size if s.size < scene.largest(s) else None for s in library},
        "outside_part": [sizes.outside_of(mark, others) for mark in own]
        if run.category == "outside"
        else [],
    }
