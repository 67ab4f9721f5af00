// The system in motion on a plain canvas: truth and any runs together. It interpolates between output times only to draw.
"use strict";
window.Playback = (function () {
  const MAX_TURN = Math.PI / 2;  // rad between output times; beyond it the motion between them is a guess
  const TRAIL = 0.12;  // share of the duration that a short trail shows
  const FRONT = {turn: -0.9, tilt: 0.3, zoom: 1};
  const MOST_VIEWS = 4;
  const {add, blend, place, direction, opening} = window.Geometry;
  const NOISE = 8 / 65533;  // share of a run's error that packing its poses may add

  // Calls `moved` with the time at every picture, and with true once the view has come to rest.
  function start(drawing, t, actors, shown, moved) {
    const id = (name) => document.getElementById(name);
    const canvas = id("stage"), context = canvas.getContext("2d");
    const play = id("play"), scrub = id("scrub"), clock = id("clock"), rate = id("rate"), trails = id("trails");
    const names = id("labels"), views = id("views"), vectorsShown = id("vectors"), magnified = id("power"), gap = id("gap");
    const port = {width: 1, height: 1};  // of the view that is drawn
    const state = {...FRONT, time: 0, playing: false, last: null, scale: 1, centre: [0, 0, 0], wide: 1, high: 1,
      radius: 1, open: 0};
    const visible = new Set(shown);
    const motions = new Map();
    const motion = (actor) => {
      if (!motions.has(actor)) motions.set(actor, actor.motion());
      return motions.get(actor);
    };
    const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
    const {stroke, dot, word, ground, spiral, arrow, zigzag, lit} = window.pens(context, style);
    const truth = actors.find((actor) => !actor.colour);
    // It stops where truth ends.
    const last = truth ? Math.max(1, motion(truth).x[0][0].findLastIndex((value) => value !== null)) : t.length - 1;
    const duration = t[last];

    // The extent of the whole motion, so that the window is chosen once: centres with the reach of corners, and fixed points.
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
      return [port.width / 2 + state.scale * right, port.height / 2 - state.scale * (ct * z + st * away),
        ct * away - st * z];
    }

    function at(time) {
      const k = Math.min(t.length - 2, Math.max(0, t.findIndex((each) => each > time) - 1));
      const index = time >= duration ? last - 1 : k;
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
    function boxes(poses, colour, opacity) {
      // In pixels along the line of sight too: the light needs this.
      const seen = (point) => { const at = project(point); return [at[0], at[1], at[2] * state.scale]; };
      lit(drawing.bodies.flatMap((body, index) => (poses[index] ? [{middle: seen(poses[index].x),
        corners: body.corners.map((corner) => seen(place(poses, index, corner)))}] : [])), colour, opacity);
    }

    // Reddens from 1e-9 of the picture on, or 1e-3 without truth to compare with; fully red at a hundredth. Gaps below
    // `noise` may come from packing alone.
    function redden(joint, poses, exact, at, noise) {
      const found = opening(joint, poses, exact), open = found > noise ? found : 0, least = exact ? -9 : -3;
      const red = open > 0 ? Math.min(1, Math.max(0, (Math.log10(open / state.radius) - least) / (-2 - least))) : 0;
      context.globalAlpha = red;
      if (red) dot(at, 4.5 + 4 * red, style("--bound"), style("--bound"));
      context.globalAlpha = 1;
      return open;
    }

    function jointsAndForces(poses, colour, edge, exact, noise) {
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
        if (colour === edge) state.open = Math.max(state.open, redden(joint, poses, exact, b, noise));
      });
      drawing.forces.forEach((force) => {
        if (force.type === "linear_spring") {
          const ends = [place(poses, force.parent, force.parent_point), place(poses, force.child, force.child_point)];
          if (ends[0] && ends[1]) zigzag(...ends.map(project), style("--green"));
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

    // Error vectors are magnified by the power of ten that makes the largest of the whole run a quarter of the picture.
    const largest = new Map();
    function worst(actor) {
      if (!largest.has(actor)) {
        const {dx} = motion(actor);
        const sizes = dx ? t.map((_, k) => Math.max(...dx.map((rows) => Math.hypot(...rows.map((row) => row[k] ?? 0))))) : [0];
        largest.set(actor, Math.max(...sizes));
      }
      return largest.get(actor);
    }
    function vectors(moves, exact, [index, share], colour, power) {
      moves.dx?.forEach((rows, body) => {
        const apart = blend(rows.map((row) => row[index]), rows.map((row) => row[index + 1]), share).map((each) => 10 ** power * each);
        if (!exact[body] || !apart.every(Number.isFinite)) return;
        const [from, to] = [project(exact[body].x), project(add(exact[body].x, apart))];
        if (Math.hypot(to[0] - from[0], to[1] - from[1]) < 3) return;
        stroke([from, to], style("--page"), 6);
        arrow(from, to, colour);
      });
    }

    function view(shown, exact, when, power) {
      const tall = state.high * Math.cos(state.tilt) + state.wide * Math.abs(Math.sin(state.tilt));
      state.scale = 0.46 * Math.min(port.width / state.wide, port.height / tall) * state.zoom;
      furniture();
      shown.forEach((actor, row) => {
        const moves = motion(actor), colour = actor.colour ?? style("--truth");
        const poses = drawing.bodies.map((_, body) => pose(moves, body, ...when));
        trail(moves, ...when, colour);
        boxes(poses, colour, actor.colour ? 0.35 : 0.15);
        if (poses.every(Boolean)) {
          jointsAndForces(poses, colour, actor.colour ? colour : style("--text"), actor.colour && exact, NOISE * worst(actor));
        }
        if (power !== null && actor.colour) vectors(moves, exact, when, colour, power);
        if (names.checked && row + 1 === shown.length) {
          drawing.bodies.slice(0, 12).forEach((body, k) => poses[k] && word(body.name, project(poses[k].x), style("--text")));
        }
        word(actor.label, [port.width - 12, 22 + 16 * row], colour, -context.measureText(actor.label).width);
      });
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
      context.font = "12px system-ui, 'DejaVu Sans', sans-serif";
      const when = at(state.time), shown = actors.filter((actor) => visible.has(actor.label));
      if (drawing.turn > MAX_TURN) when[1] = Math.round(when[1]);
      const exact = truth && drawing.bodies.map((_, body) => pose(motion(truth), body, ...when));
      const far = truth && vectorsShown.checked ? Math.max(0, ...shown.map(worst)) : 0;
      const power = far > 0 ? Math.max(0, Math.floor(Math.log10(0.25 * state.radius / far))) : null;
      // One view of all, or two to four beside each other; runs beyond the fourth share its view.
      const count = views.value === "beside" ? Math.min(MOST_VIEWS, Math.max(1, shown.length)) : 1;
      const columns = count === 3 && width > 600 ? 3 : Math.min(2, count);
      Object.assign(port, {width: width / columns, height: height / Math.ceil(count / columns)});
      state.open = 0;
      for (let k = 0; k < count; k += 1) {
        context.save();
        context.translate(k % columns * port.width, Math.floor(k / columns) * port.height);
        context.beginPath();
        context.rect(0, 0, port.width, port.height);
        context.clip();
        if (count > 1) stroke([[0, 0], [port.width, 0], [port.width, port.height], [0, port.height], [0, 0]], style("--line"), 1);
        view(count === 1 ? shown : k + 1 < count ? [shown[k]] : shown.slice(k), exact, when, power);
        context.restore();
      }
      clock.textContent = state.time.toPrecision(3) + " s";
      magnified.textContent = power === null ? "" : "× 10" + [...String(power)].map((digit) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[digit]).join("");
      gap.textContent = state.open ? "The widest is open by " + state.open.toExponential(1) + " m." : "";
      if (document.activeElement !== scrub || state.playing) scrub.value = 1000 * state.time / duration;
      Object.assign(canvas.dataset, {time: state.time, views: count, open: state.open, power: power ?? ""});
      moved(state.time);
    }
    let settling = null;
    function settle() {  // an address that changed with every turn of a wheel would be refused
      clearTimeout(settling);
      settling = setTimeout(() => moved(state.time, true), 200);
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
          settle();
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
      [trails, names, views, vectorsShown].forEach((each) => each.addEventListener("change", () => { draw(); settle(); }));
      id("reset").addEventListener("click", () => { Object.assign(state, FRONT); draw(); settle(); });
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
      ["pointerup", "pointercancel"].forEach((kind) => canvas.addEventListener(kind, (event) => {
        fingers.delete(event.pointerId);
        settle();
      }));
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        state.zoom = Math.min(20, Math.max(0.2, state.zoom * Math.exp(-event.deltaY * 0.001)));
        draw();
        settle();
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
      // What the address keeps of the picture, where it is not as the page opens.
      kept() {
        const camera = Object.keys(FRONT).map((key) => state[key]);
        return [["show", [...visible].join("|")], ...(views.value === "overlay" ? [] : [["views", views.value]]),
          ...(vectorsShown.checked ? [] : [["vectors", "none"]]), ...(trails.value === "short" ? [] : [["trails", trails.value]]),
          ...(camera.every((each, k) => each === Object.values(FRONT)[k]) ? []
            : [["camera", camera.map((each) => each.toPrecision(4)).join(",")]])];
      },
      recall(view) {
        const camera = (view.get("camera") ?? "").split(",").map(Number);
        [state.turn, state.tilt, state.zoom] = camera.length === 3 && camera.every(Number.isFinite) ? camera : Object.values(FRONT);
        views.value = view.get("views") === "beside" ? "beside" : "overlay";
        vectorsShown.checked = view.get("vectors") !== "none";
        trails.value = view.get("trails") ?? "short";
        if (view.has("show")) this.show(view.get("show").split("|").filter((label) => actors.some((actor) => actor.label === label)));
      },
      seek(time) {
        state.time = Math.min(duration, Math.max(0, time));
        draw();
      },
    };
  }

  return {start};
})();
