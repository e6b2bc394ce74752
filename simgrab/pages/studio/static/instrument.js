// What the instrument makes of the frame that is shown, from its pixels alone.

import { askJson, make, written } from "./dom.js";

export class Instrument {
  /** `wished()` gives what to measure: { scene, side, frame }, or null where nothing is at rest. */
  constructor(place, wished, viewer) {
    Object.assign(this, { place, wished, viewer, turn: 0, open: false });
    this.content = make("div", { "aria-live": "polite" });
    this.progress = make("p", { class: "field soft" });
    place.replaceChildren(make("div", { class: "bar" }, this.progress), this.content, make("p", { class: "soft" },
      "The instrument gets the image and the camera file, never the truth. One frame gives box and digits. " +
      "The swing takes the tilt of the camera, which is estimated from frames of the same scene."));
  }

  /** Measure what is shown from now on, and then more frames of its record, until there is something newer. */
  async restart() {
    const turn = ++this.turn;
    const wished = this.open ? this.wished() : null;
    if (!wished) return;
    const body = JSON.stringify(wished);
    let found = null;
    this.content.classList.add("old");
    try {
      do {
        found = await askJson("/api/measure", { method: "POST", body });
        if (turn !== this.turn) return;
        this.show(found, wished.side);
      } while (found.measured < found.wanted);
    } catch (problem) {
      if (turn !== this.turn) return;
      if (problem.message === "superseded") setTimeout(() => turn === this.turn && this.restart(), 200);
      else this.content.replaceChildren(make("p", { class: "bad" }, problem.message));
    }
  }

  stop() {
    this.turn++;
    this.content.classList.add("old");
  }

  show(found, side) {
    const viewer = this.viewer(side);
    const known = viewer.about?.values;
    viewer.measured = { box: found.box, centre: found.centre };
    viewer.mark();
    this.content.classList.remove("old");
    const state = { ok: "measured", missed: "no grab found", unread: "no rope length", refused: "refused", lost: "lost" }[found.status];
    const interval = found.alpha_low_deg === null ? "" : ` (95 %: ${found.alpha_low_deg.toFixed(2)} to ${found.alpha_high_deg.toFixed(2)}°)`;
    const box = found.box ? found.box.map((one) => one.toFixed(1)).join(", ") : "–";
    const rows = [
      ["Status", found.reason ? `${state}: ${found.reason}` : state, ""],
      ["Swing α̂", found.alpha_deg === null ? "–" : `${found.alpha_deg.toFixed(2)}°${interval}`, known ? `${known.alpha_deg.toFixed(2)}°` : "–"],
      ["Tilt β̂", found.beta_deg === null ? "–" : `${found.beta_deg.toFixed(2)}°`, known ? `${known.beta_deg.toFixed(2)}°` : "–"],
      ["Box, px", box, viewer.about?.truth.box?.join(", ") ?? "–"],
      ["Score", found.score.toFixed(3), ""],
      ["Digits", found.rope_text === null ? "no display" : `${found.rope_text} (${found.rope_status})`, known?.rope_text ?? "–"],
      ["Rope length |OA|, m", found.rope_length_m === null ? "–" : written(found.rope_length_m), known ? written(known.rope_length_m) : "–"],
    ];
    const head = make("tr", {}, make("td"), make("th", { scope: "col" }, "Measured"), make("th", { scope: "col" }, "Truth"));
    this.progress.replaceChildren(`Tilt from ${found.measured} of ${found.wanted} frames`,
      make("progress", { max: found.wanted, value: found.measured, "aria-label": "Frames measured" }));
    this.content.replaceChildren(
      make("div", { class: "scroll" }, make("table", {}, make("thead", {}, head), make("tbody", {}, ...rows.map(([label, measured, truth]) =>
        make("tr", {}, make("th", { scope: "row" }, label), make("td", { class: "number" }, measured), make("td", { class: "number soft" }, truth)))))));
    this.place.dataset.measured = found.measured;
  }
}
