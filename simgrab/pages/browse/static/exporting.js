// Export of the frames that pass the filters, or of those that are selected.

import { askJson, byId, make } from "./dom.js";

const NAMES = {
  simgrab: "simgrab, as rendered", yolo: "YOLO", "yolo-pose": "YOLO, key points", "yolo-seg": "YOLO, polygons",
  "yolo-obb": "YOLO, oriented boxes", coco: "COCO", voc: "Pascal VOC", hf: "Hugging Face Parquet",
};

export class Exporting {
  /** `rows` gives, by "filtered" or "chosen", an array with 1 for each row that is taken. */
  constructor(formats, rows) {
    this.rows = rows;
    this.dialog = byId("exporting");
    byId("format").append(...formats.map((format) => make("option", { value: format }, NAMES[format])));
    byId("export-close").addEventListener("click", () => this.dialog.close());
    byId("export-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.start();
    });
  }

  show(filtered, chosen) {
    byId("which-filtered").textContent = `${filtered} that pass the filters`;
    byId("which-chosen").textContent = `${chosen} selected`;
    const [first, second] = this.dialog.querySelectorAll("input[name=which]");
    second.disabled = chosen === 0;
    first.checked = chosen === 0;
    second.checked = chosen > 0;
    if (!this.running) say("");
    this.dialog.showModal();
  }

  async start() {
    const out = byId("out").value.trim();
    const which = this.dialog.querySelector("input[name=which]:checked").value;
    const body = JSON.stringify({ rows: packed(this.rows(which)), out, format: byId("format").value });
    this.lock(true);
    try {
      await askJson("/api/export", { method: "POST", body, headers: { "content-type": "application/json" } });
      await this.watch();
    } catch (problem) {
      say(problem.message, true);
    }
    this.lock(false);
  }

  async watch() {
    for (;;) {
      const { status, done, total, out, problem } = await askJson("/api/export");
      if (status === "failed") return say(problem, true);
      if (status === "done") return say(`Written: ${total} frames in ${out}`);
      say(`${done} of ${total} frames`);
      await new Promise((resolve) => setTimeout(resolve, 250));
    }
  }

  lock(running) {
    this.running = running;
    byId("export-start").disabled = running;
  }
}

const say = (text, bad = false) => {
  const place = byId("export-status");
  place.textContent = text;
  place.classList.toggle("bad", bad);
};

/** A bit for each row, the lowest of a byte first, as base64. */
const packed = (taken) => {
  const bytes = new Uint8Array(Math.ceil(taken.length / 8));
  for (let i = 0; i < taken.length; i++) if (taken[i]) bytes[i >> 3] |= 1 << (i & 7);
  let text = "";
  for (let i = 0; i < bytes.length; i += 4096) text += String.fromCharCode(...bytes.subarray(i, i + 4096));
  return btoa(text);
};
