"""MuJoCo: adapter and models (joint trees, or free bodies with equality constraints)."""
