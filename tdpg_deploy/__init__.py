"""Run push-grasping policies on a UR5, a Robotiq 2F-85 and a RealSense D435, real or simulated."""

__version__ = "0.1.0"
