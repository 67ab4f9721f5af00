"""Pictures of the built-in scenes, drawn from runs of them when the site is built."""

from __future__ import annotations

from html import escape

import numpy as np

import crosscheck
from crosscheck.scene.model import Scene

SAMPLES, WIDTH, HEIGHT, MARGIN = 160, 320, 200, 14
MOST_PATHS = 8  # of a longer chain the last bodies


def gallery() -> str:
    """A section for each scene: its picture, what it is, and its tags."""
    return "".join(f"\n## {name}\n\n{picture(scene)}\n\n{scene.description}. {scene.n} "
                   f"{'body' if scene.n == 1 else 'bodies'}, {scene.duration:g} s; tags: {', '.join(scene.tags)}.\n"
                   for name in crosscheck.scenes() for scene in (crosscheck.load_scene(name),))


def picture(scene: Scene) -> str:
    """The paths of the mass centres and, at the start, lines from these to the joints, as SVG in the page's colours.

    The view is along the axis in which the drawn points extend least.
    """
    traj = crosscheck.run(scene.replace(samples=SAMPLES), "lieeuler", "taylor", rtol=1e-6)
    rods = [(scene.x0[body], scene.x0[body] + scene.R0[body] @ anchor) for joint in scene.joints
            for body, anchor in ((joint.parent, joint.parent_anchor), (joint.child, joint.child_anchor)) if body >= 0]
    points = np.concatenate([traj.x.reshape(-1, 3), np.reshape(rods, (-1, 3))])
    right, up = view(points - points.mean(axis=0))
    flat = np.stack([points @ right, -points @ up], axis=-1)
    low, size = flat.min(axis=0), np.maximum(np.ptp(flat, axis=0), 1e-9)
    scale = min((WIDTH - 2 * MARGIN) / size[0], (HEIGHT - 2 * MARGIN) / size[1])
    flat = np.array([WIDTH, HEIGHT]) / 2 + (flat - low - size / 2) * scale
    paths, ends = np.split(flat, [SAMPLES * scene.n])
    lines = [f'<polyline points="{coordinates(path)}" fill="none" stroke="currentColor" stroke-opacity=".45"/>'
             for path in paths.reshape(SAMPLES, scene.n, 2).swapaxes(0, 1)[-MOST_PATHS:]]
    lines += [f'<polyline points="{coordinates(rod)}" stroke="currentColor" stroke-width="2.5"/>'
              for rod in ends.reshape(-1, 2, 2)]
    lines += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="currentColor"/>' for x, y in paths[:scene.n]]
    return (f'<svg class="scene" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="paths of the mass centres of '
            f'{escape(scene.name)}">{"".join(lines)}</svg>')


def view(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Axes (3,) to the right and upwards on the page: up is the vertical, unless all points are level."""
    _, _, axes = np.linalg.svd(points, full_matrices=False)
    sight = axes[2]
    up = np.array([0.0, 0.0, 1.0]) - sight[2] * sight
    up = axes[1] if np.linalg.norm(up) < 0.3 else up / np.linalg.norm(up)
    return np.cross(up, sight), up


def coordinates(points: np.ndarray) -> str:
    """Points (n, 2) as SVG wants them."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
