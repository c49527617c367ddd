"""What pushes free, played from the same tables again and again, and a PushNet taught by it."""
