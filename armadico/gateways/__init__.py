"""Gateways from a society to other tools: a web page, ROS 2."""
