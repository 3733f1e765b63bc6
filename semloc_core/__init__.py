"""semloc: tells a robot where it is, and why it thinks so, from the semantics of a 3D scene graph.

Read `semloc_core.localiser` first: it is the whole pipeline in one file. Nothing here imports ROS.
"""

__version__ = "0.1.0"
