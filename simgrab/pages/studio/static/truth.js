// What is known of a frame, because it was set.

import { make, written } from "./dom.js";

const ROWS = [
  ["alpha_deg", "α, swing angle", "°"], ["gamma_deg", "γ, azimuth of the swing minus that of the tilt", "°"],
  ["beta_deg", "β, tilt of the camera", "°"], ["theta_deg", "θ, from C′G′ to the grab centre", "°"],
  ["m_px", "m, from C′ to the grab centre", "px"], ["rope_length_m", "Rope length |OA|", "m"],
  ["yaw_deg", "Yaw of the grab", "°"], ["jaw_deg", "Opening of the jaws", "°"], ["load", "Load", ""],
  ["visible_fraction", "Visible part of the grab", ""], ["weather_hidden_fraction", "Light that weather keeps away", ""],
  ["rope_text", "Lengths on the display", ""], ["clock_text", "Clock on the display", ""],
  ["time_s", "Time in the clip", "s"], ["varied", "Varied", ""],
];

const shown = (value) => (typeof value === "number" ? written(value) : value === "" || value === null || value === undefined ? "–" : String(value));

/** A table of the values of the frames that are shown, one column each. */
export const truth = (abouts) => {
  const known = abouts.filter(Boolean);
  if (!known.length) return [make("p", { class: "soft" }, "No frame.")];
  const kept = ROWS.filter(([name]) => known.some((about) => shown(about.values[name]) !== "–"));
  const head = abouts.length > 1 ? make("thead", {}, make("tr", {}, make("td"), ...abouts.map((_, i) => make("th", { scope: "col" }, "AB"[i])))) : null;
  return [make("div", { class: "scroll" }, make("table", {}, head, make("tbody", {}, ...kept.map(([name, label, unit]) =>
    make("tr", {}, make("th", { scope: "row" }, label), ...abouts.map((about) => make("td", { class: "number" },
      about ? `${shown(about.values[name])}${unit && shown(about.values[name]) !== "–" ? ` ${unit}` : ""}` : "–")))))))];
};
