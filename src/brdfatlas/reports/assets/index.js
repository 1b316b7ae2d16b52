// The index: one set of choices (measure, scene, class, search) drives gallery, Pareto plots, heat map and curves.
"use strict";
(() => {
  const A = window.ATLAS, C = window.AtlasCharts;
  if (!A || !C) return;
  const $ = (id) => document.getElementById(id);
  const K = A.models.length + 1, J = A.materials.length;
  const VIRIDIS = [[68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142], [31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37]];
  const option = (value, text) => { const o = document.createElement("option"); o.value = value; o.textContent = text; return o; };
  const node = (name, attributes = {}, ...children) => { const n = document.createElement(name); for (const [k, v] of Object.entries(attributes)) n.setAttribute(k, v); n.append(...children); return n; };
  const url = encodeURIComponent;

  A.measures.forEach((m) => $("measure").append(option(m.key, m.title)));
  if (A.scenes.length > 1) $("scene").append(option("", "mean over scenes"));
  A.scenes.forEach((s) => $("scene").append(option(s.name, s.title)));
  [...new Set(A.materials.map((m) => m.class))].filter(Boolean).sort().forEach((c) => $("class").append(option(c, c)));

  const state = { sort: "", descending: true, off: new Set() };
  const measure = () => A.measures.find((m) => m.key === $("measure").value);
  const at = (key, s, j, k) => A.values[key][(s * J + j) * K + k];
  // One value a material and model: of the scene, or the mean over scenes where all of them have one.
  function value(j, k, key = measure().key) {
    const chosen = $("scene").value;
    const places = A.scenes.map((_, s) => s).filter((s) => !chosen || A.scenes[s].name === chosen);
    let sum = 0;
    for (const s of places) { const v = at(key, s, j, k); if (v === null) return null; sum += v; }
    return sum / places.length;
  }
  // PSNR is a lower bound where the noise of the renders hides the difference: its standard error is then infinite.
  const bound = (j, k) => (measure().key === "psnr_db" && value(j, k, "psnr_se_db") === Infinity && value(j, k) !== Infinity ? "≥ " : "");
  function shown() {
    const words = $("query").value.toLowerCase().split(/\s+/).filter(Boolean), wanted = $("class").value;
    return A.materials.map((m, j) => j).filter((j) => {
      const m = A.materials[j];
      const text = `${m.name} ${m.title} ${m.class} ${m.standin ? "stand-in" : "measured"}`.toLowerCase();
      return (!wanted || m.class === wanted) && words.every((w) => text.includes(w));
    });
  }
  const mean = (values) => { const good = values.filter((v) => v !== null); return good.length ? good.reduce((a, b) => a + b, 0) / good.length : NaN; };
  const median = (values) => { const s = values.filter((v) => v !== null).sort((a, b) => a - b), n = s.length; return n ? (s[(n - 1) >> 1] + s[n >> 1]) / 2 : NaN; };
  // Without a number of decimals three significant digits: errors span decades.
  const significant = (v) => (v === 0 ? "0" : Math.abs(v) < 1e-4 ? v.toExponential(2) : v.toFixed(Math.max(0, 2 - Math.floor(Math.log10(Math.abs(v))))));
  const text = (v, d = measure().digits) => (v === null || Number.isNaN(v) ? "–" : v === Infinity ? "∞" : (d === null ? significant(v) : v.toFixed(d)).replace("-", "−"));
  const BEST = new Set(A.best);
  // The best PSNRs of a picture: all that the noise does not tell apart from the highest. Means and other measures: by value.
  function isBest(j, k, v, top) {
    const s = A.scenes.length > 1 ? A.scenes.findIndex((x) => x.name === $("scene").value) : 0;
    return measure().key === "psnr_db" && s >= 0 ? BEST.has((s * J + j) * K + k) : v === top;
  }

  function front(points, higher) {
    const sign = higher ? -1 : 1;
    let best = Infinity;
    const names = [];
    for (const p of points.filter((q) => Number.isFinite(q.x) && Number.isFinite(q.y)).sort((a, b) => a.x - b.x || sign * (a.y - b.y))) {
      if (sign * p.y < best) { best = sign * p.y; names.push(p.name); }
    }
    return names;
  }
  function drawPareto(rows) {
    const m = measure();
    const pictures = rows.filter((j) => A.models.some((_, k) => value(j, k) !== null));
    const points = A.models.map((model, k) => {
      const have = pictures.filter((j) => value(j, k) !== null).length, complete = have === pictures.length;
      return { name: model.name, title: complete ? model.title : `${model.title} (${have} of ${pictures.length})`, complete, index: k, y: mean(rows.map((j) => value(j, k))), href: `models/${url(model.name)}.html`, bytes: median(rows.map((j) => A.bytes[j][k])), seconds: median(rows.map((j) => A.seconds[j][k])) };
    });
    for (const [id, key, label] of [["pareto-bytes", "bytes", "bytes of one fit (median)"], ["pareto-seconds", "seconds", "seconds of one fit (median)"]]) {
      const here = points.map((p) => ({ ...p, x: p[key], text: `${p.title}: ${text(p.y)} ${m.title}, ${C.short(p[key])} ${key}` }));
      C.scatter($(id), { points: here, front: front(here.filter((p) => p.complete), m.higher), xlabel: label, ylabel: `mean ${m.title}`, label: `Mean ${m.title} against ${label}, one point a model` });
    }
  }
  function ramp(share) {
    const t = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1), i = Math.min(Math.floor(t), VIRIDIS.length - 2), f = t - i;
    return VIRIDIS[i].map((c, n) => Math.round(c + f * (VIRIDIS[i + 1][n] - c)));
  }
  const luminance = (rgb) => { const [r, g, b] = rgb.map((c) => { c /= 255; return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; }); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  function drawHeat(rows) {
    const m = measure(), table = $("heat");
    const matrix = new Map(rows.map((j) => [j, A.models.map((_, k) => value(j, k))]));
    const finite = [...matrix.values()].flat().filter((v) => Number.isFinite(v));
    if (!finite.length) {
      table.replaceChildren();
      $("heat-bar").textContent = rows.length ? "No finite numbers." : "Nothing matches.";
      return;
    }
    const skewed = !m.higher && finite.some((v) => v > 0) && Math.max(...finite) / Math.min(...finite.filter((v) => v > 0)) > 100;
    const f = skewed ? (v) => Math.log(Math.max(v, 1e-12)) : (v) => v;
    const low = Math.min(...finite), high = Math.max(...finite);
    const positive = skewed ? Math.min(...finite.filter((v) => v > 0)) : low;
    // Bright is good, whichever way the measure points.
    const share = (v) => { if (v === Infinity) return 1; const t = (f(v) - f(positive)) / (f(high) - f(positive) || 1); return m.higher ? t : 1 - t; };
    const floors = rows.map((j) => value(j, K - 1));
    const withFloor = floors.some((v) => v !== null);
    const heads = [["", "Material", ""], ["class", "Class", "turn"], ["diffuseness", "Diffuseness", "turn"], ...A.models.map((x, k) => [String(k), x.title, "turn"]), ...(withFloor ? [["floor", "noise floor", "turn"]] : [])];
    const sorted = [...rows];
    if (state.sort !== "") {
      const key = state.sort === "class" ? (j) => A.materials[j].class : state.sort === "diffuseness" ? (j) => A.materials[j].diffuseness
        : state.sort === "floor" ? (j) => value(j, K - 1) : (j) => matrix.get(j)[Number(state.sort)];
      sorted.sort((a, b) => window.AtlasPage.compare(key(a), key(b), state.descending ? -1 : 1));
    }
    const head = node("tr");
    for (const [key, title, kind] of heads) {
      const cell = node("th", { scope: "col", class: kind });
      const button = node("button", { type: "button", class: "sort", "data-key": key }, title);
      button.addEventListener("click", () => {
        state.descending = state.sort === key ? !state.descending : true;
        state.sort = key;
        drawHeat(shown());
        table.querySelector(`button[data-key="${key}"]`).focus();
      });
      if (state.sort === key && key !== "") cell.setAttribute("aria-sort", state.descending ? "descending" : "ascending");
      cell.append(button);
      head.append(cell);
    }
    const body = node("tbody");
    for (const j of sorted) {
      const material = A.materials[j], row = node("tr", { "data-material": material.name });
      const name = node("th", { scope: "row" }, node("a", { href: `materials/${url(material.name)}.html` }, material.title));
      if (material.standin) name.append(" ", node("span", { class: "badge standin" }, "stand-in"));
      row.append(name, node("td", {}, material.class || "–"), node("td", {}, text(material.diffuseness, 2)));
      const values = matrix.get(j);
      const good = values.filter((v) => v !== null);
      const best = m.higher ? Math.max(...good) : Math.min(...good);
      values.forEach((v, k) => {
        const model = A.models[k];
        if (v === null) {
          const reason = A.reasons[`${material.name}/${model.name}`] || "no picture";
          row.append(node("td", { class: "fail", title: `${model.title}: ${reason}` }, node("span", { class: "hidden" }, reason)));
          return;
        }
        const rgb = ramp(share(v));
        const cell = node("td", { style: `background:rgb(${rgb});color:${luminance(rgb) > 0.18 ? "#000" : "#fff"}`, title: `${material.title}, ${model.title}: ${text(v)} ${m.title}` });
        const scene = $("scene").value || A.scenes[0].name;
        const link = node("a", { href: `compare.html#m=${url(material.name)}&s=${url(scene)}&b=${url(model.name)}` }, bound(j, k) + text(v));
        if (isBest(j, k, v, best)) { cell.classList.add("best"); link.prepend("● "); link.append(node("span", { class: "hidden" }, " best")); }
        cell.append(link);
        row.append(cell);
      });
      if (withFloor) row.append(node("td", { class: "floor" }, text(value(j, K - 1))));
      body.append(row);
    }
    table.replaceChildren(node("caption", { class: "hidden" }, `${m.title} of every model on every material`), node("thead", {}, head), body);
    const ends = m.higher ? [text(low), text(high)] : [text(high), text(positive)];
    $("heat-bar").replaceChildren(node("span", { class: "bar" }, ends[0], node("span", { class: "ramp", role: "img", "aria-label": `Colour scale, from ${ends[0]} (worst) to ${ends[1]} (best)`, style: `background:linear-gradient(90deg,${VIRIDIS.map((c) => `rgb(${c})`)})` }), ends[1], ` ${m.title}${skewed ? ", logarithmic" : ""}, bright is good`));
  }
  function drawCurves(rows) {
    const m = measure(), how = $("order").value;
    const skewed = ["rmse", "rel_mse"].includes(m.key);
    const sign = m.higher ? 1 : -1;
    let order = [...rows];
    if (how === "diffuseness") order.sort((a, b) => window.AtlasPage.compare(A.materials[a].diffuseness, A.materials[b].diffuseness, 1));
    if (how === "mean") { const means = new Map(rows.map((j) => [j, mean(A.models.map((_, k) => value(j, k)))])); order.sort((a, b) => sign * (means.get(a) - means.get(b))); }
    const series = A.models.map((model, k) => {
      let values = order.map((j) => value(j, k));
      if (how === "own") values = values.filter((v) => v !== null).sort((a, b) => sign * (a - b));
      return { name: model.name, title: model.title, index: k, values };
    }).filter((s) => !state.off.has(s.name));
    const floor = order.map((j) => value(j, K - 1)).filter((v) => v !== null);
    C.curves($("curves"), { series, count: order.length, ylabel: m.title, xlabel: how === "own" ? "materials, each model in its own order, worst first" : how === "mean" ? "materials by mean error, worst first" : "materials by rising diffuseness", label: `${m.title} of every material, one curve a model`, ylog: skewed, floor });
  }
  function drawLegend() {
    A.models.forEach((model, k) => {
      const { colour, dash } = C.style(k);
      const button = node("button", { type: "button", "aria-pressed": "true" });
      button.append(C.el("svg", { viewBox: "0 0 22 8", "aria-hidden": "true" }, C.el("line", { x1: 0, x2: 22, y1: 4, y2: 4, stroke: colour, "stroke-width": 2.5, "stroke-dasharray": dash })), model.title);
      button.addEventListener("click", () => {
        const off = state.off.has(model.name);
        if (off) state.off.delete(model.name); else state.off.add(model.name);
        button.setAttribute("aria-pressed", String(off));
        drawCurves(shown());
      });
      $("legend").append(button);
    });
  }
  function draw() {
    const rows = shown(), names = new Set(rows.map((j) => A.materials[j].name));
    document.querySelectorAll("#gallery li").forEach((li) => { li.hidden = !names.has(li.dataset.material); });
    $("count").textContent = rows.length === J ? `${J} materials` : `${rows.length} of ${J} materials`;
    drawPareto(rows);
    drawHeat(rows);
    drawCurves(rows);
  }
  drawLegend();
  for (const id of ["measure", "scene", "class"]) $(id).addEventListener("change", draw);
  $("query").addEventListener("input", draw);
  $("order").addEventListener("change", () => drawCurves(shown()));
  $("controls").addEventListener("submit", (e) => e.preventDefault());
  draw();
})();
