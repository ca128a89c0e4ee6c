"""One leg held at its base, with its three drives, as a compiled kernel:
a thread is a leg of one variant.

Two rates: mass matrix and bias forces are renewed every 0.5 ms at the midpoint of the coming
stretch; drives, friction and the play of the gears move at 0.125 ms. Newton and Euler link by link;
LuGre friction with the bristle solved exactly; two masses where a gear has play or gives way, with
the logged encoder on either side.
"""

import warp as wp

STEP_S = 0.000125
STEPS_PER_INERTIA = 4

# Columns of the table of parameters, per joint
NAMES = (
    "lag", "gain", "sag", "speed_corner", "speed_none", "viscous", "coulomb", "breakaway",
    "stribeck_velocity",
    "gap", "gear_stiffness", "gear_damping", "armature", "bias", "quantum", "velocity_filter",
    "cogging", "cogging_cycles", "spring", "spring_rest", "heating", "dead_zone", "asymmetry",
    "kp_slope",
    "damping_slope", "slew", "torque_limit", "hum", "hum_rate", "coupling",
    "integral", "rub", "rub_at", "dropout", "eccentric", "eccentric_cycles", "speed_scale",
    "presliding", "motor_side",
)  # fmt: skip
COLUMN = {name: number for number, name in enumerate(NAMES)}
CURVE_POINTS = 37
"""The torque that is lost, at equal steps of the command from 0 to the joint's limit."""

LAG, GAIN, SAG, CORNER, NONE, VISCOUS, COULOMB, BREAKAWAY, STRIBECK = (
    wp.constant(i) for i in range(9)
)
GAP, STIFFNESS, DAMPING, ARMATURE, BIAS, QUANTUM, FILTER = (wp.constant(i) for i in range(9, 16))
COGGING, CYCLES, SPRING, REST, HEATING, DEAD, ASYMMETRY, KP_SLOPE = (
    wp.constant(i) for i in range(16, 24)
)
DAMPING_SLOPE, SLEW, LIMIT, HUM, HUM_RATE, COUPLING = (wp.constant(i) for i in range(24, 30))
INTEGRAL, RUB, RUB_AT, DROPOUT, ECCENTRIC, ECCENTRIC_CYCLES = (
    wp.constant(i) for i in range(30, 36)
)
SPEED_SCALE, PRESLIDING, MOTOR_SIDE = (wp.constant(i) for i in range(36, 39))
LAST = wp.constant(CURVE_POINTS - 1)
H = wp.constant(STEP_S)
RENEW = wp.constant(STEPS_PER_INERTIA)
FASTEST = wp.constant(300.0)  # rad/s: ten times what the joints can do
RUB_WIDTH = wp.constant(0.08)  # rad: a spot of some degrees
HEAT_S = wp.constant(6.0)  # time constant of a motor's windings and housing, order of magnitude


@wp.struct
class Leg:
    """Mass, centre and inertia about the centre of each link, in the link's frame.

    Offset of the thigh's axis.
    """

    mass: wp.vec3
    c1: wp.vec3
    c2: wp.vec3
    c3: wp.vec3
    i1: wp.mat33
    i2: wp.mat33
    i3: wp.mat33
    offset: wp.vec3


@wp.func
def rotation_x(a: float) -> wp.mat33:
    """Rotation about the first axis."""
    c = wp.cos(a)
    s = wp.sin(a)
    return wp.mat33(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c)


@wp.func
def rotation_y(a: float) -> wp.mat33:
    """Rotation about the second axis."""
    c = wp.cos(a)
    s = wp.sin(a)
    return wp.mat33(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)


@wp.func
def inverse_dynamics(
    leg: Leg, r1: wp.mat33, r2: wp.mat33, r3: wp.mat33, v: wp.vec3, a: wp.vec3, gravity: float
) -> wp.vec3:
    """Torques of the three joints that go with velocities `v` and accelerations `a`."""
    x = wp.vec3(1.0, 0.0, 0.0)
    y = wp.vec3(0.0, 1.0, 0.0)
    shank = wp.vec3(0.0, 0.0, -0.213)
    w1 = x * v[0]
    d1 = x * a[0]
    a1 = wp.transpose(r1) * wp.vec3(0.0, 0.0, gravity)
    u2 = wp.transpose(r2) * w1
    w2 = u2 + y * v[1]
    d2 = wp.transpose(r2) * d1 + wp.cross(u2, y * v[1]) + y * a[1]
    a2 = wp.transpose(r2) * (a1 + wp.cross(d1, leg.offset) + wp.cross(w1, wp.cross(w1, leg.offset)))
    u3 = wp.transpose(r3) * w2
    w3 = u3 + y * v[2]
    d3 = wp.transpose(r3) * d2 + wp.cross(u3, y * v[2]) + y * a[2]
    a3 = wp.transpose(r3) * (a2 + wp.cross(d2, shank) + wp.cross(w2, wp.cross(w2, shank)))
    f1 = leg.mass[0] * (a1 + wp.cross(d1, leg.c1) + wp.cross(w1, wp.cross(w1, leg.c1)))
    f2 = leg.mass[1] * (a2 + wp.cross(d2, leg.c2) + wp.cross(w2, wp.cross(w2, leg.c2)))
    f3 = leg.mass[2] * (a3 + wp.cross(d3, leg.c3) + wp.cross(w3, wp.cross(w3, leg.c3)))
    n3 = leg.i3 * d3 + wp.cross(w3, leg.i3 * w3) + wp.cross(leg.c3, f3)
    g3 = r3 * f3
    n2 = (
        leg.i2 * d2
        + wp.cross(w2, leg.i2 * w2)
        + wp.cross(leg.c2, f2)
        + r3 * n3
        + wp.cross(shank, g3)
    )
    g2 = r2 * (f2 + g3)
    n1 = (
        leg.i1 * d1
        + wp.cross(w1, leg.i1 * w1)
        + wp.cross(leg.c1, f1)
        + r2 * n2
        + wp.cross(leg.offset, g2)
    )
    return wp.vec3(n1[0], n2[1], n3[1])


@wp.func
def lost(
    curve: wp.array(dtype=float, ndim=3), variant: int, joint: int, command: float, limit: float
) -> float:
    """Returns what of a commanded torque does not arrive, by table."""
    x = wp.min(wp.abs(command) / limit, 100.0) * float(LAST)
    i = wp.clamp(int(x), 0, LAST - 1)
    low = curve[variant, joint, i]
    return wp.sign(command) * (low + (curve[variant, joint, i + 1] - low) * (x - float(i)))


@wp.kernel(enable_backward=False)
def simulate(
    leg_numbers: wp.array(dtype=int),
    legs: wp.array(dtype=Leg),
    command: wp.array(dtype=float, ndim=3),
    arrival: wp.array(dtype=int, ndim=3),
    arrival_forward: wp.array(dtype=int, ndim=3),
    table: wp.array(dtype=float, ndim=3),
    curve: wp.array(dtype=float, ndim=3),
    gains: wp.array(dtype=float, ndim=2),
    start: wp.array(dtype=float, ndim=1),
    steps_per_row: int,
    steps_per_tick: int,
    out: wp.array(dtype=float, ndim=4),
):
    """Writes position, velocity and believed torque of a leg at every row,
    shape (variants, rows, 12, 3).
    """
    variant, number = wp.tid()
    number = leg_numbers[number]
    leg = legs[number]
    rows = command.shape[0]
    base = 3 * number
    q = wp.vec3(start[base], start[base + 1], start[base + 2])
    v = wp.vec3()
    motor = q
    motor_v = wp.vec3()
    filtered = wp.vec3()
    delivered = wp.vec3()
    wanted = wp.vec3()
    encoder = q
    tacho = wp.vec3()
    believed = wp.vec3()
    bristle = wp.vec3()
    heat = wp.vec3()
    gathered = wp.vec3()
    pointer = wp.vec3i()
    pointer_forward = wp.vec3i()
    inverse = wp.mat33()
    bias = wp.vec3()
    zero = wp.vec3()
    total = rows * steps_per_row
    for step in range(total):
        row = step // steps_per_row
        if step % RENEW == 0:
            middle = q + v * (0.5 * float(RENEW) * H)
            r1 = rotation_x(middle[0])
            r2 = rotation_y(middle[1])
            r3 = rotation_y(middle[2])
            bias = inverse_dynamics(leg, r1, r2, r3, v, zero, 9.81)
            k1 = inverse_dynamics(leg, r1, r2, r3, zero, wp.vec3(1.0, 0.0, 0.0), 0.0)
            k2 = inverse_dynamics(leg, r1, r2, r3, zero, wp.vec3(0.0, 1.0, 0.0), 0.0)
            k3 = inverse_dynamics(leg, r1, r2, r3, zero, wp.vec3(0.0, 0.0, 1.0), 0.0)
            m = wp.matrix_from_cols(k1, k2, k3)
            for j in range(3):
                if table[variant, base + j, STIFFNESS] <= 0.0:
                    m[j, j] = m[j, j] + table[variant, base + j, ARMATURE]
            inverse = wp.inverse(m)
        for j in range(3):
            joint = base + j
            fresh = step % steps_per_tick == 0
            if fresh:
                wave = wp.sin(table[variant, joint, ECCENTRIC_CYCLES] * motor[j])
                seen = (
                    motor[j] + table[variant, joint, BIAS] + table[variant, joint, ECCENTRIC] * wave
                )
                quantum = table[variant, joint, QUANTUM]
                if quantum > 0.0:
                    seen = quantum * wp.round(seen / quantum)
                encoder[j] = seen
                tacho[j] = filtered[j] * table[variant, joint, SPEED_SCALE]
            # a packet takes force when it comes, on the reading of the last tick
            while pointer[j] + 1 < rows and arrival[variant, joint, pointer[j] + 1] <= step:
                pointer[j] = pointer[j] + 1
                fresh = True
            while (
                pointer_forward[j] + 1 < rows
                and arrival_forward[variant, joint, pointer_forward[j] + 1] <= step
            ):
                pointer_forward[j] = pointer_forward[j] + 1
                fresh = True
            if fresh:
                proportional = command[pointer[j], joint, 0] - encoder[j]
                derivative = gains[1, joint] * (command[pointer[j], joint, 1] - tacho[j])
                forward = command[pointer_forward[j], joint, 2]
                believed[j] = gains[0, joint] * proportional + derivative + forward
                slope = table[variant, joint, KP_SLOPE] * (encoder[j] - start[joint])
                u = believed[j] + gains[0, joint] * slope * proportional
                dead = table[variant, joint, DEAD]
                if dead > 0.0:
                    u = u - wp.clamp(u, -dead, dead)
                wanted[j] = u
        if step % steps_per_row == 0:
            for j in range(3):
                joint = base + j
                geared = table[variant, joint, STIFFNESS] > 0.0
                turned = q[j]
                told = filtered[j]
                if geared and table[variant, joint, MOTOR_SIDE] > 0.0:
                    turned = motor[j]
                elif geared:
                    told = v[j]
                wave = wp.sin(table[variant, joint, ECCENTRIC_CYCLES] * turned)
                seen = (
                    turned + table[variant, joint, BIAS] + table[variant, joint, ECCENTRIC] * wave
                )
                quantum = table[variant, joint, QUANTUM]
                if quantum > 0.0:
                    seen = quantum * wp.round(seen / quantum)
                out[variant, row, joint, 0] = seen
                out[variant, row, joint, 1] = told * table[variant, joint, SPEED_SCALE]
                out[variant, row, joint, 2] = believed[j]
        torque = wp.vec3()
        for j in range(3):
            joint = base + j
            lag = table[variant, joint, LAG]
            slew = table[variant, joint, SLEW]
            if lag > 0.0:
                delivered[j] = wanted[j] + (delivered[j] - wanted[j]) * wp.exp(-H / lag)
            elif slew > 0.0:
                delivered[j] = delivered[j] + wp.clamp(
                    wanted[j] - delivered[j], -slew * H, slew * H
                )
            else:
                delivered[j] = wanted[j]
            u = delivered[j]
            limit = table[variant, joint, LIMIT]
            none = table[variant, joint, NONE]
            if none > 0.0 and u * motor_v[j] > 0.0:
                corner = table[variant, joint, CORNER]
                bound = limit * wp.clamp((none - wp.abs(motor_v[j])) / (none - corner), 0.0, 1.0)
                u = wp.clamp(u, -bound, bound)
            gathered[j] = gathered[j] + (command[pointer[j], joint, 0] - encoder[j]) * H
            u = u + table[variant, joint, INTEGRAL] * gains[0, joint] * gathered[j]
            u = u - lost(curve, variant, joint, u, limit)
            scale = table[variant, joint, GAIN] * (
                1.0 - table[variant, joint, SAG] * float(step) / float(total)
            )
            heat[j] = heat[j] + (u * u - heat[j]) * (H / HEAT_S)
            scale = scale / (1.0 + table[variant, joint, HEATING] * heat[j])
            scale = scale * (1.0 + table[variant, joint, ASYMMETRY] * wp.sign(u))
            u = u * scale + table[variant, joint, COGGING] * wp.sin(
                table[variant, joint, CYCLES] * motor[j]
            )
            u = u + table[variant, joint, COUPLING] * wanted[(j + 1) % 3]
            time_s = float(step % 80000) * H
            if wp.mod(time_s + 0.31 * float(joint), 0.83) < 0.06:
                u = u * (1.0 - table[variant, joint, DROPOUT])
            u = u + table[variant, joint, HUM] * wp.sin(
                6.2831853 * table[variant, joint, HUM_RATE] * time_s
            )
            stiffness = table[variant, joint, STIFFNESS]
            if stiffness > 0.0:
                half = 0.5 * table[variant, joint, GAP]
                twist = motor[j] - q[j]
                pressed = twist - wp.clamp(twist, -half, half)
                through = stiffness * pressed
                if pressed != 0.0:
                    through = through + table[variant, joint, DAMPING] * (motor_v[j] - v[j])
                    if through * pressed < 0.0:
                        through = 0.0
                motor_v[j] = motor_v[j] + (u - through) / table[variant, joint, ARMATURE] * H
                motor_v[j] = wp.clamp(motor_v[j], -FASTEST, FASTEST)
                motor[j] = motor[j] + motor_v[j] * H
                u = through
            speed = v[j]
            s = speed / table[variant, joint, STRIBECK]
            level = table[variant, joint, COULOMB] + table[variant, joint, BREAKAWAY] * wp.exp(
                -s * s
            )
            u = u - table[variant, joint, VISCOUS] * speed
            u = u - table[variant, joint, DAMPING_SLOPE] * speed * wp.abs(speed)
            away = (q[j] - table[variant, joint, RUB_AT]) / RUB_WIDTH
            rub = table[variant, joint, RUB] * wp.exp(-away * away)
            u = u - rub * wp.tanh(speed / 0.03)
            u = u - table[variant, joint, SPRING] * (q[j] - table[variant, joint, REST])
            if level > 0.0:
                bend = table[variant, joint, PRESLIDING]
                brush = level / bend
                settled = bend * wp.sign(speed)
                before = bristle[j]
                bristle[j] = settled + (before - settled) * wp.exp(-wp.abs(speed) / bend * H)
                slow = speed / 0.02
                rate = (bristle[j] - before) / H
                u = u - brush * bristle[j] - 0.03 * wp.sqrt(brush) * wp.exp(-slow * slow) * rate
            torque[j] = u
        v = v + inverse * (torque - bias) * H
        for j in range(3):  # what is unstable stays a number
            v[j] = wp.clamp(v[j], -FASTEST, FASTEST)
        q = q + v * H
        for j in range(3):
            if table[variant, base + j, STIFFNESS] <= 0.0:
                motor[j] = q[j]
                motor_v[j] = v[j]
            tau = table[variant, base + j, FILTER]
            if tau > 0.0:
                filtered[j] = motor_v[j] + (filtered[j] - motor_v[j]) * wp.exp(-H / tau)
            else:
                filtered[j] = motor_v[j]
