// Compare: two pictures of one material and scene, in place. The words are those of JERI and tev.
"use strict";
(() => {
  const A = window.ATLAS;
  const $ = (id) => document.getElementById(id);
  if (!A) { $("message").textContent = "data/atlas.js is missing: build the index of this report."; return; }
  const canvas = $("canvas"), context = canvas.getContext("2d");
  const VIEWS = ["flip", "swipe", "side", "error"];
  const MODELS = [{ name: "reference", title: "reference" }, ...A.models];
  const K = A.models.length + 1, J = A.materials.length;
  const fresh = () => ({ m: A.materials[0].name, s: A.scenes[0].name, a: "reference", b: A.models[0].name, v: "flip", e: 0, z: 1, x: 0.5, y: 0.5, w: 0.5 });
  let state = fresh(), flipped = false, pointer = null;

  // --- state in the address -----------------------------------------------------------------------------------------
  function read() {
    const given = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
    const next = fresh();
    if (A.materials.some((m) => m.name === given.m)) next.m = given.m;
    if (A.scenes.some((s) => s.name === given.s)) next.s = given.s;
    for (const key of ["a", "b"]) if (MODELS.some((m) => m.name === given[key])) next[key] = given[key];
    if (VIEWS.includes(given.v)) next.v = given.v;
    for (const key of ["e", "z", "x", "y", "w"]) if (given[key] && Number.isFinite(Number(given[key]))) next[key] = Number(given[key]);
    next.e = Math.min(Math.max(next.e, -8), 8);
    next.z = Math.min(Math.max(next.z, 1), 32);
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

  // --- pictures ---------------------------------------------------------------------------------------------------------
  const store = new Map();
  window.ATLAS_HDR = (id, data) => {
    const entry = store.get(id);
    if (!entry) return;
    decode(data).then((picture) => { entry.picture = picture; entry.done(); }, () => { entry.error = "cannot be decoded"; entry.done(); });
  };
  // Upper half mantissas, lower half exponents (brdfatlas.pictures): radiance = m 2^(e - 136).
  async function decode(base64) {
    const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
    const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/webp" }), { colorSpaceConversion: "none", premultiplyAlpha: "none" });
    const off = new OffscreenCanvas(bitmap.width, bitmap.height), ctx = off.getContext("2d", { willReadFrequently: true });
    ctx.drawImage(bitmap, 0, 0);
    const raw = ctx.getImageData(0, 0, bitmap.width, bitmap.height).data;
    const width = bitmap.width, height = bitmap.height / 2, count = width * height;
    const rgb = new Float32Array(3 * count);
    for (let i = 0; i < count; i++) {
      const e = raw[4 * (i + count)], scale = e ? 2 ** (e - 136) : 0;
      for (let c = 0; c < 3; c++) rgb[3 * i + c] = raw[4 * i + c] * scale;
    }
    return { width, height, rgb, canvas: null, exposure: NaN };
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
    script.onerror = () => { entry.error = A.reasons[`${m}/${model}`] || "this run made no picture of it"; entry.done(); };
    script.onload = () => script.remove();
    document.head.append(script);
    entry.waiting.then(schedule);
    // A picture is some 800 kB of floats: the oldest leave when there are too many.
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
  const panels = () => {
    const w = canvas.width, h = canvas.height;
    return state.v === "side" ? [{ x: 0, w: w / 2, h }, { x: w / 2, w: w / 2, h }] : [{ x: 0, w, h }];
  };
  // Where the picture lies in a panel: fitted at zoom 1, then magnified around the point (x, y) of the picture.
  function place(panel, picture) {
    const scale = Math.min(panel.w / picture.width, panel.h / picture.height) * state.z;
    return { scale, left: panel.x + panel.w / 2 - state.x * picture.width * scale, top: panel.h / 2 - state.y * picture.height * scale };
  }
  function paint(panel, picture, source, clip) {
    const p = place(panel, picture);
    context.save();
    context.beginPath();
    context.rect(...(clip || [panel.x, 0, panel.w, panel.h]));
    context.clip();
    context.imageSmoothingEnabled = p.scale < 1;
    context.imageSmoothingQuality = "high";
    context.drawImage(source, p.left, p.top, picture.width * p.scale, picture.height * p.scale);
    context.restore();
  }
  const titleOf = (name) => (MODELS.find((m) => m.name === name) || { title: name }).title;
  function psnr(model) {
    const j = A.materials.findIndex((m) => m.name === state.m), s = A.scenes.findIndex((x) => x.name === state.s), k = A.models.findIndex((m) => m.name === model);
    if (k < 0) return "";
    const place = (s * J + j) * K + k, v = A.values.psnr_db[place];
    if (v === null) return "failed";
    return v === Infinity ? "∞ dB" : `${A.values.psnr_se_db[place] === Infinity ? "≥ " : ""}${v.toFixed(1)} dB`;
  }
  function draw() {
    scheduled = false;
    const ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
    canvas.width = Math.max(1, Math.round(box.width * ratio));
    canvas.height = Math.max(1, Math.round(box.height * ratio));
    const left = load(idOf(state.a)), right = load(idOf(state.b));
    const both = panels(), single = state.v === "flip" ? (flipped ? left : right) : null;
    const wanted = single ? [single] : [left, right];
    const broken = wanted.find((w) => w.error);
    $("message").textContent = broken ? broken.error : wanted.every((w) => w.picture) ? "" : "loading …";
    const shown = state.v === "flip" ? (flipped ? state.a : state.b) : "";
    $("tag-left").textContent = state.v === "flip" ? `${titleOf(shown)}  ${psnr(shown)}` : state.v === "error" ? `${titleOf(state.b)} − ${titleOf(state.a)}` : `${titleOf(state.a)}  ${psnr(state.a)}`;
    $("tag-right").textContent = state.v === "swipe" || state.v === "side" ? `${titleOf(state.b)}  ${psnr(state.b)}` : "";
    $("tag-right").hidden = !$("tag-right").textContent;
    canvas.setAttribute("aria-label", `${$("tag-left").textContent} ${$("tag-right").textContent}, material ${state.m}, scene ${state.s}`);
    canvas.dataset.shown = shown;
    const ready = !broken && wanted.every((w) => w.picture);
    canvas.dataset.ready = String(ready);
    if (!ready) return;
    if (single) paint(both[0], single.picture, developed(single.picture));
    else if (state.v === "side") { paint(both[0], left.picture, developed(left.picture)); paint(both[1], right.picture, developed(right.picture)); }
    else if (state.v === "error") paint(both[0], left.picture, errorMap(left.picture, right.picture));
    else {
      const cut = Math.round(state.w * canvas.width);
      paint(both[0], left.picture, developed(left.picture), [0, 0, cut, canvas.height]);
      paint(both[0], right.picture, developed(right.picture), [cut, 0, canvas.width - cut, canvas.height]);
      context.fillStyle = "#fff";
      context.fillRect(cut - ratio, 0, 2 * ratio, canvas.height);
    }
    if (state.v === "side") { context.fillStyle = "#fff"; context.fillRect(canvas.width / 2 - ratio / 2, 0, ratio, canvas.height); }
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
    return { x: panel.x + panel.w / 2, y: panel.h / 2 };
  }
  function pixelAt() {
    const picture = (store.get(idOf(state.a)) || {}).picture || (store.get(idOf(state.b)) || {}).picture, from = aim();
    if (!from || !picture) return null;
    const panel = panels().find((p) => from.x >= p.x && from.x < p.x + p.w) || panels()[0], p = place(panel, picture);
    const x = Math.floor((from.x - p.left) / p.scale), y = Math.floor((from.y - p.top) / p.scale);
    return x >= 0 && y >= 0 && x < picture.width && y < picture.height ? { x, y } : null;
  }
  function pixels() {
    const at = pixelAt();
    if (!at) { $("pixel").textContent = "Point at the picture."; return; }
    const line = (name, v) => `${name.slice(0, 14).padEnd(15)}${v.map((c) => c.toPrecision(4).padStart(10)).join("")}`;
    const value = (model) => { const e = store.get(idOf(model)); return e && e.picture ? [0, 1, 2].map((c) => e.picture.rgb[3 * (at.y * e.picture.width + at.x) + c]) : [NaN, NaN, NaN]; };
    const a = value(state.a), b = value(state.b);
    $("pixel").textContent = [`x ${at.x}  y ${at.y}`.padEnd(15) + ["R", "G", "B"].map((c) => c.padStart(10)).join(""), line(titleOf(state.a), a), line(titleOf(state.b), b), line("difference", b.map((v, c) => v - a[c]))].join("\n");
  }

  // --- controls -------------------------------------------------------------------------------------------------------------
  const option = (value, text) => { const o = document.createElement("option"); o.value = value; o.textContent = text; return o; };
  A.materials.forEach((m) => $("material").append(option(m.name, m.standin ? `${m.title} (stand-in)` : m.title)));
  A.scenes.forEach((s) => $("scene").append(option(s.name, s.title)));
  MODELS.forEach((m) => { $("a").append(option(m.name, m.title)); $("b").append(option(m.name, m.title)); });
  MODELS.slice(1).forEach((m, i) => {
    const li = document.createElement("li"), button = document.createElement("button"), key = document.createElement("kbd"), name = document.createElement("span"), number = document.createElement("span");
    button.type = "button"; button.dataset.model = m.name; number.className = "value"; name.textContent = m.title + (m.status ? ` (${m.status})` : "");
    if (i < 20) key.textContent = `${i >= 10 ? "⇧" : ""}${(i + 1) % 10}`;
    button.append(i < 20 ? key : document.createElement("span"), name, number);
    button.addEventListener("click", () => change({ b: m.name }));
    li.append(button); $("list").append(li);
  });
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
    $("error-bar").hidden = state.v !== "error";
    $("divider-label").hidden = $("divided").hidden = state.v !== "swipe";
    $("divider").value = 100 * state.w;
    $("divided").textContent = `${Math.round(100 * state.w)} %`;
    document.title = `${material.title}${material.standin ? " (stand-in)" : ""}: ${titleOf(state.b)} · BRDF atlas`;
    document.querySelectorAll("#list button").forEach((button) => {
      button.setAttribute("aria-pressed", String(button.dataset.model === state.b));
      button.querySelector(".value").textContent = psnr(button.dataset.model);
    });
    $("status").textContent = `${material.title}, ${A.scenes.find((s) => s.name === state.s).title}: ${titleOf(state.a)} and ${titleOf(state.b)}${psnr(state.b) ? `, ${psnr(state.b)}` : ""}`;
  }
  const step = (list, name, by) => list[(list.findIndex((x) => x.name === name) + by + list.length) % list.length].name;
  for (const [id, key] of [["material", "m"], ["scene", "s"], ["a", "a"], ["b", "b"], ["view", "v"]]) $(id).addEventListener("change", (e) => change({ [key]: e.target.value }));
  $("exposure").addEventListener("input", (e) => change({ e: Number(e.target.value) }));
  const divide = (w) => change({ w: Math.min(Math.max(w, 0), 1) });
  $("divider").addEventListener("input", (e) => divide(Number(e.target.value) / 100));
  const reset = () => { flipped = false; change({ e: 0, z: 1, x: 0.5, y: 0.5, w: 0.5 }); };
  $("reset").addEventListener("click", reset);
  $("help-button").addEventListener("click", () => $("help").showModal());
  const zoom = (factor) => change({ z: Math.min(Math.max(state.z * factor, 1), 32) });
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
    if (event.target.matches("select, input")) return;
    if (event.target.matches("button") && (event.key === " " || event.key === "Enter")) return;
    const pan = event.shiftKey ? { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] : null;
    if (pan) {
      event.preventDefault();
      const [x, y] = [state.x + 0.1 * pan[0] / state.z, state.y + 0.1 * pan[1] / state.z].map((v) => Math.min(Math.max(v, 0), 1));
      change({ x, y });
      return;
    }
    const digit = /^Digit(\d)$/.exec(event.code);
    const act = {
      " ": () => { flipped = !flipped; if (state.v !== "flip") change({ v: "flip" }); schedule(); },
      e: () => change({ e: Math.min(state.e + 0.5, 8) }), E: () => change({ e: Math.max(state.e - 0.5, -8) }),
      ArrowRight: () => change({ m: step(A.materials, state.m, 1) }), ArrowLeft: () => change({ m: step(A.materials, state.m, -1) }),
      ArrowDown: () => change({ b: step(MODELS, state.b, 1) }), ArrowUp: () => change({ b: step(MODELS, state.b, -1) }),
      r: reset, v: () => change({ v: VIEWS[(VIEWS.indexOf(state.v) + 1) % VIEWS.length] }), s: () => change({ s: step(A.scenes, state.s, 1) }),
      "?": () => $("help").showModal(), ",": () => divide(state.w - 0.05), ".": () => divide(state.w + 0.05), "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5),
    }[event.key];
    if (act) { event.preventDefault(); act(); return; }
    if (digit) {
      const index = ((Number(digit[1]) + 9) % 10) + (event.shiftKey ? 10 : 0);
      if (index < A.models.length) { event.preventDefault(); change({ b: A.models[index].name }); }
    }
  });
  const local = (event) => { const box = canvas.getBoundingClientRect(), k = canvas.width / box.width; return { x: (event.clientX - box.left) * k, y: (event.clientY - box.top) * k }; };
  const anyPicture = () => (store.get(idOf(state.a)) || {}).picture || (store.get(idOf(state.b)) || {}).picture;
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const picture = anyPicture();
    if (!picture) return;
    const at = local(event), panel = panels().find((p) => at.x >= p.x && at.x < p.x + p.w) || panels()[0], before = place(panel, picture);
    const z = Math.min(Math.max(state.z * 2 ** (-event.deltaY / 300), 1), 32);
    // The point under the pointer stays where it is.
    const px = (at.x - before.left) / before.scale, py = (at.y - before.top) / before.scale, scale = before.scale * z / state.z;
    change({ z, x: z === 1 ? 0.5 : (px - (at.x - panel.x - panel.w / 2) / scale) / picture.width, y: z === 1 ? 0.5 : (py - (at.y - panel.h / 2) / scale) / picture.height });
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
  read(); sync(); write(); schedule();
  load(idOf(state.a)).waiting.then(() => load(idOf(state.b)).waiting).then(() => idle(ahead));
})();
