"""ROS 2 robots: message types, frames, session and transports, with no ROS installed."""
