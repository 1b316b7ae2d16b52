// Small charts in SVG: scatter plots with a Pareto line, and curves. No library: three shapes are all we draw.
"use strict";
(() => {
  const NS = "http://www.w3.org/2000/svg";
  // Okabe and Ito's colours, told apart by people of every colour vision; dashes tell equal colours apart.
  const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b58900", "#56b4e9", "#8a8a8a"];
  const DASHES = ["", "6 3", "2 2.5", "9 3 2 3"];
  const style = (i) => ({ colour: COLOURS[i % COLOURS.length], dash: DASHES[Math.floor(i / COLOURS.length) % DASHES.length] });
  function el(name, attributes = {}, ...children) {
    const node = document.createElementNS(NS, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  }
  function linearTicks(low, high, wanted = 5) {
    const raw = (high - low) / wanted || 1;
    const size = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].map((k) => k * size).find((s) => s >= raw);
    const ticks = [];
    for (let t = Math.ceil(low / step) * step; t <= high + step * 1e-9; t += step) ticks.push(Math.abs(t) < step * 1e-9 ? 0 : t);
    return ticks;
  }
  function logTicks(low, high) {
    const ticks = [];
    for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e++) ticks.push(10 ** e);
    const inside = ticks.filter((t) => t >= low * 0.999 && t <= high * 1.001);
    return inside.length > 1 ? inside : linearTicks(low, high, 4).filter((t) => t > 0);
  }
  function axes({ width, height, left, right, top, bottom, x, y, xlog, ylog, xlabel, ylabel, format, xformat, xticks }) {
    const svg = el("svg", { viewBox: `0 0 ${width} ${height}`, role: "group" });
    const sx = scale(x, [left, width - right], xlog), sy = scale(y, [height - bottom, top], ylog);
    for (const t of ylog ? logTicks(...y) : linearTicks(...y)) {
      svg.append(el("line", { class: "grid", x1: left, x2: width - right, y1: sy(t), y2: sy(t) }),
        el("text", { x: left - 8, y: sy(t) + 4, "text-anchor": "end" }, format(t)));
    }
    for (const t of xticks || (xlog ? logTicks(...x) : linearTicks(...x))) {
      svg.append(el("line", { class: "axis", x1: sx(t), x2: sx(t), y1: height - bottom, y2: height - bottom + 4 }),
        el("text", { x: sx(t), y: height - bottom + 18, "text-anchor": "middle" }, xformat(t)));
    }
    svg.append(el("line", { class: "axis", x1: left, x2: width - right, y1: height - bottom, y2: height - bottom }),
      el("text", { x: (left + width - right) / 2, y: height - 4, "text-anchor": "middle" }, xlabel),
      el("text", { x: left - 8, y: 12, "text-anchor": "start", dx: -(left - 8) }, ylabel));
    return { svg, sx, sy };
  }
  function scale([a, b], [p, q], log) {
    if (log) { const la = Math.log(a), lb = Math.log(b); return (v) => p + (q - p) * (Math.log(v) - la) / (lb - la || 1); }
    return (v) => p + (q - p) * (v - a) / (b - a || 1);
  }
  const short = (v) => {
    const s = Math.abs(v);
    if (s >= 1e6) return `${+(v / 1e6).toPrecision(3)}M`;
    if (s >= 1e3) return `${+(v / 1e3).toPrecision(3)}k`;
    return String(+v.toPrecision(3));
  };
  function padded(values, log) {
    let low = Math.min(...values), high = Math.max(...values);
    if (log) return [low / 1.5, high * 1.5];
    const room = (high - low || Math.abs(high) || 1) * 0.08;
    return [low - room, high + room];
  }
  // Names stand in a column beside the plot, so that none covers a point or another name: room for them, line height,
  // and rising places at least that far apart, about the middle of the wanted ones where the frame allows it.
  const NAMES = 232, GAP = 14;
  function apart(wanted, top, bottom) {
    const places = [];
    for (const y of wanted) places.push(places.length ? Math.max(y, places.at(-1) + GAP) : y);
    const shift = wanted.reduce((sum, y, i) => sum + y - places[i], 0) / (wanted.length || 1);
    const inside = Math.max(top - (places[0] + shift), Math.min(0, bottom - (places.at(-1) + shift)));
    return places.map((y) => y + shift + inside);
  }
  // points: {x, y, name, href, index, text}; front: names on the Pareto line, by rising x.
  function scatter(node, { points, front, xlabel, ylabel, label, ylog }) {
    node.replaceChildren();
    const good = points.filter((p) => Number.isFinite(p.x) && p.x > 0 && Number.isFinite(p.y));
    if (!good.length) { node.textContent = "Nothing to draw: no finite numbers."; return; }
    const width = 660, height = Math.max(380, GAP * good.length + 70);
    const box = { width, height, left: 52, right: NAMES, top: 26, bottom: 40 };
    const { svg, sx, sy } = axes({ ...box, x: padded(good.map((p) => p.x), true), y: padded(good.map((p) => p.y), ylog), xlog: true, ylog, xlabel, ylabel, format: short, xformat: short });
    svg.setAttribute("aria-label", label);
    const line = front.map((name) => good.find((p) => p.name === name)).filter(Boolean);
    if (line.length > 1) svg.append(el("path", { class: "front", d: line.map((p, i) => (i ? `H${sx(p.x)}V${sy(p.y)}` : `M${sx(p.x)} ${sy(p.y)}`)).join("") }));
    const order = [...good].sort((a, b) => sy(a.y) - sy(b.y)), beside = width - NAMES + 16;
    const places = apart(order.map((p) => sy(p.y)), 16, height - box.bottom);
    order.forEach((p, i) => {
      const x = sx(p.x), y = sy(p.y), { colour } = style(p.index), on = front.includes(p.name);
      const link = el("a", { href: p.href, "aria-label": p.text });
      link.append(el("title", {}, p.text),
        el("line", { x1: x, y1: y, x2: beside - 4, y2: places[i], stroke: colour, "stroke-width": 0.6, opacity: 0.7 }),
        el("circle", { cx: x, cy: y, r: on ? 5.5 : 4, fill: on ? colour : "var(--bg)", stroke: colour, "stroke-width": 2 }),
        el("text", { class: "name", x: beside, y: places[i] + 4, "font-weight": on ? 600 : 400 }, p.title));
      svg.append(link);
    });
    node.append(svg);
  }
  // series: {name, title, index, values}; floor: values of the noise floor in the same order, or null.
  function curves(node, { series, count, ylabel, xlabel, label, ylog, floor, names }) {
    node.replaceChildren();
    const all = series.flatMap((s) => s.values).filter((v) => Number.isFinite(v) && (!ylog || v > 0));
    if (!all.length) { node.textContent = "Nothing to draw: no finite numbers."; return; }
    const width = 1280, height = 430;
    const box = { width, height, left: 52, right: NAMES, top: 26, bottom: 40 };
    const floors = (floor || []).filter((v) => Number.isFinite(v) && (!ylog || v > 0));
    const y = padded(all.concat(floors.length ? [Math.max(...floors), Math.min(...floors)] : []), ylog);
    const step = Math.max(1, Math.ceil(count / 12));
    const xticks = [...Array(count).keys()].filter((i) => i % step === 0);
    const { svg, sx, sy } = axes({ ...box, x: [0, Math.max(1, count - 1)], y, ylog, xlabel, ylabel, format: short, xticks, xformat: (t) => String(t + 1) });
    svg.setAttribute("aria-label", label);
    if (floors.length) {
      const top = Math.min(...floors), bottom = Math.max(...floors);
      svg.append(el("rect", { class: "floor", x: box.left, width: width - box.left - box.right, y: Math.min(sy(top), sy(bottom)), height: Math.max(1.5, Math.abs(sy(top) - sy(bottom))) }));
    }
    const ends = [];
    for (const s of series) {
      const { colour, dash } = style(s.index);
      let d = "", pen = false, last = null;
      s.values.forEach((v, i) => {
        if (!Number.isFinite(v) || (ylog && v <= 0)) { pen = false; return; }
        d += `${pen ? "L" : "M"}${sx(i).toFixed(1)} ${sy(v).toFixed(1)}`;
        pen = true; last = [sx(i), sy(v)];
      });
      if (!last) continue;
      const path = el("path", { class: "line", d, stroke: colour, "stroke-dasharray": dash, "data-model": s.name });
      path.append(el("title", {}, s.title));
      svg.append(path);
      if (count === 1) svg.append(el("circle", { cx: last[0], cy: last[1], r: 4, fill: colour }));
      ends.push({ s, colour, x: last[0], y: last[1] });
    }
    ends.sort((a, b) => a.y - b.y);
    const places = apart(ends.map((e) => e.y), 10, Infinity);
    ends.forEach((e, i) => {
      svg.append(el("line", { x1: e.x + 2, y1: e.y, x2: width - box.right + 14, y2: places[i], stroke: e.colour, "stroke-width": 0.75 }),
        el("text", { class: "name", x: width - box.right + 18, y: places[i] + 4, "data-model": e.s.name }, e.s.title));
    });
    if (places.at(-1) > height) svg.setAttribute("viewBox", `0 0 ${width} ${places.at(-1) + 8}`);
    const lit = (name) => {
      node.classList.toggle("dim", Boolean(name));
      svg.querySelectorAll(".line").forEach((p) => p.classList.toggle("on", p.dataset.model === name));
    };
    svg.addEventListener("pointerover", (e) => lit(e.target.dataset ? e.target.dataset.model : ""));
    svg.addEventListener("pointerleave", () => lit(""));
    node.append(svg);
  }
  window.AtlasCharts = { scatter, curves, style, el, short };
})();
