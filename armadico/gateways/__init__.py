"""Gateways from a society to other tools: a web page, Foxglove, ROS 2."""
