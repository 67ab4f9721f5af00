// What all figures share: colours, layout, the CSV and SVG links. It places and colours numbers; it computes none.
"use strict";
window.Figures = (function () {
  const SMALLEST = 1e-18;  // where an exact zero is drawn on a logarithmic axis
  const MOST_NAMES = 14;  // lines that are named at their ends; of more, hovering tells the names
  const {emphasise, point, isolate, legend} = window.Emphasis;

  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const narrow = () => window.innerWidth < 600;

  // The look of every method is the document's (crosscheck.report.identity).
  const {looks} = window.CROSSCHECK_RUNS;
  const dark = () => document.documentElement.dataset.theme === "dark";
  const parsed = new Map();
  function runsOf(scene) {
    if (parsed.has(scene)) return parsed.get(scene);
    const runs = JSON.parse(window.CROSSCHECK_RUNS.runs[scene]);
    runs.forEach((run) => {
      const [light, ondark, dash, symbol, sign] = looks[run.engine][run.label];
      Object.defineProperty(run, "colour", {get: () => (dark() ? ondark : light)});
      Object.assign(run, {dash, symbol, sign});
    });
    parsed.set(scene, runs);
    return runs;
  }

  const linear = (title) => ({title: {text: title, standoff: 6, font: {size: 12}}});
  const log = (title) => Object.assign(linear(title), {type: "log"});
  function layout(x, y, extra) {
    const axis = (more) => Object.assign({
      gridcolor: style("--grid"), zerolinecolor: style("--line"), linecolor: style("--line"), automargin: true,
      exponentformat: "power", tickfont: {size: 11}, nticks: narrow() ? 6 : 9}, more);
    return Object.assign({
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: {color: style("--text")},
      margin: {l: 10, r: 12, t: 12, b: 10}, showlegend: false, hovermode: "closest", dragmode: narrow() ? false : "zoom",
      legend: {orientation: "h", y: -0.2, yanchor: "top", font: {size: 11}}, xaxis: axis(x), yaxis: axis(y)}, extra);
  }
  const config = () => ({displaylogo: false, responsive: true, displayModeBar: narrow() ? false : "hover",
    modeBarButtonsToRemove: ["select2d", "lasso2d", "toImage"]});

  const positive = (values) => values.map((value) => (value === null ? null : Math.max(value, SMALLEST)));

  // A trace; `raw` keeps what zeros are drawn in place of, for the CSV.
  const line = (run, x, y, name, more) => Object.assign({
    x, y, name: name ?? run.label, meta: run.label, mode: "lines", line: {color: run.colour, dash: run.dash, width: 1.6},
    hovertemplate: "%{y:.3g} at %{x:.3g} s<extra>" + (name ?? run.label) + "</extra>"}, more);
  const logLine = (run, x, values, name, more) => line(run, x, positive(values), name, {raw: values, ...more});
  const markers = (run, x, values, steps, name) => ({
    x, y: positive(values), raw: values, customdata: steps, name: name ?? run.label, meta: run.label, mode: "lines+markers",
    line: {color: run.colour, dash: run.dash, width: 1.6}, marker: {color: run.colour, symbol: run.symbol, size: 7},
    hovertemplate: "%{y:.2e}, step %{customdata:.3~g} s<extra>" + (name ?? run.label) + "</extra>"});

  // A maker returns {traces, layout, columns} or, for a figure of many panels, {panels: [{title, traces, layout}], columns}.
  const makers = {};
  const drawn = new Set();

  // One cursor on every plot over time, where playback is.
  let present = null;
  function cursor(time) {
    present = time ?? present;
    if (present === null) return;
    document.querySelectorAll(".timed.js-plotly-plot, .timed .js-plotly-plot").forEach((plot) => {
      const axis = plot._fullLayout?.xaxis, size = plot._fullLayout?._size;
      if (!axis || !size) return;
      let bar = plot.querySelector(":scope > .cursor");
      if (!bar) {
        bar = document.createElement("i");
        bar.className = "cursor";
        plot.append(bar);
      }
      const at = axis.c2p(present);
      bar.hidden = at < 0 || at > axis._length;
      Object.assign(bar.style, {left: axis._offset + at + "px", top: size.t + "px", height: size.h + "px"});
    });
  }

  // Plotly leaves its class behind, which would hide that nothing listens to the element any more.
  function clear(element) {
    Plotly.purge(element);
    element.classList.remove("js-plotly-plot");
  }
  function draw(element) {
    drawn.add(element);
    const figure = makers[element.dataset.figure](element);
    element.columns = figure.columns;
    element.classList.toggle("timed", figure.columns[0] === "time (s)");
    element.querySelectorAll(":scope > .panel > .plot").forEach((plot) => Plotly.purge(plot));
    if (figure.panels) {
      element.series = figure.panels.flatMap((panel) => panel.traces.map((trace) => ({...trace, panel: panel.title})));
      element.replaceChildren();
      figure.panels.forEach((panel) => Plotly.newPlot(addPanel(element, panel.title), panel.traces, panel.layout,
        {...config(), displayModeBar: false}));
      cursor();
      return;
    }
    element.series = figure.traces;
    element.classList.toggle("empty", !figure.traces.length);
    if (figure.height) element.style.height = figure.height + "px";
    if (!figure.traces.length) {
      clear(element);
      element.textContent = figure.empty ?? "no data for this choice";
      return;
    }
    if (!element.classList.contains("js-plotly-plot")) element.textContent = "";
    ticks(figure, "x");
    ticks(figure, "y");
    nameEnds(element, figure);
    const first = !element.classList.contains("js-plotly-plot");
    Plotly.react(element, figure.traces, figure.layout, config()).then(() => cursor());
    if (first) {
      element.on("plotly_hover", (event) => point(event.points[0].data.meta));
      element.on("plotly_unhover", () => point(null));
      element.on("plotly_click", (event) => isolate(event.points[0].data.meta));
      element.on("plotly_afterplot", () => { emphasise(); cursor(); });
    }
  }

  // Names at the ends of lines, moved apart where they would cover each other.
  function nameEnds(element, figure) {
    const named = figure.traces.filter((trace) => trace.meta && !trace.guide);
    if (narrow() || !named.length || named.length > MOST_NAMES || new Set(named.map((trace) => trace.meta)).size < named.length
      || figure.layout.showlegend) return;
    const scaled = (axis, value) => (figure.layout[axis].type === "log" ? Math.log10(value) : value);
    const ends = named.map((trace) => {
      let last = -1;
      trace.x.forEach((x, index) => {
        if (x !== null && trace.y[index] !== null && (last < 0 || scaled("xaxis", x) >= scaled("xaxis", trace.x[last]))) last = index;
      });
      return last < 0 ? null : {trace, x: scaled("xaxis", trace.x[last]), y: scaled("yaxis", trace.y[last])};
    }).filter(Boolean).sort((one, other) => one.y - other.y);
    // All traces count: a bound far above the others stretches the axis.
    const all = figure.traces.flatMap((trace) => trace.y).filter((value) => value !== null)
      .map((value) => scaled("yaxis", value)).filter(Number.isFinite);
    const low = Math.min(...all), high = Math.max(...all);
    const perUnit = Math.max(100, element.clientHeight - 70) / (1.1 * (high - low) || 1);
    let before = -Infinity;
    figure.layout.annotations = [...(figure.layout.annotations ?? []), ...ends.map((end) => {
      const pixel = (end.y - low) * perUnit, at = Math.max(pixel, before + 12);
      before = at;
      return {x: 1, xref: "paper", y: end.y, text: end.trace.meta, showarrow: false, xanchor: "left", xshift: 4,
        yshift: at - pixel, font: {size: 10, color: end.trace.line?.color ?? end.trace.marker.color}};
    })];
    const longest = Math.max(...ends.map((end) => end.trace.meta.length));
    figure.layout.margin = {...figure.layout.margin, r: 14 + 5.6 * longest};
  }

  // Marks whole decades on a logarithmic axis, but not too many; digits between them only where there is hardly one.
  function ticks(figure, side) {
    const axis = figure.layout[side + "axis"];
    if (axis.type !== "log" || axis.dtick) return;
    const values = figure.traces.flatMap((trace) => trace[side]).filter((value) => value > 0);
    const decades = Math.log10(values.reduce((one, other) => Math.max(one, other), 1e-300)
      / values.reduce((one, other) => Math.min(one, other), 1e300));
    axis.dtick = decades < 1.2 ? "D2" : Math.ceil(decades / (narrow() ? 5 : 8));
  }

  function addPanel(parent, title) {
    const box = document.createElement("div");
    box.className = "panel";
    const head = document.createElement("h3");
    head.textContent = title;
    const plot = document.createElement("div");
    plot.className = "plot";
    box.append(head, plot);
    parent.append(box);
    return plot;
  }

  const cell = (value) => (value === null || value === undefined ? "" : typeof value === "number"
    ? String(Number(value.toPrecision(5))) : /[",\n]/.test(value) ? '"' + value.replaceAll('"', '""') + '"' : value);
  function csv(element) {
    const panels = element.series.some((trace) => trace.panel);
    const rows = [[...(panels ? ["panel"] : []), "curve", ...element.columns]];
    element.series.filter((trace) => !trace.guide).forEach((trace) => {
      const y = trace.raw ?? trace.y;
      (trace.rawX ?? trace.x).forEach((x, index) => rows.push([...(panels ? [trace.panel] : []), trace.name, x, y[index]]));
    });
    return rows.map((row) => row.map(cell).join(",")).join("\n") + "\n";
  }

  const pageName = () => window.location.pathname.split("/").pop().replace(/\.html$/, "");
  function nameOf(element) {
    const {figure, quantity, series} = element.dataset;
    return [pageName(), figure, quantity ?? series].filter(Boolean).join("-").replaceAll(" ", "-");
  }
  function link(text, name, make) {
    const anchor = document.createElement("a");
    anchor.textContent = text;
    anchor.href = "#";
    anchor.download = name;
    anchor.addEventListener("click", async (event) => {
      event.preventDefault();
      const target = document.createElement("a");
      target.href = await make();
      target.download = name;
      target.click();
      if (target.href.startsWith("blob:")) setTimeout(() => URL.revokeObjectURL(target.href), 10000);
    });
    return anchor;
  }
  async function ready(element) {
    await library();
    if (!drawn.has(element)) draw(element);
  }
  function addLinks(element) {
    const caption = element.parentElement.querySelector("figcaption");
    const links = document.createElement("span");
    links.className = "links";
    links.append(link("CSV", nameOf(element) + ".csv", async () => {
      await ready(element);
      return URL.createObjectURL(new Blob([csv(element)], {type: "text/csv"}));
    }));
    if (element.classList.contains("plot")) links.append(link("SVG", nameOf(element) + ".svg", () => svg(element)));
    caption.append(" ", links);
  }
  // Always in the light colours: it is for paper.
  async function svg(element) {
    await library();
    const root = document.documentElement;
    const theme = root.dataset.theme;
    root.dataset.theme = "light";
    const figure = makers[element.dataset.figure](element);
    root.dataset.theme = theme;
    return Plotly.toImage({data: figure.traces, layout: {...figure.layout, showlegend: true,
      legend: {font: {size: 9}}}}, {format: "svg", width: 640, height: figure.height ?? 420});
  }

  // Groups of runs to compare; `preferred` first.
  function groups(runs) {
    const best = {};
    runs.filter((run) => ["pass", "known", "unresolved"].includes(run.outcome)).forEach((run) => {
      const error = run.errors.position?.max ?? Infinity;
      if (!best[run.engine] || error < (best[run.engine].errors.position?.max ?? Infinity)) best[run.engine] = run;
    });
    const euler = runs.some((run) => run.euler);
    const orders = [...new Set(runs.filter((run) => run.documented_order).map((run) => run.documented_order))];
    return [
      ["best of each engine", (run) => best[run.engine] === run],
      ["eight Euler methods, best of each engine", (run) => euler && (run.euler || best[run.engine] === run)],
      ["eight Euler methods", (run) => run.euler],
      ["established engines", (run) => run.engine !== "lieeuler"],
      ...orders.sort((one, other) => one - other).map((order) => [
        "order " + order, (run) => run.documented_order === order]),
      ["adaptive", (run) => run.rtol],
      ...Object.keys(looks).map((engine) => [engine, (run) => run.engine === engine]),
      ["every run", () => true],
    ].filter(([, keep]) => runs.some(keep));
  }

  // One figure after the other, each shown before the next is drawn.
  const waiting = [];
  function next() {
    const element = waiting.shift();
    if (waiting.length) setTimeout(next);
    if (!drawn.has(element)) draw(element);
  }

  function start(refreshed) {
    const all = [...document.querySelectorAll("[data-figure]")];
    all.forEach(addLinks);
    // A figure is drawn when it comes near the window, so that a page with many opens at once.
    const watcher = new IntersectionObserver((entries) => {
      const near = entries.filter((entry) => entry.isIntersecting && !drawn.has(entry.target));
      if (near.length && !waiting.length) library().then(next);
      waiting.push(...near.map((entry) => entry.target));
    }, {rootMargin: "400px"});
    window.addEventListener("load", () => {
      all.forEach((element) => watcher.observe(element));
      setTimeout(library);
    });
    // What is folded has no size: it is drawn when it comes into sight again.
    const refresh = () => {
      refreshed?.();
      drawn.forEach((element) => { if (element.offsetParent) draw(element); else drawn.delete(element); });
    };
    document.addEventListener("themechange", refresh);
    const anew = () => all.forEach((element) => { clear(element); draw(element); });
    ["beforeprint", "afterprint"].forEach((event) => window.addEventListener(event, () => {
      if (window.Plotly) anew();
    }));
    refreshed?.();
    return refresh;
  }

  // Pages of scenes, engines and studies all have speed and convergence.
  function speed(runs) {
    const traces = runs.map((run) => [run, run.timing]).filter(([, points]) => points.length)
      .map(([run, points]) => markers(run, points.map((point) => 1e3 * point.wall_time),
        points.map((point) => point.error ?? null), points.map((point) => point.step ?? point.rtol)))
      .map((trace) => ({...trace, mode: "markers"}));
    const front = pareto(traces);
    if (front.x.length > 1) {
      traces.unshift({...front, mode: "lines", name: "best of all", hoverinfo: "skip", guide: true, showlegend: false,
        line: {color: style("--quiet"), width: 1.2, dash: "dot", shape: "hv"}});
    }
    return {traces, columns: ["stepping time (ms)", "largest position error (m)"],
      layout: layout(log("stepping time (ms)"), log("largest position error (m)"))};
  }
  // The points that no other beats in both, from left to right.
  function pareto(traces) {
    const points = traces.flatMap((trace) => trace.x.map((x, index) => [x, trace.y[index]]))
      .filter(([x, y]) => x !== null && y !== null).sort((one, other) => one[0] - other[0]);
    const front = {x: [], y: []};
    points.forEach(([x, y]) => {
      if (front.y.length && y >= front.y.at(-1)) return;
      front.x.push(x);
      front.y.push(y);
    });
    return front;
  }
  function convergence(runs, quantity, unit) {
    const traces = [], notes = [];
    runs.filter((run) => run.documented_order && run.ladder.length).forEach((run) => {
      const steps = run.ladder.map((rung) => rung.step);
      const values = run.ladder.map((rung) => rung.errors[quantity] ?? null);
      const slope = steps.map((step) => values[0] * (step / steps[0]) ** run.documented_order);
      traces.push({x: steps, y: slope.map((y) => (y > 1e-16 ? y : null)), mode: "lines", hoverinfo: "skip",
        guide: true, showlegend: false, line: {color: style("--quiet"), width: 1, dash: "dot"}});
      const order = run.order;
      const name = run.label + (order ? ", order " + order.toFixed(2) : "");
      traces.push(markers(run, steps, values, steps, name));
      if (order && values[0] > 0) {
        notes.push({x: Math.log10(steps[0]), y: Math.log10(values[0]), text: order.toFixed(2), showarrow: false,
          xanchor: "left", xshift: 6, font: {size: 10, color: run.colour}});
      }
    });
    return {traces, columns: ["step (s)", "largest " + quantity + " error (" + unit + ")"],
      layout: layout(log("step (s)"), log("largest " + quantity + " error (" + unit + ")"),
        {annotations: apart(notes), margin: {l: 10, r: 40, t: 12, b: 10}})};
  }
  // Leaves out notes that would cover each other; hovering still shows them.
  function apart(notes) {
    const kept = [];
    notes.sort((one, other) => one.y - other.y).forEach((note) => {
      if (kept.every((each) => Math.abs(each.y - note.y) > 0.45 || Math.abs(each.x - note.x) > 0.25)) kept.push(note);
    });
    return kept;
  }

  return {runsOf, style, narrow, linear, log, layout, line, logLine, markers, makers, legend, groups, start, speed, cursor,
    convergence, positive, UNITS: {position: "m", attitude: "rad", velocity: "m/s", "angular velocity": "rad/s"}};
})();
