// The page of a material: divider, Pareto chart, the grid of pictures, functions and lobes.
"use strict";
(() => {
  const $ = (id) => document.getElementById(id), C = window.AtlasCharts, P = window.AtlasPage;
  const D = JSON.parse($("data").textContent, (_, v) => (v === "Infinity" ? Infinity : v)), url = encodeURIComponent;
  const text = (v, d) => (v === null || v === undefined ? "–" : v === Infinity ? "∞" : v.toFixed(d));
  const storage = (b) => (b >= 1e6 ? `${+(b / 1e6).toPrecision(3)} MB` : b >= 1e3 ? `${+(b / 1e3).toPrecision(3)} kB` : `${Math.round(b)} B`);

  const divider = $("divider");
  if (divider) {
    const input = divider.querySelector("input");
    input.addEventListener("input", () => divider.style.setProperty("--at", `${input.value}%`));
  }
  const points = D.models.filter((m) => m.de00 !== null && m.bytes !== null).map((m) => ({ name: m.name, title: m.title, family: m.family, x: m.bytes, y: m.de00, href: `#fit-${url(m.name)}`, text: `${m.title}: ΔE00 ${text(m.de00, 2)}, ${storage(m.bytes)}` }));
  C.scatter($("pareto"), { points, front: D.front, xlabel: "bytes of one fit", ylabel: "ΔE00", label: "ΔE00 against bytes of one fit, one point per model", ylog: true });

  const select = $("snippet-model");
  if (select) {
    const fill = () => document.querySelectorAll(".snippets [data-stem]").forEach((s) => { s.textContent = select.value; });
    // Who comes for one fit, from the index say, finds the snippets of that one.
    const follow = () => { const asked = [...select.options].find((o) => `fit-${o.dataset.model}` === P.named()); if (asked) { select.value = asked.value; fill(); } };
    select.addEventListener("change", fill);
    window.addEventListener("hashchange", follow);
    follow();
  }

  // --- the grid: one set of tiles, whose pictures change with kind and scene; best first by what the kind shows -------------
  const SHOWN = { render: ["de00_mean", "ΔE00", 2, 1], de00: ["de00_mean", "ΔE00", 2, 1], diff: ["psnr_db", "PSNR", 1, -1], flip: ["flip_mean", "FLIP", 3, 1] };
  const tiles = new Map([...document.querySelectorAll("#tiles .tile")].map((t) => [t.dataset.model, t]));
  function grid() {
    const kind = Object.hasOwn(SHOWN, P.get("kind")) ? P.get("kind") : "render", scene = D.scenes.includes(P.get("scene")) ? P.get("scene") : D.scenes[0], s = D.scenes.indexOf(scene);
    const [key, name, digits, sign] = SHOWN[kind], view = { de00: "de00", diff: "signed", flip: "flipmap" }[kind];
    const value = (m) => m.values[key][s];
    const order = [...D.models].sort((a, b) => (value(a) === null) - (value(b) === null) || sign * (value(a) - value(b)));
    const best = order.length && value(order[0]) !== null ? text(value(order[0]), digits) : "";
    for (const model of order) {
      const tile = tiles.get(model.name), img = tile.querySelector("img");
      $("tiles").append(tile);
      if (!img) continue;
      // A picture that cannot be judged says why in its place.
      const lost = value(model) === null, missing = tile.querySelector(".missing");
      tile.querySelector("a").hidden = lost;
      if (missing) missing.hidden = !lost;
      tile.querySelector(".value").hidden = lost;
      if (lost) continue;
      img.src = `${url(D.material)}/renders/${url(scene)}/${url(model.name)}/${kind}.webp`;
      tile.querySelector("a").href = `../compare.html#m=${url(D.material)}&s=${url(scene)}&b=${url(model.name)}${view ? `&v=${view}` : ""}`;
      const shown = text(value(model), digits), mark = document.createElement("strong");
      mark.textContent = shown === best ? " best" : "";
      const se = key === "psnr_db" && model.values.psnr_se_db[s] === Infinity ? "≥ " : "";
      tile.querySelector(".value").replaceChildren(`${name} ${se}${shown}${key === "psnr_db" ? " dB" : ""}`, mark);
    }
    const reference = tiles.get("reference");
    if (reference) {
      reference.hidden = kind !== "render";
      reference.querySelector("img").src = `${url(D.material)}/renders/${url(scene)}/reference/render.webp`;
      reference.querySelector("a").href = `../compare.html#m=${url(D.material)}&s=${url(scene)}`;
    }
  }
  document.querySelectorAll("[data-switch] button").forEach((b) => b.addEventListener("click", grid)); // after that of page.js, which writes the choice to the address
  P.follow(grid);
  grid();

  // --- functions and lobes ---------------------------------------------------------------------------------------------------
  window.ATLAS_CURVES = (curves) => {
    const order = D.models.filter((m) => curves.lobes.models[m.name]).map((m, i) => ({ ...m, index: i }));
    const named = new Map(order.map((m) => [m.name, m]));
    // At first the best model and, as the best often have no functions, the best that has each; four or more in all.
    const first = new Set([() => true, ...curves.functions.map((f) => (m) => f.models[m.name])].flatMap((has) => order.find(has) ?? []));
    for (const m of order) if (first.size < 4) first.add(m);
    const on = P.get("on") ? P.get("on").split(",") : [...first].map((m) => m.name);
    const off = new Set(order.map((m) => m.name).filter((name) => !on.includes(name)));
    const places = curves.functions.map(({ title, axis }) => {
      const figure = document.createElement("figure"), node = document.createElement("div"), caption = document.createElement("figcaption");
      node.className = "chart"; caption.textContent = `${title} over ${axis}`;
      figure.append(node, caption);
      $("function-charts").append(figure);
      return node;
    });
    let incidence = 0;
    function draw() {
      curves.functions.forEach((f, i) => {
        const series = Object.entries(f.models).filter(([name]) => named.has(name) && !off.has(name)).map(([name, c]) => ({ name, title: named.get(name).title, index: named.get(name).index, values: c.x.map((x, n) => [x, c.y[n]]) }));
        C.lines(places[i], { series, xlabel: `${f.axis} (degrees)`, ylabel: f.unit ? `${f.title} (${f.unit})` : f.title, label: `${f.title} of the models that have it`, ykind: f.log ? "log" : "", xkind: f.axis === "θh" ? "root" : "", xticks: f.axis === "θh" ? [0, 1, 5, 15, 30, 60, 90] : [0, 30, 60, 90], xrange: [0, 90], height: 260 });
        if (!series.length) places[i].textContent = "None of the selected models has this function.";
      });
      const values = (y) => curves.lobes.x[incidence].map((x, n) => [x, y[incidence][n]]);
      const series = order.filter((m) => !off.has(m.name)).map((m) => ({ name: m.name, title: m.title, index: m.index, values: values(curves.lobes.models[m.name]) }));
      C.lines($("lobes"), { series: [{ name: "reference", title: "reference", index: 0, strong: true, values: values(curves.lobes.reference) }, ...series], xlabel: "outgoing angle (degrees)", ylabel: "BRDF (1/sr)", label: `Lobes at ${curves.lobes.incidence[incidence]} degrees of incidence`, ykind: "log", xticks: [-90, -60, -30, 0, 30, 60, 90], xrange: [-90, 90], height: 380 });
    }
    $("incidence").replaceChildren(...curves.lobes.incidence.map((angle, i) => {
      const button = document.createElement("button");
      button.type = "button"; button.textContent = `θi = ${angle}°`;
      button.setAttribute("aria-pressed", String(i === incidence));
      button.addEventListener("click", () => { incidence = i; $("incidence").querySelectorAll("button").forEach((b, n) => b.setAttribute("aria-pressed", String(n === i))); draw(); });
      return button;
    }));
    C.legend($("function-legend"), order, off, () => { P.set({ on: order.filter((m) => !off.has(m.name)).map((m) => m.name).join(",") || "," }); draw(); });
    draw();
  };
})();
