"""A UR controller on loopback: RTDE, script and dashboard servers before a simulated arm."""
