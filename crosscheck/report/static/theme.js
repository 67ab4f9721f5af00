// Light or dark, as the system or the reader chooses; set before anything is drawn. Printing is always light.
"use strict";
(function () {
  const root = document.documentElement;
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  const WORDS = {auto: "as the system has them", light: "light", dark: "dark"};
  const ORDER = ["auto", "light", "dark"];
  let choice = "auto";
  try {
    choice = window.localStorage.getItem("crosscheck-theme") ?? "auto";
  } catch {
    choice = "auto";  // a browser may forbid storage to pages from disk
  }
  if (!ORDER.includes(choice)) choice = "auto";

  function show(theme) {
    if (root.dataset.theme === theme) return;
    root.dataset.theme = theme;
    document.dispatchEvent(new Event("themechange"));
  }
  function apply() {
    show((choice === "auto" ? !system.matches : choice === "light") ? "light" : "dark");
    const button = document.getElementById("theme");
    if (!button) return;
    const words = "colours: " + WORDS[choice];
    button.textContent = {auto: "◐", light: "○", dark: "●"}[choice];
    button.title = words;
    button.setAttribute("aria-label", words);
  }
  apply();
  system.addEventListener("change", apply);
  // Nothing can be clicked on paper, so printing opens what is folded.
  const unfold = () => document.querySelectorAll("details.card, details.section, #reasons").forEach((each) => { each.open = true; });
  window.addEventListener("beforeprint", () => { root.classList.add("printed"); show("light"); unfold(); });
  window.addEventListener("afterprint", () => { root.classList.remove("printed"); apply(); });

  document.addEventListener("DOMContentLoaded", () => {
    apply();
    document.getElementById("theme").addEventListener("click", () => {
      choice = ORDER[(ORDER.indexOf(choice) + 1) % ORDER.length];
      try {
        window.localStorage.setItem("crosscheck-theme", choice);
      } catch {
        // the choice then lasts as long as the page
      }
      apply();
    });
    // One menu at a time, closed by a click elsewhere or Escape.
    const menus = [...document.querySelectorAll("details.menu")];
    const close = (except) => menus.forEach((menu) => { if (menu !== except) menu.open = false; });
    menus.forEach((menu) => menu.addEventListener("toggle", () => { if (menu.open) close(menu); }));
    document.addEventListener("click", (event) => close(event.target.closest("details.menu")));
    document.addEventListener("keydown", (event) => { if (event.key === "Escape") close(null); });
  });
})();
