"""Pictures drawn from runs when the site is built: the built-in scenes, and what gains do to Baumgarte's method."""

from __future__ import annotations

from html import escape

import numpy as np

import crosscheck
import lieeuler
from crosscheck.adapters.lieeuler import build_problem
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


STEPS = (8e-3, 4e-3, 2e-3, 1e-3, 5e-4)
LINES = {"0 (INDEX1_LE)": (0.0, 0.0), "1 per s": (1.0, 0.0), "5 per s, the default": (5.0, 0.0),
         "20 per s": (20.0, 0.0), "100 per s": (100.0, 0.0), "1 over the step": (0.0, 1.0)}
"""Label, and the gain as a sum of a constant (1/s) and a multiple of 1/step."""


def gains() -> str:
    """The largest opening of the joints of double_pendulum against the step, for gains of BAUMGARTE_LE, as SVG."""
    problem = build_problem(crosscheck.load_scene("double_pendulum"))
    wide, high = 620, 370
    lines = [f'<text x="10" y="14">largest opening of a joint, m</text><text x="{wide - 210}" y="{high - 6}">'
             "step, s (falling to the right)</text>"]
    place = lambda k, opened: (60 + 90 * k, 30 + 55 * (0.3 - np.log10(opened)))  # noqa: E731
    lines += [f'<line x1="60" x2="{wide}" y1="{y:.1f}" y2="{y:.1f}" stroke="currentColor" stroke-opacity=".2"/>'
              f'<text x="8" y="{y + 4:.1f}">1e{power}</text>' for power in range(-5, 1)
              for _, y in (place(0, 10.0**power),)]
    for label, (constant, over) in LINES.items():
        points = []
        for k, step in enumerate(STEPS):
            gain = constant + over / step
            run = lieeuler.integrate(problem, "BAUMGARTE_LE", step=step, t_eval=[0.0, 10.0], alpha=gain, beta=gain)
            points.append(place(k, run.stats.maxima["constraint_position"]))
        x, y = points[-1]
        lines.append(f'<polyline points="{coordinates(np.array(points))}" fill="none" stroke="currentColor" '
                     f'stroke-width="2"/><text x="{x + 8:.0f}" y="{y + 4:.1f}">{label}</text>')
    lines += [f'<text x="{place(k, 1.0)[0] - 14}" y="{high - 24}">{step:g}</text>' for k, step in enumerate(STEPS)]
    return (f'\n<svg viewBox="0 0 {wide} {high}" role="img" font-size="13" fill="currentColor" aria-label="opening of '
            f'joints against step for six gains: it falls with the step and with the gain">{"".join(lines)}</svg>\n')
