"""Small model files: an arm as URDF and as MJCF, and a MuJoCo model with every kind of joint."""

ARM_URDF = """<robot name="arm">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0.1 0 -0.3" rpy="0.3 0.2 0.1"/><mass value="1"/>
  <inertia ixx="0.1" iyy="0.12" izz="0.05" ixy="0.01" ixz="0.002" iyz="0"/></inertial>
  <visual><geometry><mesh filename="package://somewhere/upper.stl"/></geometry></visual></link>
<link name="lower"><inertial><origin xyz="0 0.02 -0.2"/><mass value="0.5"/>
  <inertia ixx="0.02" iyy="0.025" izz="0.01" ixy="0" ixz="0" iyz="0.001"/></inertial></link>
<link name="tool"><inertial><mass value="0.1"/>
  <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="finger"><inertial><origin xyz="0 0 -0.1"/><mass value="0.2"/>
  <inertia ixx="0.002" iyy="0.0015" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
  <origin xyz="0 0 1" rpy="0.2 0.1 0"/><axis xyz="0 1 0"/><dynamics damping="0.5"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
  <origin xyz="0 0 -0.6" rpy="0 0 0.4"/><axis xyz="0.6 0.8 0"/></joint>
<joint name="wrist" type="fixed"><parent link="lower"/><child link="tool"/><origin xyz="0 0.1 -0.4"/></joint>
<joint name="reach" type="prismatic"><parent link="tool"/><child link="finger"/>
  <origin xyz="0 0 -0.1"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
  <dynamics damping="2"/></joint>
</robot>"""

ARM_MJCF = """<mujoco model="arm"><compiler angle="radian"/><worldbody>
<body name="upper" pos="0 0 1" quat="{quat}"><inertial pos="0.1 0 -0.3" mass="1" fullinertia="{inertia}"/>
 <joint name="shoulder" axis="0 1 0" damping="0.5"/>
 <body name="lower" pos="0 0 -0.6" quat="{turn}"><inertial pos="0 0.02 -0.2" mass="0.5"
   fullinertia="0.02 0.025 0.01 0 0 0.001"/><joint name="elbow" axis="0.6 0.8 0"/>
  <body name="tool" pos="0 0.1 -0.4"><inertial pos="0 0 0" mass="0.1" diaginertia="0.001 0.001 0.001"/>
   <body name="finger" pos="0 0 -0.1"><inertial pos="0 0 -0.1" mass="0.2" diaginertia="0.002 0.0015 0.001"/>
    <joint name="reach" type="slide" axis="0 0 1" damping="2"/></body></body></body></body>
</worldbody></mujoco>"""

ZOO = """<mujoco model="zoo"><option gravity="0.3 0 -9.81"/><compiler angle="radian"/><worldbody>
<body name="a" pos="0 0 1" euler="0.1 0.2 0.3">
 <inertial pos="0.1 0 -0.2" mass="1.2" fullinertia="0.1 0.12 0.09 0.01 0.005 0.002"/>
 <joint name="h" axis="0.3 1 0.2" damping="0.3" stiffness="3" springref="0.4" ref="0.2" pos="0 0.1 0"
  armature="0.05"/>
 <site name="tip" pos="0 0 -0.4"/>
 <body name="welded" pos="0 0 -0.2"><inertial pos="0 0 0" mass="0.2" diaginertia="0.01 0.01 0.01"/></body>
 <body name="b" pos="0 0 -0.5"><inertial pos="0 0.1 -0.1" mass="0.7" diaginertia="0.04 0.03 0.02"/>
  <joint name="s" type="slide" axis="1 0.2 0" damping="0.2" stiffness="20" armature="0.3"/>
  <body name="c" pos="0 0 -0.3"><inertial pos="0 0.1 -0.1" mass="0.5" diaginertia="0.04 0.03 0.02"/>
   <joint name="ball" type="ball" pos="0 0 0.1"/></body></body></body>
<body name="fly" pos="2 0 0"><freejoint/><inertial pos="0.1 0 0" mass="1" diaginertia="0.1 0.2 0.15"/>
 <site name="eye" pos="0 0.1 0"/></body>
<body name="cart" pos="0 3 0"><inertial pos="0 0 0.1" mass="1" diaginertia="0.1 0.2 0.15"/>
 <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/><joint type="hinge" axis="0 1 0"/>
 <body name="cross" pos="0 0 -0.5" gravcomp="0.5"><inertial pos="0 0.1 -0.1" mass="0.7" diaginertia="0.04 0.03 0.02"/>
  <joint name="u1" axis="1 0 0"/><joint name="u2" axis="0 1 0"/>
  <body name="screw" pos="0.2 0 -0.5"><inertial pos="0 0.1 -0.1" mass="0.4" diaginertia="0.04 0.03 0.02"/>
   <joint name="turn" axis="0 0 1" damping="0.1" stiffness="0.5" springref="0.2" armature="0.02"/>
   <joint name="travel" type="slide" axis="0 0 -1" damping="0.4" stiffness="6" springref="0.1" armature="0.1"/>
  </body></body></body>
</worldbody>
<tendon><spatial name="rope" stiffness="5" damping="0.1" springlength="1.5"><site site="tip"/><site site="eye"/>
</spatial></tendon><actuator><motor joint="h"/></actuator></mujoco>"""
