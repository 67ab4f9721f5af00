"""Running tasks that may crash, hang or be interrupted: workers, grids of tasks, journals."""
