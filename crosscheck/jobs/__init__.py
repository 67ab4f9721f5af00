"""Running tasks that may crash, hang or be interrupted: workers, grids of tasks, the table of rows."""
