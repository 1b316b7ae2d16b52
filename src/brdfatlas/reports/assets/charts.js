// Charts in SVG, drawn at the size they are shown at, so that text is never scaled. No library: points, lines and dots
// on two axes are all we draw. Each chart redraws itself when its room changes.
"use strict";
(() => {
  const NS = "http://www.w3.org/2000/svg";
  const FAMILIES = ["engine", "analytic", "tabulated", "factored", "ours"];
  const DASHES = ["", "6 3", "2 2.5", "9 3 2 3"];
  const SHADES = 8;
  const style = (i) => ({ colour: `var(--c${i % SHADES})`, dash: DASHES[Math.floor(i / SHADES) % DASHES.length] });
  const familyColour = (family) => `var(--f-${FAMILIES.includes(family) ? family : "analytic"})`;
  function el(name, attributes = {}, ...children) {
    const node = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  }
  const pen = document.createElement("canvas").getContext("2d");
  const widthOf = (text, size = 12) => { pen.font = `${size}px ${getComputedStyle(document.body).fontFamily}`; return pen.measureText(text).width; };

  // --- numbers and ticks ---------------------------------------------------------------------------------------------
  const short = (v, digits = 3) => {
    const s = Math.abs(v);
    if (s >= 1e6) return `${+(v / 1e6).toPrecision(digits)}M`;
    if (s >= 1e3) return `${+(v / 1e3).toPrecision(digits)}k`;
    if (s && s < 1e-3) return (+v.toPrecision(digits)).toExponential().replaceAll("-", "−");
    return String(+v.toPrecision(digits)).replace("-", "−");
  };
  // What stands at ticks: as many digits as tell them apart.
  function words(ticks) {
    const gap = Math.min(...ticks.slice(1).map((t, i) => Math.abs(t - ticks[i])));
    let digits = 3;
    while (digits < 12 && ticks.some((t) => Math.abs(+t.toPrecision(digits) - t) > 0.01 * gap)) digits++;
    return ticks.map((t) => short(t, digits));
  }
  function linearTicks(low, high, wanted = 5) {
    const raw = (high - low) / wanted || 1, size = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((k) => k * size).find((s) => s >= raw);
    const ticks = [];
    for (let t = Math.ceil(low / step) * step; t <= high + step * 1e-9; t += step) ticks.push(Math.abs(t) < step * 1e-9 ? 0 : t);
    return ticks;
  }
  function logTicks(low, high) {
    const decades = Math.log10(high / low), factors = decades < 1.3 ? [1, 2, 3, 5] : decades < 3 ? [1, 3] : [1], ticks = [];
    const every = Math.max(1, Math.ceil(decades / 7));
    for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e++) if (e % every === 0) for (const f of factors) ticks.push(f * 10 ** e);
    const inside = ticks.filter((t) => t >= low * 0.999 && t <= high * 1.001);
    return inside.length > 1 ? inside : linearTicks(low, high, 4).filter((t) => t > 0);
  }
  function scale([a, b], [p, q], kind) {
    const f = kind === "log" ? Math.log : kind === "root" ? (v) => Math.sqrt(Math.max(v, 0)) : (v) => v;
    const fa = f(a), fb = f(b);
    return (v) => p + (q - p) * (f(v) - fa) / (fb - fa || 1);
  }
  function padded(all, log) {
    const values = all.filter((v) => Number.isFinite(v) && (v > 0 || !log));
    if (!values.length) values.push(1);
    const low = Math.min(...values), high = Math.max(...values);
    if (log) return [low / 1.35, high * 1.35];
    const room = (high - low || Math.abs(high) || 1) * 0.08;
    return [low - room, high + room];
  }

  // A perfect match, an error of 0 or a PSNR of ∞, has no place on its axis and stands at the end of it.
  const within = ([low, high]) => (v) => Math.min(Math.max(v, low), high);

  // --- frame ------------------------------------------------------------------------------------------------------------
  // A chart is a function of its width; it is drawn again when that changes.
  const drawn = new WeakMap();
  const watcher = new ResizeObserver((entries) => {
    for (const { target, contentRect } of entries) {
      const chart = drawn.get(target);
      if (chart && Math.abs(chart.width - contentRect.width) > 1) paint(target, chart.draw);
    }
  });
  function paint(node, draw) {
    const width = Math.max(280, Math.floor(node.clientWidth || 640));
    drawn.set(node, { width: node.clientWidth, draw });
    node.replaceChildren(draw(width));
    watcher.observe(node);
  }
  // Words in place of a chart, which is not to come back when its room changes.
  function nothing(node, text) {
    drawn.delete(node);
    node.textContent = text;
  }
  function frame({ width, height, x, y, xkind, ykind, xlabel, ylabel, xticks, yticks, label, left, bottom = 42, top = 24, right = 14 }) {
    const svg = el("svg", { viewBox: `0 0 ${width} ${height}`, width, height, role: "group", "aria-label": label });
    const ys = yticks || (ykind === "log" ? logTicks(...y) : linearTicks(...y));
    const named = words(ys), edge = left ?? Math.ceil(Math.max(...named.map((text) => widthOf(text)))) + 14;
    const box = { left: edge, right: width - right, top, bottom: height - bottom };
    const sx = scale(x, [box.left, box.right], xkind), sy = scale(y, [box.bottom, box.top], ykind);
    ys.forEach((t, i) => svg.append(el("line", { class: "grid", x1: box.left, x2: box.right, y1: sy(t), y2: sy(t) }), el("text", { x: box.left - 8, y: sy(t) + 4, "text-anchor": "end" }, named[i])));
    let last = -Infinity;
    const xs = xticks || (xkind === "log" ? logTicks(...x) : linearTicks(...x, Math.max(2, Math.floor(width / 110)))), below = words(xs);
    for (const [i, t] of xs.entries()) {
      const half = widthOf(below[i]) / 2;
      svg.append(el("line", { class: "axis", x1: sx(t), x2: sx(t), y1: box.bottom, y2: box.bottom + 4 }));
      if (sx(t) - half < last + 8 || sx(t) + half > width) continue;
      last = sx(t) + half;
      svg.append(el("text", { x: sx(t), y: box.bottom + 18, "text-anchor": "middle" }, below[i]));
    }
    svg.append(el("line", { class: "axis", x1: box.left, x2: box.right, y1: box.bottom, y2: box.bottom }),
      el("text", { x: (box.left + box.right) / 2, y: height - 4, "text-anchor": "middle" }, xlabel), el("text", { x: 0, y: 12 }, ylabel));
    return { svg, sx, sy, box };
  }
  function marker(family, x, y, r, attributes) {
    const fill = familyColour(family), d = {
      engine: `M${x - r} ${y - r}h${2 * r}v${2 * r}h${-2 * r}z`, tabulated: `M${x} ${y - 1.3 * r}L${x + 1.3 * r} ${y}L${x} ${y + 1.3 * r}L${x - 1.3 * r} ${y}z`,
      factored: `M${x} ${y - 1.25 * r}L${x + 1.2 * r} ${y + r}H${x - 1.2 * r}z`, ours: `M${x} ${y + 1.25 * r}L${x + 1.2 * r} ${y - r}H${x - 1.2 * r}z`,
    }[family];
    return d ? el("path", { d, fill, ...attributes }) : el("circle", { cx: x, cy: y, r, fill, ...attributes });
  }
  // Rising heights moved apart to at least a gap, no lower than the last may be, in the same order.
  function spread(heights, gap, last) {
    let at = -Infinity;
    const placed = heights.map((y) => { at = Math.max(y, at + gap); return at; });
    for (let i = placed.length - 1; i >= 0; i--, last -= gap) placed[i] = Math.min(placed[i], last);
    return placed;
  }

  // --- scatter with a Pareto front ---------------------------------------------------------------------------------------
  // points: {x, y, name, title, family, href, text, faint}; front: names by rising x. They stand in a column beside the plot; the
  // rest is named on hover and focus.
  function scatter(node, { points, front, xlabel, ylabel, label, ylog }) {
    const all = points.filter((p) => Number.isFinite(p.x) && p.x > 0 && !Number.isNaN(p.y));
    if (!all.length) { nothing(node, "Nothing to draw: no numbers."); return; }
    const range = padded(all.map((p) => p.y), ylog), place = within(range), good = all.map((p) => ({ ...p, y: place(p.y) }));
    paint(node, (width) => {
      const line = front.map((name) => good.find((p) => p.name === name)).filter(Boolean);
      const gap = 15, room = Math.min(Math.max(0, ...line.map((p) => widthOf(p.title) + 2)), width * 0.47);
      const height = Math.max(Math.round(Math.min(Math.max(width * 0.55, 300), 480)), line.length * gap + 80);
      const { svg, sx, sy, box } = frame({ width, height, x: padded(good.map((p) => p.x), true), y: range, xkind: "log", ykind: ylog ? "log" : "", xlabel, ylabel, label, right: room + 34 });
      if (line.length > 1) svg.append(el("path", { class: "front", d: line.map((p, i) => (i ? `H${sx(p.x)}V${sy(p.y)}` : `M${sx(p.x)} ${sy(p.y)}`)).join("") }));
      const size = (p) => (front.includes(p.name) ? 5.5 : 4.5);
      const names = el("g", { "aria-hidden": "true" }), down = [...line].sort((a, b) => sy(a.y) - sy(b.y));
      spread(down.map((p) => sy(p.y)), gap, box.bottom - 8).forEach((y, i) => {
        const p = down[i], x = width - room;
        names.append(el("path", { class: "leader", d: `M${sx(p.x)} ${sy(p.y)}L${x - 16} ${y}H${x - 4}` }), el("text", { class: "name", x, y: y + 4 }, fit(p.title, room)));
      });
      svg.append(names);
      const tip = el("g", { class: "tip", visibility: "hidden", "aria-hidden": "true" }, el("rect", { rx: 4 }), el("text", {}));
      const show = (p) => {
        const [rect, text] = tip.children;
        text.textContent = p.text;
        const w = Math.min(widthOf(p.text) + 16, width - 4), x = Math.min(Math.max(sx(p.x) - w / 2, 2), width - w - 2), y = sy(p.y) < 60 ? sy(p.y) + 14 : sy(p.y) - 36;
        for (const [k, v] of Object.entries({ x, y, width: w, height: 24 })) rect.setAttribute(k, v);
        text.setAttribute("x", x + 8); text.setAttribute("y", y + 16);
        tip.setAttribute("visibility", "visible");
      };
      const hide = () => tip.setAttribute("visibility", "hidden");
      for (const p of good) {
        const on = front.includes(p.name), link = el("a", { href: p.href, "aria-label": p.text, "data-model": p.name });
        link.append(el("circle", { cx: sx(p.x), cy: sy(p.y), r: 11, fill: "transparent" }), marker(p.family, sx(p.x), sy(p.y), size(p), { class: "point", opacity: on ? 1 : 0.6 }));
        for (const [event, act] of [["mouseenter", () => show(p)], ["focus", () => show(p)], ["mouseleave", hide], ["blur", hide]]) link.addEventListener(event, act);
        svg.append(link);
      }
      svg.append(tip);
      return svg;
    });
  }
  function familyLegend(node, families) {
    node.replaceChildren(...families.map((f) => {
      const item = document.createElement("span");
      item.append(el("svg", { width: 14, height: 12, viewBox: "0 0 14 12", "aria-hidden": "true" }, marker(f, 7, 6, 4.5, {})), f);
      return item;
    }));
  }

  // --- lines ---------------------------------------------------------------------------------------------------------------
  // series: {name, title, index, values: [[x, y], ...]}; a gap where y is not a number. Hover and focus bring one forward.
  function lines(node, { series, xlabel, ylabel, label, xkind = "", ykind = "", xticks, xrange, yrange, bands = [], height = 320 }) {
    const usable = (v) => Number.isFinite(v) && (ykind !== "log" || v > 0);
    const ys = series.flatMap((s) => s.values.map((v) => v[1])).filter(usable);
    if (!ys.length) { nothing(node, "Nothing to draw: no finite numbers."); return; }
    paint(node, (width) => {
      const y = yrange || (ykind === "log" ? padded([Math.max(Math.min(...ys), Math.max(...ys) * 1e-7), Math.max(...ys)], true) : padded(ys, false));
      const x = xrange || [Math.min(...series.map((s) => s.values[0][0])), Math.max(...series.map((s) => s.values.at(-1)[0]))];
      const { svg, sx, sy, box } = frame({ width, height, x, y, xkind, ykind, xlabel, ylabel, xticks, label });
      const clip = `clip-${Math.random().toString(36).slice(2)}`;
      svg.append(el("clipPath", { id: clip }, el("rect", { x: box.left, y: box.top - 2, width: box.right - box.left, height: box.bottom - box.top + 2 })));
      for (const [low, high] of bands) svg.append(el("rect", { class: "noise", x: box.left, width: box.right - box.left, y: sy(high), height: Math.max(2, sy(low) - sy(high)) }));
      const g = el("g", { "clip-path": `url(#${clip})` });
      for (const s of series) {
        const { colour, dash } = style(s.index);
        let d = "", open = false;
        for (const [a, b] of s.values) { if (usable(b)) { d += `${open ? "L" : "M"}${sx(a).toFixed(1)} ${sy(b).toFixed(1)}`; open = true; } else open = false; }
        const path = el("path", { class: s.strong ? "line strong" : "line", d, stroke: s.strong ? "var(--ink)" : colour, "stroke-dasharray": s.strong ? "" : dash, "data-model": s.name }, el("title", {}, s.title));
        path.addEventListener("mouseenter", () => { node.classList.add("dim"); path.classList.add("on"); });
        path.addEventListener("mouseleave", () => { node.classList.remove("dim"); path.classList.remove("on"); });
        g.append(path);
      }
      svg.append(g);
      return svg;
    });
  }
  // --- dots: a row a model, a dot a material -----------------------------------------------------------------------------
  // rows: {name, title, family, href, dots: [{x, text, href}], middle}
  function dots(node, { rows, xlabel, label, xlog }) {
    const all = rows.flatMap((r) => r.dots.map((d) => d.x)).filter((v) => !Number.isNaN(v));
    if (!all.length) { nothing(node, "Nothing to draw: no numbers."); return; }
    const range = padded(all, xlog), place = within(range);
    paint(node, (width) => {
      const left = Math.min(Math.max(...rows.map((r) => widthOf(r.title))) + 14, width * 0.45), step = 20, height = rows.length * step + 66;
      const { svg, sx, box } = frame({ width, height, x: range, y: [0, 1], xkind: xlog ? "log" : "", yticks: [], xlabel, ylabel: "", label, left });
      rows.forEach((r, i) => {
        const y = box.top + step * (i + 0.5);
        const link = el("a", { href: r.href }, el("text", { class: "name", x: 0, y: y + 4 }, fit(r.title, left - 12)));
        svg.append(el("line", { class: "grid", x1: box.left, x2: box.right, y1: y, y2: y }), link);
        for (const d of r.dots) if (!Number.isNaN(d.x)) svg.append(el("a", { href: d.href, "aria-label": d.text }, marker(r.family, sx(place(d.x)), y, 4, { class: "point", opacity: 0.75 }, ), el("title", {}, d.text)));
        if (!Number.isNaN(r.middle)) svg.append(el("line", { class: "median", x1: sx(place(r.middle)), x2: sx(place(r.middle)), y1: y - 7, y2: y + 7 }));
      });
      return svg;
    });
  }
  function fit(text, room) {
    if (widthOf(text) <= room) return text;
    let n = text.length;
    while (n > 3 && widthOf(`${text.slice(0, n)}…`) > room) n--;
    return `${text.slice(0, n)}…`;
  }
  // A legend of buttons that switch series on and off; `off` is a set of names.
  function legend(node, models, off, changed) {
    node.replaceChildren(...models.map(({ name, title, index }) => {
      const { colour, dash } = style(index), button = document.createElement("button");
      button.type = "button"; button.dataset.model = name;
      button.setAttribute("aria-pressed", String(!off.has(name)));
      button.append(el("svg", { viewBox: "0 0 22 8", width: 22, height: 8, "aria-hidden": "true" }, el("line", { x1: 0, x2: 22, y1: 4, y2: 4, stroke: colour, "stroke-width": 2.5, "stroke-dasharray": dash })), title);
      button.addEventListener("click", () => {
        if (off.has(name)) off.delete(name); else off.add(name);
        button.setAttribute("aria-pressed", String(!off.has(name)));
        changed();
      });
      return button;
    }));
  }
  window.AtlasCharts = { scatter, lines, dots, legend, familyLegend, style, el, short, FAMILIES, padded };
})();
