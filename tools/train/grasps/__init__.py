"""Grasps in doubt, each tried from the same look, and the critics of grasps taught by them."""
