"""URDF texts that tests of the reader share."""

from __future__ import annotations

from pathlib import Path

ROBOTS = Path(__file__).parents[1] / "robots" / "urdf"

#: Every element that is read, and some that are not.
WHOLE = """<?xml version="1.0" encoding="utf-8"?>
<robot name="whole">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="base_link">
    <inertial>
      <origin xyz="0 0 0.1" rpy="0.1 0.2 0.3"/>
      <mass value="4.0"/>
      <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="-0.002" izz="0.025"/>
    </inertial>
    <visual>
      <origin xyz="0 0 0.05" rpy="0 0 1.5707963267948966"/>
      <geometry><box size="0.2 0.3 0.1"/></geometry>
    </visual>
    <collision><geometry><sphere radius="0.2"/></geometry></collision>
  </link>
  <link name="upper-arm">
    <inertial>
      <mass value="1.5"/>
      <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.003"/>
    </inertial>
    <visual><geometry><cylinder radius="0.05" length="0.4"/></geometry></visual>
    <visual><geometry><mesh filename="package://arm/upper.dae" scale="2 2 2"/></geometry></visual>
  </link>
  <link name="slider">
    <inertial>
      <origin xyz="0.05 0 0"/>
      <mass value="0.4"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/>
    </inertial>
    <visual><geometry><sphere radius="0.03"/></geometry></visual>
  </link>
  <link name="follower">
    <inertial>
      <mass value="0.3"/>
      <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/>
    </inertial>
  </link>
  <link name="tool"/>
  <joint name="shoulder joint" type="revolute">
    <origin xyz="0 0 0.3" rpy="1.5707963267948966 0 0"/>
    <parent link="base_link"/>
    <child link="upper-arm"/>
    <axis xyz="0 0 1"/>
    <limit effort="10" velocity="2" lower="-1" upper="1"/>
    <dynamics damping="0.7" friction="0.2"/>
  </joint>
  <joint name="slide" type="prismatic">
    <origin xyz="0 0.4 0"/>
    <parent link="upper-arm"/>
    <child link="slider"/>
    <axis xyz="1 0 0"/>
    <limit effort="10" velocity="2" lower="-1" upper="1"/>
  </joint>
  <joint name="follow" type="continuous">
    <origin xyz="0 -0.4 0"/>
    <parent link="upper-arm"/>
    <child link="follower"/>
    <axis xyz="0 1 0"/>
    <mimic joint="shoulder joint" multiplier="-2" offset="0.5"/>
  </joint>
  <joint name="flange" type="fixed">
    <origin xyz="0.1 0 0"/>
    <parent link="slider"/>
    <child link="tool"/>
  </joint>
  <transmission name="t1"><type>SimpleTransmission</type></transmission>
  <gazebo reference="tool"/>
</robot>
"""
