// Figures of the pages of engines and studies: one scene at a time.
"use strict";
(function () {
  const choose = (name) => document.querySelector('[data-choose="' + name + '"]');
  const sceneSelect = choose("scene"), quantitySelect = choose("quantity"), groupSelect = choose("group");
  const engine = document.querySelector("[data-engine]")?.dataset.engine;
  if (!sceneSelect) return;

  const usable = (scene) => (engine ? scene.engines.includes(engine) : scene.engines.length);
  window.CROSSCHECK_RUNS.scenes.filter(usable).forEach((scene) => sceneSelect.add(new Option(scene.title.replaceAll("_", " "), scene.name)));
  // Starts with a scene that everybody knows instead of the first in the alphabet.
  if ([...sceneSelect.options].some((option) => option.value === "double_pendulum")) sceneSelect.value = "double_pendulum";
  if (quantitySelect) Object.keys(Figures.UNITS).forEach((name) => quantitySelect.add(new Option(name, name)));
  const ofScene = () => Figures.runsOf(sceneSelect.value).filter((run) => !engine || run.engine === engine);
  let groups = [];
  function fillGroups() {
    if (!groupSelect) return;
    const before = groupSelect.selectedOptions[0]?.text;
    groups = Figures.groups(ofScene());
    groupSelect.replaceChildren(...groups.map(([name], index) => new Option(name, index)));
    const again = groups.findIndex(([name]) => name === before);
    if (again >= 0) groupSelect.value = again;
  }
  const chosen = () => (groupSelect ? ofScene().filter(groups[groupSelect.value][1]) : ofScene());

  Figures.makers.speed = () => Figures.speed(chosen());
  Figures.makers.convergence = () => {
    const quantity = quantitySelect?.value ?? "position";
    return Figures.convergence(chosen(), quantity, Figures.UNITS[quantity]);
  };
  Figures.makers.conservation = () => {
    const kinds = [["energy error", "diamond", "--violet", (run) => run.energy_error],
      ["position level, m", "circle", "--blue", (run) => run.levels.position?.max],
      ["velocity level, m/s", "square", "--orange", (run) => run.levels.velocity?.max],
      ["acceleration level, m/s²", "triangle-up", "--green", (run) => run.levels.acceleration?.max],
      ["orthogonality", "x", "--quiet", (run) => run.orthogonality]];
    const shown = chosen().filter((run) => run.energy_error !== null).reverse();
    const traces = kinds.map(([name, symbol, colour, read]) => {
      const values = shown.map((run) => read(run) ?? null);
      return {x: Figures.positive(values), rawX: values, y: shown.map((run) => run.label), raw: shown.map((run) => run.label), name,
        mode: "markers", marker: {symbol, size: 9, color: Figures.style(colour)},
        hovertemplate: "%{x:.2e}<extra>%{y}, " + name + "</extra>"};
    }).filter((trace) => trace.x.some((value) => value !== null));
    return {traces: shown.length ? traces : [], columns: ["largest value (1, m, m/s, m/s² by curve)", "run"],
      height: 110 + 22 * shown.length,
      layout: Figures.layout(Figures.log("largest value over the run"), {type: "category", nticks: 0, tickfont: {
        size: Figures.narrow() ? 9 : 11}, dtick: 1}, {showlegend: true, legend: {orientation: "h", y: 1, yanchor: "bottom",
        font: {size: 11}}, margin: {l: 10, r: 12, t: 30, b: 10}})};
  };

  const tell = () => document.dispatchEvent(new Event("scenechosen"));
  const refresh = (fillGroups(), Figures.start(() => Figures.legend(chosen())));
  sceneSelect.addEventListener("change", () => { fillGroups(); refresh(); tell(); });
  tell();
  [quantitySelect, groupSelect].forEach((select) => select?.addEventListener("change", refresh));
})();
