// Makes one run stand out in all figures of a page, and the legend that chooses it.
"use strict";
window.Emphasis = (function () {
  // The run at the pointer or the keyboard focus stands out, or those clicked, until the next click or Escape.
  let pointed = null;
  const isolated = new Set();
  function emphasise() {
    const kept = isolated.size ? isolated : pointed ? new Set([pointed]) : null;
    document.querySelectorAll("[data-figure] .trace").forEach((node) => {
      const name = node.__data__?.[0]?.trace?.meta;
      node.style.opacity = !kept || !name || kept.has(name) ? "" : isolated.size ? "0.06" : "0.15";
    });
    document.querySelectorAll("[data-legend] button").forEach((button) => {
      button.setAttribute("aria-pressed", String(isolated.has(button.dataset.run)));
      button.classList.toggle("away", Boolean(isolated.size) && !isolated.has(button.dataset.run));
    });
  }
  function point(name) {
    pointed = name ?? null;
    emphasise();
  }
  function isolate(name, more) {
    if (!name) return;
    const only = isolated.size === 1 && isolated.has(name);
    if (more) {
      isolated[isolated.has(name) ? "delete" : "add"](name);
    } else {
      isolated.clear();
      if (!only) isolated.add(name);
    }
    emphasise();
  }
  document.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    isolated.clear();
    emphasise();
  });

  const SVG = "http://www.w3.org/2000/svg";
  function entry(run) {
    const button = document.createElement("button");
    button.type = "button";
    button.dataset.run = run.label;
    button.title = "click: this one alone; with Shift: this one too";
    const sample = document.createElementNS(SVG, "svg"), stroke = document.createElementNS(SVG, "line");
    sample.setAttribute("width", "34");
    sample.setAttribute("height", "10");
    sample.setAttribute("aria-hidden", "true");
    Object.entries({x1: 0, x2: 34, y1: 5, y2: 5, stroke: run.colour, "stroke-width": 2}).forEach(
      ([key, value]) => stroke.setAttribute(key, value));
    if (run.dash !== "solid") stroke.setAttribute("stroke-dasharray", run.dash.replaceAll("px", ""));
    sample.append(stroke);
    const sign = document.createElement("span");
    sign.textContent = run.sign;
    sign.style.color = run.colour;
    sign.setAttribute("aria-hidden", "true");
    button.append(sample, sign, " " + run.label.slice(run.engine.length + 1));
    return button;
  }
  function legend(runs) {
    const rows = {};
    runs.forEach((run) => {
      if (!rows[run.engine]) {
        rows[run.engine] = document.createElement("div");
        const name = document.createElement("b");
        name.textContent = run.engine;
        rows[run.engine].append(name);
      }
      rows[run.engine].append(entry(run));
    });
    document.querySelectorAll("[data-legend]").forEach((place) => {
      place.replaceChildren(...Object.values(rows).map((row) => row.cloneNode(true)));
      place.querySelectorAll("button").forEach((button) => {
        const name = button.dataset.run;
        button.addEventListener("click", (event) => isolate(name, event.shiftKey || event.ctrlKey));
        ["mouseenter", "focus"].forEach((each) => button.addEventListener(each, () => point(name)));
        ["mouseleave", "blur"].forEach((each) => button.addEventListener(each, () => point(null)));
      });
    });
    emphasise();
  }

  return {emphasise, point, isolate, legend};
})();
