// What a picture on a canvas is drawn with: lines, dots, words, arrows and the signs of ground and springs.
"use strict";
window.pens = function (context, style) {
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
  return {stroke, dot, word, ground, spiral, arrow};
};
