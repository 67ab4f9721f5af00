// Draws the figures of a scene page from window.CROSSCHECK. It places and colours numbers; it computes none.
"use strict";
(function () {
  const data = window.CROSSCHECK;
  const curves = data.scene.curves;
  const runSelect = document.getElementById("run");
  const groupSelect = document.getElementById("group");
  const bodySelect = document.getElementById("body");  // only where there are several
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const SMALLEST = 1e-18;  // where an exact zero is drawn on a logarithmic axis
  const PALETTE = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#8c6bb1", "#7f7f7f"];
  const DASHES = {lieeuler: "solid", mujoco: "dash", pinocchio: "dot", exudyn: "dashdot"};
  const SYMBOLS = {lieeuler: "circle", mujoco: "square", pinocchio: "diamond", exudyn: "triangle-up"};

  const counters = {};
  // Coarse runs take their colours last, so that a method keeps its colour on every page.
  [...data.runs].sort((one, other) => one.practical - other.practical).forEach((run) => {
    const index = counters[run.engine] = (counters[run.engine] ?? -1) + 1;
    run.colour = PALETTE[index % PALETTE.length];
    run.dash = DASHES[run.engine] ?? "longdash";
    run.symbol = SYMBOLS[run.engine] ?? "star";
  });

  const groups = [
    ["eight Euler methods and the engines", (run) => !run.practical && (run.euler || run.engine !== "lieeuler")],
    ["eight Euler methods", (run) => !run.practical && run.euler],
    ["engines", (run) => !run.practical && run.engine !== "lieeuler"],
    ["coarse steps", (run) => run.practical],
    ["every run", () => true],
  ].filter(([, keep]) => data.runs.some(keep));
  groups.forEach(([name], index) => groupSelect.add(new Option(name, index)));
  data.runs.forEach((run, index) => { if (run.curves.t) runSelect.add(new Option(run.label, index)); });
  const preferred = data.runs.findIndex((run) => run.label.startsWith("lieeuler DAE1L_LSE") && run.curves.t);
  if (preferred >= 0) runSelect.value = preferred;

  const alone = () => data.runs[runSelect.value];
  const compared = () => data.runs.filter(groups[groupSelect.value][1]);
  const positive = (values) => values.map((value) => (value === null ? null : Math.max(value, SMALLEST)));

  function layout(x, y, extra) {
    const axis = (more) => Object.assign({
      gridcolor: style("--grid"), zerolinecolor: style("--line"),
      linecolor: style("--line"), automargin: true, exponentformat: "power", tickfont: {size: 11}}, more);
    return Object.assign({
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: {color: style("--text")},
      margin: {l: 10, r: 10, t: 10, b: 10}, showlegend: false, hovermode: "closest",
      legend: {orientation: "h", y: -0.22, font: {size: 11}},
      xaxis: axis(x), yaxis: axis(y)}, extra);
  }
  const linear = (title) => ({title: {text: title, standoff: 6, font: {size: 12}}});
  const log = (title) => Object.assign(linear(title), {type: "log"});
  const config = {displaylogo: false, responsive: true, modeBarButtonsToRemove: ["select2d", "lasso2d"]};
  const draw = (element, traces, plan, more) => Plotly.react(element, traces, plan, Object.assign({}, config, more));

  const line = (run, y, name) => ({
    x: run.curves.t, y, name: name ?? run.label, mode: "lines",
    line: {color: run.colour, dash: run.dash, width: 1.6},
    hovertemplate: "%{y:.2e} at %{x:.3g} s<extra>" + (name ?? run.label) + "</extra>"});

  const plots = {
    trajectory(element) {
      const run = alone();
      const path = (x, name, colour, width, dash) => ({
        type: "scatter3d", mode: "lines", x: x[0], y: x[1], z: x[2], name,
        line: {color: colour, width, dash}, hovertemplate: "(%{x:.3g}, %{y:.3g}, %{z:.3g}) m<extra>" + name + "</extra>"});
      const hues = [style("--blue"), style("--orange"), style("--green")];
      const traces = [];
      data.scene.bodies.forEach((body, index) => {
        if (curves.t) traces.push(path(curves.x[index], body + ", truth", style("--quiet"), 6));
        traces.push(path(run.curves.x[index], body, hues[index % 3], 3));
      });
      const axis = (title) => ({title: {text: title + " (m)"}, gridcolor: style("--grid"), color: style("--text"),
        zerolinecolor: style("--line"), showbackground: false});
      draw(element, traces, layout({}, {}, {
        showlegend: true, legend: {orientation: "h", y: 0, font: {size: 11}},
        scene: {xaxis: axis("x"), yaxis: axis("y"), zaxis: axis("z"), aspectmode: "data"}}));
    },
    energies(element) {
      const run = alone();
      const traces = [];
      [["kinetic", "--blue"], ["potential", "--orange"], ["total", "--green"]].forEach(([name, colour]) => {
        const trace = line(run, run.curves[name], name);
        trace.line = {color: style(colour), width: 2};
        traces.push(trace);
        if (!curves.t) return;
        const truth = line(run, curves[name], name + ", truth");
        truth.x = curves.t;
        truth.line = {color: style("--text"), width: 1.2, dash: "dot"};
        truth.showlegend = name === "total";
        truth.name = "truth";
        traces.push(truth);
      });
      draw(element, traces, layout(linear("time (s)"), linear("energy (J)"), {showlegend: true}));
    },
    error(element) {
      const quantity = element.dataset.quantity;
      const traces = compared().filter((run) => run.curves.t)
        .map((run) => line(run, positive(run.curves.errors[quantity])));
      // Every run starts at the true state: the first sample would stretch the axis to nothing.
      traces.forEach((trace) => { trace.x = trace.x.slice(1); trace.y = trace.y.slice(1); });
      draw(element, traces, layout(linear("time (s)"), log(quantity + " error (" + element.dataset.unit + ")")));
    },
    series(element) {
      const traces = compared().filter((run) => run.curves.t)
        .map((run) => line(run, positive(run.curves[element.dataset.series])));
      // The start is exact, and would stretch the axis to nothing.
      traces.forEach((trace) => { trace.x = trace.x.slice(1); trace.y = trace.y.slice(1); });
      draw(element, traces, layout(linear("time (s)"), log(element.dataset.axis)));
    },
    speed(element) {
      const traces = compared().map((run) => [run, run.timing.length ? run.timing : run.ladder
        .filter((rung) => rung.wall_time !== null)
        .map((rung) => ({wall_time: rung.wall_time, error: rung.end.position, step: rung.step}))])
        .filter(([, points]) => points.length)
        .map(([run, points]) => markers(run, points.map((point) => 1e3 * point.wall_time),
          points.map((point) => point.error), points.map((point) => point.step)));
      draw(element, traces, layout(log("stepping time (ms)"), log("position error at the end (m)")));
    },
    convergence(element) {
      const traces = [];
      compared().filter((run) => run.documented_order && run.ladder.length).forEach((run) => {
        const steps = run.ladder.map((rung) => rung.step);
        traces.push({x: steps, y: run.ladder.map((rung) => (rung.guide > 1e-16 ? rung.guide : null)), mode: "lines", hoverinfo: "skip",
          line: {color: style("--quiet"), width: 1, dash: "dot"}});
        traces.push(markers(run, steps, run.ladder.map((rung) => rung.errors.position ?? null), steps));
      });
      draw(element, traces, layout(log("step (s)"), log("largest position error (m)")));
    },
  };

  function markers(run, x, y, steps) {
    return {x, y: positive(y), customdata: steps, name: run.label, mode: "lines+markers",
      line: {color: run.colour, dash: run.dash, width: 1.6}, marker: {color: run.colour, symbol: run.symbol, size: 7},
      hovertemplate: "%{y:.2e} m, step %{customdata:.2e} s<extra>" + run.label + "</extra>"};
  }

  function panel(parent, title) {
    const box = document.createElement("div");
    box.className = "panel";
    const head = document.createElement("h4");
    head.textContent = title;
    const plot = document.createElement("div");
    plot.className = "plot";
    box.append(head, plot);
    parent.append(box);
    return plot;
  }

  const panels = {
    constraints(parent) {
      const hues = {position: "--blue", velocity: "--orange", acceleration: "--green"};
      compared().filter((run) => run.curves.t).forEach((run) => {
        const traces = Object.entries(hues).filter(([level]) => run.curves["constraint " + level]).map(([level, hue]) => {
          const trace = line(run, positive(run.curves["constraint " + level]), level);
          trace.line = {color: style(hue), width: 1.5};
          return trace;
        });
        const y = Object.assign(log("m, m/s, m/s²"), {range: [-18.3, 1.5], dtick: 6});
        draw(panel(parent, run.label), traces, layout(linear("time (s)"), y), {displayModeBar: false});
      });
    },
    attitude(parent) {
      const run = alone();
      const body = bodySelect ? Number(bodySelect.value) : 0;
      for (let element = 0; element < 9; element += 1) {
        const name = "R" + "₁₂₃"[Math.floor(element / 3)] + "₁₂₃"[element % 3];
        const truth = {x: curves.t ?? [], y: curves.t ? curves.R[body][element] : [], mode: "markers", marker: {color: style("--quiet"), size: 3},
          hoverinfo: "skip"};
        const trace = line(run, run.curves.R[body][element], name);
        trace.line = {color: style("--blue"), width: 1.6};
        const y = Object.assign(linear(name + " (1)"), {range: [-1.1, 1.1], dtick: 1});
        draw(panel(parent, name), [truth, trace], layout(linear("time (s)"), y), {displayModeBar: false});
      }
    },
  };

  function legend() {
    const words = {solid: "solid, ●", dash: "dashed, ■", dot: "dotted, ◆", dashdot: "dash-dotted, ▲"};
    const rows = {};
    compared().forEach((run) => {
      if (!rows[run.engine]) {
        rows[run.engine] = document.createElement("div");
        const name = document.createElement("b");
        name.textContent = run.engine + ": " + (words[run.dash] ?? "long dashes, ★");
        rows[run.engine].append(name);
      }
      const entry = document.createElement("span");
      const chip = document.createElement("i");
      chip.style.setProperty("--c", run.colour);
      entry.append(chip, run.label.slice(run.engine.length + 1));
      rows[run.engine].append(entry);
    });
    document.getElementById("legend").replaceChildren(...Object.values(rows));
  }

  // A figure is drawn when it comes near the window, so that a page with many opens at once.
  const drawn = new Set();
  function render(element) {
    drawn.add(element);
    if (element.dataset.plot) { plots[element.dataset.plot](element); return; }
    element.querySelectorAll(".plot").forEach((plot) => Plotly.purge(plot));
    element.replaceChildren();
    panels[element.dataset.panels](element);
  }
  const watcher = new IntersectionObserver((entries) => entries.forEach((entry) => {
    if (entry.isIntersecting && !drawn.has(entry.target)) render(entry.target);
  }), {rootMargin: "400px"});
  document.querySelectorAll("[data-plot], [data-panels]").forEach((element) => watcher.observe(element));

  function refresh() { legend(); drawn.forEach(render); }
  runSelect.addEventListener("change", refresh);
  groupSelect.addEventListener("change", refresh);
  if (bodySelect) bodySelect.addEventListener("change", refresh);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", refresh);
  window.addEventListener("beforeprint", () => document.querySelectorAll("[data-plot], [data-panels]").forEach(render));
  legend();
})();
