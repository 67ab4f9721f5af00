// The first page's answer to: which method of my engine, at which step? It reads the rows of the page and its address.
"use strict";
(function () {
  const rows = window.CROSSCHECK_ADVICE;
  if (!rows) return;
  const [scene, error, engine] = ["scene", "error", "engine"].map((name) => document.getElementById("decide-" + name));
  const answer = document.getElementById("decide-answer"), body = document.querySelector("#decide-table tbody");
  const levels = [...new Set(rows.map((row) => row.wanted))].sort((one, other) => other - one);
  const ours = (name) => name === "lieeuler";  // last: the reader came with another one
  const engines = [...new Set(rows.map((row) => row.engine))].sort((one, other) => ours(one) - ours(other));
  const power = (value) => value.toExponential(0).replace("e-", "e\u2212");
  levels.forEach((level) => error.add(new Option(power(level), level)));
  engines.forEach((name) => engine.add(new Option(name, name)));
  error.value = levels.find((level) => level <= 1.01e-4) ?? levels[0];
  if ([...scene.options].some((option) => option.value === "double_pendulum")) scene.value = "double_pendulum";

  const short = (value, digits = 2) => (value === null ? "–" : value === 0 ? "0"
    : Math.abs(value) >= 0.01 && Math.abs(value) < 1000 ? String(Number(value.toPrecision(digits + 1)))
    : value.toExponential(digits - 1));
  const size = (row) => (row.step ? Number(row.step.toPrecision(3)) + " s" : "rtol " + Number(row.rtol.toPrecision(3)));
  const breaks = (row) => (row.breaks_at === null ? "at none tried"
    : size(row.step ? {step: row.breaks_at} : {rtol: row.breaks_at}));
  const basis = (row) => "breaks " + (row.breaks_at === null ? "" : "at ") + breaks(row);
  const node = (tag, text) => Object.assign(document.createElement(tag), {textContent: text});
  // A line of a command ends at a space, never within "--step".
  function command(text) {
    const code = node("code", "");
    text.split(" ").forEach((word, index) => code.append(index ? " " : "", node("span", word)));
    return code;
  }

  function show() {
    const found = rows.filter((row) => row.scene === scene.value && row.wanted === Number(error.value));
    const mine = found.find((row) => row.engine === engine.value);
    const parts = [];
    if (!mine) {
      parts.push(engine.value + " cannot model this scene, or was not tried on it.");
    } else if (mine.method === null) {
      parts.push(mine.engine + ": not " + mine.tried + "; the least error found is " + short(mine.least) + ".");
    } else {
      parts.push(node("b", mine.method), (mine.form ? " (form " + mine.form + ")" : "") + " of " + mine.engine + " at "
        + (mine.step ? "step " : "") + size(mine) + ": error " + short(mine.error) + " of its size for "
        + short(1e3 * mine.cost) + " ms of stepping; " + basis(mine) + ". ",
        command(mine.command));
    }
    answer.replaceChildren(...parts);
    const reached = found.some((row) => !ours(row.engine) && row.method !== null);
    const shown = found.filter((row) => !reached || !ours(row.engine) || row.engine === engine.value);
    body.replaceChildren(...shown.sort((one, other) => (one.cost ?? Infinity) - (other.cost ?? Infinity)).map((row) => {
      const line = document.createElement("tr");
      if (row.engine === engine.value) line.className = "mine";
      const head = node("th", row.engine);
      head.scope = "row";
      line.append(head);
      const cells = row.method === null ? ["not found", "", short(row.least), "", ""]
        : [row.method, size(row), short(row.error), short(1e3 * row.cost),
          breaks(row)];
      ["method", "step", "error, of size", "cost, ms", "breaks at"].forEach((label, index) => {
        const cell = node("td", cells[index]);
        cell.dataset.label = label;
        if (index) cell.className = "n";
        line.append(cell);
      });
      return line;
    }));
  }
  // A page from disk may change only what follows "#" in its address.
  function remember() {
    window.location.replace("#decide=" + [scene, error, engine].map((each) => encodeURIComponent(each.value)).join(","));
  }
  function recall() {
    const [key, values] = window.location.hash.slice(1).split("=");
    if (key !== "decide" || !values) return;
    values.split(",").forEach((value, index) => {
      const select = [scene, error, engine][index], wanted = decodeURIComponent(value);
      if (select && [...select.options].some((option) => option.value === wanted)) select.value = wanted;
    });
  }
  [scene, error, engine].forEach((each) => each.addEventListener("change", () => { remember(); show(); }));
  window.addEventListener("hashchange", () => { recall(); show(); });
  recall();
  show();
})();
