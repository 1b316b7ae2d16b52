"""What leaves the project: one file a target."""
