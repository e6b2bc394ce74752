// The page of the grid: images with labels, whose number is small whatever the number of rows is.

import { askJson, make, written } from "./dom.js";
import { overlay } from "./overlay.js";

export const PER_PAGE = 48;

export class Grid {
  /** `open` is called with a row; `chosen` holds 1 for each row that is selected. */
  constructor(place, table, session, open, chosen, choose) {
    Object.assign(this, { place, table, session, open, chosen, choose, asked: 0, drawn: new Map() });
  }

  /** Show rows, with the value of a column below each image. */
  async show(rows, name, masks) {
    const turn = ++this.asked;
    const column = await this.table.load(name);
    const missing = [...rows].filter((row) => !this.drawn.has(key(row, masks)));
    const found = missing.length ? await askJson(`/api/overlays?rows=${missing.join(",")}&masks=${masks ? 1 : 0}`) : [];
    if (this.drawn.size > 20 * PER_PAGE) this.drawn.clear();
    for (const one of found) this.drawn.set(key(one.row, masks), one);
    if (turn !== this.asked) return; // another page was asked for meanwhile
    const drawn = [...rows].map((row) => this.drawn.get(key(row, masks)));
    if (drawn.includes(undefined)) return this.show(rows, name, masks); // the store was cleared
    this.place.replaceChildren(...drawn.map((one) => this.tile(one, column)));
  }

  tile(drawn, column) {
    const { row, frame, width, height } = drawn;
    const image = make("img", { src: `/api/frames/${row}/tile?v=${this.session}`, alt: "", width, height, loading: "lazy",
      decoding: "async" });
    const picture = make("span", { class: "picture" }, image, overlay(drawn, 0.014));
    image.addEventListener("error", () => image.replaceWith(make("span", { class: "missing" }, "no image")));
    const value = shown(column, row);
    const caption = make("span", { class: "caption" }, make("span", { class: "number" }, `#${frame}`),
      column.name === "frame" ? null : make("span", { class: "number value", title: `${column.name}: ${value}` }, value));
    const choice = make("input", { type: "checkbox", "aria-label": `Select frame ${frame}`,
      onchange: (event) => this.choose(row, event.target.checked) });
    choice.checked = this.chosen[row] === 1;
    const button = make("button", { type: "button", class: "open", "data-row": row, onclick: () => this.open(row),
      "aria-label": `Frame ${frame}${column.name === "frame" ? "" : `, ${column.name} ${value}`}: show everything` },
      picture, caption);
    return make("li", {}, button, choice);
  }
}

const key = (row, masks) => `${masks ? "m" : ""}${row}`;

const shown = (column, row) => {
  const value = column.values[row];
  if (column.kind === "number") return `${written(value)}${column.unit && !Number.isNaN(value) ? ` ${column.unit}` : ""}`;
  return column.kind === "category" ? (column.levels[value] ?? "no value") : "";
};
