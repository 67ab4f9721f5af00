// Draws on a canvas: lines, dots, words, arrows, and the signs of ground and springs.
"use strict";
window.pens = function (context, style) {
  const FACES = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];  // of corners
  const LIGHT = [-0.4, -0.8, -0.45];  // towards the light: right, down and away
  const dot3 = (p, q) => p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
  const cross = (p, q) => [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];

  function stroke(points, colour, width, dash) {
    if (points.some((point) => !point)) return;
    context.beginPath();
    points.forEach((point, k) => context[k ? "lineTo" : "moveTo"](point[0], point[1]));
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.setLineDash(dash ?? []);
    context.stroke();
    context.setLineDash([]);
  }
  function dot(point, radius, fill, edge) {
    context.beginPath();
    context.arc(point[0], point[1], radius, 0, 2 * Math.PI);
    context.fillStyle = fill;
    context.fill();
    context.strokeStyle = edge;
    context.lineWidth = 1.5;
    context.stroke();
  }
  function word(text, point, colour, shift) {
    context.lineWidth = 3;
    context.strokeStyle = style("--page");
    context.font = "12px system-ui, 'DejaVu Sans', sans-serif";
    context.strokeText(text, point[0] + (shift ?? 7), point[1] - 6);
    context.fillStyle = colour;
    context.fillText(text, point[0] + (shift ?? 7), point[1] - 6);
  }

  function ground(point) {
    const [x, y] = point, colour = style("--quiet");
    stroke([[x - 12, y - 9], [x + 12, y - 9]], colour, 2);
    [-9, -3, 3, 9].forEach((shift) => stroke([[x + shift, y - 9], [x + shift + 4, y - 15]], colour, 1.2));
    stroke([[x, y - 9], [x, y]], colour, 1.2);
  }
  function spiral(point) {
    const points = [];
    for (let k = 0; k <= 60; k += 1) {
      points.push([point[0] + (5 + k / 8) * Math.cos(k / 4), point[1] + (5 + k / 8) * Math.sin(k / 4)]);
    }
    stroke(points, style("--green"), 1.4);
  }
  function arrow(from, to, colour) {
    stroke([from, to], colour, 2);
    const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
    [2.6, -2.6].forEach((side) => stroke([to, [to[0] + 8 * Math.cos(angle + side), to[1] + 8 * Math.sin(angle + side)]],
      colour, 2));
  }
  function zigzag(a, b, colour) {
    const dx = b[0] - a[0], dy = b[1] - a[1], length = Math.hypot(dx, dy) || 1;
    const nx = -dy / length * 6, ny = dx / length * 6;
    const points = [a];
    for (let k = 1; k < 16; k += 1) {
      const side = k < 3 || k > 13 ? 0 : k % 2 ? 1 : -1;
      points.push([a[0] + dx * k / 16 + side * nx, a[1] + dy * k / 16 + side * ny]);
    }
    stroke([...points, b], colour, 1.6);
  }

  // Boxes by their corners and middles, in pixels; the far faces first, lit from above the reader's left shoulder.
  function lit(boxes, colour, opacity) {
    const faces = boxes.flatMap(({corners, middle}) => FACES.map((face) => ({points: face.map((corner) => corners[corner]), middle})));
    const depth = ({points}) => points.reduce((sum, point) => sum + point[2], 0);
    faces.sort((one, other) => depth(other) - depth(one)).forEach(({points, middle}) => {
      const apart = (k, from) => points[k].map((value, axis) => value - from[axis]);
      const normal = cross(apart(1, points[0]), apart(3, points[0]));
      const light = Math.sign(dot3(normal, apart(0, middle))) * dot3(LIGHT, normal) / (Math.hypot(...normal) || 1);
      context.beginPath();
      points.forEach((point, k) => context[k ? "lineTo" : "moveTo"](point[0], point[1]));
      context.closePath();
      [[opacity, colour], [0.6 * opacity * Math.abs(light), light > 0 ? "#ffffff" : "#000000"]].forEach(([alpha, fill]) => {
        context.globalAlpha = alpha;
        context.fillStyle = fill;
        context.fill();
      });
      context.globalAlpha = 1;
      context.strokeStyle = colour;
      context.lineWidth = 1;
      context.stroke();
    });
  }

  return {stroke, dot, word, ground, spiral, arrow, zigzag, lit};
};
