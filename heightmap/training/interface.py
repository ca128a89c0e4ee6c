"""The part of a model's card from which alone others can feed it."""

from dataclasses import asdict

from saltus.depth import MODEL_CAMERA, RANGE_M
from saltus.depth_camera import DepthCamera
from saltus.effects.image_delivery import CameraLatency
from saltus.grid import HeightGrid
from saltus.heightmap.data.delivery import TRAINING, ImageDeliveryModel
from saltus.heightmap.service.proprioception_vector import PROPRIOCEPTION
from saltus.robots.robot import Robot
from saltus.wire.topics import depth_topic

_FRAMES = """\
**Frames.** Base: origin at the centre of the trunk, x ahead, y to the left, z up. World: z up. R = Rz(yaw) Ry(pitch)
Rx(roll) turns the base into the world; nose down is a positive pitch. Yaw frame: origin at the base, axes of the world
turned by the yaw. Legs are in the order FR, FL, RR, RL, each with the joints hip, thigh, calf.

**Feet** are the centres of the spheres at the ends of the legs. With joint angles a, b, c [rad], all 0 where a leg
hangs straight down, and d = {thigh:g} cos b + {calf:g} cos(b + c) [m], a foot is in the base frame, from its hip, at

    x = -{thigh:g} sin b - {calf:g} sin(b + c)
    y = s cos a + d sin a
    z = s sin a - d cos a

Front hips are at x = {hip_x:g} m, rear hips at -{hip_x:g}; left hips at y = {hip_y:g} m, with s = {side:g};
right hips at -{hip_y:g}, with s = -{side:g}; all at z = 0.
"""
_INTERFACE = """\
## Inputs and outputs

One call is one tick of 10 ms, at the time of one reading of the robot. All arrays are float32; their first dimension is
that of robots. Units are SI. The file normalises its inputs itself: do not apply the metadata `normalisation` again.

| input | shape | |
|---|---|---|
| `image` | 2, 48, 16 | the image in use: depth, then which pixels are valid; see *Image* |
| `age` | | time from the taking of that image to now [s]; infinite before the first |
| `new` | | 1 in the first tick that uses the image, else 0 |
| `proprioception` | {features} | see *Proprioception* |
| `hidden` | {hidden} | `hidden_out` of the tick before; zeros at the first, and where an image \
comes that was taken more than 0.13 s after the one before |

| output | shape | |
|---|---|---|
| `height` | {points} | terrain minus base [m] at {points} points of the yaw frame: y = 0, x evenly from \
{first_x:g} to {last_x:g} m \
(metadata `grid_m`) |
| `std` | {points} | 1.645 times this is half of the 90 % interval of `height` [m] |
| `hidden_out` | {hidden} | `hidden` of the next tick |

Heights are to be relied on when `hidden` has seen as many images as the metadata `warmup_frames` says.

{frames}
### Proprioception

| entries | |
|---|---|
| 0, 1 | roll and pitch [rad] |
| 2 to 9 | x and z of each foot, yaw frame [m]; 0 and 0 of a leg that is not trusted |
| 10 to 13 | 1 for each leg that is trusted, else 0. Trusted are all legs of a standing robot, \
and later those in the middle half of their scheduled stance; a leg that is wrongly trusted misleads, none at all is \
allowed |
| 14 to 16 | velocity of the base, yaw frame [m/s] |
| 17 to 19 | angular velocity of the base, yaw frame [rad/s] |
| 20 | height of the base above the soles of the feet that are trusted [m], {sole:g} m below their centres; \
while none is, carried on by the velocity upwards |

### Image

The camera sits at ({mount}) m of the base frame and looks ahead, {pitch:g} rad nose down. It is
{width} pixels wide and {height} high, rows from the top. Pixel (u, v) reaches from (u, v) to (u + 1, v + 1) in the
image plane, whose point (p, q) lies in the direction ((p - {cx:g}) / f, (q - {cy:g}) / f, 1): right, down, along the
optical axis; f = {fx:.6f}.

An image of another size from the same place, with focal lengths F, G and a centre (C, D) that count from the corner of
the first pixel (ROS counts from its centre: add 0.5), is pooled: pixel (u, v) covers C + (u - {cx:g}) F / f to
C + (u + 1 - {cx:g}) F / f of its columns, D + (v - {cy:g}) G / f to D + (v + 1 - {cy:g}) G / f of its rows.

- Depth is along the optical axis, divided by {range:g} m and cut to at most 1 before any mean is taken. A source pixel
  that sees nothing within range has 1; one without a measurement is invalid, as is what lies outside of the source.
- A pixel has the mean of the valid part of what it covers, weighted by area, and is valid (second layer 1) where that
  is at least half of its area. Else it has depth 1 and 0 in the second layer. So has all before the first image.
- An image that was taken before the one in use or is older than {ignored:g} s is ignored; so is one more than 80 % of
  which is invalid. The image before it stays in use, with the age that it has, and is not new again.
- It was trained with images at {rate:g} Hz that come {soonest:.0f} to {latest:.0f} ms after they were taken.
"""


def frames_and_feet(robot: Robot) -> str:
    """Returns what a card says of the frames, and of where the feet of the robot are."""
    x, y, _ = robot.hip_anchor[1]
    side = robot.abduction_offset[1]
    return _FRAMES.format(
        thigh=robot.thigh_length, calf=robot.calf_length, hip_x=x, hip_y=y, side=side
    )


def model_interface(
    robot: Robot,
    grid: HeightGrid,
    camera: DepthCamera,
    latency: CameraLatency,
    hidden: int,
    trained: ImageDeliveryModel = TRAINING,
) -> str:
    """Returns what the card of a model, with so many entries of hidden state,
    says of its inputs and outputs.
    """
    soonest_s, latest_s = trained.range_s(latency)
    return _INTERFACE.format(
        features=len(PROPRIOCEPTION),
        points=grid.size,
        first_x=grid.x[0],
        last_x=grid.x[-1],
        hidden=hidden,
        frames=frames_and_feet(robot),
        mount=", ".join(f"{value:g}" for value in robot.camera_position),
        pitch=robot.camera_pitch,
        range=RANGE_M,
        rate=camera.rate_hz,
        sole=robot.foot_radius,
        ignored=depth_topic(float(latency.latency)).invalid_age_s,
        soonest=1e3 * soonest_s,
        latest=1e3 * latest_s,
        **asdict(MODEL_CAMERA),
    )
