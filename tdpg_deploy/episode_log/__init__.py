"""The log of an episode: one MCAP file that Foxglove and Rerun open. See docs/log.md."""
