"""The morphology of the stereo camera on torch, which is kornia's.

All else of it is one law with numpy.

On a GPU no step waits for a value: shapes and the number of operations depend on the size of the
images only.
"""

from dataclasses import dataclass

import torch
from kornia.morphology import dilation, erosion


@dataclass(frozen=True)
class KorniaWindows:
    """`saltus.render.stereo.image.Morphology` for images of three dimensions.

    Only extremes come from kornia: its moving averages (`box_blur`), which are convolutions on a
    CPU, take 8 to 49 times as long there as sums over windows of 1, 2, 4, ... samples.
    """

    def any_around(self, mask: torch.Tensor, rows: int, columns: int) -> torch.Tensor:
        """See there; along rows, then along columns."""
        image = mask[:, None].to(torch.float16)  # 0 and 1 are exact in it
        for shape in ((2 * rows + 1, 1), (1, 2 * columns + 1)):
            if max(shape) > 1:
                image = dilation(image, torch.ones(shape, dtype=image.dtype, device=image.device))
        return image[:, 0] > 0.0

    def range_around(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See there."""
        around = torch.ones((3, 3), dtype=values.dtype, device=values.device)
        return erosion(values[:, None], around)[:, 0], dilation(values[:, None], around)[:, 0]
