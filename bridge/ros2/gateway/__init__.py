"""A society as ROS 2 nodes: topics for RViz and other tools, and goals from them."""

from importlib.util import find_spec

if find_spec("pycdr2") is None:
    raise ImportError(
        "ROS 2 messages need pycdr2, which is not installed; run: pip install 'armadico[ros2]'"
    )
