"""An arm of two links that hangs, and a motion that moves it."""

from __future__ import annotations

import numpy as np

URDF = b"""<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz=".02 0 -.15"/><mass value="2"/>
    <inertia ixx=".02" iyy=".02" izz=".004" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 -.2"/><mass value="1.2"/>
    <inertia ixx=".012" iyy=".012" izz=".002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="60" velocity="10"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 -.3"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="40" velocity="10"/></joint>
</robot>"""


def multisine(t: np.ndarray, hz: np.ndarray, size: np.ndarray, phase: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities of both joints, (2, N) each, at times (N,), of sines (2, K)."""
    turn = 2 * np.pi * hz[..., None] * t + phase[..., None]
    return (size[..., None] * np.sin(turn)).sum(1), (2 * np.pi * (size * hz)[..., None] * np.cos(turn)).sum(1)
