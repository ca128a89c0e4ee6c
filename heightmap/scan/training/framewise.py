"""The rival that others build: a network on each image alone,
whose heights are fused by their half-widths.

As in AME-2 (arXiv 2601.08485): what is told anew takes a cell over where it is surer than what is
kept, which gets less sure with time. The pose is corrected as that of the best classical map.
"""

from dataclasses import replace

from saltus.arrays import Array, namespace
from saltus.heightmap.scan.cells import move_window
from saltus.heightmap.scan.elevation import (
    WIDEST,
    ElevationMap,
    MapContext,
    MapUpdate,
    advance_map,
    new_map,
)
from saltus.heightmap.scan.network_inputs import MapHeights, ScanInputs, inputs_of
from saltus.heightmap.scan.settings import MapSettings


def of_image(
    state: ElevationMap, measured: MapUpdate, now_s: Array, settings: MapSettings
) -> tuple[ElevationMap, ScanInputs, MapContext]:
    """Returns what would be known and shown had this image been the first,
    at the pose that `state` has corrected.
    """
    blank = new_map(len(now_s), settings, state.height)._replace(correction=state.correction)
    alone, around = advance_map(blank, measured, replace(settings, matching=False, foot_gain=0.0))
    return alone, inputs_of(alone, around, now_s, measured), around


def heights_kept(
    state: ElevationMap,
    corner: Array,
    told: MapHeights,
    images_apart_s: Array,
    settings: MapSettings,
) -> MapHeights:
    """Heights of all images in the window of `state`,
    which holds in `told` those of the images before.

    `told` is of the last image, in the window that begins at `corner`; `images_apart_s` has shape
    (batch,).
    """
    xp = namespace(told.height)
    by = (state.corner - corner) * settings.sub
    height, width = move_window(told.height, by, 0.0), move_window(told.half_width, by, WIDEST)
    older = (state.told_width**2 + (settings.drift * images_apart_s[:, None, None]) ** 2) ** 0.5
    surer = width < older
    return MapHeights(xp.where(surer, height, state.told), xp.where(surer, width, older))
