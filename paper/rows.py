"""Every table, figure and claim of the paper's experiments:
what it shows, its numbers, and how Saltus makes it.

Paper: "Agile Continuous Jumping in Discontinuous Terrains". What it shows is said in words of our
    own. Each number says
where it was measured; a number that the paper gives in a picture only is not repeated.
"""

from dataclasses import dataclass
from typing import Literal, get_args

Source = Literal["real robot", "simulation", "hardware test", "other robots"]
"""Where a number of the paper was measured; "other robots": cited there from other papers."""
SOURCES: tuple[Source, ...] = get_args(Source)
Needs = Literal["nothing", "a trained ablation", "cited only"]
ABLATION: Needs = "a trained ablation"
NEEDS: tuple[Needs, ...] = get_args(Needs)
_UNTRAINED = (
    "Needs its own training, and that of the full system beside it: saltus paper train NAME (GPU)."
)


@dataclass(frozen=True, kw_only=True)
class Number:
    """A number of the paper, and which of ours stands beside it."""

    what: str
    paper: str
    source: Source
    ours: str = ""
    """Place among the numbers of the row, with dots; empty where there is none to compare."""
    unit: str = ""
    """Unit of ours."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One table, figure or claim."""

    name: str
    where: str
    """In the paper."""
    shows: str
    """Result of the paper, in one line."""
    needs: Needs = "nothing"
    make: str = ""
    """Module and function that make it; of an ablation nothing, all are measured alike."""
    numbers: tuple[Number, ...] = ()
    trial: str = ""
    """How ours was measured, where that is not how the paper's was."""
    differs: str = ""
    """Where ours disagrees with the paper, and why.

    Of a row that cannot be made, what is missing.
    """

    @property
    def missing(self) -> str:
        """Words for what is missing where the row is not made."""
        return _UNTRAINED if self.needs == ABLATION else self.differs


_SIMULATED = (
    "ours: MuJoCo, shipped policy and predictor, late images of a D435i with its errors, "
    "what trials draw"
)
_TRAINED = (
    "ours: MuJoCo, policies of 250 million steps, shipped predictor, "
    "late images of a D435i with its errors"
)
_ALL = (
    "ours: MuJoCo, what was trained for the row of each system, "
    "late images of a D435i with its errors"
)
_SEEING = (
    "ours: MuJoCo, a policy of 250 million steps, networks of the same data, late images of a D435i"
)


def _on_stairs(system: str, simulation: str, robot: str) -> tuple[Number, Number]:
    """Steps before failure, as the paper says of its simulation and its robot, beside ours."""
    return (
        Number(what="mean steps of 14 before failure", paper=simulation, source="simulation",
               ours=f"{system}.simulation.steps"),
        Number(what="the same; ours on a simulated stand-in", paper=robot, source="real robot",
               ours=f"{system}.simulated stand-in.steps"),
    )  # fmt: skip


ROWS: tuple[Row, ...] = (
    Row(
        name="terrains", where="Fig. 3", make="motion.terrains",
        shows="Training has four kinds of terrain, stairs, stepping stones, one step, one gap, "
              "from easy to hard.",
        differs="The paper shows pictures without sizes: "
                "how sizes grow with difficulty is our choice.",
    ),
    Row(
        name="gait", where="Fig. 4", make="motion.gait", trial=_SIMULATED,
        shows="The robot bounds: front feet, flight, rear feet, flight, in this order.",
    ),
    Row(
        name="tracking", where="Fig. 5", make="motion.tracking", trial=_SIMULATED,
        shows="Feedback on joint velocities makes the body follow the angular velocity "
              "that is asked for.",
        differs="The paper shows curves without an error; "
                "ours are of the learned policy on 14 stairs.",
    ),
    Row(
        name="torque-saturation", where="Fig. 6a", make="sysid.torque_saturation",
        shows="A dynamometer measures less torque than is commanded, from a few Nm on.",
        numbers=(
            Number(
                what="delivered by a calf of which 35 Nm are asked",
                paper="25.68 Nm (authors' table)",
                source="hardware test", ours="delivered_at_35_nm.found", unit="Nm",
            ),
        ),
        trial="ours: that table hidden in a simulated robot and found in its log, "
              "not measured again",
    ),
    Row(
        name="camera-latency", where="Fig. 6b", make="sysid.camera_latency",
        shows="The body heaves; its height in depth images follows that from joint angles late.",
        numbers=(
            Number(what="latency", paper="about 50 ms", source="real robot",
                ours="lag_of_heights_ms", unit="ms"),
            Number(what="latency, as found by real2sim", paper="about 50 ms", source="real robot",
                ours="found_ms",
                   unit="ms"),
        ),
        trial="ours: 50 ms hidden in a simulated robot and found in its log",
    ),
    Row(
        name="performance", where="Table I", make="motion.performance", trial=_SIMULATED,
        shows="One framework is the fastest on stairs and stones and equals the best on one "
              "step and one gap.",
        numbers=(
            Number(what="stairs, greatest speed", paper="1 m/s", source="real robot",
                ours="stairs.speed_mps.most",
                   unit="m/s"),
            Number(what="stepping stones, greatest speed", paper="1.4 m/s", source="real robot",
                   ours="stepping stones.speed_mps.most", unit="m/s"),
            Number(what="successes on a step of 0.60 m", paper="its highest", source="real robot",
                ours="step.success"),
            Number(what="successes on a gap of 0.80 m", paper="its widest", source="real robot",
                ours="gap.success"),
            Number(what="stairs, walking (Egocentric Vision, A1)", paper="0.46 m/s", source="other "
                                                                                            "robots"),
            Number(what="step, gap (Robot Parkour, A1)", paper="0.4 m, 0.6 m", source="other "
                                                                                      "robots"),
            Number(what="step, gap (Extreme Parkour, A1)", paper="0.5 m, 0.8 m", source="other "
                                                                                        "robots"),
        ),
        differs="Ours is faster; the paper does not say what bounds its robot's speed, "
                "so why cannot be told.",
    ),
    Row(
        name="staircase", where="Sec. VIII-B, Fig. 1a", make="motion.staircase", trial=_SIMULATED,
        shows="14 stairs, 3.5 m long and 2.8 m high, in one go, mostly two stairs a jump.",
        numbers=(
            Number(what="time", paper="4.5 s", source="real robot", ours="time_over_it_s.median",
                unit="s"),
            Number(what="horizontal speed", paper="0.8 m/s", source="real robot",
                ours="horizontal_mps.median",
                   unit="m/s"),
            Number(what="vertical speed", paper="0.6 m/s", source="real robot",
                ours="vertical_mps.median",
                   unit="m/s"),
            Number(what="jumps", paper="8", source="real robot", ours="jumps.median"),
        ),
        differs="Ours is quicker. Its jumps are landings of the front feet; "
                "what the paper counts it does not say.",
    ),
    Row(
        name="stones", where="Sec. VIII-B, Fig. 1b", make="motion.stones", trial=_SIMULATED,
        shows="Stepping stones, one gap a jump, in less than two seconds.",
        numbers=(
            Number(what="time", paper="less than 2 s", source="real robot",
                ours="time_over_it_s.median", unit="s"),
            Number(what="jumps", paper="one a gap", source="real robot", ours="jumps.median"),
        ),
        differs="The paper does not say how long its course is; ours is 6.9 m: stones of 0.5 m, "
                "gaps of 0.1 to 0.5 m.",
    ),
    Row(
        name="walking", where="Sec. VIII-B, Table I", needs="cited only",
        shows="Jumping takes less than half of the time of a walking policy on stairs.",
        numbers=(Number(what="stairs, walking", paper="0.46 m/s", source="other robots"),),
        differs="Saltus has no walking gait: a number that is cited only.",
    ),
    Row(
        name="generalisation", where="Sec. VIII-B, Fig. 1c", make="motion.generalisation",
        trial=_SIMULATED,
        shows="Four places with ground not seen in training; "
              "all go well but stairs of separate planks.",
        numbers=(
            Number(what="stairs of planks", paper="20 %", source="real robot",
                   ours="stairs of planks.success"),
            Number(what="three other places", paper="100 %", source="real robot",
                   ours="stairs with noses.success"),
        ),
        differs="The paper's places are known from pictures only; ours are in no training. Planks "
        "fail with true heights, too: the policy is at fault as well. Stairs with noses fail "
        "mostly because of predicted heights. In "
        "the row of four most robots with true heights fail: its gaps are deeper than in training.",
    ),
    Row(
        name="step-and-gap", where="Fig. 7", make="edges.step_and_gap", trial=_SIMULATED,
        shows="A step of 0.60 m and a gap of 0.80 m: key frames, "
              "and predicted heights that fit the ground.",
    ),
    Row(
        name="gap-footsteps", where="Fig. 8", make="edges.gap_footsteps", trial=_SIMULATED,
        shows="Feet are placed by the gap: narrow ones are crossed at once, "
              "at wide ones the robot lands once more.",
        differs="Ours crosses all of them in one jump, and bounds once more before it only where "
                "its start is far off.",
    ),
    Row(
        name="step-pitch", where="Fig. 9", make="edges.step_pitch", trial=_SIMULATED,
        shows="The higher the step, the further the policy pitches the nose up.",
    ),
    Row(
        name="no-feedback-deployment", where="Fig. 10, Sec. VIII-E",
        make="motion.no_feedback_deployment",
        trial=_SIMULATED,
        shows="Without velocity feedback in the stance legs the robot cannot jump up.",
        differs="The paper leaves it out in training, too; here it is left out when deployed only.",
    ),
    Row(
        name="full-system", where="Fig. 10", needs=ABLATION, trial=_TRAINED,
        shows="The full system completes 14 stairs in simulation and on the robot.",
        numbers=_on_stairs("full-system", "all", "all"),
        differs="The stand-in for the robot is harder than the paper's robot was: its drives are "
        "weak and its joints have friction. Each of its ten effects alone fails few trials, all "
        "together two of three (docs/paper.md).",
    ),
    Row(
        name="no-height-randomisation", where="Fig. 10, Sec. VIII-E", needs=ABLATION,
        trial=_TRAINED,
        shows="Trained on exact heights, the policy fails on predicted ones already in simulation.",
        numbers=_on_stairs("no-height-randomisation", "not all", "not all"),
        differs="Two seeds of three fail in simulation, in four trials of ten. On the stand-in "
        "they do better than the full system's: there the power of the drives decides. Where these "
        "are not weak, they do worse, as in the "
        "paper (docs/paper.md).",
    ),
    Row(
        name="no-feedback", where="Fig. 10, Sec. VIII-E", needs=ABLATION, trial=_TRAINED,
        shows="Trained and run without feedback, the robot fails on stairs already in simulation.",
        numbers=_on_stairs("no-feedback", "not all", "not all"),
    ),
    Row(
        name="no-tracking-reward", where="Fig. 10, Sec. VIII-E", needs=ABLATION, trial=_TRAINED,
        shows="Without the controller's cost in the reward: well in simulation, some steps and a "
              "fall on the robot.",
        numbers=_on_stairs("no-tracking-reward", "all", "a few"),
        differs="On the stand-in no loss can be shown: 91 of 300 succeed, and 107 of the full "
        "system, and from seed to seed there is more; the power of the drives decides there. Where "
        "these are not weak, it does "
        "worse, as in the paper (docs/paper.md).",
    ),
    Row(
        name="no-saturation", where="Sec. VII, VIII-E", needs=ABLATION, trial=_TRAINED,
        shows="Half of the paper's 'No SysID': motors without saturation in training.",
        differs="The paper does not show this half alone.",
    ),
    Row(
        name="no-latency", where="Sec. VII, VIII-E", needs=ABLATION, trial=_SEEING,
        shows="Half of the paper's 'No SysID': images without delay in training.",
        differs="The paper does not show this half alone. Heights that are predicted as if images "
        "were new belong to where the robot was 50 ms before.",
    ),
    Row(
        name="no-sysid", where="Fig. 10, Sec. VIII-E", needs=ABLATION, trial=_SEEING,
        shows="Without both: well in simulation; too fast, and into the edges of stairs, "
              "on the robot.",
        numbers=_on_stairs("no-sysid", "all", "not all"),
        differs="Ours fails in simulation already: there images are late and motors saturate, "
                "whatever was trained.",
    ),
    Row(
        name="imitation", where="Fig. 10, Sec. VIII-E", needs=ABLATION, trial=_SEEING,
        shows="Actions learned from depth without a heightmap: "
              "no more than two stairs on the robot.",
        numbers=_on_stairs("imitation", "all", "2 at most"),
        differs="Ours learns from the predictor's data. On the stand-in it climbs 3.6 steps on "
        "average, and all in one of 100 trials.",
    ),
    Row(
        name="predictor-rounds", where="Sec. IV-A, VIII-A", needs=ABLATION, trial=_SEEING,
        shows="The predictor learns from data of its own roll-outs, round after round: "
              "30 of 5,000 pairs each.",
        differs="Ours are 3 rounds of 2.4 million pairs; "
                "in the first the robots are driven with true heights.",
    ),
    Row(
        name="learning-curves", where="Sec. VIII-A", needs=ABLATION,
        make="learning_curves.learning_curves",
        shows="The policy takes 8,000 iterations, 7 hours on one RTX 4090; the predictor one hour.",
        differs="Ours are of the full system's policies, 250 million steps each, and of the "
                "networks that see.",
    ),
    Row(
        name="transfer", where="Fig. 10", needs=ABLATION, trial=_ALL,
        shows="Steps before failure on the real robot, in five trials of each system.",
        differs="Saltus has no robot: a simulated one stands in, beyond what the trainings draw.",
    ),
)  # fmt: skip
BY_NAME = {row.name: row for row in ROWS}
