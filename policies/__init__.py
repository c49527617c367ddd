"""Policies that look at a heightmap and name one push or grasp. Needs numpy and torch only."""
