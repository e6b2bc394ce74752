// The page as a whole: the scenes that are edited, their history, and the frames that are shown.

import { ask, askJson, byId, make } from "./dom.js";
import { Controls } from "./controls.js";
import { Instrument } from "./instrument.js";
import { switchLayers } from "./overlay.js";
import { learn, same } from "./schema.js";
import { truth } from "./truth.js";
import { Viewer } from "./viewer.js";

const REST_MS = 300; // without a change, after which the full frame is shown
const MOST_STEPS = 200; // of the history
const NONE = "nothing";
const SEED = "another seed";

const report = (problem) => {
  byId("problem").textContent = problem === null ? "" : problem.message;
  byId("problem").hidden = problem === null;
};
const start = await askJson("/api/start").catch((problem) => {
  report(problem);
  throw problem;
});
const properties = learn(start.schema);

/** What undo goes back to: both scenes, and what is shown beside the first. */
let state = { a: start.scene, b: null, beside: NONE };
const view = { frame: 0, side: "a", playing: null };
const history = { past: [], future: [], key: null };

const sceneOf = (side) => (side === "b" && state.beside === SEED ? { ...state.a, seed: state.b.seed } : state[side]);
const sides = () => (state.beside === NONE ? ["a"] : ["a", "b"]);
const frames = () => Math.min(...sides().map((side) => sceneOf(side).frames));

const controls = new Controls(byId("controls"), properties, start.default, () => sceneOf(view.side), change);
controls.layouts = start.layouts;
const viewers = Object.fromEntries(["a", "b"].map((side) => [side, new Viewer(side, document.querySelector(`[data-side="${side}"]`),
  () => ({ scene: sceneOf(side), frame: view.frame }), shown, failed)]));
const instrument = new Instrument(byId("panel-instrument"), () =>
  (viewers[view.side].about && !viewers[view.side].about.small ? { scene: sceneOf(view.side), side: view.side, frame: view.frame } : null),
(side) => viewers[side]);

/** Set what a path of the edited scene holds. A slider that moves is one step of the history, however often it moves. */
function change(path, value, rests) {
  const old = state[view.side];
  const key = `${view.side}.${path.join(".")}`;
  if (!same(path.reduce((inner, name) => inner?.[name], old), value)) {
    remember(key);
    state = { ...state, [view.side]: replaced(old, path, value) };
  }
  if (rests) history.key = null;
  refresh();
  render(!rests);
}

const replaced = (data, [key, ...rest], value) => {
  const next = rest.length ? replaced(data[key], rest, value) : value;
  if (Array.isArray(data)) return data.map((one, i) => (i === key ? next : one));
  return { ...data, [key]: next };
};

function remember(key) {
  if (key !== null && history.key === key) return;
  history.past.push(state);
  if (history.past.length > MOST_STEPS) history.past.shift();
  history.future = [];
  history.key = key;
}

function step(from, to) {
  if (!from.length) return;
  to.push(state);
  state = from.pop();
  history.key = null;
  if (!sides().includes(view.side)) view.side = "a";
  refresh();
  render(false);
}

let resting = null;

/** Show what has changed: small pictures while changes go on, the full ones when they rest. */
function render(small) {
  clearTimeout(resting);
  instrument.stop();
  if (small && !view.playing) resting = setTimeout(() => render(false), REST_MS);
  return Promise.all(sides().map((side) => viewers[side].show(small)));
}

function shown(viewer, about) {
  if (viewer.side === view.side) {
    controls.mark("", null);
    byId("time").textContent = about.timed ? `clip ${about.clip}, ${(about.values.time_s ?? 0).toFixed(2)} s` : `of ${about.frames}`;
  }
  if (!byId("panel-truth").hidden) PANELS.truth();
  if (viewer.side === view.side && !about.small) {
    if (!byId("panel-file").hidden) PANELS.file();
    instrument.restart();
  }
  report(null);
  document.body.dataset.ready = "yes";
}

function failed(viewer, problem) {
  document.body.dataset.ready = "yes";
  if (viewer.side !== view.side) return;
  const { key, problem: line } = problem.answer ?? {};
  if (!controls.mark(key ?? "", line ?? problem.message)) report(problem);
  else report(null);
}

/** Bring everything but the frames up to date. */
function refresh() {
  const scene = sceneOf(view.side);
  controls.update();
  byId("undo").disabled = history.past.length === 0;
  byId("redo").disabled = history.future.length === 0;
  byId("title").textContent = scene.name;
  document.title = `${scene.name} – simgrab studio`;
  byId("about").textContent = scene.description;
  view.frame = Math.min(view.frame, Math.max(frames() - 1, 0));
  for (const id of ["frame", "frame-number"]) Object.assign(byId(id), { max: frames() - 1, value: view.frame });
  byId("compare").value = [NONE, SEED].includes(state.beside) || start.scenes.includes(state.beside) ? state.beside : NONE;
  byId("other-seed").hidden = state.beside !== SEED;
  if (state.beside === SEED && document.activeElement !== byId("seed")) byId("seed").value = state.b.seed;
  document.querySelector('[data-side="b"]').hidden = state.beside === NONE;
  byId("views").classList.toggle("two", state.beside !== NONE);
  byId("which").hidden = [NONE, SEED].includes(state.beside);
  for (const one of document.querySelectorAll("#which input")) one.checked = one.value === view.side;
}

const PANELS = {
  truth: () => byId("panel-truth").replaceChildren(...truth(sides().map((side) => viewers[side].about))),
  file: async () => {
    const scene = sceneOf(view.side);
    try {
      const text = await (await ask("/api/toml", post({}))).text();
      if (!same(scene, sceneOf(view.side))) return; // it has changed meanwhile
      byId("panel-file").replaceChildren(make("pre", { tabindex: "0", "aria-label": "Scene file" }, text));
    } catch (problem) {
      byId("panel-file").replaceChildren(make("p", { class: "bad" }, problem.message));
    }
  },
  instrument: () => instrument.restart(),
};
const post = (more) => ({ method: "POST", body: JSON.stringify({ scene: sceneOf(view.side), ...more }) });

function choose(name) {
  for (const one of Object.keys(PANELS)) {
    byId(`tab-${one}`).setAttribute("aria-selected", one === name);
    byId(`tab-${one}`).tabIndex = one === name ? 0 : -1;
    byId(`panel-${one}`).hidden = one !== name;
  }
  instrument.open = name === "instrument";
  if (!instrument.open) instrument.stop();
  PANELS[name]();
}

function go(frame, small) {
  view.frame = Math.min(Math.max(Math.round(frame) || 0, 0), frames() - 1);
  byId("frame").value = byId("frame-number").value = view.frame;
  return render(small);
}

/** Show small frames one after another at the scene's rate; frames that are late are left out. */
async function play() {
  const mine = (view.playing = {});
  byId("play").textContent = "Pause";
  byId("play").setAttribute("aria-pressed", "true");
  const first = view.frame >= frames() - 1 ? 0 : view.frame;
  const rate = sceneOf("a").clip.frame_rate_hz;
  await go(first, true); // which may take longer, as where a world is built
  const begun = performance.now();
  while (view.playing === mine && view.frame < frames() - 1) {
    const due = begun + ((view.frame + 1 - first) * 1000) / rate;
    await new Promise((done) => setTimeout(done, Math.max(due - performance.now(), 0)));
    if (view.playing !== mine) return;
    await go(Math.max(view.frame + 1, first + Math.floor(((performance.now() - begun) * rate) / 1000)), true);
  }
  if (view.playing === mine) pause();
}

function pause() {
  view.playing = null;
  byId("play").textContent = "Play";
  byId("play").setAttribute("aria-pressed", "false");
  render(false);
}

async function beside(name) {
  let b = null;
  if (name === SEED) b = { ...state.a, seed: state.a.seed + 1 };
  else if (name !== NONE) b = await askJson(`/api/open?scene=${encodeURIComponent(name)}`);
  remember(null);
  state = { ...state, b, beside: name };
  view.side = "a";
  refresh();
  render(false);
}

async function open(name) {
  const scene = await askJson(`/api/open?scene=${encodeURIComponent(name)}`);
  remember(null);
  state = { ...state, [view.side]: scene };
  refresh();
  render(false);
}

async function save() {
  const status = byId("saving-status");
  try {
    const { path } = await askJson("/api/save", post({ path: byId("saving-path").value.trim(), replace: byId("replace").checked }));
    status.textContent = `Saved: ${path}`;
    status.classList.remove("bad");
    byId("saving-replace").hidden = true;
  } catch (problem) {
    status.textContent = problem.message;
    status.classList.add("bad");
    byId("saving-replace").hidden = !problem.answer?.exists;
  }
  byId("replace").checked = false;
}

async function download() {
  const text = await (await ask("/api/toml", post({}))).text();
  const url = URL.createObjectURL(new Blob([text], { type: "application/toml" }));
  make("a", { href: url, download: `${sceneOf(view.side).name}.toml` }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

async function command() {
  const { command: line } = await askJson("/api/command", post({}));
  byId("command").textContent = line ?? `simgrab render ${sceneOf(view.side).name}.toml`;
  byId("command-note").textContent = line === null
    ? "Options alone cannot make these changes. Save the scene, and name the file." : "It renders every frame of the scene.";
  byId("commanding").showModal();
}

const guarded = (act) => async (...given) => {
  try {
    await act(...given);
  } catch (problem) {
    report(problem);
  }
};
const on = (id, kind, act) => byId(id).addEventListener(kind, guarded(act));

function listen() {
  on("undo", "click", () => step(history.past, history.future));
  on("redo", "click", () => step(history.future, history.past));
  const search = () => (byId("no-match").hidden = controls.find(byId("search").value, byId("changed-only").checked) > 0);
  on("search", "input", search);
  on("changed-only", "change", search);
  on("frame", "input", (event) => go(Number(event.target.value), true));
  on("frame", "change", (event) => go(Number(event.target.value), false));
  on("frame-number", "change", (event) => go(Number(event.target.value), false));
  on("before", "click", () => go(view.frame - 1, false));
  on("after", "click", () => go(view.frame + 1, false));
  on("play", "click", () => (view.playing ? pause() : play()));
  on("layers", "change", switchLayers);
  on("compare", "change", (event) => beside(event.target.value));
  on("seed", "input", (event) => {
    const seed = Number(event.target.value);
    if (event.target.value === "" || !Number.isSafeInteger(seed) || seed < 0) return;
    remember("seed");
    state = { ...state, b: { ...state.b, seed } };
    render(true);
  });
  for (const name of Object.keys(PANELS)) on(`tab-${name}`, "click", () => choose(name));
  document.querySelector("[role=tablist]").addEventListener("keydown", (event) => {
    const tabs = [...event.currentTarget.children];
    const next = tabs[tabs.indexOf(document.activeElement) + { ArrowLeft: -1, ArrowRight: 1 }[event.key]];
    if (!next) return;
    next.focus();
    next.click();
  });
  on("open", "click", () => byId("opening").showModal());
  on("opening-go", "click", async () => {
    try {
      await open(byId("opening-name").value.trim());
      byId("opening-problem").textContent = "";
      byId("opening").close();
    } catch (problem) {
      byId("opening-problem").textContent = problem.message;
    }
  });
  on("save", "click", () => {
    byId("saving-path").value ||= `${sceneOf(view.side).name}.toml`;
    byId("saving-status").textContent = "";
    byId("saving-replace").hidden = true;
    byId("saving").showModal();
  });
  on("saving-go", "click", save);
  on("download", "click", download);
  on("copy", "click", command);
  on("command-copy", "click", async () => {
    await navigator.clipboard.writeText(byId("command").textContent);
    byId("command-note").textContent = "Copied.";
  });
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || document.querySelector("dialog[open]")) return;
    const back = event.key === "z" && !event.shiftKey;
    const forth = event.key === "y" || (event.key.toLowerCase() === "z" && event.shiftKey);
    if (!back && !forth) return;
    if (document.activeElement?.matches('input[type="text"], input[type="search"]')) return;
    event.preventDefault();
    step(...(back ? [history.past, history.future] : [history.future, history.past]));
  });
}

function prepare() {
  byId("compare").replaceChildren(...[NONE, SEED, ...start.scenes].map((name) => make("option", { value: name }, name)));
  byId("scenes").replaceChildren(...start.scenes.map((name) => make("option", { value: name })));
  byId("opening-help").textContent = `A bundled scene, or a scene file below ${start.root}.`;
  byId("saving-help").textContent = `A path below ${start.root}; its folder must be there.`;
  byId("which").replaceChildren(...["a", "b"].map((side) => make("label", {},
    make("input", { type: "radio", name: "which", value: side, onchange: () => {
      view.side = side;
      refresh();
      controls.mark("", null);
      shownAgain();
    } }), `Scene ${side.toUpperCase()}`)));
}

function shownAgain() {
  const { about } = viewers[view.side];
  if (about) shown(viewers[view.side], about);
  else render(false);
}

prepare();
listen();
switchLayers();
render(true); // first a small frame, then the full one
controls.build();
refresh();
choose("truth");
