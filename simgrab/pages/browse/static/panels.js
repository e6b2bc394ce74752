// Filters of the columns that are shown: a histogram with two numbers, categories with bars, or a text to search.

import { make, svg, written } from "./dom.js";

const WIDTH = 240;
const HEIGHT = 56;

export class Panels {
  /** `changed` is called with a column and its new filter, or null. */
  constructor(place, table, changed, removed) {
    Object.assign(this, { place, table, changed, removed, shown: new Map() });
  }

  async add(name) {
    if (this.shown.has(name)) return;
    this.shown.set(name, null);
    const column = await this.table.load(name);
    const panel = makers[column.kind](column, this);
    const close = make("button", { type: "button", class: "plain", "aria-label": `Remove the column ${name}`,
      onclick: () => this.remove(name) }, "✕");
    const unit = column.unit ? make("span", { class: "soft" }, ` ${column.unit}`) : null;
    const head = make("div", { class: "row" }, make("h3", { title: column.description }, name, unit), close);
    panel.section = make("section", { "aria-label": `Filter: ${name}`, "data-column": name }, head, ...panel.parts);
    this.shown.set(name, panel);
    this.place.append(panel.section);
    panel.update();
  }

  remove(name) {
    this.shown.get(name)?.section.remove();
    this.shown.delete(name);
    this.removed(name);
  }

  update() {
    for (const panel of this.shown.values()) panel?.update();
  }
}

/** Wait until nobody typed for a moment. */
const debounced = (act, pause = 80) => {
  let timer;
  return () => {
    clearTimeout(timer);
    timer = setTimeout(act, pause);
  };
};

const numbers = (column, panels) => {
  const { table, changed } = panels;
  const name = column.name;
  const [low, high] = column.span ?? [0, 0];
  const bars = Array.from({ length: column.bars }, () => [svg("rect", { class: "all" }), svg("rect", { class: "left" })]);
  const brush = svg("rect", { class: "brush", y: 0, height: HEIGHT });
  const drawing = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", preserveAspectRatio: "none" },
    ...bars.flat(), brush);
  const field = (label, value) => make("input", { type: "number", step: "any", placeholder: written(value),
    "aria-label": `${name}, ${label}` });
  const from = field("from", low);
  const to = field("to", high);
  const read = (input, other) => (input.value === "" ? other : Number(input.value));
  const apply = () => {
    const free = from.value === "" && to.value === "";
    changed(name, free ? null : { from: read(from, -Infinity), to: read(to, Infinity) });
  };
  from.addEventListener("input", debounced(apply));
  to.addEventListener("input", debounced(apply));
  const soon = debounced(apply, 30);
  brushed(drawing, column, table, (a, b) => {
    from.value = a === null ? "" : Number(a.toPrecision(6));
    to.value = b === null ? "" : Number(b.toPrecision(6));
    soon();
  });
  const update = () => {
    const { all, left } = table.counts(name);
    const most = Math.max(1, ...all);
    const width = WIDTH / column.bars;
    bars.forEach(([whole, part], i) => {
      place(whole, i * width, width, all[i] / most);
      place(part, i * width, width, left[i] / most);
    });
    const filter = table.filters.get(name);
    const at = (value) => Math.min(Math.max(((value - low) / (high - low || 1)) * WIDTH, 0), WIDTH);
    if (document.activeElement !== from) from.value = Number.isFinite(filter?.from) ? filter.from : "";
    if (document.activeElement !== to) to.value = Number.isFinite(filter?.to) ? filter.to : "";
    brush.toggleAttribute("hidden", !filter);
    if (filter) {
      brush.setAttribute("x", at(filter.from));
      brush.setAttribute("width", Math.max(at(filter.to) - at(filter.from), 1));
    }
    const sum = left.reduce((a, b) => a + b, 0);
    drawing.setAttribute("aria-label", `Histogram of ${name} from ${written(low)} to ${written(high)}: ${sum} frames`);
  };
  const ends = make("div", { class: "row soft number ends", "aria-hidden": "true" }, make("span", {}, written(low)),
    make("span", {}, written(high)));
  return { parts: [drawing, ends, make("div", { class: "row range" }, from, make("span", { class: "soft" }, "to"), to)],
    update };
};

const place = (bar, x, width, share) => {
  const height = share > 0 ? Math.max(share * (HEIGHT - 2), 1.5) : 0;
  bar.setAttribute("x", x + 0.5);
  bar.setAttribute("width", Math.max(width - 1, 0.5));
  bar.setAttribute("y", HEIGHT - height);
  bar.setAttribute("height", height);
};

/** Let a range be dragged over a histogram; a click takes one bar, or with a filter removes it. */
const brushed = (drawing, column, table, done) => {
  let start = null;
  const share = (event) => {
    const box = drawing.getBoundingClientRect();
    return Math.min(Math.max((event.clientX - box.left) / box.width, 0), 0.9999);
  };
  drawing.addEventListener("pointerdown", (event) => {
    if (!column.span) return;
    start = share(event);
    drawing.setPointerCapture(event.pointerId);
  });
  drawing.addEventListener("pointermove", (event) => {
    if (start !== null && Math.abs(share(event) - start) > 0.01) done(...ends(start, share(event)));
  });
  drawing.addEventListener("pointerup", (event) => {
    if (start === null) return;
    const end = share(event);
    if (Math.abs(end - start) <= 0.01) done(...(table.filters.has(column.name) ? [null, null] : ends(end, end)));
    start = null;
  });
  const ends = (a, b) => {
    const bar = (at) => table.bar(column, Math.floor(at * column.bars));
    return [bar(Math.min(a, b))[0], bar(Math.max(a, b))[1]];
  };
};

const categories = (column, panels) => {
  const { table, changed } = panels;
  const name = column.name;
  const boxes = column.levels.map((level) => {
    const input = make("input", { type: "checkbox", onchange: () => apply() });
    const bar = svg("rect", { class: "left", height: 4 });
    const all = svg("rect", { class: "all", height: 4 });
    const count = make("span", { class: "number soft" });
    const text = level === null ? "no value" : level === "" ? "empty" : level;
    const label = make("label", { class: "level" }, input, make("span", { class: "text", title: text }, text), count,
      svg("svg", { viewBox: "0 0 100 4", preserveAspectRatio: "none", "aria-hidden": "true" }, all, bar));
    return { level, input, bar, all, count, label };
  });
  const apply = () => {
    const kept = boxes.filter((box) => box.input.checked).map((box) => box.level);
    changed(name, kept.length ? { levels: new Set(kept) } : null);
  };
  const update = () => {
    const { all, left } = table.counts(name);
    const most = Math.max(1, ...all);
    const kept = table.filters.get(name)?.levels;
    boxes.forEach((box, i) => {
      box.input.checked = Boolean(kept?.has(box.level));
      box.count.textContent = left[i];
      box.all.setAttribute("width", (100 * all[i]) / most);
      box.bar.setAttribute("width", (100 * left[i]) / most);
    });
  };
  return { parts: [make("div", { class: "levels" }, ...boxes.map((box) => box.label))], update };
};

const texts = (column, panels) => {
  const name = column.name;
  const input = make("input", { type: "search", placeholder: "contains…", maxlength: 200,
    "aria-label": `${name} contains` });
  const filter = () => panels.changed(name, input.value ? { text: input.value } : null);
  input.addEventListener("input", debounced(filter, 250));
  const update = () => {
    if (document.activeElement !== input) input.value = panels.table.filters.get(name)?.text ?? "";
  };
  return { parts: [input], update };
};

const makers = { number: numbers, category: categories, text: texts };
