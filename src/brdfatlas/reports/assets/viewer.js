// The viewer: the reference and the fits on a sphere or the statue under an environment, by Monte Carlo in a fragment
// shader (WebGL 2). A sum of products comes from its factors, everything else from a table that is loaded when chosen.
// The sphere is met in closed form, the statue by steps along its field of distances, which also finds its shadows.
// Each sample draws its light direction from one of three densities (environment, microfacet normals by D, cosine) and
// divides by their mixture, the balance heuristic with one sample.
"use strict";
(() => {
  const D = window.ATLAS_VIEWER_DATA, $ = (id) => document.getElementById(id);
  const say = (text) => { $("message").textContent = text; };
  if (!D) { say("data/viewer.js is missing."); return; }
  const canvas = $("canvas"), gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
  if (!gl || !gl.getExtension("EXT_color_buffer_float")) { say("This browser has no WebGL 2 with float textures."); return; }

  const RENDER = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D; precision highp sampler3D;
uniform sampler2D factors, lights, alias, history, masses;
uniform sampler3D table_a, table_b; uniform ivec2 kinds; uniform vec2 spans; // kinds: 0 factors, 1 table, 2 nothing
uniform sampler3D field; uniform vec3 corner; uniform float cell_size; uniform bool statue;
uniform ivec2 fit, products; uniform ivec2 grid; uniform int first, count; uniform float split; uniform vec2 size;
uniform mat3 view; uniform float turn;
out vec4 sum;
const float PI = 3.14159265358979;
uint state;
float random() {
  state = state * 747796405u + 2891336453u;
  uint w = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
  return float(((w >> 22u) ^ w) >> 8u) * (1.0 / 16777216.0);
}
uint mixed(uint x) { x ^= x >> 16u; x *= 0x7feb352du; x ^= x >> 15u; x *= 0x846ca68bu; return x ^ (x >> 16u); }
vec3 row(int x, int y) { return texelFetch(factors, ivec2(x, y), 0).rgb; }
vec3 line(int start, float x, int n, int y) {
  x = clamp(x, 0.0, float(n - 1));
  int low = min(int(x), n - 2);
  return mix(row(start + low, y), row(start + low + 1, y), x - float(low));
}
float angle(vec3 a, vec3 b) { return 2.0 * atan(length(a - b), length(a + b)); }
// G / cos, both linear between the nodes.
vec3 shadowing(float c, int y) {
  float x = acos(clamp(c, 0.0, 1.0)) / (0.5 * PI) * 89.0;
  int low = min(int(x), 88);
  float s = x - float(low), step_ = 0.5 * PI / 89.0;
  float below = mix(cos(float(low) * step_), low == 88 ? 0.0 : cos(float(low + 1) * step_), s);
  return mix(row(180 + low, y), row(181 + low, y), s) / max(below, 1e-9);
}
vec3 brdf(vec3 wi, vec3 wo, bool left) {
  int kind = left ? kinds.x : kinds.y;
  if (kind == 2) return vec3(0.0);
  vec3 h = normalize(wi + wo);
  float r = length(h.xy), theta_h = atan(r, h.z), theta_d = 0.5 * angle(wi, wo);
  vec2 p = r > 1e-6 ? h.xy / r : vec2(1.0, 0.0);
  float phi_d = atan(wi.y * p.x - wi.x * p.y, h.z * dot(wi.xy, p) - r * wi.z);
  if (kind == 1) {
    // Mirror images are equal, and so are both orders of the directions where the table covers a quarter of the circle.
    float phi = abs(phi_d), span = left ? spans.x : spans.y;
    if (span < 2.0) phi = min(phi, PI - phi);
    vec3 place = vec3(sqrt(theta_h / (0.5 * PI)), theta_d / (0.5 * PI), phi / span);
    return left ? textureLod(table_a, place, 0.0).rgb : textureLod(table_b, place, 0.0).rgb;
  }
  int y = left ? fit.x : fit.y, count_ = left ? products.x : products.y;
  vec3 m = vec3(0.0);
  for (int k = y; k < y + count_; k++) m += line(0, sqrt(theta_h / (0.5 * PI)) * 90.0 - 0.5, 90, k) * line(90, theta_d / (0.5 * PI) * 90.0 - 0.5, 90, k);
  vec3 g0 = row(180, y);
  if (g0.r + g0.g + g0.b > 0.0) m *= shadowing(wi.z, y) * shadowing(wo.z, y);
  else {
    float x = mod(mod(phi_d, PI) / PI * 180.0 - 0.5, 180.0);
    int low = min(int(x), 179);
    m *= mix(row(272 + low, y), row(272 + (low + 1) % 180, y), x - float(low));
  }
  return max(row(270, y) + row(271, y) * m, 0.0);
}
float edge(int k) { float x = float(k) / 90.0; return x * x * 0.5 * PI; }
float square(float x) { return x * x; }
float mass(int k, int side) { return texelFetch(masses, ivec2(k, side), 0).r - (k > 0 ? texelFetch(masses, ivec2(k - 1, side), 0).r : 0.0); }
// Density of microfacet normals per solid angle, constant in sin^2 within a cell.
float normal_pdf(vec3 h, int side) {
  float theta = atan(length(h.xy), h.z);
  int k = clamp(int(sqrt(theta / (0.5 * PI)) * 90.0), 0, 89);
  return mass(k, side) * h.z / (PI * (square(sin(edge(k + 1))) - square(sin(edge(k)))));
}
vec3 draw_normal(int side) {
  float u = random(), v = random();
  int low = 0, high = 89;
  for (int i = 0; i < 7; i++) { int mid = (low + high) / 2; if (texelFetch(masses, ivec2(mid, side), 0).r < u) low = min(mid + 1, high); else high = mid; }
  float a = square(sin(edge(low))), b = square(sin(edge(low + 1))), s2 = mix(a, b, random());
  return vec3(sqrt(s2) * vec2(cos(2.0 * PI * v), sin(2.0 * PI * v)), sqrt(max(0.0, 1.0 - s2)));
}
// World directions: y up, as in the scenes. Columns turn with the light.
ivec2 cell(vec3 d) {
  float theta = acos(clamp(d.y, -1.0, 1.0)), phi = atan(d.x, -d.z) + turn;
  float x = fract(phi / (2.0 * PI)) * float(grid.x);
  return ivec2(min(int(x), grid.x - 1), min(int(theta / PI * float(grid.y)), grid.y - 1));
}
vec3 draw_light() {
  int n = grid.x * grid.y, i = min(int(random() * float(n)), n - 1);
  vec4 a = texelFetch(alias, ivec2(i % grid.x, i / grid.x), 0);
  if (random() >= a.x) i = int(a.y + 0.5);
  int column = i % grid.x, line_ = i / grid.x;
  float top = cos(float(line_) * PI / float(grid.y)), bottom = cos(float(line_ + 1) * PI / float(grid.y));
  float c = mix(top, bottom, random()), s = sqrt(max(0.0, 1.0 - c * c));
  float phi = (float(column) + random()) / float(grid.x) * 2.0 * PI - turn;
  return vec3(sin(phi) * s, c, -cos(phi) * s);
}
// The statue: distance at a point, the first point of a ray on it (-1 without one), its normal.
float apart(vec3 p) { return texture(field, ((p - corner) / cell_size + 0.5) / vec3(textureSize(field, 0))).r; }
float meet(vec3 o, vec3 d, float start) {
  vec3 last = corner + cell_size * (vec3(textureSize(field, 0)) - 1.0), a = (corner - o) / d, b = (last - o) / d;
  vec3 low = min(a, b), high = max(a, b);
  float t = max(start, max(low.x, max(low.y, low.z))), end = min(high.x, min(high.y, high.z));
  for (int i = 0; i < 200 && t < end; i++) {
    float r = apart(o + t * d);
    if (r < 2e-4) return t;
    t += max(0.6 * r, 1e-3); // the field grows up to 1.5 times as fast as the distance
  }
  return -1.0;
}
vec3 upright(vec3 p) {
  vec2 e = vec2(0.5 * cell_size, 0.0);
  return normalize(vec3(apart(p + e.xyy) - apart(p - e.xyy), apart(p + e.yxy) - apart(p - e.yxy), apart(p + e.yyx) - apart(p - e.yyx)));
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 before = first > 0 ? texelFetch(history, at, 0) : vec4(0.0);
  vec3 total = vec3(0.0);
  bool left = gl_FragCoord.x < split * size.x;
  int side = left ? 0 : 1;
  state = mixed(uint(at.x) + mixed(uint(at.y) + mixed(uint(first) + 1u)));
  for (int i = 0; i < count; i++) {
    vec2 p = ((vec2(at) + vec2(random(), random())) / size * 2.0 - 1.0) * tan(radians(21.0) / 2.0);
    vec3 o = view * vec3(0.0, 0.0, 6.0), d = normalize(view * vec3(p, -1.0));
    float b = dot(o, d), q = b * b - dot(o, o) + 1.0, far = statue ? meet(o, d, 0.0) : q < 0.0 ? -1.0 : -b - sqrt(q);
    if (far < 0.0) { total += texelFetch(lights, cell(d), 0).rgb; continue; }
    vec3 place = o + far * d, n = statue ? upright(place) : normalize(place);
    vec3 t = normalize(abs(n.y) < 0.99 ? cross(vec3(0, 1, 0), n) : cross(vec3(1, 0, 0), n)), s = cross(n, t);
    mat3 frame = mat3(t, s, n);
    vec3 wo = -d * frame;
    if (wo.z <= 1e-4) continue;
    float pick = random();
    vec3 wi;
    if (pick < 0.5) wi = draw_light() * frame;
    else if (pick < 0.85) { vec3 h = draw_normal(side); wi = 2.0 * dot(wo, h) * h - wo; }
    else { float r = sqrt(random()), a = 2.0 * PI * random(); wi = vec3(r * cos(a), r * sin(a), sqrt(max(0.0, 1.0 - r * r))); }
    if (wi.z <= 0.0) continue;
    vec3 world = frame * wi, h = normalize(wi + wo);
    if (statue && meet(place + 6e-3 * n, world, 0.0) >= 0.0) continue;
    ivec2 c = cell(world);
    float pdf = 0.5 * texelFetch(alias, c, 0).z + 0.35 * normal_pdf(h, side) / max(4.0 * dot(wo, h), 1e-6) + 0.15 * wi.z / PI;
    if (pdf > 0.0) total += brdf(wi, wo, left) * texelFetch(lights, c, 0).rgb * (wi.z / pdf);
  }
  sum = before + vec4(total, float(count));
}`;
  const SHOW = `#version 300 es
precision highp float; precision highp sampler2D;
uniform sampler2D history; uniform float exposure, gamma, split; uniform vec2 size; out vec4 colour;
void main() {
  vec4 h = texelFetch(history, ivec2(gl_FragCoord.xy), 0);
  vec3 c = pow(1.0 - exp2(-exposure * h.rgb / max(h.a, 1.0)), vec3(1.0 / gamma));
  float x = gl_FragCoord.x - split * size.x;
  colour = vec4(abs(x) < 0.75 && split > 0.0 && split < 1.0 ? vec3(1.0) : c, 1.0);
}`;
  function program(fragment) {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, "#version 300 es\nvoid main() { gl_Position = vec4(vec2((gl_VertexID << 1) & 2, gl_VertexID & 2) * 2.0 - 1.0, 0.0, 1.0); }"], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
    const cache = {};
    return { use: () => gl.useProgram(made), at: (name) => (name in cache ? cache[name] : (cache[name] = gl.getUniformLocation(made, name))) };
  }
  function texture(width, height, data) {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, data);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
    return made;
  }
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  function half(h) { // IEEE half to number
    const e = (h >> 10) & 31, m = h & 1023, s = h & 32768 ? -1 : 1;
    return s * (e === 0 ? m * 2 ** -24 : e === 31 ? Infinity : (1 + m / 1024) * 2 ** (e - 15));
  }
  const environments = D.environments.map((e) => {
    const h = e.height, w = 2 * h, raw = new Uint16Array(bytes(e.data)), rgba = new Float32Array(4 * w * h), power = new Float64Array(w * h);
    for (let i = 0; i < w * h; i++) {
      for (let c = 0; c < 3; c++) rgba[4 * i + c] = half(raw[3 * i + c]);
      const j = Math.floor(i / w), solid = (Math.cos(j * Math.PI / h) - Math.cos((j + 1) * Math.PI / h)) * 2 * Math.PI / w;
      rgba[4 * i + 3] = solid;
      power[i] = (0.2126 * rgba[4 * i] + 0.7152 * rgba[4 * i + 1] + 0.0722 * rgba[4 * i + 2] + 1e-6) * solid;
    }
    // Vose's alias table: x threshold, y other cell, z density per solid angle.
    const n = w * h, total = power.reduce((a, b) => a + b, 0), table = new Float32Array(4 * n), scaled = power.map((p) => p * n / total);
    const small = [], large = [];
    scaled.forEach((p, i) => { (p < 1 ? small : large).push(i); table[4 * i] = 1; table[4 * i + 1] = i; table[4 * i + 2] = power[i] / total / rgba[4 * i + 3]; });
    while (small.length && large.length) {
      const s = small.pop(), l = large.pop();
      table[4 * s] = scaled[s]; table[4 * s + 1] = l;
      scaled[l] += scaled[s] - 1;
      (scaled[l] < 1 ? small : large).push(l);
    }
    return { name: e.name, width: w, height: h, lights: texture(w, h, rgba), alias: texture(w, h, table) };
  });
  const texels = new Float32Array(bytes(D.texture)), factors = texture(D.width, D.height, texels);
  const field = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_3D, field);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 2);
  gl.texImage3D(gl.TEXTURE_3D, 0, gl.R16F, ...D.statue.counts, 0, gl.RED, gl.HALF_FLOAT, new Uint16Array(bytes(D.statue.data)));
  for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_3D, key, gl.LINEAR);
  for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(gl.TEXTURE_3D, key, gl.CLAMP_TO_EDGE);
  const render = program(RENDER), show = program(SHOW);
  gl.bindVertexArray(gl.createVertexArray());

  // --- tables ------------------------------------------------------------------------------------------------------------
  // brdfatlas.figures.tables: zlib of differences of logarithms, theta_h fastest; loaded once and kept.
  const STEPS = 64, FLOOR = 1e-5, tables = new Map();
  async function decode(cells, packed) {
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const steps = new Int16Array(await new Response(stream).arrayBuffer()), n = steps.length / 3, width = cells[0];
    for (let i = 0; i < steps.length; i++) if (i % width) steps[i] += steps[i - 1];
    const rgba = new Float32Array(4 * n);
    const value = (q) => (q <= 0 ? 0 : Math.min(FLOOR * 2 ** (q / STEPS), 65504));
    for (let i = 0; i < n; i++) {
      rgba[4 * i] = value(steps[i]);
      for (const c of [1, 2]) rgba[4 * i + c] = value(steps[i] + steps[i + c * n]);
    }
    return { cells, rgba, span: cells[2] > 20 ? Math.PI : Math.PI / 2, masses: massesOf(cells, rgba) };
  }
  // Cumulated mass of D cos(theta_h) over the cells of theta_h, D the mean luminance at theta_d below 60 degrees, and a
  // little everywhere so that no direction is out of reach.
  function massesOf([width, height, depth], rgba) {
    const edge = (k) => Math.sin((k / width) ** 2 * Math.PI / 2) ** 2, sums = new Float64Array(width);
    for (let k = 0; k < depth; k++) for (let j = 0; j < height * 2 / 3; j++) for (let i = 0; i < width; i++) {
      const o = 4 * (i + width * (j + height * k));
      sums[i] += (0.2126 * rgba[o] + 0.7152 * rgba[o + 1] + 0.0722 * rgba[o + 2]) * (edge(i + 1) - edge(i));
    }
    const total = sums.reduce((a, b) => a + b, 0), out = new Float32Array(width);
    let sum = 0;
    for (let i = 0; i < width; i++) { sum += (total > 0 ? 0.98 * sums[i] / total : 0) + (total > 0 ? 0.02 : 1) * (edge(i + 1) - edge(i)); out[i] = sum; }
    return out.map((v) => v / sum);
  }
  window.ATLAS_TABLE = (id, cells, count, text) => tables.get(id)?.arrived(decode(cells, window.atlasUnpack(count, text)));
  function loadTable(id) {
    if (!tables.has(id)) {
      const entry = {};
      entry.data = new Promise((resolve, reject) => {
        entry.arrived = resolve;
        const [material, model] = id.split("/"), script = document.createElement("script");
        script.src = `materials/${encodeURIComponent(material)}/tables/${encodeURIComponent(model)}.js`;
        script.onerror = () => reject(new Error("this run made no table of it"));
        document.head.append(script);
      });
      tables.set(id, entry);
    }
    return tables.get(id).data;
  }
  function volume() {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_3D, made);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.RGBA16F, 1, 1, 1, 0, gl.RGBA, gl.FLOAT, new Float32Array(4));
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_3D, key, gl.LINEAR);
    for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) gl.texParameteri(gl.TEXTURE_3D, key, gl.CLAMP_TO_EDGE);
    return made;
  }
  const masses = texture(90, 2, null), NOTHING = 2;
  const sides = ["a", "b"].map(() => ({ kind: NOTHING, first: 0, products: 0, span: 1, volume: volume(), wanted: "", fault: "" }));

  // --- state, in the address ---------------------------------------------------------------------------------------------
  const TONES = JSON.parse($("tones").textContent), P = window.AtlasPage;
  // Material and model of the left and of the right, environment, shape, divider, exposure, view, light.
  // The model that the run recommends for a material without a limit on size; without one, the first.
  function recommended(material) {
    const A = window.ATLAS, j = A.materials.findIndex((item) => item.name === material), k = A.recommended[0][j]?.[A.budgets.findIndex((item) => item.key === "any")];
    return k >= 0 ? A.models[k].name : (D.models[1] || D.models[0]).name;
  }
  const fresh = (material = D.materials[0].name) => ({ m: material, a: "reference", n: "", b: recommended(material), s: environments[0].name, f: "sphere", w: 0.5, e: 0, x: 0, y: 0, t: 0 });
  let state = fresh();
  const LIMITS = { w: [0, 1], e: [-6, 6], y: [-1.5, 1.5], x: [-100, 100], t: [-100, 100] };
  function read() {
    const named = D.materials.find((item) => item.name === P.get("m")), next = fresh(named?.name), among = { m: D.materials, n: D.materials, a: D.models, b: D.models, s: environments, f: [{ name: "sphere" }, { name: "statue" }] };
    for (const [key, list] of Object.entries(among)) if (list.some((item) => item.name === P.get(key))) next[key] = P.get(key);
    for (const [key, [low, high]] of Object.entries(LIMITS)) { const v = Number(P.get(key, "x")); if (Number.isFinite(v)) next[key] = Math.min(Math.max(v, low), high); }
    state = next;
    sync();
  }
  let writing = 0;
  function write() {
    clearTimeout(writing); // browsers refuse an address that changes a hundred times a second
    writing = setTimeout(keep, 150);
  }
  function keep() {
    const first = fresh();
    P.set(Object.fromEntries(Object.entries(state).map(([key, value]) => {
      const text = typeof value === "number" ? String(+value.toFixed(4)) : value;
      return [key, text === String(first[key]) && !["m", "a", "b"].includes(key) ? "" : text];
    })));
  }
  const of = (side) => [side && state.n ? state.n : state.m, side ? state.b : state.a];
  // What a side shows: factors and failures are known, a table may have to come first.
  async function choose(side) {
    const place = sides[side], [material, model] = of(side), id = `${material}/${model}`, found = D.fits[id];
    if (place.wanted === id) return;
    Object.assign(place, { wanted: id, kind: NOTHING, fault: "" });
    if (typeof found === "string") place.fault = found;
    else if (found) {
      Object.assign(place, { kind: 0, first: found[0], products: found[1] });
      upload(side, Float32Array.from({ length: 90 }, (_, k) => texels[4 * (found[0] * D.width + k) + 3]));
    } else {
      const data = await loadTable(id).catch((error) => { if (place.wanted === id) place.fault = error.message; });
      if (!data || place.wanted !== id) { told(); return; }
      gl.bindTexture(gl.TEXTURE_3D, place.volume);
      gl.texImage3D(gl.TEXTURE_3D, 0, gl.RGBA16F, ...data.cells, 0, gl.RGBA, gl.FLOAT, data.rgba);
      Object.assign(place, { kind: 1, span: data.span });
      upload(side, data.masses);
    }
    told();
    restart();
  }
  function upload(side, values) {
    const rgba = new Float32Array(4 * 90);
    values.forEach((v, k) => { rgba[4 * k] = v; });
    gl.bindTexture(gl.TEXTURE_2D, masses);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, side, 90, 1, gl.RGBA, gl.FLOAT, rgba);
  }
  const titleOf = (list, name) => list.find((item) => item.name === name).title;
  const shownAs = (side) => { const [material, model] = of(side); return `${titleOf(D.materials, material)}, ${titleOf(D.models, model)}`; };
  // A browser may take the graphics context away, and give one back: all is loaded anew then, from the address.
  canvas.addEventListener("webglcontextlost", (e) => { e.preventDefault(); paused = true; told(); });
  canvas.addEventListener("webglcontextrestored", () => location.reload());
  function told() {
    if (gl.isContextLost()) { say("The browser has taken the graphics context away; reload the page."); return; }
    say(sides.map((place, side) => (place.fault ? `${shownAs(side)} cannot be shown: ${place.fault}.` : "")).filter(Boolean).join(" "));
  }
  let targets = [], samples = 0, budget = 4096, paused = false;
  function resize(width, height) {
    canvas.width = width; canvas.height = height;
    for (const t of targets) { gl.deleteTexture(t.texture); gl.deleteFramebuffer(t.buffer); }
    targets = [0, 1].map(() => {
      const made = texture(width, height, null), buffer = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made, 0);
      return { texture: made, buffer };
    });
    restart();
  }
  function restart() { samples = 0; }
  function bind(unit, made, where) { gl.activeTexture(gl.TEXTURE0 + unit); gl.bindTexture(gl.TEXTURE_2D, made); gl.uniform1i(where, unit); }
  function matrix() {
    const [ca, sa, ce, se] = [Math.cos(state.x), Math.sin(state.x), Math.cos(state.y), Math.sin(state.y)];
    return [ca, 0, -sa, sa * se, ce, ca * se, sa * ce, -se, ca * ce]; // columns: right, up, backwards
  }
  function accumulate(count) {
    const e = environments.find((item) => item.name === state.s), [from, to] = targets;
    render.use();
    gl.bindFramebuffer(gl.FRAMEBUFFER, to.buffer);
    gl.viewport(0, 0, canvas.width, canvas.height);
    bind(0, factors, render.at("factors")); bind(1, e.lights, render.at("lights")); bind(2, e.alias, render.at("alias")); bind(3, from.texture, render.at("history"));
    bind(7, masses, render.at("masses"));
    [[field, "field"], [sides[0].volume, "table_a"], [sides[1].volume, "table_b"]].forEach(([made, name], i) => {
      gl.activeTexture(gl.TEXTURE4 + i);
      gl.bindTexture(gl.TEXTURE_3D, made);
      gl.uniform1i(render.at(name), 4 + i);
    });
    gl.uniform2i(render.at("kinds"), sides[0].kind, sides[1].kind);
    gl.uniform2f(render.at("spans"), sides[0].span, sides[1].span);
    gl.uniform3fv(render.at("corner"), D.statue.low);
    gl.uniform1f(render.at("cell_size"), D.statue.step);
    gl.uniform1i(render.at("statue"), Number(state.f === "statue"));
    gl.uniform2i(render.at("fit"), sides[0].first, sides[1].first);
    gl.uniform2i(render.at("products"), sides[0].products, sides[1].products);
    gl.uniform2i(render.at("grid"), e.width, e.height);
    gl.uniform1i(render.at("first"), samples);
    gl.uniform1i(render.at("count"), count);
    gl.uniform1f(render.at("split"), state.w);
    gl.uniform2f(render.at("size"), canvas.width, canvas.height);
    gl.uniformMatrix3fv(render.at("view"), false, matrix());
    gl.uniform1f(render.at("turn"), state.t);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    targets.reverse();
    samples += count;
  }
  function develop() {
    const tone = TONES[state.s] || { exposure: 1, gamma: 2.2 };
    show.use();
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    bind(0, targets[0].texture, show.at("history"));
    gl.uniform1f(show.at("exposure"), tone.exposure * 2 ** state.e);
    gl.uniform1f(show.at("gamma"), tone.gamma);
    gl.uniform1f(show.at("split"), state.w);
    gl.uniform2f(show.at("size"), canvas.width, canvas.height);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
  function frame() {
    if (!paused && samples < budget && !document.hidden) {
      accumulate(samples < 16 ? 2 : 8);
      develop();
      $("samples").textContent = `${samples} samples a pixel`;
    }
    requestAnimationFrame(frame);
  }

  // --- controls ------------------------------------------------------------------------------------------------------------
  const option = (value, text) => { const o = document.createElement("option"); o.value = value; o.textContent = text; return o; };
  for (const id of ["material-a", "material-b"]) D.materials.forEach((m) => $(id).append(option(m.name, m.standin ? `${m.title} (stand-in)` : m.title)));
  for (const id of ["model-a", "model-b"]) D.models.forEach((m) => $(id).append(option(m.name, m.title)));
  environments.forEach((e) => $("environment").append(option(e.name, e.name.replaceAll("_", " "))));
  const FIELDS = { "material-a": "m", "model-a": "a", "material-b": "n", "model-b": "b", environment: "s", shape: "f", split: "w", exposure: "e" };
  function sync() {
    for (const [id, key] of Object.entries(FIELDS)) $(id).value = key === "n" ? state.n || state.m : state[key];
    $("stops").textContent = `${state.e > 0 ? "+" : ""}${+state.e.toFixed(2)} stops`.replace("-", "−");
    ["left", "right"].forEach((id, side) => { $(id).textContent = state.n ? shownAs(side) : titleOf(D.models, of(side)[1]); $(id).hidden = side ? state.w >= 1 : state.w <= 0; });
    canvas.setAttribute("aria-label", `Picture: ${shownAs(0)} beside ${shownAs(1)}; arrow keys turn the view, with Shift the light`);
    for (const [id, path] of [["material-page", `materials/${encodeURIComponent(state.m)}.html`], ["compare-page", `compare.html#${new URLSearchParams({ m: state.m, a: state.a, b: state.b })}`]]) $(id).href = path;
    choose(0); choose(1);
    told();
    restart();
  }
  function change(parts) {
    // A material chosen on the left is that of both, unless the right has another one.
    if (parts.n === state.m) parts.n = "";
    Object.assign(state, parts);
    if (state.n === state.m) state.n = "";
    sync();
    write();
  }
  for (const [id, key] of Object.entries(FIELDS)) $(id).addEventListener($(id).type === "range" ? "input" : "change", (e) => change({ [key]: key === "w" || key === "e" ? Number(e.target.value) : e.target.value }));
  $("controls").addEventListener("submit", (e) => e.preventDefault());
  function turnBy(dx, dy, light) {
    change(light ? { t: state.t + dx } : { x: state.x - dx, y: Math.min(Math.max(state.y + dy, -1.5), 1.5) });
  }
  // A drag that starts at the divider moves it, any other turns the view.
  const across = (e) => { const box = canvas.getBoundingClientRect(); return (e.clientX - box.left) / box.width; };
  const atDivider = (e) => Math.abs(across(e) - state.w) < 14 / canvas.getBoundingClientRect().width;
  let last = null, dividing = false;
  canvas.addEventListener("pointerdown", (e) => { last = e; dividing = atDivider(e); canvas.setPointerCapture(e.pointerId); });
  canvas.addEventListener("pointermove", (e) => {
    canvas.style.cursor = dividing || (!last && atDivider(e)) ? "ew-resize" : "";
    if (!last) return;
    if (dividing) change({ w: Math.min(Math.max(across(e), 0), 1) });
    else turnBy((e.clientX - last.clientX) / 150, (e.clientY - last.clientY) / 150, e.shiftKey || e.buttons === 2);
    last = e;
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { last = null; dividing = false; });
  canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  canvas.addEventListener("keydown", (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey) return; // the browser's own, such as Ctrl+R
    const by = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[e.key];
    if (by) { e.preventDefault(); turnBy(...by, e.shiftKey); }
    if (e.key === "," || e.key === ".") change({ w: Math.min(Math.max(state.w + (e.key === "," ? -0.05 : 0.05), 0), 1) });
    if (e.key === "r") change({ x: 0, y: 0, t: 0, w: 0.5, e: 0 });
  });
  P.follow(read);
  window.addEventListener("pagehide", () => { clearTimeout(writing); keep(); });
  resize(512, 512);
  read();
  requestAnimationFrame(frame);
  // For tests and for whoever wants the numbers: linear radiance, rows from the bottom, after a number of samples.
  window.ATLAS_VIEWER = {
    change, resize,
    get state() { return state; },
    get loaded() { return sides.every((place) => place.kind !== NOTHING); },
    get samples() { return samples; },
    linear(wanted, step = 32) {
      paused = true;
      restart();
      while (samples < wanted) accumulate(Math.min(step, wanted - samples));
      gl.bindFramebuffer(gl.FRAMEBUFFER, targets[0].buffer);
      const raw = new Float32Array(4 * canvas.width * canvas.height);
      gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.FLOAT, raw);
      develop();
      paused = false;
      const out = [];
      for (let i = 0; i < raw.length; i += 4) out.push(raw[i] / raw[i + 3], raw[i + 1] / raw[i + 3], raw[i + 2] / raw[i + 3]);
      return out;
    },
  };
})();
