"""Logs of vehicles as others write them: CSV, MCAP and ROS 2 bags, with their faults repaired."""
