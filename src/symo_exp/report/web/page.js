"use strict";
// Draws the panels as SVG when they come near the window; hover, zoom, and what is switched off.
(() => {
  const held = JSON.parse(document.getElementById("panels").textContent);
  const divs = [...document.querySelectorAll(".panel")];
  const boxes = [...document.querySelectorAll("#bar input")];
  const system = document.getElementById("system");
  const tip = document.getElementById("tip");
  const of = (div) => held[div.dataset.chart][Number(div.dataset.panel)];
  const M = { left: 58, right: 12, top: 24, bottom: 40 };
  const RADIUS = 3.6;
  const WIDTH = { ours: 1.8, published: 1, floor: 1.2, truth: 3 };

  const escaped = (text) => String(text).replace(/[&<>"]/g, (c) => `&#${c.charCodeAt(0)};`);
  const short = (x) => {
    if (x === 0 || (Math.abs(x) >= 1e-2 && Math.abs(x) < 1e3)) return String(Number(x.toPrecision(3)));
    const [digits, exponent] = x.toExponential(2).split("e");
    return `${digits}e${Number(exponent)}`;
  };

  // -- axes ---------------------------------------------------------------------------------------

  const extent = (panel, which, log) => {
    const all = panel.series.flatMap((s) => (which ? [s.y, s.low ?? [], s.high ?? []] : [s.x]).flat())
      .filter((v) => v !== null && (!log || v > 0));
    const low = Math.min(...all), high = Math.max(...all);
    if (!all.length) return [log ? 0.1 : 0, 1];
    if (log) return which ? [low / 2, high * 2] : [low / 1.15, high * 1.15];
    const edge = 0.04 * (high - low) || Math.abs(high) / 10 || 1;
    return [low - edge, high + edge];
  };

  const axis = (panel, which, start, end) => {
    const { log, range, label, ticks, asIs } = panel.axes[which];
    const [a, b] = (panel.view?.[which] ?? (asIs ? null : range) ?? extent(panel, which, log)).map(log ? Math.log10 : Number);
    const at = (v) => (v === null || (log && v <= 0) ? NaN : start + (((log ? Math.log10(v) : v) - a) / (b - a)) * (end - start));
    const back = (p) => { const v = a + ((p - start) / (end - start)) * (b - a); return log ? 10 ** v : v; };
    let marks = ticks.map((v) => [v, String(v)]);
    if (!marks.length && log && b - a >= 0.8) {
      const step = Math.ceil((b - a) / 5), between = b - a > 2.5 ? [1] : b - a > 1.4 ? [1, 3] : [1, 2, 5];
      for (let k = Math.floor(a); k <= b; k += 1) {
        if (k % step === 0) between.forEach((m) => marks.push([m * 10 ** k, m === 1 ? k : short(m * 10 ** k)]));
      }
    } else if (!marks.length) {
      const [low, high] = log ? [10 ** a, 10 ** b] : [a, b];
      const raw = (high - low) / 4, ten = 10 ** Math.floor(Math.log10(raw));
      const step = [1, 2, 5, 10].find((m) => m * ten >= raw) * ten;
      for (let v = Math.ceil(low / step) * step; v <= high; v += step) marks.push([Number(v.toPrecision(12)), short(Number(v.toPrecision(6)))]);
    }
    marks = marks.filter(([v]) => at(v) >= Math.min(start, end) - 1 && at(v) <= Math.max(start, end) + 1);
    return { at, back, marks, label };
  };

  const ten = (text) => (text === 0 || text === 1 || text === 2 ? 10 ** text : typeof text === "number" ? `10<tspan dy="-5" font-size="8">${text}</tspan>` : escaped(text));

  // -- marks --------------------------------------------------------------------------------------

  const SHAPES = {
    circle: (r) => `M${-r},0a${r},${r} 0 1 0 ${2 * r},0a${r},${r} 0 1 0 ${-2 * r},0z`,
    dot: (r) => SHAPES.circle(r * 0.6),
    square: (r) => `M${-r},${-r}h${2 * r}v${2 * r}h${-2 * r}z`,
    up: (r) => `M0,${-1.2 * r}L${1.1 * r},${r}H${-1.1 * r}z`,
    down: (r) => `M0,${1.2 * r}L${1.1 * r},${-r}H${-1.1 * r}z`,
    diamond: (r) => `M0,${-1.3 * r}L${1.3 * r},0L0,${1.3 * r}L${-1.3 * r},0z`,
    plus: (r) => `M0,${-r}V${r}M${-r},0H${r}`,
    cross: (r) => `M${-r},${-r}L${r},${r}M${-r},${r}L${r},${-r}`,
  };
  // points have no dash: those of a second integrator are hollow, of a third half filled
  const filling = (s, kind) => (s.source === "published" ? 0 : kind !== "points" || !s.dash ? 1 : s.dash.split(",").length > 2 ? 0.4 : 0);
  const mark = (s, x, y, kind, r = RADIUS) =>
    `<path d="${SHAPES[s.marker](r)}" transform="translate(${x.toFixed(1)},${y.toFixed(1)})" style="fill:${s.colour};fill-opacity:${filling(s, kind)};stroke:${s.colour}"/>`;
  const stroke = (s) =>
    `style="fill:none;stroke:${s.colour};stroke-width:${WIDTH[s.source]};opacity:${s.source === "ours" ? 1 : 0.6}" stroke-dasharray="${s.dash}"`;

  // A mark at every point; on a long line a few, set apart for each series.
  const marked = (s, kind, order) => {
    if (kind !== "line") return () => true;
    const step = Math.max(1, Math.floor(s.x.length / 6));
    return (i) => s.source !== "truth" && i % step === Math.floor(step * (0.3 + 0.17 * order)) % step;
  };

  // -- a panel ------------------------------------------------------------------------------------

  const shown = (s) => !boxes.some((box) => !box.checked && s[box.dataset.by] === box.dataset.value);

  const draw = (div) => {
    const panel = of(div), W = div.clientWidth, H = div.clientHeight;
    if (!W) return;
    const x = axis(panel, 0, M.left, W - M.right), y = axis(panel, 1, H - M.bottom, M.top);
    const parts = [], gone = [];
    panel.points = [];
    for (const [v, text] of x.marks) parts.push(`<path class="grid" d="M${x.at(v)},${M.top}V${H - M.bottom}"/><text x="${x.at(v)}" y="${H - M.bottom + 14}" text-anchor="middle">${ten(text)}</text>`);
    for (const [v, text] of y.marks) parts.push(`<path class="grid" d="M${M.left},${y.at(v)}H${W - M.right}"/><text x="${M.left - 5}" y="${y.at(v) + 4}" text-anchor="end">${ten(text)}</text>`);
    parts.push(`<g clip-path="url(#clip-${div.dataset.chart}-${div.dataset.panel})">`);
    panel.series.forEach((s, order) => {
      if (!shown(s)) return;
      const many = s.x.length > 200 && panel.mark === "points", has = marked(s, panel.mark, order);
      let line = "", pen = "M", marks = "", inside = false;
      s.x.forEach((value, i) => {
        const px = x.at(value), py = Math.max(-2e4, Math.min(2e4, y.at(s.y[i])));
        if (!Number.isFinite(px) || !Number.isFinite(py)) { pen = "M"; return; }
        line += `${pen}${px.toFixed(1)},${py.toFixed(1)}`;
        pen = "L";
        const within = py >= M.top && py <= H - M.bottom && px >= M.left - 1 && px <= W - M.right + 1;
        inside ||= within;
        if (within) panel.points.push([px, py, s, i]);
        if (within && has(i)) marks += mark(s, px, py, panel.mark, many ? 1.2 : RADIUS);
      });
      if (s.low) {
        const edge = (values) => values.map((v, i) => [x.at(s.x[i]), y.at(Math.max(v ?? NaN, panel.axes[1].log ? 1e-300 : -Infinity))]).filter((p) => p.every(Number.isFinite));
        parts.push(`<path d="M${[...edge(s.low), ...edge(s.high).reverse()].map((p) => p.map((v) => v.toFixed(1))).join("L")}z" style="fill:${s.colour};opacity:.15"/>`);
      }
      if (panel.mark !== "points") parts.push(`<path class="line" d="${line}" ${stroke(s)}/>`);
      parts.push(marks);
      if (!inside && !panel.view) gone.push(`${s.name}: off the scale`);
    });
    parts.push("</g>");
    gone.forEach((text, i) => parts.push(`<text class="soft" x="${W / 2}" y="${M.top + 12 + 13 * i}" text-anchor="middle">${escaped(text)}</text>`));
    parts.push(`<text class="title" x="${M.left}" y="14">${escaped(panel.title)}</text>`,
      `<text x="${(M.left + W - M.right) / 2}" y="${H - 6}" text-anchor="middle">${escaped(x.label)}</text>`,
      `<text transform="translate(11,${(H - M.bottom + M.top) / 2})rotate(-90)" text-anchor="middle">${escaped(y.label)}</text>`);
    const clip = `<clipPath id="clip-${div.dataset.chart}-${div.dataset.panel}"><rect x="${M.left}" y="${M.top}" width="${W - M.left - M.right}" height="${H - M.top - M.bottom}"/></clipPath>`;
    div.innerHTML = `<svg width="${W}" height="${H}" role="img" aria-label="${escaped(`${panel.title} ${y.label} over ${x.label}`)}">${clip}${parts.join("")}</svg>`;
    Object.assign(panel, { x, y });
    div.dataset.drawn = "yes";
  };

  const legend = (figure) => {
    const entries = new Map();
    figure.querySelectorAll(".panel").forEach((div) => {
      const panel = of(div);
      panel.series.filter(shown).forEach((s) => entries.has(s.name) || entries.set(s.name, [s, panel.mark]));
    });
    figure.querySelector(".legend").innerHTML = [...entries].map(([name, [s, kind]]) =>
      `<span><svg width="30" height="12">${kind === "points" ? "" : `<path d="M0,6H30" ${stroke(s)}/>`}${s.source === "truth" ? "" : mark(s, 15, 6, kind)}</svg>${escaped(name)}</span>`).join("");
  };

  // -- hover and zoom -----------------------------------------------------------------------------

  const hover = (div, event) => {
    const panel = of(div), box = div.getBoundingClientRect();
    const px = event.clientX - box.left, py = event.clientY - box.top;
    let best = null, near = 30 ** 2;
    for (const point of panel.points ?? []) {
      const d = (point[0] - px) ** 2 + (point[1] - py) ** 2;
      if (d < near) [best, near] = [point, d];
    }
    tip.hidden = !best;
    if (!best) return;
    const [x, y, s, i] = best;
    const unit = (label) => / \[([^\]]*)\]$|^\[([^\]]*)\]$/.exec(label)?.slice(1).find(Boolean) ?? "";
    const name = (label) => label.replace(/ ?\[[^\]]*\]$/, "");
    const said = (value, label) => [name(label), "=", short(value), unit(label)].filter(Boolean).join(" ");
    const yname = name(panel.y.label) ? panel.y.label : `${name(panel.title)} ${panel.y.label}`;
    tip.textContent = [s.name, said(s.y[i], yname), said(s.x[i], panel.x.label), s.text?.[i]].filter(Boolean).join("\n");
    tip.style.left = `${Math.min(box.left + x + 12, innerWidth - tip.offsetWidth - 4)}px`;
    tip.style.top = `${Math.max(4, box.top + y - tip.offsetHeight - 8)}px`;
  };

  const zoomed = (div, from, to) => {
    const panel = of(div), box = div.getBoundingClientRect();
    if (Math.abs(from.clientX - to.clientX) < 8 || Math.abs(from.clientY - to.clientY) < 8) return;
    const order = (a, b) => (a < b ? [a, b] : [b, a]);
    panel.view = [order(panel.x.back(from.clientX - box.left), panel.x.back(to.clientX - box.left)),
      order(panel.y.back(from.clientY - box.top), panel.y.back(to.clientY - box.top))];
    draw(div);
  };

  divs.forEach((div) => {
    let from = null;
    div.title = "";
    div.addEventListener("pointermove", (event) => hover(div, event));
    div.addEventListener("pointerdown", (event) => { from = event.pointerType === "mouse" ? event : null; hover(div, event); });
    div.addEventListener("pointerup", (event) => { if (from) zoomed(div, from, event); from = null; });
    div.addEventListener("pointerleave", () => { tip.hidden = true; });
    div.addEventListener("dblclick", () => { delete of(div).view; draw(div); });
    div.addEventListener("dragstart", (event) => event.preventDefault());
  });

  // -- what is shown ------------------------------------------------------------------------------

  const nearby = new IntersectionObserver(
    (entries) => entries.filter((e) => e.isIntersecting && !e.target.dataset.drawn).forEach((e) => draw(e.target)),
    { rootMargin: "800px 0px" },
  );
  divs.forEach((div) => nearby.observe(div));
  const again = () => divs.filter((div) => div.dataset.drawn).forEach(draw);
  const figures = [...document.querySelectorAll(".chart")];
  figures.forEach(legend);
  boxes.forEach((box) => box.addEventListener("change", () => { figures.forEach(legend); again(); }));
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; again(); } });

  document.querySelectorAll(".axes button").forEach((button) => button.addEventListener("click", () => {
    button.closest("figure").querySelectorAll(".panel").forEach((div) => {
      const one = of(div).axes[Number(button.dataset.axis)];
      one.log = !one.log;
      one.asIs = !one.asIs;
      delete of(div).view;
      draw(div);
    });
  }));

  system?.addEventListener("change", () => {
    const other = (name) => Boolean(system.value && name && name !== system.value);
    document.querySelectorAll("[data-system]").forEach((one) => { one.hidden = other(one.dataset.system); });
    figures.forEach((figure) => { figure.hidden = [...figure.querySelectorAll(".panel")].every((one) => one.hidden); });
    again();
  });

  // a link into what is folded opens it; a menu closes when something else is touched
  const open = () => document.getElementById(location.hash.slice(1))?.closest("details")?.setAttribute("open", "");
  addEventListener("hashchange", open);
  open();
  addEventListener("click", (event) => document.querySelectorAll("#bar details[open]").forEach((one) => {
    if (!one.contains(event.target) || event.target.matches("a")) one.open = false;
  }));
})();
