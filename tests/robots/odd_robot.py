"""A robot whose model says all that ours does in another way, as MJCF."""

LEGS = ("fl", "fr", "hl", "hr")  # another order, other names

HEAD = """
<mujoco model="odd">
  <compiler angle="radian"/>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom type="plane" size="5 5 1"/>
    <body name="body" pos="0 0 0.6">
      <freejoint/>
      <inertial mass="14" pos="0.01 0.002 0.003" diaginertia="0.1 0.3 0.35"/>
      <geom type="box" size="0.25 0.1 0.05" pos="0.01 0 0.02" contype="1"/>
      <geom type="box" size="0.02 0.02 0.02" pos="0.2 0 0.09" contype="1"/>
      <body name="camera" pos="0.3 0 0.1"><inertial mass="0.5" pos="0 0 0.01" diaginertia="1e-4 1e-4 1e-4"/></body>
"""

# The hip's frame is turned a quarter about y: its z is the base's x. Left legs count the abduction
# the other way, all count the knee the other way. The knee lies 25 mm ahead of the thigh's line and
# 10 mm to the side, the foot 4 mm behind the calf's. The thigh's joint is not at the origin of its
# body. The foot is a body of its own.
LEG = """
      <body name="{leg}_hip" pos="{x} {y} 0.01" quat="0.7071067811865476 0 0.7071067811865475 0">
        <joint name="{leg}.hx" axis="0 0 {hx}" range="{hx_range}" armature="0.01" damping="0.2"/>
        <inertial mass="1.2" pos="0.01 {com_y} 0.005" quat="0.9 0.1 0.3 0.2" diaginertia="0.003 0.002 0.004"/>
        <body name="{leg}_upper" pos="0 {offset} 0.03" quat="0.7071067811865476 0 -0.7071067811865475 0">
          <joint name="{leg}.hy" pos="0 {joint_y} 0" axis="0 1 0" range="-0.8 2.2" armature="0.02"/>
          <inertial mass="1.5" pos="0.01 0.02 -0.1" quat="0.8 0.3 -0.3 0.1" diaginertia="0.02 0.018 0.003"/>
          <geom type="capsule" size="0.02" fromto="0 0 0 0.025 0 -0.3" contype="1"/>
          <body name="{leg}_lower" pos="0.025 {knee_y} -0.3">
            <joint name="{leg}.kn" axis="0 -1 0" range="0.3 2.7" armature="0.03"/>
            <inertial mass="0.4" pos="0 0.001 -0.15" diaginertia="0.004 0.004 0.0002"/>
            <geom type="sphere" size="0.03" pos="0 0 0"/>
            <body name="{leg}_foot" pos="-0.004 0 -0.31">
              <geom type="sphere" size="0.025" mass="0.05" contype="1"/>
            </body>
          </body>
        </body>
      </body>
"""

MOTORS = """    <motor joint="{leg}.hx" gear="2" ctrlrange="-20 20"/>
    <position joint="{leg}.hy" forcerange="-50 50"/>
"""


def odd_mjcf(keyframe: str = "") -> str:
    """The text of the model; knees have no torque limit."""
    legs, motors = "", ""
    for leg in LEGS:
        left, front = leg[1] == "l", leg[0] == "f"
        side = 1.0 if left else -1.0
        legs += LEG.format(
            leg=leg,
            x=0.25 if front else -0.27,
            y=0.06 * side,
            hx=-1 if left else 1,
            hx_range="-0.3 0.6" if left else "-0.6 0.3",
            offset=0.09 * side,
            joint_y=0.01 * side,
            knee_y=0.02 * side,
            com_y=0.03 * side,
        )
        motors += MOTORS.format(leg=leg)
    return (
        f"{HEAD}{legs}    </body>\n  </worldbody>\n  <actuator>\n{motors}  "
        f"</actuator>\n{keyframe}</mujoco>\n"
    )
