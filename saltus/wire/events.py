"""The codes of events: who sends them, and what they say. What the details say is for people."""

from saltus.wire.messages import ControllerMode, HeightmapStatus

CODES: dict[str, tuple[str, str]] = {
    "process_ready": (
        "supervisor",
        "a process works; the first time, and each time that it has started again",
    ),
    "process_died": ("supervisor", "a process has died, or gave no sign of life and was killed"),
    "no_spare": (
        "supervisor",
        "a process that would take over from one that dies cannot be started; tried again",
    ),
    "too_slow": ("supervisor", "the computer does not keep up with the run's clock"),
    "recording_failed": (
        "supervisor",
        "nothing more can be recorded, as where a disk is full; the robot lands",
    ),
    "error": ("every process", "it ends with this error"),
    "depth_lost": ("heightmap", "images are too old for heights"),
    **{
        f"heightmap_{status.name.lower()}": (
            "heightmap",
            f"heights have this status now: {status.name}",
        )
        for status in HeightmapStatus
    },
    "heightmap_invalid": (
        "heightmap, policy",
        "heights are INVALID now; the policy says so when it stops the robot",
    ),
    "states_refused": (
        "heightmap",
        "states are not answered while their time is not that of this computer",
    ),
    "model_accepted": ("heightmap", "a model that was given at run time is sound, and warms up"),
    "model_swapped": ("heightmap", "that model answers from now on"),
    "model_refused": ("heightmap", "that model is not used"),
    "heightmap_grid": (
        "policy",
        "heights come on another grid than that of the run: they are not used",
    ),
    "heightmap_lost": (
        "policy",
        "no heights came, or old ones: it stops the robot, or makes a walking one stand",
    ),
    "plan_lost": ("controller", "the newest plan is too old"),
    "plan_back": ("controller", "plans come in time again"),
    **{
        f"mode_{mode.name.lower()}": (
            "controller",
            f"the leg controller is in this mode now: {mode.name}",
        )
        for mode in ControllerMode
    },
    "robot_lost": (
        "controller",
        "a robot over DDS is given up, and damped or landed; the detail says why",
    ),
    "finished": ("controller", "the robot is at the end of its course"),
    "fell": ("controller", "the trial has failed: trunk on the ground, or not upright"),
    "timeout": ("controller", "the trial has failed: its time is over"),
    "stop": ("operator", "asks the supervisor to let the robot land and to end the run"),
    "kill": ("operator", "asks the supervisor to kill the process that the detail names"),
    "blind": ("operator", "asks the camera to see nothing for so many seconds"),
    "push": (
        "operator",
        "asks the controller of a simulated robot to push it, to the left by so many Ns",
    ),
}
"""Code of an event, its senders and its meaning; the operator's under `event/operator`."""
