"""The claimed robot as a MuJoCo model, written from the table of this package."""

import numpy as np

from benchmarks.hidden_effects.robot import (
    ABDUCTION,
    ANCHOR,
    ARMATURE,
    CALF,
    FOOT_RADIUS,
    FRONT,
    LEGS,
    SIDE,
    STAND_HEIGHT,
    THIGH,
    TRUNK_CENTRE,
    TRUNK_INERTIA,
    TRUNK_MASS,
    TRUNK_QUATERNION,
    Floats,
    leg_links,
    rotation,
)


def model_text(
    *,
    free: bool,
    timestep: float,
    integrator: str = "implicitfast",
    friction: float = 1.0,
    contact_time: float = 0.02,
) -> str:
    """MJCF of the robot.

    With a free base it stands on a plane that touches nothing but its feet.
    """
    ground = f' friction="{friction} 0.005 0.0001" solref="{contact_time} 1"'
    axes = rotation(TRUNK_QUATERNION)
    trunk = axes @ np.diag(TRUNK_INERTIA) @ axes.T
    legs = "".join(_leg(number, ground) for number in range(4))
    joint = "<freejoint/>" if free else ""
    floor = (
        f'<geom name="floor" type="plane" size="0 0 1" contype="1" conaffinity="2"{ground}/>'
        if free
        else ""
    )
    motors = "".join(
        f'<motor joint="{leg}_{kind}"/>' for leg in LEGS for kind in ("hip", "thigh", "calf")
    )
    return f"""<mujoco model="claimed">
  <compiler angle="radian" balanceinertia="false"/>
  <option timestep="{timestep}" integrator="{integrator}" cone="elliptic"/>
  <worldbody>{floor}
    <body name="trunk" pos="0 0 {STAND_HEIGHT}">{joint}
      {_inertial(TRUNK_MASS, np.array(TRUNK_CENTRE), trunk)}{legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>"""


def _leg(number: int, ground: str) -> str:
    masses, centres, inertias = leg_links(number)
    leg, side, front = LEGS[number], SIDE[number], FRONT[number]
    inertial = [_inertial(*values) for values in zip(masses, centres, inertias, strict=True)]
    armature = ARMATURE[3 * number : 3 * number + 3]
    return f"""
      <body name="{leg}_hip" pos="{front * ANCHOR[0]} {side * ANCHOR[1]} 0">
        <joint name="{leg}_hip" axis="1 0 0" armature="{armature[0]}"/>{inertial[0]}
        <body name="{leg}_thigh" pos="0 {side * ABDUCTION} 0">
          <joint name="{leg}_thigh" axis="0 1 0" armature="{armature[1]}"/>{inertial[1]}
          <body name="{leg}_calf" pos="0 0 {-THIGH}">
            <joint name="{leg}_calf" axis="0 1 0" armature="{armature[2]}"/>{inertial[2]}
            <geom name="{leg}" type="sphere" size="{FOOT_RADIUS}" pos="0 0 {-CALF}" mass="0"
              contype="2" conaffinity="1"{ground}/>
          </body>
        </body>
      </body>"""


def _inertial(mass: float, centre: Floats, inertia: Floats) -> str:
    entries = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return (
        f'<inertial mass="{mass}" pos="{" ".join(map(str, centre))}" '
        f'fullinertia="{" ".join(map(str, entries))}"/>'
    )
