"""What stays on disk: records, stages, checkpoints."""
