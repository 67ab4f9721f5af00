// Tables that sort by a click on a heading and filter by words and verdict.
"use strict";
(function () {
  // Spellings of a method in the papers behind lieeuler, doi:10.1177/1687814019842406.
  const SPELLINGS = {dae1_iels: "dae1l_lse", dae1l_les: "dae1l_lse"};
  const OUTCOMES = ["error", "fail", "unresolved", "known", "pass", "unsupported"];

  const FIRST = 8;  // rows of a long table that a phone shows at first
  const phone = window.matchMedia("(max-width: 760px)");
  const printed = document.documentElement.classList.contains("printed");

  const value = (row, column) => {
    const cell = row.cells[column];
    if (!cell) return "";
    const text = (cell.dataset.sort ?? cell.textContent).trim();
    const rank = OUTCOMES.indexOf(text);
    return rank >= 0 && cell.querySelector(".tag") ? String(rank) : text;
  };
  const isNumber = (text) => text !== "" && Number.isFinite(Number(text));

  // Numbers come before words and words before empty cells, whichever way the column is sorted.
  function compare(one, other, down) {
    const rank = (text) => (isNumber(text) ? 0 : text === "" || text === "–" ? 2 : 1);
    if (rank(one) !== rank(other)) return rank(one) - rank(other);
    const order = rank(one) === 0 ? Number(one) - Number(other) : one.localeCompare(other, "en", {numeric: true});
    return down ? -order : order;
  }

  function sortable(table) {
    const heads = [...table.tHead.rows[0].cells];
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        heads.forEach((each) => each.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const body = table.tBodies[0];
        body.append(...[...body.rows].sort((one, other) => compare(value(one, column), value(other, column), down)));
        table.dispatchEvent(new Event("sorted"));
      });
    });
  }

  function filterable(table) {
    const rows = [...table.tBodies[0].rows];
    // If the page shows one scene at a time, so does the table: all scenes would be thousands of rows.
    // The page of an engine without figures has no scene to choose.
    const scene = rows[0]?.dataset.scene === undefined ? null : document.querySelector('[data-choose="scene"]');
    if (rows.length < 6 && !scene) return;
    const bar = document.createElement("div");
    bar.className = "filter";
    const words = document.createElement("input");
    words.type = "search";
    words.placeholder = "filter by words";
    words.setAttribute("aria-label", "filter the rows by words");
    const verdict = document.createElement("select");
    verdict.setAttribute("aria-label", "filter the rows by verdict");
    const outcomes = OUTCOMES.filter((outcome) => table.querySelector("tbody .tag." + outcome));
    verdict.add(new Option("every verdict", ""));
    outcomes.forEach((outcome) => verdict.add(new Option(outcome, outcome)));
    const count = document.createElement("span");
    count.className = "quiet";
    count.setAttribute("role", "status");
    const every = document.createElement("input");
    every.type = "checkbox";
    every.checked = printed;
    const label = document.createElement("label");
    label.append(every, " every scene");
    // A phone shows the first rows of a long table, and the rest when asked.
    let whole = rows.length <= 2 * FIRST || printed;
    const rest = document.createElement("button");
    rest.type = "button";
    rest.textContent = "all rows";
    rest.addEventListener("click", () => { whole = true; apply(); });
    bar.append(words, ...(outcomes.length > 1 ? [verdict] : []), ...(scene ? [label] : []), count, rest);
    (table.closest(".scroll") ?? table).before(bar);

    const chosen = new URLSearchParams(window.location.search).get("engine");
    if (chosen && rows.some((row) => row.dataset.engine === chosen)) words.value = chosen;
    function apply() {
      const wanted = words.value.toLowerCase().split(/\s+/).filter(Boolean)
        .map((word) => SPELLINGS[word] ?? word);
      let shown = 0, found = 0;
      table.classList.toggle("single", Boolean(scene) && !every.checked);
      [...table.tBodies[0].rows].forEach((row) => {
        const text = wanted.length ? row.textContent.toLowerCase() : "";
        row.hidden = !wanted.every((word) => text.includes(word))
          || (scene && !every.checked && row.dataset.scene !== scene.value)
          || (verdict.value !== "" && !row.querySelector(".tag." + verdict.value));
        found += row.hidden ? 0 : 1;
        row.hidden ||= phone.matches && !whole && found > FIRST;
        shown += row.hidden ? 0 : 1;
      });
      rest.hidden = shown === found;
      count.textContent = shown + " of " + rows.length;
    }
    words.addEventListener("input", apply);
    verdict.addEventListener("change", apply);
    every.addEventListener("change", apply);
    phone.addEventListener("change", apply);
    table.addEventListener("sorted", apply);
    document.addEventListener("scenechosen", apply);
    if (!scene) apply();
  }

  // On a phone the cells of some rows stand one below the other, each with the words of its heading.
  function stackable(table) {
    const heads = [...table.tHead.rows[0].cells].map((head) => head.textContent.trim());
    [...table.tBodies[0].rows].forEach((row) => [...row.cells].forEach((cell, index) => {
      if (cell.tagName === "TD" && cell.colSpan === 1) cell.dataset.label = heads[index];
    }));
  }

  const label = () => { if (phone.matches) document.querySelectorAll("table.stack").forEach(stackable); };
  label();
  phone.addEventListener("change", label);
  document.querySelectorAll("table.sortable").forEach(sortable);
  document.querySelectorAll("table[data-filter]").forEach(filterable);

  // A box that scrolls sideways and holds no link or control can itself take the keyboard focus.
  document.querySelectorAll(".scroll").forEach((box) => { if (!box.querySelector("a, button, input, summary")) box.tabIndex = 0; });

  // A phone shows the headings of the sections that it does not need first.
  if (phone.matches && !printed) document.querySelectorAll("details.section").forEach((each) => { each.open = false; });

  // A link to a heading or a run opens what it is folded into.
  function open() {
    const target = document.getElementById(window.location.hash.slice(1));
    const folded = target?.closest("details");
    if (!folded || folded.classList.contains("menu")) return;
    folded.open = true;
    target.scrollIntoView();
  }
  window.addEventListener("hashchange", open);
  open();
})();
