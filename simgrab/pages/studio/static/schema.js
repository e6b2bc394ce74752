// Reads the JSON schema of scenes: what kind of control a key gets, and what values a new table has.

let definitions = {};
export const TAGS = ["model", "dist"]; // keys that select the kind of a table

export const learn = (schema) => {
  definitions = schema.$defs;
  return definitions.Scenario.properties;
};

/** Follow a reference; what stands beside it (default, description, unit) wins. */
export const resolved = (node) => {
  if (!node.$ref) return node;
  const { $ref, ...beside } = node;
  return { ...definitions[$ref.split("/").at(-1)], ...beside };
};

/** Names among which a node's list chooses; the list may have other items too, or be given as true or false: all or none. */
export const names = (node) => {
  const list = node.type === "array" ? node : node.anyOf?.find((one) => one.type === "array");
  return list?.items?.enum ?? list?.items?.anyOf?.find((one) => one.enum)?.enum;
};

/** What a schema node asks for: the name of a kind of control. */
export const kindOf = (node) => {
  if (node.discriminator) return "kinds";
  if (names(node)) return "several";
  if (node.anyOf) return node.anyOf.some((one) => one.type === "null") ? "optional" : "mixed";
  if (node.$ref) return kindOf(definitions[node.$ref.split("/").at(-1)]);
  if (node.enum) return "choice";
  if (node.type === "boolean") return "switch";
  if (node.type === "number" || node.type === "integer") return "number";
  if (node.type === "string") return "text";
  if (node.type === "array") return node.prefixItems ? "tuple" : "list";
  if (node.type === "object") return node.properties ? "table" : "entries";
  return "any";
};

/** Tables that a node takes, by tag: [field of the tag, { tag: schema }]. */
export const kinds = (node) => {
  const { propertyName, mapping } = node.discriminator;
  return [propertyName, Object.fromEntries(Object.entries(mapping).map(([tag, $ref]) => [tag, resolved({ $ref })]))];
};

/** The part of a node that takes a value, where it may also have none. */
export const present = (node) => {
  const { anyOf, ...beside } = node;
  return { ...resolved(anyOf.find((one) => one.type !== "null")), ...beside, default: undefined };
};

export const bounds = (node) => ({
  low: node.minimum ?? node.exclusiveMinimum, high: node.maximum, above: node.exclusiveMinimum !== undefined,
});

/** A value to begin with. */
export const fresh = (node) => {
  if (node.default !== undefined) return structuredClone(node.default);
  switch (kindOf(node)) {
    case "optional": return null;
    case "kinds": return freshKind(node, Object.keys(kinds(node)[1])[0]);
    case "mixed": return fresh(node.anyOf[0]);
    case "choice": return node.enum[0];
    case "switch": return false;
    case "number": return freshNumber(node);
    case "text": return "";
    case "tuple": return node.prefixItems.map(fresh);
    case "several": return [names(node)[0]];
    case "list": return node.minItems ? [fresh(resolved(node.items ?? {}))] : [];
    case "table": return freshTable(resolved(node));
    case "entries": return {};
    default: return 0;
  }
};

const freshNumber = (node) => {
  const { low, high, above } = bounds(node);
  if (low === undefined || low <= -1e9) return 0;
  return above ? Math.min(low + 1, (low + high) / 2) : low;
};

const freshTable = (table) => Object.fromEntries(Object.entries(table.properties)
  .filter(([key]) => !TAGS.includes(key))
  .map(([key, value]) => [key, fresh(value)]));

/** A new table of a kind; a distribution keeps about the values that the one before it had. */
export const freshKind = (node, tag, before = null) => {
  const [field, tables] = kinds(node);
  const made = { [field]: tag, ...freshTable(tables[tag]) };
  if (field !== "dist" || !before) return made;
  const { low, high, middle } = spread(before);
  const as = {
    constant: { value: middle }, uniform: { low, high }, choice: { values: [middle] },
    normal: { mean: middle, sd: (high - low) / 4 || 1, low: low < high ? low : null, high: low < high ? high : null },
    "one-of": { values: [middle] },
  };
  return { ...made, ...as[tag] };
};

const spread = (law) => {
  const numbers = Array.isArray(law.values) ? law.values.filter((one) => typeof one === "number") : [];
  const middle = law.value ?? law.mean ?? numbers[0] ?? (law.low + law.high) / 2;
  const low = law.low ?? (numbers.length ? Math.min(...numbers) : middle);
  const high = law.high ?? (numbers.length ? Math.max(...numbers) : middle);
  return Number.isFinite(middle) ? { low, high, middle } : { low: 0, high: 1, middle: 0 };
};

export const same = (one, other) => {
  if (one === other) return true;
  if (typeof one !== "object" || typeof other !== "object" || one === null || other === null) return false;
  if (Array.isArray(one) !== Array.isArray(other)) return false;
  const [keys, others] = [Object.keys(one), Object.keys(other)];
  return keys.length === others.length && keys.every((key) => same(one[key], other[key]));
};

/** Schema node of a dotted key in a scene, and its value; null where there is none. */
export const leaves = function* (properties, scene, before = "") {
  for (const [key, value] of Object.entries(properties)) {
    if (scene?.[key] === undefined) continue;
    const dotted = `${before}${key}`;
    const kind = kindOf(value);
    if (kind === "table") yield* leaves(resolved(value).properties, scene[key], `${dotted}.`);
    else if (kind === "kinds" && kinds(value)[0] !== "dist") {
      const [field, tables] = kinds(value);
      yield [dotted, value, scene[key]];
      yield* leaves(tables[scene[key][field]]?.properties ?? {}, scene[key], `${dotted}.`);
    } else if (kind !== "entries") yield [dotted, value, scene[key]];
  }
};
