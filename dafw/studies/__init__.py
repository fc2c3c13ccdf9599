"""Running a study: its cycles, its log and progress bar, and stopping it on request."""
