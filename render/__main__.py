"""The camera process: python -m saltus.render --run-dir DIR --endpoint ENDPOINT."""

import sys
from dataclasses import replace

import numpy as np

from saltus.effects.image_pixels import to_images
from saltus.render.backends import make_renderer
from saltus.render.camera import RobotCamera
from saltus.render.exposure import Exposure, PerfectExposure, StereoExposure
from saltus.render.process import CameraProcess, random_stream
from saltus.runtime.process import ProcessContext, run_process
from saltus.wire.bus import Bus
from saltus.wire.messages import OPERATOR, DepthFrame, Done, GroundTruth
from saltus.wire.topics import staleness_of

WAIT_S = 0.1  # how often an idle process gives proof of life
NOTHING_DUE = -1
LONGEST_COVER_S = 60.0  # a run of the demo takes 20


class LensCover:
    """A cover that an operator lays over the lens: "blind",
    for the run's seconds that its detail names.
    """

    def __init__(self, bus: Bus) -> None:
        self._events = bus.latest("event", OPERATOR)
        self._until_ns = -1

    def over(self, frame: DepthFrame, now_ns: int) -> DepthFrame:
        """The image, all of it invalid while the lens is covered."""
        sample = self._events.take()
        if sample is not None and sample.message.code == "blind":
            self._until_ns = now_ns + round(1e9 * _seconds(sample.message.detail))
        return (
            replace(frame, depth=np.zeros_like(frame.depth)) if now_ns < self._until_ns else frame
        )


def _seconds(text: str) -> float:
    """A time that somebody has typed, at most `LONGEST_COVER_S`; 0 where it is none."""
    try:
        seconds = float(text)
    except ValueError:
        return 0.0
    return min(seconds, LONGEST_COVER_S) if seconds > 0.0 else 0.0


def build(context: ProcessContext) -> CameraProcess:
    """The camera of a run."""
    config, setup = context.config, context.setup
    camera, profile = setup.camera, setup.hardware
    exposure: Exposure
    if camera.ideal:
        view = RobotCamera.on(setup.robot, camera.image).moved(profile.view_chain)
        exposure = PerfectExposure(
            make_renderer(config.renderer, setup.terrain, view), camera.image
        )
    else:
        exposure = StereoExposure(
            setup.terrain,
            setup.robot,
            camera,
            random_stream(config.seed),
            profile.view_chain,
            config.renderer,
        )
    return CameraProcess(
        camera,
        exposure,
        to_images(profile, camera.image.fx).camera_chain,
        random_stream(config.seed),
    )


def warmed_camera(context: ProcessContext) -> CameraProcess:
    """The camera of a run, after an image of the robot in its stand pose that nobody gets.

    The first image of a process takes 0.14 s of processor time where another one takes 5 ms, and
    0.3 to 0.4 s beside busy programs: 7 to 20 images of the run would be lost meanwhile.
    """
    robot, terrain, x = context.setup.robot, context.setup.terrain, context.setup.trial.position_x
    base_z = float(terrain.height_at(np.asarray(x), np.asarray(0.0))) + robot.stand_height
    standing = GroundTruth(
        time_ns=0, step=0, position_base_in_world=np.array([x, 0.0, base_z]),
        quaternion_base_in_world=np.array([1.0, 0.0, 0.0, 0.0]),
        velocity_base_in_world=np.zeros(3), angular_velocity_base=np.zeros(3),
        joint_position=robot.stand_pose, foot_force=np.zeros(4), x=np.zeros(0), height=np.zeros(0),
    )  # fmt: skip
    build(context).step(standing, 0)
    return build(context)


def body(context: ProcessContext) -> None:
    """Wires the camera to the bus."""
    if context.config.pace == "lockstep":
        run_lockstep(context, build(context))
    else:
        run_realtime(context, warmed_camera(context))


def run_lockstep(context: ProcessContext, camera: CameraProcess) -> None:
    """Answers every step of the plant; a step that is asked again gets its frame again."""
    truths = context.bus.latest("plant/truth")
    frames = context.bus.publisher("camera/depth")
    done = context.bus.publisher("done", context.name)
    cover = LensCover(context.bus)
    context.ready()
    last_step = -1
    while not context.stopped:
        context.beat(ticks=camera.exposures, overruns=camera.overruns)
        sample = truths.wait(timeout_s=WAIT_S)
        if sample is None:
            continue
        truth = sample.message
        context.clock.set(truth.time_ns)
        frame = camera.step(truth, truth.time_ns) if truth.step > last_step else camera.due
        last_step = max(last_step, truth.step)
        if frame is not None:
            frames.put(cover.over(frame, truth.time_ns))
        frame_id = NOTHING_DUE if camera.due is None else camera.due.frame_id
        done.put(
            Done(time_ns=truth.time_ns, step=truth.step, process=context.name, frame_id=frame_id)
        )


def run_realtime(context: ProcessContext, camera: CameraProcess) -> None:
    """Exposes on the newest truth and publishes by the clock."""
    # Truth is routed to a spare, which waits in `ready`, but does not wake it
    context.bus.latest("plant/truth", rings=False)
    frames = context.bus.publisher("camera/depth")
    cover = LensCover(context.bus)
    context.ready()
    truths = context.bus.latest("plant/truth")
    while not context.stopped:
        context.beat(ticks=camera.exposures, overruns=camera.overruns)
        sample = truths.wait(context.clock.machine_s(camera.wait_s(context.clock.now_ns(), WAIT_S)))
        now_ns = context.clock.now_ns()
        truth = None
        if sample is not None and staleness_of(truths.topic, sample.message.time_ns, now_ns).usable:
            truth = sample.message
        frame = camera.step(truth, now_ns)
        if frame is not None:
            frames.put(cover.over(frame, now_ns))


if __name__ == "__main__":
    sys.exit(run_process("render", body))
