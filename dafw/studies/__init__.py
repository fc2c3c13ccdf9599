"""Running a study: its cycles, its log and progress, and ending it when asked to."""
