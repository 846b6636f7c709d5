"""A society as ROS 2 nodes: topics for RViz and other tools, and goals from them."""
