"use strict";
// Embeds the charts when they come near the window. What a chart shows is declared in its
// Vega-Lite specification; here are the width, the theme, the axes and what is switched off.
const held = JSON.parse(document.getElementById("held").textContent);
const packed = Uint8Array.from(atob(held.specs), (letter) => letter.charCodeAt(0));
const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
const specs = await new Response(unpacked).json();
const charts = [...document.querySelectorAll(".chart")];
const boxes = [...document.querySelectorAll("#bar input")];
const system = document.getElementById("system");
const views = new Map(); // of the charts that are drawn
const flipped = new Map(charts.map((chart) => [chart, new Set()])); // axes, between log and linear
const off = new Set(); // names of methods, integrators and sources
const darkness = matchMedia("(prefers-color-scheme: dark)");
let theme = ""; // as the system has it
const [AXIS, GAP, LEAST, MOST] = [74, 30, 250, 640]; // px

const isDark = () => (theme ? theme === "dark" : darkness.matches);
const elsewhere = (name) => Boolean(system?.value && name && name !== system.value);

const flip = (panel, axes) => {
  for (const { encoding } of panel.layer) {
    for (const axis of axes) {
      const log = encoding[axis].scale.type?.endsWith("log"); // or symlog, which has a zero
      encoding[axis].scale = log ? { zero: false } : { type: "log" };
    }
  }
};

const fitted = (chart) => {
  const spec = structuredClone(specs[chart.id]);
  const width = chart.clientWidth - 4;
  spec.concat = spec.concat.filter((_, i) => !elsewhere(spec.usermeta.systems[i]));
  const across = Math.floor((width + GAP) / (AXIS + LEAST + GAP));
  const rows = Math.ceil(spec.concat.length / Math.max(1, Math.min(spec.columns, across)));
  spec.columns = Math.ceil(spec.concat.length / rows); // no gap in the last row if need be
  const each = (width - GAP * (spec.columns - 1)) / spec.columns - AXIS;
  for (const panel of spec.concat) {
    panel.width = Math.min(each, MOST);
    flip(panel, flipped.get(chart));
    // a long title is cut into lines
    panel.title.text = wrapped(panel.title.text, Math.floor((panel.width + AXIS) / 6.5));
  }
  spec.config = structuredClone(held.themes[isDark() ? "dark" : "light"]);
  spec.config.legend.columns = Math.max(1, Math.floor(width / 190));
  const values = { off: [...off], ink: isDark() ? "#dddddd" : "#333333" };
  // a finger scrolls the page
  const zooms = !matchMedia("(pointer: coarse)").matches;
  spec.params = spec.params.filter((one) => zooms || one.bind !== "scales")
    .map((one) => (one.name in values ? { ...one, value: values[one.name] } : one));
  const there = new Set(spec.concat.flatMap((panel) => panel.layer.map((layer) => layer.name)));
  spec.params = spec.params.filter((one) => !one.views || one.views.some((name) => there.has(name)));
  return spec;
};

const wrapped = (text, letters) => {
  const lines = [""];
  for (const word of text.split(" ")) {
    if (lines.at(-1) && `${lines.at(-1)} ${word}`.length > letters) lines.push("");
    lines.push([lines.pop(), word].filter(Boolean).join(" "));
  }
  return lines;
};

const draw = async (chart) => {
  if (!chart.clientWidth) return;
  views.get(chart)?.finalize();
  const options = { renderer: "svg", actions: { export: true, source: false, compiled: false, editor: false },
    downloadFileName: chart.id, tooltip: { theme: isDark() ? "dark" : "light" } };
  views.set(chart, await vegaEmbed(chart.querySelector(".view"), fitted(chart), options));
  chart.dataset.drawn = "yes";
};
const again = () => charts.filter((chart) => chart.dataset.drawn).forEach(draw);

const toggle = (name) => {
  if (!off.delete(name)) off.add(name);
  boxes.forEach((box) => { box.checked = !off.has(box.value); });
  views.forEach(({ view }) => view.signal("off", [...off]).runAsync());
};

charts.forEach((chart) => {
  chart.addEventListener("click", (event) => {
    if (event.target.closest(".role-legend-label")) toggle(event.target.textContent.slice(2));
  });
  chart.querySelectorAll("button").forEach((button) => button.addEventListener("click", () => {
    const axes = flipped.get(chart);
    if (!axes.delete(button.value)) axes.add(button.value);
    draw(chart);
  }));
});
boxes.forEach((box) => box.addEventListener("change", () => toggle(box.value)));

system?.addEventListener("change", () => {
  document.querySelectorAll("[data-systems]").forEach((one) => {
    one.hidden = one.dataset.systems.split(" ").every(elsewhere);
  });
  again();
});

document.getElementById("theme").addEventListener("click", () => {
  theme = isDark() ? "light" : "dark";
  document.documentElement.style.colorScheme = theme;
  again();
});
darkness.addEventListener("change", again);

let width = innerWidth;
addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; again(); } });
addEventListener("beforeprint", () => {
  document.querySelectorAll(".folded").forEach((one) => { one.open = true; });
  charts.filter((chart) => !chart.dataset.drawn).forEach(draw);
});
const nearby = new IntersectionObserver(
  (entries) => entries.filter((e) => e.isIntersecting && !e.target.dataset.drawn).forEach((e) => draw(e.target)),
  { rootMargin: "800px 0px" },
);
charts.forEach((chart) => nearby.observe(chart));

// A link into a folded section opens it; a menu closes when something else is clicked.
const open = () => document.getElementById(location.hash.slice(1))?.closest("details")?.setAttribute("open", "");
addEventListener("hashchange", open);
open();
addEventListener("click", (event) => document.querySelectorAll("#bar details[open]").forEach((one) => {
  if (!one.contains(event.target) || event.target.matches("a")) one.open = false;
}));
