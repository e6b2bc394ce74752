// Elements without HTML: whatever a page shows is text, and the browser refuses anything else (Trusted Types).

const SVG = "http://www.w3.org/2000/svg";

const filled = (element, attributes, children) => {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
};

export const make = (tag, attributes = {}, ...children) => filled(document.createElement(tag), attributes, children);

export const svg = (tag, attributes = {}, ...children) =>
  filled(document.createElementNS(SVG, tag), attributes, children);

export const byId = (id) => document.getElementById(id);

/** Ask the server; an answer that is an error is thrown with the line that it gives, and as `answer` with all of it. */
export const ask = async (path, options = {}) => {
  let answer;
  try {
    answer = await fetch(path, options);
  } catch {
    throw new Error("simgrab does not answer: the command has ended");
  }
  if (answer.ok) return answer;
  const text = await answer.text();
  let given = { error: text.trim() };
  try {
    given = JSON.parse(text);
  } catch {
    // It is a line of text.
  }
  throw Object.assign(new Error(given.error || `${answer.status}`), { answer: given });
};

export const askJson = async (path, options) => (await ask(path, options)).json();

/** Write a number with as many digits as tell it apart, for people. */
export const written = (value) => {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (Number.isInteger(value)) return String(value);
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-3) return value.toExponential(2);
  return value.toFixed(size >= 100 ? 1 : size >= 10 ? 2 : 3);
};
