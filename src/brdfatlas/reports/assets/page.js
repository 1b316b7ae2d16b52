// What every page does: tables sort by their heads, filters filter, one scene is shown at a time.
"use strict";
(() => {
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
    const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells];
    heads.forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "sort";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const old = head.getAttribute("aria-sort");
        const direction = old === "ascending" ? "descending" : old === "descending" ? "ascending"
          : head.classList.contains("num") ? "descending" : "ascending";
        heads.forEach((other) => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", direction);
        const body = table.tBodies[0];
        const rows = [...body.rows].map((row) => [valueOf(row.cells[column]), row]);
        const sign = direction === "ascending" ? 1 : -1;
        rows.sort(([a], [b]) => compare(a, b, sign));
        body.append(...rows.map(([, row]) => row));
      });
    });
  }
  function filterable(input) {
    const table = document.getElementById(input.dataset.filter);
    input.addEventListener("input", () => {
      const words = input.value.toLowerCase().split(/\s+/).filter(Boolean);
      for (const row of table.tBodies[0].rows) {
        const text = row.textContent.toLowerCase();
        row.hidden = !words.every((word) => text.includes(word));
      }
    });
  }
  function scenes() {
    const buttons = [...document.querySelectorAll("[data-scene-button]")];
    if (!buttons.length) return;
    const show = (name) => {
      buttons.forEach((b) => b.setAttribute("aria-pressed", String(b.dataset.sceneButton === name)));
      document.querySelectorAll("[data-scene]").forEach((block) => { block.hidden = name !== "" && block.dataset.scene !== name; });
    };
    buttons.forEach((b) => b.addEventListener("click", () => show(b.dataset.sceneButton)));
    show(buttons[0].dataset.sceneButton);
  }
  window.AtlasPage = { sortable, compare };
  document.querySelectorAll("table[data-sortable]").forEach(sortable);
  document.querySelectorAll("input[data-filter]").forEach(filterable);
  scenes();
})();
