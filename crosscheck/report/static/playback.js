// The system in motion on a plain canvas: truth and any runs together. It interpolates between output times only to draw.
"use strict";
window.Playback = (function () {
  const FACES = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
  const MAX_TURN = Math.PI / 2;  // rad between output times; beyond it the way between them is a guess
  const TRAIL = 0.12;  // share of the duration that a short trail shows
  const add = (p, q) => [p[0] + q[0], p[1] + q[1], p[2] + q[2]];
  const blend = (p, q, share) => p.map((value, k) => value + share * (q[k] - value));

  function turned(q, p) {
    const [w, x, y, z] = q;
    const u = [2 * (y * p[2] - z * p[1]), 2 * (z * p[0] - x * p[2]), 2 * (x * p[1] - y * p[0])];
    return [p[0] + w * u[0] + y * u[2] - z * u[1], p[1] + w * u[1] + z * u[0] - x * u[2], p[2] + w * u[2] + x * u[1] - y * u[0]];
  }

  // `moved` is told the time at every picture, and whether the time is to stay.
  function start(drawing, t, actors, shown, moved) {
    const id = (name) => document.getElementById(name);
    const canvas = id("stage"), context = canvas.getContext("2d");
    const play = id("play"), scrub = id("scrub"), clock = id("clock"), rate = id("rate"), trails = id("trails");
    const names = id("labels");
    const state = {time: 0, playing: false, turn: -0.9, tilt: 0.3, zoom: 1, last: null, scale: 1, centre: [0, 0, 0], wide: 1, high: 1,
      radius: 1};
    const duration = t.at(-1);
    const visible = new Set(shown);
    const motions = new Map();
    const motion = (actor) => {
      if (!motions.has(actor)) motions.set(actor, actor.motion());
      return motions.get(actor);
    };
    const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

    // Where everything ever is, to choose the window once: every centre with the corners' reach, and the fixed points.
    function extent() {
      const points = [];
      const first = actors[0] && motion(actors[0]);
      drawing.bodies.forEach((body, index) => {
        const reach = 0.8 * Math.max(...body.corners.map((corner) => Math.hypot(...corner)));
        first?.x[index][0].forEach((_, k) => points.push([first.x[index].map((axis) => axis[k]), reach]));
      });
      drawing.joints.filter((joint) => joint.parent < 0).forEach((joint) => points.push([joint.parent_anchor, 0]));
      drawing.forces.filter((force) => force.parent === drawing.ground && force.parent_point).forEach(
        (force) => points.push([force.parent_point, 0]));
      const good = points.filter(([p]) => p.every(Number.isFinite));
      if (!good.length) return;
      state.centre = [0, 1, 2].map((k) => (Math.min(...good.map(([p, r]) => p[k] - r)) + Math.max(...good.map(([p, r]) => p[k] + r))) / 2);
      const most = (read) => Math.max(...good.map(([p, r]) => read(p.map((value, k) => value - state.centre[k])) + r), 1e-9);
      state.wide = most(([x, y]) => Math.hypot(x, y));
      state.high = most(([, , z]) => Math.abs(z));
      state.radius = Math.hypot(state.wide, state.high);
    }

    function project(p) {
      const [x, y, z] = p.map((value, k) => value - state.centre[k]);
      const c = Math.cos(state.turn), s = Math.sin(state.turn), ct = Math.cos(state.tilt), st = Math.sin(state.tilt);
      const right = c * x + s * y, away = -s * x + c * y;
      return [canvas.clientWidth / 2 + state.scale * right, canvas.clientHeight / 2 - state.scale * (ct * z + st * away),
        ct * away - st * z];
    }

    function at(time) {
      const k = Math.min(t.length - 2, Math.max(0, t.findIndex((each) => each > time) - 1));
      const index = time >= duration ? t.length - 2 : k;
      return [index, Math.min(1, (time - t[index]) / (t[index + 1] - t[index]))];
    }
    function pose(moves, body, index, share) {
      const pick = (rows, k) => rows.map((row) => row[k]);
      const near = drawing.turn > MAX_TURN ? Math.round(share) : share;
      const x = blend(pick(moves.x[body], index), pick(moves.x[body], index + 1), near);
      const q = blend(pick(moves.q[body], index), pick(moves.q[body], index + 1), near);
      const size = Math.hypot(...q);
      return size > 0 && Number.isFinite(size + x[0]) ? {x, q: q.map((value) => value / size)} : null;
    }
    const place = (poses, body, point) => (body < 0 ? point : poses[body] && add(poses[body].x, turned(poses[body].q, point)));
    const direction = (poses, body, axis) => (body < 0 ? axis : turned(poses[body].q, axis));

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

    function zigzag(from, to) {
      const [a, b] = [project(from), project(to)];
      const dx = b[0] - a[0], dy = b[1] - a[1], length = Math.hypot(dx, dy) || 1;
      const nx = -dy / length * 6, ny = dx / length * 6;
      const points = [a];
      for (let k = 1; k < 16; k += 1) {
        const side = k < 3 || k > 13 ? 0 : k % 2 ? 1 : -1;
        points.push([a[0] + dx * k / 16 + side * nx, a[1] + dy * k / 16 + side * ny]);
      }
      return [...points, b];
    }

    function boxes(poses, colour, opacity) {
      const faces = [];
      drawing.bodies.forEach((body, index) => {
        if (!poses[index]) return;
        const corners = body.corners.map((corner) => project(place(poses, index, corner)));
        FACES.forEach((face) => faces.push(face.map((corner) => corners[corner])));
      });
      const depth = (face) => face.reduce((sum, point) => sum + point[2], 0);
      faces.sort((one, other) => depth(other) - depth(one)).forEach((face) => {
        context.beginPath();
        face.forEach((point, k) => context[k ? "lineTo" : "moveTo"](point[0], point[1]));
        context.closePath();
        context.globalAlpha = opacity;
        context.fillStyle = colour;
        context.fill();
        context.globalAlpha = 1;
        context.strokeStyle = colour;
        context.lineWidth = 1;
        context.stroke();
      });
    }

    function jointsAndForces(poses, colour, edge) {
      drawing.joints.forEach((joint) => {
        const from = place(poses, joint.parent, joint.parent_anchor), to = place(poses, joint.child, joint.child_anchor);
        if (!from || !to) return;
        const [a, b] = [project(from), project(to)];
        if (joint.parent >= 0) stroke([project(poses[joint.parent].x), a], colour, 2.5);
        if (joint.child >= 0) stroke([b, project(poses[joint.child].x)], colour, 2.5);
        if (joint.type === "distance") stroke([a, b], edge, 2);
        const axis = joint.parent_axis && direction(poses, joint.parent, joint.parent_axis);
        const reach = 0.1 * state.radius;
        const along = (size) => project(from.map((value, k) => value + size * axis[k]));
        if (axis && joint.type === "point_on_plane") stroke([a, along(reach)], edge, 2);
        else if (axis) {
          const long = ["prismatic", "cylindrical", "point_on_line"].includes(joint.type) ? 3 : 1;
          stroke([along(-long * reach), along(long * reach)], edge, 2, long > 1 ? [7, 4] : null);
        }
        if (joint.parent < 0) ground(a);
        dot(b, joint.type === "fixed" ? 3 : 4.5, style("--page"), edge);
      });
      drawing.forces.forEach((force) => {
        if (force.type === "linear_spring") {
          const ends = [place(poses, force.parent, force.parent_point), place(poses, force.child, force.child_point)];
          if (ends[0] && ends[1]) stroke(zigzag(...ends), style("--green"), 1.6);
        } else if (force.type === "torsional_spring") {
          const joint = drawing.joints.find((each) => each.name === force.joint);
          const point = joint && place(poses, joint.parent, joint.parent_anchor);
          if (point) spiral(project(point));
        } else if (force.type === "constant_force") {
          const tip = place(poses, force.child, force.child_point);
          const size = Math.hypot(...force.force) || 1;
          const unit = force.force.map((value) => 0.3 * state.radius * value / size);
          if (tip) arrow(project(tip), project(add(tip, force.frame === "body" ? direction(poses, force.child, unit) : unit)),
            style("--orange"));
        }
      });
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

    function trail(moves, index, share, colour) {
      if (trails.value === "none") return;
      const from = trails.value === "all" ? 0 : Math.max(0, t.findIndex((each) => each >= state.time - TRAIL * duration));
      const to = trails.value === "all" ? t.length - 1 : index;
      drawing.bodies.forEach((_, body) => {
        const points = [];
        for (let k = from; k <= to; k += 1) {
          const p = moves.x[body].map((row) => row[k]);
          if (p.includes(null)) break;
          points.push(project(p));
        }
        const end = pose(moves, body, index, share);
        if (trails.value !== "all" && end) points.push(project(end.x));
        if (points.length > 1) stroke(points, colour, 1.4);
      });
    }

    function furniture() {
      const colour = style("--quiet"), height = canvas.clientHeight;
      const corner = [34, height - 34], origin = project([0, 0, 0]);
      ["x", "y", "z"].forEach((axis, k) => {
        const end = project([0, 1, 2].map((each) => (each === k ? 26 / state.scale : 0)));
        const tip = [corner[0] + end[0] - origin[0], corner[1] + end[1] - origin[1]];
        stroke([corner, tip], colour, 1.4);
        word(axis, tip, colour, 2);
      });
      // A length of 1, 2 or 5 times a power of ten that takes about a fifth of the width.
      const wanted = canvas.clientWidth / 5 / state.scale, power = 10 ** Math.floor(Math.log10(wanted));
      const length = [5, 2, 1].map((digit) => digit * power).find((each) => each <= wanted) ?? power;
      const right = canvas.clientWidth - 14;
      stroke([[right - length * state.scale, height - 16], [right, height - 16]], colour, 2);
      word(Number(length.toPrecision(1)) + " m", [right - length * state.scale, height - 16], colour, 2);
      const size = Math.hypot(...drawing.gravity);
      if (!size) return;
      const pull = project(drawing.gravity.map((value) => value / size * 30 / state.scale));
      arrow([30, 20], [30 + pull[0] - origin[0], 20 + pull[1] - origin[1]], colour);
      word("g", [30, 36], colour, 8);
    }

    function draw() {
      const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
      if (!width) return;
      if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
      }
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.clearRect(0, 0, width, height);
      context.lineJoin = "round";
      const tall = state.high * Math.cos(state.tilt) + state.wide * Math.abs(Math.sin(state.tilt));
      state.scale = 0.46 * Math.min(width / state.wide, height / tall) * state.zoom;
      furniture();
      const [index, share] = at(state.time);
      actors.filter((actor) => visible.has(actor.label)).forEach((actor) => {
        const moves = motion(actor);
        const colour = actor.colour ?? style("--truth");
        const poses = drawing.bodies.map((_, body) => pose(moves, body, index, share));
        trail(moves, index, share, colour);
        boxes(poses, colour, actor.colour ? 0.16 : 0.1);
        if (poses.every(Boolean)) jointsAndForces(poses, colour, actor.colour ? colour : style("--text"));
        if (names.checked && actor === actors.find((each) => visible.has(each.label))) {
          drawing.bodies.slice(0, 12).forEach((body, k) => poses[k] && word(body.name, project(poses[k].x), style("--text")));
        }
      });
      clock.textContent = state.time.toPrecision(3) + " s";
      if (document.activeElement !== scrub || state.playing) scrub.value = 1000 * state.time / duration;
      canvas.dataset.time = state.time;
      moved(state.time);
    }

    function tick(now) {
      if (!state.playing) return;
      state.time += state.last === null ? 0 : (now - state.last) / 1000 * Number(rate.value);
      state.last = now;
      if (state.time > duration) state.time = 0;
      draw();
      requestAnimationFrame(tick);
    }
    function set(playing) {
      state.playing = playing;
      state.last = null;
      play.textContent = playing ? "❚❚" : "▶";
      play.setAttribute("aria-label", playing ? "pause" : "play");
      if (!playing) moved(state.time, true);
      if (playing) {
        if (state.time >= duration) state.time = 0;
        requestAnimationFrame(tick);
      }
    }

    function chooser() {
      const groups = {};
      actors.forEach((actor) => {
        const box = groups[actor.engine] = groups[actor.engine] ?? document.createElement("div");
        const label = document.createElement("label");
        const input = document.createElement("input");
        const chip = document.createElement("i");
        input.type = "checkbox";
        input.value = actor.label;
        input.checked = visible.has(actor.label);
        chip.style.setProperty("--c", actor.colour ?? "var(--truth)");
        input.addEventListener("change", () => {
          visible[input.checked ? "add" : "delete"](actor.label);
          draw();
        });
        label.append(input, chip, actor.label);
        box.append(label);
      });
      id("actors").replaceChildren(...Object.values(groups));
    }

    function listen() {
      play.addEventListener("click", () => set(!state.playing));
      scrub.addEventListener("input", () => {
        if (state.playing) set(false);
        state.time = scrub.value / 1000 * duration;
        draw();
      });
      scrub.addEventListener("change", () => moved(state.time, true));
      [trails, names].forEach((each) => each.addEventListener("change", draw));
      id("reset").addEventListener("click", () => { Object.assign(state, {turn: -0.9, tilt: 0.3, zoom: 1}); draw(); });
      canvas.addEventListener("keydown", (event) => {
        if (event.key === " ") { event.preventDefault(); set(!state.playing); }
      });
      const fingers = new Map();
      canvas.addEventListener("pointerdown", (event) => {
        fingers.set(event.pointerId, [event.clientX, event.clientY]);
        canvas.setPointerCapture(event.pointerId);
      });
      canvas.addEventListener("pointermove", (event) => {
        const before = fingers.get(event.pointerId);
        if (!before) return;
        const spread = () => Math.hypot(...[0, 1].map((k) => [...fingers.values()][0][k] - [...fingers.values()][1][k]));
        const wide = fingers.size === 2 && spread();
        fingers.set(event.pointerId, [event.clientX, event.clientY]);
        if (fingers.size === 2) state.zoom = Math.min(20, Math.max(0.2, state.zoom * spread() / (wide || 1)));
        else {
          state.turn -= (event.clientX - before[0]) * 0.01;
          state.tilt = Math.max(-1.5, Math.min(1.5, state.tilt + (event.clientY - before[1]) * 0.01));
        }
        draw();
      });
      ["pointerup", "pointercancel"].forEach((kind) => canvas.addEventListener(kind, (event) => fingers.delete(event.pointerId)));
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        state.zoom = Math.min(20, Math.max(0.2, state.zoom * Math.exp(-event.deltaY * 0.001)));
        draw();
      }, {passive: false});
      document.addEventListener("themechange", draw);
      new ResizeObserver(draw).observe(canvas);
    }

    if (drawing.turn > MAX_TURN) {
      id("warning").textContent = "Bodies turn up to " + (drawing.turn * 180 / Math.PI).toFixed(0)
        + "° between output times: the picture jumps from one to the next.";
    }
    // A scene that is over in a blink starts in slow motion.
    rate.value = duration < 0.3 ? "0.05" : duration < 1.5 ? "0.1" : "1";
    extent();
    chooser();
    listen();
    draw();
    return {
      show(labels) {
        visible.clear();
        labels.forEach((label) => visible.add(label));
        chooser();
        canvas.dataset.shown = labels.join(", ");
        draw();
      },
      seek(time) {
        state.time = Math.min(duration, Math.max(0, time));
        draw();
      },
    };
  }

  return {start};
})();
