// One frame: its image at full size, and everything that is known of it.

import { askJson, byId, make, written } from "./dom.js";
import { overlay } from "./overlay.js";

const groupOf = (name) => (/(^|_)error_(deg|px|m)$/.test(name) ? "Errors" : name.startsWith("true_") ? "Truth" : "Measured");

export class Detail {
  constructor(summary) {
    this.summary = summary;
    this.dialog = byId("detail");
    this.row = null;
    byId("detail-close").addEventListener("click", () => this.dialog.close());
    byId("detail-previous").addEventListener("click", () => this.step(-1));
    byId("detail-next").addEventListener("click", () => this.step(1));
    this.dialog.addEventListener("keydown", (event) => {
      if (event.target instanceof HTMLInputElement) return;
      if (event.key === "ArrowLeft") this.step(-1);
      if (event.key === "ArrowRight") this.step(1);
    });
    this.dialog.addEventListener("close", () => {
      this.row = null;
      this.closed?.();
    });
  }

  /** Show a row; `near` gives the one that is so many further on the grid, or null. */
  async show(row, near) {
    this.row = row;
    this.near = near;
    const { overlay: drawn, values } = await askJson(`/api/frames/${row}`);
    if (this.row !== row) return;
    byId("detail-title").textContent = `Frame ${drawn.frame}`;
    const image = make("img", { src: `/api/frames/${row}/picture?v=${this.summary.session}`, width: drawn.width,
      height: drawn.height, alt: `Frame ${drawn.frame}` });
    image.addEventListener("error", async () => {
      let why = "no image";
      try {
        await askJson(`/api/frames/${row}/picture`);
      } catch (problem) {
        why = problem.message;
      }
      image.replaceWith(make("span", { class: "missing" }, why));
    });
    byId("detail-picture").replaceChildren(image, overlay(drawn, 0.006));
    byId("detail-values").replaceChildren(...this.tables(values));
    byId("detail-previous").disabled = near(-1) === null;
    byId("detail-next").disabled = near(1) === null;
    if (!this.dialog.open) this.dialog.showModal();
    this.moved?.();
  }

  step(by) {
    const row = this.near?.(by);
    if (row !== null && row !== undefined) this.show(row, this.near);
  }

  tables(values) {
    const all = this.summary.columns.map((column, i) => [column, values[i]]);
    if (this.summary.kind !== "run") return [table("Everything that is known", all)];
    return ["Errors", "Measured", "Truth"].map((title) => [title, all.filter(([column]) => groupOf(column.name) === title)])
      .filter(([, own]) => own.length).map(([title, own]) => table(title, own));
  }
}

const table = (title, pairs) => {
  const rows = pairs.map(([column, value]) => make("tr", {},
    make("th", { scope: "row" }, column.name), make("td", { class: "number" }, text(value)),
    make("td", { class: "soft unit" }, column.unit), make("td", { class: "soft about" }, column.description)));
  const head = make("tr", {}, ...["Column", "Value", "Unit", "What it is"].map((name, i) =>
    make("th", { scope: "col", class: ["", "", "unit", "about"][i] }, name)));
  return make("section", {}, make("h3", {}, title),
    make("div", { class: "scroll" }, make("table", {}, make("thead", {}, head), make("tbody", {}, ...rows))));
};

const text = (value) => {
  if (value === null) return "–";
  if (Array.isArray(value)) return value.map(written).join(", ");
  if (typeof value === "boolean") return value ? "yes" : "no";
  return typeof value === "number" ? String(Number(value.toPrecision(9))) : value === "" ? "empty" : value;
};
