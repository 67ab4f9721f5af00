// Menus and search over the pages of this folder and of the folders beside it, which sites.js lists.
"use strict";
// Plotly is most of what a page loads, so it comes once the rest can be read. All callers share one promise.
window.library = (function () {
  let asked = null;
  return () => (asked ??= new Promise((done, failed) => {
    const script = document.createElement("script");
    Object.assign(script, {src: "plotly.min.js", onload: done, onerror: failed});
    document.head.append(script);
  }));
})();
(function () {
  const MOST = 12;  // results listed
  const sites = window.CROSSCHECK_SITES ?? [];
  const nav = document.querySelector("header nav"), others = document.getElementById("sites");
  const spoken = (text) => text.replaceAll("_", " ");
  const make = (tag, text, more) => Object.assign(document.createElement(tag), {textContent: text, ...more});
  const link = ([, title, href], here) => {
    const made = make("a", spoken(title), {href});
    if (here) made.setAttribute("aria-current", "page");
    return made;
  };
  const order = [...sites].sort((one, other) => other.report - one.report);

  // Pages of a report have its menus; pages of a study take those of the report beside them.
  const report = order.find((site) => site.report);
  const own = Boolean(nav.querySelector("[data-own]"));
  if (report && !own) {
    const menus = [["Scenes", "scene"], ["Engines", "engine"], ["Studies", "study"]].map(([name, kind]) => {
      const pages = report.pages.filter((page) => page[0] === kind);
      const menu = make("details", "", {className: "menu"}), list = make("div", "");
      list.append(...pages.map((page) => link(page)));
      menu.append(make("summary", name), list);
      return pages.length ? menu : null;
    });
    nav.prepend(make("a", "Overview", {href: report.pages[0][2]}), ...menus.filter(Boolean));
  }
  const first = (site) => link([null, spoken(site.pages[0][1]) + ", " + spoken(site.name), site.pages[0][2]], site.here && !own);
  if (sites.length > 1) {
    others.querySelector("div").append(...order.map(first));
    others.hidden = false;
  }

  // What can be found: headings and runs of this page, then pages of this folder, then those of the others.
  function entries() {
    const here = [...document.querySelectorAll("main :is(h2, h3)[id], main details[id] > summary")].map((node) => ({
      href: "#" + (node.id || node.parentElement.id), where: "this page",
      text: node.querySelector("b")?.textContent ?? node.textContent.trim()}));
    const menus = [...nav.querySelectorAll("a")].map((each) => ({href: each.getAttribute("href"), where: "", text: each.textContent}));
    const pages = [...sites].sort((one, other) => other.here - one.here).flatMap((site) => site.pages.map(
      ([, title, href]) => ({href, where: site.here ? "" : spoken(site.name), text: spoken(title)})));
    return [...here, ...(sites.length ? pages : menus)];
  }
  const find = document.getElementById("find"), words = find.querySelector("input");
  const list = find.querySelector("ul"), told = find.querySelector("p");
  let known = null;
  function show() {
    known ??= entries();
    const wanted = spoken(words.value.toLowerCase()).split(/\s+/).filter(Boolean);
    const found = wanted.length ? known.filter((each) => wanted.every((word) => spoken(each.text.toLowerCase()).includes(word))) : [];
    list.replaceChildren(...found.slice(0, MOST).map((each) => {
      const line = make("li", ""), target = make("a", each.text, {href: each.href});
      target.addEventListener("click", () => { find.open = false; });
      line.append(target, ...(each.where ? [make("span", " " + each.where, {className: "quiet"})] : []));
      return line;
    }));
    told.textContent = !wanted.length ? "scenes, engines, runs, headings" : found.length > MOST
      ? "the first " + MOST + " of " + found.length : found.length + " found";
  }
  words.addEventListener("input", show);
  words.addEventListener("keydown", (event) => { if (event.key === "Enter") list.querySelector("a")?.click(); });
  find.addEventListener("toggle", () => { if (find.open) { show(); words.focus(); } });
  document.addEventListener("keydown", (event) => {
    if (event.key !== "/" || event.target.closest?.("input, select, textarea")) return;
    event.preventDefault();
    find.open = true;
  });
})();
