"""A Franka Panda as a URDF file, from the published table of its modified Denavit-Hartenberg
parameters, and the beam of the experiment of Mamedov et al.

Sources: Franka Emika, Robot and interface specifications (Denavit-Hartenberg parameters); masses
and centers of mass rounded from C. Gaz et al., IEEE Robotics and Automation Letters 4(4), 2019.
"""

from __future__ import annotations

# a [m], d [m], alpha [rad] of each joint, in Craig's convention, and of the flange
TABLE = (
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -1.5707963267948966),
    (0.0, 0.316, 1.5707963267948966),
    (0.0825, 0.0, 1.5707963267948966),
    (-0.0825, 0.384, -1.5707963267948966),
    (0.0, 0.0, 1.5707963267948966),
    (0.088, 0.0, 1.5707963267948966),
)
FLANGE = 0.107  # m along the axis of joint 7
MASSES = (4.97, 0.65, 3.23, 3.59, 1.23, 1.67, 0.74)  # kg
CENTERS = (
    (0.004, 0.002, -0.048),
    (-0.003, -0.029, 0.003),
    (0.028, 0.039, -0.067),
    (-0.053, 0.104, 0.027),
    (-0.012, 0.041, -0.038),
    (0.060, -0.014, -0.011),
    (0.011, -0.004, 0.062),
)  # m
RADIUS = 0.08  # m, of gyration of each link
LOWER = (-2.9, -1.77, -2.9, -3.08, -2.9, -0.02, -2.9)  # rad
UPPER = (2.9, 1.77, 2.9, -0.06, 2.9, 3.76, 2.9)
SPEED = (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61)  # rad/s
TORQUE = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)  # N m
# of the experiment: m, Pa, kg/m^3; first mode at 2.9 Hz
BEAM = {"length": 0.52, "width": 0.08, "height": 0.001, "modulus": 190e9, "density": 7870.0}


def panda_urdf() -> str:
    """The text of a URDF file: links ``link0`` to ``link7`` and ``flange``, joints ``q1`` to
    ``q7``.
    """
    lines = ['<robot name="panda">', '<link name="link0"/>']
    for k, (a, d, alpha) in enumerate(TABLE, 1):
        x, y, z = CENTERS[k - 1]
        m = MASSES[k - 1]
        moment = m * RADIUS**2
        lines += [
            f'<link name="link{k}"><inertial><origin xyz="{x} {y} {z}"/><mass value="{m}"/>',
            f'<inertia ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"/>',
            "</inertial></link>",
        ]
        # Craig: rotate by alpha about x, then move by a along x and by d along the new z
        y, z = {0.0: (0.0, d), -1.5707963267948966: (d, 0.0)}.get(alpha, (-d, 0.0))
        lines += [
            f'<joint name="q{k}" type="revolute"><parent link="link{k - 1}"/>',
            f'<child link="link{k}"/><origin xyz="{a} {y} {z}" rpy="{alpha} 0 0"/>',
            f'<axis xyz="0 0 1"/><limit lower="{LOWER[k - 1]}" upper="{UPPER[k - 1]}" ',
            f'velocity="{SPEED[k - 1]}" effort="{TORQUE[k - 1]}"/></joint>',
        ]
    lines += [
        '<link name="flange"/><joint name="to_flange" type="fixed"><parent link="link7"/>',
        f'<child link="flange"/><origin xyz="0 0 {FLANGE}"/></joint></robot>',
    ]
    return "\n".join(lines)
