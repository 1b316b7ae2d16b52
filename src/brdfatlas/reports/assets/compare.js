// Compare: pictures of one material and scene, in place. The words and keys are those of JERI and tev.
"use strict";
(() => {
  const A = window.ATLAS;
  const $ = (id) => document.getElementById(id);
  if (!A) { $("message").textContent = "data/atlas.js is missing: build the index of this report."; return; }
  const canvas = $("canvas"), context = canvas.getContext("2d");
  const VIEWS = ["flip", "swipe", "side", "three", "four", "signed", "de00", "flipmap", "noise"];
  // Maps that the run drew, as pictures: view -> [kind, whose]; colour bars lie beside the style.
  const MAPS = { de00: "de00", flipmap: "flip", noise: "de00" };
  // So is the difference to the reference at the run's exposure: that of stored radiances has their steps.
  const mapKind = () => MAPS[state.v] || (state.v === "signed" && state.a === "reference" && state.b !== "reference" && state.e === 0 ? "diff" : "");
  const BARS = { de00: "bar-de00.svg", flipmap: "bar-flip.svg", noise: "bar-de00.svg" };
  const MODELS = [{ name: "reference", title: "reference" }, ...A.models];
  const K = A.models.length + 1, J = A.materials.length;
  const fresh = () => ({ m: A.materials[0].name, s: A.scenes[0].name, a: "reference", b: A.models[A.order[0]].name, v: "flip", e: 0, z: 1, x: 0.5, y: 0.5, w: 0.5 });
  let state = fresh(), flipped = false, pointer = null;

  // --- state in the address -----------------------------------------------------------------------------------------
  function read() {
    const given = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
    const next = fresh();
    if (A.materials.some((m) => m.name === given.m)) next.m = given.m;
    if (A.scenes.some((s) => s.name === given.s)) next.s = given.s;
    for (const key of ["a", "b"]) if (MODELS.some((m) => m.name === given[key])) next[key] = given[key];
    if (VIEWS.includes(given.v)) next.v = given.v;
    if (!given.b) next.b = ranked(next.m, next.s)[0].name;
    for (const key of ["e", "z", "x", "y", "w"]) if (given[key] && Number.isFinite(Number(given[key]))) next[key] = Number(given[key]);
    next.e = Math.min(Math.max(next.e, -8), 8);
    next.z = Math.min(Math.max(next.z, 1 / 32), 32);
    next.w = Math.min(Math.max(next.w, 0), 1);
    state = next;
  }
  let ownHash = "";
  function write() {
    const first = fresh(), words = new URLSearchParams();
    for (const [key, value] of Object.entries(state)) {
      const text = typeof value === "number" ? String(+value.toFixed(4)) : value;
      if (["m", "s", "b"].includes(key) || text !== String(first[key])) words.set(key, text);
    }
    ownHash = `#${words}`;
    history.replaceState(null, "", ownHash);
  }

  // Models of a picture, best first by dE00; those without a picture last.
  function number(model, key, m = state.m, s = state.s) {
    const j = A.materials.findIndex((x) => x.name === m), t = A.scenes.findIndex((x) => x.name === s), k = A.models.findIndex((x) => x.name === model);
    return k < 0 ? null : A.values[key][(t * J + j) * K + k];
  }
  function ranked(m = state.m, s = state.s) {
    return A.models.map((x) => [number(x.name, "de00_mean", m, s), x]).sort(([a], [b]) => (a === null) - (b === null) || a - b).map(([, x]) => x);
  }
  const shownModels = () => {
    const count = { side: 2, three: 3, four: 4 }[state.v] || 2, order = ranked().filter((x) => ![state.a, state.b].includes(x.name) && number(x.name, "de00_mean") !== null).map((x) => x.name);
    return [state.a, state.b, ...order].slice(0, count);
  };

  // --- pictures ---------------------------------------------------------------------------------------------------------
  const store = new Map();
  window.ATLAS_HDR = async (id, count, text) => {
    const entry = store.get(id);
    if (!entry) return;
    try { entry.picture = await decode(window.atlasUnpack(count, text), id); } catch { entry.error = "cannot be decoded"; }
    entry.done();
  };
  // Levels of log radiance as brdfatlas.figures.pictures stores them; a fit's are steps from those of its reference.
  const STEPS = 96, COARSE = 8;
  async function decode(bytes, id) {
    const own = id.replace(/[^/]*$/, "reference"), reference = own === id ? null : load(own);
    const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/webp" }), { colorSpaceConversion: "none", premultiplyAlpha: "none" });
    const off = new OffscreenCanvas(bitmap.width, bitmap.height), ctx = off.getContext("2d", { willReadFrequently: true });
    ctx.drawImage(bitmap, 0, 0);
    const raw = ctx.getImageData(0, 0, bitmap.width, bitmap.height).data;
    const width = bitmap.width, height = bitmap.height / 2, count = width * height;
    if (reference) await reference.waiting;
    const base = reference && reference.picture.levels;
    const rgb = new Float32Array(3 * count), levels = new Int16Array(3 * count);
    for (let i = 0; i < count; i++) for (let c = 0; c < 3; c++) {
      const o = 3 * i + c;
      levels[o] = raw[4 * i + c] + 256 * raw[4 * (i + count) + c] - 128;
      rgb[o] = 2 ** ((base ? base[o] + COARSE * levels[o] : levels[o]) / STEPS);
    }
    return { width, height, rgb, levels: base ? null : levels, canvas: null, exposure: NaN };
  }
  const idOf = (model, m = state.m, s = state.s) => `${m}/${s}/${model}`;
  function load(id) {
    if (store.has(id)) return store.get(id);
    const entry = { picture: null, error: "", waiting: null, done: null };
    entry.waiting = new Promise((resolve) => { entry.done = resolve; });
    store.set(id, entry);
    const [m, s, model] = id.split("/");
    const script = document.createElement("script");
    script.src = `materials/${encodeURIComponent(m)}/renders/${encodeURIComponent(s)}/${encodeURIComponent(model)}/hdr.js`;
    script.onerror = () => { entry.error = A.reasons[`${m}/${model}`] || A.unjudged[`${m}/${s}`] || "this run made no picture of it"; entry.done(); };
    script.onload = () => script.remove();
    document.head.append(script);
    entry.waiting.then(schedule);
    // A picture is 800 kB of floats: the oldest leave when there are too many.
    if (store.size > 160) for (const old of [...store.keys()].slice(0, 40)) if (!old.startsWith(`${state.m}/`)) store.delete(old);
    return entry;
  }
  function developed(picture) {
    const scene = A.scenes.find((s) => s.name === state.s);
    const k = (scene.exposure || 1) * 2 ** state.e, gamma = 1 / (scene.gamma || 2.2);
    if (picture.exposure === state.e && picture.canvas) return picture.canvas;
    const { width, height, rgb } = picture, image = new ImageData(width, height);
    for (let i = 0, n = width * height; i < n; i++) {
      for (let c = 0; c < 3; c++) image.data[4 * i + c] = Math.round(255 * (1 - 2 ** (-k * rgb[3 * i + c])) ** gamma);
      image.data[4 * i + 3] = 255;
    }
    return keep(picture, image);
  }
  function keep(picture, image) {
    picture.canvas = new OffscreenCanvas(image.width, image.height);
    picture.canvas.getContext("2d").putImageData(image, 0, 0);
    picture.exposure = state.e;
    return picture.canvas;
  }
  // Red: the right picture is brighter than the left; blue: darker. Root scale, so that 1 % of white is seen.
  const RDBU = [[5, 48, 97], [33, 102, 172], [67, 147, 195], [146, 197, 222], [209, 229, 240], [247, 247, 247], [253, 219, 199], [244, 165, 130], [214, 96, 77], [178, 24, 43], [103, 0, 31]];
  function errorMap(left, right) {
    const scene = A.scenes.find((s) => s.name === state.s), k = Math.LN2 * (scene.exposure || 1) * 2 ** state.e;
    const { width, height } = left, image = new ImageData(width, height);
    for (let i = 0, n = width * height; i < n; i++) {
      const o = 3 * i;
      const d = k * (0.2126 * (right.rgb[o] - left.rgb[o]) + 0.7152 * (right.rgb[o + 1] - left.rgb[o + 1]) + 0.0722 * (right.rgb[o + 2] - left.rgb[o + 2]));
      const t = (0.5 + 0.5 * Math.sign(d) * Math.sqrt(Math.min(Math.abs(d), 1))) * (RDBU.length - 1);
      const j = Math.min(Math.floor(t), RDBU.length - 2), f = t - j;
      for (let c = 0; c < 3; c++) image.data[4 * i + c] = Math.round(RDBU[j][c] + f * (RDBU[j + 1][c] - RDBU[j][c]));
      image.data[4 * i + 3] = 255;
    }
    return keep({}, image);
  }

  // --- drawing ------------------------------------------------------------------------------------------------------------
  let scheduled = false;
  // Until it is drawn, the canvas does not show what the state asks for: whoever waits for data-ready must not be misled.
  function schedule() {
    canvas.dataset.ready = "false";
    if (!scheduled) { scheduled = true; requestAnimationFrame(draw); }
  }
  const SIDES = ["side", "three", "four"];
  // Panels side by side; four in two rows, three and two below each other where the stage is upright.
  const panels = () => {
    const w = canvas.width, h = canvas.height, n = SIDES.includes(state.v) ? shownModels().length : 1;
    const columns = n === 4 ? 2 : h > w ? 1 : n, rows = Math.ceil(n / columns);
    return Array.from({ length: n }, (_, i) => ({ x: (i % columns) * w / columns, y: Math.floor(i / columns) * h / rows, w: w / columns, h: h / rows }));
  };
  // A picture that the run drew, for a map; drawn, never read.
  const drawnMaps = new Map();
  function mapOf(model) {
    const kind = mapKind(), whose = state.v === "noise" ? "reference_again" : model, src = `materials/${encodeURIComponent(state.m)}/renders/${encodeURIComponent(state.s)}/${encodeURIComponent(whose)}/${kind}.webp`;
    if (!drawnMaps.has(src)) {
      const image = new Image();
      image.onload = schedule; image.onerror = () => { image.dataset.error = A.reasons[`${state.m}/${model}`] || A.unjudged[`${state.m}/${state.s}`] || "this run made no such map"; schedule(); };
      image.src = src;
      drawnMaps.set(src, image);
    }
    return drawnMaps.get(src);
  }
  // Where the picture lies in a panel: fitted at zoom 1, then magnified around the point (x, y) of the picture.
  function place(panel, picture) {
    const scale = Math.min(panel.w / picture.width, panel.h / picture.height) * state.z;
    return { scale, left: panel.x + panel.w / 2 - state.x * picture.width * scale, top: panel.y + panel.h / 2 - state.y * picture.height * scale };
  }
  function paint(panel, picture, source, clip) {
    const p = place(panel, picture);
    context.save();
    context.beginPath();
    context.rect(...(clip || [panel.x, panel.y, panel.w, panel.h]));
    context.clip();
    context.imageSmoothingEnabled = p.scale < 1;
    context.imageSmoothingQuality = "high";
    context.drawImage(source, p.left, p.top, picture.width * p.scale, picture.height * p.scale);
    context.restore();
  }
  const titleOf = (name) => (MODELS.find((m) => m.name === name) || { title: name }).title;
  const digits = (v, d) => (v === null ? "–" : v === Infinity ? "∞" : v.toFixed(d));
  function psnr(model) {
    const v = number(model, "psnr_db");
    return v === null ? "–" : v === Infinity ? "∞" : `${number(model, "psnr_se_db") === Infinity ? "≥ " : ""}${v.toFixed(1)}`;
  }
  // Why a model has no picture: it is given parameters that there are not for the material, the reference is black, or its
  // fit failed.
  const lack = (model) => (A.absent.includes(`${state.m}/${model}`) ? "no parameters" : A.unjudged[`${state.m}/${state.s}`] ? "not judged" : "failed");
  const delta = (model) => (model === "reference" ? "" : number(model, "de00_mean") === null ? lack(model) : `ΔE00 ${digits(number(model, "de00_mean"), 2)}`);
  function draw() {
    scheduled = false;
    const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
    canvas.width = Math.max(1, Math.round(box.width * ratio));
    canvas.height = Math.max(1, Math.round(box.height * ratio));
    const sides = SIDES.includes(state.v), names = sides ? shownModels() : [state.a, state.b];
    const entries = names.map((name) => load(idOf(name))), [left, right] = entries, both = panels();
    const single = state.v === "flip" ? (flipped ? left : right) : null, map = mapKind() ? mapOf(state.b) : null;
    const wanted = map ? [] : single ? [single] : entries;
    const broken = map ? map.dataset.error : (wanted.find((w) => w.error) || {}).error;
    const ready = !broken && (map ? map.complete && map.naturalWidth > 0 : wanted.every((w) => w.picture));
    $("message").textContent = broken || (ready ? "" : "loading …");
    const shown = state.v === "flip" ? (flipped ? state.a : state.b) : "";
    const tag = (name) => `${titleOf(name)}  ${delta(name)}`.trim();
    const words = sides ? names.map(tag) : [state.v === "flip" ? tag(shown) : state.v === "swipe" ? tag(state.a) : state.v === "signed" ? `${titleOf(state.b)} − ${titleOf(state.a)}` : state.v === "noise" ? "ΔE00 of the reference with another seed" : `${{ de00: "ΔE00", flipmap: "FLIP" }[state.v]} of ${titleOf(state.b)}`, ...(state.v === "swipe" ? [tag(state.b)] : [])];
    const at_ = (i) => (state.v === "swipe" ? (i ? { right: ".5rem", top: ".5rem" } : { left: ".5rem", top: ".5rem" }) : { left: `calc(${both[i].x / ratio}px + .5rem)`, top: `calc(${both[i].y / ratio}px + .5rem)` });
    $("tags").replaceChildren(...words.map((text, i) => { const span = document.createElement("span"); span.className = "tag"; span.textContent = text; Object.assign(span.style, at_(i)); return span; }));
    canvas.setAttribute("aria-label", `${words.join("; ")}, material ${state.m}, scene ${state.s}`);
    canvas.dataset.shown = shown;
    canvas.dataset.ready = String(ready);
    if (!ready) return;
    if (map) paint(both[0], { width: map.naturalWidth, height: map.naturalHeight }, map);
    else if (single) paint(both[0], single.picture, developed(single.picture));
    else if (sides) entries.forEach((e, i) => paint(both[i], e.picture, developed(e.picture)));
    else if (state.v === "signed") paint(both[0], left.picture, errorMap(left.picture, right.picture));
    else {
      const cut = Math.round(state.w * canvas.width);
      paint(both[0], left.picture, developed(left.picture), [0, 0, cut, canvas.height]);
      paint(both[0], right.picture, developed(right.picture), [cut, 0, canvas.width - cut, canvas.height]);
      context.fillStyle = "#fff";
      context.fillRect(cut - ratio, 0, 2 * ratio, canvas.height);
    }
    if (sides) { context.strokeStyle = "#fff"; context.lineWidth = ratio; for (const p of both) context.strokeRect(p.x, p.y, p.w, p.h); }
    const base = wanted[0]?.picture || { width: map.naturalWidth, height: map.naturalHeight };
    $("zoom").textContent = `${Math.round(100 * place(both[0], base).scale / ratio)} %`;
    const at = pointer ? null : aim();
    if (at) {
      for (const [colour, wide] of [["#000", 3], ["#fff", 1]]) {
        context.strokeStyle = colour; context.lineWidth = wide * ratio;
        context.strokeRect(at.x - 5 * ratio, at.y - 5 * ratio, 10 * ratio, 10 * ratio);
      }
    }
    pixels();
  }
  // Where the pixel is read: under the pointer or, without one, in the middle of the picture that the keyboard is on.
  function aim() {
    if (pointer || !canvas.matches(":focus-visible")) return pointer;
    const panel = panels()[0];
    return { x: panel.x + panel.w / 2, y: panel.y + panel.h / 2 };
  }
  function pixelAt() {
    const picture = (store.get(idOf(state.a)) || {}).picture || (store.get(idOf(state.b)) || {}).picture, from = aim();
    if (!from || !picture) return null;
    const panel = panels().find((p) => from.x >= p.x && from.x < p.x + p.w && from.y >= p.y && from.y < p.y + p.h) || panels()[0], p = place(panel, picture);
    const x = Math.floor((from.x - p.left) / p.scale), y = Math.floor((from.y - p.top) / p.scale);
    return x >= 0 && y >= 0 && x < picture.width && y < picture.height ? { x, y } : null;
  }
  // The surroundings of the pixel that is read, magnified, in A and in B.
  const INSET = 15;
  function insets(at) {
    for (const [id, model] of [["inset-a", state.a], ["inset-b", state.b]]) {
      const target = $(id), ink = target.getContext("2d"), picture = (store.get(idOf(model)) || {}).picture, cell = target.width / INSET;
      $(`${id}-title`).textContent = titleOf(model);
      ink.clearRect(0, 0, target.width, target.height);
      target.dataset.at = at && picture ? `${at.x},${at.y}` : "";
      if (!at || !picture) continue;
      const half = (INSET - 1) / 2;
      ink.imageSmoothingEnabled = false;
      ink.drawImage(developed(picture), (half - at.x) * cell, (half - at.y) * cell, picture.width * cell, picture.height * cell);
      for (const [colour, wide] of [["#000", 3], ["#fff", 1]]) { ink.strokeStyle = colour; ink.lineWidth = wide; ink.strokeRect(half * cell, half * cell, cell, cell); }
    }
  }
  function pixels() {
    const at = pixelAt(), rows = [...$("pixel").tBodies[0].rows];
    const value = (model) => { const e = store.get(idOf(model)); return at && e && e.picture ? [0, 1, 2].map((c) => e.picture.rgb[3 * (at.y * e.picture.width + at.x) + c]) : [NaN, NaN, NaN]; };
    const a = value(state.a), b = value(state.b);
    insets(at);
    $("place").textContent = at ? `x ${at.x}  y ${at.y}` : "Point at the picture.";
    [[titleOf(state.a), a], [titleOf(state.b), b], ["difference", b.map((v, c) => v - a[c])]].forEach(([name, values], i) => {
      rows[i].cells[0].textContent = name;
      values.forEach((v, c) => { rows[i].cells[c + 1].textContent = Number.isNaN(v) ? "–" : v.toPrecision(4).replace("-", "−"); });
    });
  }

  // --- controls -------------------------------------------------------------------------------------------------------------
  const option = (value, text) => { const o = document.createElement("option"); o.value = value; o.textContent = text; return o; };
  A.materials.forEach((m) => $("material").append(option(m.name, m.standin ? `${m.title} (stand-in)` : m.title)));
  A.scenes.forEach((s) => $("scene").append(option(s.name, s.title)));
  MODELS.forEach((m) => { $("a").append(option(m.name, m.title)); $("b").append(option(m.name, m.title)); });
  // The list: the reference, then the models best first; its order is that of the keys.
  const make = (name, className, text = "") => Object.assign(document.createElement(name), { className, textContent: text });
  function drawList() {
    const order = ranked(), focused = document.activeElement?.dataset?.model;
    $("list").replaceChildren(...["reference", ...order.map((m) => m.name)].map((name, i) => {
      const li = document.createElement("li"), button = make("button", ""), image = make("img", ""), words = make("span", "words"), key = make("kbd", "", i === 0 ? "`" : i <= 9 ? String(i) : "");
      button.type = "button"; button.dataset.model = name;
      button.setAttribute("aria-pressed", String(name === state.b));
      const failed = name !== "reference" && number(name, "de00_mean") === null;
      if (!failed) image.src = `materials/${encodeURIComponent(state.m)}/renders/${encodeURIComponent(state.s)}/${encodeURIComponent(name)}/render.webp`;
      image.alt = ""; image.width = image.height = 40; image.loading = "lazy";
      image.hidden = failed;
      words.append(make("span", "name", titleOf(name)), make("span", "value", name === "reference" ? "" : failed ? lack(name) : `ΔE00 ${digits(number(name, "de00_mean"), 2)} · FLIP ${digits(number(name, "flip_mean"), 3)} · ${psnr(name)} dB`));
      button.append(image, words, key.textContent ? key : make("span", ""));
      button.addEventListener("click", () => change({ b: name }));
      li.append(button);
      return li;
    }));
    if (focused) $("list").querySelector(`button[data-model="${CSS.escape(focused)}"]`)?.focus();
  }
  $("error-bar").replaceChildren("−1 darker", Object.assign(document.createElement("span"), { className: "ramp", role: "img", ariaLabel: "Colour scale of the difference, from -1 to 1, root scale" }), "+1 brighter (1 = white at this exposure, root scale)");
  $("error-bar").querySelector(".ramp").style.background = `linear-gradient(90deg,${RDBU.map((c) => `rgb(${c})`)})`;
  function change(parts) {
    if ("b" in parts || "m" in parts || "s" in parts || "v" in parts) flipped = false;
    Object.assign(state, parts);
    sync();
    write();
    schedule();
  }
  function sync() {
    const material = A.materials.find((m) => m.name === state.m);
    $("heading").textContent = material.title;
    $("standin").hidden = !material.standin;
    $("material-page").href = `materials/${encodeURIComponent(state.m)}.html`;
    $("material").value = state.m; $("scene").value = state.s; $("a").value = state.a; $("b").value = state.b; $("view").value = state.v;
    $("exposure").value = state.e;
    $("stops").textContent = `${state.e > 0 ? "+" : ""}${+state.e.toFixed(2)} stops`.replace("-", "−");
    $("error-bar").hidden = state.v !== "signed";
    $("map-bar").hidden = !BARS[state.v];
    if (BARS[state.v]) $("map-bar").src = `assets/${BARS[state.v]}`;
    $("exposure").disabled = Boolean(MAPS[state.v]);
    $("divider-label").hidden = $("divided").hidden = state.v !== "swipe";
    $("divider").value = 100 * state.w;
    $("divided").textContent = `${Math.round(100 * state.w)} %`;
    document.title = `${material.title}${material.standin ? " (stand-in)" : ""}: ${titleOf(state.b)} · BRDF atlas`;
    drawList();
    $("status").textContent = `${material.title}, ${A.scenes.find((s) => s.name === state.s).title}: ${titleOf(state.a)} and ${titleOf(state.b)}${delta(state.b) ? `, ${delta(state.b)}` : ""}`;
  }
  const step = (list, name, by) => list[(list.findIndex((x) => x.name === name) + by + list.length) % list.length].name;
  for (const [id, key] of [["material", "m"], ["scene", "s"], ["a", "a"], ["b", "b"], ["view", "v"]]) $(id).addEventListener("change", (e) => change({ [key]: e.target.value }));
  $("exposure").addEventListener("input", (e) => change({ e: Number(e.target.value) }));
  const divide = (w) => change({ w: Math.min(Math.max(w, 0), 1) });
  $("divider").addEventListener("input", (e) => divide(Number(e.target.value) / 100));
  // After a choice in a drop-down the keys are the picture's again.
  for (const id of ["material", "scene", "a", "b", "view"]) $(id).addEventListener("change", () => canvas.focus({ preventScroll: true }));
  const actual = () => { const picture = anyPicture(); if (picture) { const p = panels()[0], fitted = Math.min(p.w / picture.width, p.h / picture.height); change({ z: Math.min(Math.max((window.devicePixelRatio || 1) / fitted, 1 / 32), 32) }); } };
  $("actual").addEventListener("click", actual);
  $("fit").addEventListener("click", () => change({ z: 1, x: 0.5, y: 0.5 }));
  $("copy").addEventListener("click", async () => {
    try { await navigator.clipboard.writeText(location.href); $("status").textContent = "The link is copied."; } catch { $("status").textContent = `The link: ${location.href}`; }
  });
  // Whose picture is in front, of the two that are chosen.
  const front = () => (state.v === "flip" && flipped ? state.a : state.b);
  $("save").addEventListener("click", () => {
    try {
      const link = document.createElement("a");
      link.href = canvas.toDataURL("image/png");
      link.download = `${state.m}-${state.s}-${front()}-${state.v}.png`;
      link.click();
    } catch { // of a page from a file, a canvas that shows a picture file cannot be read
      const file = Object.assign(document.createElement("a"), { href: mapOf(state.b).src, textContent: "the picture file" });
      $("status").replaceChildren("The browser does not let a page from a file save this map; it is ", file, ".");
    }
  });
  // Linear radiance as an OpenEXR file: one part, scan lines, float, not compressed.
  function exr({ width, height, rgb }) {
    const header = [0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0], little = (type, ...values) => values.flatMap((v) => { const b = new DataView(new ArrayBuffer(4)); b[`set${type}`](0, v, true); return [...new Uint8Array(b.buffer)]; });
    const name = (s) => [...s].map((c) => c.charCodeAt(0)).concat(0), attribute = (key, type, bytes) => header.push(...name(key), ...name(type), ...little("Int32", bytes.length), ...bytes);
    attribute("channels", "chlist", ["B", "G", "R"].flatMap((c) => [...name(c), ...little("Int32", 2, 0, 1, 1)]).concat(0));
    attribute("compression", "compression", [0]);
    for (const key of ["dataWindow", "displayWindow"]) attribute(key, "box2i", little("Int32", 0, 0, width - 1, height - 1));
    attribute("lineOrder", "lineOrder", [0]);
    attribute("pixelAspectRatio", "float", little("Float32", 1));
    attribute("screenWindowCenter", "v2f", little("Float32", 0, 0));
    attribute("screenWindowWidth", "float", little("Float32", 1));
    header.push(0);
    const start = header.length + 8 * height, line = 8 + 12 * width, view = new DataView(new ArrayBuffer(start + line * height));
    header.forEach((byte, i) => view.setUint8(i, byte));
    for (let y = 0; y < height; y++) {
      const at = start + line * y;
      view.setBigUint64(header.length + 8 * y, BigInt(at), true);
      view.setInt32(at, y, true);
      view.setInt32(at + 4, 12 * width, true);
      for (let c = 0; c < 3; c++) for (let x = 0; x < width; x++) view.setFloat32(at + 8 + 4 * (c * width + x), rgb[3 * (y * width + x) + 2 - c], true);
    }
    return new Blob([view], { type: "image/x-exr" });
  }
  $("exr").addEventListener("click", () => {
    const model = front(), picture = (store.get(idOf(model)) || {}).picture;
    if (!picture) { $("status").textContent = "The picture is not loaded."; return; }
    const link = document.createElement("a");
    link.href = URL.createObjectURL(exr(picture));
    link.download = `${state.m}-${state.s}-${model}.exr`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  });
  const reset = () => { flipped = false; change({ e: 0, z: 1, x: 0.5, y: 0.5, w: 0.5 }); };
  $("reset").addEventListener("click", reset);
  $("help-button").addEventListener("click", () => $("help").showModal());
  // Maps that the run drew have its exposure.
  const expose = (by) => { if (!MAPS[state.v]) change({ e: Math.min(Math.max(state.e + by, -8), 8) }); };
  const zoom = (factor) => change({ z: Math.min(Math.max(state.z * factor, 1 / 4), 32) });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
    // Space and digits belong to the picture wherever the focus is, except in a field for text; arrows to what has them.
    if (event.target.matches("input:not([type=range]), textarea")) return;
    if (event.target.matches("select, input") && !(event.key === " " || event.key === "`" || /^Digit\d$/.test(event.code))) return;
    if (event.target.matches("a, button") && event.key === "Enter") return;
    const pan = event.shiftKey ? { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] : null;
    if (pan) {
      event.preventDefault();
      const [x, y] = [state.x + 0.1 * pan[0] / state.z, state.y + 0.1 * pan[1] / state.z].map((v) => Math.min(Math.max(v, 0), 1));
      change({ x, y });
      return;
    }
    const digit = /^Digit(\d)$/.exec(event.code);
    const act = {
      "`": () => { if (state.v !== "flip") change({ v: "flip" }); flipped = true; schedule(); }, "1:1": actual, f: () => change({ z: 1, x: 0.5, y: 0.5 }), o: actual,
      " ": () => { flipped = !flipped; if (state.v !== "flip") change({ v: "flip" }); schedule(); },
      e: () => expose(0.5), E: () => expose(-0.5),
      ArrowRight: () => change({ m: step(A.materials, state.m, 1) }), ArrowLeft: () => change({ m: step(A.materials, state.m, -1) }),
      ArrowDown: () => change({ b: step([MODELS[0], ...ranked()], state.b, 1) }), ArrowUp: () => change({ b: step([MODELS[0], ...ranked()], state.b, -1) }),
      r: reset, v: () => change({ v: VIEWS[(VIEWS.indexOf(state.v) + 1) % VIEWS.length] }), s: () => change({ s: step(A.scenes, state.s, 1) }),
      "?": () => $("help").showModal(), ",": () => divide(state.w - 0.05), ".": () => divide(state.w + 0.05), "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5),
    }[event.key];
    if (act) { event.preventDefault(); act(); return; }
    if (digit) {
      const index = ((Number(digit[1]) + 9) % 10) + (event.shiftKey ? 10 : 0), order = ranked();
      if (index < order.length) { event.preventDefault(); change({ b: order[index].name }); }
    }
  });
  // Browsers press a button on the release of Space: it has flipped already.
  document.addEventListener("keyup", (event) => { if (event.key === " " && event.target.matches("button")) event.preventDefault(); });
  const local = (event) => { const box = canvas.getBoundingClientRect(), k = canvas.width / box.width; return { x: (event.clientX - box.left) * k, y: (event.clientY - box.top) * k }; };
  const anyPicture = () => (store.get(idOf(state.a)) || {}).picture || (store.get(idOf(state.b)) || {}).picture;
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const picture = anyPicture();
    if (!picture) return;
    const at = local(event), panel = panels().find((p) => at.x >= p.x && at.x < p.x + p.w && at.y >= p.y && at.y < p.y + p.h) || panels()[0], before = place(panel, picture);
    const z = Math.min(Math.max(state.z * 2 ** (-event.deltaY / 300), 1 / 4), 32);
    // The point under the pointer stays where it is.
    const px = (at.x - before.left) / before.scale, py = (at.y - before.top) / before.scale, scale = before.scale * z / state.z;
    change({ z, x: z <= 1 ? 0.5 : (px - (at.x - panel.x - panel.w / 2) / scale) / picture.width, y: z <= 1 ? 0.5 : (py - (at.y - panel.y - panel.h / 2) / scale) / picture.height });
  }, { passive: false });
  let drag = null;
  canvas.addEventListener("pointerdown", (event) => {
    drag = { ...local(event), swipe: state.v === "swipe" && Math.abs(local(event).x - state.w * canvas.width) < 24 * (window.devicePixelRatio || 1) };
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    pointer = local(event);
    const picture = anyPicture();
    if (drag && picture) {
      if (drag.swipe) divide(pointer.x / canvas.width);
      else {
        const { scale } = place(panels()[0], picture);
        change({ x: state.x - (pointer.x - drag.x) / (scale * picture.width), y: state.y - (pointer.y - drag.y) / (scale * picture.height) });
        drag.x = pointer.x; drag.y = pointer.y;
      }
    } else pixels();
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { drag = null; });
  canvas.addEventListener("pointerleave", () => { pointer = null; schedule(); });
  for (const name of ["focus", "blur"]) canvas.addEventListener(name, schedule);
  new ResizeObserver(schedule).observe($("stage"));
  window.addEventListener("hashchange", () => { if (location.hash !== ownHash) { read(); sync(); schedule(); } });
  // What will be wanted next is loaded while nothing else happens.
  const idle = window.requestIdleCallback || ((f) => setTimeout(f, 200));
  function ahead() {
    const next = MODELS.map((m) => idOf(m.name)).find((id) => !store.has(id));
    if (next) { load(next).waiting.then(() => idle(ahead)); } else setTimeout(() => idle(ahead), 400);
  }
  window.addEventListener("pageshow", () => { read(); sync(); schedule(); });
  read(); sync(); write(); schedule();
  load(idOf(state.a)).waiting.then(() => load(idOf(state.b)).waiting).then(() => idle(ahead));
})();
