// The page as a whole: what is shown stands behind the # of the address, so that a view can be opened again.

import { askJson, byId, make } from "./dom.js";
import { Detail } from "./detail.js";
import { Exporting } from "./exporting.js";
import { Grid, PER_PAGE } from "./grid.js";
import { switchLayers } from "./overlay.js";
import { Panels } from "./panels.js";
import { Table } from "./table.js";

const summary = await askJson("/api/summary").catch((problem) => report(problem));
const table = new Table(summary);
const chosen = new Uint8Array(summary.rows);
const view = { column: summary.order.column, descending: summary.order.descending, page: 0, rows: new Uint32Array(0) };

function report(problem) {
  byId("problem").textContent = problem.message;
  byId("problem").hidden = false;
  throw problem;
}

/** Run an act, and show what goes wrong. */
const guarded = (act) => (...given) => Promise.resolve(act(...given)).then(() => (byId("problem").hidden = true), report)
  .catch(() => {});

const layers = () => new Set([...document.querySelectorAll("[data-layer]")].filter((one) => one.checked)
  .map((one) => one.dataset.layer));

const panels = new Panels(byId("panels"), table, guarded(async (name, filter) => {
  await table.filter(name, filter);
  view.page = 0;
  await refresh();
}), guarded(async (name) => {
  if (table.filters.has(name)) await table.filter(name, null);
  await refresh();
}));
const detail = new Detail(summary);
const open = guarded((row) => detail.show(row, (by) => {
  const at = view.rows.indexOf(detail.row) + by;
  return at >= 0 && at < view.rows.length ? view.rows[at] : null;
}));
const grid = new Grid(byId("grid"), table, summary.session, open, chosen, (row, yes) => {
  chosen[row] = yes ? 1 : 0;
  count();
});

const pages = () => Math.max(Math.ceil(view.rows.length / PER_PAGE), 1);
const onPage = () => view.rows.subarray(view.page * PER_PAGE, (view.page + 1) * PER_PAGE);
const selected = () => chosen.reduce((sum, one) => sum + one, 0);

function count() {
  const all = summary.rows.toLocaleString("en");
  const left = view.rows.length.toLocaleString("en");
  const picked = selected();
  byId("count").textContent = `${left} of ${all} frames${picked ? `, ${picked.toLocaleString("en")} selected` : ""}`;
}

/** Show rows and histograms again after a change. */
async function refresh() {
  view.rows = await table.sorted(view.column, view.descending);
  view.page = Math.min(view.page, pages() - 1);
  panels.update();
  count();
  byId("sort").value = view.column;
  byId("direction").textContent = view.descending ? "Descending ↓" : "Ascending ↑";
  byId("direction").setAttribute("aria-label", view.descending ? "Descending; sort ascending" : "Ascending; sort descending");
  byId("nothing").hidden = view.rows.length > 0;
  byId("clear").hidden = table.filters.size === 0;
  byId("fold").textContent = table.filters.size ? `Filters (${table.filters.size})` : "Filters";
  byId("page").value = view.page + 1;
  byId("page").max = pages();
  byId("pages").textContent = `of ${pages().toLocaleString("en")}`;
  byId("previous").disabled = view.page === 0;
  byId("next").disabled = view.page === pages() - 1;
  byId("pager").hidden = pages() === 1;
  keep();
  const below = view.column === "frame" ? (summary.shown[0] ?? "frame") : view.column;
  await grid.show(onPage(), below, layers().has("mask"));
}

/** Write the view behind the # of the address. */
function keep() {
  const parts = new URLSearchParams();
  parts.set("sort", `${view.descending ? "-" : ""}${view.column}`);
  for (const [name, { from, to, levels, text }] of table.filters) {
    if (text) parts.set(`text.${name}`, text);
    else if (levels) parts.set(`is.${name}`, JSON.stringify([...levels]));
    else parts.set(`range.${name}`, `${Number.isFinite(from) ? from : ""}..${Number.isFinite(to) ? to : ""}`);
  }
  parts.set("labels", [...layers()].join(","));
  if (view.page) parts.set("page", view.page + 1);
  if (detail.row !== null) parts.set("row", detail.row);
  history.replaceState(null, "", `#${parts}`);
}

const KINDS = { text: "text", is: "category", range: "number" }; // of a filter: the columns that have such

/** Take up the view that stands behind the # of the address. */
async function take() {
  const parts = new URLSearchParams(location.hash.slice(1));
  const sort = parts.get("sort") ?? "";
  const name = sort.replace(/^-/, "");
  if (table.columns.has(name) && table.columns.get(name).kind !== "list") {
    view.column = name;
    view.descending = sort.startsWith("-");
  }
  if (parts.has("labels")) {
    const wanted = new Set(parts.get("labels").split(","));
    for (const one of document.querySelectorAll("[data-layer]")) one.checked = wanted.has(one.dataset.layer);
  }
  for (const [key, value] of parts) {
    const [, kind, column] = key.match(/^(text|is|range)\.(.*)$/s) ?? [];
    if (KINDS[kind] === undefined || table.columns.get(column)?.kind !== KINDS[kind]) continue;
    await panels.add(column);
    const [from, to] = value.split("..");
    const wanted = { text: { text: value }, is: { levels: new Set(kind === "is" ? parsed(value) : []) },
      range: { from: from ? Number(from) : -Infinity, to: to ? Number(to) : Infinity } };
    await table.filter(column, wanted[kind]);
  }
  view.page = Math.max(Number(parts.get("page") ?? 1) - 1 || 0, 0);
  return parts.get("row");
}

const parsed = (text) => {
  try {
    return [JSON.parse(text)].flat();
  } catch {
    return [];
  }
};

function prepare() {
  document.title = `${summary.name} – simgrab`;
  byId("name").textContent = summary.name;
  byId("about").textContent = `${summary.rows.toLocaleString("en")} frames of a ${summary.kind}`;
  byId("notes").replaceChildren(...summary.notes.map((note) => make("li", {}, note)));
  byId("notes").hidden = summary.notes.length === 0;
  for (const part of document.querySelectorAll('[data-of="run"]')) part.hidden = summary.kind !== "run";
  const sortable = summary.columns.filter((column) => column.kind !== "list").map((column) => column.name);
  byId("sort").append(...sortable.map((name) => make("option", { value: name }, name)));
  byId("add").append(make("option", { value: "" }, "choose…"), ...sortable.map((name) => make("option", { value: name }, name)));
  byId("export").hidden = byId("choose-all").hidden = summary.formats.length === 0;
  document.body.classList.toggle("no-choice", summary.formats.length === 0);
}

function listen() {
  const on = (id, kind, act) => byId(id).addEventListener(kind, guarded(act));
  const turn = (page) => {
    view.page = Math.min(Math.max(page, 0), pages() - 1);
    byId("grid").scrollIntoView({ block: "nearest" });
    return refresh();
  };
  on("sort", "change", (event) => {
    view.column = event.target.value;
    return turn(0);
  });
  on("direction", "click", () => {
    view.descending = !view.descending;
    return turn(0);
  });
  on("previous", "click", () => turn(view.page - 1));
  on("next", "click", () => turn(view.page + 1));
  on("page", "change", (event) => turn((Number(event.target.value) || 1) - 1));
  on("add", "change", async (event) => {
    const name = event.target.value;
    event.target.value = "";
    if (name) await panels.add(name);
  });
  on("clear", "click", async () => {
    for (const name of [...table.filters.keys()]) await table.filter(name, null);
    await turn(0);
  });
  on("fold", "click", () => {
    const folded = document.body.classList.toggle("unfolded");
    byId("fold").setAttribute("aria-expanded", folded);
  });
  on("layers", "change", async () => {
    switchLayers();
    await refresh();
  });
  on("choose-all", "click", () => {
    const rows = onPage();
    const all = rows.every((row) => chosen[row]);
    for (const row of rows) chosen[row] = all ? 0 : 1;
    count();
    for (const box of document.querySelectorAll("#grid input")) box.checked = !all;
  });
  const exporting = new Exporting(summary.formats, (which) =>
    (which === "chosen" ? chosen : table.fails.map((fails) => (fails ? 0 : 1))));
  on("export", "click", () => exporting.show(view.rows.length, selected()));
  detail.moved = keep;
  detail.closed = keep;
}

prepare();
listen();
guarded(async () => {
  const row = await take();
  switchLayers();
  await refresh();
  document.body.dataset.ready = "grid";
  for (const name of summary.shown) await panels.add(name);
  panels.update();
  document.body.dataset.ready = "yes";
  if (row !== null && /^\d{1,9}$/.test(row) && Number(row) < summary.rows) open(Number(row));
})();
