// Figures of a scene page, from the packed curves beside it (crosscheck/document/curves.py describes their form).
"use strict";
(function () {
  const STEPS = 65533, MISSING = 65535;
  const name = document.getElementById("scene").dataset.scene;
  const scene = window.CROSSCHECK_RUNS.scenes.find((each) => each.name === name);
  const runs = Figures.runsOf(name);
  const {scene: truth, runs: curves} = window.CROSSCHECK_CURVES;
  const select = (id) => document.getElementById(id);
  const hasTruth = Boolean(truth.x);

  const unpacked = new Map(), summed = new Map();
  // Curves stored as differences are added to the true one.
  function unpack(curve, exact) {
    if (curve === null || curve === undefined) return null;
    if (curve === "truth") return unpack(exact);
    if (!curve.over) return stored(curve);
    if (!summed.has(curve)) {
      const base = unpack(exact);
      summed.set(curve, stored(curve).map((value, k) => (value === null ? null : value + base[k])));
    }
    return summed.get(curve);
  }
  function stored(curve) {
    if (unpacked.has(curve)) return unpacked.get(curve);
    let values;
    if ("n" in curve) {
      values = new Array(curve.n).fill(curve.lo);
    } else {
      const bytes = Uint8Array.from(atob(curve.q), (letter) => letter.charCodeAt(0));
      const view = new DataView(bytes.buffer);
      values = Array.from({length: bytes.length / 2}, (_, index) => {
        const code = view.getUint16(2 * index, true);
        if (code === MISSING) return null;
        if (curve.log && code === 0) return 0;
        const value = curve.lo + (code - 1) / (STEPS - 1) * (curve.hi - curve.lo);
        return curve.log ? 10 ** value : value;
      });
    }
    unpacked.set(curve, values);
    return values;
  }
  const t = truth.t;
  const drawable = runs.filter((run) => curves[run.label]);
  if (!drawable.length) {  // one sentence says so
    document.querySelectorAll("figure:has([data-figure])").forEach((figure) => { figure.style.display = "none"; });
  }
  const own = (run, read) => unpack(read(curves[run.label]), read(truth));
  const exact = (read) => (hasTruth ? unpack(read(truth)) : null);

  const runSelect = select("run"), groupSelect = select("group"), bodySelect = select("body"), jointSelect = select("joint");
  const quantitySelect = select("quantity");
  drawable.forEach((run, index) => runSelect.add(new Option(run.label, index)));
  const theirs = drawable.findIndex((run) => run.engine !== "lieeuler");  // the reader came with another engine
  const preferred = theirs >= 0 ? theirs : drawable.findIndex((run) => run.label.startsWith("lieeuler DAE1L_LSE"));
  if (preferred >= 0) runSelect.value = preferred;
  const groups = Figures.groups(runs);
  groups.forEach(([title], index) => groupSelect.add(new Option(title, index)));
  truth.drawing.joints.forEach((joint) => jointSelect.add(new Option(joint.name, joint.name)));
  if (quantitySelect) Object.keys(Figures.UNITS).forEach((each) => quantitySelect.add(new Option(each, each)));
  const alone = () => drawable[runSelect.value];
  const compared = () => (groups.length ? runs.filter(groups[groupSelect.value][1]) : []);
  const comparedCurves = () => compared().filter((run) => curves[run.label]);
  const body = () => (bodySelect ? Number(bodySelect.value) : 0);

  const {style, layout, linear, log, line, logLine, makers} = Figures;
  const HUES = ["--blue", "--orange", "--green", "--violet"], DASHES = ["solid", "dash", "dot", "longdashdot"];

  // The run shown alone as lines over truth as dots: `parts` are [name, reader of a packed curve].
  function overTruth(parts, axis, empty) {
    const run = alone();
    const traces = [];
    if (!run) return {traces, columns: ["time (s)", axis]};
    parts.forEach(([part, read], index) => {
      const dots = exact(read);
      if (dots) {
        traces.push(line(run, t, dots, part + ", truth", {mode: "markers", showlegend: false,
          marker: {size: 3, color: style("--dots")}}));
      }
    });
    parts.forEach(([part, read], index) => {
      const values = own(run, read);
      if (values) traces.push(line(run, t, values, part, {line: {color: style(HUES[index]), dash: DASHES[index], width: 1.8}}));
    });
    return {traces, columns: ["time (s)", axis], empty,
      layout: layout({...linear("time (s)"), range: [t[0], t.at(-1)]}, linear(axis), {showlegend: parts.length > 1})};
  }
  makers.position = () => overTruth(["x", "y", "z"].map((part, axis) => [part, (c) => c.x[body()][axis]]), "position (m)");
  makers.quaternion = () => overTruth(["w", "x", "y", "z"].map((part, axis) => [part, (c) => c.q[body()][axis]]),
    "quaternion (1)");
  makers.energies = () => overTruth(["kinetic", "potential", "total"].map((part) => [part, (c) => c[part]]), "energy (J)");
  makers.momentum = () => overTruth([["momentum", (c) => c.momentum]], "angular momentum (kg m²/s)");
  const reaction = (kind, axis) => overTruth(["x", "y", "z"].map((part, index) => [part,
    (c) => c.reactions?.[jointSelect.value]?.[kind]?.[index]]), axis,
  truth.drawing.joints.length ? "this joint carries none, or the engine gives no multipliers" : "this scene has no joint");
  makers.force = () => reaction("force", "force (N)");
  makers.torque = () => reaction("torque", "torque (N m)");

  function matrix(q) {
    const [w, x, y, z] = q;
    return [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
      2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
      2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
  }
  const elements = (parts) => parts[0].map((_, k) => (parts.some((part) => part[k] === null)
    ? new Array(9).fill(null) : matrix(parts.map((part) => part[k]))));
  makers.elements = () => {
    const run = alone();
    const columns = ["time (s)", "element (1)"];
    if (!run) return {panels: [], columns};
    const parts = (read) => [0, 1, 2, 3].map(read);
    const shown = elements(parts((k) => own(run, (c) => c.q[body()][k])));
    const dots = hasTruth ? elements(parts((k) => exact((c) => c.q[body()][k]))) : null;
    return {columns, panels: Array.from({length: 9}, (_, element) => {
      const title = "R" + "₁₂₃"[Math.floor(element / 3)] + "₁₂₃"[element % 3];
      const traces = dots ? [line(run, t, dots.map((each) => each[element]), "truth", {mode: "markers", hoverinfo: "skip",
        hovertemplate: null, marker: {size: 3, color: style("--dots")}})] : [];
      traces.push(line(run, t, shown.map((each) => each[element]), run.label, {line: {color: style("--blue"), width: 1.6}}));
      return {title, traces, layout: layout({nticks: 4, range: [t[0], t.at(-1)]}, {range: [-1.1, 1.1], dtick: 1})};
    })};
  };

  // The path of the body's centre of mass and, where it is held by one joint only, of the point opposite that joint.
  makers.path = (element) => {
    const run = alone(), across = Number(element.dataset.axis), columns = ["x (m)", "xyz"[across] + " (m)"];
    const traces = [], empty = "no data for this choice";
    if (!run) return {traces, columns, empty};
    const joints = truth.drawing.joints.filter((joint) => [joint.parent, joint.child].includes(body()));
    const anchor = joints.length === 1 && joints[0].child === body() ? joints[0].child_anchor : null;
    const places = (read, whole) => {
      const x = [0, 1, 2].map((k) => read((c) => c.x[body()][k]));
      if (!whole || !anchor?.some(Boolean)) return whole ? null : x;
      const R = elements([0, 1, 2, 3].map((k) => read((c) => c.q[body()][k])));
      return x.map((part, row) => part.map((value, time) => (value === null || R[time][0] === null ? null
        : value - anchor.reduce((sum, each, k) => sum + R[time][3 * row + k] * each, 0))));
    };
    [["mass centre", false, "--blue", "solid"], ["end", true, "--orange", "dash"]].forEach(([part, whole, hue, dash]) => {
      const shown = places((read) => own(run, read), whole), dots = hasTruth ? places(exact, whole) : null;
      if (!shown) return;
      const over = (from, name, more) => traces.push(line(run, from[0], from[across], name,
        {hovertemplate: "%{x:.3g}, %{y:.3g} m<extra>" + name + "</extra>", ...more}));
      if (dots) over(dots, part + ", truth", {mode: "markers", marker: {size: 3, color: style("--dots")}, showlegend: false});
      over(shown, part, {line: {color: style(hue), dash, width: 1.6}});
      over(shown.map((values) => values.slice(0, 1)), part + ", start", {mode: "markers", showlegend: false,
        marker: {size: 8, symbol: "circle-open", color: style(hue)}});
    });
    return {traces, columns, empty, layout: layout(linear(columns[0]),
      {...linear(columns[1]), scaleanchor: "x", scaleratio: 1}, {showlegend: traces.length > 3})};
  };

  // Every run starts at the true state: the first sample would stretch the axis to nothing.
  const late = (values) => values.slice(1);
  const timesOf = (values) => t.filter((_, index) => index % Math.round((t.length - 1) / (values.length - 1)) === 0);
  const history = (run, read, name, more) => {
    const values = own(run, read);
    return logLine(run, late(timesOf(values)), late(values), name, more);
  };
  makers.error = (element) => {
    const {quantity, unit} = element.dataset;
    const axis = quantity + " error (" + unit + ")";
    const traces = comparedCurves().filter((run) => curves[run.label].errors[quantity])
      .map((run) => history(run, (c) => c.errors?.[quantity]));
    return {traces, columns: ["time (s)", axis], layout: layout(linear("time (s)"), log(axis))};
  };
  makers.series = (element) => {
    const {series, axis} = element.dataset;
    const traces = comparedCurves().filter((run) => curves[run.label][series])
      .map((run) => history(run, (c) => c[series]));
    return {traces, columns: ["time (s)", axis], layout: layout(linear("time (s)"), log(axis))};
  };
  makers.levels = () => ({columns: ["time (s)", "largest row (m, m/s or m/s² by curve)"],
    panels: comparedCurves().map((run) => ({title: run.label,
      traces: ["position", "velocity", "acceleration"].map((level, index) => (curves[run.label]["constraint " + level]
        ? history(run, (c) => c["constraint " + level], level, {line: {color: style(HUES[index]), width: 1.5}})
        : null)).filter(Boolean),
      layout: layout(Object.assign(linear("time (s)"), {nticks: 4}), Object.assign(log(""), {range: [-18.3, 1.5], dtick: 6}))}))});
  makers.speed = () => Figures.speed(compared());
  makers.convergence = () => Figures.convergence(compared(), quantitySelect.value, Figures.UNITS[quantitySelect.value]);

  // Events of the true motion are lines in every figure over time, and beside the clock of the player.
  const events = JSON.parse(document.getElementById("scene").dataset.events);
  const marked = (each) => ({...each, layout: {...each.layout, shapes: events.map(([time]) => ({type: "line", x0: time,
    x1: time, yref: "paper", y0: 0, y1: 1, layer: "below", line: {color: style("--dots"), dash: "dot", width: 1}}))}});
  if (events.length) {
    Object.entries(makers).forEach(([figure, make]) => {
      makers[figure] = (element) => {
        const made = make(element);
        if (made.columns?.[0] !== "time (s)") return made;
        return made.panels ? {...made, panels: made.panels.map(marked)} : marked(made);
      };
    });
  }
  const happened = (time) => events.findLast(([each]) => each <= time && time < each + 0.05 * t.at(-1));

  const refresh = Figures.start(() => {
    Figures.legend(compared());
    const place = document.querySelector("[data-body]");
    if (place) place.textContent = scene.bodies[body()];
  });
  const motion = (read) => ({x: truth.drawing.bodies.map((_, index) => [0, 1, 2].map((k) => read((c) => c.x[index][k]))),
    q: truth.drawing.bodies.map((_, index) => [0, 1, 2, 3].map((k) => read((c) => c.q[index][k])))});
  // Where a run's positions are stored as differences from truth, they are its error vectors.
  const apart = (run) => (curves[run.label].x.every((body) => body.every((curve) => curve?.over))
    ? curves[run.label].x.map((body) => body.map(stored)) : null);
  const actors = drawable.map((run) => ({label: run.label, engine: run.engine, colour: run.colour,
    motion: () => ({...motion((read) => own(run, read)), dx: apart(run)})}));
  if (hasTruth) actors.unshift({label: "truth", engine: "", colour: null, motion: () => motion(exact)});
  const wanted = () => ["truth", alone()?.label].filter(Boolean);
  let now = 0;
  const playback = window.Playback.start(truth.drawing, t, actors, wanted(), (time, settled) => {
    now = time;
    Figures.cursor(time);
    const last = happened(time);
    if (last) select("clock").textContent += " · " + last[1] + " " + last[2].replaceAll("_", " ");
    if (settled) remember();
  });

  document.querySelectorAll("#events [data-time]").forEach((button) => button.addEventListener("click", () => {
    playback.seek(Number(button.dataset.time));
    select("stage").scrollIntoView({block: "nearest"});
  }));

  // The address holds the state of the page, after "#": a page from disk may change nothing else.
  const choices = {run: runSelect, compared: groupSelect, body: bodySelect, joint: jointSelect, quantity: quantitySelect};
  const given = Object.entries(choices).filter(([, each]) => each?.options.length);
  const address = () => "#" + new URLSearchParams([["view", ""],
    ...given.map(([key, each]) => [key, each.selectedOptions[0].text]), ...playback.kept(), ["t", now.toPrecision(4)]]);
  let written = "";  // the event of a change comes later, when the reader may have changed more
  const remember = () => { written = address(); window.location.replace(written); };
  function recall() {
    written = window.location.hash;
    const view = new URLSearchParams(written.slice(1));
    if (!view.has("view")) return;
    given.forEach(([key, each]) => {
      const option = [...each.options].find((one) => one.text === view.get(key));
      if (option) each.value = option.value;
    });
    refresh();
    playback.show(wanted());
    playback.recall(view);
    playback.seek(Number(view.get("t")) || 0);
  }
  given.forEach(([, each]) => each.addEventListener("change", () => {
    refresh();
    if (each === runSelect) playback.show(wanted());
    remember();
  }));
  window.addEventListener("hashchange", () => { if (window.location.hash !== written) recall(); });
  recall();
})();
