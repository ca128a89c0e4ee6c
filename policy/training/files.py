"""Names of what a training leaves in its folder."""

CHECKPOINT, PROGRESS, COMMIT = "checkpoint.pt", "progress.csv", "commit.txt"
