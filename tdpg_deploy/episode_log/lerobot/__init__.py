"""Logs as a dataset of LeRobot, format v3.0. docs/log.md describes what is in it."""
