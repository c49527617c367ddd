"""What a push would come to, tried in a simulated cell on which stands what the camera shows."""
