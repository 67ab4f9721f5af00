// Points and directions of bodies in their poses {x, q}, and how far joints are open.
"use strict";
window.Geometry = (function () {
  // The free direction of joints that slide: along the axis or across it.
  const SLIDING = {cylindrical: "along", prismatic: "along", point_on_line: "along", planar: "across", point_on_plane: "across",
    knife_edge: "across"};
  const dot3 = (p, q) => p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
  const add = (p, q) => [p[0] + q[0], p[1] + q[1], p[2] + q[2]];
  // What is not known at one end is NaN between; null would count as zero.
  const blend = (p, q, share) => p.map((value, k) => (value === null || q[k] === null ? NaN : value + share * (q[k] - value)));

  function turned(q, p) {
    const [w, x, y, z] = q;
    const u = [2 * (y * p[2] - z * p[1]), 2 * (z * p[0] - x * p[2]), 2 * (x * p[1] - y * p[0])];
    return [p[0] + w * u[0] + y * u[2] - z * u[1], p[1] + w * u[1] + z * u[0] - x * u[2], p[2] + w * u[2] + x * u[1] - y * u[0]];
  }

  const place = (poses, body, point) => (body < 0 ? point : poses[body] && add(poses[body].x, turned(poses[body].q, point)));
  const direction = (poses, body, axis) => (body < 0 ? axis : turned(poses[body].q, axis));

  // The height of a rolling body's centre over the plane, and the sine between its axis and the normal: a radius is their
  // quotient. A sphere has no axis.
  const standing = (joint, poses, apart) => [dot3(joint.parent_axis, apart), joint.child_axis
    ? Math.sqrt(1 - dot3(joint.parent_axis, direction(poses, joint.child, joint.child_axis)) ** 2) : 1];

  // How far (m) a joint is open in the directions that it closes. Truth is subtracted, which cancels the rounding of packing; the
  // radius of what rolls is that of truth, and slip opens nothing.
  function opening(joint, poses, exact) {
    const gapOf = (each) => {
      const from = place(each, joint.parent, joint.parent_anchor), to = place(each, joint.child, joint.child_anchor);
      return from && to ? from.map((value, k) => to[k] - value) : [NaN, NaN, NaN];
    };
    const own = gapOf(poses), close = exact ? gapOf(exact) : [0, 0, 0];
    if (joint.type === "distance") return exact ? Math.abs(Math.hypot(...own) - Math.hypot(...close)) : 0;
    if (joint.type.startsWith("rolling")) {
      const [height, sine] = standing(joint, poses, own), [exactHeight, exactSine] = exact ? standing(joint, exact, close) : [height, sine];
      return Math.abs(height - exactHeight * sine / exactSine);
    }
    const apart = own.map((value, k) => value - close[k]), free = SLIDING[joint.type];
    if (!free || !joint.parent_axis) return Math.hypot(...apart);
    const along = dot3(direction(exact ?? poses, joint.parent, joint.parent_axis), apart);
    return free === "along" ? Math.sqrt(Math.max(0, dot3(apart, apart) - along * along)) : Math.abs(along);
  }

  return {add, blend, place, direction, opening};
})();
