"""The fast way to what the model sees: a few rays for each of its pixels instead of the 25 of the sensor."""

from typing import Any

from saltus.arrays import namespace
from saltus.depth import MODEL_CAMERA, VALID_SHARE, Intrinsics


def sampled_model_camera(rows: int, columns: int) -> Intrinsics:
    """The model's camera with `rows` times `columns` samples for each of its pixels."""
    model = MODEL_CAMERA
    return Intrinsics(
        width=model.width * columns,
        height=model.height * rows,
        fx=model.fx * columns,
        fy=model.fy * rows,
        cx=model.cx * columns,
        cy=model.cy * rows,
    )


def pooled(depth: Any, rows: int, columns: int) -> Any:
    """Averages the valid samples of each pixel of the model.

    Args:
        depth: [m], 0 where invalid, shape (..., 48 rows, 16 columns).
        rows: samples for each pixel.
        columns: samples for each pixel.

    Returns:
        Depth [m], 0 where fewer than half of the samples are valid, shape (..., 48, 16); see
        `saltus.depth.model_images`.
    """
    xp = namespace(depth)
    shape = (*depth.shape[:-2], depth.shape[-2] // rows, rows, depth.shape[-1] // columns, columns)
    parts = xp.reshape(depth, shape)
    samples = [parts[..., i, :, k] for i in range(rows) for k in range(columns)]
    total, count = samples[0], xp.astype(samples[0] > 0.0, depth.dtype)
    for sample in samples[1:]:
        total = total + sample
        count = count + xp.astype(sample > 0.0, depth.dtype)
    mean = total / xp.clip(count, min=1.0)
    return xp.where(count >= VALID_SHARE * len(samples), mean, xp.zeros_like(mean))
