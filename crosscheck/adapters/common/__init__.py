"""What more than one adapter needs: spanning tree, links, the loop over steps, Lie group steppers."""
