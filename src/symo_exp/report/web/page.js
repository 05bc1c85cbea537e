"use strict";
// Draws each panel when it comes near the window, and applies what is switched on and off.
(() => {
  const panels = JSON.parse(document.getElementById("panels").textContent);
  const boxes = [...document.querySelectorAll("#bar input")];
  const drawn = new Set();

  const hidden = () =>
    boxes.filter((box) => !box.checked).map((box) => [box.dataset.by, box.dataset.value]);

  const visibilities = (traces) => {
    const off = hidden();
    return traces.map((trace) => !off.some(([by, value]) => trace.meta[by] === value));
  };

  const draw = async (div) => {
    if (drawn.has(div)) return;
    drawn.add(div);
    const { data, layout } = panels[div.dataset.chart][Number(div.dataset.panel)];
    const shown = visibilities(data);
    data.forEach((trace, i) => { trace.visible = shown[i]; });
    await Plotly.newPlot(div, data, layout, {
      responsive: true,
      displaylogo: false,
      displayModeBar: "hover",
      modeBarButtons: [["toImage", "zoom2d", "pan2d", "autoScale2d", "resetScale2d"]],
    });
    div.dataset.drawn = "yes";
  };

  const nearby = new IntersectionObserver(
    (entries) => entries.filter((entry) => entry.isIntersecting).forEach((entry) => draw(entry.target)),
    { rootMargin: "800px 0px" },
  );
  document.querySelectorAll(".panel").forEach((div) => nearby.observe(div));

  boxes.forEach((box) => box.addEventListener("change", () => {
    drawn.forEach((div) => {
      if (div.data) Plotly.restyle(div, { visible: visibilities(div.data) });
    });
  }));

  document.querySelectorAll(".axes button").forEach((button) => button.addEventListener("click", () => {
    const axis = `${button.dataset.axis}axis`;
    button.closest("figure").querySelectorAll(".panel").forEach(async (div) => {
      await draw(div);
      const log = div.layout[axis].type === "log";
      Plotly.relayout(div, {
        [`${axis}.type`]: log ? "linear" : "log",
        [`${axis}.autorange`]: true,
      });
    });
  }));
})();
