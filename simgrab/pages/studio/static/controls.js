// Controls for every key of a scene, made from its schema. Each has its name, unit, bounds, default, help and error.

import { make } from "./dom.js";
import { TAGS, bounds, fresh, freshKind, kindOf, kinds, leaves, names, present, resolved, same } from "./schema.js";

let count = 0;
const id = () => `control-${++count}`;
const MOST_STEPS = 5000; // of a slider; what has more bounds than these gets a field alone
const MOST_BOUND = 1e7; // of a slider: beyond it stands what has no bounds of its own
const words = (value) => (typeof value === "string" ? value : JSON.stringify(value));

/** The value at a path of plain data. */
const at = (data, path) => path.reduce((inner, key) => inner?.[key], data);

export class Controls {
  /** `scene()` gives what is edited, `set(path, value, rests)` changes it, `default` has what a file may leave out. */
  constructor(place, properties, defaults, scene, set) {
    Object.assign(this, { place, properties, defaults, scene, set, text: "", changedOnly: false });
  }

  build() {
    const entries = Object.entries(this.properties).filter(([key]) => key !== "base");
    const isTable = ([, node]) => ["table", "kinds", "entries"].includes(kindOf(node));
    const plain = entries.filter((one) => !isTable(one));
    const tables = entries.filter(isTable);
    this.sections = [section(this, "", plain), ...tables.map(([key, node]) => section(this, key, [[key, node]]))];
    this.place.replaceChildren(...this.sections.map((one) => one.element));
    this.update();
  }

  update() {
    for (const one of this.sections) one.update();
    this.find(this.text, this.changedOnly);
  }

  value(path) {
    return at(this.scene(), path);
  }

  preset(path) {
    return at(this.defaults, path);
  }

  /** Show an error at the key that it is about, or at the nearest one around it; with null show none. */
  mark(key, problem) {
    for (const one of this.place.querySelectorAll(".error:not([hidden])")) {
      one.hidden = true;
      one.closest("[data-key]").classList.remove("wrong");
    }
    if (problem === null) return true;
    const places = [...this.place.querySelectorAll("[data-key]")];
    for (let dotted = key; dotted; dotted = dotted.includes(".") ? dotted.slice(0, dotted.lastIndexOf(".")) : "") {
      const found = places.find((one) => one.dataset.key === dotted);
      if (!found) continue;
      const shown = found.querySelector(":scope > .error");
      shown.textContent = dotted === key ? problem : `${key}: ${problem}`;
      shown.hidden = false;
      found.classList.add("wrong");
      for (let above = found; above; above = above.parentElement?.closest("details")) above.open = true;
      return true;
    }
    return false;
  }

  /** Show the keys whose name, unit or help contains a text. */
  find(text, changedOnly) {
    Object.assign(this, { text, changedOnly });
    const wanted = text.trim().toLowerCase().split(/\s+/).filter(Boolean);
    const active = wanted.length > 0 || changedOnly;
    let shown = 0;
    for (const row of this.place.querySelectorAll("[data-key]")) {
      const own = (row.dataset.text ?? "").toLowerCase();
      row.classList.toggle("hit", active && wanted.every((word) => own.includes(word))
        && (!changedOnly || row.classList.contains("changed")));
    }
    for (const row of this.place.querySelectorAll("[data-key]")) {
      const within = row.classList.contains("hit") || row.querySelector(".hit") || row.parentElement.closest(".hit:not(.section)");
      row.hidden = active && !within;
      shown += !row.hidden;
    }
    for (const one of this.sections) {
      const any = !active || one.element.querySelector("[data-key]:not([hidden])") !== null;
      one.element.hidden = !any;
      if (active && any && wanted.length) one.element.open = true;
    }
    return shown;
  }
}

/** A table of the file, which can be left out of it. */
const section = (form, key, entries) => {
  const controls = entries.map(([name, node]) => (key ? body(form, node, [name]) : control(form, node, [name])));
  const badge = make("span", { class: "badge" });
  const remove = make("button", { type: "button", class: "plain", "aria-label": `Remove ${key}`,
    title: `Leave [${key}] out of the file: all of its keys take their defaults` }, "Remove");
  const node = key ? entries[0][1] : {};
  remove.addEventListener("click", (event) => {
    event.preventDefault();
    form.set([key], structuredClone(form.defaults[key]), true);
  });
  const help = make("p", { class: "help soft" }, key ? node.description : "Keys at the top of the file.");
  const element = make("details", { class: "section", open: key === "" || key === "camera" || key === "swing" },
    make("summary", {}, make("h2", {}, key || "scene"), badge, key ? remove : null),
    make("div", { class: "inner" }, help, ...controls.map((one) => one.element)));
  if (key) {
    Object.assign(element.dataset, { key, text: `${key} ${node.description}` });
    element.append(make("p", { class: "error bad", hidden: true }));
  }
  const update = () => {
    for (const one of controls) one.update();
    if (!key) return;
    const changed = !same(form.value([key]), form.defaults[key]);
    element.classList.toggle("changed", changed);
    badge.textContent = changed ? "" : "not in the file";
    badge.hidden = changed;
    remove.hidden = !changed;
  };
  return { element, update };
};

const GROUPS = ["table", "kinds", "entries", "list", "mixed"];

/** A control with its label, help and error. */
const control = (form, node, path, preset = form.preset(path)) => {
  const kind = kindOf(node);
  if (GROUPS.includes(kind)) return group(form, node, path, preset);
  const label = id();
  const inner = (MAKERS[kind] ?? MAKERS.any)(form, node, path, label);
  const key = path.at(-1);
  const name = typeof key === "number" ? `${key + 1}` : key;
  const back = make("button", { type: "button", class: "plain back", hidden: true,
    "aria-label": `Reset ${path.join(".")}`, title: "Back to the default" }, "↺");
  back.addEventListener("click", () => form.set(path, structuredClone(initial(node, preset)), true));
  const element = make("div", { class: `key is-${kind}`, "data-key": path.join("."), "data-text": textOf(node, path) },
    make("div", { class: "name" }, make("label", { for: label }, name), node.unit ? make("span", { class: "unit" }, node.unit) : null,
      back),
    make("div", { class: "input" }, inner.element), ...helps(node, preset), make("p", { class: "error bad", hidden: true }));
  const update = () => {
    inner.update(form.value(path));
    const known = initial(node, preset);
    const changed = known !== undefined && !same(form.value(path), known);
    element.classList.toggle("changed", changed);
    back.hidden = !changed;
  };
  return { element, update };
};

const initial = (node, preset) => (preset === undefined ? node.default : preset);

const textOf = (node, path) => [path.join("."), node.unit, node.description, ...(node.enum ?? []), node.title].filter(Boolean).join(" ");

const helps = (node, preset) => {
  const limits = limitsOf(node);
  const known = initial(node, preset);
  const shown = known === undefined || (typeof known === "object" && known !== null && !Array.isArray(known)) ? ""
    : `default ${known === null ? "absent" : known === "" ? "empty" : words(known)}`;
  const facts = [limits, shown].filter(Boolean).join(" · ");
  return [node.description ? make("p", { class: "help soft" }, node.description) : null,
    facts ? make("p", { class: "facts soft" }, facts) : null].filter(Boolean);
};

const limitsOf = (node) => {
  const inner = kindOf(node) === "optional" ? present(node) : kindOf(node) === "tuple" ? node.prefixItems[0] : node;
  const { low, high, above } = bounds(inner);
  if (low !== undefined && high !== undefined && Math.abs(low) < 1e9 && Math.abs(high) <= 1e7)
    return `${above ? "above " : ""}${low} to ${high}`;
  if (low !== undefined && Math.abs(low) < 1e9) return `${above ? "above" : "at least"} ${low}`;
  return inner.maxLength ? `at most ${inner.maxLength} characters` : "";
};

/** A control of several others, with a heading. */
const group = (form, node, path, preset) => {
  const inner = body(form, node, path, preset);
  const key = path.at(-1);
  const element = make("fieldset", { class: "group", "data-key": path.join("."), "data-text": textOf(node, path) },
    make("legend", {}, typeof key === "number" ? `${key + 1}` : String(key),
      node.unit ? make("span", { class: "unit" }, node.unit) : null),
    ...helps(node, preset), inner.element, make("p", { class: "error bad", hidden: true }));
  const update = () => {
    inner.update();
    const known = initial(node, preset);
    element.classList.toggle("changed", known !== undefined && !same(form.value(path), known));
  };
  return { element, update };
};

/** What is within a group: made again where the structure of the value changes. */
const body = (form, node, path, preset = form.preset(path)) => {
  const element = make("div", { class: "body" });
  let shape = null;
  let parts = [];
  const update = () => {
    const value = form.value(path);
    const now = shapeOf(node, value);
    if (now !== shape) {
      shape = now;
      parts = BODIES[kindOf(node)](form, node, path, value, preset);
      element.replaceChildren(...parts.map((one) => one.element));
    }
    for (const one of parts) one.update();
  };
  return { element, update };
};

const shapeOf = (node, value) => {
  const tags = (one) => (one && typeof one === "object" ? `${one.model ?? ""}/${one.dist ?? ""}` : typeof one);
  switch (kindOf(node)) {
    case "kinds": return tags(value);
    case "mixed": return typeof value;
    case "list": return JSON.stringify(value.map(tags));
    case "entries": return JSON.stringify(Object.entries(value).map(([key, one]) => [key, tags(one)]));
    default: return "";
  }
};

const still = (element) => ({ element, update: () => {} });

const rows = (form, table, path, preset) => Object.entries(table.properties).filter(([key]) => !TAGS.includes(key))
  .map(([key, inner]) => control(form, inner, [...path, key], preset?.[key] === undefined ? inner.default : preset[key]));

const picked = (label, choices, value, pick) => {
  const select = make("select", { "aria-label": label }, ...choices.map((one) =>
    make("option", { value: one, selected: one === value }, one)));
  select.addEventListener("change", () => pick(select.value));
  return select;
};

const button = (text, act, attributes = {}) => make("button", { type: "button", onclick: act, ...attributes }, text);

const BODIES = {
  table: (form, node, path, value, preset) => rows(form, resolved(node), path, preset),

  kinds: (form, node, path, value, preset) => {
    const [field, tables] = kinds(node);
    const tag = value[field];
    const select = picked(`${path.join(".")} ${field}`, Object.keys(tables), tag, (to) =>
      form.set(path, same(to, preset?.[field]) ? structuredClone(preset) : freshKind(node, to, value), true));
    const line = make("div", { class: "key is-kind", "data-key": [...path, field].join("."),
      "data-text": `${path.join(".")} ${field} ${Object.keys(tables).join(" ")}` },
    make("div", { class: "name" }, make("span", {}, field)), make("div", { class: "input" }, select),
    make("p", { class: "error bad", hidden: true }));
    const own = tag === preset?.[field] ? preset : undefined;
    return [still(line), ...rows(form, tables[tag], path, own)];
  },

  mixed: (form, node, path, value) => {
    const plain = node.anyOf.find((one) => !one.$ref);
    const table = resolved(node.anyOf.find((one) => one.$ref));
    const choices = plain.enum ?? form.layouts;
    const own = typeof value === "object";
    const select = picked(path.join("."), [...choices, "a table of its own"], own ? "a table of its own" : value, (to) =>
      form.set(path, choices.includes(to) ? to : fresh({ ...table, default: undefined }), true));
    return [still(select), ...(own ? rows(form, table, path) : [])];
  },

  list: (form, node, path, value) => {
    const items = resolved(node.items ?? {});
    const { unit } = node;
    const parts = value.map((_, i) => {
      const one = control(form, { ...items, unit }, [...path, i], undefined);
      one.element.append(button("Remove", () => form.set(path, form.value(path).filter((_, j) => j !== i), true),
        { class: "plain remove", "aria-label": `Remove ${[...path, i + 1].join(".")}` }));
      return one;
    });
    if (node.maxItems === undefined || value.length < node.maxItems) parts.push(still(button("Add", () => {
      const all = form.value(path);
      form.set(path, [...all, all.length ? structuredClone(all.at(-1)) : fresh({ ...items, default: undefined })], true);
    }, { class: "add", "aria-label": `Add to ${path.join(".")}` })));
    return parts;
  },

  entries: (form, node, path, value) => {
    const each = resolved(node.additionalProperties);
    const parts = Object.keys(value).map((key) => {
      const one = control(form, { ...each, description: "" }, [...path, key]);
      one.element.append(button("Remove", () => {
        const { [key]: gone, ...left } = form.value(path);
        form.set(path, left, true);
      }, { class: "plain remove", "aria-label": `Remove ${[...path, key].join(".")}` }));
      return one;
    });
    return [...parts, path[0] === "vary" ? varying(form, each, path) : adding(form, each, path)];
  },
};

/** Adds an entry of a table with free names: a table of a kind, or a plain value. */
const adding = (form, each, path) => {
  const tags = kindOf(each) === "kinds" ? Object.keys(kinds(each)[1]) : [];
  const name = make("input", { type: "text", placeholder: "name", "aria-label": `Name of a new entry of ${path.join(".")}` });
  const kind = tags.length ? picked(`Kind of a new entry of ${path.join(".")}`, tags, "", () => {}) : null;
  const act = () => {
    const key = name.value.trim() || kind?.value;
    if (key && form.value(path)[key] === undefined) {
      form.set(path, { ...form.value(path), [key]: kind ? freshKind(each, kind.value) : fresh(each) }, true);
    }
    name.value = "";
  };
  return still(make("div", { class: "adding" }, name, kind, button("Add", act, { class: "add", "aria-label": `Add to ${path.join(".")}` })));
};

/** Adds a key that varies. */
const varying = (form, each, path) => {
  const list = id();
  const options = make("datalist", { id: list });
  const name = make("input", { type: "text", list, placeholder: "key, such as camera.beta_deg", "aria-label": "Key that varies",
    spellcheck: "false", autocomplete: "off" });
  const act = () => {
    const key = name.value.trim();
    if (!key || form.value(path)[key] !== undefined) return;
    const found = [...leaves(form.properties, form.scene())].find(([dotted]) => dotted === key);
    form.set(path, { ...form.value(path), [key]: factor(found) }, true);
    name.value = "";
  };
  const update = () => options.replaceChildren(...[...leaves(form.properties, form.scene())].map(([key]) => make("option", { value: key })));
  return { element: make("div", { class: "adding" }, name, options, button("Add", act, { class: "add", "aria-label": "Add a key that varies" })), update };
};

/** What a key varies by at first: a number about its value, anything else a choice. */
const factor = (found) => {
  const [, node, value] = found ?? [null, {}, 0];
  if (typeof value !== "number") return { dist: "one-of", values: [value ?? null], weights: [], names: [] };
  if (node.type === "integer") return { dist: "one-of", values: [value, value], weights: [], names: [] };
  const { low = -Infinity, high = Infinity } = bounds(node);
  const width = Math.abs(value) * 0.2 || (Number.isFinite(high) ? (high - Math.max(low, 0)) * 0.1 : 1);
  return { dist: "uniform", low: Math.max(value - width, low), high: Math.min(value + width, high) };
};

const field = (element, update) => ({ element, update: (value) => {
  if (document.activeElement !== element || element.type !== "text") update(value);
} });

const MAKERS = {
  number: (form, node, path, label) => {
    const input = make("input", { type: "number", id: label, step: node.type === "integer" ? 1 : "any" });
    const scale = scaleOf(node);
    const slider = scale && make("input", { type: "range", min: 0, max: scale.steps, step: 1, "aria-label": path.join(".") });
    const take = (value, rests) => Number.isFinite(value) && form.set(path, value, rests);
    input.addEventListener("input", () => input.value !== "" && take(Number(input.value), false));
    input.addEventListener("change", () => (input.value === "" ? update(form.value(path), true) : take(Number(input.value), true)));
    slider?.addEventListener("input", () => take(scale.value(Number(slider.value)), false));
    slider?.addEventListener("change", () => take(scale.value(Number(slider.value)), true));
    const update = (value, anyway = false) => {
      if (anyway || document.activeElement !== input || Number(input.value) !== value) input.value = value;
      if (slider) {
        if (document.activeElement !== slider || scale.value(Number(slider.value)) !== value) slider.value = scale.at(value);
        slider.setAttribute("aria-valuetext", `${value}${node.unit ? ` ${node.unit}` : ""}`);
      }
    };
    return { element: make("div", { class: slider ? "numeric" : "numeric alone" }, slider, input), update };
  },

  switch: (form, node, path, label) => {
    const input = make("input", { type: "checkbox", role: "switch", id: label });
    input.addEventListener("change", () => form.set(path, input.checked, true));
    return field(input, (value) => (input.checked = value));
  },

  choice: (form, node, path, label) => {
    const select = make("select", { id: label }, ...node.enum.map((one) => make("option", { value: JSON.stringify(one) }, words(one))));
    select.addEventListener("change", () => form.set(path, JSON.parse(select.value), true));
    return field(select, (value) => (select.value = JSON.stringify(value)));
  },

  text: (form, node, path, label) => {
    const input = make("input", { type: "text", id: label, spellcheck: "false", autocomplete: "off" });
    input.addEventListener("change", () => form.set(path, input.value, true));
    return field(input, (value) => (input.value = value));
  },

  optional: (form, node, path, label) => {
    const inner = present(node);
    const on = make("input", { type: "checkbox", role: "switch", id: label, "aria-label": `${path.join(".")} is set` });
    const place = make("div", { class: "optional" });
    let part = null;
    on.addEventListener("change", () => form.set(path, on.checked ? freshOptional(inner) : null, true));
    const update = (value) => {
      on.checked = value !== null && value !== undefined;
      if (on.checked && !part) {
        if (GROUPS.includes(kindOf(inner))) part = body(form, inner, path, freshOptional(inner));
        else {
          part = (MAKERS[kindOf(inner)] ?? MAKERS.any)(form, inner, path, id());
          part.element.querySelector?.("input[type=number]")?.setAttribute("aria-label", path.join("."));
        }
        place.replaceChildren(part.element);
      }
      if (!on.checked && part) {
        part = null;
        place.replaceChildren();
      }
      part?.update(value);
    };
    return { element: make("div", { class: "row-of" }, on, place), update };
  },

  tuple: (form, node, path, label) => {
    const inputs = node.prefixItems.map((item, i) => make("input", { type: "number", step: item.type === "integer" ? 1 : "any",
      id: i ? null : label, "aria-label": `${path.join(".")} ${i + 1}` }));
    const colour = path.at(-1).toString().endsWith("_rgb")
      ? make("input", { type: "color", "aria-label": `${path.join(".")} as a colour` }) : null;
    const take = (values, rests) => values.every(Number.isFinite) && form.set(path, values, rests);
    for (const [kind, rests] of [["input", false], ["change", true]]) {
      for (const input of inputs) input.addEventListener(kind, () => take(inputs.map((one) => (one.value === "" ? NaN : Number(one.value))), rests));
      colour?.addEventListener(kind, () => take([1, 3, 5].map((i) => Number((parseInt(colour.value.slice(i, i + 2), 16) / 255).toFixed(3))), rests));
    }
    const update = (value) => {
      inputs.forEach((input, i) => {
        if (document.activeElement !== input || Number(input.value) !== value[i]) input.value = value[i];
      });
      if (colour) colour.value = `#${value.map((one) => Math.round(Math.min(Math.max(one, 0), 1) * 255).toString(16).padStart(2, "0")).join("")}`;
    };
    return { element: make("div", { class: "tuple" }, colour, ...inputs), update };
  },

  several: (form, node, path, label) => {
    const boxes = names(node).map((one, i) => {
      const box = make("input", { type: "checkbox", id: i ? null : label });
      box.addEventListener("change", () => {
        const taken = boxes.filter((other) => other.box.checked).map((other) => other.one);
        const value = form.value(path);
        const others = Array.isArray(value) ? value.filter((item) => !names(node).includes(item)) : [];
        form.set(path, [...taken, ...others], true);
      });
      return { one, box, element: make("label", {}, box, one) };
    });
    const update = (value) => boxes.forEach(({ one, box }) => (box.checked = value === true || Boolean(value.includes?.(one))));
    return { element: make("div", { class: "several" }, ...boxes.map((one) => one.element)), update };
  },

  any: (form, node, path, label) => {
    const input = make("input", { type: "text", id: label, spellcheck: "false", autocomplete: "off", class: "json" });
    input.addEventListener("change", () => {
      let value = input.value;
      try {
        value = JSON.parse(input.value);
      } catch {
        // It is a text.
      }
      form.set(path, value, true);
    });
    return field(input, (value) => (input.value = typeof value === "string" ? value : JSON.stringify(value)));
  },
};

const freshOptional = (node) => {
  const { low = 0, high } = bounds(node);
  if (kindOf(node) !== "number") return fresh(node);
  return low > 0 && high / low > 100 ? Number(Math.sqrt(low * high).toPrecision(1)) : (low + high) / 2;
};

/** How a slider goes from one bound to the other: evenly, or by factors where they are far apart; null without bounds. */
const scaleOf = (node) => {
  const { low, high } = bounds(node);
  if (low === undefined || high === undefined || Math.max(-low, high) >= MOST_BOUND) return null;
  if (low > 0 && high / low >= 1000) {
    const steps = 300;
    const round = (value) => (node.type === "integer" ? Math.round(value) : Number(value.toPrecision(3)));
    return { steps, value: (i) => (i === 0 ? low : i === steps ? high : round(low * (high / low) ** (i / steps))),
      at: (value) => Math.round((steps * Math.log(Math.max(value, low) / low)) / Math.log(high / low)) };
  }
  const step = node.type === "integer" ? 1 : niceStep((high - low) / 500);
  const steps = Math.round((high - low) / step);
  if (steps > MOST_STEPS) return null;
  return { steps, value: (i) => (i >= steps ? high : Number((low + i * step).toFixed(6))), at: (value) => Math.round((value - low) / step) };
};

const niceStep = (width) => {
  const power = 10 ** Math.floor(Math.log10(width));
  return power * [1, 2, 5, 10].find((one) => one * power >= width * 0.999);
};
