// What every page does: its state is in the address, tables sort by their heads, filters filter, one scene is shown at
// a time, and what can be scrolled says so.
"use strict";
(() => {
  // --- state in the address: survives reload, Back and copying --------------------------------------------------------
  // An address that names a place in the page (#fits) leaves the state as it is.
  let stated = "";
  const words = () => {
    if (!location.hash || location.hash.includes("=")) stated = location.hash.slice(1);
    return new URLSearchParams(stated);
  };
  // What the address names in the page; an address cut off within a %.. names nothing.
  const named = () => { try { return decodeURIComponent(location.hash.slice(1)); } catch { return ""; } };
  const get = (key, otherwise = "") => words().get(key) ?? otherwise;
  function set(changes) {
    const now = words();
    for (const [key, value] of Object.entries(changes)) if (value === "" || value === null) now.delete(key); else now.set(key, value);
    const text = now.toString();
    history.replaceState(null, "", text ? `#${text}` : location.pathname + location.search);
  }
  // `read` is called with the address as it is now, whenever another one is entered or the page comes back.
  function follow(read) {
    window.addEventListener("hashchange", () => { if (!location.hash || location.hash.includes("=")) read(); });
    window.addEventListener("pageshow", read);
  }

  // --- tables -------------------------------------------------------------------------------------------------------------
  const valueOf = (cell) => {
    const raw = cell ? (cell.dataset.value !== undefined ? cell.dataset.value : cell.textContent.trim()) : "";
    if (raw === "" || raw === "nan" || raw === "None" || raw === "–") return null;
    if (raw === "inf" || raw === "∞") return Infinity;
    const number = Number(raw.replace(/[\s\u2009\u202f]/g, "").replace("−", "-"));
    return Number.isNaN(number) ? raw.toLowerCase() : number;
  };
  // Missing values stay last in both directions.
  const compare = (a, b, sign) => {
    if (a === null || b === null) return (a === null) - (b === null);
    if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
    return sign * (typeof a === "number" ? a - b : a.localeCompare(b));
  };
  function sortable(table) {
    const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells], body = table.tBodies[0], given = [...body.rows];
    const name = table.id ? `sort-${table.id}` : "";
    function sort(column, direction) {
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      if (column < 0) { body.append(...given); return; }
      heads[column].setAttribute("aria-sort", direction);
      const rows = given.map((row) => [valueOf(row.cells[column]), row]);
      rows.sort(([a], [b]) => compare(a, b, direction === "ascending" ? 1 : -1));
      body.append(...rows.map(([, row]) => row));
    }
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "sort";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const old = head.getAttribute("aria-sort"), first = head.dataset.first || (head.classList.contains("num") ? "descending" : "ascending");
        const direction = !old ? first : old === "ascending" ? "descending" : "ascending";
        sort(column, direction);
        if (name) set({ [name]: `${column}-${direction}` });
      });
    });
    if (name) {
      const read = () => { const [column, direction] = get(name, "-1-").split(/-(?=[a-z]|$)/); sort(Number(column) in heads ? Number(column) : -1, direction); };
      follow(read);
      if (get(name)) read();
    }
  }
  function filterable(input) {
    const table = document.getElementById(input.dataset.filter), name = `find-${input.dataset.filter}`;
    const apply = () => {
      const wanted = input.value.toLowerCase().split(/\s+/).filter(Boolean);
      for (const row of table.tBodies[0].rows) {
        const text = row.textContent.toLowerCase();
        row.hidden = !wanted.every((word) => text.includes(word));
      }
    };
    input.addEventListener("input", () => { set({ [name]: input.value }); apply(); });
    const read = () => { input.value = get(name); apply(); };
    follow(read);
    read();
  }

  // --- switches: buttons of one group show one of several blocks ---------------------------------------------------------
  // <group data-switch="scene"> holds buttons with data-choice; blocks carry data-scene.
  function switches(group) {
    const key = group.dataset.switch, buttons = [...group.querySelectorAll("button[data-choice]")];
    const show = (choice) => {
      buttons.forEach((b) => b.setAttribute("aria-pressed", String(b.dataset.choice === choice)));
      document.querySelectorAll(`[data-${key}]`).forEach((block) => { block.hidden = block.getAttribute(`data-${key}`) !== choice; });
    };
    buttons.forEach((b) => b.addEventListener("click", () => { set({ [key]: b === buttons[0] ? "" : b.dataset.choice }); show(b.dataset.choice); }));
    const read = () => { const choice = get(key); show(buttons.some((b) => b.dataset.choice === choice) ? choice : buttons[0].dataset.choice); };
    follow(read);
    read();
  }

  // --- what can be scrolled says so ----------------------------------------------------------------------------------------
  const cue = (box) => {
    box.classList.toggle("more", box.scrollLeft + box.clientWidth < box.scrollWidth - 2);
    box.classList.toggle("below", box.scrollTop + box.clientHeight < box.scrollHeight - 2);
  };
  const room = new ResizeObserver((entries) => entries.forEach(({ target }) => cue(target.classList.contains("scroll") ? target : target.parentElement)));
  function scrolls(box) {
    const frame = document.createElement("div");
    frame.className = "scroll-frame";
    box.replaceWith(frame);
    frame.append(box);
    box.addEventListener("scroll", () => cue(box), { passive: true });
    room.observe(box);
    for (const child of box.children) room.observe(child);
  }
  document.addEventListener("toggle", (event) => event.target.querySelectorAll(".scroll").forEach(cue), true);
  // A copy button for every snippet.
  function copies(button) {
    button.addEventListener("click", async () => {
      const text = document.getElementById(button.dataset.copy).textContent, old = button.textContent;
      try { await navigator.clipboard.writeText(text); button.textContent = "Copied"; } catch {
        const range = document.createRange();
        range.selectNodeContents(document.getElementById(button.dataset.copy));
        getSelection().removeAllRanges(); getSelection().addRange(range);
        button.textContent = "Selected: press Ctrl+C";
      }
      setTimeout(() => { button.textContent = old; }, 2500);
    });
  }
  // A link to something inside a folded part opens it.
  function unfold() {
    const id = location.hash.includes("=") ? "" : named(), target = id && document.getElementById(id);
    for (let node = target; node; node = node.parentElement) if (node.tagName === "DETAILS") node.open = true;
    if (target) target.scrollIntoView();
  }
  window.AtlasPage = { sortable, compare, named, get, set, follow, scrolls };
  document.querySelectorAll("table[data-sortable]").forEach(sortable);
  document.querySelectorAll("input[data-filter]").forEach(filterable);
  document.querySelectorAll("[data-switch]").forEach(switches);
  document.querySelectorAll(".scroll").forEach(scrolls);
  document.querySelectorAll("button[data-copy]").forEach(copies);
  window.addEventListener("hashchange", unfold);
  unfold();
})();
