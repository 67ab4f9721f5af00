"""Code shared by several adapters: spanning tree, links, the loop over steps, Lie group steppers."""
