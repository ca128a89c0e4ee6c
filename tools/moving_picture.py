"""Makes the moving picture of the README out of the video of a run.

saltus demo --terrain stairs --seed 1 --out runs/readme
python tools/moving_picture.py runs/readme/video.mp4 docs/images/demo.webp
"""

import argparse
from pathlib import Path

import cv2

RATE_HZ = 15.0
WIDTH = 800  # [px]: numbers can be read
QUALITY = 25  # of WebP: edges stay sharp, and a run of seven seconds takes under 0.7 MB


def main() -> None:
    """Writes frames of the video, smaller, as an animation that repeats."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("video", type=Path)
    parser.add_argument("picture", type=Path, help="a .webp")
    arguments = parser.parse_args()
    video = cv2.VideoCapture(str(arguments.video))
    stride = max(1, round(video.get(cv2.CAP_PROP_FPS) / RATE_HZ))
    frames = []
    while (read := video.read())[0]:
        frames.append(read[1])
    animation = cv2.Animation()
    kept = frames[::stride]
    height = round(WIDTH * kept[0].shape[0] / kept[0].shape[1])
    animation.frames = [
        cv2.resize(frame, (WIDTH, height), interpolation=cv2.INTER_AREA) for frame in kept
    ]
    animation.durations = [round(1000.0 * stride / video.get(cv2.CAP_PROP_FPS))] * len(kept)
    cv2.imwriteanimation(str(arguments.picture), animation, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])


if __name__ == "__main__":
    main()
