// One frame: asked for, and shown. The latest wish wins; while it waits for its turn, an older one is dropped.

import { ask, make } from "./dom.js";
import { marked } from "./marks.js";
import { same } from "./schema.js";

const SLOW_MS = 700; // after which the page says that it waits, as where another world is built

export class Viewer {
  /** `wished()` gives what to ask for: { scene, frame }; `shown` and `failed` are told what came of it. */
  constructor(side, place, wished, shown, failed) {
    Object.assign(this, { side, place, wished, shown, failed, next: null, running: null, about: null, measured: null, drawn: 0 });
    this.canvas = make("canvas", { role: "img", "aria-label": "Rendered frame" });
    this.layer = make("div");
    this.message = make("p", { class: "message", role: "status" }, "Rendering …");
    this.state = make("figcaption", { class: "soft number" });
    place.replaceChildren(make("div", { class: "picture" }, this.canvas, this.layer, this.message), this.state);
  }

  /** Show what is wished, small or at full size; gives a promise that ends when nothing more is wished. */
  show(small) {
    this.next = { small, at: performance.now() };
    this.running ??= this.run();
    return this.running;
  }

  async run() {
    try {
      while (this.next) {
        const { small, at } = this.next;
        this.next = null;
        await this.one(small, at);
      }
    } finally {
      this.running = null;
    }
  }

  async one(small, at) {
    const { scene, frame } = this.wished();
    if (this.about?.frame === frame && (small || !this.about.small) && same(scene, this.scene)) {
      this.say("");
      return this.shown(this, this.about);
    }
    const slow = setTimeout(() => this.say("Rendering …"), SLOW_MS);
    try {
      const answer = await ask("/api/frame", { method: "POST", body: JSON.stringify({ scene, side: this.side, frame, small }) });
      const { about, picture } = await read(answer);
      if (this.next && !small) return; // something newer comes at once
      this.scene = scene;
      this.draw(about, picture, performance.now() - at);
      this.shown(this, about);
    } catch (problem) {
      if (problem.message === "superseded") {
        this.next ??= { small, at };
        await new Promise((done) => setTimeout(done, 100));
      } else if (!this.next) {
        this.about = null;
        this.layer.replaceChildren();
        this.canvas.classList.add("old");
        this.say(problem.message);
        this.failed(this, problem);
      }
    } finally {
      clearTimeout(slow);
    }
  }

  say(text) {
    this.message.textContent = text;
    this.message.hidden = text === "";
  }

  draw(about, picture, milliseconds) {
    Object.assign(this, { about, measured: null });
    const { width, height } = about;
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.canvas.getContext("2d").drawImage(picture, 0, 0);
    picture.close();
    this.canvas.classList.remove("old");
    this.canvas.setAttribute("aria-label", `Frame ${about.frame}: ${about.values.present
      ? `swing α ${about.values.alpha_deg.toFixed(2)}°` : "no grab"}`);
    this.say("");
    this.mark();
    this.state.textContent = `${width} × ${height}${about.small ? ", preview" : ", as a dataset stores it"}, ${Math.round(milliseconds)} ms`;
    this.place.dataset.small = about.small;
    this.place.dataset.frame = about.frame;
    this.place.dataset.drawn = ++this.drawn;
  }

  mark() {
    if (this.about) this.layer.replaceChildren(marked(this.about, this.measured));
  }
}

const read = async (answer) => {
  const data = await answer.arrayBuffer();
  const length = new DataView(data).getUint32(0);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  const picture = await createImageBitmap(new Blob([new Uint8Array(data, 4 + length)], { type: about.kind }));
  return { about, picture };
};
