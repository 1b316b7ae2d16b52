// The index: recommendation, Pareto chart, leaderboard, heat map, curves, from data/atlas.js. All that a reader chooses
// is in the address.
"use strict";
(() => {
  const A = window.ATLAS, C = window.AtlasCharts, P = window.AtlasPage;
  const $ = (id) => document.getElementById(id);
  if (!A) { $("count").textContent = "data/atlas.js is missing"; return; }
  const J = A.materials.length, K = A.models.length + 1;
  const VIRIDIS = [[68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142], [31, 158, 137], [53, 183, 121], [109, 205, 89], [180, 222, 44], [253, 231, 37]];
  const url = encodeURIComponent;
  function node(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.append(...children);
    return made;
  }
  const option = (value, text) => node("option", { value }, text);
  A.measures.forEach((m) => $("measure").append(option(m.key, m.title)));
  if (A.scenes.length > 1) $("scene").append(option("", "mean over scenes"));
  A.scenes.forEach((s) => $("scene").append(option(A.scenes.length > 1 ? s.name : "", s.title)));
  A.classes.forEach((c) => $("class").append(option(c, c)));

  // --- numbers ------------------------------------------------------------------------------------------------------------
  const measure = () => A.measures.find((m) => m.key === $("measure").value);
  const at = (key, s, j, k) => A.values[key][(s * J + j) * K + k];
  const chosenScenes = () => { const name = $("scene").value; return A.scenes.map((_, s) => s).filter((s) => !name || A.scenes[s].name === name); };
  // One value a material and model: of the scene, or the mean over scenes where all have one by which any model is judged.
  const unjudged = (j, s) => A.unjudged[`${A.materials[j].name}/${A.scenes[s].name}`];
  function value(j, k, key = measure().key, places = chosenScenes()) {
    let sum = 0, count = 0;
    for (const s of places) if (!unjudged(j, s)) { const v = at(key, s, j, k); if (v === null) return null; sum += v; count++; }
    return count ? sum / count : null;
  }
  // PSNR is a lower bound where the noise of the renders hides the difference: its standard error is then infinite.
  const bound = (j, k) => (measure().key === "psnr_db" && value(j, k, "psnr_se_db") === Infinity && value(j, k) !== Infinity ? "≥ " : "");
  const median = (values) => { const s = values.filter((v) => v !== null).sort((a, b) => a - b), n = s.length; return n ? (s[(n - 1) >> 1] + s[n >> 1]) / 2 : NaN; };
  // Without a number of decimals three significant digits: errors span decades.
  const significant = (v) => (v === 0 ? "0" : Math.abs(v) < 1e-4 ? v.toExponential(2) : v.toFixed(Math.max(0, 2 - Math.floor(Math.log10(Math.abs(v))))));
  const text = (v, d = measure().digits) => (v === null || Number.isNaN(v) ? "–" : v === Infinity ? "∞" : (d === null ? significant(v) : v.toFixed(d)).replace("-", "−"));
  const storage = (b) => (b >= 1e6 ? `${+(b / 1e6).toPrecision(3)} MB` : b >= 1e3 ? `${+(b / 1e3).toPrecision(3)} kB` : `${Math.round(b)} B`);
  const seconds = (s) => (s === null || Number.isNaN(s) ? "–" : s < 1 ? `${Math.round(1000 * s)} ms` : s < 100 ? `${s.toFixed(1)} s` : `${Math.round(s / 60)} min`);
  function shown() {
    const words = $("query").value.toLowerCase().split(/\s+/).filter(Boolean), wanted = $("class").value;
    return A.materials.map((m, j) => j).filter((j) => {
      const m = A.materials[j], all = `${m.name} ${m.title} ${m.class} ${m.standin ? "stand-in" : "measured"}`.toLowerCase();
      return (!wanted || m.class === wanted) && words.every((w) => all.includes(w));
    });
  }
  // Models by the median of the chosen measure over the materials shown, best first; those that lack pictures last.
  function ranking(rows) {
    const places = chosenScenes(), key = measure().key, sign = measure().higher ? -1 : 1;
    const pictures = rows.filter((j) => A.models.some((_, k) => value(j, k, key, places) !== null));
    return A.models.map((model, k) => {
      const values = rows.map((j) => value(j, k, key, places)), have = pictures.filter((j) => value(j, k, key, places) !== null).length;
      return { k, model, values, middle: median(values), complete: have === pictures.length, have, pictures: pictures.length };
    }).sort((a, b) => b.complete - a.complete || (Number.isNaN(a.middle) - Number.isNaN(b.middle)) || sign * (a.middle - b.middle));
  }

  // --- recommendation -----------------------------------------------------------------------------------------------------
  const folder = (j) => `materials/${url(A.materials[j].name)}`;
  const picture = (j, name) => `${folder(j)}/renders/${url(A.scenes[0].name)}/${url(name)}/render.webp`;
  const ENGINE = [".xml", ".mtlx", ".gltf"];
  function cell(j, k, budget) {
    if (k < 0) return node("td", { class: "none" }, "none");
    const model = A.models[k], de = value(j, k, "de00_mean", A.scenes.map((_, s) => s)), bytes = A.bytes[j][k], time = A.seconds[j][k];
    const endings = A.endings[A.files[j][k]], wanted = budget === "engine" ? endings.filter((e) => ENGINE.includes(e)) : endings.includes(".npz") ? [".npz"] : [];
    const links = node("span", { class: "links" });
    for (const ending of wanted) links.append(node("a", { href: `${folder(j)}/fits/${url(A.stems[j][k])}${ending}`, download: "", title: `Download ${model.title} for ${A.materials[j].title}` }, wanted.length > 1 || budget === "engine" ? ending : "download"));
    links.append(node("a", { href: `compare.html#m=${url(A.materials[j].name)}&s=${url(A.scenes[0].name)}&b=${url(model.name)}` }, "compare"));
    return node("td", { "data-model": model.name },
      node("a", { href: `${folder(j)}.html#fit-${url(model.name)}`, class: "pick" }, node("img", { src: picture(j, model.name), width: 72, height: 72, loading: "lazy", decoding: "async", alt: "" }), node("strong", {}, model.title)),
      node("span", { class: "numbers" }, `ΔE00 ${text(de, 2)} · ${storage(bytes)} · ${seconds(time)}`), links);
  }
  function head(material) {
    const j = A.materials.indexOf(material);
    return node("th", { scope: "row" }, node("a", { href: `${folder(j)}.html`, class: "pick" }, node("img", { src: picture(j, "reference"), width: 72, height: 72, loading: "lazy", decoding: "async", alt: "" }), material.title), material.class ? node("span", { class: "numbers" }, material.class) : "");
  }
  const open = new Set();
  function drawRecommended() {
    const bits = [...$("switches").querySelectorAll("input")].reduce((sum, box, i) => sum + (box.checked ? 2 ** i : 0), 0), body = node("tbody");
    const few = J <= 12;
    const materialRow = (j) => node("tr", { "data-material": A.materials[j].name }, head(A.materials[j]), ...A.recommended[bits][j].map((k, b) => cell(j, k, A.budgets[b].key)));
    if (few) A.materials.forEach((_, j) => body.append(materialRow(j)));
    else A.classes.forEach((name, c) => {
      const members = A.materials.map((m, j) => j).filter((j) => A.materials[j].class === name), button = node("button", { type: "button", "aria-expanded": String(open.has(name)) }, `${name} (${members.length})`);
      button.addEventListener("click", () => { if (open.has(name)) open.delete(name); else open.add(name); P.set({ open: [...open].join(",") }); drawRecommended(); $("recommended").querySelectorAll("button")[c].focus(); });
      body.append(node("tr", { class: "class", "data-class": name }, node("th", { scope: "row" }, button), ...A.of_class[bits][c].map((k) => {
        if (k < 0) return node("td", { class: "none" }, "none");
        const places = A.scenes.map((_, s) => s), de = median(members.map((j) => value(j, k, "de00_mean", places)));
        const near = members.filter((j) => value(j, k, "de00_mean", places) !== null).reduce((a, j) => (Math.abs(value(j, k, "de00_mean", places) - de) < Math.abs(value(a, k, "de00_mean", places) - de) ? j : a));
        return node("td", { "data-model": A.models[k].name }, node("a", { href: `models/${url(A.models[k].name)}.html`, class: "pick" }, node("img", { src: picture(near, A.models[k].name), width: 72, height: 72, loading: "lazy", alt: "" }), node("strong", {}, A.models[k].title)),
          node("span", { class: "numbers" }, `ΔE00 ${text(de, 2)} · ${storage(Math.max(...members.map((j) => A.bytes[j][k])))} · ${seconds(median(members.map((j) => A.seconds[j][k])))}`), node("span", { class: "links" }, node("a", { href: `compare.html#m=${url(A.materials[near].name)}&s=${url(A.scenes[0].name)}&b=${url(A.models[k].name)}` }, "compare")));
      })));
      if (open.has(name)) members.forEach((j) => body.append(materialRow(j)));
    });
    $("recommended").replaceChildren(node("caption", { class: "hidden" }, "Recommended model for every material and budget"),
      node("thead", {}, node("tr", {}, node("th", { scope: "col" }, few ? "Material" : "Class"), ...A.budgets.map((b) => node("th", { scope: "col" }, b.title)))), body);
  }

  // --- Pareto chart ---------------------------------------------------------------------------------------------------------
  function front(points, higher) {
    const sign = higher ? -1 : 1, names = [];
    let best = Infinity, cost = NaN;
    for (const p of points.filter((q) => Number.isFinite(q.x) && !Number.isNaN(q.y)).sort((a, b) => a.x - b.x || sign * (a.y - b.y))) if (sign * p.y < best || (p.x === cost && sign * p.y === best)) { best = sign * p.y; cost = p.x; names.push(p.name); }
    return names;
  }
  const costKey = () => $("cost").querySelector("[aria-pressed=true]").value;
  function drawPareto(ranked, rows) {
    const m = measure(), key = costKey();
    const points = ranked.map(({ k, model, middle, complete, have, pictures }) => {
      const title = complete ? model.title : `${model.title} (${have} of ${pictures} materials)`, x = median(rows.map((j) => A[key][j][k]));
      return { name: model.name, title, complete, family: model.family, x, y: middle, href: `models/${url(model.name)}.html`, text: `${title}: ${m.title} ${text(middle)}, ${key === "bytes" ? storage(x) : seconds(x)}` };
    });
    C.scatter($("pareto"), { points, front: front(points.filter((p) => p.complete), m.higher), xlabel: `${key} of one fit (median)`, ylabel: `${m.title} (median)`, label: `Median ${m.title} against ${key} of one fit, one point per model`, ylog: !m.higher });
  }

  // --- heat map -------------------------------------------------------------------------------------------------------------
  const state = { sort: "", descending: true, off: new Set() };
  function ramp(share) {
    const t = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1), i = Math.min(Math.floor(t), VIRIDIS.length - 2), f = t - i;
    return VIRIDIS[i].map((c, n) => Math.round(c + f * (VIRIDIS[i + 1][n] - c)));
  }
  const luminance = (rgb) => { const [r, g, b] = rgb.map((c) => { c /= 255; return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; }); return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const BEST = new Set(A.best);
  // The best PSNRs of a picture: all that are statistically indistinguishable from the highest; else all that print alike.
  function isBest(j, k, v, top) {
    const s = A.scenes.length > 1 ? A.scenes.findIndex((x) => x.name === $("scene").value) : 0;
    return measure().key === "psnr_db" && s >= 0 ? BEST.has((s * J + j) * K + k) : text(v) === text(top);
  }
  function drawHeat(rows, ranked) {
    const m = measure(), table = $("heat"), places = chosenScenes();
    const columns = A.families.flatMap((family) => ranked.filter((r) => r.model.family === family));
    const matrix = new Map(rows.map((j) => [j, new Map(columns.map((c) => [c.k, value(j, c.k, m.key, places)]))]));
    const finite = [...matrix.values()].flatMap((row) => [...row.values()]).filter((v) => Number.isFinite(v));
    if (!finite.length) { table.replaceChildren(); $("heat-bar").textContent = rows.length ? "No finite numbers." : "Nothing matches."; return; }
    const positives = finite.filter((v) => v > 0), skewed = !m.higher && positives.length > 0;
    const low = skewed ? Math.min(...positives) : Math.min(...finite), high = Math.max(...finite), f = skewed ? (v) => Math.log(Math.max(v, low)) : (v) => v;
    // Bright is good, whichever way the measure points.
    const share = (v) => { if (v === Infinity) return 1; const t = (f(v) - f(low)) / (f(high) - f(low) || 1); return m.higher ? t : 1 - t; };
    const withNoise = rows.some((j) => value(j, K - 1, m.key, places) !== null);
    const heads = [["", "Material", ""], ["class", "Class", "turn"], ["diffuseness", "Diffuseness", "turn"], ...columns.map((c) => [String(c.k), c.model.title, "turn"]), ...(withNoise ? [["noise", "reference, other seed", "turn"]] : [])];
    const sorted = [...rows];
    if (state.sort !== "") {
      const key = state.sort === "class" ? (j) => A.materials[j].class : state.sort === "diffuseness" ? (j) => A.materials[j].diffuseness : state.sort === "noise" ? (j) => value(j, K - 1) : (j) => matrix.get(j).get(Number(state.sort)) ?? null;
      sorted.sort((a, b) => P.compare(key(a), key(b), state.descending ? -1 : 1));
    }
    const families = node("tr", { class: "family-row" }, node("th"), node("td", { colspan: 2 }));
    A.families.forEach((family) => { const n = columns.filter((c) => c.model.family === family).length; if (n) families.append(node("th", { scope: "colgroup", colspan: n, class: "family", style: `--family:var(--f-${family})` }, family)); });
    if (withNoise) families.append(node("td"));
    const headRow = node("tr");
    for (const [key, title, kind] of heads) {
      const th = node("th", { scope: "col", class: kind }), button = node("button", { type: "button", class: "sort", "data-key": key }, title);
      button.addEventListener("click", () => {
        state.descending = state.sort === key ? !state.descending : true;
        state.sort = key;
        P.set({ heat: key === "" ? "" : `${key === "class" || key === "diffuseness" || key === "noise" ? key : A.models[Number(key)].name}${state.descending ? "" : ",up"}` });
        drawHeat(shown(), ranking(shown()));
        table.querySelector(`button[data-key="${key}"]`).focus();
      });
      if (state.sort === key && key !== "") th.setAttribute("aria-sort", state.descending ? "descending" : "ascending");
      th.append(button);
      headRow.append(th);
    }
    const body = node("tbody"), scene = $("scene").value || A.scenes[0].name;
    for (const j of sorted) {
      const material = A.materials[j], row = node("tr", { "data-material": material.name });
      row.append(node("th", { scope: "row" }, node("a", { href: `${folder(j)}.html` }, material.title)), node("td", {}, material.class || "–"), node("td", {}, text(material.diffuseness, 2)));
      const values = matrix.get(j), good = [...values.values()].filter((v) => v !== null), best = m.higher ? Math.max(...good) : Math.min(...good);
      for (const { k, model } of columns) {
        const v = values.get(k);
        if (v === null) {
          const reason = A.reasons[`${material.name}/${model.name}`] || places.map((s) => unjudged(j, s)).find(Boolean) || "no picture";
          row.append(node("td", { class: "fail", title: `${model.title}: ${reason}` }, node("span", { class: "hidden" }, reason)));
          continue;
        }
        const rgb = ramp(share(v)), td = node("td", { style: `background:rgb(${rgb});color:${luminance(rgb) > 0.18 ? "#000" : "#fff"}`, title: `${material.title}, ${model.title}: ${m.title} ${text(v)}` });
        const link = node("a", { href: `compare.html#m=${url(material.name)}&s=${url(scene)}&b=${url(model.name)}` }, bound(j, k) + text(v));
        if (isBest(j, k, v, best)) { td.classList.add("best"); link.prepend("● "); link.append(node("span", { class: "hidden" }, " best")); }
        td.append(link);
        row.append(td);
      }
      if (withNoise) row.append(node("td", { class: "noise" }, text(value(j, K - 1, m.key, places))));
      body.append(row);
    }
    table.replaceChildren(node("caption", { class: "hidden" }, `${m.title} of every model on every material`), node("thead", {}, families, headRow), body);
    const ends = m.higher ? [text(low), text(high)] : [text(high), text(low)];
    $("heat-bar").replaceChildren(node("span", { class: "bar" }, ends[0], node("span", { class: "ramp", role: "img", "aria-label": `Colour scale, from ${ends[0]} (worst) to ${ends[1]} (best)`, style: `background:linear-gradient(90deg,${VIRIDIS.map((c) => `rgb(${c})`)})` }), ends[1], ` ${m.title}${skewed ? ", logarithmic" : ""}, bright is good`));
  }

  // --- every material -------------------------------------------------------------------------------------------------------
  function drawCurves(rows, ranked) {
    const m = measure();
    if (J <= 8) {
      C.dots($("curves"), { rows: ranked.map(({ k, model, middle }) => ({ name: model.name, title: model.title, family: model.family, middle, href: `models/${url(model.name)}.html`, dots: rows.map((j) => ({ x: value(j, k) ?? NaN, href: `compare.html#m=${url(A.materials[j].name)}&s=${url($("scene").value || A.scenes[0].name)}&b=${url(model.name)}`, text: `${model.title}, ${A.materials[j].title}: ${m.title} ${text(value(j, k))}` })) })), xlabel: m.title, xlog: !m.higher, label: `${m.title} of every model and material` });
      return;
    }
    const how = $("order").value, sign = m.higher ? 1 : -1, order = [...rows];
    if (how === "diffuseness") order.sort((a, b) => P.compare(A.materials[a].diffuseness, A.materials[b].diffuseness, 1));
    if (how === "mean") { const middles = new Map(rows.map((j) => [j, median(A.models.map((_, k) => value(j, k)))])); order.sort((a, b) => sign * (middles.get(a) - middles.get(b))); }
    const series = ranked.map(({ k, model }) => {
      let values = order.map((j) => value(j, k));
      if (how === "own") values = values.filter((v) => v !== null).sort((a, b) => sign * (a - b));
      return { name: model.name, title: model.title, index: k, values: values.map((v, i) => [i + 1, v ?? NaN]) };
    }).filter((s) => !state.off.has(s.name) && s.values.length);
    const noise = order.map((j) => value(j, K - 1)).filter((v) => Number.isFinite(v) && (m.higher || v > 0));
    C.lines($("curves"), { series, xrange: [1, Math.max(order.length, 2)], ylabel: m.title, xlabel: how === "own" ? "materials, each model in its own order, worst first" : how === "mean" ? "materials by median error, worst first" : "materials by rising diffuseness", label: `${m.title} of every material, one curve per model`, ykind: m.higher ? "" : "log", bands: noise.length ? [[Math.min(...noise), Math.max(...noise)]] : [], height: 420 });
  }
  function drawLegend(ranked) {
    if (J <= 8) return;
    C.legend($("legend"), ranked.map(({ k, model }) => ({ name: model.name, title: model.title, index: k })), state.off, () => { P.set({ off: [...state.off].join(",") }); drawCurves(shown(), ranking(shown())); });
  }

  // --- leaderboard columns, state, start --------------------------------------------------------------------------------------
  const boxes = () => [...$("columns").querySelectorAll("input")];
  const defaults = boxes().filter((b) => b.defaultChecked).map((b) => b.value).join(",");
  function drawColumns() {
    const on = new Set(boxes().filter((b) => b.checked).map((b) => b.value));
    document.querySelectorAll("#leaderboard [data-column]").forEach((c) => { c.hidden = !on.has(c.dataset.column); });
  }
  function draw() {
    const rows = shown(), names = new Set(rows.map((j) => A.materials[j].name)), ranked = ranking(rows);
    document.querySelectorAll("#gallery li").forEach((li) => { li.hidden = !names.has(li.dataset.material); });
    $("count").textContent = rows.length === J ? `${J} material${J === 1 ? "" : "s"}` : `${rows.length} of ${J} materials`;
    drawPareto(ranked, rows);
    drawHeat(rows, ranked);
    drawCurves(rows, ranked);
    drawLegend(ranked);
  }
  const pick = (select, value) => { select.value = [...select.options].some((o) => o.value === value) ? value : select.options[0].value; };
  function read() {
    pick($("measure"), P.get("measure", A.measures[0].key)); pick($("scene"), P.get("scene")); pick($("class"), P.get("class"));
    $("query").value = P.get("q");
    if ($("order")) pick($("order"), P.get("order", "own"));
    const costs = [...$("cost").querySelectorAll("button")], cost = costs.find((b) => b.value === P.get("cost")) ?? costs[0];
    costs.forEach((b) => b.setAttribute("aria-pressed", String(b === cost)));
    const [sort, up] = P.get("heat").split(",");
    state.sort = ["", "class", "diffuseness", "noise"].includes(sort) ? sort : String(A.models.findIndex((m) => m.name === sort));
    if (state.sort === "-1") state.sort = "";
    state.descending = up !== "up";
    state.off = new Set(P.get("off").split(",").filter(Boolean));
    open.clear(); P.get("open").split(",").filter(Boolean).forEach((c) => open.add(c));
    const on = P.get("only").split(",");
    $("switches").querySelectorAll("input").forEach((b) => { b.checked = on.includes(b.value); });
    const columns = P.get("columns", defaults).split(",");
    boxes().forEach((b) => { b.checked = columns.includes(b.value); });
    drawColumns(); drawRecommended(); draw();
  }
  for (const [id, key, first] of [["measure", "measure", A.measures[0].key], ["scene", "scene", ""], ["class", "class", ""]]) $(id).addEventListener("change", (e) => { P.set({ [key]: e.target.value === first ? "" : e.target.value }); draw(); });
  $("query").addEventListener("input", (e) => { P.set({ q: e.target.value }); draw(); });
  if ($("order")) $("order").addEventListener("change", (e) => { P.set({ order: e.target.value === "own" ? "" : e.target.value }); drawCurves(shown(), ranking(shown())); });
  $("cost").querySelectorAll("button").forEach((b) => b.addEventListener("click", () => {
    $("cost").querySelectorAll("button").forEach((o) => o.setAttribute("aria-pressed", String(o === b)));
    P.set({ cost: b.value === "bytes" ? "" : b.value });
    drawPareto(ranking(shown()), shown());
  }));
  $("switches").addEventListener("change", () => { P.set({ only: [...$("switches").querySelectorAll("input:checked")].map((b) => b.value).join(",") }); drawRecommended(); });
  $("columns").addEventListener("change", () => { const on = boxes().filter((b) => b.checked).map((b) => b.value).join(","); P.set({ columns: on === defaults ? "" : on || "none" }); drawColumns(); });
  $("controls").addEventListener("submit", (e) => e.preventDefault());
  C.familyLegend($("families"), A.families);
  P.follow(read);
  read();
})();
